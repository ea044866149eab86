"""Uploaded missions and fences, and a pilot's radio, with both autopilots."""

import math

import numpy as np
import pytest
from pymavlink.dialects.v20 import common as dialect

from sitl import Emulator
from sitl.faults import Fault
from sitl.physics.geodesy import Geodesy
from sitl.protocol.missions import Area, areas, breached
from tests.sitl.client import Ground, world

BOTH = pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
HERE = Geodesy.at(47.397742, 8.545594, 488.0)
TAKE_OFF, WAYPOINT = 22, 16
MISSION, FENCE = 0, 1


def item(command: int, x: float, y: float, z: float, *p: float, frame: int = 6) -> tuple:
    latitude, longitude, _ = HERE.degrees(x, y, 0.0)
    values = [*p, *[0.0] * (4 - len(p))]
    return (frame, command, values, round(latitude * 1e7), round(longitude * 1e7), z)


def upload(ground: Ground, items: list[tuple], kind: int = MISSION) -> int:
    """Upload a list item by item as requested; return the result."""
    ground.log.clear()
    ground.send(1, dialect.MAVLink_mission_count_message(1, 1, len(items), kind))
    for seq, (frame, command, values, x, y, z) in enumerate(items):
        ground.run(0.05)
        request = ground.last[1, "MISSION_REQUEST_INT"]
        assert (request.seq, request.mission_type) == (seq, kind)
        ground.send(
            1,
            dialect.MAVLink_mission_item_int_message(
                1, 1, seq, frame, command, 0, 1, *values, x, y, z, kind
            ),
        )
    ground.run(0.1)
    return int(ground.last[1, "MISSION_ACK"].type)


def ready(autopilot: str, **keys) -> Ground:
    ground = Ground(Emulator(world(1, autopilot=autopilot, **keys)))
    if autopilot == "ardupilot":
        for name in ("LOCAL_POSITION_NED", "MISSION_CURRENT"):
            number = getattr(dialect, f"MAVLINK_MSG_ID_{name}")
            ground.command(1, dialect.MAV_CMD_SET_MESSAGE_INTERVAL, number, 1e5)
    ground.run(1.2)
    return ground


def up(ground: Ground, autopilot: str, height: float = 5.0) -> None:
    """Take off and wait."""
    if autopilot == "ardupilot":
        ground.command(1, dialect.MAV_CMD_DO_SET_MODE, 1, 4)
        ground.run(0.2)
        ground.command(1, dialect.MAV_CMD_COMPONENT_ARM_DISARM, 1)
        ground.run(0.5)
        ground.command(1, TAKE_OFF, 0, 0, 0, 0, 0, 0, height)
    else:
        ground.command(1, TAKE_OFF, 0, 0, 0, 0, 0, 0, 488.6 + height)
        ground.command(1, dialect.MAV_CMD_COMPONENT_ARM_DISARM, 1)
    ground.run(10.0)
    assert place(ground)[2] == pytest.approx(height, abs=0.5)


def place(ground: Ground) -> np.ndarray:
    return ground.emulator.truth().position[0]


def modes(ground: Ground) -> list[str]:
    return [event["mode"] for event in ground.emulator.events if event["kind"] == "mode"]


@BOTH
def test_no_mission_is_started(autopilot: str) -> None:
    """Uploaded missions are stored: no vehicle of this world leaves its ground station for one."""
    ground = ready(autopilot)
    places = [item(WAYPOINT, x, 0.0, 6.0) for x in (0.0, 40.0)]
    assert upload(ground, places) == dialect.MAV_MISSION_ACCEPTED
    up(ground, autopilot)
    before = modes(ground)[-1]
    ground.command(1, dialect.MAV_CMD_MISSION_START)
    ground.run(0.2)
    refused, words = {
        "px4": (1, "Switching to mode 'Mission' is currently not possible\t"),
        "ardupilot": (4, "Mode change to AUTO failed: init failed"),
    }[autopilot]
    assert ground.acks(1, dialect.MAV_CMD_MISSION_START) == [refused]
    assert ground.texts(1)[-1] == words
    assert modes(ground)[-1] == before


def test_points_inside_fences() -> None:
    square = Area(True, ((0.0, 0.0), (4.0, 0.0), (4.0, 4.0), (2.0, 2.0), (0.0, 4.0)))
    assert square.contains(1.0, 1.0)
    assert square.contains(3.5, 3.4)
    assert not square.contains(2.0, 3.5), "the notch"
    assert not square.contains(-0.1, 1.0)
    hole = Area(False, ((1.0, 1.0),), 0.5)
    assert breached([square, hole], 1.2, 1.2)
    assert not breached([square, hole], 1.0, 0.2)
    assert not breached([], 1e6, 0.0)


@pytest.mark.parametrize(
    "bad",
    [
        [item(5001, 0, 0, 0, 4), item(5001, 1, 0, 0, 4), item(5001, 1, 1, 0, 4)],
        [item(5001, 0, 0, 0, 3), item(5001, 1, 0, 0, 3), item(5002, 1, 1, 0, 3)],
        [item(5001, 0, 0, 0, math.nan)],
        [item(5003, 0, 0, 0, -1.0)],
    ],
    ids=["too few corners", "corners of two kinds", "no number", "no radius"],
)
def test_invalid_fences_are_refused(bad: list[tuple]) -> None:
    named = [{"command": c, "param1": p[0], "x": x, "y": y} for _, c, p, x, y, _ in bad]
    assert areas(named, HERE) is None
    ground = ready("px4")
    assert upload(ground, bad, FENCE) == dialect.MAV_MISSION_ERROR


def go_east(ground: Ground, metres: float, seconds: float) -> None:
    latitude, longitude, altitude = HERE.degrees(metres, 0.0, 5.6)
    message = dialect.MAVLink_command_int_message(
        1, 1, 5, dialect.MAV_CMD_DO_REPOSITION, 0, 0, -1.0, 1.0, 0.0, math.nan,
        round(latitude * 1e7), round(longitude * 1e7), altitude,
    )  # fmt: skip
    ground.send(1, message)
    ground.run(seconds)


SQUARE = [item(5001, x, y, 0, 4) for x, y in ((-10, -10), (10, -10), (10, 10), (-10, 10))]
HOLE = [item(5004, 14.0, 0.0, 0, 6.0)]


@BOTH
@pytest.mark.parametrize(
    "fence", [SQUARE, HOLE], ids=["polygon to stay in", "circle to stay out of"]
)
def test_an_uploaded_fence_stops_the_vehicle(autopilot: str, fence: list[tuple]) -> None:
    ground = ready(autopilot)
    assert upload(ground, fence, FENCE) == 0
    ground.command(1, dialect.MAV_CMD_DO_FENCE_ENABLE, 1)
    up(ground, autopilot)
    go_east(ground, 30.0, 6.0)
    assert "fence" in {event["kind"] for event in ground.emulator.events}
    assert modes(ground)[-1] == ("LOITER" if autopilot == "px4" else "RTL")
    said = "Geofence violation\t" if autopilot == "px4" else "Polygon fence breached"
    assert said in ground.texts(1)
    assert place(ground)[0] < 16.0


@BOTH
def test_fences_from_parameters(autopilot: str) -> None:
    ground = ready(autopilot)
    names = {
        "px4": {"GF_MAX_HOR_DIST": 8.0, "GF_ACTION": 5},
        "ardupilot": {"FENCE_RADIUS": 8.0, "FENCE_ENABLE": 1, "FENCE_ACTION": 2},
    }[autopilot]
    for name, value in names.items():
        ground.send(1, dialect.MAVLink_param_set_message(1, 1, name.encode(), value, 9))
    ground.run(0.2)
    up(ground, autopilot)
    go_east(ground, 30.0, 14.0)
    assert modes(ground)[-1] == "LAND" or not ground.armed(1)
    assert 7.5 < place(ground)[0] < 16.0


def test_ardupilots_fence_is_off_without_FENCE_ENABLE() -> None:
    ground = ready("ardupilot")
    upload(ground, SQUARE, FENCE)
    up(ground, "ardupilot")
    go_east(ground, 20.0, 8.0)
    assert place(ground)[0] > 15.0
    assert modes(ground)[-1] == "GUIDED"


@BOTH
def test_arming_is_refused_outside_the_fence(autopilot: str) -> None:
    ground = ready(autopilot)
    upload(ground, [item(5003, 50.0, 0.0, 0, 20.0)], FENCE)
    ground.command(1, dialect.MAV_CMD_DO_FENCE_ENABLE, 1)
    ground.command(1, dialect.MAV_CMD_COMPONENT_ARM_DISARM, 1)
    ground.run(0.3)
    assert ground.acks(1, dialect.MAV_CMD_COMPONENT_ARM_DISARM)[-1] == (
        1 if autopilot == "px4" else 4
    )
    assert not ground.armed(1)


@BOTH
@pytest.mark.parametrize("radio", [True, False])
def test_a_lost_radio_triggers_a_failsafe_only_if_connected_before(
    autopilot: str, radio: bool
) -> None:
    """PX4 holds for COM_FAIL_ACT_T and returns (NAV_RCL_ACT 2), ArduPilot returns immediately."""
    ground = ready(autopilot, radio="true" if radio else "false")
    up(ground, autopilot)
    before = modes(ground)[-1]
    ground.emulator.inject(Fault(at=0.0, kind="rc_loss"))
    ground.run(3.0)
    if not radio:
        assert modes(ground)[-1] == before
        return
    assert modes(ground)[-1] == ("LOITER" if autopilot == "px4" else "RTL")
    ground.run(4.0)
    assert modes(ground)[-1] == "RTL"
    said = "Failsafe activated\t" if autopilot == "px4" else "Radio Failsafe"
    assert said in ground.texts(1)


@BOTH
def test_parameters_disable_the_radio_failsafe_with_setpoints(autopilot: str) -> None:
    ground = ready(autopilot, radio="true")
    name, value = ("COM_RCL_EXCEPT", 4) if autopilot == "px4" else ("FS_OPTIONS", 4)
    ground.send(1, dialect.MAVLink_param_set_message(1, 1, name.encode(), value, 9))
    ground.run(0.1)
    if autopilot == "px4":
        ground.px4_offboard({1: (0.0, 0.0, 5.0)}, 9.0)
    else:
        up(ground, autopilot)
    ground.command(1, 420, 104, 1)
    ground.run(8.0, ground.toward({1: (0.0, 0.0, 5.0)}))
    assert modes(ground)[-1] == ("OFFBOARD" if autopilot == "px4" else "GUIDED")


def test_with_a_radio_px4_changes_to_position_mode_after_stream_loss() -> None:
    """COM_OBL_RC_ACT 0 is Position with a radio, a blind descent without one."""
    last = []
    for radio in ("true", "false"):
        ground = ready("px4", radio=radio)
        ground.px4_offboard({1: (0.0, 0.0, 5.0)}, 9.0)
        ground.run(2.0)
        last.append(modes(ground)[-1])
    assert last == ["POSCTL", "DESCEND"]


def test_ardupilot_releases_the_cable_in_a_failsafe_if_configured() -> None:
    cable = "{mass_per_length: 0.02, points: [[0, 0, 0], [3.0, 0, 0]]}"
    held = []
    for options in (16, 48):
        ground = Ground(Emulator(world(1, cable, autopilot="ardupilot", radio="true")))
        ground.run(1.0)
        ground.send(1, dialect.MAVLink_param_set_message(1, 1, b"FS_OPTIONS", options, 9))
        ground.command(1, dialect.MAV_CMD_DO_GRIPPER, 1, 1)
        ground.run(1.5)
        assert ground.emulator.truth().gripped.all()
        up(ground, "ardupilot", 2.0)
        ground.command(1, 420, 104, 1)
        ground.run(2.0)
        held.append(bool(ground.emulator.truth().gripped[0]))
    assert held == [True, False]


@BOTH
def test_a_gripper_without_setup_is_unsupported(autopilot: str) -> None:
    ground = ready(autopilot)
    name = b"PD_GRIPPER_EN" if autopilot == "px4" else b"GRIP_ENABLE"
    ground.send(1, dialect.MAVLink_param_set_message(1, 1, name, 0, 9))
    ground.command(1, dialect.MAV_CMD_DO_GRIPPER, 1, 1)
    ground.run(0.2)
    assert ground.acks(1, dialect.MAV_CMD_DO_GRIPPER) == [3]
