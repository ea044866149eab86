"""What PX4 does with MAVLink commands that concern flying, and how it answers them."""

import math
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from pymavlink.dialects.v20 import common as dialect

from sitl.px4_tables import BY_NUMBER
from sitl.vehicle import ACCEPTED, DENIED, TEMPORARILY_REJECTED, UNSUPPORTED, Command

if TYPE_CHECKING:
    from sitl.px4 import Px4

_FORCE = 21196
_CRITICAL = 2


def _do_set_mode(px4: "Px4", command: Command) -> int:
    p = command.p
    base, main, sub = int(p[0]), int(p[1]), int(p[2])
    if not base & 1:
        return DENIED
    return px4.change(BY_NUMBER.get((main, sub)))


def _arm_disarm(px4: "Px4", command: Command) -> int:
    p = command.p
    v = px4.v
    force = p[1] == _FORCE
    if p[0] not in (0.0, 1.0):
        return UNSUPPORTED
    if p[0] == 1.0:
        return px4.arm(force)
    if not v.armed:
        return ACCEPTED
    if not v.landed and not force:
        v.text(_CRITICAL, "Disarming denied: not landed\t")
        return TEMPORARILY_REJECTED
    px4.disarm("Disarmed by external command")
    return ACCEPTED


def _takeoff(px4: "Px4", command: Command) -> int:
    p = command.p
    v = px4.v
    result = px4.change("TAKEOFF")
    if result == ACCEPTED:
        ground = float(v.estimated()[2])
        if math.isfinite(p[6]):
            height = p[6] - v.around.geodesy.altitude
        else:
            height = ground + v.parameters["MIS_TAKEOFF_ALT"]
        px4.goal = np.array([*v.estimated()[:2], max(height, ground)])
        px4.state = ""
        px4.evaluate()
    return result


def _start_mission(px4: "Px4", _: Command) -> int:
    result = px4.change("MISSION")
    return px4.arm(force=False) if result == ACCEPTED else result


def _jump(px4: "Px4", command: Command) -> int:
    number = command.p[0]
    known = math.isfinite(number) and px4.route.jump_to(int(number))
    return ACCEPTED if known else DENIED


def _land(px4: "Px4", _: Command) -> int:
    return px4.change("LAND")


def _return(px4: "Px4", _: Command) -> int:
    return px4.change("RTL")


def _reposition(px4: "Px4", command: Command) -> int:
    p, x, y = command.p, command.x, command.y
    v = px4.v
    result = px4.change("LOITER")
    if result == ACCEPTED:
        here = v.estimated()
        place = np.array(here)
        if x != 2**31 - 1 and y != 2**31 - 1 and (x or y):
            place[:2] = v.around.geodesy.metres(x * 1e-7, y * 1e-7)
        if math.isfinite(p[6]):
            place[2] = p[6] - v.around.geodesy.altitude
        px4.goal = place
        if math.isfinite(p[3]):
            v.bodies.goal_yaw[v.index] = math.pi / 2 - p[3]
        px4.state = ""
        px4.evaluate()
    return result


def _speed(px4: "Px4", command: Command) -> int:
    p = command.p
    if math.isfinite(p[1]) and p[1] > 0:
        px4.v.bodies.speed_limit[px4.v.index] = min(p[1], px4.v.spec.max_speed)
        px4.v.bodies.touch()
    return ACCEPTED


def _terminate(px4: "Px4", command: Command) -> int:
    p = command.p
    if p[0] > 0.5:
        px4.terminate()
    return ACCEPTED


COMMANDS: dict[int, Callable[["Px4", Command], int]] = {
    dialect.MAV_CMD_COMPONENT_ARM_DISARM: _arm_disarm,
    dialect.MAV_CMD_DO_SET_MODE: _do_set_mode,
    dialect.MAV_CMD_NAV_TAKEOFF: _takeoff,
    dialect.MAV_CMD_MISSION_START: _start_mission,
    dialect.MAV_CMD_DO_SET_MISSION_CURRENT: _jump,
    dialect.MAV_CMD_NAV_LAND: _land,
    dialect.MAV_CMD_NAV_RETURN_TO_LAUNCH: _return,
    dialect.MAV_CMD_DO_REPOSITION: _reposition,
    dialect.MAV_CMD_DO_CHANGE_SPEED: _speed,
    dialect.MAV_CMD_DO_FLIGHTTERMINATION: _terminate,
}
