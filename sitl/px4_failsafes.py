"""What PX4 does when something is lost: battery, ground station, radio, fence.

``failsafe.cpp`` and ``HealthAndArmingChecks``; the actions' numbers are in `sitl.px4_tables`.
"""

import math
from typing import TYPE_CHECKING

from sitl import controller_goals, fences
from sitl.px4_tables import BATTERY, GEOFENCE, LINK_LOSS, MODES

if TYPE_CHECKING:
    from sitl.px4 import Px4

_INFO, _WARNING, _CRITICAL = 6, 4, 2
_NO_STICKS = 4
_EXCEPTIONS = {"MISSION": 1, "LOITER": 2, "OFFBOARD": 4}


def watch_battery(px4: "Px4") -> None:
    """Warn of, and act on, a battery that runs low (BAT_*_THR, COM_LOW_BAT_ACT)."""
    p, v = px4.v.parameters, px4.v
    thresholds = (p["BAT_LOW_THR"], p["BAT_CRIT_THR"], p["BAT_EMERGEN_THR"])
    level = sum(v.charge < threshold for threshold in thresholds)
    if level > px4.battery_level:
        label = ("Low battery level", "Critical battery level", "Dangerous battery level")
        v.text(_WARNING if level == 1 else _CRITICAL, f"{label[level - 1]}\t")
        action = BATTERY[p.integer("COM_LOW_BAT_ACT") % 4][max(level - 2, 0)]
        if v.armed and level >= 2 and action and level > px4.battery_at_arming:
            trigger(px4, action)
    px4.battery_level = max(level, px4.battery_level if v.armed else 0)


def watch_ground_station(px4: "Px4") -> None:
    """Notice a ground station that is heard, lost (NAV_DLL_ACT) and heard again."""
    v, p = px4.v, px4.v.parameters
    latest = max(v.last_heartbeat.values(), default=-math.inf)
    lost = v.now - latest > p["COM_DL_LOSS_T"]
    if not lost and not px4.gcs_seen:
        if px4.gcs_known:
            v.text(_INFO, "GCS connection regained\t")
        px4.gcs_seen = px4.gcs_known = True
    elif lost and px4.gcs_seen:
        px4.gcs_seen = False
        v.text(_INFO, "Connection to ground station lost\t")
        if v.armed:
            _link_lost(px4, "NAV_DLL_ACT", "COM_DLL_EXCEPT")


def watch_radio(px4: "Px4") -> None:
    """Notice a lost radio (NAV_RCL_ACT).

    One that was off when the vehicle armed is optional until it is heard."""
    v, p = px4.v, px4.v.parameters
    if v.radio_heard:
        px4.radio_seen, px4.radio_lost_at = True, None
    elif px4.radio_seen:
        if px4.radio_lost_at is None:
            px4.radio_lost_at = v.now
        if v.now - px4.radio_lost_at >= p["COM_RC_LOSS_T"]:
            px4.radio_seen = False
            v.text(_CRITICAL, "Manual control lost\t")
            if p.integer("COM_RC_IN_MODE") != _NO_STICKS:
                _link_lost(px4, "NAV_RCL_ACT", "COM_RCL_EXCEPT")


def _link_lost(px4: "Px4", action_name: str, except_name: str) -> None:
    p = px4.v.parameters
    action = LINK_LOSS.get(p.integer(action_name))
    excepted = p.integer(except_name) & _EXCEPTIONS.get(px4.intended, 0)
    if action and not excepted and px4.intended != "LAND":
        trigger(px4, action)


def watch_fence(px4: "Px4") -> None:
    """Act when the vehicle leaves its fence: uploaded ones, and GF_MAX_* about home."""
    v, p = px4.v, px4.v.parameters
    outside = beyond_fence(px4)
    if outside and not px4.outside:
        number = p.integer("GF_ACTION")
        if number:
            v.text(_CRITICAL, "Geofence violation\t")
        v.around.event("fence", v.system)
        action = GEOFENCE.get(number)
        if action:
            trigger(px4, action)
    px4.outside = outside


def beyond_fence(px4: "Px4") -> bool:
    """Whether the vehicle is outside a fence now."""
    v, p = px4.v, px4.v.parameters
    if not v.global_valid:
        return False
    level, upright = p["GF_MAX_HOR_DIST"], p["GF_MAX_VER_DIST"]
    if not v.fence and level <= 0 and upright <= 0:
        return False
    here = v.estimated()
    if v.home is not None:
        away = here - v.home
        if level > 0 and math.hypot(away[0], away[1]) > level:
            return True
        if upright > 0 and away[2] > upright:
            return True
    return fences.breached(v.fence, float(here[0]), float(here[1]))


def trigger(px4: "Px4", action: str) -> None:
    """Start a failsafe: Hold for COM_FAIL_ACT_T while a pilot could take over, then act."""
    v = px4.v
    if action == "DISARM":
        px4.disarm("Disarmed by failsafe")
    elif action == "TERMINATION":
        px4.terminate()
    elif px4.latched != action:
        wait = v.parameters["COM_FAIL_ACT_T"] if action != "LOITER" else 0.0
        px4.latched = "LOITER" if wait > 0 else action
        px4.delayed = action
        px4.delay_until = v.now + wait
        v.text(_CRITICAL, f"Failsafe activated: {MODES[action].label}\t")
        if px4.state == "LOITER" and px4.goal is not None:
            px4.goal = None
            controller_goals.hold(v)
