"""What ArduCopter does with MAVLink commands that concern flying, and how it answers them."""

import math
from collections.abc import Callable
from typing import TYPE_CHECKING

from pymavlink.dialects.v20 import common as dialect

from sitl import ardupilot_flight, controller_goals
from sitl.ardupilot_tables import AUTO, GUIDED, LAND, RTL
from sitl.vehicle import ACCEPTED, DENIED, FAILED, Command

if TYPE_CHECKING:
    from sitl.ardupilot import ArduPilot

_FORCE_ARM, _FORCE_DISARM = 2989, 21196


def _do_set_mode(copter: "ArduPilot", command: Command) -> int:
    p = command.p
    return copter.change(int(p[1])) if int(p[0]) & 1 else DENIED


def _arm_disarm(copter: "ArduPilot", command: Command) -> int:
    p = command.p
    v = copter.v
    if p[0] == 1.0:
        return copter.arm(force=p[1] == _FORCE_ARM)
    if p[0] != 0.0:
        return DENIED
    if not v.armed:
        return ACCEPTED
    if not v.landed and p[1] != _FORCE_DISARM:
        return FAILED
    copter.disarm("command")
    return ACCEPTED


def _takeoff(copter: "ArduPilot", command: Command) -> int:
    p = command.p
    v = copter.v
    if copter.mode != GUIDED or not v.armed or not v.landed or not math.isfinite(p[6]):
        return FAILED
    if p[6] < 0.1:
        return FAILED
    copter.submode = "takeoff"
    copter.takeoff_at = v.now
    home = v.home if v.home is not None else v.origin
    here = v.estimated()
    copter.takeoff_height, copter.takeoff_from = float(home[2]) + p[6], float(here[2])
    v.bodies.may_lift[v.index] = True
    v.bodies.advance[v.index] = 0.0
    copter.cruise()
    controller_goals.go(v, (here[0], here[1], max(copter.takeoff_height, float(here[2]))))
    copter.all_axes = True
    return ACCEPTED


def _start_mission(copter: "ArduPilot", _: Command) -> int:
    """Begin the mission, from the ground too; it does not arm."""
    v = copter.v
    if copter.change(AUTO) != ACCEPTED or not v.armed:
        return FAILED
    copter.submode = "auto"
    v.bodies.may_lift[v.index] = True
    ardupilot_flight.steer(copter)
    return ACCEPTED


def _jump(copter: "ArduPilot", command: Command) -> int:
    number = command.p[0]
    known = math.isfinite(number) and copter.route.jump_to(int(number))
    return ACCEPTED if known else DENIED


def _enable_fence(copter: "ArduPilot", command: Command) -> int:
    if command.p[0] not in {0.0, 1.0}:
        return DENIED
    copter.v.parameters.values["FENCE_ENABLE"] = int(command.p[0])
    return ACCEPTED


def _land(copter: "ArduPilot", _: Command) -> int:
    return copter.change(LAND)


def _return(copter: "ArduPilot", _: Command) -> int:
    return copter.change(RTL)


def _reposition(copter: "ArduPilot", command: Command) -> int:
    p, x, y = command.p, command.x, command.y
    v = copter.v
    if not math.isfinite(p[6]) or x == 2**31 - 1 or y == 2**31 - 1:
        return DENIED
    if copter.mode != GUIDED:
        if not int(p[1]) & 1:
            return DENIED
        if copter.change(GUIDED) != ACCEPTED:
            return FAILED
    if v.landed:
        return FAILED
    place = (*v.around.geodesy.metres(x * 1e-7, y * 1e-7), p[6] - v.around.geodesy.altitude)
    copter.cruise()
    copter.submode = "position"
    controller_goals.go(v, place)
    return ACCEPTED


def _speed(copter: "ArduPilot", command: Command) -> int:
    p = command.p
    v = copter.v
    if math.isfinite(p[1]) and p[1] > 0:
        v.bodies.speed_limit[v.index] = min(p[1], v.spec.max_speed)
        v.bodies.touch()
    return ACCEPTED


def _terminate(copter: "ArduPilot", command: Command) -> int:
    p = command.p
    if p[0] > 0.5:
        copter.disarm("terminated")
    return ACCEPTED


COMMANDS: dict[int, Callable[["ArduPilot", Command], int]] = {
    dialect.MAV_CMD_COMPONENT_ARM_DISARM: _arm_disarm,
    dialect.MAV_CMD_DO_SET_MODE: _do_set_mode,
    dialect.MAV_CMD_NAV_TAKEOFF: _takeoff,
    dialect.MAV_CMD_MISSION_START: _start_mission,
    dialect.MAV_CMD_DO_SET_MISSION_CURRENT: _jump,
    dialect.MAV_CMD_DO_FENCE_ENABLE: _enable_fence,
    dialect.MAV_CMD_NAV_LAND: _land,
    dialect.MAV_CMD_NAV_RETURN_TO_LAUNCH: _return,
    dialect.MAV_CMD_DO_REPOSITION: _reposition,
    dialect.MAV_CMD_DO_CHANGE_SPEED: _speed,
    dialect.MAV_CMD_DO_FLIGHTTERMINATION: _terminate,
}
