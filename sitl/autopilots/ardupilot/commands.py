"""ArduCopter's commands for flight, and their results."""

import math
from collections.abc import Callable

from pymavlink.dialects.v20 import common as dialect

from sitl.autopilots import controller_goals
from sitl.autopilots.ardupilot import flight, modes
from sitl.autopilots.ardupilot.state import ArduPilotState
from sitl.autopilots.ardupilot.tables import AUTO, GUIDED, LAND, RTL
from sitl.protocol.links import ACCEPTED, DENIED, FAILED, Command

_FORCE_ARM, _FORCE_DISARM = 2989, 21196


def _do_set_mode(copter: ArduPilotState, command: Command) -> int:
    p = command.p
    return modes.change(copter, int(p[1])) if int(p[0]) & 1 else DENIED


def _arm_disarm(copter: ArduPilotState, command: Command) -> int:
    p = command.p
    v = copter.v
    if p[0] == 1.0:
        return modes.arm(copter, force=p[1] == _FORCE_ARM)
    if p[0] != 0.0:
        return DENIED
    if not v.armed:
        return ACCEPTED
    if not v.landed and p[1] != _FORCE_DISARM:
        return FAILED
    modes.disarm(copter, "command")
    return ACCEPTED


def _takeoff(copter: ArduPilotState, command: Command) -> int:
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
    v.bodies.goal_moves[v.index] = 0.0
    modes.cruise(copter)
    controller_goals.go(v, (here[0], here[1], max(copter.takeoff_height, float(here[2]))))
    return ACCEPTED


def _start_mission(copter: ArduPilotState, _: Command) -> int:
    """Start the mission, from the ground too, without arming."""
    v = copter.v
    if modes.change(copter, AUTO) != ACCEPTED or not v.armed:
        return FAILED
    copter.submode = "auto"
    v.bodies.may_lift[v.index] = True
    flight.steer(copter)
    return ACCEPTED


def _jump(copter: ArduPilotState, command: Command) -> int:
    number, v = command.p[0], copter.v
    found = math.isfinite(number) and v.mission_progress.jump_to(int(number), len(v.mission[0]))
    return ACCEPTED if found else DENIED


def _enable_fence(copter: ArduPilotState, command: Command) -> int:
    if command.p[0] not in {0.0, 1.0}:
        return DENIED
    copter.v.parameters.values["FENCE_ENABLE"] = int(command.p[0])
    return ACCEPTED


def _land(copter: ArduPilotState, _: Command) -> int:
    return modes.change(copter, LAND)


def _return(copter: ArduPilotState, _: Command) -> int:
    return modes.change(copter, RTL)


def _reposition(copter: ArduPilotState, command: Command) -> int:
    p, x, y = command.p, command.x, command.y
    v = copter.v
    if not math.isfinite(p[6]) or x == 2**31 - 1 or y == 2**31 - 1:
        return DENIED
    if copter.mode != GUIDED:
        if not int(p[1]) & 1:
            return DENIED
        if modes.change(copter, GUIDED) != ACCEPTED:
            return FAILED
    if v.landed:
        return FAILED
    place = (
        *v.environment.geodesy.metres(x * 1e-7, y * 1e-7),
        p[6] - v.environment.geodesy.altitude,
    )
    modes.cruise(copter)
    copter.submode = "position"
    controller_goals.go(v, place)
    return ACCEPTED


def _speed(copter: ArduPilotState, command: Command) -> int:
    controller_goals.set_speed(copter.v, command.p[1])
    return ACCEPTED


def _terminate(copter: ArduPilotState, command: Command) -> int:
    if command.p[0] > 0.5:
        modes.disarm(copter, "terminated")
    return ACCEPTED


COMMANDS: dict[int, Callable[[ArduPilotState, Command], int]] = {
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
