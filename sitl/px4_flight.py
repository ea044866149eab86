"""What flies in each of PX4's modes: goals for the controller, and offboard setpoints."""

import math
from typing import TYPE_CHECKING

import numpy as np

from sitl import controller_goals, wire
from sitl.route import DONE, LANDING, RETURNING

if TYPE_CHECKING:
    from sitl.px4 import Px4

_LOCAL_NED = 1


def begin(px4: "Px4", name: str) -> None:
    """Set the controller up for a state that has just been entered while armed."""
    v, p = px4.v, px4.v.parameters
    b, i = v.bodies, v.index
    b.may_lift[i] = name in {"OFFBOARD", "TAKEOFF", "POSCTL", "MISSION"}
    controller_goals.limits(v, p["MPC_XY_CRUISE"], p["MPC_Z_V_AUTO_UP"], p["MPC_Z_V_AUTO_DN"])
    px4.all_axes = False
    if name == "OFFBOARD":
        up, down = p["MPC_Z_VEL_MAX_UP"], p["MPC_Z_VEL_MAX_DN"]
        controller_goals.limits(v, p["MPC_XY_VEL_MAX"], up, down)
        if px4.offboard is not None:
            received = px4.offboard_at
            take(px4, px4.offboard)
            px4.offboard_at = received
    elif name == "TAKEOFF" and px4.goal is not None:
        controller_goals.limits(v, p["MPC_XY_CRUISE"], p["MPC_TKO_SPEED"], p["MPC_Z_V_AUTO_DN"])
        controller_goals.go(v, px4.goal)
    elif name == "LOITER" and px4.goal is not None:
        controller_goals.go(v, px4.goal)
    elif name == "MISSION":
        controller_goals.hold(v)
        steer(px4)
    elif name == "LAND":
        controller_goals.hold(v)
        controller_goals.sink(v, p["MPC_LAND_SPEED"], steer=True)
    elif name == "DESCEND":
        controller_goals.sink(v, p["MPC_LAND_SPEED"], steer=False)
    elif name != "TERMINATION":
        controller_goals.hold(v)


def _take_off(px4: "Px4") -> None:
    v = px4.v
    if px4.goal is not None and abs(float(v.estimated()[2] - px4.goal[2])) < 0.3:
        px4.intended, px4.after_disarm = "LOITER", "LOITER"
        px4.goal = np.array(px4.goal)
        px4.evaluate()


def _land(px4: "Px4") -> None:
    """Go down, slower and slower from MPC_LAND_ALT1 to MPC_LAND_ALT2 above home."""
    v, p = px4.v, px4.v.parameters
    home = v.home[2] if v.home is not None else v.origin[2]
    height = float(v.estimated()[2] - home)
    slow, fast = p["MPC_LAND_SPEED"], p["MPC_Z_V_AUTO_DN"]
    low, high = p["MPC_LAND_ALT2"], p["MPC_LAND_ALT1"]
    share = min(1.0, max(0.0, (height - low) / max(high - low, 1e-3)))
    v.bodies.climb(v.index, -(slow + share * (fast - slow)))


def _return(px4: "Px4") -> None:
    """Climb to the return altitude, fly home, come down, land."""
    v, p = px4.v, px4.v.parameters
    if v.home is None:
        return
    home = v.home
    here = v.estimated()
    away = float(np.hypot(*(home - here)[:2]))
    top = max(float(here[2]), float(home[2]) + min(p["RTL_RETURN_ALT"], 0.5 * away + 5.0))
    if px4.stage == "":
        px4.goal = np.array([here[0], here[1], top if away > 1.0 else here[2]])
        px4.stage = "climb"
        controller_goals.go(v, px4.goal)
    elif px4.stage == "climb" and here[2] > px4.goal[2] - 0.5:
        px4.goal = np.array([home[0], home[1], px4.goal[2]])
        px4.stage = "home"
        controller_goals.go(v, px4.goal)
    elif px4.stage == "home" and away < 0.5:
        px4.stage = "land"
        px4.landing = True
        controller_goals.sink(v, p["MPC_LAND_SPEED"], steer=True)


def _fly_mission(px4: "Px4") -> None:
    v, p = px4.v, px4.v.parameters
    if px4.stage == "land":
        _land(px4)
        return
    result = px4.route.steer(p["NAV_ACC_RAD"])
    if result == RETURNING:
        px4.intend("RTL")
    elif result == DONE:
        px4.route.restart()
        px4.intend("LOITER")
    elif result == LANDING:
        px4.stage, px4.landing = "land", True
        controller_goals.sink(v, p["MPC_LAND_SPEED"], steer=True)


def steer(px4: "Px4") -> None:
    """Move on within the state that flies."""
    step = _STEERING.get(px4.state)
    if step is not None:
        step(px4)


_STEERING = {
    "TAKEOFF": _take_off,
    "LAND": _land,
    "RTL": _return,
    "MISSION": _fly_mission,
}


def take(px4: "Px4", setpoint: wire.Setpoint) -> None:
    """Take SET_POSITION_TARGET_LOCAL_NED as PX4 does: LOCAL_NED only; NaN is "not given"."""
    if setpoint.frame != _LOCAL_NED or setpoint.mask & 512:
        return
    mask = setpoint.mask
    values = setpoint.values
    total = sum(values)
    if mask & 0x1FF or total - total != 0.0:
        values = tuple(math.nan if mask >> k & 1 else x for k, x in enumerate(values))
        if not _complete(values):
            return
    px4.offboard_at = px4.v.now
    px4.offboard = setpoint
    if px4.state == "OFFBOARD":
        _follow(px4, values)
        _turn(px4, setpoint)


def _turn(px4: "Px4", setpoint: wire.Setpoint) -> None:
    if not setpoint.mask & 1024 and math.isfinite(setpoint.yaw):
        px4.v.bodies.goal_yaw[px4.v.index] = math.pi / 2 - setpoint.yaw


def _follow(px4: "Px4", values: tuple[float, ...]) -> None:
    v = px4.v
    n, e, d, vn, ve, vd, an, ae, ad = values
    total = sum(values)
    if total - total == 0.0:
        v.bodies.aim(v.index, (*v.to_world(n, e, d), ve, vn, -vd, ae, an, -ad))
        px4.all_axes = True
        return
    px4.all_axes = False
    given = [float(math.isfinite(value)) for value in values]
    moved = [max(given[k], given[k + 3]) for k in range(3)]
    n, e, d, vn, ve, vd, an, ae, ad = (u if math.isfinite(u) else 0.0 for u in values)
    v.bodies.aim(
        v.index,
        (*v.to_world(n, e, d), ve, vn, -vd, ae, an, -ad),
        (given[1], given[0], given[2]),
        (moved[1], moved[0], moved[2]),
    )


def _complete(values: tuple[float, ...]) -> bool:
    """Every axis has something, x and y alike (PX4 refuses other combinations)."""
    given = [math.isfinite(value) for value in values]
    kinds = (given[:3], given[3:6], given[6:])
    return all(any(kind[k] for kind in kinds) for k in range(3)) and all(
        kind[0] == kind[1] for kind in kinds
    )
