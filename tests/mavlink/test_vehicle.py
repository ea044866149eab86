"""One vehicle: the effects of its messages, and the commands to it."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common, development

from swarm.mavlink.packets import Decoder, Packet
from swarm.mavlink.vehicle import Vehicle

PX4, ARDUPILOT = common.MAV_AUTOPILOT_PX4, common.MAV_AUTOPILOT_ARDUPILOTMEGA


class Wire:
    """Passes packets that pymavlink has packed to a vehicle."""

    def __init__(self, system=3):
        self.vehicle = Vehicle(system)
        self._mav = common.MAVLink(None, srcSystem=system, srcComponent=1)

    def __call__(self, message, now=0.0):
        (packet,) = Decoder().feed(message.pack(self._mav))
        self._mav.seq = (self._mav.seq + 1) % 256
        self.vehicle.receive(packet, now)
        return [event.kind for event in self.vehicle.take_events()]

    def lose(self, count):
        self._mav.seq = (self._mav.seq + count) % 256


def heartbeat(autopilot=PX4, armed=False, custom_mode=0):
    base = 1 | (common.MAV_MODE_FLAG_SAFETY_ARMED if armed else 0)
    return common.MAVLink_heartbeat_message(2, autopilot, base, custom_mode, 4, 3)


def current_mode(custom_mode):
    """CURRENT_MODE, from a dialect that defines it."""
    return development.MAVLink_current_mode_message(0, custom_mode, custom_mode)


@pytest.mark.parametrize(
    ("autopilot", "custom_mode", "name"),
    [
        (PX4, 6 << 16, "offboard"),
        (PX4, 4 << 16 | 6 << 24, "land"),
        (PX4, 4 << 16 | 5 << 24, "return"),
        (PX4, 3 << 16, "position"),
        (ARDUPILOT, 4, "guided"),
        (ARDUPILOT, 9, "land"),
        (ARDUPILOT, 6, "return"),
        (ARDUPILOT, 250, "mode 250"),
    ],
)
def test_modes_have_names(autopilot, custom_mode, name):
    wire = Wire()
    assert wire(heartbeat(autopilot, custom_mode=custom_mode)) == ["discovered", "mode"]
    assert wire.vehicle.mode == name


def test_arming_and_disarming_are_reported_once():
    wire = Wire()
    wire(heartbeat())
    assert wire(heartbeat(armed=True)) == ["armed"]
    assert wire(heartbeat(armed=True)) == []
    assert wire(heartbeat(armed=False)) == ["disarmed"]


def test_other_components_do_not_change_the_autopilots_state():
    wire = Wire()
    wire(heartbeat())
    camera = common.MAVLink_heartbeat_message(30, common.MAV_AUTOPILOT_INVALID, 128, 9, 4, 3)
    assert wire(camera) == []
    assert not wire.vehicle.armed


def test_packets_of_a_companion_computer_do_not_count_as_the_autopilots():
    wire = Wire()
    wire(heartbeat(), 1.0)
    aboard = common.MAVLink(None, srcSystem=3, srcComponent=191)
    companion = common.MAVLink_heartbeat_message(18, common.MAV_AUTOPILOT_INVALID, 0, 0, 4, 3)
    (packet,) = Decoder().feed(companion.pack(aboard))
    wire.vehicle.receive(packet, 5.0)
    assert wire.vehicle.received_at == 1.0


def test_px4_reports_its_mode_between_heartbeats():
    wire = Wire()
    wire(heartbeat(custom_mode=6 << 16))
    offboard, hold = 6 << 16, 4 << 16 | 3 << 24
    events = [wire(current_mode(mode), 0.3) for mode in (offboard, hold, hold)]
    assert events == [[], ["mode"], []]
    assert (wire.vehicle.mode, wire.vehicle.mode_at) == ("hold", 0.3)
    assert wire.vehicle.heartbeat_at == 0.0


def test_another_autopilot_is_unknown():
    wire = Wire()
    wire(heartbeat(common.MAV_AUTOPILOT_GENERIC))
    assert wire.vehicle.autopilot is None
    assert wire.vehicle.mode == "unknown"


def test_readiness_is_unknown_until_it_is_reported():
    wire = Wire()
    bit = common.MAV_SYS_STATUS_PREARM_CHECK

    def status(present, health):
        return common.MAVLink_sys_status_message(
            present, present, health, 0, 16000, 0, 87, 0, 0, 0, 0, 0, 0
        )

    wire(status(1, bit))
    assert wire.vehicle.ready is None
    wire(heartbeat(ARDUPILOT))
    wire(status(1, bit))
    assert wire.vehicle.ready is None
    wire(status(bit, 0))
    assert wire.vehicle.ready is False
    wire(status(bit, bit))
    assert wire.vehicle.ready is True
    assert wire.vehicle.battery == pytest.approx(0.87)


def test_px4_reports_readiness_in_the_sensors_health_only():
    wire = Wire()
    wire(heartbeat(PX4))
    bit = common.MAV_SYS_STATUS_PREARM_CHECK
    for health, ready in ((1, False), (1 | bit, True), (1, False)):
        wire(common.MAVLink_sys_status_message(1, 1, health, 0, 16000, 0, 87, 0, 0, 0, 0, 0, 0))
        assert wire.vehicle.ready is ready


def test_an_unknown_battery_is_not_empty():
    wire = Wire()
    wire(common.MAVLink_sys_status_message(0, 0, 0, 0, 16000, 0, -1, 0, 0, 0, 0, 0, 0))
    assert math.isnan(wire.vehicle.battery)


def test_chunks_of_long_texts_are_joined_and_stripped():
    wire = Wire()
    long = "x" * 50 + "the rest\t"
    for chunk in range(2):
        part = long[50 * chunk : 50 * chunk + 50].encode()
        wire(common.MAVLink_statustext_message(3, part, 11, chunk), 5.0)
    assert [text for _, _, text in wire.vehicle.texts] == ["x" * 50 + "the rest"]
    assert wire.vehicle.recent_warnings(6.0) == "x" * 50 + "the rest"
    assert wire.vehicle.recent_warnings(60.0) == ""


def test_lost_packets_are_counted_by_sequence():
    wire = Wire()
    for _ in range(300):
        wire(heartbeat())
    wire.lose(7)
    wire(heartbeat())
    assert wire.vehicle.lost_packets == 7


@pytest.mark.parametrize("start", [0, 200, 254])
def test_late_packets_are_not_lost_and_repeated_ones_count_once(start):
    vehicle = Vehicle(7)
    order = [0, 1, 3, 4, 2, 2, 4, 8, 9, 6, 5, 12]
    for number in order:
        vehicle.receive(Packet(9999, 7, 1, start + number & 0xFF, None), 1.0)
    assert vehicle.lost_packets == 3, "7, 10 and 11"
    for number in range(13, 13 + 256):
        vehicle.receive(Packet(9999, 7, 1, start + number & 0xFF, None), 2.0)
    for number in (256 + 7, 256 + 10):
        vehicle.receive(Packet(9999, 7, 1, start + number & 0xFF, None), 3.0)
    assert vehicle.lost_packets == 3, "the numbers repeat, and these have arrived"


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_lost_packets_are_those_that_never_arrive(seed):
    """Packets are lost, doubled and overtaken by up to twenty others."""
    rng = np.random.default_rng(seed)
    vehicle = Vehicle(7)
    sent = [k for k in range(1, 1500) if rng.random() > 0.1] + [1500]
    copies = [*sent, *rng.choice(sent, 200)]
    late = np.array(copies) + rng.uniform(0.0, 20.0, len(copies))
    for number in [0, *(copies[k] for k in np.argsort(late))]:
        vehicle.receive(Packet(9999, 7, 1, number & 0xFF, None), 1.0)
    assert vehicle.lost_packets == 1501 - len(sent) - 1


def test_an_overtaken_packet_is_not_two_hundred_lost_ones():
    wire = Wire()
    wire(heartbeat())
    wire.lose(255 - 1)
    wire(heartbeat())
    assert wire.vehicle.lost_packets == 0


def test_a_boot_time_that_goes_back_is_a_reboot_but_reordering_is_not():
    wire = Wire()

    def position(boot):
        return common.MAVLink_local_position_ned_message(boot, 0, 0, 0, 0, 0, 0)

    wire(position(50_000))
    assert wire(position(49_500)) == []
    assert wire(position(1_000)) == ["rebooted"]


def test_a_moved_origin_is_reported_but_rounding_is_not():
    wire = Wire()

    def origin(latitude, altitude):
        return common.MAVLink_gps_global_origin_message(latitude, 85_000_000, altitude, 0)

    assert wire(origin(470_000_000, 400_000)) == []
    assert wire(origin(470_000_001, 400_001)) == []
    assert wire(origin(470_000_100, 400_000)) == ["origin"]


@pytest.mark.parametrize(("metres", "reports"), [(0.5, 0), (3.0, 1)])
def test_a_mismatch_of_local_and_global_position_is_reported_once(metres, reports):
    wire = Wire()
    wire(heartbeat())
    wire(common.MAVLink_gps_global_origin_message(470_000_000, 85_000_000, 400_000, 0))
    kinds = []
    for second in range(8):
        north = metres if second > 2 else 0.0
        boot = 1000 * second
        local = common.MAVLink_local_position_ned_message(boot, north, 0, -5, 0, 0, 0)
        kinds += wire(local, float(second))
        position = common.MAVLink_global_position_int_message(
            boot, 470_000_000, 85_000_000, 405_000, 5_000, 0, 0, 0, 0
        )
        kinds += wire(position, second + 0.1)
    assert kinds.count("origin") == reports


def test_the_clock_offset_is_that_of_the_fastest_answer():
    wire = Wire()
    for delay, late in ((0.4, 0.1), (0.02, 0.01), (0.3, 0.0)):
        sent = 100.0
        theirs = sent + delay / 2 + late + 7.0
        answer = common.MAVLink_timesync_message(int(theirs * 1e9), int(sent * 1e9))
        wire(answer, sent + delay)
    assert wire.vehicle.round_trip == pytest.approx(0.02)
    assert wire.vehicle.clock_offset == pytest.approx(7.01)


def test_unused_streams_are_stopped_and_restored():
    wire = Wire()
    wire(heartbeat())
    for k in range(100):
        wire(common.MAVLink_attitude_quaternion_message(k, 1, 0, 0, 0, 0, 0, 0), 0.02 * k)
        wire(common.MAVLink_attitude_message(k, 0, 0, 0, 0, 0, 0), 0.02 * k)
    wire.vehicle.stop_unused_streams(0.0, 2.0)
    unused = {
        common.MAVLINK_MSG_ID_ATTITUDE_QUATERNION,
        common.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED,
    }
    assert accepted_commands(wire, 2.0) == {(message, -1.0) for message in unused}
    wire.vehicle.stop_unused_streams(0.0, 2.0)
    assert wire.vehicle.commands.idle
    wire.vehicle.restore_streams()
    assert accepted_commands(wire, 3.0) == {(message, 0.0) for message in unused}


def accepted_commands(wire: "Wire", now: float) -> set[tuple[float, float]]:
    """Accept all commands, one after the other; return their first two parameters."""
    commands = set()
    while messages := wire.vehicle.tick(now):
        for message in messages:
            commands.add((message.param1, message.param2))
            wire(common.MAVLink_command_ack_message(message.command, 0), now)
    wire.vehicle.tick(now)
    return commands


def test_modes_are_commanded_as_each_autopilot_expects():
    for autopilot, main, sub in ((PX4, 4.0, 6.0), (ARDUPILOT, 9.0, 0.0)):
        wire = Wire()
        wire(heartbeat(autopilot))
        wire.vehicle.set_mode("land")
        wire.vehicle.set_mode("land")
        (message,) = wire.vehicle.tick(0.0)
        assert (message.param1, message.param2, message.param3) == (1.0, main, sub)


@pytest.mark.parametrize(("accuracy", "window"), [(0.02, 0.0), (1.0, 5.0), (1.78, 9.0)])
def test_the_satellite_height_is_averaged_longer_for_poor_receivers(accuracy, window):
    wire = Wire()
    wire(heartbeat())
    wire(common.MAVLink_gps_global_origin_message(0, 0, 100_000))
    rng = np.random.default_rng(1)
    heights = rng.normal(0.0, accuracy / 3.56, 60)
    differences = []
    for now, height in enumerate(heights.tolist()):
        wire(common.MAVLink_local_position_ned_message(1000 * now, 0, 0, -5.0, 0, 0, 0), float(now))
        millimetres = round(1000 * (105.0 + height))
        wire(
            common.MAVLink_gps_raw_int_message(
                0, 3, 0, 0, millimetres, 90, 178, 0, 0, 10, 0, 900, round(1000 * accuracy)
            ),
            float(now),
        )
        differences.append(wire.vehicle.height_difference)
    known = [k for k, difference in enumerate(differences) if not math.isnan(difference)]
    assert known[0] == pytest.approx(window, abs=1.0)
    assert known == list(range(known[0], 60))
    assert np.abs(np.array(differences)[known]).max() < 0.3
