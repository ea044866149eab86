"""PX4's failsafes: battery, ground station, radio, fence.

``failsafe.cpp`` and ``HealthAndArmingChecks``; the numbers of actions are in
`sitl.autopilots.px4.tables`.
"""

import math

from sitl.autopilots.px4 import checks, modes
from sitl.autopilots.px4.state import CRITICAL, EMERGENCY, INFO, Px4State
from sitl.autopilots.px4.tables import BATTERY, GEOFENCE, LINK_LOSS

_NO_STICKS = 4
_EXCEPTIONS = {"MISSION": 1, "LOITER": 2, "OFFBOARD": 4}

_ALIVE = 1.9
"""Seconds after its last heartbeat for which a ground station counts as connected: 1.25 to 2.5 s,
the latest of checks 1.25 s apart."""


def watch_battery(px4: Px4State) -> None:
    """Report a low battery and act on it (BAT_*_THR, COM_LOW_BAT_ACT)."""
    p, v = px4.v.parameters, px4.v
    thresholds = (p["BAT_LOW_THR"], p["BAT_CRIT_THR"], p["BAT_EMERGEN_THR"])
    level = sum(v.charge < threshold for threshold in thresholds)
    if level > px4.battery_level:
        label = ("Low battery", "Critical battery", "Emergency battery level")
        v.text(EMERGENCY, f"{label[level - 1]}\t")
        action = BATTERY[p.integer("COM_LOW_BAT_ACT") % 4][max(level - 2, 0)]
        if v.armed and level >= 2 and action and level > px4.battery_at_arming:
            modes.trigger(px4, action)
        elif v.armed:
            # a warning is a failsafe without an action, and is reported as the others are
            v.text(CRITICAL, "Failsafe activated\t")
    px4.battery_level = max(level, px4.battery_level if v.armed else 0)


def watch_ground_station(px4: Px4State) -> None:
    """Detect the connection, loss (NAV_DLL_ACT) and return of the ground station."""
    v, p = px4.v, px4.v.parameters
    latest = max(v.last_heartbeat.values(), default=-math.inf)
    lost = v.now - latest > p["COM_DL_LOSS_T"] + _ALIVE
    if not lost and not px4.gcs_connected:
        v.muted = False
        if px4.gcs_known:
            v.text(INFO, "GCS connection regained\t")
        px4.gcs_connected = px4.gcs_known = True
    elif lost and px4.gcs_connected:
        px4.gcs_connected = False
        v.muted = True
        if v.armed:
            _link_lost(px4, "NAV_DLL_ACT", "COM_DLL_EXCEPT")


def watch_radio(px4: Px4State) -> None:
    """Detect a lost radio (NAV_RCL_ACT).

    A radio that was off when the vehicle armed is optional until its first signal.
    """
    v, p = px4.v, px4.v.parameters
    if v.radio_connected:
        px4.radio_known, px4.radio_lost_at = True, None
    elif px4.radio_known:
        if px4.radio_lost_at is None:
            px4.radio_lost_at = v.now
        if v.now - px4.radio_lost_at >= p["COM_RC_LOSS_T"]:
            px4.radio_known = False  # an event says so, no text
            if p.integer("COM_RC_IN_MODE") != _NO_STICKS:
                _link_lost(px4, "NAV_RCL_ACT", "COM_RCL_EXCEPT")


def _link_lost(px4: Px4State, action_name: str, except_name: str) -> None:
    p = px4.v.parameters
    action = LINK_LOSS.get(p.integer(action_name))
    excepted = p.integer(except_name) & _EXCEPTIONS.get(px4.intended, 0)
    if action and not excepted and px4.intended != "LAND":
        modes.trigger(px4, action)


def watch_fence(px4: Px4State) -> None:
    """Act when the vehicle leaves a fence (GF_ACTION)."""
    v, p = px4.v, px4.v.parameters
    outside = checks.beyond_fence(px4)
    if outside and not px4.outside_fence:
        number = p.integer("GF_ACTION")
        if number:
            v.text(CRITICAL, "Geofence violation\t")
        v.environment.event("fence", v.system)
        action = GEOFENCE.get(number)
        if action:
            modes.trigger(px4, action)
    px4.outside_fence = outside
