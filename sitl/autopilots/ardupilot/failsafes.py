"""ArduCopter's failsafes: ground station, radio, battery, position, fence.

``ArduCopter/events.cpp``, ``ekf_check.cpp``, ``fence.cpp`` and ``AC_Fence``; the numbers of actions
are in `sitl.autopilots.ardupilot.tables`.
"""

import math

from sitl.autopilots.ardupilot import checks, modes
from sitl.autopilots.ardupilot.state import CRITICAL, WARNING, ArduPilotState
from sitl.autopilots.ardupilot.tables import (
    AUTO,
    BATTERY,
    FENCE,
    GROUND_STATION_LOSS,
    GUIDED,
    LAND,
    MODES,
    RADIO_LOSS,
)

_RADIO_IN_AUTO, _GCS_IN_AUTO, _RADIO_IN_GUIDED, _WHILE_LANDING, _GCS_WITH_PILOT = 1, 2, 4, 8, 16
"""FS_OPTIONS: conditions in which a failsafe does not change the mode."""
_RADIO_TIMEOUT = 1.0
"""Seconds without pulses until a radio counts as lost: RC_FS_TIMEOUT's default; measured."""
_ESTIMATOR_TIMEOUT = 8.0
"""Seconds without a receiver until the estimator's variances are a failure: measured on 4.6.2.

The dead reckoning failsafe (FS_DR_ENABLE) does not come before it: it needs an estimate of the
wind (EK3_DRAG_BCOEF_X), which multicopters have only where somebody has measured their drag."""
_FENCES = {checks.ALTITUDE: "Max Alt", checks.CIRCLE: "Circle", checks.POLYGON: "Polygon"}


def watch(copter: ArduPilotState) -> None:
    """Check all failsafes; called a few times a second while armed."""
    v = copter.v
    watch_ground_station(copter)
    _watch_radio(copter)
    _watch_fence(copter)
    _watch_battery(copter)
    if v.local_valid and v.global_valid:
        copter.position_lost_at = None
    elif not v.environment.indoor or not v.local_valid:
        _watch_position(copter)


def watch_ground_station(copter: ArduPilotState) -> None:
    """Detect the loss (FS_GCS_ENABLE) and return of the ground station, armed or not."""
    v, p = copter.v, copter.v.parameters
    latest = v.last_heartbeat.get(p.integer("SYSID_MYGCS"), -math.inf)
    if v.now - latest <= p["FS_GCS_TIMEOUT"]:
        copter.gcs_connected = True
        if copter.gcs_lost:
            copter.gcs_lost = False
            v.text(WARNING, "GCS Failsafe Cleared")
    elif copter.gcs_connected:
        copter.gcs_connected = False
        _ground_station_lost(copter)


def _ground_station_lost(copter: ArduPilotState) -> None:
    v, p = copter.v, copter.v.parameters
    action = GROUND_STATION_LOSS.get(p.integer("FS_GCS_ENABLE"))
    if action is None:
        return
    copter.gcs_lost = True
    if v.landed:
        v.text(WARNING, "GCS Failsafe - Disarming" if v.armed else "GCS Failsafe")
        modes.disarm(copter, "ground station lost")
        return
    options = p.integer("FS_OPTIONS")
    manual = not MODES[copter.mode].autonomous
    if copter.mode == LAND:
        return
    if (copter.mode == AUTO and options & _GCS_IN_AUTO) or (manual and options & _GCS_WITH_PILOT):
        kept = "Auto Mode" if copter.mode == AUTO else "Pilot Control"
        v.text(WARNING, f"GCS Failsafe - Continuing {kept}")
        return
    v.text(WARNING, "GCS Failsafe")
    modes.fail_to(copter, action)


def _watch_radio(copter: ArduPilotState) -> None:
    """Detect the loss of a pilot's radio that was connected (FS_THR_ENABLE, FS_OPTIONS)."""
    v, p = copter.v, copter.v.parameters
    if v.radio_connected:
        copter.radio_known, copter.radio_lost_at, copter.radio_failed = True, None, False
        return
    if not copter.radio_known:
        return
    if copter.radio_lost_at is None:
        copter.radio_lost_at = v.now
    if v.now - copter.radio_lost_at < _RADIO_TIMEOUT:
        return
    copter.radio_known, copter.radio_failed = False, True
    action = RADIO_LOSS.get(p.integer("FS_THR_ENABLE"), LAND)
    options = p.integer("FS_OPTIONS")
    if action is None:
        return
    if v.landed:
        v.text(WARNING, "Radio Failsafe - Disarming")
        modes.disarm(copter, "radio failsafe")
    elif copter.mode == LAND and (options & _WHILE_LANDING or copter.failsafe):
        v.text(WARNING, "Radio Failsafe - Continuing Landing")
    elif copter.mode == AUTO and options & _RADIO_IN_AUTO:
        v.text(WARNING, "Radio Failsafe - Continuing Auto Mode")
    elif copter.mode == GUIDED and options & _RADIO_IN_GUIDED:
        v.text(WARNING, "Radio Failsafe - Continuing Guided Mode")
    else:
        v.text(WARNING, "Radio Failsafe")
        modes.fail_to(copter, action)


def _watch_fence(copter: ArduPilotState) -> None:
    """Act when the vehicle leaves a fence (FENCE_ACTION)."""
    v, p = copter.v, copter.v.parameters
    outside = checks.beyond_fence(copter)
    fresh = outside & ~copter.outside_fences
    copter.outside_fences = outside
    if not fresh:
        return
    names = " and ".join(name for bit, name in _FENCES.items() if fresh & bit)
    v.text(WARNING, f"{names} fence breached")
    v.environment.event("fence", v.system)
    action = FENCE.get(p.integer("FENCE_ACTION"))
    if action is None:
        return
    if v.landed:
        modes.disarm(copter, "fence breached")
    else:
        modes.fail_to(copter, action)


def _watch_battery(copter: ArduPilotState) -> None:
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
            v.text(WARNING, f"Battery 1 is {word} {v.voltage:.2f}V used {5000 - left:.0f} mAh")
            if not v.landed:
                v.text(WARNING, "Battery Failsafe")
            action = BATTERY.get(p.integer(f"BATT_FS_{key}_ACT"))
            if action is not None and not v.landed:
                modes.fail_to(copter, action)


def _watch_position(copter: ArduPilotState) -> None:
    """Without GPS: an estimator failure (FS_EKF_ACTION), once."""
    v, p = copter.v, copter.v.parameters
    if copter.position_lost_at is None:
        copter.position_lost_at = v.now
    timeout = 1.0 if not v.local_valid else _ESTIMATOR_TIMEOUT
    if v.now - copter.position_lost_at > timeout and copter.mode != LAND:
        copter.position_lost_at = math.inf
        v.text(CRITICAL, "EKF variance")
        if p.integer("FS_EKF_ACTION") in {1, 3} and not v.landed:
            v.text(CRITICAL, "EKF Failsafe: changed to LAND Mode")
            modes.fail_to(copter, LAND)
        else:
            v.text(CRITICAL, "EKF Failsafe")
