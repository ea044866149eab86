"""Whole flights in virtual time: every autopilot, every wish of the operator, failures of links."""

import math

import numpy as np
import pytest
from pymavlink.dialects.v20 import common

from swarm.flight.parameters import ARDUPILOT_LATE
from swarm.mavlink.packets import Decoder
from swarm.mission.fleet import emulated_fleet
from tests.network import Network, small_plan

PLAN = small_plan()
AUTOPILOTS = [("px4",), ("ardupilot",), ("px4", "ardupilot")]


def network(autopilots=("px4",), plan=PLAN, **options) -> Network:
    return Network(plan, emulated_fleet(plan.plan.vehicles, autopilots), **options)


def patient_for(seconds: float):
    """A fleet with another T, after which everybody lands."""
    fleet = emulated_fleet(3)
    return fleet.model_copy(update={"limits": fleet.limits.model_copy(update={"hold": seconds})})


@pytest.mark.slow
@pytest.mark.parametrize("autopilots", AUTOPILOTS, ids="-".join)
def test_a_plan_is_flown_from_the_pads_to_disarming(autopilots):
    flight = network(autopilots)
    outcome = flight.run()
    assert outcome.word == "done", flight.words()[-12:]
    trace = flight.conductor.trace()
    error = np.linalg.norm(trace.position - trace.setpoint, axis=2)
    folding = np.array([phase == "fold" for phase in trace.phase])
    assert np.sqrt(np.mean(error[folding] ** 2)) < PLAN.plan.mission.vehicles.tracking
    assert not flight.emulator.truth().armed.any()
    assert flight.emulator.truth().contacts == ()


def test_vehicles_are_where_the_plan_says_although_each_has_its_own_origin():
    flight = network(("px4", "ardupilot"), no_cable=True)
    flight.until_phase("hold", 1.0)
    truth = flight.emulator.truth()
    assert (
        np.linalg.norm(truth.position - flight.conductor.state.streams.setpoint, axis=1).max()
        < 0.15
    )
    origins = [vehicle.origin for vehicle in flight.conductor.flyers]
    assert len(set(origins)) == len(origins)


def test_the_same_seed_gives_the_same_flight():
    one, other = (network(no_cable=True, loss=0.05, seed=7) for _ in range(2))
    for flight in (one, other):
        flight.until_phase("lift")
    assert one.sent == other.sent


def test_px4_hears_a_stream_before_offboard_and_is_armed_after_it():
    flight = network(no_cable=True)
    flight.until_phase("takeoff", 1.0)
    seen = [(now, kind) for now, system, kind, *_ in sent_to(flight) if system == 1]
    first = {}
    for now, kind in seen:
        first.setdefault(kind, now)
    assert first["offboard"] - first["setpoint"] >= 0.99
    assert first["arm"] > first["offboard"]


def test_ardupilot_gets_no_setpoint_until_it_flies():
    flight = network(("ardupilot",), no_cable=True)
    flight.run(lambda: bool(flight.conductor.state.streams.active.any()))
    seen = [(now, kind) for now, _, kind, *_ in sent_to(flight)]
    assert "takeoff" in [kind for _, kind in seen]
    assert {now for now, kind in seen if kind == "setpoint"} == {flight.now}
    assert flight.emulator.truth().position[:, 2].max() > 0.5


@pytest.mark.slow
def test_arming_is_never_forced_and_no_vehicle_returns_to_launch():
    flight = network(("px4", "ardupilot"))
    flight.run()
    for _, _, _, message in sent_to(flight):
        if getattr(message, "command", None) == common.MAV_CMD_COMPONENT_ARM_DISARM:
            assert message.param2 == 0.0
        assert getattr(message, "command", None) != common.MAV_CMD_NAV_RETURN_TO_LAUNCH


def test_hold_stops_along_the_path_and_resume_goes_on():
    flight = network(no_cable=True).in_fold(2.0)
    flight.conductor.request("hold")
    flight.until_time(9.5)
    stood = flight.conductor.clock.time
    assert flight.conductor.clock.stopped
    flight.until_time(2.0)
    assert flight.conductor.clock.time == stood
    assert np.linalg.norm(flight.conductor.state.observation.velocity, axis=1).max() < 0.1
    flight.conductor.request("resume")
    flight.until_time(5.0)
    assert flight.conductor.clock.time > stood + 1.0


def test_a_hold_without_a_command_becomes_a_landing():
    flight = Network(PLAN, patient_for(5.0), no_cable=True).in_fold(2.0)
    flight.conductor.request("hold")
    outcome = flight.run(most=60.0)
    assert outcome.word == "interrupted"
    assert "hold timeout: on hold for 5 s: operator command" in flight.words("failure")


@pytest.mark.slow
def test_rewind_goes_back_to_the_beginning_of_the_fold_and_holds():
    flight = network(no_cable=True)
    start = PLAN.plan.phase("fold").start
    flight.until_phase("fold", 3.0)
    flight.conductor.request("rewind")
    flight.until_time(1.0)
    assert flight.conductor.request("resume") == "stops the rewind, and continues the plan"
    flight.until_phase("fold", 3.0)
    flight.conductor.request("rewind")
    flight.run(lambda: flight.conductor.clock.time <= start + 1e-6, most=30.0)
    flight.until_time(1.0)
    assert flight.conductor.holding == (f"rewound to {start:.1f} s: the phase fold begins there")
    assert flight.conductor.clock.time == pytest.approx(start)
    flight.conductor.request("resume")
    assert flight.run().word == "done"


def test_nothing_runs_back_through_a_grip():
    flight = network()
    flight.until_phase("contract", 1.0)
    before = flight.conductor.clock.time
    assert "does not run backwards" in flight.conductor.request("rewind")
    flight.until_time(1.0)
    assert flight.conductor.clock.time > before


@pytest.mark.slow
@pytest.mark.parametrize("autopilots", AUTOPILOTS, ids="-".join)
def test_landing_brings_all_vehicles_straight_down_together(autopilots):
    flight = network(autopilots).in_fold(3.0)
    flight.conductor.request("land")
    flight.run(lambda: flight.conductor.state.guidance.descending)
    above = flight.emulator.truth().position
    outcome = flight.run(most=60.0)
    assert outcome.word == "interrupted"
    below = flight.emulator.truth()
    assert not below.armed.any()
    assert np.linalg.norm(below.position[:, :2] - above[:, :2], axis=1).max() < 0.5
    assert below.gripped.all()


def test_release_drops_the_cable_and_moves_apart():
    flight = network().in_fold(3.0)
    flight.conductor.request("release")
    outcome = flight.run(most=90.0)
    assert outcome.word == "interrupted"
    truth = flight.emulator.truth()
    assert not truth.gripped.any()
    assert not truth.armed.any()
    assert truth.contacts == ()


def test_kill_stops_the_motors():
    flight = network(no_cable=True)
    flight.until_phase("takeoff", 3.0)
    flight.conductor.request("kill")
    assert flight.run(most=20.0).word == "failed"
    assert not flight.emulator.truth().armed.any()
    assert flight.words("contingency") == ["all motors stopped: killed by the operator"]


@pytest.mark.slow
def test_an_interrupt_holds_and_lands_and_a_second_one_lands_at_once():
    once, twice = network(no_cable=True), network(no_cable=True)
    for flight, times in ((once, 1), (twice, 2)):
        flight.until_phase("fold", 2.0)
        for _ in range(times):
            flight.conductor.request("interrupt")
        assert flight.run(most=60.0).exit_code == 130
    assert any(words == "holding: interrupted" for words in once.words("hold"))
    assert twice.now < once.now


def test_before_arming_an_interrupt_just_ends():
    flight = network()
    flight.until_time(0.5)
    flight.conductor.request("interrupt")
    assert flight.conductor.finished.explanation == "interrupted before anything was armed"


@pytest.mark.slow
def test_one_silent_vehicle_holds_the_team_and_after_t_all_land_as_its_failsafe_does():
    flight = Network(PLAN, patient_for(8.0), no_cable=True).in_fold(1.0)
    since = flight.now
    flight.downlink = lambda _now, system, _data: system != 2
    flight.run(lambda: flight.conductor.holding is not None, most=3.0)
    assert flight.now - since == pytest.approx(0.7, abs=0.2)
    flight.run(lambda: flight.conductor.stage == "contingency", most=12.0)
    assert flight.now - since == pytest.approx(9.0, abs=0.3)
    outcome = flight.run(most=80.0)
    assert outcome.exit_code == 3
    assert outcome.explanation == "no packets for 5 s: vehicle 2"
    truth = flight.emulator.truth()
    assert not truth.armed.any(), "it still hears, and lands with the others"


def test_a_short_silence_is_only_a_hold():
    flight = network(no_cable=True).in_fold(1.0)
    start = flight.now
    flight.downlink = lambda now, system, _data: system != 2 or now > start + 2.0
    assert flight.run().word == "done"
    assert "vehicle 2 is received again" in flight.words("link")


def test_a_team_whose_packets_stop_holds_and_is_landed_blind():
    flight = Network(PLAN, patient_for(8.0), no_cable=True).in_fold(1.0)
    since = flight.now
    flight.downlink = lambda *_: False
    outcome = flight.run(most=80.0)
    assert (outcome.word, outcome.exit_code) == ("failed", 3)
    assert outcome.explanation == "no packets of any vehicle for 5 s"
    assert any("landing together" in words for words in flight.words("contingency"))
    assert flight.now - since > 8.0
    assert not flight.emulator.truth().armed.any()


@pytest.mark.slow
@pytest.mark.parametrize("speed", [0.1, 1.0, 20.0])
def test_vehicles_that_are_never_received_are_named_after_real_time(speed):
    """A simulated world may run slower or faster: the person who waits does not."""
    fleet = emulated_fleet(3)
    limits = fleet.limits.model_copy(update={"ready": 8.0})
    fleet = fleet.model_copy(update={"limits": limits})
    flight = Network(PLAN, fleet, speed=speed, downlink=lambda _now, system, _data: system == 1)
    outcome = flight.run()
    assert outcome.exit_code == 3
    assert outcome.explanation == "not received in 8 s: vehicle 2, vehicle 3"
    assert flight.now / speed == pytest.approx(8.0, abs=0.6)
    assert flight.conductor.trace().position.shape == (0, 3, 3)


@pytest.mark.slow
@pytest.mark.parametrize("autopilots", AUTOPILOTS[:2], ids="-".join)
def test_a_vehicle_that_leaves_offboard_is_not_streamed_to_again(autopilots):
    fleet = patient_for(6.0)
    vehicles = tuple(v.model_copy(update={"autopilot": autopilots[0]}) for v in fleet.vehicles)
    flight = Network(PLAN, fleet.model_copy(update={"vehicles": vehicles}), no_cable=True).in_fold(
        1.0
    )
    change_mode(flight, 2, {"px4": (4, 3), "ardupilot": (5, 0)}[autopilots[0]])
    flight.run(lambda: flight.conductor.holding is not None, most=2.0)
    since = flight.now
    outcome = flight.run(lambda: flight.now > since + 40.0, most=60.0)
    assert any("landing together" in words for words in flight.words("contingency"))
    later = [(t, k) for t, system, k, *_ in sent_to(flight) if system == 2 and t > since]
    assert "setpoint" not in [kind for _, kind in later]
    if autopilots == ("ardupilot",):
        assert "mode" not in [kind for _, kind in later], "loiter means a pilot's hands"
    assert any("left offboard mode uncommanded" in words for words in flight.words("failure"))
    assert outcome is None or outcome.exit_code == 3


def change_mode(flight: Network, system: int, mode: tuple[int, int]) -> None:
    """As a pilot's ground station does."""
    pilot = common.MAVLink(None, srcSystem=254, srcComponent=190)
    take_over = common.MAVLink_command_long_message(system, 1, 176, 0, 1, *mode, 0, 0, 0, 0)
    flight.emulator.receive(system, take_over.pack(pilot), flight.now)


def test_a_vehicle_that_left_rejoins_from_where_it_is_when_the_operator_agrees():
    flight = network(no_cable=True).in_fold(2.0)
    change_mode(flight, 2, (4, 3))
    flight.run(lambda: flight.conductor.clock.stopped, most=6.0)
    flight.until_time(1.0)
    where = flight.emulator.truth().position[1].copy()
    flight.sent.clear()
    assert flight.conductor.request("rejoin").startswith("returns vehicle 2 to the team")
    flight.until_time(0.2)
    first = next(m for _, system, kind, m in sent_to(flight) if kind == "setpoint" and system == 2)
    asked = flight.conductor.state.streams.setpoint[1]
    assert np.linalg.norm(asked - where) < 0.1
    assert abs(first.vx) + abs(first.vy) + abs(first.vz) < 0.05
    flight.run(lambda: bool(flight.words("rejoin")), most=8.0)
    assert flight.words("rejoin") == ["vehicle 2 follows again"]
    assert flight.conductor.holding == "vehicles rejoin"
    flight.conductor.request("resume")
    assert flight.run().exit_code == 3, "it is flown to its end, and it is said that one left"
    assert flight.conductor.state.progress.gate == len(PLAN.plan.gates)


def test_the_ground_station_may_sleep_and_no_setpoint_jumps():
    """One second without a tick is not made up for: mission time waits meanwhile."""
    flight = network(no_cable=True).in_fold(4.0)
    before, was = flight.conductor.clock.time, flight.conductor.state.streams.setpoint.copy()
    flight._tick += 20
    flight.once()
    assert flight.conductor.clock.time - before <= 0.1 + 1e-9
    assert np.linalg.norm(flight.conductor.state.streams.setpoint - was, axis=1).max() < 0.15


@pytest.mark.slow
def test_a_lossy_jittery_link_is_flown_through():
    flight = network(("px4", "ardupilot"), loss=0.2, delay=0.05, jitter=0.1, duplication=0.1)
    outcome = flight.run()
    assert outcome.word == "done", flight.words("failure")


@pytest.mark.slow
def test_a_release_without_acknowledgement_is_sent_again():
    dropped = []

    def downlink(_now, system, data):
        for packet in Decoder().feed(data):
            if packet.number == common.MAVLINK_MSG_ID_COMMAND_ACK and system == 2:
                ack = packet.message
                if (
                    ack.command == common.MAV_CMD_DO_GRIPPER
                    and flight.conductor.state.progress.gate == 6
                ):
                    dropped.append(ack)
                    return len(dropped) > 1
        return True

    flight = network(downlink=downlink)
    assert flight.run().word == "done"
    assert len(dropped) >= 2


def test_no_vehicle_outside_the_fleet_is_commanded():
    flight = network()
    stranger = common.MAVLink(None, srcSystem=77, srcComponent=1)
    heartbeat = common.MAVLink_heartbeat_message(2, 12, 81, 0, 3, 3)
    ground = common.MAVLink(None, srcSystem=250, srcComponent=190)
    other = common.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)
    flight.until_phase("takeoff", 0.5)
    for _ in range(100):
        flight.once()
        flight.conductor.receive("loopback", 77, heartbeat.pack(stranger), flight.now)
        flight.conductor.receive("loopback", 250, other.pack(ground), flight.now)
    assert {system for _, system, _ in flight.sent} == {1, 2, 3}
    noticed = " ".join(flight.words("security"))
    assert "system 77 on link loopback is not in the fleet file: ignored" in noticed
    assert "another ground station (system 250)" in noticed


def test_a_vehicle_is_received_only_from_its_first_address():
    flight = network()
    flight.until_time(2.0)
    liar = common.MAVLink(None, srcSystem=1, srcComponent=1)
    lie = common.MAVLink_heartbeat_message(2, 12, 0, 0, 4, 3)
    position = flight.conductor.flyers[0].position
    false = common.MAVLink_local_position_ned_message(0, 1e3, 1e3, 1e3, 0, 0, 0)
    flight.conductor.receive("loopback", 999, lie.pack(liar) + false.pack(liar), flight.now)
    assert flight.conductor.flyers[0].position == position
    assert any("another address" in words for words in flight.words("security")) or any(
        "another address" in event.message for event in flight.conductor.events()
    )


def test_a_link_that_loses_a_fifth_is_no_lost_station_and_setpoints_come_at_their_rate():
    flight = network(no_cable=True).in_fold(5.0)
    end = flight.now
    window = [(t, k) for t, system, k, *_ in sent_to(flight) if system == 3 and t > end - 10.0]
    heartbeats = sum(kind == "heartbeat" for _, kind in window)
    setpoints = sum(kind == "setpoint" for _, kind in window)
    # limits.hold is 8 s at least, after which an ArduCopter that hears none descends
    assert 0.2 ** (heartbeats * (8.0 - ARDUPILOT_LATE) / 10.0) < 1e-12
    assert setpoints == pytest.approx(10.0 * flight.fleet.rates.setpoint, abs=2)


def sent_to(flight: Network):
    """Yield time, system, kind and content of everything that was sent."""
    names = {
        (common.MAV_CMD_COMPONENT_ARM_DISARM, 1.0): "arm",
        (common.MAV_CMD_NAV_TAKEOFF, 0.0): "takeoff",
    }
    decoder = Decoder()
    for now, system, data in flight.sent:
        for packet in decoder.feed(data):
            message = packet.message
            kind = str(packet.number)
            if packet.number == common.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED:
                kind = "setpoint"
                assert math.isfinite(message.x)
            elif packet.number == common.MAVLINK_MSG_ID_HEARTBEAT:
                kind = "heartbeat"
            elif packet.number == common.MAVLINK_MSG_ID_COMMAND_LONG:
                kind = names.get((message.command, message.param1), "command")
                if message.command == common.MAV_CMD_DO_SET_MODE:
                    kind = "offboard" if message.param2 == 6 else "mode"
            yield now, system, kind, message
