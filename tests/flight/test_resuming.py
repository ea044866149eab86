"""A flight whose ground station dies in mid-fold is found again and taken up, in virtual time."""

import json
from dataclasses import replace

import numpy as np
import pytest
from pymavlink.dialects.v20 import common

from swarm import planner
from swarm.errors import InputError, Refused
from swarm.flight.archive import certificate_document, read_certificate
from swarm.flight.conductor import Conductor
from swarm.flight.flight_plan import ResumedFlight
from swarm.flight.setup import FlightOptions
from swarm.flight.tlog import ClockEncoder, frames_document, left_off, read_frames, replay
from swarm.ground.record import Record
from swarm.mission.fleet import emulated_fleet
from swarm.simulation.stepped_simulation import set_audited_parameters
from tests.network import Network, small_plan

PLAN = small_plan()
BEGAN = 1_700_000_000.0
ARDUPILOT_LAND = 9


class Recorded(Network):
    """A network whose packets are kept as a .tlog."""

    def __post_init__(self):
        super().__post_init__()
        set_audited_parameters(self.emulator, self.flight_plan, self.fleet)
        self.tlog = bytearray()
        self.clock_encoder = ClockEncoder(self.flight_plan.plan)
        self.downlink = self.kept

    def kept(self, now, _system, data):
        from swarm.mavlink.packets import split_packets

        for packet in split_packets(data)[0]:
            self.tlog += int((BEGAN + now) * 1e6).to_bytes(8, "big") + packet
        return True

    def once(self):
        before = len(self.sent)
        super().once()
        for now, _, data in self.sent[before:]:
            self.kept(now, 0, data)
        conductor = self.conductor
        if conductor.stage in {"ready", "execute", "contingency"}:
            phase = conductor.phase.name if conductor.stage == "execute" else ""
            data = self.clock_encoder.encode(self.now, conductor.clock.time, phase)
            self.kept(self.now, 0, data)


def cut_off_record(folder):
    """Write the record of a flight that was cut off in its fold, and return its folder."""
    flight = Recorded(small_plan()).in_fold(2.0)
    kept = Record(folder, BEGAN)
    kept.before(flight.flight_plan, flight.conductor.basis, flight.fleet, {})
    for event in flight.events:
        kept.event(event)
    kept.close()
    (folder / "flight.tlog").write_bytes(flight.tlog)
    return folder


def broken_off(autopilots, after, silent_for, *, no_cable=False):
    """A flight that was killed so long into its fold, and the emulator some seconds later."""
    flight = Recorded(PLAN, emulated_fleet(3, autopilots), no_cable=no_cable).in_fold(after)
    flight.uplink = lambda *_: False
    left = left_off(bytes(flight.tlog), PLAN.plan, flight.fleet)
    assert left.gripped
    for _ in range(round(silent_for / flight.step)):
        for _system, _data in flight.emulator.step(flight.now):
            pass
        flight._tick += 1
        flight.now = flight._tick * flight.step
    return flight, left


def taken_up(flight, left, then):
    """The next ground station, which knows what the record says and nothing else."""
    document = certificate_document(flight.conductor.basis, flight.flight_plan.assessment)
    basis, found = read_certificate(json.loads(json.dumps(document)))
    resumed = ResumedFlight(PLAN.plan, basis, found)
    flight.conductor = Conductor(
        resumed, flight.fleet, FlightOptions(no_cable=not basis.cable), left=left, then=then
    )
    flight.uplink = lambda *_: True
    flight.downlink = lambda *_: True
    flight.events.clear()
    flight._start = flight.now
    return flight


@pytest.mark.slow
@pytest.mark.parametrize(
    "autopilots",
    [
        pytest.param(("px4",), marks=pytest.mark.full),
        pytest.param(("ardupilot",), marks=pytest.mark.full),
        ("px4", "ardupilot"),
    ],
    ids="-".join,
)
def test_a_flight_goes_on_where_it_broke_off(autopilots):
    flight, left = broken_off(autopilots, 3.0, 4.0)
    before = flight.emulator.truth().position.copy()
    taken_up(flight, left, "continue")
    flight.run(lambda: flight.conductor.stage == "execute", most=10.0)
    (words,) = flight.words("resume")
    assert words.startswith("found the team at ")
    assert abs(flight.conductor.clock.time - left.mission_time) < 2.0
    flight.run(lambda: not flight.conductor.holding, most=15.0)
    moved = np.linalg.norm(flight.emulator.truth().position - before, axis=1)
    assert moved.max() < 0.4, "nobody jumps when it is streamed to again"
    outcome = flight.run(most=200.0)
    assert outcome.word == "done", flight.words("failure")
    truth = flight.emulator.truth()
    assert not truth.armed.any()
    assert not truth.gripped.any()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("then", "ends"),
    [
        pytest.param("land", "interrupted", marks=pytest.mark.full),
        ("release", "interrupted"),
        ("rewind", None),
    ],
)
def test_the_operator_may_say_what_follows(then, ends):
    flight, left = broken_off(("px4",), 4.0, 3.0)
    taken_up(flight, left, then)
    if then == "rewind":
        start = PLAN.plan.phase("fold").start
        flight.run(lambda: flight.conductor.stage == "execute", most=10.0)
        flight.run(lambda: flight.conductor.clock.time <= start + 1e-6, most=60.0)
        assert flight.conductor.stage == "execute"
        return
    assert flight.run(most=120.0).word == ends
    truth = flight.emulator.truth()
    assert not truth.armed.any()
    assert truth.gripped.all() == (then == "land")


def sent_by_another_station(flight, system, message):
    """Another ground station sends a message, and a step of time passes."""
    way = flight.conductor.team.way_to(system)
    flight.emulator.receive(system, way.encoder.encode(message), flight.now)
    for _system, _data in flight.emulator.step(flight.now):
        pass
    flight._tick += 1
    flight.now = flight._tick * flight.step


def moved_by_another_station(flight, system, aside):
    """It leads a vehicle aside that holds, metres NED, in five seconds, and keeps it there."""
    place = flight.conductor.team.vehicles[system].position
    for share in np.minimum(np.arange(0.0, 1.6, 0.2 * flight.step), 1.0):
        x, y, z = place + share * np.array(aside)
        sent_by_another_station(
            flight,
            system,
            common.MAVLink_set_position_target_local_ned_message(
                0, system, 1, 1, 0b110111111000, x, y, z, 0, 0, 0, 0, 0, 0, 0, 0
            ),
        )


def commands(sent):
    """Return the commands of COMMAND_LONG among packets, and the messages of other kinds."""
    link = common.MAVLink(None)
    read = [message for _, _, data in sent for message in link.parse_buffer(data) or ()]
    return (
        {message.command for message in read if message.get_type() == "COMMAND_LONG"},
        {message.get_type() for message in read} - {"COMMAND_LONG"},
    )


def found_beside_its_plan():
    """A team of which another station has moved a vehicle, searched; and where it is found."""
    flight, left = broken_off(("ardupilot",), 3.0, 4.0)
    moved_by_another_station(flight, 2, (0.0, 0.0, -0.8))
    taken_up(flight, left, None)
    before, began = flight.emulator.truth().position.copy(), len(flight.sent)
    flight.run(lambda: flight.conductor.found is not None, most=10.0)
    asked, others = commands(flight.sent[began:])
    assert asked <= {common.MAV_CMD_SET_MESSAGE_INTERVAL, common.MAV_CMD_REQUEST_MESSAGE}
    assert "HEARTBEAT" in others, "so that all hold on"
    assert others <= {"HEARTBEAT", "TIMESYNC"}
    assert np.linalg.norm(flight.emulator.truth().position - before, axis=1).max() < 0.1
    return flight, left, flight.conductor.found


def flown_from_there(flight, left, rest):
    flight.flight_plan, flight.clock_encoder = rest, ClockEncoder(rest.plan)
    flight.tlog.clear()
    flight.downlink = flight.kept
    flight.conductor = Conductor(
        rest, flight.fleet, left=replace(left, mission_time=0.0, gate=0), then="continue"
    )
    assert flight.conductor.basis.kind == "resumed"
    assert flight.conductor.basis.checked.startswith("certified in the quasi-static cable model")


@pytest.mark.slow
def test_a_team_beside_its_plan_flies_the_rest_of_the_fold_from_there():
    flight, left, found = found_beside_its_plan()
    assert 0.5 < found.off < 0.9
    rest = planner.rest_of_fold(PLAN.plan, found.time, found.places).certified()
    assert np.array_equal(rest.plan.motion.at(0.0)[0], found.places)
    flown_from_there(flight, left, rest)
    assert flight.run(most=300.0).word == "done", flight.words("failure")
    assert flight.words("failure") == []
    words = flight.words("resume")
    assert words[0].startswith("found the team at 0.")
    assert len(words) == 1
    trace = flight.conductor.trace()
    folding = np.array(trace.phase) == "fold"
    error = np.linalg.norm(trace.position - trace.setpoint, axis=2)[folding]
    assert np.nanmax(error) < 0.1, "within its certificate from its first setpoint on"
    assert not flight.emulator.truth().gripped.any()


@pytest.mark.slow
def test_a_team_that_has_moved_since_its_plan_was_made_holds_there():
    flight, left, found = found_beside_its_plan()
    rest = planner.rest_of_fold(PLAN.plan, found.time, found.places).certified()
    moved_by_another_station(flight, 2, (0.0, 0.0, 0.3))
    flown_from_there(flight, left, rest)
    flight.until_time(20.0)
    assert flight.words("resume")[1] == (
        "it has moved since that was planned: it holds once it is there"
    )
    assert flight.conductor.holding == "the flight is resumed"
    assert flight.conductor.clock.time < 1.0
    again = left_off(bytes(flight.tlog), rest.plan, flight.fleet, left.known)
    assert again.gripped, "also where its clock never ran"
    flight.conductor.request("resume")
    assert flight.run(most=300.0).word == "done", flight.words("failure")


@pytest.mark.slow
def test_a_team_that_lands_is_not_found_at_rest():
    flight, left = broken_off(("ardupilot",), 3.0, 4.0)
    for system in (1, 2, 3):
        land = common.MAVLink_command_long_message(
            system, 1, common.MAV_CMD_DO_SET_MODE, 0, 1, ARDUPILOT_LAND, 0, 0, 0, 0, 0
        )
        sent_by_another_station(flight, system, land)
    taken_up(flight, left, None)
    flight.run(lambda: flight.now > flight._start + 6.0, most=10.0)
    assert flight.conductor.found is None


@pytest.mark.slow
def test_without_a_word_from_the_operator_the_team_holds_and_then_lands():
    flight, left = broken_off(("px4",), 3.0, 3.0)
    flight.fleet = flight.fleet.model_copy(
        update={"limits": flight.fleet.limits.model_copy(update={"hold": 8.0})}
    )
    taken_up(flight, left, "hold")
    flight.run(lambda: flight.conductor.stage == "execute", most=10.0)
    flight.until_time(5.0)
    assert flight.conductor.holding is not None, flight.words()
    assert flight.run(most=120.0).word == "interrupted"
    assert not flight.emulator.truth().armed.any()


@pytest.mark.slow
@pytest.mark.parametrize("autopilots", [("px4",), ("ardupilot",)], ids="-".join)
def test_a_flight_without_cable_is_resumed_without_cable(autopilots):
    """Its vehicles lean as vehicles without cable do, and no gripper has lost anything."""
    flight, left = broken_off(autopilots, 3.0, 3.0, no_cable=True)
    taken_up(flight, left, "continue")
    assert not flight.conductor.state.setup.carries_cable
    outcome = flight.run(most=300.0)
    assert outcome.word == "done", flight.words("failure")
    assert flight.words("failure") == []
    basis = flight.conductor.basis
    assert (basis.kind, basis.cable) == ("resumed", False)
    assert basis.checked == (
        "certified in the quasi-static cable model for tracking errors of up to 0.1 m, "
        "before it was interrupted; not checked again"
    )


@pytest.mark.slow
def test_a_resumed_flight_is_replayed_in_the_frames_of_its_record():
    """It begins in mid-air, where no log tells on which pads vehicles stood."""
    flight, left = broken_off(("px4",), 3.0, 3.0)
    document = json.loads(json.dumps(frames_document(left.known)))
    known = read_frames(document, PLAN.plan)
    assert known.systems == left.known.systems
    assert np.array_equal(known.frames.translation, left.known.frames.translation)
    for wrong in ({}, {**document, "yaw": [0.0]}, {**document, "rotation": None}):
        with pytest.raises(InputError, match="the record's frames cannot be read"):
            read_frames(wrong, PLAN.plan)
    flight.tlog.clear()
    taken_up(flight, left, "continue")
    flight.downlink = flight.kept
    assert flight.run(most=300.0).word == "done"
    told = replay(bytes(flight.tlog), PLAN.plan, flight.fleet, known).trace
    folding = np.array(told.phase) == "fold"
    assert np.count_nonzero(folding) > 20
    error = np.linalg.norm(told.position - told.setpoint, axis=2)[folding]
    off = np.linalg.norm(told.position - PLAN.plan.motion.at(told.mission_time)[0], axis=2)[folding]
    assert np.nanmax(error) < 0.3
    assert np.nanmax(off) < 0.6, "in the mission's frame"


def test_a_flight_without_cable_cannot_be_resumed_with_cable():
    flight, left = broken_off(("px4",), 3.0, 3.0, no_cable=True)
    resumed = ResumedFlight(PLAN.plan, flight.conductor.basis, PLAN.assessment)
    with pytest.raises(Refused, match="the flight that is resumed carried no cable"):
        Conductor(resumed, flight.fleet, left=left)


def test_a_recorded_plan_that_was_changed_is_not_resumed():
    flight, _ = broken_off(("px4",), 3.0, 0.0)
    faster = replace(PLAN.plan, gates=PLAN.plan.gates[1:])
    with pytest.raises(Refused, match="the recorded plan is not the plan that was flown"):
        ResumedFlight(faster, flight.conductor.basis, PLAN.assessment)


def test_a_vehicle_that_is_not_found_is_named():
    flight, left = broken_off(("px4",), 3.0, 3.0)
    taken_up(flight, left, "continue")
    flight.downlink = lambda _now, system, _data: system != 2
    outcome = flight.run(most=200.0)
    assert outcome.exit_code == 3
    assert outcome.explanation == "not found: vehicle 2; each vehicle lands by its failsafe"


def test_a_team_that_was_leaving_or_standing_is_not_taken_up():
    flight = Recorded(PLAN, emulated_fleet(3))
    flight.until_phase("fold", 2.0)
    flight.conductor.request("land")
    flight.until_time(1.0)
    with pytest.raises(InputError, match="nothing to resume"):
        left_off(bytes(flight.tlog), PLAN.plan, flight.fleet)
    with pytest.raises(InputError, match="contains no flight"):
        left_off(b"", PLAN.plan, flight.fleet)
