"""Requests to any autopilot: parameters, rates, missions, logs, files, time, keys."""

import hashlib

import numpy as np
import pytest
from pymavlink.dialects.v20 import common as dialect

from sitl import Emulator
from tests.sitl.client import Ground, world

COMPONENT_METADATA, AVAILABLE_MODES = 397, 435

INTERVAL, REQUEST = dialect.MAV_CMD_SET_MESSAGE_INTERVAL, dialect.MAV_CMD_REQUEST_MESSAGE
ACCEPTED, DENIED, UNSUPPORTED, FAILED = 0, 2, 3, 4


@pytest.fixture
def ground() -> Ground:
    started = Ground(Emulator(world(1)), quiet=False)
    started.run(1.1)
    return started


def count(ground: Ground, name: str, since: float) -> int:
    return sum(1 for t, _, m in ground.log if t > since and m.get_type() == name)


def test_heartbeat_identifies_the_autopilot(ground: Ground) -> None:
    beat = ground.last[1, "HEARTBEAT"]
    assert (beat.type, beat.autopilot, beat.system_status) == (2, 12, 3)
    before = ground.now
    ground.run(10.0)
    assert count(ground, "HEARTBEAT", before) == 10


def test_rates_equal_the_requested_ones(ground: Ground) -> None:
    for rate in (50, 10, 4):
        ground.command(1, INTERVAL, 32, 1e6 / rate)
        before = ground.now
        ground.run(4.0)
        assert count(ground, "LOCAL_POSITION_NED", before) == pytest.approx(4 * rate, abs=2)
    ground.command(1, INTERVAL, 32, -1)
    before = ground.now
    ground.run(2.0)
    assert count(ground, "LOCAL_POSITION_NED", before) == 0
    ground.command(1, INTERVAL, 32, 0)
    before = ground.now
    ground.run(2.0)
    assert count(ground, "LOCAL_POSITION_NED", before) == pytest.approx(60, abs=2), "PX4's default"
    ground.command(1, INTERVAL, 12345, 1e5)
    ground.run(0.1)
    assert ground.acks(1, INTERVAL)[-1] == FAILED


def test_px4_sends_heartbeats_once_a_second_and_its_mode_after_a_change(ground: Ground) -> None:
    ground.command(1, INTERVAL, 0, 250_000)
    ground.command(1, INTERVAL, 436, 250_000)
    before = ground.now
    ground.run(4.0)
    assert ground.acks(1, INTERVAL)[-2:] == [FAILED, ACCEPTED]
    assert count(ground, "HEARTBEAT", before) == 4
    ground.command(1, dialect.MAV_CMD_DO_SET_MODE, 1, 6, 0)
    before = ground.now
    ground.run(0.3)
    modes = [m for t, _, m in ground.log if t > before and m.get_type() == "UNKNOWN_436"]
    assert bytes(modes[-1].get_msgbuf())[10:14] == (6 << 16).to_bytes(4, "little")


@pytest.mark.parametrize(
    "name",
    ["AUTOPILOT_VERSION", "HOME_POSITION", "GPS_GLOBAL_ORIGIN", "SYS_STATUS", "EXTENDED_SYS_STATE",
     "BATTERY_STATUS", "ESTIMATOR_STATUS", "GPS_RAW_INT", "ALTITUDE", "ODOMETRY", "SYSTEM_TIME"],
)  # fmt: skip
def test_single_messages_on_request(ground: Ground, name: str) -> None:
    ground.log.clear()
    ground.command(1, REQUEST, getattr(dialect, f"MAVLINK_MSG_ID_{name}"))
    ground.run(0.05)
    assert name in {message.get_type() for _, _, message in ground.log}
    assert ground.acks(1, REQUEST) == [ACCEPTED]


def test_unknown_requests_are_answered(ground: Ground) -> None:
    ground.command(1, REQUEST, 9999)
    ground.command(1, 31000)
    ground.run(0.1)
    assert ground.acks(1, REQUEST) == [DENIED]
    assert ground.acks(1, 31000) == [UNSUPPORTED]


def test_all_parameters_arrive_within_a_second(ground: Ground) -> None:
    ground.send(1, dialect.MAVLink_param_request_list_message(1, 1))
    ground.run(1.0)
    hashed, *values = [m for _, _, m in ground.log if m.get_type() == "PARAM_VALUE"]
    assert (hashed.param_id, hashed.param_index) == ("_HASH_CHECK", 65535)
    assert len(values) == values[0].param_count == len({m.param_index for m in values})
    by_name = {m.param_id: m for m in values}
    assert by_name["COM_OF_LOSS_T"].param_value == pytest.approx(1.0)
    negative = by_name["COM_FLTMODE1"]
    assert negative.param_type == dialect.MAV_PARAM_TYPE_INT32
    assert np.array([negative.param_value], "<f4").view("<i4")[0] == -1, "PX4 sends bytes"


def test_a_parameter_is_set_and_read(ground: Ground) -> None:
    bits = float(np.array([5], "<i4").view("<f4")[0])
    ground.send(1, dialect.MAVLink_param_set_message(1, 1, b"COM_OBL_RC_ACT", bits, 6))
    ground.run(0.1)
    ground.log.clear()
    ground.send(1, dialect.MAVLink_param_request_read_message(1, 1, b"COM_OBL_RC_ACT", -1))
    ground.run(0.1)
    (answer,) = [m for _, _, m in ground.log if m.get_type() == "PARAM_VALUE"]
    assert np.array([answer.param_value], "<f4").view("<i4")[0] == 5
    ground.log.clear()
    ground.send(1, dialect.MAVLink_param_request_read_message(1, 1, b"NO_SUCH", -1))
    ground.send(1, dialect.MAVLink_param_set_message(1, 1, b"NO_SUCH", 1.0, 9))
    ground.run(0.1)
    assert not [m for _, _, m in ground.log if m.get_type() == "PARAM_VALUE"]


def test_a_mission_is_uploaded_and_read_back(ground: Ground) -> None:
    for seq in range(3):
        if seq == 0:
            ground.send(1, dialect.MAVLink_mission_count_message(1, 1, 3))
        ground.run(0.1)
        assert ground.last[1, "MISSION_REQUEST_INT"].seq == seq
        ground.send(
            1,
            dialect.MAVLink_mission_item_int_message(
                1, 1, seq, 6, 16, 0, 1, 0, 0, 0, 0, 473977420 + seq, 85455940, 10.0 + seq
            ),
        )
    ground.run(0.1)
    assert ground.last[1, "MISSION_ACK"].type == dialect.MAV_MISSION_ACCEPTED
    ground.send(1, dialect.MAVLink_mission_request_list_message(1, 1))
    ground.run(0.1)
    assert ground.last[1, "MISSION_COUNT"].count == 3
    ground.send(1, dialect.MAVLink_mission_request_int_message(1, 1, 2))
    ground.run(0.1)
    item = ground.last[1, "MISSION_ITEM_INT"]
    assert (item.seq, item.x, item.z) == (2, 473977422, 12.0)
    ground.send(1, dialect.MAVLink_mission_clear_all_message(1, 1))
    ground.send(1, dialect.MAVLink_mission_request_list_message(1, 1))
    ground.run(0.1)
    assert ground.last[1, "MISSION_COUNT"].count == 0


def test_file_transfer_is_refused_and_the_log_list_is_empty(ground: Ground) -> None:
    request = [7, 0, 3, 4, 0, 0] + [0] * 245
    ground.send(1, dialect.MAVLink_file_transfer_protocol_message(0, 1, 1, request))
    ground.send(1, dialect.MAVLink_log_request_list_message(1, 1, 0, 0xFFFF))
    ground.run(0.1)
    answer = ground.last[1, "FILE_TRANSFER_PROTOCOL"].payload
    assert (answer[0], answer[3], answer[5]) == (8, 129, 4), "NAK of opcode 4 with the next number"
    assert ground.last[1, "LOG_ENTRY"].num_logs == 0


def test_timesync_returns_the_vehicles_clock() -> None:
    ground = Ground(Emulator(world(2, biases="default")))
    ground.run(1.0)
    for vehicle in (1, 2):
        ground.send(vehicle, dialect.MAVLink_timesync_message(0, 123456789))
    ground.run(0.1)
    answers = [
        message
        for vehicle in (1, 2)
        for _, system, message in ground.log
        if system == vehicle and message.get_type() == "TIMESYNC" and message.tc1
    ]
    assert [answer.ts1 for answer in answers] == [123456789] * 2
    boots = [answer.tc1 * 1e-9 - 1.0 for answer in answers]
    assert abs(boots[0] - boots[1]) > 0.1, "clocks of their own"
    for vehicle, boot in zip((1, 2), boots, strict=True):
        assert ground.last[vehicle, "ATTITUDE"].time_boot_ms * 1e-3 == pytest.approx(
            boot + ground.now, abs=0.1
        )


def test_commands_to_other_systems_are_ignored(ground: Ground) -> None:
    message = dialect.MAVLink_command_long_message(2, 1, 400, 0, 1, 0, 0, 0, 0, 0, 0)
    ground.send(1, message)
    ground.run(0.1)
    assert not ground.acks(1, 400)
    assert not ground.emulator.truth().armed[0]


def test_local_and_global_position_agree_through_the_origin() -> None:
    ground = Ground(Emulator(world(3, biases="default", seed=4)))
    ground.run(2.5)
    origins = set()
    for vehicle in (1, 2, 3):
        local = ground.last[vehicle, "LOCAL_POSITION_NED"]
        place = ground.last[vehicle, "GLOBAL_POSITION_INT"]
        origin = ground.last[vehicle, "GPS_GLOBAL_ORIGIN"]
        north = (place.lat - origin.latitude) * 1e-7 * 111_172.0
        assert north == pytest.approx(local.x, abs=0.05)
        assert (place.alt - origin.altitude) * 1e-3 == pytest.approx(-local.z, abs=0.03)
        origins.add((origin.latitude, origin.longitude, origin.altitude))
    assert len(origins) == 3


@pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
def test_the_projection_of_each_autopilot_scales_local_metres(autopilot: str) -> None:
    """A hundred true metres east at 47° are fewer local metres on PX4's sphere and in ArduPilot."""
    keys = {"autopilot": autopilot, "biases": "none", "projection": "autopilot"}
    emulator = Emulator(world(1, **keys))
    ground = Ground(emulator)
    emulator.by_id[1].move_origin((-100.0, -100.0, 0.6))
    ground.run(0.5)
    ground.command(1, REQUEST, 32)
    ground.run(0.1)
    local = ground.last[1, "LOCAL_POSITION_NED"]
    sphere = 6_371_000.0
    north, east = (sphere / 6_370_600.0, sphere / 6_390_200.0)
    if autopilot == "ardupilot":
        degree = 111_318.845 * 180 / np.pi
        north, east = degree / 6_370_600.0, degree / 6_390_200.0
    assert local.x == pytest.approx(100 * north, abs=0.01)
    assert local.y == pytest.approx(100 * east, abs=0.01)


def test_signing_is_required_and_applied_after_setup() -> None:
    ground = Ground(Emulator(world(1)))
    ground.run(1.0)
    key = hashlib.sha256(b"a shared secret").digest()
    ground.send(1, dialect.MAVLink_setup_signing_message(1, 1, list(key), 0))
    ground.run(0.2)
    link = ground.emulator.by_id[1].links[0]
    assert link.receiver.key == key
    ground.command(1, 400, 1)
    ground.run(0.2)
    assert not ground.emulator.truth().armed[0], "unsigned when keyed: not heard"
    mav = ground.mav[1]
    mav.signing.secret_key = key
    mav.signing.sign_outgoing = True
    mav.signing.timestamp = (1_800_000_000 - 1_420_070_400) * 100_000
    ground.command(1, 400, 1)
    before = len(ground.log)
    ground.run(1.0)
    assert ground.emulator.truth().armed[0]
    types = {message.get_type() for _, _, message in ground.log[before:]}
    assert "HEARTBEAT" in types
    assert "BAD_DATA" not in types, "telemetry is signed with the same key"
    replayed = dialect.MAVLink_command_long_message(1, 1, 400, 0, 0, 0, 0, 0, 0, 0, 0)
    mav.signing.timestamp -= 100_000 * 3600
    ground.send(1, replayed)
    ground.run(0.2)
    assert ground.emulator.truth().armed[0], "an old timestamp is a replay"


def test_indoors_the_position_follows_vision() -> None:
    ground = Ground(Emulator(world(1, indoor=True)))
    ground.run(2.0)
    assert (1, "GLOBAL_POSITION_INT") not in ground.last
    assert (1, "GPS_GLOBAL_ORIGIN") not in ground.last
    assert ground.last[1, "LOCAL_POSITION_NED"].z == pytest.approx(-0.6, abs=0.02), "shared frame"
    ground.send(1, dialect.MAVLink_vision_position_estimate_message(0, 0.3, 0.2, -0.6, 0, 0, 0))
    ground.run(0.5)
    local = ground.last[1, "LOCAL_POSITION_NED"]
    assert (local.x, local.y) == pytest.approx((0.3, 0.2), abs=0.01)


def test_the_same_seed_and_bytes_give_the_same_flight() -> None:
    def fly(seed: int) -> list[bytes]:
        emulator = Emulator(world(2, biases="default", seed=seed, wind="{gust: 1.0}"))
        ground = Ground(emulator)
        ground.px4_offboard({1: (0.0, 0.0, 3.0), 2: (3.0, 0.0, 3.0)}, 5.0)
        return [message.get_msgbuf() for _, _, message in ground.log]

    assert fly(1) == fly(1)
    assert fly(1) != fly(2)


def test_ardupilots_estimator_report_matches_its_dialect() -> None:
    from pymavlink.dialects.v20 import ardupilotmega

    ground = Ground(Emulator(world(2, autopilots=["ardupilot", "px4"])))
    ground.mav[1] = ardupilotmega.MAVLink(None, 255, 190)
    ground.run(0.2)
    for vehicle in (1, 2):
        ground.command(vehicle, dialect.MAV_CMD_SET_MESSAGE_INTERVAL, 193, 1e5)
    ground.run(0.5)
    assert [ground.acks(vehicle, 511) for vehicle in (1, 2)] == [[ACCEPTED], [FAILED]]
    report = ground.last[1, "EKF_STATUS_REPORT"]
    assert report.flags == 1 | 2 | 4 | 8 | 16 | 32 | 256 | 512
    assert report.velocity_variance == pytest.approx(0.05)


@pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
def test_the_first_requests_of_qgroundcontrol_are_answered(autopilot: str) -> None:
    """In the order of its InitialConnectStateMachine.cc; each answer arrives within 0.5 s."""
    ground = Ground(Emulator(world(1, autopilot=autopilot)), quiet=False)
    ground.run(1.2)
    assert ground.last[1, "HEARTBEAT"].type == dialect.MAV_TYPE_QUADROTOR
    requests = (
        (dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION, {0}),
        (AVAILABLE_MODES, {DENIED, FAILED}),
        (COMPONENT_METADATA, {ACCEPTED} if autopilot == "px4" else {FAILED}),
    )
    for number, answers in requests:
        ground.log.clear()
        ground.command(1, dialect.MAV_CMD_REQUEST_MESSAGE, number)
        ground.run(0.5)
        assert set(ground.acks(1, dialect.MAV_CMD_REQUEST_MESSAGE)) <= answers
        assert ground.acks(1, dialect.MAV_CMD_REQUEST_MESSAGE)
    able = ground.last[1, "AUTOPILOT_VERSION"].capabilities
    assert able & dialect.MAV_PROTOCOL_CAPABILITY_MISSION_INT
    assert able & dialect.MAV_PROTOCOL_CAPABILITY_MISSION_FENCE
    bytewise = able & dialect.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE
    assert bool(bytewise) == (autopilot == "px4")
    ground.send(1, dialect.MAVLink_file_transfer_protocol_message(0, 1, 1, [0] * 251))
    ground.run(0.5)
    assert ground.last[1, "FILE_TRANSFER_PROTOCOL"].payload[3] == 129
    ground.send(1, dialect.MAVLink_param_request_list_message(1, 1))
    ground.run(1.0)
    values = [m for _, _, m in ground.log if m.get_type() == "PARAM_VALUE"]
    assert len({m.param_index for m in values} - {65535}) == values[0].param_count
    for kind in (0, 1, 2):
        ground.send(1, dialect.MAVLink_mission_request_list_message(1, 1, kind))
        ground.run(0.5)
        count = ground.last[1, "MISSION_COUNT"]
        assert (count.count, count.mission_type) == (0, kind)
    if autopilot == "ardupilot":
        ground.send(1, dialect.MAVLink_request_data_stream_message(1, 1, 0, 4, 1))
        ground.command(1, 512, dialect.MAVLINK_MSG_ID_HOME_POSITION)
        ground.command(1, 511, dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE, 1e6)
    ground.run(2.5)
    shown = {kind for _, kind in ground.last}
    assert {
        "SYS_STATUS", "EXTENDED_SYS_STATE", "HOME_POSITION", "GPS_RAW_INT", "GLOBAL_POSITION_INT",
        "ATTITUDE", "VFR_HUD", "BATTERY_STATUS",
    } <= shown  # fmt: skip


@pytest.mark.parametrize("frame", [5, 6])
def test_setpoints_in_degrees_reach_the_same_position(frame: int) -> None:
    ground = Ground(Emulator(world(1)))
    emulator = ground.emulator
    geodesy = emulator.environment.geodesy
    latitude, longitude, _ = geodesy.degrees(3.0, 4.0, 0.0)
    altitude = 5.6 - 0.6 if frame == 6 else geodesy.altitude + 5.6
    ground.px4_offboard({1: (0.0, 0.0, 5.0)}, 6.0)
    for _ in range(120):
        message = dialect.MAVLink_set_position_target_global_int_message(
            0, 1, 1, frame, 3576, round(latitude * 1e7), round(longitude * 1e7), altitude,
            *[0.0] * 6, 0.0, 0.0,
        )  # fmt: skip
        ground.send(1, message)
        ground.run(0.1)
    assert emulator.truth().position[0] == pytest.approx([3.0, 4.0, 5.0], abs=0.1)


def test_a_gap_of_vision_ends_the_position_until_it_returns() -> None:
    ground = Ground(Emulator(world(1, indoor=True)))
    message = dialect.MAVLink_vision_position_estimate_message(0, 0.0, 0.0, -0.6, 0, 0, 0)
    for _ in range(10):
        ground.send(1, message)
        ground.run(0.1)
    vehicle = ground.emulator.vehicles[0]
    assert vehicle.local_valid
    ground.run(2.0)
    assert not vehicle.local_valid
    ground.command(1, 400, 1)
    ground.run(0.2)
    assert ground.acks(1, 400) == [1], "no arming without a position"
    ground.send(1, message)
    ground.run(0.2)
    assert vehicle.local_valid
