"""PX4's rules from its documentation and source, over MAVLink bytes."""

import math

import numpy as np
import pytest
from pymavlink.dialects.v20 import common as dialect

from sitl import Emulator
from tests.sitl.client import Ground, world

ARM, MODE = dialect.MAV_CMD_COMPONENT_ARM_DISARM, dialect.MAV_CMD_DO_SET_MODE
ACCEPTED, TEMPORARILY_REJECTED, DENIED = 0, 1, 2
OFFBOARD, HOLD, LAND, RETURN = 6 << 16, 4 << 16 | 3 << 24, 4 << 16 | 6 << 24, 4 << 16 | 5 << 24


def flying(places=None, **keys) -> Ground:
    ground = Ground(Emulator(world(1, **keys)))
    ground.px4_offboard(places or {1: (0.0, 0.0, 3.0)}, 8.0)
    assert ground.mode(1) == OFFBOARD
    return ground


def set_parameter(ground: Ground, name: str, value: float | int) -> None:
    raw = np.array([value], "<i4" if isinstance(value, int) else "<f4")
    ground.send(
        1,
        dialect.MAVLink_param_set_message(
            1, 1, name.encode(), float(raw.view("<f4")[0]), 6 if isinstance(value, int) else 9
        ),
    )


def test_arming_in_offboard_requires_the_stream() -> None:
    ground = Ground(Emulator(world(1)))
    ground.run(1.0)
    ground.command(1, MODE, 1, 6, 0)
    ground.run(1.1)
    assert ground.acks(1, MODE) == [ACCEPTED, ACCEPTED], "disarmed, any mode is taken; two ACKs"
    assert ground.mode(1) == OFFBOARD
    ground.command(1, ARM, 1)
    ground.run(0.2)
    assert ground.acks(1, ARM) == [TEMPORARILY_REJECTED]
    assert ground.texts(1)[-1] == "Arming denied: Resolve system health failures first\t"
    ground.run(0.5, ground.toward({1: (0, 0, 3)}))
    ground.command(1, ARM, 1)
    ground.run(1.2, ground.toward({1: (0, 0, 3)}))
    assert ground.acks(1, ARM)[-1] == ACCEPTED
    assert ground.armed(1)


def test_offboard_is_refused_in_flight_without_a_stream() -> None:
    ground = flying()
    ground.command(1, MODE, 1, 4, 3)
    ground.run(2.0)
    assert ground.mode(1) == HOLD
    ground.command(1, MODE, 1, 6, 0)
    ground.run(1.2)
    assert ground.acks(1, MODE)[-1] == TEMPORARILY_REJECTED
    assert ground.mode(1) == HOLD
    assert "Switching to mode 'Offboard' is currently not possible\t" in ground.texts(1)


def test_setpoints_alone_start_a_take_off() -> None:
    ground = flying({1: (1.0, 2.0, 3.0)})
    place = ground.emulator.truth().position[0]
    assert place == pytest.approx([1.0, 2.0, 2.4], abs=0.1), "grip point 0.6 m below the centre"
    assert ground.last[1, "EXTENDED_SYS_STATE"].landed_state == 2


@pytest.mark.parametrize(
    ("action", "mode"), [(0, LAND), (3, RETURN), (4, LAND), (5, HOLD)], ids=str
)
def test_reactions_to_stream_loss(action: int, mode: int) -> None:
    ground = flying()
    set_parameter(ground, "COM_OBL_RC_ACT", action)
    ground.run(0.5, ground.toward({1: (0, 0, 3)}))
    stopped = ground.now
    ground.run(3.0)
    change = next(
        event
        for event in ground.emulator.events
        if event["kind"] == "mode" and event["time"] > stopped
    )
    assert change["failsafe"]
    assert change["time"] - stopped == pytest.approx(1.0, abs=0.06), "COM_OF_LOSS_T"
    assert ground.mode(1) == mode
    assert ground.last[1, "HEARTBEAT"].system_status == dialect.MAV_STATE_CRITICAL
    if action == 0:
        assert change["mode"] == "DESCEND", "blind: no pilot, no position control"


def test_hold_without_a_global_position_lands() -> None:
    ground = flying(indoor=True)
    set_parameter(ground, "COM_OBL_RC_ACT", 5)
    ground.run(0.5, ground.toward({1: (0, 0, 3)}))
    ground.run(2.5)
    assert ground.mode(1) == LAND


def test_offboard_resumes_when_setpoints_return() -> None:
    ground = flying()
    set_parameter(ground, "COM_OBL_RC_ACT", 4)
    ground.run(2.5)
    assert ground.mode(1) == LAND
    ground.run(6.0, ground.toward({1: (0, 0, 3)}))
    assert ground.mode(1) == OFFBOARD
    assert ground.emulator.truth().position[0, 2] == pytest.approx(2.4, abs=0.1)


def test_motion_continues_until_the_failsafe() -> None:
    """Position and velocity stay valid for COM_OF_LOSS_T: the vehicle moves to their balance."""
    ground = flying()
    origin = ground.origin(1)

    def eastward(_: int, now: float) -> tuple[float, ...]:
        return (-origin[1], -origin[0] + (now - start), -(3.0 - origin[2]), 0.0, 1.0, 0.0)

    start = ground.now
    ground.run(4.0, eastward)
    there = ground.emulator.truth().position[0, 0]
    assert there == pytest.approx(4.0, abs=0.15)
    ground.run(1.0)
    assert 0.6 < ground.emulator.truth().position[0, 0] - there < 1.05


def test_after_landing_px4_disarms_and_restores_the_mode() -> None:
    ground = flying()
    ground.command(1, MODE, 1, 4, 6)
    ground.run(10.0)
    kinds = [event["kind"] for event in ground.emulator.events]
    assert kinds[-3:] == ["landed", "disarmed", "mode"]
    landed, disarmed = ground.emulator.events[-3]["time"], ground.emulator.events[-2]["time"]
    assert disarmed - landed == pytest.approx(2.0, abs=0.1), "COM_DISARM_LAND"
    assert not ground.armed(1)
    assert ground.mode(1) == OFFBOARD
    assert not ground.last[1, "SYS_STATUS"].onboard_control_sensors_health & 1 << 28


def test_an_armed_vehicle_on_the_ground_disarms() -> None:
    ground = Ground(Emulator(world(1)))
    ground.run(1.0)
    ground.command(1, ARM, 1)
    ground.run(9.5)
    assert ground.armed(1)
    ground.run(1.7)
    assert not ground.armed(1)


def test_disarming_in_flight_requires_the_magic_number() -> None:
    ground = flying()
    ground.command(1, ARM, 0)
    ground.run(0.2, ground.toward({1: (0, 0, 3)}))
    assert ground.acks(1, ARM)[-1] == TEMPORARILY_REJECTED
    ground.command(1, ARM, 0, 21196)
    ground.run(1.5)
    assert ground.acks(1, ARM)[-1] == ACCEPTED
    assert ground.emulator.truth().position[0, 2] < 0.01
    assert [contact["kind"] for contact in ground.emulator.truth().contacts] == ["crash"]


def test_takeoff_uses_an_altitude_above_mean_sea_level() -> None:
    ground = Ground(Emulator(world(1)))
    ground.run(1.0)
    ground.command(1, ARM, 1)
    ground.command(1, dialect.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, math.nan, math.nan, math.nan, 492.0)
    ground.run(12.0)
    assert ground.emulator.truth().position[0, 2] == pytest.approx(4.0 - 0.6, abs=0.2)
    assert ground.mode(1) == HOLD


def test_return_flies_home_and_lands() -> None:
    ground = flying({1: (6.0, 0.0, 3.0)})
    ground.command(1, dialect.MAV_CMD_NAV_RETURN_TO_LAUNCH)
    ground.run(45.0)
    assert np.abs(ground.emulator.truth().position[0]).max() < 0.5
    assert not ground.armed(1)


def test_accepted_setpoints() -> None:
    ground = flying()
    place = ground.emulator.bodies.goal_position[0].copy()
    nan = math.nan
    for values, frame, mask in (
        ((9.0, 9.0, -9.0), dialect.MAV_FRAME_LOCAL_OFFSET_NED, 3576),
        ((9.0, 9.0, -9.0), dialect.MAV_FRAME_BODY_NED, 3576),
        ((9.0, 9.0, -9.0), dialect.MAV_FRAME_LOCAL_NED, 3576 | 512),
        ((nan, nan, nan), dialect.MAV_FRAME_LOCAL_NED, 3576),
        ((9.0, nan, -9.0), dialect.MAV_FRAME_LOCAL_NED, 3576),
    ):
        ground.send(
            1,
            dialect.MAVLink_set_position_target_local_ned_message(
                0, 1, 1, frame, mask, *values, *[0.0] * 6, 0.0, 0.0
            ),
        )
        assert ground.emulator.bodies.goal_position[0].tolist() == place.tolist()
    for target in (2, 0):
        ground.send(
            1,
            dialect.MAVLink_set_position_target_local_ned_message(
                0, target, 1, 1, 3576, 1.0, 2.0, -3.0, *[0.0] * 6, 0.0, 0.0
            ),
        )
        moved = ground.emulator.bodies.goal_position[0] - ground.origin(1)
        assert (moved.tolist() == [2.0, 1.0, 3.0]) == (target == 0), "0 is a broadcast"


def test_a_lost_ground_station_triggers_NAV_DLL_ACT() -> None:
    ground = flying()
    set_parameter(ground, "NAV_DLL_ACT", 3)
    ground.run(1.2, ground.toward({1: (0, 0, 3)}))
    ground.run(10.0, ground.toward({1: (0, 0, 3)}), heartbeat=False)
    assert ground.mode(1) == OFFBOARD, "10 s, and some that a link counts as alive"
    ground.run(3.5, ground.toward({1: (0, 0, 3)}), heartbeat=False)
    assert ground.mode(1) == HOLD, "COM_FAIL_ACT_T: hold for five seconds first"
    ground.run(5.0, ground.toward({1: (0, 0, 3)}), heartbeat=False)
    assert ground.mode(1) == LAND


def test_the_land_detector_fails_for_a_vehicle_that_hangs_on_the_cable() -> None:
    """A descent setpoint without a descent: the land detector cuts the thrust (PX4 #15718)."""
    cable = "{mass_per_length: 0.02, points: [[0, 0, 0], [6.1, 0, 0]], attached: [0, 3.05, 6.1]}"
    ground = Ground(Emulator(world(3, cable, gripper="attached", payload=1.5)))
    places = {1: (0.0, 0.0, 4.6), 2: (3.0, 0.0, 4.4), 3: (6.0, 0.0, 4.6)}
    ground.px4_offboard(places, 12.0)
    ground.command(2, MODE, 1, 4, 6)
    ground.run(20.0, ground.toward({1: places[1], 3: places[3]}))
    landed = [e for e in ground.emulator.events if e["kind"] == "landed" and e["vehicle"] == 2]
    assert landed
    assert ground.emulator.truth().position[1, 2] > 1.0, "high above the floor"
