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


def aboard(component, message, system=3):
    """A packet of another component with a vehicle's system id."""
    (packet,) = Decoder().feed(message.pack(common.MAVLink(None, system, component)))
    return packet


CAMERA = common.MAVLink_heartbeat_message(30, common.MAV_AUTOPILOT_GENERIC, 0, 0, 4, 3)


@pytest.mark.parametrize("component", [0, 2, 25, 100, 154, 191, 255])
def test_only_the_autopilots_component_counts(component):
    """What a camera, gimbal or companion computer says of itself is not said of the vehicle."""
    wire = Wire()
    wire(heartbeat(armed=True, custom_mode=6 << 16), 1.0)
    vehicle = wire.vehicle
    vehicle.parameters.fetch()
    vehicle.arm()
    vehicle.tick(1.0)
    before = repr(vehicle)
    for message in (
        CAMERA,
        common.MAVLink_heartbeat_message(26, common.MAV_AUTOPILOT_PX4, 0, 0, 4, 3),
        common.MAVLink_command_ack_message(400, common.MAV_RESULT_UNSUPPORTED, 0, 0, 255, 190),
        common.MAVLink_param_value_message(b"GMB_YAW", 1.0, 9, 1, 0),
        common.MAVLink_sys_status_message(0, 0xFFFFFFF, 0, 900, 4900, -1, 3, 0, 0, 0, 0, 0, 0),
        common.MAVLink_extended_sys_state_message(0, 1),
        common.MAVLink_gps_raw_int_message(0, 0, 0, 0, 0, 65535, 65535, 65535, 65535, 0),
        common.MAVLink_local_position_ned_message(90_000, 9, 9, 9, 9, 9, 9),
        common.MAVLink_attitude_message(90_000, 3, 0, 0, 0, 0, 0),
        common.MAVLink_timesync_message(1, 1),
        common.MAVLink_gps_global_origin_message(1, 1, 1),
        common.MAVLink_vfr_hud_message(1, 1, 1, 1, 1, 1),
    ):
        vehicle.receive(aboard(component, message), 1.5)
    assert repr(vehicle) == before
    assert vehicle.received_at == 1.0
    assert vehicle.packets == 1


def test_a_camera_that_is_received_first_is_not_the_vehicle():
    vehicle = Vehicle(3)
    vehicle.receive(aboard(100, CAMERA), 0.0)
    assert vehicle.take_events() == []
    vehicle.receive(aboard(1, heartbeat()), 1.0)
    assert (vehicle.component, vehicle.mode, vehicle.heartbeat_at) == (1, "mode 0", 1.0)


def test_an_autopilot_may_have_another_component():
    vehicle = Vehicle(3)
    vehicle.receive(aboard(4, heartbeat()), 0.0)
    vehicle.receive(aboard(4, position(1_000, 5.0)), 0.1)
    assert (vehicle.component, vehicle.commands.component, vehicle.position[0]) == (4, 4, 5.0)


def test_texts_of_other_components_name_them():
    wire = Wire()
    wire(heartbeat())
    text = common.MAVLink_statustext_message(3, b"gimbal stuck", 0, 0)
    wire.vehicle.receive(aboard(154, text), 0.5)
    assert [event.message for event in wire.vehicle.take_events()] == [
        "component 154: gimbal stuck"
    ]
    assert wire.vehicle.texts == []


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


LONG = "PreArm: Compass: 12 °C, the field is out of range, check the mount near motor 3, Ωß"


def chunks(text, number):
    raw = text.encode()
    return [(raw[k : k + 50], number, place) for place, k in enumerate(range(0, len(raw), 50))]


def said(*arrived, after=5.0):
    """The texts of chunks that arrive one after the other, and of later silence."""
    wire = Wire()
    wire(heartbeat())
    for k, (raw, number, place) in enumerate(arrived):
        (packet,) = Decoder().feed(
            common.MAVLink_statustext_message(4, raw, number, place).pack(wire._mav)
        )
        wire.vehicle.receive(packet, 0.01 * k)
    wire(heartbeat(), after)
    return [text for _, _, text in wire.vehicle.texts]


def test_chunks_are_joined_as_bytes_whatever_their_order():
    first, second = chunks(LONG, 7)
    assert said(first, second) == said(second, first) == [LONG]
    assert said(first, first, second, second, first) == [LONG]


@settings(max_examples=100, deadline=None)
@given(st.text(min_size=1, max_size=120), st.randoms(use_true_random=False))
def test_any_text_comes_through_doubled_and_shuffled(text, rng):
    text = " ".join("".join(c for c in text if c.isprintable()).split())
    arrived = [*chunks(text, 9), (b"", 9, len(chunks(text, 9)))] * 2
    rng.shuffle(arrived)
    assert said(*arrived)[:1] == ([text] if text else [])


def test_lost_chunks_are_marked():
    one, two, three = chunks("a" * 50 + "b" * 50 + "end", 3)
    assert said(one, three) == ["a" * 50 + "[…]end"]
    assert said(one, two) == ["a" * 50 + "b" * 50 + "[…]"]
    assert said(one, (b"other", 0, 0)) == ["a" * 50 + "[…]", "other"]
    assert said(one, *chunks("c" * 50 + "d", 3)) == ["a" * 50 + "[…]", "c" * 50 + "d"]
    assert said((b"x", 3, 255)) == ["[…]x"]


def test_px4s_first_long_text_is_not_split():
    """PX4 1.16 counts its texts from 0, which stands for a text of one chunk."""
    text = "Preflight Fail: No connection to the ground control station"
    assert said(*chunks(text, 0)) == [text]
    assert said((b"x" * 50, 0, 0)) == ["x" * 50]


def test_control_characters_do_not_reach_the_screen():
    raw = b"\x1b[2J\x07red\xe2\x80\xaegnp.exe\r\nnext\x9b"
    assert said((raw, 0, 0)) == ["\ufffd[2J\ufffdred\ufffdgnp.exe  next\ufffd"]


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


def position(boot, north=0.0):
    return common.MAVLink_local_position_ned_message(boot, north, 0, 0, 0, 0, 0)


def test_a_clock_that_begins_anew_and_stays_is_a_reboot():
    wire = Wire()
    wire(position(50_000), 20.0)
    events = [wire(position(3_000 + 100 * k, 1.0), 23.0 + 0.1 * k) for k in range(20)]
    assert events.index(["rebooted"]) == 5
    assert events.count([]) == len(events) - 1
    assert (wire.vehicle.boot_ms, wire.vehicle.position[0]) == (4_900, 1.0)


@pytest.mark.parametrize(
    ("stamps", "at"),
    [
        ([46_800, 46_900, 47_000, 47_100], [20.1, 20.2, 20.3, 20.9]),
        ([0, 100, 200, 300], [20.1, 20.1, 20.1, 20.1]),
        ([500], [20.2]),
        ([30_000 + 100 * k for k in range(30)], [22.0 + 0.1 * k for k in range(30)]),
    ],
    ids=["seconds late", "a burst from the beginning", "one", "late after the vehicle is gone"],
)
def test_late_positions_neither_count_nor_are_a_reboot(stamps, at):
    wire = Wire()
    wire(position(50_000, 7.0), 20.0)
    assert [wire(position(stamp), now) for stamp, now in zip(stamps, at, strict=True)] == [
        [] for _ in at
    ]
    assert (wire.vehicle.position[0], wire.vehicle.position_at) == (7.0, 20.0)


def test_old_positions_between_new_ones_are_never_a_reboot():
    wire = Wire()
    for k in range(200):
        now = 20.0 + 0.05 * k
        assert wire(position(50_000 + 50 * k, 7.0), now) == []
        assert wire(position(10 * k), now) == []
        assert wire.vehicle.position[0] == 7.0


def test_a_clock_that_overflows_after_fifty_days_goes_on():
    wire = Wire()
    for k in range(10):
        assert wire(position((2**32 - 250 + 50 * k) % 2**32, float(k)), 20.0 + 0.05 * k) == []
    assert (wire.vehicle.position[0], wire.vehicle.boot_ms) == (9.0, 200)


def test_a_reboot_after_a_month_is_a_reboot():
    wire = Wire()
    wire(position(2_900_000_000), 20.0)
    events = [wire(position(3_000 + 100 * k), 23.0 + 0.1 * k) for k in range(9)]
    assert events.count(["rebooted"]) == 1


def test_late_attitudes_and_global_positions_do_not_count():
    wire = Wire()
    wire(common.MAVLink_attitude_message(50_000, 1.0, 0, 0, 0, 0, 0))
    wire(common.MAVLink_global_position_int_message(50_000, 10_000_000, 0, 0, 0, 0, 0, 0, 0))
    wire(common.MAVLink_attitude_message(49_900, 2.0, 0, 0, 0, 0, 0))
    wire(common.MAVLink_global_position_int_message(46_800, 20_000_000, 0, 0, 0, 0, 0, 0, 0))
    assert wire.vehicle.attitude[0] == 1.0
    assert wire.vehicle.global_position.latitude == 1.0


@pytest.mark.parametrize("behind", [2, 40, 100, 127, 200])
def test_late_copies_of_unstamped_messages_change_nothing(behind):
    """Copies of a standing vehicle's messages, as many packets late as a radio's buffer holds."""
    wire = Wire()
    wire(heartbeat(custom_mode=4 << 16))
    old = [
        message.pack(wire._mav)
        for message in (
            heartbeat(custom_mode=4 << 16),
            current_mode(4 << 16),
            common.MAVLink_extended_sys_state_message(0, 1),
            common.MAVLink_gps_raw_int_message(0, 1, 0, 0, 0, 0, 0, 0, 0, 3),
        )
    ]
    for k in range(behind):
        wire(heartbeat(armed=True, custom_mode=6 << 16), 0.01 * k)
        wire(common.MAVLink_extended_sys_state_message(0, 2), 0.01 * k)
        wire(common.MAVLink_gps_raw_int_message(0, 3, 0, 0, 0, 0, 0, 0, 0, 9), 0.01 * k)
    for data in old:
        (packet,) = Decoder().feed(data)
        wire.vehicle.receive(packet, 0.01 * behind)
    assert wire.vehicle.take_events() == []
    v = wire.vehicle
    assert (v.armed, v.mode, v.landed_state, v.fix_type) == (True, "offboard", 2, 3)


def test_a_late_copy_of_an_answer_does_not_acknowledge_the_next_command():
    wire = Wire()
    wire(heartbeat())
    wire.vehicle.grip(closed=True)
    wire.vehicle.tick(0.0)
    (copy,) = Decoder().feed(common.MAVLink_command_ack_message(211, 0).pack(wire._mav))
    assert wire(common.MAVLink_command_ack_message(211, 0), 0.1) == []
    wire.vehicle.tick(0.2)
    for k in range(30):
        wire(heartbeat(), 0.2 + 0.1 * k)
    wire.vehicle.take_events()
    wire.vehicle.grip(closed=False)
    wire.vehicle.tick(3.3)
    wire.vehicle.receive(copy, 3.4)
    wire.vehicle.tick(3.5)
    assert wire.vehicle.commands.contains("release")


def test_an_origin_that_is_repeated_is_believed_where_packets_are_missing():
    """It is requested once a second: on a lossy link a flight must not wait for a lucky one."""
    wire = Wire()
    wire(heartbeat())
    for known in (False, True):
        wire.lose(1)
        wire(common.MAVLink_gps_global_origin_message(470_000_000, 85_000_000, 400_000, 0))
        assert (wire.vehicle.origin is not None) == known


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
    for delay, late, sent in ((0.4, 0.1, 100.0), (0.02, 0.01, 102.0), (0.3, 0.0, 104.0)):
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


@pytest.mark.parametrize("climb", [-0.45, 0.3, 0.45])
@pytest.mark.parametrize("age", [0.0, 0.1, 0.25])
def test_the_satellite_height_is_compared_with_the_height_of_its_own_time(climb, age):
    wire = Wire()
    wire(heartbeat())
    wire(common.MAVLink_gps_global_origin_message(0, 0, 100_000))
    wire(common.MAVLink_local_position_ned_message(0, 0, 0, -5.0, 0, 0, -climb), 0.0)
    millimetres = round(1000 * (105.4 + climb * age))
    wire(common.MAVLink_gps_raw_int_message(0, 3, 0, 0, millimetres, 90, 178, 0, 0, 10), age)
    assert wire.vehicle.height_difference == pytest.approx(0.4, abs=1e-3)


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
