"""A flight recomputed from the bytes of its .tlog alone, against what the conductor measured."""

import numpy as np
import pytest
from pymavlink.dialects.v20 import common

from swarm.errors import InputError
from swarm.flight.tlog import ClockEncoder, measurement_times, packets, replay
from swarm.mavlink.packets import split_packets
from swarm.mission.fleet import emulated_fleet
from tests.network import Network, small_plan

PLAN = small_plan()
BEGAN = 1_750_000_000.0


def logged(flight_plan, fleet, most=400.0, **options):
    """Fly in virtual time; return the log's entries in order, and the network."""
    entries: list[tuple[float, bytes]] = []

    def keep(now, _system, data):
        entries.append((now, data))
        return True

    flight = Network(flight_plan, fleet, uplink=keep, downlink=keep, **options)
    clock_encoder = ClockEncoder(flight_plan.plan)
    conductor = flight.conductor

    def tick():
        if conductor.stage in {"ready", "execute", "contingency"}:
            phase = conductor.phase.name if conductor.stage == "execute" else ""
            entries.append(
                (flight.now, clock_encoder.encode(flight.now, conductor.clock.time, phase))
            )
        return False

    flight.run(tick, most=most)
    return entries, flight


def as_tlog(entries):
    out = bytearray()
    for now, data in entries:
        stamp = int((BEGAN + now) * 1e6).to_bytes(8, "big")
        for packet in split_packets(data)[0]:
            out += stamp + packet
    return bytes(out)


@pytest.fixture(scope="module")
def flown():
    fleet = emulated_fleet(3, ("px4", "ardupilot"))
    entries, flight = logged(PLAN, fleet)
    assert flight.conductor.finished.word == "done"
    return as_tlog(entries), flight, fleet


@pytest.mark.slow
def test_positions_setpoints_clock_and_phases_come_back(flown):
    data, flight, fleet = flown
    again, known = replay(data, PLAN.plan, fleet), flight.conductor.trace()
    assert again.known.systems == (1, 2, 3)
    assert again.damaged == 0
    offset = next(now for now, packet in packets(data) if packet) - BEGAN
    for phase in ("fold", "hold"):
        then = np.array(known.phase) == phase
        at = known.time[then] - offset
        for got, was in (
            (again.trace.position, known.position),
            (again.trace.setpoint, known.setpoint),
        ):
            found = np.stack(
                [
                    np.interp(at, again.trace.time, got[:, k, axis])
                    for k in range(3)
                    for axis in range(3)
                ],
                axis=1,
            )
            assert np.abs(found - was[then].reshape(len(at), 9)).max() < 0.05
        clock = np.interp(at, again.trace.time, again.trace.mission_time)
        assert np.abs(clock - known.mission_time[then]).max() < 0.1
    assert list(dict.fromkeys(again.trace.phase))[-2:] == ["finish", "land"]


@pytest.mark.slow
def test_what_others_aboard_say_is_not_replayed_as_the_vehicles(flown):
    data, _, fleet = flown
    alone = [(now - BEGAN, packet) for now, packet in packets(data)]
    said = (
        common.MAVLink_local_position_ned_message(4_000_000, 9, 9, 9, 9, 9, 9),
        common.MAVLink_command_ack_message(400, 4, 0, 0, 255, 190),
    )
    entries = []
    for now, packet in alone:
        camera = common.MAVLink(None, packet[5], 100)
        entries.append((now, packet))
        entries += [(now, one.pack(camera)) for one in said if packet[5] in {1, 2, 3}]
    plain, loud = (replay(as_tlog(one), PLAN.plan, fleet) for one in (alone, entries))
    np.testing.assert_array_equal(plain.trace.position, loud.trace.position)
    assert (plain.commands, plain.received, plain.lost) == (loud.commands, loud.received, loud.lost)


@pytest.mark.slow
def test_reports_that_are_read_late_stand_at_the_time_of_their_measurement(flown):
    data, _, fleet = flown
    trace = replay(data, PLAN.plan, fleet).trace
    began = next(now for now, packet in packets(data) if packet)
    # moves at 1 m/s here: half a metre, if what is read late were taken as new
    middle = began + trace.time[np.argmax(np.array(trace.phase) == "fold")] + 2.5
    stalled = middle, middle + 0.5
    entries = [
        (stalled[1] if stalled[0] < now < stalled[1] and packet[5] != 255 else now, packet)
        for now, packet in packets(data)
        if packet
    ]
    entries.sort(key=lambda entry: entry[0])
    late = replay(as_tlog([(now - BEGAN, packet) for now, packet in entries]), PLAN.plan, fleet)
    moved = np.abs(trace.position - late.trace.position)
    assert np.nanmax(moved) < 0.005
    assert np.nanmax(np.abs(np.diff(trace.position[:, 1], axis=0))) > 0.08


@pytest.mark.parametrize("drift", [-1e-4, 0.0, 1e-4])
def test_measurement_times_keep_to_the_clock_by_which_reports_are_read(drift):
    rng = np.random.default_rng(7)
    true = np.arange(0.0, 300.0, 0.05)
    boot = 12.0 + (1.0 + drift) * true
    read = true + 0.01 + rng.exponential(0.05, len(true))
    found = measurement_times(np.maximum.accumulate(read).tolist(), boot.tolist())
    assert np.abs(found - true - 0.01).max() < 0.006


@pytest.mark.parametrize(
    "boot", [np.zeros(400), np.arange(400) % 200 * 0.05 + 3.0], ids=["no clock", "boots anew"]
)
def test_without_a_vehicles_clock_reports_stand_where_they_were_read(boot):
    read = 5.0 + np.arange(400) * 0.05
    assert measurement_times(read.tolist(), boot.tolist()).tolist() == read.tolist()


@pytest.mark.slow
def test_commands_and_losses_are_counted(flown):
    data, flight, fleet = flown
    again = replay(data, PLAN.plan, fleet)
    commands = {one.name: one for one in again.commands}
    assert commands["do gripper"].sent == commands["do gripper"].answered == 9
    assert 0.0 <= commands["component arm disarm"].median < 1.0
    assert again.lost == {1: 0, 2: 0, 3: 0}
    for vehicle in flight.conductor.team.vehicles.values():
        # what arrived after the flight's end is in the log, too
        assert 0 <= again.received[vehicle.system] - vehicle.packets < 30


@pytest.mark.slow
def test_a_log_that_was_cut_off_anywhere_is_read_to_there(flown):
    data, _, fleet = flown
    for share in (0.6, 0.8):
        cut = data[: int(share * len(data)) + 5]
        again = replay(cut, PLAN.plan, fleet)
        whole = replay(data, PLAN.plan, fleet)
        rows = len(again.trace.time) - 2
        assert again.damaged == 0
        assert again.trace.phase[:rows] == whole.trace.phase[:rows]


@pytest.mark.slow
def test_a_hole_in_the_log_costs_what_was_in_it(flown):
    data, _, fleet = flown
    middle, noted = len(data) // 2, []
    for size in (20_008, 20_009, 20_010):
        again = replay(data[: middle + 3] + data[middle + 3 + size :], PLAN.plan, fleet)
        assert 0 < again.damaged < 10
        assert again.trace.phase[-1] == "land"
        noted.append("damaged place" in " ".join(again.notes))
    assert sum(noted) >= 2, "of three, one may end where a packet ends"


@pytest.mark.parametrize("data", [b"", b"nonsense" * 100, bytes(10_000)])
def test_what_is_no_log_of_a_flight_is_refused(data):
    with pytest.raises(InputError, match=r"flight\.tlog contains no flight"):
        replay(data, PLAN.plan, emulated_fleet(3))


def test_losses_show():
    fleet = emulated_fleet(3)
    dropped = {"count": 0}

    def lossy(_now, system, _data):
        dropped["count"] += system == 2
        return not (system == 2 and dropped["count"] % 10 == 0)

    entries: list[tuple[float, bytes]] = []
    flight = Network(PLAN, fleet, no_cable=True, downlink=lossy)
    receive = flight.conductor.receive

    def kept(link, address, data, now):
        entries.append((now, data))
        receive(link, address, data, now)

    flight.conductor.receive = kept
    clock_encoder = ClockEncoder(PLAN.plan)
    flight.until_phase("takeoff", 2.0)
    entries.append((flight.now, clock_encoder.encode(flight.now, 0.0, "takeoff")))
    again = replay(as_tlog(entries), PLAN.plan, fleet)
    assert again.lost[2] > 5
    assert again.lost[1] == again.lost[3] == 0


@pytest.mark.slow
def test_nine_vehicles_with_nine_origins_headings_heights_and_clocks_keep_the_cable_whole():
    flight_plan = small_plan(vehicles=9)
    flight = Network(flight_plan, emulated_fleet(9, ("px4", "ardupilot")))
    flight.until_phase("hold", 1.0)
    flyers, truth = flight.conductor.flyers, flight.emulator.truth()
    for different in (
        [v.origin.latitude for v in flyers],
        [v.origin.altitude for v in flyers],
        [v.attitude[2] for v in flyers],
        [v.clock_offset for v in flyers],
        [v.position[2] for v in flyers],
    ):
        assert len(set(np.round(different, 7))) == 9
    wanted = flight.conductor.state.streams.setpoint
    lift = [0.0, 0.0, flight_plan.plan.mission.vehicles.grip_offset]
    off = np.linalg.norm(truth.position - wanted, axis=1)
    off = np.minimum(off, np.linalg.norm(truth.position - wanted - lift, axis=1))
    # what an estimator gets wrong after standing on its pad cannot be seen from the ground
    assert off.max() < 0.25
    heights = truth.position[:, 2]
    assert np.ptp(heights) < 0.3
    chords = np.linalg.norm(np.diff(truth.position, axis=0), axis=1)
    assert np.all(chords < flight_plan.plan.layout.lengths)
    assert truth.gripped.all()
    assert np.ptp([v.origin.altitude for v in flyers]) > 1.0
