"""PX4 (1.16) as a ground station sees it: modes, arming, offboard, failsafes, landing.

Behaviour from PX4's documentation and source (``commander``: ``UserModeIntention``,
``failsafe.cpp``, ``HealthAndArmingChecks``; ``mavlink_receiver``), and measurements on its
software-in-the-loop build. One simplification: few of the detailed preflight texts exist.

In this order: modes, parameters and streams as data; the state; setpoints; health and arming
checks; the navigator's goals of each mode; the commander's modes and failsafes (a failsafe holds
for COM_FAIL_ACT_T while a pilot could take over, then acts; a mode whose requirements fail falls
back to the next one of `FALLBACK`); commands.
"""

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from pymavlink.dialects.v20 import common as dialect

from sitl.faults import SIM_PARAMETERS
from sitl.protocol import wire
from sitl.protocol.missions import breached
from sitl.protocol.vehicle import (
    CRITICAL,
    EMERGENCY,
    INFO,
    SLOW_INTERVAL,
    Autopilot,
    Commands,
    Vehicle,
)
from sitl.protocol.wire import ACCEPTED, DENIED, TEMPORARILY_REJECTED, UNSUPPORTED, Command


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

_AXES, _FORCE, _LOCAL_NED = 0x1FF, 512, 1
"""Bits of a setpoint's type mask; its frame."""
_UNHEALTHY = "Resolve system health failures first"
_NO_STICKS = 4
_EXCEPTIONS = {"LOITER": 2, "OFFBOARD": 4}
_ALIVE = 1.9
"""Seconds after its last heartbeat for which a ground station counts as connected: 1.25 to 2.5 s,
the latest of checks 1.25 s apart."""
_FORCE_ARMING = 21196
_BOOT_TIME = 12.0
_MOVED = 1.0
"""Distance from home in metres at which a disarmed vehicle sets its home again."""
_AUTO, _OFFBOARD = 4, 6


class Px4(Autopilot):
    """PX4 of one vehicle.

    ``mode`` is active, ``intended`` is the user's mode, ``after_disarm`` the one to return to;
    ``latched`` is the mode of a failsafe that lasts until the user changes the mode.
    """

    streams = STREAMS
    gain_parameters = ("MPC_", "COM_SPOOLUP")

    def __init__(self, vehicle: Vehicle) -> None:
        super().__init__(vehicle, {**PARAMETERS, **SIM_PARAMETERS, "MAV_SYS_ID": vehicle.system})
        vehicle.bodies.land_time[vehicle.index] = 0.9

    def reset(self) -> None:
        """Set the state after a boot."""
        super().reset()
        self.mode = self.intended = self.after_disarm = "LOITER"
        self.offboard_at = self.ready_at = -math.inf
        self._offboard: wire.Setpoint | bytes | None = None
        self.armed_at = 0.0
        self.landed_at: float | None = None
        self.latched: str | None = None
        self.delay_until: float | None = None
        self.delayed: str | None = None
        self.battery_at_arming = 0
        self.gcs_known = self.outside_fence = self.all_axes = self.tumble_reported = False

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

    def standard_mode(self) -> int:
        """Return MAV_STANDARD_MODE, 0 without one."""
        mode = MODES[self.mode]
        return STANDARD_MODES.get((mode.main, mode.sub), 0)

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
        self.v.set_gains(
            (p["MPC_XY_P"], p["MPC_Z_P"]),
            (p["MPC_XY_VEL_P_ACC"], p["MPC_Z_VEL_P_ACC"]),
            (p["MPC_XY_VEL_I_ACC"], p["MPC_Z_VEL_I_ACC"]),
        )
        b.tilt_limit[i] = math.tan(math.radians(min(89.0, max(10.0, p["MPC_TILTMAX_AIR"]))))
        b.spool_time[i] = max(0.0, p["COM_SPOOLUP_TIME"])
        b.ramp_time[i] = max(0.1, 0.5 * p["MPC_TKO_RAMP_T"])
        b.refresh()

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
        return self.refusal() is None

    def set_mode(self, base: int, custom: int) -> int:
        """Execute the legacy message SET_MODE, with the custom mode as one number."""
        if not base & 1:
            return DENIED
        return self.change(BY_NUMBER.get((custom >> 16 & 0xFF, custom >> 24 & 0xFF)))

    def pilot_override(self) -> None:
        """Select Position mode, as a pilot's sticks do; it is the user's mode from then on."""
        self.pilot = True
        self.intend("POSCTL")

    def leave_offboard(self) -> None:
        """Change to Hold without a reason that the ground station receives."""
        self.intend("LOITER")

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
            self.slow_at = v.now + SLOW_INTERVAL
            self.watch_battery()
            self.watch_ground_station()
            if v.armed:
                self.watch_radio()
                self.watch_fence()
            else:
                self._update_home()
        elif self._steadily_offboard():
            return
        self.evaluate()
        if not v.armed:
            return
        if not v.landed:
            if not self.has_flown:
                if v.global_valid:
                    v.set_home_here()
                v.text(INFO, "Takeoff detected\t")
            self.has_flown = True
            self.landed_at = None
            self.steer()
        elif self.has_flown:
            self._after_landing()
        elif v.now - self.armed_at > v.parameters["COM_DISARM_PRFLT"] > 0:
            self.disarm("Disarmed by auto preflight disarming")

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
        return self.offboard_signal() and self.v.local_valid and not self.v.landed

    def _after_landing(self) -> None:
        v = self.v
        if self.landed_at is None:
            self.landed_at = v.now
            v.text(INFO, "Landing detected\t")
            v.environment.event("landed", v.system)
        wait = v.parameters["COM_DISARM_LAND"]
        if 0 <= wait < v.now - self.landed_at:
            self.disarm("Disarmed by landing")

    def handle_setpoint(self, setpoint: wire.Setpoint) -> None:
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
        self.offboard_at = self.v.now
        self.offboard = setpoint
        if self.mode == "OFFBOARD":
            self._follow(values)
            self.v.face(mask, setpoint.yaw)

    def _follow(self, values: tuple[float, ...]) -> None:
        v = self.v
        n, e, d, vn, ve, vd, an, ae, ad = values
        total = sum(values)
        if total - total == 0.0:
            v.bodies.set_goal(v.index, (*v.to_world(n, e, d), ve, vn, -vd, ae, an, -ad))
            self.all_axes = True
            return
        self.all_axes = False
        given = [float(math.isfinite(value)) for value in values]
        moved = [max(given[k], given[k + 3]) for k in range(3)]
        n, e, d, vn, ve, vd, an, ae, ad = (u if math.isfinite(u) else 0.0 for u in values)
        v.bodies.set_goal(
            v.index,
            (*v.to_world(n, e, d), ve, vn, -vd, ae, an, -ad),
            (given[1], given[0], given[2]),
            (moved[1], moved[0], moved[2]),
        )

    def offboard_signal(self) -> bool:
        """Return whether the setpoint stream is alive (COM_OF_LOSS_T)."""
        return self.v.now - self.offboard_at <= self.v.parameters["COM_OF_LOSS_T"]

    def meets(self, requirement: str) -> bool:
        """Return whether a requirement of a mode is met."""
        v = self.v
        if requirement == "offboard":
            return self.offboard_signal() and v.local_valid
        if requirement == "local":
            return v.local_valid
        if requirement == "global":
            return v.global_valid
        if requirement == "home":
            return v.home is not None
        if requirement == "mission":
            return False
        return (self.pilot or v.spec.radio) and not v.radio_lost

    def can_run(self, mode: str) -> bool:
        """Return whether all requirements of a mode are met."""
        return all(self.meets(requirement) for requirement in MODES[mode].requires)

    def refusal(self) -> str | None:
        """Return why PX4 would deny arming now, None if it would arm."""
        v = self.v
        if v.now < self.ready_at:
            return _UNHEALTHY
        if v.refuse_arming:
            return v.refuse_arming
        if MODES[self.intended].prevents_arming:
            return f"Mode '{MODES[self.intended].label}' prevents arming"
        alone = not self.gcs_connected and v.parameters["NAV_DLL_ACT"] > 0
        weak = self.battery_level >= 2 or self.beyond_fence()
        if alone or weak or not self.can_run(self.intended) or v.bodies.crashed[v.index]:
            return _UNHEALTHY
        return None

    def beyond_fence(self) -> bool:
        """Return whether the vehicle is outside a fence: uploaded, or GF_MAX_* around home."""
        v, p = self.v, self.v.parameters
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
        return breached(v.fence, float(here[0]), float(here[1]))

    def begin(self) -> None:
        """Set limits and goals of a mode that has just become active while armed."""
        v, p, mode = self.v, self.v.parameters, self.mode
        b, i = v.bodies, v.index
        b.may_lift[i] = mode in {"OFFBOARD", "TAKEOFF", "POSCTL"}
        v.limit_speeds(p["MPC_XY_CRUISE"], p["MPC_Z_V_AUTO_UP"], p["MPC_Z_V_AUTO_DN"])
        self.all_axes = False
        if mode == "OFFBOARD":
            up, down = p["MPC_Z_VEL_MAX_UP"], p["MPC_Z_VEL_MAX_DN"]
            v.limit_speeds(p["MPC_XY_VEL_MAX"], up, down)
            if self.offboard is not None:
                received = self.offboard_at
                self.handle_setpoint(self.offboard)
                self.offboard_at = received
        elif mode == "TAKEOFF" and self.goal is not None:
            v.limit_speeds(p["MPC_XY_CRUISE"], p["MPC_TKO_SPEED"], p["MPC_Z_V_AUTO_DN"])
            v.go(self.goal)
        elif mode == "LOITER" and self.goal is not None:
            v.go(self.goal)
        elif mode == "LAND":
            v.hold()
            v.descend(p["MPC_LAND_SPEED"], steer=True)
        elif mode == "DESCEND":
            v.descend(p["MPC_LAND_SPEED"], steer=False)
        elif mode != "TERMINATION":
            v.hold()

    def steer(self) -> None:
        """Update the goals of the active mode, and change the mode where it has ended."""
        if self.mode == "TAKEOFF":
            if self.goal is not None and abs(self.v.estimated()[2] - self.goal[2]) < 0.3:
                self.intended = self.after_disarm = "LOITER"
                self.evaluate()
        elif self.mode == "LAND":
            self._land()
        elif self.mode == "RTL":
            self._return()

    def _land(self) -> None:
        """Descend; the rate falls linearly from MPC_LAND_ALT1 to MPC_LAND_ALT2 above home."""
        v, p = self.v, self.v.parameters
        height = float(v.estimated()[2] - v.home_height())
        slow, fast = p["MPC_LAND_SPEED"], p["MPC_Z_V_AUTO_DN"]
        low, high = p["MPC_LAND_ALT2"], p["MPC_LAND_ALT1"]
        share = min(1.0, max(0.0, (height - low) / max(high - low, 1e-3)))
        v.bodies.set_climb_rate(v.index, -(slow + share * (fast - slow)))

    def _return(self) -> None:
        """Climb to the return altitude, fly home, descend, land."""
        v, p = self.v, self.v.parameters
        if v.home is None:
            return
        here, home = v.estimated(), v.home
        away = float(np.hypot(*(home - here)[:2]))
        top = max(float(here[2]), float(home[2]) + min(p["RTL_RETURN_ALT"], 0.5 * away + 5.0))
        if self.fly_home(top if away > 1.0 else here[2]):
            self.begin_landing(p["MPC_LAND_SPEED"])

    def change(self, name: str | None) -> int:
        """Change the user's mode if the new one can run; return the MAV_RESULT."""
        if name is None:
            return DENIED
        if self.mode == "TERMINATION":
            return TEMPORARILY_REJECTED
        if self.v.armed and not self.can_run(name):
            label = MODES[name].label
            self.v.text(CRITICAL, f"Switching to mode '{label}' is currently not possible\t")
            return TEMPORARILY_REJECTED
        self.intend(name)
        return ACCEPTED

    def intend(self, name: str) -> None:
        """Set the user's mode; this clears failsafes that last until a mode change."""
        self.intended = name
        self.latched = None
        self.delay_until = None
        self.goal = None
        self.stage = ""
        if not MODES[name].prevents_arming:
            self.after_disarm = name
        self.evaluate()

    def restart_mode(self) -> None:
        """Enter the mode once more, with its new goal."""
        self.mode = ""
        self.evaluate()

    def refuse_arming(self) -> int | None:
        """Return the MAV_RESULT of a refusal, after its text; None where the checks pass."""
        reason = self.refusal()
        if reason:
            self.v.text(CRITICAL, f"Arming denied: {reason}\t")
        return TEMPORARILY_REJECTED if reason else None

    def after_arming(self) -> None:
        """Report that the motors are armed, and enter the mode."""
        v = self.v
        self.armed_at = v.now
        self.landed_at = None
        self.battery_at_arming = self.battery_level
        self.radio_known, self.radio_lost_at = v.radio_connected, None
        self.outside_fence = False
        if v.global_valid:
            v.set_home_here()
        v.text(INFO, "Armed by external command\t")
        v.environment.event("armed", v.system)
        self.restart_mode()

    def after_disarming(self, reason: str) -> None:
        """Report that the motors are disarmed, and return to the mode before."""
        self.intended = self.after_disarm
        self.latched = None
        self.delay_until = None
        self.v.text(INFO, f"{reason}\t")
        self.v.environment.event("disarmed", self.v.system, reason=reason)
        self.evaluate()

    def terminate(self) -> None:
        """Stop the motors for good: flight termination."""
        v = self.v
        self.intended = self.mode = "TERMINATION"
        self.failsafe = True
        v.bodies.armed[v.index] = False
        v.text(EMERGENCY, "Flight termination active\t")
        v.environment.event("terminated", v.system)

    def trigger(self, action: str) -> None:
        """Start a failsafe: Hold for COM_FAIL_ACT_T while a pilot could take over, then act."""
        v = self.v
        if action == "DISARM":
            self.disarm("Disarmed by failsafe")
        elif action == "TERMINATION":
            self.terminate()
        elif self.latched != action:
            wait = v.parameters["COM_FAIL_ACT_T"] if action != "LOITER" else 0.0
            self.latched = "LOITER" if wait > 0 else action
            self.delayed = action
            self.delay_until = v.now + wait
            v.text(CRITICAL, "Failsafe activated\t")
            if self.mode == "LOITER" and self.goal is not None:
                self.goal = None
                v.hold()

    def evaluate(self) -> None:
        """Activate the user's mode, or the mode that failsafes and requirements select instead."""
        v = self.v
        if self.mode == "TERMINATION":
            return
        if not v.armed:
            self._enter(self.intended, failsafe=False)
            return
        if self.delay_until is not None and v.now >= self.delay_until:
            self.latched, self.delay_until = self.delayed, None
        selected, failsafe = self.intended, False
        if self.latched and self.intended != "LAND":
            selected, failsafe = self.latched, True
        if "offboard" in MODES[selected].requires and not self.offboard_signal():
            selected = OFFBOARD_LOSS.get(v.parameters.integer("COM_OBL_RC_ACT"), "POSCTL")
            failsafe = True
            if selected == "DISARM":
                self.disarm("Disarmed by failsafe")
                return
            if selected == "TERMINATION":
                self.terminate()
                return
        while not self.can_run(selected):
            failsafe = True
            needs_pilot = "pilot" in MODES[selected].requires
            selected = FALLBACK.get(selected, "DESCEND" if needs_pilot else "RTL")
        self._enter(selected, failsafe)

    def _enter(self, name: str, failsafe: bool) -> None:
        if name == self.mode and failsafe == self.failsafe:
            return
        v = self.v
        if failsafe and not self.failsafe and v.armed:
            v.text(CRITICAL, "Failsafe activated\t")
        self.failsafe = failsafe
        if name == self.mode:
            return
        self.mode = name
        self.landing = name in {"LAND", "DESCEND"}
        self.stage = ""
        v.environment.event("mode", v.system, mode=name, failsafe=failsafe)
        if v.armed:
            self.begin()

    def watch_battery(self) -> None:
        """Report a low battery and act on it (BAT_*_THR, COM_LOW_BAT_ACT)."""
        p, v = self.v.parameters, self.v
        thresholds = (p["BAT_LOW_THR"], p["BAT_CRIT_THR"], p["BAT_EMERGEN_THR"])
        level = sum(v.charge < threshold for threshold in thresholds)
        if level > self.battery_level:
            label = ("Low battery", "Critical battery", "Emergency battery level")
            v.text(EMERGENCY, f"{label[level - 1]}\t")
            action = BATTERY[p.integer("COM_LOW_BAT_ACT") % 4][max(level - 2, 0)]
            if v.armed and level >= 2 and action and level > self.battery_at_arming:
                self.trigger(action)
            elif v.armed:
                # a warning is a failsafe without an action, and is reported as the others are
                v.text(CRITICAL, "Failsafe activated\t")
        self.battery_level = max(level, self.battery_level if v.armed else 0)

    def watch_ground_station(self) -> None:
        """Detect the connection, loss (NAV_DLL_ACT) and return of the ground station."""
        v, p = self.v, self.v.parameters
        latest = max(v.last_heartbeat.values(), default=-math.inf)
        lost = v.now - latest > p["COM_DL_LOSS_T"] + _ALIVE
        if not lost and not self.gcs_connected:
            v.muted = False
            if self.gcs_known:
                v.text(INFO, "GCS connection regained\t")
            self.gcs_connected = self.gcs_known = True
        elif lost and self.gcs_connected:
            self.gcs_connected = False
            v.muted = True
            if v.armed:
                self._link_lost("NAV_DLL_ACT", "COM_DLL_EXCEPT")

    def watch_radio(self) -> None:
        """Detect a lost radio (NAV_RCL_ACT).

        A radio that was off when the vehicle armed is optional until its first signal.
        """
        p = self.v.parameters  # an event says so, no text
        if self.radio_lost_for(p["COM_RC_LOSS_T"]) and p.integer("COM_RC_IN_MODE") != _NO_STICKS:
            self._link_lost("NAV_RCL_ACT", "COM_RCL_EXCEPT")

    def _link_lost(self, action_name: str, except_name: str) -> None:
        p = self.v.parameters
        action = LINK_LOSS.get(p.integer(action_name))
        excepted = p.integer(except_name) & _EXCEPTIONS.get(self.intended, 0)
        if action and not excepted and self.intended != "LAND":
            self.trigger(action)

    def watch_fence(self) -> None:
        """Act when the vehicle leaves a fence (GF_ACTION)."""
        v, p = self.v, self.v.parameters
        outside = self.beyond_fence()
        if outside and not self.outside_fence:
            number = p.integer("GF_ACTION")
            if number:
                v.text(CRITICAL, "Geofence violation\t")
            v.environment.event("fence", v.system)
            action = GEOFENCE.get(number)
            if action:
                self.trigger(action)
        self.outside_fence = outside

    def _do_set_mode(self, command: Command) -> int:
        base, main, sub = (int(value) for value in command.p[:3])
        return self.change(BY_NUMBER.get((main, sub))) if base & 1 else DENIED

    def _arm_disarm(self, command: Command) -> int:
        p, v = command.p, self.v
        force = p[1] == _FORCE_ARMING
        if p[0] not in (0.0, 1.0):
            return UNSUPPORTED
        if p[0] == 1.0:
            return self.arm(force)
        if not v.armed:
            return ACCEPTED
        if not v.landed and not force:
            v.text(CRITICAL, "Disarming denied: not landed\t")
            return TEMPORARILY_REJECTED
        self.disarm("Disarmed by external command")
        return ACCEPTED

    def _takeoff(self, command: Command) -> int:
        p, v = command.p, self.v
        result = self.change("TAKEOFF")
        if result == ACCEPTED:
            ground = float(v.estimated()[2])
            if math.isfinite(p[6]):
                height = p[6] - v.environment.geodesy.altitude
            else:
                height = ground + v.parameters["MIS_TAKEOFF_ALT"]
            self.goal = np.array([*v.estimated()[:2], max(height, ground)])
            self.restart_mode()
        return result

    def _start_mission(self, _: Command) -> int:
        result = self.change("MISSION")
        return self.arm(force=False) if result == ACCEPTED else result

    def _command_land(self, _: Command) -> int:
        result = self.change("LAND")
        if result == ACCEPTED:
            self.v.text(INFO, "Landing at current position\t")
        return result

    def _command_return(self, _: Command) -> int:
        return self.change("RTL")

    def _reposition(self, command: Command) -> int:
        v, p, x, y = self.v, command.p, command.x, command.y
        result = self.change("LOITER")
        if result == ACCEPTED:
            place = np.array(v.estimated())
            if x != 2**31 - 1 and y != 2**31 - 1 and (x or y):
                place[:2] = v.environment.geodesy.metres(x * 1e-7, y * 1e-7)
            if math.isfinite(p[6]):
                place[2] = p[6] - v.environment.geodesy.altitude
            self.goal = place
            if math.isfinite(p[3]):
                v.bodies.goal_yaw[v.index] = math.pi / 2 - p[3]
            self.restart_mode()
        return result

    def _terminate(self, command: Command) -> int:
        if command.p[0] > 0.5:
            self.terminate()
        return ACCEPTED

    commands: ClassVar[Commands] = {
        dialect.MAV_CMD_COMPONENT_ARM_DISARM: _arm_disarm,
        dialect.MAV_CMD_DO_SET_MODE: _do_set_mode,
        dialect.MAV_CMD_NAV_TAKEOFF: _takeoff,
        dialect.MAV_CMD_MISSION_START: _start_mission,
        dialect.MAV_CMD_NAV_LAND: _command_land,
        dialect.MAV_CMD_NAV_RETURN_TO_LAUNCH: _command_return,
        dialect.MAV_CMD_DO_REPOSITION: _reposition,
        dialect.MAV_CMD_DO_FLIGHTTERMINATION: _terminate,
    }


def _complete(values: tuple[float, ...]) -> bool:
    """Return whether every axis has a value, x and y alike (PX4 refuses other combinations)."""
    given = [math.isfinite(value) for value in values]
    kinds = (given[:3], given[3:6], given[6:])
    return all(any(kind[k] for kind in kinds) for k in range(3)) and all(
        kind[0] == kind[1] for kind in kinds
    )
