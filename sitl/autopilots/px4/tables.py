"""PX4's modes, failsafe actions, default parameters and default streams, as data."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Mode:
    """One flight mode: its numbers, its label in texts and its requirements."""

    main: int
    sub: int
    label: str
    requires: frozenset[str]
    prevents_arming: bool = False


def _mode(main: int, sub: int, label: str, *requires: str, prevents_arming: bool = False) -> Mode:
    return Mode(main, sub, label, frozenset(requires), prevents_arming)


MODES: dict[str, Mode] = {
    "MANUAL": _mode(1, 0, "Manual", "pilot"),
    "ALTCTL": _mode(2, 0, "Altitude", "pilot"),
    "POSCTL": _mode(3, 0, "Position", "pilot", "local"),
    "TAKEOFF": _mode(4, 2, "Takeoff", "local"),
    "LOITER": _mode(4, 3, "Hold", "local", "global"),
    "MISSION": _mode(4, 4, "Mission", "local", "global", "mission"),
    "RTL": _mode(4, 5, "Return", "local", "global", "home", prevents_arming=True),
    "LAND": _mode(4, 6, "Land", "local", prevents_arming=True),
    "DESCEND": _mode(4, 6, "Descend", prevents_arming=True),
    "ACRO": _mode(5, 0, "Acro", "pilot"),
    "OFFBOARD": _mode(6, 0, "Offboard", "offboard"),
    "STABILIZED": _mode(7, 0, "Stabilized", "pilot"),
    "TERMINATION": _mode(1, 0, "Termination", prevents_arming=True),
}
BY_NUMBER = {(mode.main, mode.sub): name for name, mode in MODES.items() if name != "DESCEND"}
BY_NUMBER[(1, 0)] = "MANUAL"
BY_NUMBER[(4, 6)] = "LAND"

STANDARD_MODES = {(3, 0): 1, (2, 0): 4, (4, 5): 5, (4, 4): 6, (4, 6): 7, (4, 2): 8}
"""MAV_STANDARD_MODE by main and sub mode; other modes have none."""

FALLBACK = {"LOITER": "RTL", "RTL": "LAND", "LAND": "DESCEND"}
"""The mode that replaces one that cannot run (failsafe framework)."""

OFFBOARD_LOSS = {0: "POSCTL", 1: "ALTCTL", 2: "STABILIZED", 3: "RTL", 4: "LAND", 5: "LOITER",
                 6: "TERMINATION", 7: "DISARM"}  # fmt: skip
"""COM_OBL_RC_ACT: action after the loss of the offboard signal; 0–2 need a pilot's sticks."""
LINK_LOSS = {0: None, 1: "LOITER", 2: "RTL", 3: "LAND", 5: "TERMINATION", 6: "DISARM"}
"""NAV_DLL_ACT and NAV_RCL_ACT."""
GEOFENCE = {2: "LOITER", 3: "RTL", 4: "TERMINATION", 5: "LAND"}
"""GF_ACTION: 1 only warns."""
BATTERY: dict[int, tuple[str | None, str | None]] = {
    0: (None, None),
    1: ("RTL", "RTL"),
    2: ("LAND", "LAND"),
    3: ("RTL", "LAND"),
}
"""COM_LOW_BAT_ACT: actions at critical and at emergency level."""

PARAMETERS: dict[str, float | int] = {
    "BAT1_CAPACITY": 5000.0, "BAT1_N_CELLS": 4, "BAT_CRIT_THR": 0.07, "BAT_EMERGEN_THR": 0.05,
    "BAT_LOW_THR": 0.15, "CBRK_FLIGHTTERM": 121212, "CBRK_SUPPLY_CHK": 894281,
    "COM_ACT_FAIL_ACT": 0, "COM_ARM_WO_GPS": 1, "COM_DISARM_LAND": 2.0,
    "COM_DISARM_PRFLT": 10.0, "COM_DL_LOSS_T": 10, "COM_FAIL_ACT_T": 5.0, "COM_FLTT_LOW_ACT": 3,
    "COM_FLT_TIME_MAX": -1, "COM_IMB_PROP_ACT": 0, "COM_FLTMODE1": -1, "COM_LOW_BAT_ACT": 0,
    "COM_OBL_RC_ACT": 0, "COM_OF_LOSS_T": 1.0, "COM_POSCTL_NAVL": 0, "COM_POS_FS_EPH": 5.0,
    "COM_POS_LOW_ACT": 3, "COM_POS_LOW_EPH": -1.0, "COM_RC_OVERRIDE": 1, "COM_RCL_EXCEPT": 0,
    "COM_RC_IN_MODE": 3, "COM_RC_LOSS_T": 0.5, "COM_SPOOLUP_TIME": 1.0, "COM_WIND_MAX": -1.0,
    "COM_WIND_MAX_ACT": 0, "COM_DLL_EXCEPT": 0, "EKF2_EV_CTRL": 0, "EKF2_GPS_CTRL": 7,
    "EKF2_HGT_REF": 1, "EKF2_AID_MASK": 1, "FD_FAIL_P": 60, "FD_FAIL_R": 60, "GF_ACTION": 2,
    "GF_MAX_HOR_DIST": 0.0, "GF_MAX_VER_DIST": 0.0, "LNDMC_ROT_MAX": 20.0,
    "LNDMC_TRIG_TIME": 1.0, "LNDMC_XY_VEL_MAX": 1.5, "LNDMC_Z_VEL_MAX": 0.25,
    "LND_FLIGHT_T_HI": 0, "MAV_COMP_ID": 1, "MAV_SYS_ID": 1, "MAV_TYPE": 2,
    "MC_YAWRATE_MAX": 200.0, "MIS_TAKEOFF_ALT": 2.5, "MPC_ACC_DOWN_MAX": 3.0,
    "MPC_ACC_HOR": 3.0, "MPC_ACC_HOR_MAX": 5.0, "MPC_ACC_UP_MAX": 4.0, "MPC_JERK_AUTO": 4.0,
    "MPC_LAND_ALT1": 10.0, "MPC_LAND_ALT2": 5.0, "MPC_LAND_ALT3": 1.0, "MPC_LAND_CRWL": 0.3,
    "MPC_LAND_SPEED": 0.7, "MPC_THR_HOVER": 0.5, "MPC_THR_MAX": 1.0, "MPC_THR_MIN": 0.12,
    "MPC_TILTMAX_AIR": 45.0, "MPC_TILTMAX_LND": 12.0, "MPC_TKO_RAMP_T": 3.0,
    "MPC_TKO_SPEED": 1.5, "MPC_USE_HTE": 1, "MPC_XY_CRUISE": 5.0, "MPC_XY_P": 0.95,
    "MPC_XY_VEL_D_ACC": 0.2, "MPC_XY_VEL_I_ACC": 0.4, "MPC_XY_VEL_MAX": 12.0,
    "MPC_XY_VEL_P_ACC": 1.8, "MPC_Z_P": 1.0, "MPC_Z_VEL_D_ACC": 0.0, "MPC_Z_VEL_I_ACC": 2.0,
    "MPC_Z_VEL_MAX_DN": 1.5, "MPC_Z_VEL_MAX_UP": 3.0, "MPC_Z_VEL_P_ACC": 4.0,
    "MPC_Z_V_AUTO_DN": 1.5, "MPC_Z_V_AUTO_UP": 3.0, "NAV_ACC_RAD": 2.0, "NAV_DLL_ACT": 0,
    "NAV_RCL_ACT": 2, "NAV_TRAFF_AVOID": 1, "PD_GRIPPER_EN": 1, "PD_GRIPPER_TO": 1.0,
    "PD_GRIPPER_TYPE": 0, "RTL_DESCEND_ALT": 30.0, "RTL_LAND_DELAY": 0.0,
    "RTL_RETURN_ALT": 60.0, "RTL_TYPE": 0, "SDLOG_MODE": 0, "SYS_AUTOSTART": 10040,
    "SYS_HAS_BARO": 1, "SYS_HAS_GPS": 1, "SYS_HAS_MAG": 1, "SYS_FAILURE_EN": 1, "TRIG_MODE": 0,
    "UAVCAN_ENABLE": 0, "CAL_ACC0_ID": 1310988, "CAL_GYRO0_ID": 1310988, "CAL_MAG0_ID": 197388,
}  # fmt: skip

_SLOW: dict[str, float] = {
    "TIMESYNC": 10, "PING": 1, "MISSION_CURRENT": 1, "SCALED_PRESSURE": 1, "VIBRATION": 0.5,
    "LINK_NODE_STATUS": 1, "TIME_ESTIMATE_TO_TARGET": 0.5, "CURRENT_EVENT_SEQUENCE": 0.33,
    "CURRENT_MODE": 0.5,
}  # fmt: skip
"""Streams of every link, hertz."""
STREAMS: dict[str, dict[str, float]] = {
    "onboard": {
        "HEARTBEAT": 1, "LOCAL_POSITION_NED": 30, "ATTITUDE": 50, "ALTITUDE": 10, "ODOMETRY": 30,
        "ATTITUDE_QUATERNION": 50, "BATTERY_STATUS": 0.5, "ESTIMATOR_STATUS": 1,
        "EXTENDED_SYS_STATE": 5, "GLOBAL_POSITION_INT": 50, "GPS_GLOBAL_ORIGIN": 1,
        "GPS_RAW_INT": 5, "HOME_POSITION": 0.5, "POSITION_TARGET_LOCAL_NED": 10,
        "RC_CHANNELS": 20, "SERVO_OUTPUT_RAW": 10, "SYS_STATUS": 5, "SYSTEM_TIME": 1,
        "VFR_HUD": 10, "HIGHRES_IMU": 50, "DISTANCE_SENSOR": 10, "ATTITUDE_TARGET": 10,
        **_SLOW,
    },
    "gcs": {
        "HEARTBEAT": 1, "LOCAL_POSITION_NED": 1, "ATTITUDE": 15, "ALTITUDE": 1,
        "ATTITUDE_QUATERNION": 10, "BATTERY_STATUS": 0.5, "ESTIMATOR_STATUS": 0.5,
        "EXTENDED_SYS_STATE": 1, "GLOBAL_POSITION_INT": 5, "GPS_GLOBAL_ORIGIN": 1,
        "GPS_RAW_INT": 5, "HOME_POSITION": 0.5, "POSITION_TARGET_LOCAL_NED": 1.5,
        "RC_CHANNELS": 5, "SERVO_OUTPUT_RAW": 1, "SYS_STATUS": 1, "VFR_HUD": 4,
        "ATTITUDE_TARGET": 2, "DISTANCE_SENSOR": 0.5, **_SLOW,
    },
}  # fmt: skip
"""Streams of PX4's MAVLink modes onboard and normal that the emulator has, hertz."""
