"""PX4's health and arming checks: the requirements of modes, the fence, the reason of a refusal."""

import math

from sitl.autopilots.px4.state import Px4State
from sitl.autopilots.px4.tables import MODES
from sitl.protocol import fences

_UNHEALTHY = "Resolve system health failures first"


def offboard_signal(px4: Px4State) -> bool:
    """Return whether the setpoint stream is alive (COM_OF_LOSS_T)."""
    return px4.v.now - px4.offboard_at <= px4.v.parameters["COM_OF_LOSS_T"]


def meets(px4: Px4State, requirement: str) -> bool:
    """Return whether a requirement of a mode is met."""
    v = px4.v
    if requirement == "offboard":
        return offboard_signal(px4) and v.local_valid
    if requirement == "local":
        return v.local_valid
    if requirement == "global":
        return v.global_valid
    if requirement == "home":
        return v.home is not None
    if requirement == "mission":
        return bool(v.mission[0])
    return (px4.pilot or v.spec.radio) and not v.radio_lost


def can_run(px4: Px4State, mode: str) -> bool:
    """Return whether all requirements of a mode are met."""
    return all(meets(px4, requirement) for requirement in MODES[mode].requires)


def refusal(px4: Px4State) -> str | None:
    """Return why PX4 would deny arming now, None if it would arm."""
    v = px4.v
    if v.now < px4.ready_at:
        return _UNHEALTHY
    if v.refuse_arming:
        return v.refuse_arming
    if MODES[px4.intended].prevents_arming:
        return f"Mode '{MODES[px4.intended].label}' prevents arming"
    alone = not px4.gcs_connected and v.parameters["NAV_DLL_ACT"] > 0
    weak = px4.battery_level >= 2 or beyond_fence(px4)
    if alone or weak or not can_run(px4, px4.intended) or v.bodies.crashed[v.index]:
        return _UNHEALTHY
    return None


def beyond_fence(px4: Px4State) -> bool:
    """Return whether the vehicle is outside a fence: an uploaded one, or GF_MAX_* around home."""
    v, p = px4.v, px4.v.parameters
    if not v.global_valid:
        return False
    horizontal, vertical = p["GF_MAX_HOR_DIST"], p["GF_MAX_VER_DIST"]
    if not v.fence and horizontal <= 0 and vertical <= 0:
        return False
    here = v.estimated()
    if v.home is not None:
        away = here - v.home
        if horizontal > 0 and math.hypot(away[0], away[1]) > horizontal:
            return True
        if vertical > 0 and away[2] > vertical:
            return True
    return fences.breached(v.fence, float(here[0]), float(here[1]))
