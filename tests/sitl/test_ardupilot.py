"""ArduCopter's rules from its documentation and source, over MAVLink bytes."""

import math

import numpy as np
import pytest
from pymavlink.dialects.v20 import common as dialect

from sitl import Emulator
from tests.sitl.client import Ground, world

ARM, MODE = dialect.MAV_CMD_COMPONENT_ARM_DISARM, dialect.MAV_CMD_DO_SET_MODE
TAKEOFF, INTERVAL = dialect.MAV_CMD_NAV_TAKEOFF, dialect.MAV_CMD_SET_MESSAGE_INTERVAL
ACCEPTED, FAILED = 0, 4
STABILIZE, GUIDED, LOITER, RTL, LAND = 0, 4, 5, 6, 9


def copter(**keys) -> Ground:
    ground = Ground(Emulator(world(1, autopilot="ardupilot", **keys)))
    ground.run(1.1)
    return ground


def guided(ground: Ground) -> None:
    ground.command(1, MODE, 1, GUIDED)
    ground.run(0.2)
    ground.command(1, ARM, 1)
    ground.run(0.2)


def flying(height: float = 3.0) -> Ground:
    ground = copter()
    guided(ground)
    ground.command(1, TAKEOFF, 0, 0, 0, 0, 0, 0, height)
    ground.run(8.0)
    return ground


def set_parameter(ground: Ground, name: str, value: float) -> None:
    ground.send(1, dialect.MAVLink_param_set_message(1, 1, name.encode(), value, 9))


def test_streams_must_be_requested() -> None:
    ground = copter()
    ground.run(2.0)
    assert {message.get_type() for _, _, message in ground.log} <= {"HEARTBEAT", "TIMESYNC"}
    ground.command(1, INTERVAL, 32, 100_000)
    before = ground.now
    ground.run(2.0)
    got = [t for t, _, m in ground.log if t > before and m.get_type() == "LOCAL_POSITION_NED"]
    assert len(got) == pytest.approx(20, abs=1)
    ground.send(1, dialect.MAVLink_request_data_stream_message(1, 1, 0, 4, 1))
    ground.run(1.0)
    assert {"ATTITUDE", "SYS_STATUS", "GLOBAL_POSITION_INT", "VFR_HUD"} <= {
        message.get_type() for _, _, message in ground.log
    }


def test_boot_mode_is_stabilize_and_a_mode_change_gets_one_ack() -> None:
    ground = copter()
    assert ground.mode(1) == STABILIZE
    ground.command(1, MODE, 1, GUIDED)
    ground.run(1.1)
    assert ground.acks(1, MODE) == [ACCEPTED]
    assert ground.mode(1) == GUIDED


def test_take_off_requires_guided_and_armed() -> None:
    ground = copter()
    ground.command(1, TAKEOFF, 0, 0, 0, 0, 0, 0, 3)
    ground.command(1, MODE, 1, GUIDED)
    ground.command(1, TAKEOFF, 0, 0, 0, 0, 0, 0, 3)
    ground.run(0.2)
    assert ground.acks(1, TAKEOFF) == [FAILED, FAILED]
    ground.command(1, ARM, 1)
    ground.command(1, TAKEOFF, 0, 0, 0, 0, 0, 0, 3)
    ground.run(8.0)
    assert ground.acks(1, TAKEOFF)[-1] == ACCEPTED
    assert ground.emulator.truth().position[0, 2] == pytest.approx(3.0, abs=0.15)


def test_setpoints_alone_do_not_start_a_take_off() -> None:
    ground = copter()
    guided(ground)
    ground.run(5.0, ground.toward({1: (0.0, 0.0, 3.0)}))
    assert ground.emulator.truth().position[0, 2] < 0.01


@pytest.mark.parametrize(("wait", "lifts"), [(0.1, False), (4.0, True)])
def test_an_early_setpoint_cancels_a_take_off_without_a_message(wait: float, lifts: bool) -> None:
    ground = copter()
    guided(ground)
    ground.command(1, TAKEOFF, 0, 0, 0, 0, 0, 0, 3)
    ground.run(wait)
    ground.run(6.0, ground.toward({1: (0.0, 0.0, 3.6)}))
    assert (ground.emulator.truth().position[0, 2] > 2.0) == lifts
    assert {text for text in ground.texts(1) if "EKF3" not in text} == {"Arming motors"}


def test_an_idle_armed_vehicle_disarms_after_ten_seconds() -> None:
    ground = copter()
    guided(ground)
    ground.run(9.0)
    assert ground.armed(1)
    ground.run(2.2)
    assert not ground.armed(1)


def test_arming_is_refused_in_return_and_land() -> None:
    ground = copter()
    ground.command(1, MODE, 1, RTL)
    ground.command(1, ARM, 1)
    ground.run(0.2)
    assert ground.acks(1, ARM) == [FAILED]
    assert ground.texts(1)[-1] == "Arm: RTL mode not armable"


def test_motion_continues_for_GUID_TIMEOUT_after_the_last_setpoint() -> None:
    ground = flying()
    origin = ground.origin(1)
    start = ground.now

    def eastward(_: int, now: float) -> tuple[float, ...]:
        return (-origin[1], now - start - origin[0], -(3.6 - origin[2]), 0.0, 1.0, 0.0)

    ground.run(4.0, eastward)
    there = ground.emulator.truth().position[0, 0]
    assert there == pytest.approx(4.0, abs=0.2)
    texts = len(ground.texts(1))
    ground.run(6.0)
    assert ground.mode(1) == GUIDED
    assert len(ground.texts(1)) == texts
    truth = ground.emulator.truth()
    assert truth.position[0, 0] - there == pytest.approx(3.0, abs=0.3)
    assert np.linalg.norm(truth.velocity[0]) < 0.1


def test_position_and_acceleration_without_velocity_select_velocity_control() -> None:
    ground = flying()
    ground.command(1, INTERVAL, 85, 100_000)
    for _ in range(20):
        ground.setpoint(1, (5.0, 5.0, -5.0), mask=3072 | 56)
        ground.run(0.1)
    assert ground.last[1, "POSITION_TARGET_LOCAL_NED"].type_mask & 0x1FF == 7
    assert np.hypot(*ground.emulator.truth().position[0, :2]) < 0.3, "it does not go there"
    for _ in range(80):
        ground.setpoint(1, (1.0, 1.0, -4.0), mask=3072)
        ground.run(0.1)
    assert ground.last[1, "POSITION_TARGET_LOCAL_NED"].type_mask & 0x1FF == 0
    assert np.hypot(*(ground.emulator.truth().position[0, :2] - 1.0)) < 0.2


def test_offset_frames_are_accepted() -> None:
    ground = flying()
    ground.send(
        1,
        dialect.MAVLink_set_position_target_local_ned_message(
            0, 1, 1, dialect.MAV_FRAME_LOCAL_OFFSET_NED, 3576, 2.0, 0.0, 0.0, *[0.0] * 8
        ),
    )
    ground.run(6.0)
    assert ground.emulator.truth().position[0, 1] == pytest.approx(2.0, abs=0.2)


def test_ground_station_loss_is_off_by_default_and_5_lands() -> None:
    ground = flying()
    ground.run(12.0, heartbeat=False)
    assert ground.mode(1) == GUIDED
    ground.run(2.0)
    set_parameter(ground, "FS_GCS_ENABLE", 5)
    ground.run(7.5, heartbeat=False)
    assert ground.mode(1) == LAND
    assert "GCS Failsafe" in ground.texts(1)
    ground.run(12.0, heartbeat=False)
    assert not ground.armed(1)


def test_only_heartbeats_of_SYSID_MYGCS_prevent_the_failsafe() -> None:
    ground = flying()
    set_parameter(ground, "FS_GCS_ENABLE", 5)
    ground.run(1.0)
    for _ in range(8):
        other = dialect.MAVLink(None, 42, 190)
        beat = dialect.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)
        ground.emulator.receive(1, beat.pack(other), ground.now)
        ground.run(1.0, heartbeat=False)
    assert ground.mode(1) == LAND


def test_return_climbs_flies_home_and_lands() -> None:
    ground = flying()
    ground.run(8.0, ground.toward({1: (5.0, 0.0, 4.0)}))
    ground.command(1, MODE, 1, RTL)
    ground.run(12.0)
    assert ground.emulator.truth().position[0, 2] > 10.0
    ground.run(50.0)
    assert np.abs(ground.emulator.truth().position[0]).max() < 0.5
    assert not ground.armed(1)


def test_the_position_is_valid_forty_seconds_after_a_reboot() -> None:
    ground = copter()
    ground.command(1, MODE, 1, GUIDED)
    ground.command(1, dialect.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 1)
    ground.run(30.0)
    boot = ground.last[1, "HEARTBEAT"]
    assert boot.custom_mode == STABILIZE
    ground.command(1, MODE, 1, GUIDED)
    ground.command(1, ARM, 1)
    ground.run(0.2)
    assert ground.acks(1, ARM) == [FAILED]
    assert ground.texts(1)[-1] == "PreArm: Need Position Estimate"
    ground.run(14.0)
    ground.command(1, ARM, 1)
    ground.run(0.2)
    assert ground.acks(1, ARM)[-1] == ACCEPTED


def test_parameters_are_sent_as_numbers() -> None:
    ground = copter()
    set_parameter(ground, "FS_GCS_ENABLE", 5.0)
    ground.run(0.1)
    assert ground.last[1, "PARAM_VALUE"].param_value == 5.0
    set_parameter(ground, "FS_GCS_ENABLE", math.nan)
    ground.run(0.1)
    assert ground.last[1, "PARAM_VALUE"].param_value == 5.0


@pytest.mark.parametrize("action", [0, 1])
def test_a_low_battery_acts_after_its_timer(action: int) -> None:
    """Three cells, 10.5 V, for BATT_LOW_TIMER (10 s); BATT_FS_LOW_ACT 0 warns, 1 lands."""
    ground = flying()
    ground.send(
        1,
        dialect.MAVLink_param_set_message(
            1, 1, b"BATT_FS_LOW_ACT", action, dialect.MAV_PARAM_TYPE_INT8
        ),
    )
    ground.send(
        1,
        dialect.MAVLink_param_set_message(
            1, 1, b"SIM_BATT_VOLTAGE", 10.2, dialect.MAV_PARAM_TYPE_REAL32
        ),
    )
    ground.send(
        1,
        dialect.MAVLink_param_set_message(
            1, 1, b"BATT_CAPACITY", 3000.0, dialect.MAV_PARAM_TYPE_INT32
        ),
    )
    ground.run(8.0)
    assert not [text for text in ground.texts(1) if "Battery 1 is low" in text]
    ground.run(4.0)
    (text,) = [text for text in ground.texts(1) if "Battery 1 is low" in text]
    assert 0.0 <= float(text.split()[-2]) <= 3000.0, text
    assert ground.mode(1) == (9 if action else 4)
