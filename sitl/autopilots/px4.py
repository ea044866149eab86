"""PX4 (1.16) as a ground station sees it: modes, arming, offboard, failsafes, landing.

Behaviour from PX4's documentation and source (``commander``: ``UserModeIntention``,
``failsafe.cpp``, ``HealthAndArmingChecks``; ``mavlink_receiver``), and measurements on its
software-in-the-loop build. One simplification: few of the detailed preflight texts exist.

In this order: modes, parameters and streams as data; the state; setpoints; health and arming
checks; the navigator's goals of each mode; the commander's modes and failsafes (a failsafe holds
for COM_FAIL_ACT_T while a pilot could take over, then acts; a mode whose requirements fail falls
back to the next one of `FALLBACK`); commands; telemetry of PX4 only, of ideal sensors.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import common as dialect

from sitl.autopilots import controller_goals, mission_flight
from sitl.autopilots.mission_flight import DONE, LANDING, RETURNING
from sitl.physics.geodesy import GRAVITY
from sitl.protocol import fences, wire
from sitl.protocol.links import ACCEPTED, DENIED, TEMPORARILY_REJECTED, UNSUPPORTED, Command
from sitl.protocol.parameter_protocol import SIM_PARAMETERS
from sitl.protocol.vehicle import MissionProgress, Vehicle


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


INFO, WARNING, CRITICAL, EMERGENCY = 6, 4, 2, 0
"""MAV_SEVERITY."""
_AUTO, _OFFBOARD = 4, 6


class Px4:
    """PX4 of one vehicle; the methods are those of `sitl.protocol.vehicle.Autopilot`.

    ``mode`` is active, ``intended`` is the user's mode, ``after_disarm`` the one to return to;
    ``latched`` is the mode of a failsafe that lasts until the user changes the mode.
    """

    streams = STREAMS

    def __init__(self, vehicle: Vehicle) -> None:
        self.v = vehicle
        self.has_origin = True
        self.reset()
        table = {**PARAMETERS, **SIM_PARAMETERS}
        table["MAV_SYS_ID"] = vehicle.system
        vehicle.parameters.load(table)
        self.apply_gains()
        vehicle.bodies.land_time[vehicle.index] = 0.9

    def reset(self) -> None:
        """Set the state after a boot."""
        self.intended = "LOITER"
        self.after_disarm = "LOITER"
        self.mode = "LOITER"
        self.failsafe = False
        self.landing = False
        self.offboard_at = -math.inf
        self._offboard: wire.Setpoint | bytes | None = None
        self.armed_at = 0.0
        self.has_flown = False
        self.landed_at: float | None = None
        self.goal: Any = None
        self.stage = ""
        self.pilot = False
        self.latched: str | None = None
        self.delay_until: float | None = None
        self.delayed: str | None = None
        self.battery_level = 0
        self.battery_at_arming = 0
        self.gcs_connected = self.gcs_known = False
        self.radio_known = False
        self.radio_lost_at: float | None = None
        self.outside_fence = False
        self.v.mission_progress = MissionProgress(first=0)
        self.all_axes = False
        self.slow_at = -math.inf
        self.tumble_reported = False
        self.ready_at = -math.inf

    @property
    def offboard(self) -> wire.Setpoint | None:
        """The last accepted setpoint."""
        if isinstance(self._offboard, bytes):
            self._offboard = wire.setpoint_in(self._offboard)
        return self._offboard

    @offboard.setter
    def offboard(self, setpoint: wire.Setpoint) -> None:
        self._offboard = setpoint

    @property
    def follows_setpoints(self) -> bool:
        """Whether the vehicle follows setpoints of all axes: another one changes only the goal."""
        return self.mode == "OFFBOARD" and self.all_axes

    def note_setpoint(self, data: bytes, now: float) -> None:
        """Record a setpoint packet whose goal is already set, while `follows_setpoints`."""
        self.offboard_at, self._offboard = now, data

    @property
    def target_mask(self) -> int | None:
        """Type mask of POSITION_TARGET_LOCAL_NED; None without an active controller."""
        if not self.v.armed:
            return None
        return self.offboard.mask if self.mode == "OFFBOARD" and self.offboard else 0

    @property
    def logging(self) -> bool:
        """Whether the autopilot writes its log: SDLOG_MODE 0 logs while armed."""
        return self.v.armed

    @property
    def failsafe_active(self) -> bool:
        """Whether HEARTBEAT reports an active failsafe."""
        return self.failsafe and self.v.armed

    @property
    def taking_off(self) -> bool:
        """Whether the take-off mode is active."""
        return self.mode == "TAKEOFF"

    def custom_mode(self) -> int:
        """Return main and sub mode of the active mode, as PX4 packs them."""
        mode = MODES[self.mode]
        return mode.main << 16 | mode.sub << 24

    def base_mode(self) -> int:
        """Return the MAV_MODE_FLAG bits of the active mode."""
        mode = MODES[self.mode]
        flags = 1 | 16
        if mode.main == _AUTO:
            flags |= 4 | 8
        elif mode.main != _OFFBOARD:
            flags |= 64
        return flags | (128 if self.v.armed else 0)

    def apply_gains(self) -> None:
        """Copy the controller parameters into the bodies."""
        p, b, i = self.v.parameters, self.v.bodies, self.v.index
        controller_goals.gains(
            self.v,
            (p["MPC_XY_P"], p["MPC_Z_P"]),
            (p["MPC_XY_VEL_P_ACC"], p["MPC_Z_VEL_P_ACC"]),
            (p["MPC_XY_VEL_I_ACC"], p["MPC_Z_VEL_I_ACC"]),
        )
        b.tilt_limit[i] = math.tan(math.radians(min(89.0, max(10.0, p["MPC_TILTMAX_AIR"]))))
        b.spool_time[i] = max(0.0, p["COM_SPOOLUP_TIME"])
        b.ramp_time[i] = max(0.1, 0.5 * p["MPC_TKO_RAMP_T"])
        b.refresh()

    def parameter_changed(self, name: str) -> None:
        """Apply a parameter that PARAM_SET changed."""
        if name.startswith(("MPC_", "COM_SPOOLUP")):
            self.apply_gains()

    def restart(self) -> None:
        """Boot: arming is possible when estimator and checks are ready."""
        self.reset()
        self.ready_at = self.v.now + _BOOT_TIME
        self.v.timers.append((self.ready_at, self._set_home))

    def _set_home(self) -> None:
        if self.v.global_valid:
            self.v.set_home_here()
        self.v.text(INFO, "Ready for takeoff!\t")

    def ready_to_arm(self) -> bool:
        """Return the pre-arm bit: health and the intended mode would allow arming now."""
        return refusal(self) is None

    def handle_command(self, command: Command) -> int | None:
        """Execute a command; return its MAV_RESULT, None for an unknown command."""
        handler = COMMANDS.get(command.number)
        return None if handler is None else handler(self, command)

    def set_mode(self, base: int, custom: int) -> int:
        """Execute the legacy message SET_MODE, with the custom mode as one number."""
        if not base & 1:
            return DENIED
        return change(self, BY_NUMBER.get((custom >> 16 & 0xFF, custom >> 24 & 0xFF)))

    def arm(self, force: bool) -> int:
        """Arm if the checks pass; return the MAV_RESULT."""
        return arm(self, force)

    def disarm(self, reason: str) -> None:
        """Stop the motors, on the ground or in flight."""
        disarm(self, reason)

    def handle_setpoint(self, setpoint: wire.Setpoint) -> None:
        """Accept or ignore SET_POSITION_TARGET_LOCAL_NED."""
        accept(self, setpoint)

    def pilot_override(self) -> None:
        """Select Position mode, as a pilot's sticks do; it is the user's mode from then on."""
        self.pilot = True
        intend(self, "POSCTL")

    def leave_offboard(self) -> None:
        """Change to Hold without a reason that the ground station receives."""
        intend(self, "LOITER")

    def update(self) -> float:
        """Check timers and conditions, at most 25 times a second; return when to check next."""
        self._check()
        v = self.v
        if v.armed:
            if not self._steadily_offboard():
                return -math.inf
            return min(self.slow_at, self.offboard_at + v.parameters["COM_OF_LOSS_T"])
        return self.slow_at

    def _check(self) -> None:
        v = self.v
        if v.bodies.tumbling[v.index] and not self.tumble_reported:
            self.tumble_reported = True
            v.text(EMERGENCY, "Attitude failure detected\t")
        if v.now >= self.slow_at:
            self.slow_at = v.now + _SLOW_INTERVAL
            watch_battery(self)
            watch_ground_station(self)
            if v.armed:
                watch_radio(self)
                watch_fence(self)
            else:
                self._update_home()
        elif self._steadily_offboard():
            return
        evaluate(self)
        if not v.armed:
            return
        if not v.landed:
            if not self.has_flown:
                self._report_takeoff()
            self.has_flown = True
            self.landed_at = None
            steer(self)
        elif self.has_flown:
            self._after_landing()
        elif v.now - self.armed_at > v.parameters["COM_DISARM_PRFLT"] > 0:
            self.disarm("Disarmed by auto preflight disarming")

    def _report_takeoff(self) -> None:
        v = self.v
        if v.global_valid:
            v.set_home_here()
        v.text(INFO, "Takeoff detected\t")

    def _update_home(self) -> None:
        """Set home again after the vehicle was carried away, or has landed elsewhere."""
        v = self.v
        if v.home is not None and v.global_valid and math.dist(v.home, v.estimated()) > _MOVED:
            v.set_home_here()

    def _steadily_offboard(self) -> bool:
        """Return whether no check is due: the most frequent case, for speed."""
        if not (
            self.mode == self.intended == "OFFBOARD" and self.has_flown and self.latched is None
        ):
            return False
        return offboard_signal(self) and self.v.local_valid and not self.v.landed

    def _after_landing(self) -> None:
        v = self.v
        if self.landed_at is None:
            self.landed_at = v.now
            v.text(INFO, "Landing detected\t")
            v.environment.event("landed", v.system)
        wait = v.parameters["COM_DISARM_LAND"]
        if 0 <= wait < v.now - self.landed_at:
            self.disarm("Disarmed by landing")


_LOCAL_NED = 1
_AXES, _FORCE, _NO_YAW = 0x1FF, 512, 1024


def accept(px4: Px4, setpoint: wire.Setpoint) -> None:
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


def _turn(px4: Px4, setpoint: wire.Setpoint) -> None:
    if not setpoint.mask & _NO_YAW and math.isfinite(setpoint.yaw):
        px4.v.bodies.goal_yaw[px4.v.index] = math.pi / 2 - setpoint.yaw


def _follow(px4: Px4, values: tuple[float, ...]) -> None:
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


_UNHEALTHY = "Resolve system health failures first"


def offboard_signal(px4: Px4) -> bool:
    """Return whether the setpoint stream is alive (COM_OF_LOSS_T)."""
    return px4.v.now - px4.offboard_at <= px4.v.parameters["COM_OF_LOSS_T"]


def meets(px4: Px4, requirement: str) -> bool:
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


def can_run(px4: Px4, mode: str) -> bool:
    """Return whether all requirements of a mode are met."""
    return all(meets(px4, requirement) for requirement in MODES[mode].requires)


def refusal(px4: Px4) -> str | None:
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


def beyond_fence(px4: Px4) -> bool:
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


def begin(px4: Px4) -> str | None:
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
            accept(px4, px4.offboard)
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


def steer_in_mode(px4: Px4) -> str | None:
    """Update the goals of the active mode."""
    step = _STEPS.get(px4.mode)
    return None if step is None else step(px4)


def _take_off(px4: Px4) -> str | None:
    v = px4.v
    if px4.goal is not None and abs(float(v.estimated()[2] - px4.goal[2])) < 0.3:
        return "LOITER"
    return None


def _land(px4: Px4) -> None:
    """Descend; the rate falls linearly from MPC_LAND_ALT1 to MPC_LAND_ALT2 above home."""
    v, p = px4.v, px4.v.parameters
    home = v.home[2] if v.home is not None else v.origin[2]
    height = float(v.estimated()[2] - home)
    slow, fast = p["MPC_LAND_SPEED"], p["MPC_Z_V_AUTO_DN"]
    low, high = p["MPC_LAND_ALT2"], p["MPC_LAND_ALT1"]
    share = min(1.0, max(0.0, (height - low) / max(high - low, 1e-3)))
    v.bodies.set_climb_rate(v.index, -(slow + share * (fast - slow)))


def _return(px4: Px4) -> None:
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


def _fly_mission(px4: Px4) -> str | None:
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


_STEPS: dict[str, Callable[[Px4], str | None]] = {
    "TAKEOFF": _take_off,
    "LAND": _land,
    "RTL": _return,
    "MISSION": _fly_mission,
}


def change(px4: Px4, name: str | None) -> int:
    """Change the user's mode if the new one can run; return the MAV_RESULT."""
    if name is None:
        return DENIED
    if px4.mode == "TERMINATION":
        return TEMPORARILY_REJECTED
    if px4.v.armed and not can_run(px4, name):
        label = MODES[name].label
        px4.v.text(CRITICAL, f"Switching to mode '{label}' is currently not possible\t")
        return TEMPORARILY_REJECTED
    intend(px4, name)
    return ACCEPTED


def intend(px4: Px4, name: str) -> None:
    """Set the user's mode; this clears failsafes that last until a mode change."""
    px4.intended = name
    px4.latched = None
    px4.delay_until = None
    px4.goal = None
    px4.stage = ""
    if not MODES[name].prevents_arming:
        px4.after_disarm = name
    evaluate(px4)


def restart_mode(px4: Px4) -> None:
    """Enter the mode once more, with its new goal."""
    px4.mode = ""
    evaluate(px4)


def arm(px4: Px4, force: bool) -> int:
    """Arm if the checks pass; return the MAV_RESULT."""
    v = px4.v
    if v.armed:
        return ACCEPTED
    reason = refusal(px4)
    if reason and not force:
        v.text(CRITICAL, f"Arming denied: {reason}\t")
        return TEMPORARILY_REJECTED
    v.bodies.armed[v.index] = True
    v.bodies.landed[v.index] = True
    px4.armed_at = v.now
    px4.has_flown = False
    px4.landed_at = None
    px4.battery_at_arming = px4.battery_level
    px4.radio_known, px4.radio_lost_at = v.radio_connected, None
    px4.outside_fence = False
    if v.global_valid:
        v.set_home_here()
    v.text(INFO, "Armed by external command\t")
    v.environment.event("armed", v.system)
    restart_mode(px4)
    return ACCEPTED


def disarm(px4: Px4, reason: str) -> None:
    """Stop the motors, on the ground or in flight."""
    v = px4.v
    if not v.armed:
        return
    v.bodies.armed[v.index] = False
    v.bodies.landed[v.index] = True
    controller_goals.idle(v)
    px4.intended = px4.after_disarm
    px4.latched = None
    px4.delay_until = None
    v.text(INFO, f"{reason}\t")
    v.environment.event("disarmed", v.system, reason=reason)
    evaluate(px4)


def terminate(px4: Px4) -> None:
    """Stop the motors for good: flight termination."""
    v = px4.v
    px4.intended = px4.mode = "TERMINATION"
    px4.failsafe = True
    v.bodies.armed[v.index] = False
    v.text(EMERGENCY, "Flight termination active\t")
    v.environment.event("terminated", v.system)


def trigger(px4: Px4, action: str) -> None:
    """Start a failsafe: Hold for COM_FAIL_ACT_T while a pilot could take over, then act."""
    v = px4.v
    if action == "DISARM":
        disarm(px4, "Disarmed by failsafe")
    elif action == "TERMINATION":
        terminate(px4)
    elif px4.latched != action:
        wait = v.parameters["COM_FAIL_ACT_T"] if action != "LOITER" else 0.0
        px4.latched = "LOITER" if wait > 0 else action
        px4.delayed = action
        px4.delay_until = v.now + wait
        v.text(CRITICAL, "Failsafe activated\t")
        if px4.mode == "LOITER" and px4.goal is not None:
            px4.goal = None
            controller_goals.hold(v)


def steer(px4: Px4) -> None:
    """Update the goals of the active mode, and change the mode where it has ended."""
    _follow_up(px4, steer_in_mode(px4))


def evaluate(px4: Px4) -> None:
    """Activate the user's mode, or the mode that failsafes and requirements select instead."""
    v = px4.v
    if px4.mode == "TERMINATION":
        return
    if not v.armed:
        _enter(px4, px4.intended, failsafe=False)
        return
    if px4.delay_until is not None and v.now >= px4.delay_until:
        px4.latched, px4.delay_until = px4.delayed, None
    selected, failsafe = px4.intended, False
    if px4.latched and px4.intended != "LAND":
        selected, failsafe = px4.latched, True
    if "offboard" in MODES[selected].requires and not offboard_signal(px4):
        selected = OFFBOARD_LOSS.get(v.parameters.integer("COM_OBL_RC_ACT"), "POSCTL")
        failsafe = True
        if selected == "DISARM":
            disarm(px4, "Disarmed by failsafe")
            return
        if selected == "TERMINATION":
            terminate(px4)
            return
    while not can_run(px4, selected):
        failsafe = True
        needs_pilot = "pilot" in MODES[selected].requires
        selected = FALLBACK.get(selected, "DESCEND" if needs_pilot else "RTL")
    _enter(px4, selected, failsafe)


def _enter(px4: Px4, name: str, failsafe: bool) -> None:
    if name == px4.mode and failsafe == px4.failsafe:
        return
    v = px4.v
    if failsafe and not px4.failsafe and v.armed:
        v.text(CRITICAL, "Failsafe activated\t")
    px4.failsafe = failsafe
    if name == px4.mode:
        return
    px4.mode = name
    px4.landing = name in {"LAND", "DESCEND"}
    px4.stage = ""
    v.environment.event("mode", v.system, mode=name, failsafe=failsafe)
    if v.armed:
        _follow_up(px4, begin(px4))


def _follow_up(px4: Px4, following: str | None) -> None:
    """Change to the mode that follows; a take-off holds at its goal."""
    if following is None:
        return
    if px4.mode == "TAKEOFF":
        px4.intended = px4.after_disarm = following
        evaluate(px4)
    else:
        intend(px4, following)


_NO_STICKS = 4
_EXCEPTIONS = {"MISSION": 1, "LOITER": 2, "OFFBOARD": 4}

_ALIVE = 1.9
"""Seconds after its last heartbeat for which a ground station counts as connected: 1.25 to 2.5 s,
the latest of checks 1.25 s apart."""


def watch_battery(px4: Px4) -> None:
    """Report a low battery and act on it (BAT_*_THR, COM_LOW_BAT_ACT)."""
    p, v = px4.v.parameters, px4.v
    thresholds = (p["BAT_LOW_THR"], p["BAT_CRIT_THR"], p["BAT_EMERGEN_THR"])
    level = sum(v.charge < threshold for threshold in thresholds)
    if level > px4.battery_level:
        label = ("Low battery", "Critical battery", "Emergency battery level")
        v.text(EMERGENCY, f"{label[level - 1]}\t")
        action = BATTERY[p.integer("COM_LOW_BAT_ACT") % 4][max(level - 2, 0)]
        if v.armed and level >= 2 and action and level > px4.battery_at_arming:
            trigger(px4, action)
        elif v.armed:
            # a warning is a failsafe without an action, and is reported as the others are
            v.text(CRITICAL, "Failsafe activated\t")
    px4.battery_level = max(level, px4.battery_level if v.armed else 0)


def watch_ground_station(px4: Px4) -> None:
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


def watch_radio(px4: Px4) -> None:
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


def _link_lost(px4: Px4, action_name: str, except_name: str) -> None:
    p = px4.v.parameters
    action = LINK_LOSS.get(p.integer(action_name))
    excepted = p.integer(except_name) & _EXCEPTIONS.get(px4.intended, 0)
    if action and not excepted and px4.intended != "LAND":
        trigger(px4, action)


def watch_fence(px4: Px4) -> None:
    """Act when the vehicle leaves a fence (GF_ACTION)."""
    v, p = px4.v, px4.v.parameters
    outside = beyond_fence(px4)
    if outside and not px4.outside_fence:
        number = p.integer("GF_ACTION")
        if number:
            v.text(CRITICAL, "Geofence violation\t")
        v.environment.event("fence", v.system)
        action = GEOFENCE.get(number)
        if action:
            trigger(px4, action)
    px4.outside_fence = outside


_FORCE_ARMING = 21196


def _do_set_mode(px4: Px4, command: Command) -> int:
    p = command.p
    base, main, sub = int(p[0]), int(p[1]), int(p[2])
    if not base & 1:
        return DENIED
    return change(px4, BY_NUMBER.get((main, sub)))


def _arm_disarm(px4: Px4, command: Command) -> int:
    p = command.p
    v = px4.v
    force = p[1] == _FORCE_ARMING
    if p[0] not in (0.0, 1.0):
        return UNSUPPORTED
    if p[0] == 1.0:
        return arm(px4, force)
    if not v.armed:
        return ACCEPTED
    if not v.landed and not force:
        v.text(CRITICAL, "Disarming denied: not landed\t")
        return TEMPORARILY_REJECTED
    disarm(px4, "Disarmed by external command")
    return ACCEPTED


def _takeoff(px4: Px4, command: Command) -> int:
    p = command.p
    v = px4.v
    result = change(px4, "TAKEOFF")
    if result == ACCEPTED:
        ground = float(v.estimated()[2])
        if math.isfinite(p[6]):
            height = p[6] - v.environment.geodesy.altitude
        else:
            height = ground + v.parameters["MIS_TAKEOFF_ALT"]
        px4.goal = np.array([*v.estimated()[:2], max(height, ground)])
        restart_mode(px4)
    return result


def _start_mission(px4: Px4, _: Command) -> int:
    result = change(px4, "MISSION")
    return arm(px4, force=False) if result == ACCEPTED else result


def _jump(px4: Px4, command: Command) -> int:
    number, v = command.p[0], px4.v
    found = math.isfinite(number) and v.mission_progress.jump_to(int(number), len(v.mission[0]))
    return ACCEPTED if found else DENIED


def _command_land(px4: Px4, _: Command) -> int:
    result = change(px4, "LAND")
    if result == ACCEPTED:
        px4.v.text(INFO, "Landing at current position\t")
    return result


def _command_return(px4: Px4, _: Command) -> int:
    return change(px4, "RTL")


def _reposition(px4: Px4, command: Command) -> int:
    p, x, y = command.p, command.x, command.y
    v = px4.v
    result = change(px4, "LOITER")
    if result == ACCEPTED:
        here = v.estimated()
        place = np.array(here)
        if x != 2**31 - 1 and y != 2**31 - 1 and (x or y):
            place[:2] = v.environment.geodesy.metres(x * 1e-7, y * 1e-7)
        if math.isfinite(p[6]):
            place[2] = p[6] - v.environment.geodesy.altitude
        px4.goal = place
        if math.isfinite(p[3]):
            v.bodies.goal_yaw[v.index] = math.pi / 2 - p[3]
        restart_mode(px4)
    return result


def _speed(px4: Px4, command: Command) -> int:
    controller_goals.set_speed(px4.v, command.p[1])
    return ACCEPTED


def _terminate(px4: Px4, command: Command) -> int:
    if command.p[0] > 0.5:
        terminate(px4)
    return ACCEPTED


COMMANDS: dict[int, Callable[[Px4, Command], int]] = {
    dialect.MAV_CMD_COMPONENT_ARM_DISARM: _arm_disarm,
    dialect.MAV_CMD_DO_SET_MODE: _do_set_mode,
    dialect.MAV_CMD_NAV_TAKEOFF: _takeoff,
    dialect.MAV_CMD_MISSION_START: _start_mission,
    dialect.MAV_CMD_DO_SET_MISSION_CURRENT: _jump,
    dialect.MAV_CMD_NAV_LAND: _command_land,
    dialect.MAV_CMD_NAV_RETURN_TO_LAUNCH: _command_return,
    dialect.MAV_CMD_DO_REPOSITION: _reposition,
    dialect.MAV_CMD_DO_CHANGE_SPEED: _speed,
    dialect.MAV_CMD_DO_FLIGHTTERMINATION: _terminate,
}


_LARGEST = 2**32
_SEA_PRESSURE, _WARM, _LAPSE, _EXPONENT = 1013.25, 288.15, 0.0065, 5.2559
"""The standard atmosphere: hPa, K, K/m."""
_LEVEL_FIELD = (0.21, 0.0, 0.42)
_ALL_UPDATED = 511
_DOWN, _FARTHEST = 25, 10_000
_RECEIVING, _SENDING = 100, 20_000


def _time_usec(v: Vehicle) -> int:
    return round(v.clock() * 1e6)


def _boot_ms(v: Vehicle) -> int:
    return int(v.clock() * 1000) % _LARGEST


def _height(v: Vehicle) -> float:
    return float(v.environment.geodesy.altitude + v.estimated()[2])


def _pressure(v: Vehicle) -> float:
    return _SEA_PRESSURE * math.pow(1.0 - _LAPSE * _height(v) / _WARM, _EXPONENT)


def _inertial(v: Vehicle) -> bytes:
    fx, fy, fz = v.bodies.thrust[v.index].tolist()
    force = (0.0, 0.0, -GRAVITY) if v.landed else (fy, fx, -fz)
    fields = {
        "time_usec": _time_usec(v), "xacc": force[0], "yacc": force[1], "zacc": force[2],
        "xmag": _LEVEL_FIELD[0], "ymag": _LEVEL_FIELD[1], "zmag": _LEVEL_FIELD[2],
        "abs_pressure": _pressure(v) * 100.0, "pressure_alt": _height(v), "temperature": 15.0,
        "fields_updated": _ALL_UPDATED,
    }  # fmt: skip
    return wire.payload("HIGHRES_IMU", fields)


def _distance(v: Vehicle) -> bytes:
    above = max(0.0, float(v.bodies.position[v.index, 2] - v.bodies.floor))
    fields = {"time_boot_ms": _boot_ms(v), "max_distance": _FARTHEST, "orientation": _DOWN,
              "current_distance": min(round(above * 100), _FARTHEST)}  # fmt: skip
    return wire.payload("DISTANCE_SENSOR", fields)


def _attitude_target(v: Vehicle) -> bytes:
    yaw = math.pi / 2 - float(v.bodies.goal_yaw[v.index] if v.armed else v.bodies.yaw[v.index])
    share = float(v.bodies.thrust[v.index, 2] / v.bodies.thrust_limit[v.index]) if v.armed else 0.0
    fields = {"time_boot_ms": _boot_ms(v), "q": (math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2)),
              "thrust": max(0.001, share)}  # fmt: skip
    return wire.payload("ATTITUDE_TARGET", fields)


def _air_pressure(v: Vehicle) -> bytes:
    fields = {"time_boot_ms": _boot_ms(v), "press_abs": _pressure(v), "temperature": 1182}
    return wire.payload("SCALED_PRESSURE", fields)


def _vibration(v: Vehicle) -> bytes:
    return wire.payload("VIBRATION", {"time_usec": _time_usec(v)})


def _ping(v: Vehicle) -> bytes:
    """A broadcast PING; PX4 does not evaluate the answers."""
    return wire.payload("PING", {"time_usec": _time_usec(v), "seq": int(v.clock()) % _LARGEST})


def _link_status(v: Vehicle) -> bytes:
    fields = {"timestamp": round(v.clock() * 1e3), "tx_rate": _SENDING, "rx_rate": _RECEIVING}
    return wire.payload("LINK_NODE_STATUS", fields)


def _time_to_target(v: Vehicle) -> bytes:
    home = v.home if v.home is not None else v.origin
    away = math.dist(v.estimated(), home) if v.armed and not v.landed else 0.0
    names = ("land", "mission_next_item", "mission_end", "commanded_action")
    fields = {"safe_return": math.ceil(away), **dict.fromkeys(names, -1)}
    return wire.payload("TIME_ESTIMATE_TO_TARGET", fields)


def _events(v: Vehicle) -> bytes:
    return wire.payload("CURRENT_EVENT_SEQUENCE", {"sequence": v.text_id})


def _metadata(v: Vehicle) -> bytes:
    fields = {"time_boot_ms": _boot_ms(v), "uri": "mftp://etc/extras/component_general.json.xz"}
    return wire.payload("COMPONENT_METADATA", fields)


def clock_request(v: Vehicle) -> bytes:
    """Return a TIMESYNC request."""
    return wire.payload("TIMESYNC", {"tc1": 0, "ts1": round(v.clock() * 1e9)})


TELEMETRY: dict[str, Callable[[Vehicle], bytes | None]] = {
    "HIGHRES_IMU": _inertial,
    "DISTANCE_SENSOR": _distance,
    "ATTITUDE_TARGET": _attitude_target,
    "SCALED_PRESSURE": _air_pressure,
    "VIBRATION": _vibration,
    "PING": _ping,
    "LINK_NODE_STATUS": _link_status,
    "TIME_ESTIMATE_TO_TARGET": _time_to_target,
    "CURRENT_EVENT_SEQUENCE": _events,
    "COMPONENT_METADATA": _metadata,
    "TIMESYNC": clock_request,
}


_BOOT_TIME = 12.0
_SLOW_INTERVAL = 0.4
_MOVED = 1.0
"""Distance from home in metres at which a disarmed vehicle sets its home again."""
