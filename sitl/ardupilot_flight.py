"""What flies in ArduCopter's modes that fly by themselves, and what GUIDED takes of setpoints."""

import math
from typing import TYPE_CHECKING

import numpy as np

from sitl import controller_goals, wire
from sitl.ardupilot_tables import AUTO, GUIDED, LAND, RTL
from sitl.route import DONE, LANDING, RETURNING

if TYPE_CHECKING:
    from sitl.ardupilot import ArduPilot

_LOCAL, _LOCAL_OFFSET, _BODY, _BODY_OFFSET = 1, 7, 8, 9
_TAKEOFF_CANCELLED = 0.2
_POSITION, _VELOCITY, _ACCELERATION, _FORCE = 7, 56, 448, 512
_Vector = tuple[float, float, float]


def land(copter: "ArduPilot") -> None:
    """Go down, faster high above home."""
    v, p = copter.v, copter.v.parameters
    home = v.home[2] if v.home is not None else v.origin[2]
    high = float(v.estimated()[2] - home) > p["LAND_ALT_LOW"] / 100.0
    rate = p["WPNAV_SPEED_DN"] if high else p["LAND_SPEED"]
    v.bodies.climb(v.index, -rate / 100.0)


def _return(copter: "ArduPilot") -> None:
    """Climb, fly home, wait RTL_LOIT_TIME, land."""
    v, p = copter.v, copter.v.parameters
    if v.home is None:
        return
    here, home = v.estimated(), v.home
    away = float(np.hypot(*(home - here)[:2]))
    if copter.stage == "":
        top = max(float(here[2]), float(home[2]) + p["RTL_ALT"] / 100.0)
        copter.goal = np.array([here[0], here[1], top])
        copter.stage = "climb"
        controller_goals.go(v, copter.goal)
    elif copter.stage == "climb" and here[2] > copter.goal[2] - 0.5:
        copter.goal = np.array([home[0], home[1], copter.goal[2]])
        copter.stage = "home"
        controller_goals.go(v, copter.goal)
    elif copter.stage == "home" and away < 0.5:
        copter.stage, copter.stage_at = "wait", v.now
    elif copter.stage == "wait" and v.now - copter.stage_at > p["RTL_LOIT_TIME"] / 1000.0:
        copter.stage, copter.landing = "land", True
        controller_goals.sink(v, p["LAND_SPEED"] / 100.0, steer=True)
    elif copter.stage == "land":
        land(copter)


def guided(copter: "ArduPilot") -> None:
    """Velocities are forgotten when no setpoint comes for GUID_TIMEOUT."""
    v = copter.v
    if copter.submode not in {"posvel", "velocity", "acceleration"}:
        return
    if v.now - copter.setpoint_at > v.parameters["GUID_TIMEOUT"]:
        b, i = v.bodies, v.index
        b.advance[i] = 0.0
        goal = (*b.goal_position[i], *[0.0] * 6)
        if copter.submode != "posvel":
            goal = (*v.estimated(), *[0.0] * 6)
        copter.submode = "stopped"
        b.aim(i, goal)


def _fly_mission(copter: "ArduPilot") -> None:
    v, p = copter.v, copter.v.parameters
    if copter.submode != "auto":
        return
    if copter.stage == "land":
        land(copter)
        return
    result = copter.route.steer(p["WPNAV_RADIUS"] / 100.0)
    if result == RETURNING:
        copter.change(RTL)
    elif result == DONE:
        copter.route.restart()
        copter.submode = "done"
        controller_goals.hold(v)
    elif result == LANDING:
        copter.stage, copter.landing = "land", True
        controller_goals.sink(v, p["LAND_SPEED"] / 100.0, steer=True)


def steer(copter: "ArduPilot") -> None:
    """Move on within the mode that flies."""
    step = _STEERING.get(copter.mode)
    if step is not None:
        step(copter)


def take(copter: "ArduPilot", setpoint: wire.Setpoint) -> None:
    """Take SET_POSITION_TARGET_LOCAL_NED as GUIDED does, by what its mask leaves."""
    v = copter.v
    mask = setpoint.mask
    if copter.mode != GUIDED or not v.armed or mask & _FORCE:
        return
    if setpoint.frame not in {_LOCAL, _LOCAL_OFFSET, _BODY, _BODY_OFFSET}:
        return
    if copter.submode == "takeoff" and v.landed:
        if v.now - copter.takeoff_at < _TAKEOFF_CANCELLED:
            v.bodies.may_lift[v.index] = False
    elif not v.bodies.may_lift[v.index] and v.landed:
        return
    position, velocity, acceleration = _in_world(copter, setpoint)
    used = [
        values
        for values, bits in ((position, _POSITION), (velocity, _VELOCITY),
                             (acceleration, _ACCELERATION))
        if not mask & bits
    ]  # fmt: skip
    total = sum(map(sum, used))
    if total - total != 0.0:
        return
    copter.setpoint_at = v.now
    _take(copter, mask, position, velocity, acceleration)
    if not mask & 1024 and math.isfinite(setpoint.yaw):
        v.bodies.goal_yaw[v.index] = math.pi / 2 - setpoint.yaw


def _take(
    copter: "ArduPilot", mask: int, position: _Vector, velocity: _Vector, acceleration: _Vector
) -> None:
    v, b, i = copter.v, copter.v.bodies, copter.v.index
    zero = (0.0, 0.0, 0.0)
    if mask & _ACCELERATION:
        acceleration = zero
    if not mask & _POSITION and not mask & _VELOCITY:
        kind, taken = "posvel", mask & _ACCELERATION
        goal = (*position, *velocity, *acceleration)
        axes = 1.0
    elif not mask & _POSITION and mask & _ACCELERATION:
        kind, taken = "position", _VELOCITY | _ACCELERATION
        goal, axes = (*position, *zero, *zero), 1.0
    elif mask & _POSITION and not mask & _VELOCITY:
        kind, taken = "velocity", _POSITION | (mask & _ACCELERATION)
        goal, axes = (*v.estimated(), *velocity, *acceleration), 0.0
    elif mask & _POSITION and not mask & _ACCELERATION:
        kind, taken = "acceleration", _POSITION | _VELOCITY
        goal, axes = (*v.estimated(), *zero, *acceleration), 0.0
    else:
        kind, taken = "velocity", _POSITION
        goal, axes = (*v.estimated(), *zero, *zero), 0.0
    if kind == copter.submode == "posvel":
        b.stage(i, goal)
    else:
        copter.submode = kind
        b.advance[i] = 1.0 if kind == "posvel" else 0.0
        hold = 0.0 if kind == "acceleration" else 1.0
        b.aim(i, goal, (axes, axes, axes), (hold, hold, hold))
    copter.taken_mask = taken | (mask & 3072)


def _in_world(copter: "ArduPilot", s: wire.Setpoint) -> tuple[_Vector, _Vector, _Vector]:
    """Position, velocity, acceleration in world ENU from any of the four frames."""
    v = copter.v
    n, e, d, vn, ve, vd, an, ae, ad = s.values
    if s.frame == _LOCAL:
        place = v.to_world(n, e, d)
    else:
        x, y, z = v.estimated().tolist()
        if s.frame in {_BODY, _BODY_OFFSET}:
            yaw = math.pi / 2 - float(v.bodies.yaw[v.index])
            cos, sin = math.cos(yaw), math.sin(yaw)
            n, e = n * cos - e * sin, n * sin + e * cos
            vn, ve = vn * cos - ve * sin, vn * sin + ve * cos
            an, ae = an * cos - ae * sin, an * sin + ae * cos
        place = (x + e, y + n, z - d)
    return place, (ve, vn, -vd), (ae, an, -ad)


_STEERING = {GUIDED: guided, RTL: _return, LAND: land, AUTO: _fly_mission}
