"""What ArduCopter does when something is lost: ground station, radio, battery, position, fence.

``ArduCopter/events.cpp``, ``ekf_check.cpp``, ``fence.cpp`` and ``AC_Fence``; the actions' numbers
are in `sitl.ardupilot_tables`.
"""

import math
from typing import TYPE_CHECKING

from sitl import fences
from sitl.ardupilot_tables import (
    AUTO,
    BATTERY,
    DEAD_RECKONING,
    FENCE,
    GROUND_STATION_LOSS,
    GUIDED,
    LAND,
    MODES,
    RADIO_LOSS,
    RTL,
)

if TYPE_CHECKING:
    from sitl.ardupilot import ArduPilot

_WARNING, _CRITICAL = 4, 2
# FS_OPTIONS
_RADIO_IN_AUTO, _GCS_IN_AUTO, _RADIO_IN_GUIDED, _WHILE_LANDING, _GCS_WITH_PILOT, _LET_GO = (
    1, 2, 4, 8, 16, 32,
)  # fmt: skip
_ALTITUDE, _CIRCLE, _POLYGON = 1, 2, 4
_FENCES = {_ALTITUDE: "Max Alt", _CIRCLE: "Circle", _POLYGON: "Polygon"}


def watch(copter: "ArduPilot") -> None:
    """Look at everything that can be lost, a few times a second while armed."""
    v = copter.v
    watch_ground_station(copter)
    _watch_radio(copter)
    _watch_fence(copter)
    _watch_battery(copter)
    if v.local_valid and v.global_valid:
        copter.lost_at = None
    elif not v.around.indoor or not v.local_valid:
        _watch_position(copter)


def watch_ground_station(copter: "ArduPilot") -> None:
    """Notice a ground station that is lost (FS_GCS_ENABLE), and heard again, armed or not."""
    v, p = copter.v, copter.v.parameters
    latest = v.last_heartbeat.get(p.integer("SYSID_MYGCS"), -math.inf)
    if v.now - latest <= p["FS_GCS_TIMEOUT"]:
        copter.gcs_seen = True
        if copter.gcs_lost:
            copter.gcs_lost = False
            v.text(_WARNING, "GCS Failsafe Cleared")
    elif copter.gcs_seen:
        copter.gcs_seen = False
        _ground_station_lost(copter)


def _ground_station_lost(copter: "ArduPilot") -> None:
    v, p = copter.v, copter.v.parameters
    action = GROUND_STATION_LOSS.get(p.integer("FS_GCS_ENABLE"))
    if action is None:
        return
    copter.gcs_lost = True
    if v.landed:
        v.text(_WARNING, "GCS Failsafe - Disarming" if v.armed else "GCS Failsafe")
        copter.disarm("ground station lost")
        return
    options = p.integer("FS_OPTIONS")
    by_hand = not MODES[copter.mode].by_itself
    if copter.mode == LAND:
        return
    if (copter.mode == AUTO and options & _GCS_IN_AUTO) or (by_hand and options & _GCS_WITH_PILOT):
        kept = "Auto Mode" if copter.mode == AUTO else "Pilot Control"
        v.text(_WARNING, f"GCS Failsafe - Continuing {kept}")
        return
    v.text(_WARNING, "GCS Failsafe")
    fail_to(copter, action)


def _watch_radio(copter: "ArduPilot") -> None:
    """A pilot's radio that was heard and is no more (FS_THR_ENABLE, FS_OPTIONS)."""
    v, p = copter.v, copter.v.parameters
    if v.radio_heard:
        copter.radio_seen = True
        return
    if not copter.radio_seen:
        return
    copter.radio_seen = False
    action = RADIO_LOSS.get(p.integer("FS_THR_ENABLE"), LAND)
    options = p.integer("FS_OPTIONS")
    if action is None:
        return
    if v.landed:
        v.text(_WARNING, "Radio Failsafe - Disarming")
        copter.disarm("radio failsafe")
    elif copter.mode == LAND and (options & _WHILE_LANDING or copter.failsafe):
        v.text(_WARNING, "Radio Failsafe - Continuing Landing")
    elif copter.mode == AUTO and options & _RADIO_IN_AUTO:
        v.text(_WARNING, "Radio Failsafe - Continuing Auto Mode")
    elif copter.mode == GUIDED and options & _RADIO_IN_GUIDED:
        v.text(_WARNING, "Radio Failsafe - Continuing Guided Mode")
    else:
        v.text(_WARNING, "Radio Failsafe")
        fail_to(copter, action)


def _watch_fence(copter: "ArduPilot") -> None:
    """A fence that has just been left (FENCE_ACTION); far outside it lands at once."""
    v, p = copter.v, copter.v.parameters
    outside = beyond_fence(copter)
    fresh = outside & ~copter.outside
    copter.outside = outside
    if not fresh:
        return
    names = " and ".join(name for bit, name in _FENCES.items() if fresh & bit)
    v.text(_WARNING, f"{names} fence breached")
    v.around.event("fence", v.system)
    action = FENCE.get(p.integer("FENCE_ACTION"))
    if action is None:
        return
    if v.landed:
        copter.disarm("fence breached")
    else:
        fail_to(copter, action)


def beyond_fence(copter: "ArduPilot") -> int:
    """Which fences (bits of FENCE_TYPE) the vehicle is outside of now."""
    v, p = copter.v, copter.v.parameters
    if not p.integer("FENCE_ENABLE") or not copter.position_ok():
        return 0
    here, home = v.estimated(), v.home if v.home is not None else v.origin
    found = 0
    if here[2] - home[2] > p["FENCE_ALT_MAX"]:
        found |= _ALTITUDE
    if math.hypot(here[0] - home[0], here[1] - home[1]) > p["FENCE_RADIUS"]:
        found |= _CIRCLE
    if fences.breached(v.fence, float(here[0]), float(here[1])):
        found |= _POLYGON
    return found & p.integer("FENCE_TYPE")


def _watch_battery(copter: "ArduPilot") -> None:
    v, p = copter.v, copter.v.parameters
    left = v.charge * p["BATT_CAPACITY"]
    levels = (("LOW", "low"), ("CRT", "critical"))
    for level, (key, word) in enumerate(levels, start=1):
        volts, charge = p[f"BATT_{key}_VOLT"], p[f"BATT_{key}_MAH"]
        if v.voltage >= volts and left >= charge:
            copter.battery_low_at[level] = math.inf
            continue
        copter.battery_low_at[level] = since = min(v.now, copter.battery_low_at[level])
        if level > copter.battery_level and v.now - since >= p["BATT_LOW_TIMER"]:
            copter.battery_level = level
            v.text(_WARNING, f"Battery 1 is {word} {v.voltage:.2f}V used {5000 - left:.0f} mAh")
            action = BATTERY.get(p.integer(f"BATT_FS_{key}_ACT"))
            if action is not None and not v.landed:
                fail_to(copter, action)


def _watch_position(copter: "ArduPilot") -> None:
    """Without GPS: dead reckoning (FS_DR_ENABLE), then the estimator fails (FS_EKF_ACTION)."""
    v, p = copter.v, copter.v.parameters
    if copter.lost_at is None:
        copter.lost_at = v.now
        action = DEAD_RECKONING.get(p.integer("FS_DR_ENABLE"))
        if action is not None and not v.landed and v.local_valid:
            v.text(_WARNING, "Dead Reckoning started")
            fail_to(copter, action)
    patience = 1.0 if not v.local_valid else p["FS_DR_TIMEOUT"]
    if v.now - copter.lost_at > patience and copter.mode != LAND:
        v.text(_CRITICAL, "EKF Failsafe")
        if p.integer("FS_EKF_ACTION") in {1, 3} and not v.landed:
            fail_to(copter, LAND)


def fail_to(copter: "ArduPilot", mode: int) -> None:
    """Change the mode as a failsafe does; the gripper opens with it where FS_OPTIONS says so."""
    v = copter.v
    if v.parameters.integer("FS_OPTIONS") & _LET_GO:
        v.start_gripper(False, None, 0, 0, 0.0)
    if mode == RTL and (not copter.position_ok() or v.home is None):
        mode = LAND
    copter.change(mode, failsafe=True)
