"""PX4's handling of SET_POSITION_TARGET_LOCAL_NED."""

import math

from sitl.autopilots.px4.state import Px4State
from sitl.protocol import wire

_LOCAL_NED = 1
_AXES, _FORCE, _NO_YAW = 0x1FF, 512, 1024


def accept(px4: Px4State, setpoint: wire.Setpoint) -> None:
    """Accept a setpoint in LOCAL_NED; NaN and masked values are "not given"."""
    if setpoint.frame != _LOCAL_NED or setpoint.mask & _FORCE:
        return
    mask = setpoint.mask
    values = setpoint.values
    total = sum(values)
    if mask & _AXES or total - total != 0.0:
        values = tuple(math.nan if mask >> k & 1 else x for k, x in enumerate(values))
        if not _complete(values):
            return
    px4.offboard_at = px4.v.now
    px4.offboard = setpoint
    if px4.mode == "OFFBOARD":
        _follow(px4, values)
        _turn(px4, setpoint)


def _turn(px4: Px4State, setpoint: wire.Setpoint) -> None:
    if not setpoint.mask & _NO_YAW and math.isfinite(setpoint.yaw):
        px4.v.bodies.goal_yaw[px4.v.index] = math.pi / 2 - setpoint.yaw


def _follow(px4: Px4State, values: tuple[float, ...]) -> None:
    v = px4.v
    n, e, d, vn, ve, vd, an, ae, ad = values
    total = sum(values)
    if total - total == 0.0:
        v.bodies.set_goal(v.index, (*v.to_world(n, e, d), ve, vn, -vd, ae, an, -ad))
        px4.all_axes = True
        return
    px4.all_axes = False
    given = [float(math.isfinite(value)) for value in values]
    moved = [max(given[k], given[k + 3]) for k in range(3)]
    n, e, d, vn, ve, vd, an, ae, ad = (u if math.isfinite(u) else 0.0 for u in values)
    v.bodies.set_goal(
        v.index,
        (*v.to_world(n, e, d), ve, vn, -vd, ae, an, -ad),
        (given[1], given[0], given[2]),
        (moved[1], moved[0], moved[2]),
    )


def _complete(values: tuple[float, ...]) -> bool:
    """Return whether every axis has a value, x and y alike (PX4 refuses other combinations)."""
    given = [math.isfinite(value) for value in values]
    kinds = (given[:3], given[3:6], given[6:])
    return all(any(kind[k] for kind in kinds) for k in range(3)) and all(
        kind[0] == kind[1] for kind in kinds
    )
