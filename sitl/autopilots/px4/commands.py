"""PX4's commands for flight, and their results."""

import math
from collections.abc import Callable

import numpy as np
from pymavlink.dialects.v20 import common as dialect

from sitl.autopilots import controller_goals
from sitl.autopilots.px4 import modes
from sitl.autopilots.px4.state import CRITICAL, INFO, Px4State
from sitl.autopilots.px4.tables import BY_NUMBER
from sitl.protocol.links import ACCEPTED, DENIED, TEMPORARILY_REJECTED, UNSUPPORTED, Command

_FORCE = 21196


def _do_set_mode(px4: Px4State, command: Command) -> int:
    p = command.p
    base, main, sub = int(p[0]), int(p[1]), int(p[2])
    if not base & 1:
        return DENIED
    return modes.change(px4, BY_NUMBER.get((main, sub)))


def _arm_disarm(px4: Px4State, command: Command) -> int:
    p = command.p
    v = px4.v
    force = p[1] == _FORCE
    if p[0] not in (0.0, 1.0):
        return UNSUPPORTED
    if p[0] == 1.0:
        return modes.arm(px4, force)
    if not v.armed:
        return ACCEPTED
    if not v.landed and not force:
        v.text(CRITICAL, "Disarming denied: not landed\t")
        return TEMPORARILY_REJECTED
    modes.disarm(px4, "Disarmed by external command")
    return ACCEPTED


def _takeoff(px4: Px4State, command: Command) -> int:
    p = command.p
    v = px4.v
    result = modes.change(px4, "TAKEOFF")
    if result == ACCEPTED:
        ground = float(v.estimated()[2])
        if math.isfinite(p[6]):
            height = p[6] - v.environment.geodesy.altitude
        else:
            height = ground + v.parameters["MIS_TAKEOFF_ALT"]
        px4.goal = np.array([*v.estimated()[:2], max(height, ground)])
        modes.restart_mode(px4)
    return result


def _start_mission(px4: Px4State, _: Command) -> int:
    result = modes.change(px4, "MISSION")
    return modes.arm(px4, force=False) if result == ACCEPTED else result


def _jump(px4: Px4State, command: Command) -> int:
    number, v = command.p[0], px4.v
    found = math.isfinite(number) and v.mission_progress.jump_to(int(number), len(v.mission[0]))
    return ACCEPTED if found else DENIED


def _land(px4: Px4State, _: Command) -> int:
    result = modes.change(px4, "LAND")
    if result == ACCEPTED:
        px4.v.text(INFO, "Landing at current position\t")
    return result


def _return(px4: Px4State, _: Command) -> int:
    return modes.change(px4, "RTL")


def _reposition(px4: Px4State, command: Command) -> int:
    p, x, y = command.p, command.x, command.y
    v = px4.v
    result = modes.change(px4, "LOITER")
    if result == ACCEPTED:
        here = v.estimated()
        place = np.array(here)
        if x != 2**31 - 1 and y != 2**31 - 1 and (x or y):
            place[:2] = v.environment.geodesy.metres(x * 1e-7, y * 1e-7)
        if math.isfinite(p[6]):
            place[2] = p[6] - v.environment.geodesy.altitude
        px4.goal = place
        if math.isfinite(p[3]):
            v.bodies.goal_yaw[v.index] = math.pi / 2 - p[3]
        modes.restart_mode(px4)
    return result


def _speed(px4: Px4State, command: Command) -> int:
    controller_goals.set_speed(px4.v, command.p[1])
    return ACCEPTED


def _terminate(px4: Px4State, command: Command) -> int:
    if command.p[0] > 0.5:
        modes.terminate(px4)
    return ACCEPTED


COMMANDS: dict[int, Callable[[Px4State, Command], int]] = {
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
