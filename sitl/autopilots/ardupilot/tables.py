"""ArduCopter's modes, failsafe actions, default parameters and stream groups, as data."""

from dataclasses import dataclass

from sitl.protocol.parameters import INT8, INT16, INT32


@dataclass(frozen=True)
class Mode:
    """One flight mode: its name, whether it requires a position, allows arming, is autonomous."""

    name: str
    position: bool
    armable: bool
    autonomous: bool = False


MODES: dict[int, Mode] = {
    0: Mode("STABILIZE", False, True),
    1: Mode("ACRO", False, True),
    2: Mode("ALT_HOLD", False, True),
    3: Mode("AUTO", True, False, autonomous=True),
    4: Mode("GUIDED", True, True, autonomous=True),
    5: Mode("LOITER", True, True),
    6: Mode("RTL", True, False, autonomous=True),
    9: Mode("LAND", False, False, autonomous=True),
    16: Mode("POSHOLD", True, True),
    17: Mode("BRAKE", True, False, autonomous=True),
}
STABILIZE, AUTO, GUIDED, LOITER, RTL, LAND, BRAKE = 0, 3, 4, 5, 6, 9, 17

GROUND_STATION_LOSS = {0: None, 1: RTL, 2: RTL, 3: RTL, 4: LAND, 5: LAND, 6: LAND, 7: BRAKE}
"""FS_GCS_ENABLE; SmartRTL does not exist here and falls back as documented."""
RADIO_LOSS = {0: None, 1: RTL, 2: RTL, 3: LAND, 4: RTL, 5: LAND, 6: RTL, 7: BRAKE}
"""FS_THR_ENABLE."""
FENCE = {0: None, 1: RTL, 2: LAND, 3: RTL, 4: BRAKE, 5: LAND}
"""FENCE_ACTION."""
BATTERY = {0: None, 1: LAND, 2: RTL, 3: RTL, 4: LAND, 6: LAND, 7: BRAKE}
"""BATT_FS_LOW_ACT and BATT_FS_CRT_ACT."""
"""FS_DR_ENABLE."""

PARAMETERS: dict[str, float | int] = {
    "ANGLE_MAX": 3000, "ARMING_CHECK": 1, "AUTO_OPTIONS": 0, "BATT_CAPACITY": 5000,
    "BATT_CRT_MAH": 0.0, "BATT_CRT_VOLT": 0.0, "BATT_FS_CRT_ACT": 0, "BATT_FS_LOW_ACT": 0,
    "BATT_LOW_MAH": 0.0, "BATT_LOW_VOLT": 10.5, "BATT_LOW_TIMER": 10, "BATT_MONITOR": 4,
    "BRD_SAFETY_DEFLT": 0,
    "DISARM_DELAY": 10, "EK3_ENABLE": 1, "EK3_SRC1_POSXY": 3, "EK3_SRC1_POSZ": 1,
    "EK3_SRC1_VELXY": 3, "EK3_SRC1_VELZ": 3, "EK3_SRC1_YAW": 1, "FENCE_ACTION": 1,
    "FENCE_ALT_MAX": 100.0, "FENCE_ENABLE": 0, "FENCE_RADIUS": 300.0, "FENCE_TYPE": 7,
    "FLIGHT_OPTIONS": 0, "FRAME_CLASS": 1, "FRAME_TYPE": 1, "FS_CRASH_CHECK": 1, "FS_DR_ENABLE": 2,
    "FS_DR_TIMEOUT": 30, "FS_EKF_ACTION": 1, "FS_EKF_THRESH": 0.8, "FS_GCS_ENABLE": 0,
    "FS_GCS_TIMEOUT": 5.0, "FS_OPTIONS": 16, "FS_THR_ENABLE": 1, "FS_THR_VALUE": 975,
    "FS_VIBE_ENABLE": 1, "GPS1_TYPE": 1, "GRIP_ENABLE": 1, "GRIP_TYPE": 1, "GUID_OPTIONS": 0,
    "GUID_TIMEOUT": 3.0, "INITIAL_MODE": 0, "INS_ACCOFFS_X": 0.001, "INS_ACC_ID": 2753028,
    "LAND_ALT_LOW": 1000, "LAND_SPEED": 50, "LAND_SPEED_HIGH": 0, "LOIT_SPEED": 1250.0,
    "LOG_BACKEND_TYPE": 1, "MOT_SPIN_ARM": 0.1, "MOT_SPOOL_TIME": 0.5, "MOT_THST_HOVER": 0.39,
    "PILOT_SPEED_DN": 0, "PILOT_SPEED_UP": 250, "PILOT_TKOFF_ALT": 0.0, "PSC_ACCZ_I": 1.0,
    "PSC_ACCZ_P": 0.5, "PSC_JERK_XY": 5.0, "PSC_POSXY_P": 1.0, "PSC_POSZ_P": 1.0,
    "PSC_VELXY_D": 0.5, "PSC_VELXY_I": 1.0, "PSC_VELXY_P": 2.0, "PSC_VELZ_P": 5.0,
    "RCMAP_THROTTLE": 3, "RTL_ALT": 1500, "RTL_ALT_FINAL": 0, "RTL_LOIT_TIME": 5000,
    "RTL_SPEED": 0, "SCHED_LOOP_RATE": 400, "SERIAL0_PROTOCOL": 2, "SERVO9_FUNCTION": 28,
    "SR0_EXTRA1": 0, "SR0_POSITION": 0, "SYSID_ENFORCE": 0,
    "SYSID_MYGCS": 255, "SYSID_THISMAV": 1, "TKOFF_SLEW_TIME": 2.0, "WPNAV_ACCEL": 250.0,
    "WPNAV_ACCEL_Z": 100.0, "WPNAV_JERK": 1.0, "WPNAV_RADIUS": 200.0, "WPNAV_SPEED": 1000.0,
    "WPNAV_SPEED_DN": 150.0, "WPNAV_SPEED_UP": 250.0, "WP_YAW_BEHAVIOR": 2,
}  # fmt: skip
_INT32_NAMES = (
    "ARMING_CHECK", "AUTO_OPTIONS", "BATT_CAPACITY", "FLIGHT_OPTIONS", "FS_OPTIONS",
    "GUID_OPTIONS", "RTL_ALT", "RTL_LOIT_TIME",
)  # fmt: skip
_INT16_NAMES = ("FS_DR_TIMEOUT", "SERVO9_FUNCTION", "SR0_EXTRA1", "SR0_POSITION", "SYSID_THISMAV")
KINDS = {
    name: INT16 if abs(value) > 100 or "SPEED" in name or "ALT" in name else INT8
    for name, value in PARAMETERS.items()
    if isinstance(value, int) and abs(value) < 32768
}
KINDS |= dict.fromkeys(_INT32_NAMES, INT32) | dict.fromkeys(_INT16_NAMES, INT16)
KINDS |= dict.fromkeys(("SIM_ENGINE_FAIL", "SIM_RC_FAIL"), INT8)

_ALWAYS: dict[str, float] = {"HEARTBEAT": 1, "TIMESYNC": 0.1}
STREAMS: dict[str, dict[str, float]] = {"onboard": _ALWAYS, "gcs": _ALWAYS}
_STATUS = ("SYS_STATUS", "MISSION_CURRENT", "GPS_RAW_INT", "NAV_CONTROLLER_OUTPUT")
_PLACE = ("GLOBAL_POSITION_INT", "LOCAL_POSITION_NED")
_CHANNELS = ("SERVO_OUTPUT_RAW", "RC_CHANNELS")
_EXTRA3 = ("BATTERY_STATUS", "SYSTEM_TIME", "EKF_STATUS_REPORT")
DATA_STREAMS: dict[int, tuple[str, ...]] = {
    0: (*_STATUS, *_CHANNELS, *_PLACE, "ATTITUDE", "VFR_HUD", *_EXTRA3),
    2: _STATUS,
    3: _CHANNELS,
    6: _PLACE,
    10: ("ATTITUDE",),
    11: ("VFR_HUD",),
    12: _EXTRA3,
}
