"""PX4's navigator: controller goals of each mode.

`begin` and `steer` return the mode that follows when the active one has ended, None otherwise.
"""

from collections.abc import Callable

import numpy as np

from sitl.autopilots import controller_goals, mission_flight
from sitl.autopilots.mission_flight import DONE, LANDING, RETURNING
from sitl.autopilots.px4 import setpoints
from sitl.autopilots.px4.state import Px4State


def begin(px4: Px4State) -> str | None:
    """Set limits and goals of a mode that has just become active while armed."""
    v, p, mode = px4.v, px4.v.parameters, px4.mode
    b, i = v.bodies, v.index
    b.may_lift[i] = mode in {"OFFBOARD", "TAKEOFF", "POSCTL", "MISSION"}
    controller_goals.limits(v, p["MPC_XY_CRUISE"], p["MPC_Z_V_AUTO_UP"], p["MPC_Z_V_AUTO_DN"])
    px4.all_axes = False
    if mode == "OFFBOARD":
        up, down = p["MPC_Z_VEL_MAX_UP"], p["MPC_Z_VEL_MAX_DN"]
        controller_goals.limits(v, p["MPC_XY_VEL_MAX"], up, down)
        if px4.offboard is not None:
            received = px4.offboard_at
            setpoints.accept(px4, px4.offboard)
            px4.offboard_at = received
    elif mode == "TAKEOFF" and px4.goal is not None:
        controller_goals.limits(v, p["MPC_XY_CRUISE"], p["MPC_TKO_SPEED"], p["MPC_Z_V_AUTO_DN"])
        controller_goals.go(v, px4.goal)
    elif mode == "LOITER" and px4.goal is not None:
        controller_goals.go(v, px4.goal)
    elif mode == "MISSION":
        controller_goals.hold(v)
        return _fly_mission(px4)
    elif mode == "LAND":
        controller_goals.hold(v)
        controller_goals.descend(v, p["MPC_LAND_SPEED"], steer=True)
    elif mode == "DESCEND":
        controller_goals.descend(v, p["MPC_LAND_SPEED"], steer=False)
    elif mode != "TERMINATION":
        controller_goals.hold(v)
    return None


def steer(px4: Px4State) -> str | None:
    """Update the goals of the active mode."""
    step = _STEPS.get(px4.mode)
    return None if step is None else step(px4)


def _take_off(px4: Px4State) -> str | None:
    v = px4.v
    if px4.goal is not None and abs(float(v.estimated()[2] - px4.goal[2])) < 0.3:
        return "LOITER"
    return None


def _land(px4: Px4State) -> None:
    """Descend; the rate falls linearly from MPC_LAND_ALT1 to MPC_LAND_ALT2 above home."""
    v, p = px4.v, px4.v.parameters
    home = v.home[2] if v.home is not None else v.origin[2]
    height = float(v.estimated()[2] - home)
    slow, fast = p["MPC_LAND_SPEED"], p["MPC_Z_V_AUTO_DN"]
    low, high = p["MPC_LAND_ALT2"], p["MPC_LAND_ALT1"]
    share = min(1.0, max(0.0, (height - low) / max(high - low, 1e-3)))
    v.bodies.set_climb_rate(v.index, -(slow + share * (fast - slow)))


def _return(px4: Px4State) -> None:
    """Climb to the return altitude, fly home, descend, land."""
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
        controller_goals.descend(v, p["MPC_LAND_SPEED"], steer=True)


def _fly_mission(px4: Px4State) -> str | None:
    v, p = px4.v, px4.v.parameters
    if px4.stage == "land":
        _land(px4)
        return None
    result = mission_flight.steer(v, p["NAV_ACC_RAD"])
    if result == RETURNING:
        return "RTL"
    if result == DONE:
        v.mission_progress.restart()
        return "LOITER"
    if result == LANDING:
        px4.stage, px4.landing = "land", True
        controller_goals.descend(v, p["MPC_LAND_SPEED"], steer=True)
    return None


_STEPS: dict[str, Callable[[Px4State], str | None]] = {
    "TAKEOFF": _take_off,
    "LAND": _land,
    "RTL": _return,
    "MISSION": _fly_mission,
}
