"""ArduCopter's handling of SET_POSITION_TARGET_LOCAL_NED in GUIDED."""

import math

from sitl.autopilots.ardupilot.state import ArduPilotState
from sitl.autopilots.ardupilot.tables import GUIDED
from sitl.protocol import wire

_LOCAL, _LOCAL_OFFSET, _BODY, _BODY_OFFSET = 1, 7, 8, 9
_TAKEOFF_CANCELLED = 0.2
_POSITION, _VELOCITY, _ACCELERATION, _FORCE = 7, 56, 448, 512
_NO_YAW, _YAW_BITS = 1024, 3072
_Vector = tuple[float, float, float]


def accept(copter: ArduPilotState, setpoint: wire.Setpoint) -> None:
    """Accept a setpoint in GUIDED; the mask selects position, velocity or acceleration."""
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
    _follow(copter, mask, position, velocity, acceleration)
    if not mask & _NO_YAW and math.isfinite(setpoint.yaw):
        v.bodies.goal_yaw[v.index] = math.pi / 2 - setpoint.yaw


def _follow(
    copter: ArduPilotState, mask: int, position: _Vector, velocity: _Vector, acceleration: _Vector
) -> None:
    v, b, i = copter.v, copter.v.bodies, copter.v.index
    zero = (0.0, 0.0, 0.0)
    if mask & _ACCELERATION:
        acceleration = zero
    if not mask & _POSITION and not mask & _VELOCITY:
        kind, ignored = "posvel", mask & _ACCELERATION
        goal = (*position, *velocity, *acceleration)
        axes = 1.0
    elif not mask & _POSITION and mask & _ACCELERATION:
        kind, ignored = "position", _VELOCITY | _ACCELERATION
        goal, axes = (*position, *zero, *zero), 1.0
    elif mask & _POSITION and not mask & _VELOCITY:
        kind, ignored = "velocity", _POSITION | (mask & _ACCELERATION)
        goal, axes = (*v.estimated(), *velocity, *acceleration), 0.0
    elif mask & _POSITION and not mask & _ACCELERATION:
        kind, ignored = "acceleration", _POSITION | _VELOCITY
        goal, axes = (*v.estimated(), *zero, *acceleration), 0.0
    else:
        kind, ignored = "velocity", _POSITION
        goal, axes = (*v.estimated(), *zero, *zero), 0.0
    if kind == copter.submode == "posvel":
        b.set_goal_values(i, goal)
    else:
        copter.submode = kind
        b.goal_moves[i] = 1.0 if kind == "posvel" else 0.0
        hold = 0.0 if kind == "acceleration" else 1.0
        b.set_goal(i, goal, (axes, axes, axes), (hold, hold, hold))
    copter.accepted_mask = ignored | (mask & _YAW_BITS)


def _in_world(copter: ArduPilotState, s: wire.Setpoint) -> tuple[_Vector, _Vector, _Vector]:
    """Return position, velocity and acceleration in world ENU, from any of the four frames."""
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
