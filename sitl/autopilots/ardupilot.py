"""ArduCopter (4.6) as a ground station sees it: modes, arming, GUIDED, take-off, failsafes.

Behaviour from ArduPilot's documentation and source (``GCS_Mavlink.cpp``, ``mode_guided.cpp``,
``AP_Arming``, ``events.cpp``, ``ekf_check.cpp``, ``fence.cpp``, ``AC_Fence``), and measurements on
its software-in-the-loop build. One simplification: without a pilot LOITER and similar modes hold,
as with centred sticks.

In this order: modes, parameters and streams as data; the state; setpoints in GUIDED; pre-arm checks
and fences; mode changes, arming and failsafe actions; goals of autonomous modes; failsafes;
commands.
"""

import math
from dataclasses import dataclass
from typing import ClassVar

from pymavlink.dialects.v20 import common as dialect

from sitl.autopilots.telemetry import send_now
from sitl.faults import SIM_PARAMETERS
from sitl.protocol import wire
from sitl.protocol.missions import breached
from sitl.protocol.parameters import INT8, INT16, INT32
from sitl.protocol.vehicle import (
    CRITICAL,
    INFO,
    SLOW_INTERVAL,
    WARNING,
    Autopilot,
    Commands,
    GripperRequest,
    Vehicle,
)  # fmt: skip
from sitl.protocol.wire import ACCEPTED, DENIED, FAILED, Command


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
"""Numbers of modes (COPTER_MODE of ardupilotmega.xml)."""

GROUND_STATION_LOSS = {0: None, 1: RTL, 2: RTL, 3: RTL, 4: LAND, 5: LAND, 6: LAND, 7: BRAKE}
"""FS_GCS_ENABLE; SmartRTL does not exist here and falls back as documented."""
RADIO_LOSS = {0: None, 1: RTL, 2: RTL, 3: LAND, 4: RTL, 5: LAND, 6: RTL, 7: BRAKE}
"""FS_THR_ENABLE."""
FENCE = {0: None, 1: RTL, 2: LAND, 3: RTL, 4: BRAKE, 5: LAND}
"""FENCE_ACTION."""
BATTERY = {0: None, 1: LAND, 2: RTL, 3: RTL, 4: LAND, 6: LAND, 7: BRAKE}
"""BATT_FS_LOW_ACT and BATT_FS_CRT_ACT."""

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


POSITION_READY = 42.0
"""Seconds after boot until the estimator has an absolute position."""
_TAKEN_OFF = 0.9
"""Share of the height at which a take-off ends."""
_LOGS_ON = 15.0
"""Seconds for which the log continues after disarming."""
_LOCAL, _LOCAL_OFFSET, _BODY, _BODY_OFFSET = 1, 7, 8, 9
"""MAV_FRAME of setpoints (common.xml)."""
_TAKEOFF_CANCELLED = 0.2
_POSITION, _VELOCITY, _ACCELERATION, _FORCE = 7, 56, 448, 512
_YAW_BITS = 3072
"""POSITION_TARGET_TYPEMASK: bits of quantities to ignore, and that of forces (common.xml)."""
_Vector = tuple[float, float, float]
_BASIC_READY = 10.0
ALTITUDE, CIRCLE, POLYGON = 1, 2, 4
"""FENCE_TYPE."""
_RELEASE_GRIPPER = 32
"""FS_OPTIONS."""
_LAND_PAUSE = 4.0
"""Seconds for which a failsafe's landing hovers first (LAND_WITH_DELAY_MS in its source)."""
_RADIO_IN_GUIDED, _WHILE_LANDING, _GCS_WITH_PILOT = 4, 8, 16
"""FS_OPTIONS: conditions in which a failsafe does not change the mode."""
_RADIO_TIMEOUT = 1.0
"""Seconds without pulses until a radio counts as lost: RC_FS_TIMEOUT's default; measured."""
_ESTIMATOR_TIMEOUT = 8.0
"""Seconds without a receiver until the estimator's variances are a failure: measured on 4.6.2.

The dead reckoning failsafe (FS_DR_ENABLE) does not come before it: it needs an estimate of the
wind (EK3_DRAG_BCOEF_X), which multicopters have only where their drag was measured."""
_FENCES = {ALTITUDE: "Max Alt", CIRCLE: "Circle", POLYGON: "Polygon"}
_FORCE_ARM, _FORCE_DISARM = 2989, 21196
_PREARM_INTERVAL = 30.0
_CRASH_TIME = 2.0
_ARMING_DELAY = 2.0
"""Seconds after arming in which the motors do not turn."""
_CHECK_INTERVAL = 1.0
_ALIGNED_AFTER = 5.0
"""Seconds of flight after which the estimator reports its heading as aligned."""
_IDLE_TIME = 0.4
"""Seconds on the ground after which the autopilot disarms when it has landed by itself."""
_VERTICAL_INTEGRAL = 1.1
"""Integral gain on the vertical velocity error, 1/s², over PSC_VELZ_P · PSC_ACCZ_I.

ArduCopter closes a loop on the measured acceleration; at a hover throttle of 0.39 its gains are
1.26 and 2.5 /s, and the integral becomes 2.5 / (1 + 1.26)."""


class ArduPilot(Autopilot):
    """ArduCopter of one vehicle.

    ``submode`` is the kind of GUIDED ("takeoff", "posvel", …), ``stage`` the part of RTL.
    """

    streams = STREAMS
    gain_parameters = ("PSC_", "ANGLE_", "MOT_SPOOL", "TKOFF_")

    def __init__(self, vehicle: Vehicle) -> None:
        self.booted = -math.inf
        vehicle.parameters.bytewise = False
        table = {**PARAMETERS, **SIM_PARAMETERS, "SYSID_THISMAV": vehicle.system}
        super().__init__(vehicle, table, KINDS)

    def reset(self) -> None:
        """Set the state after a boot."""
        super().reset()
        self.mode = STABILIZE
        self.submode = ""
        self.setpoint_at = self.descend_at = self.takeoff_at = self.disarmed_at = -math.inf
        self.takeoff_height = self.takeoff_from = self.idle_since = self.stage_at = 0.0
        self.accepted_mask: int | None = None
        self.gcs_lost = self.radio_failed = False
        self.checked = (-math.inf, False)
        self.outside_fences = 0
        self.battery_low_at = {1: math.inf, 2: math.inf}
        self.position_lost_at: float | None = None
        self.prearm_at = 0.0
        self.tumbled_at: float | None = None
        self.landed_at = math.inf

    @property
    def logging(self) -> bool:
        """Whether the autopilot writes its log: while armed, and for a while afterwards."""
        return self.v.armed or self.v.now - self.disarmed_at < _LOGS_ON

    @property
    def failsafe_active(self) -> bool:
        """Whether HEARTBEAT reports an active failsafe, in flight or not."""
        reported = self.gcs_lost or self.radio_failed or self.battery_level > 0
        return self.failsafe or reported

    @property
    def taking_off(self) -> bool:
        """Whether NAV_TAKEOFF is active: until its height, or a setpoint."""
        if self.submode != "takeoff":
            return False
        height = float(self.v.estimated()[2]) - self.takeoff_from
        return height < _TAKEN_OFF * (self.takeoff_height - self.takeoff_from)

    @property
    def target_mask(self) -> int | None:
        """Type mask of POSITION_TARGET_LOCAL_NED: the values that GUIDED accepted."""
        return self.accepted_mask if self.mode == GUIDED else None

    def custom_mode(self) -> int:
        """Return the mode's number."""
        return self.mode

    def base_mode(self) -> int:
        """Return the MAV_MODE_FLAG bits."""
        guided = 8 if MODES[self.mode].autonomous or self.mode == LOITER else 0
        return 1 | 16 | 64 | guided | (128 if self.v.armed else 0)

    def position_ok(self) -> bool:
        """Return whether the estimator has an absolute position."""
        return self.v.local_valid and self.v.now - self.booted >= POSITION_READY

    def restart(self) -> None:
        """Boot: the estimator has a position after 42 s."""
        v = self.v
        self.reset()
        self.booted = v.now
        self.has_origin = False
        v.timers.append((v.now + POSITION_READY, self._set_origin))

    def _set_origin(self) -> None:
        v = self.v
        self.has_origin = True
        self.set_home()
        v.text(INFO, "EKF3 IMU0 origin set")
        v.text(INFO, "EKF3 IMU0 is using GPS")

    def apply_gains(self) -> None:
        """Copy the controller parameters into the bodies."""
        p, b, i = self.v.parameters, self.v.bodies, self.v.index
        self.v.set_gains(
            (p["PSC_POSXY_P"], p["PSC_POSZ_P"]),
            (p["PSC_VELXY_P"], p["PSC_VELZ_P"]),
            (p["PSC_VELXY_I"], _VERTICAL_INTEGRAL * p["PSC_VELZ_P"] * p["PSC_ACCZ_I"]),
        )
        angle = min(80.0, max(10.0, p["ANGLE_MAX"] / 100.0))
        b.tilt_limit[i] = math.tan(math.radians(angle))
        b.spool_time[i] = _ARMING_DELAY + max(0.1, p["MOT_SPOOL_TIME"])
        b.ramp_time[i] = max(0.1, 0.5 * p["TKOFF_SLEW_TIME"])
        b.land_time[i] = 1.0
        b.cut_time[i] = 0.6
        b.refresh()

    def ready_to_arm(self) -> bool:
        """Return the pre-arm bit: the result of the last checks, which run once a second."""
        now = self.v.now
        if not 0.0 <= now - self.checked[0] < _CHECK_INTERVAL:
            self.checked = now, self.refusal() is None
        return self.checked[1]

    def set_mode(self, base: int, custom: int) -> int:
        """Execute the legacy message SET_MODE."""
        return self.change(custom) if base & 1 else DENIED

    def pilot_override(self) -> None:
        """Select LOITER, as a pilot's switch does."""
        self.change(LOITER)

    def leave_offboard(self) -> None:
        """Change from GUIDED to BRAKE without a reason that the ground station receives."""
        self.change(BRAKE)

    def update(self) -> float:
        """Check timers and conditions, at most 25 times a second; return when to check next."""
        self._check()
        v = self.v
        if not v.armed:
            return self.slow_at
        if self.mode != GUIDED or v.landed or self.submode not in {"posvel", "stopped"}:
            return -math.inf
        if self.submode == "stopped" or self.tumbled_at is not None:
            return self.slow_at
        return min(self.slow_at, self.setpoint_at + v.parameters["GUID_TIMEOUT"])

    def _check(self) -> None:
        v = self.v
        slow = v.now >= self.slow_at
        if slow:
            self.slow_at = v.now + SLOW_INTERVAL
        if not v.armed:
            self._report_refusal()
            if slow:
                self.watch_ground_station()
            return
        if v.bodies.tumbling[v.index] and self._crash_check():
            return
        if slow:
            self.watch()
        if v.landed:
            self._on_ground()
            return
        if not self.has_flown:
            v.timers.append((v.now + _ALIGNED_AFTER, self._report_alignment))
        self.has_flown = True
        self.idle_since, self.landed_at = v.now, math.inf
        self.steer()

    def _report_alignment(self) -> None:
        if not self.v.landed:
            for core in (0, 1):
                text = f"EKF3 IMU{core} MAG0 in-flight yaw alignment complete"
                self.v.text(INFO, text)

    def _crash_check(self) -> bool:
        """Disarm after two seconds upside down with running motors; return whether it did."""
        v = self.v
        if self.tumbled_at is None:
            self.tumbled_at = v.now
        if v.now - self.tumbled_at < _CRASH_TIME or not v.parameters["FS_CRASH_CHECK"]:
            return False
        v.text(CRITICAL, "Crash: Disarming: AngErr=90>30, Accel=1.0<3.0")
        self.disarm("crash check")
        return True

    def _report_refusal(self) -> None:
        v = self.v
        if v.now - self.prearm_at < _PREARM_INTERVAL:
            return
        self.prearm_at = v.now
        reason = self.refusal()
        if reason:
            v.text(CRITICAL, reason)

    def _on_ground(self) -> None:
        v = self.v
        if self.has_flown and (self.mode == LAND or self.stage == "land"):
            if self.landed_at == math.inf:
                self.landed_at = v.now
                v.environment.event("landed", v.system)
            if v.now - self.landed_at >= _IDLE_TIME:
                self.disarm("landed")
        elif self.submode == "takeoff" and v.bodies.may_lift[v.index]:
            self.idle_since = v.now
        elif 0 < v.parameters["DISARM_DELAY"] < v.now - self.idle_since:
            self.disarm("idle")

    def handle_setpoint(self, setpoint: wire.Setpoint) -> None:
        """Accept a setpoint in GUIDED; the mask selects position, velocity or acceleration."""
        v = self.v
        mask = setpoint.mask
        if self.mode != GUIDED or not v.armed or mask & _FORCE:
            return
        if setpoint.frame not in {_LOCAL, _LOCAL_OFFSET, _BODY, _BODY_OFFSET}:
            return
        if self.submode == "takeoff" and v.landed:
            if v.now - self.takeoff_at < _TAKEOFF_CANCELLED:
                v.bodies.may_lift[v.index] = False
        elif not v.bodies.may_lift[v.index] and v.landed:
            return
        position, velocity, acceleration = self._in_world(setpoint)
        used = [
            values
            for values, bits in ((position, _POSITION), (velocity, _VELOCITY),
                                 (acceleration, _ACCELERATION))
            if not mask & bits
        ]  # fmt: skip
        total = sum(map(sum, used))
        if total - total != 0.0:
            return
        self.setpoint_at = v.now
        self._follow(mask, position, velocity, acceleration)
        v.face(mask, setpoint.yaw)

    def _follow(
        self, mask: int, position: _Vector, velocity: _Vector, acceleration: _Vector
    ) -> None:
        v, b, i = self.v, self.v.bodies, self.v.index
        zero = (0.0, 0.0, 0.0)
        if mask & _ACCELERATION:
            acceleration = zero
        if not mask & _POSITION and not mask & _VELOCITY:
            kind, ignored = "posvel", mask & _ACCELERATION
            goal = (*position, *velocity, *acceleration)
            axes = 1.0
        elif not mask & _POSITION and mask & _ACCELERATION:
            kind, ignored = "position", _VELOCITY | _ACCELERATION
            goal, axes = (*position, *zero, *zero), 1.0
        elif mask & _POSITION and not mask & _VELOCITY:
            kind, ignored = "velocity", _POSITION | (mask & _ACCELERATION)
            goal, axes = (*v.estimated(), *velocity, *acceleration), 0.0
        elif mask & _POSITION and not mask & _ACCELERATION:
            kind, ignored = "acceleration", _POSITION | _VELOCITY
            goal, axes = (*v.estimated(), *zero, *acceleration), 0.0
        else:
            kind, ignored = "velocity", _POSITION
            goal, axes = (*v.estimated(), *zero, *zero), 0.0
        if kind == self.submode == "posvel":
            b.set_goal_values(i, goal)
        else:
            self.submode = kind
            b.goal_moves[i] = 1.0 if kind == "posvel" else 0.0
            hold = 0.0 if kind == "acceleration" else 1.0
            b.set_goal(i, goal, (axes, axes, axes), (hold, hold, hold))
        self.accepted_mask = ignored | (mask & _YAW_BITS)

    def _in_world(self, s: wire.Setpoint) -> tuple[_Vector, _Vector, _Vector]:
        """Return position, velocity and acceleration in world ENU, from any of the four frames."""
        v = self.v
        n, e, d, vn, ve, vd, an, ae, ad = s.values
        if s.frame == _LOCAL:
            place = v.to_world(n, e, d)
        else:
            x, y, z = v.estimated().tolist()
            if s.frame in {_BODY, _BODY_OFFSET}:
                yaw = math.pi / 2 - float(v.bodies.yaw[v.index])
                cos, sin = math.cos(yaw), math.sin(yaw)
                n, e = n * cos - e * sin, n * sin + e * cos
                vn, ve = vn * cos - ve * sin, vn * sin + ve * cos
                an, ae = an * cos - ae * sin, an * sin + ae * cos
            place = (x + e, y + n, z - d)
        return place, (ve, vn, -vd), (ae, an, -ad)

    def refusal(self) -> str | None:
        """Return why arming would fail now, None if it would succeed."""
        v = self.v
        needs_position = MODES[self.mode].position and not self.position_ok()
        checks = (
            (v.now - self.booted < _BASIC_READY, "Gyros not calibrated"),
            (bool(v.refuse_arming), v.refuse_arming),
            (needs_position, "Need Position Estimate"),
            (bool(v.bodies.crashed[v.index]), "Motors: Check frame"),
            (v.spec.radio and v.radio_lost, "Radio failsafe on"),
            (self.gcs_lost, "GCS failsafe on"),
            (bool(self.beyond_fence()), "Vehicle breaching fence"),
            (self.battery_level > 0, "Battery 1 low voltage failsafe"),
        )
        return next((f"PreArm: {text}" for failed, text in checks if failed), None)

    def beyond_fence(self) -> int:
        """Return the fences (bits of FENCE_TYPE) that the vehicle is outside of."""
        v, p = self.v, self.v.parameters
        if not p.integer("FENCE_ENABLE") or not self.position_ok():
            return 0
        here, home = v.estimated(), v.home if v.home is not None else v.origin
        outside = 0
        if here[2] - home[2] > p["FENCE_ALT_MAX"]:
            outside |= ALTITUDE
        if math.hypot(here[0] - home[0], here[1] - home[1]) > p["FENCE_RADIUS"]:
            outside |= CIRCLE
        if breached(v.fence, float(here[0]), float(here[1])):
            outside |= POLYGON
        return outside & p.integer("FENCE_TYPE")

    def change(self, number: int, *, failsafe: bool = False) -> int:
        """Change the mode, if it exists and can run; return the MAV_RESULT."""
        v = self.v
        if number not in MODES:
            v.text(WARNING, f"No such mode {number}")
            return FAILED
        mode = MODES[number]
        if v.armed and mode.position and not self.position_ok():
            v.text(WARNING, f"Mode change to {mode.name} failed: requires position")
            return FAILED
        if number == self.mode and not failsafe:
            return ACCEPTED
        if number == AUTO:
            v.text(WARNING, "Mode change to AUTO failed: init failed")
            return FAILED
        self.mode = number
        self.failsafe = failsafe
        self.descend_at = v.now + _LAND_PAUSE if failsafe and number == LAND else v.now
        v.environment.event("mode", v.system, mode=mode.name, failsafe=failsafe)
        self._begin()
        return ACCEPTED

    def fail_to(self, mode: int) -> None:
        """Change the mode for a failsafe; the gripper opens too where FS_OPTIONS requires it."""
        v = self.v
        if v.parameters.integer("FS_OPTIONS") & _RELEASE_GRIPPER:
            v.gripper.start(GripperRequest(v.now, grab=False))
        if mode == RTL and (not self.position_ok() or v.home is None):
            mode = LAND
        self.change(mode, failsafe=True)

    def _begin(self) -> None:
        v, p = self.v, self.v.parameters
        self.landing = self.mode == LAND
        self.stage = ""
        self.submode = ""
        v.bodies.goal_moves[v.index] = 0.0
        v.bodies.may_lift[v.index] = False
        self.cruise()
        if not v.armed:
            return
        v.hold()
        if self.mode == LAND:
            rate = p["LAND_SPEED"] / 100.0 if v.now >= self.descend_at else 0.0
            v.descend(rate, steer=v.local_valid)

    def cruise(self) -> None:
        """Set the speed limits of autonomous flight."""
        p = self.v.parameters
        speeds = (p["WPNAV_SPEED"], p["WPNAV_SPEED_UP"], p["WPNAV_SPEED_DN"])
        self.v.limit_speeds(*(max(0.1, speed / 100.0) for speed in speeds))

    def refuse_arming(self) -> int | None:
        """Return the MAV_RESULT of a refusal, after its text; None where the checks pass."""
        reason = self.refusal()
        if not (reason or MODES[self.mode].armable):
            reason = f"Arm: {MODES[self.mode].name} mode not armable"
        if reason:
            self.v.text(CRITICAL, reason)
        return FAILED if reason else None

    def after_arming(self) -> None:
        """Report that the motors are armed; they wait for a take-off."""
        v = self.v
        v.bodies.may_lift[v.index] = False
        self.idle_since = v.now
        self.submode = ""
        self.set_home()
        v.text(INFO, "Arming motors")
        v.environment.event("armed", v.system)

    def after_disarming(self, reason: str) -> None:
        """Report that the motors are disarmed."""
        self.disarmed_at = self.v.now
        self.submode = ""
        self.landing = False
        self.v.text(INFO, "Disarming motors")
        self.v.environment.event("disarmed", self.v.system, reason=reason)

    def set_home(self) -> None:
        """Set home where the vehicle arms; indoors too, once the estimator has an origin."""
        v = self.v
        if v.global_valid or (v.environment.indoor and v.local_valid):
            v.set_home_here()
            send_now(v, "GPS_GLOBAL_ORIGIN", "HOME_POSITION")

    def _land(self) -> None:
        """Descend, faster above LAND_ALT_LOW over home; a failsafe's landing waits before it."""
        v, p = self.v, self.v.parameters
        if v.now < self.descend_at:
            return
        high = float(v.estimated()[2] - v.home_height()) > p["LAND_ALT_LOW"] / 100.0
        rate = p["WPNAV_SPEED_DN"] if high else p["LAND_SPEED"]
        v.bodies.set_climb_rate(v.index, -rate / 100.0)

    def _return(self) -> None:
        """Climb, fly home, wait RTL_LOIT_TIME, land."""
        v, p = self.v, self.v.parameters
        if v.home is None:
            return
        if self.stage == "wait":
            if v.now - self.stage_at > p["RTL_LOIT_TIME"] / 1000.0:
                self.begin_landing(p["LAND_SPEED"] / 100.0)
        elif self.stage == "land":
            self._land()
        elif self.fly_home(max(float(v.estimated()[2]), float(v.home[2]) + p["RTL_ALT"] / 100.0)):
            self.stage, self.stage_at = "wait", v.now

    def _guided(self) -> None:
        """Stop when no setpoint has arrived for GUID_TIMEOUT."""
        v = self.v
        if self.submode not in {"posvel", "velocity", "acceleration"}:
            return
        if v.now - self.setpoint_at > v.parameters["GUID_TIMEOUT"]:
            b, i = v.bodies, v.index
            b.goal_moves[i] = 0.0
            goal = (*b.goal_position[i], *[0.0] * 6)
            if self.submode != "posvel":
                goal = (*v.estimated(), *[0.0] * 6)
            self.submode = "stopped"
            b.set_goal(i, goal)

    def steer(self) -> None:
        """Update the goals of the active mode."""
        if self.mode == GUIDED:
            self._guided()
        elif self.mode == RTL:
            self._return()
        elif self.mode == LAND:
            self._land()

    def watch(self) -> None:
        """Check all failsafes; called a few times a second while armed."""
        v = self.v
        self.watch_ground_station()
        self._watch_radio()
        self._watch_fence()
        self._watch_battery()
        if v.local_valid and v.global_valid:
            self.position_lost_at = None
        elif not v.environment.indoor or not v.local_valid:
            self._watch_position()

    def watch_ground_station(self) -> None:
        """Detect the loss (FS_GCS_ENABLE) and return of the ground station, armed or not."""
        v, p = self.v, self.v.parameters
        latest = v.last_heartbeat.get(p.integer("SYSID_MYGCS"), -math.inf)
        if v.now - latest <= p["FS_GCS_TIMEOUT"]:
            self.gcs_connected = True
            if self.gcs_lost:
                self.gcs_lost = False
                v.text(WARNING, "GCS Failsafe Cleared")
        elif self.gcs_connected:
            self.gcs_connected = False
            self._ground_station_lost()

    def _ground_station_lost(self) -> None:
        v, p = self.v, self.v.parameters
        action = GROUND_STATION_LOSS.get(p.integer("FS_GCS_ENABLE"))
        if action is None:
            return
        self.gcs_lost = True
        if v.landed:
            v.text(WARNING, "GCS Failsafe - Disarming" if v.armed else "GCS Failsafe")
            self.disarm("ground station lost")
            return
        options = p.integer("FS_OPTIONS")
        manual = not MODES[self.mode].autonomous
        if self.mode == LAND:
            return
        if manual and options & _GCS_WITH_PILOT:
            v.text(WARNING, "GCS Failsafe - Continuing Pilot Control")
            return
        v.text(WARNING, "GCS Failsafe")
        self.fail_to(action)

    def _watch_radio(self) -> None:
        """Detect the loss of a pilot's radio that was connected (FS_THR_ENABLE, FS_OPTIONS)."""
        v, p = self.v, self.v.parameters
        if v.radio_connected:
            self.radio_failed = False
        if not self.radio_lost_for(_RADIO_TIMEOUT):
            return
        self.radio_failed = True
        action = RADIO_LOSS.get(p.integer("FS_THR_ENABLE"), LAND)
        options = p.integer("FS_OPTIONS")
        if action is None:
            return
        if v.landed:
            v.text(WARNING, "Radio Failsafe - Disarming")
            self.disarm("radio failsafe")
        elif self.mode == LAND and (options & _WHILE_LANDING or self.failsafe):
            v.text(WARNING, "Radio Failsafe - Continuing Landing")
        elif self.mode == GUIDED and options & _RADIO_IN_GUIDED:
            v.text(WARNING, "Radio Failsafe - Continuing Guided Mode")
        else:
            v.text(WARNING, "Radio Failsafe")
            self.fail_to(action)

    def _watch_fence(self) -> None:
        """Act when the vehicle leaves a fence (FENCE_ACTION)."""
        v, p = self.v, self.v.parameters
        outside = self.beyond_fence()
        fresh = outside & ~self.outside_fences
        self.outside_fences = outside
        if not fresh:
            return
        names = " and ".join(name for bit, name in _FENCES.items() if fresh & bit)
        v.text(WARNING, f"{names} fence breached")
        v.environment.event("fence", v.system)
        action = FENCE.get(p.integer("FENCE_ACTION"))
        if action is None:
            return
        if v.landed:
            self.disarm("fence breached")
        else:
            self.fail_to(action)

    def _watch_battery(self) -> None:
        v, p = self.v, self.v.parameters
        capacity = p["BATT_CAPACITY"]
        remaining = v.charge * capacity
        levels = (("LOW", "low"), ("CRT", "critical"))
        for level, (key, word) in enumerate(levels, start=1):
            volts, charge = p[f"BATT_{key}_VOLT"], p[f"BATT_{key}_MAH"]
            if v.voltage >= volts and remaining >= charge:
                self.battery_low_at[level] = math.inf
                continue
            self.battery_low_at[level] = since = min(v.now, self.battery_low_at[level])
            if level > self.battery_level and v.now - since >= p["BATT_LOW_TIMER"]:
                self.battery_level = level
                used = f"used {capacity - remaining:.0f} mAh"
                v.text(WARNING, f"Battery 1 is {word} {v.voltage:.2f}V {used}")
                if not v.landed:
                    v.text(WARNING, "Battery Failsafe")
                action = BATTERY.get(p.integer(f"BATT_FS_{key}_ACT"))
                if action is not None and not v.landed:
                    self.fail_to(action)

    def _watch_position(self) -> None:
        """Without GPS: an estimator failure (FS_EKF_ACTION), once."""
        v, p = self.v, self.v.parameters
        if self.position_lost_at is None:
            self.position_lost_at = v.now
        timeout = 1.0 if not v.local_valid else _ESTIMATOR_TIMEOUT
        if v.now - self.position_lost_at > timeout and self.mode != LAND:
            self.position_lost_at = math.inf
            v.text(CRITICAL, "EKF variance")
            if p.integer("FS_EKF_ACTION") in {1, 3} and not v.landed:
                v.text(CRITICAL, "EKF Failsafe: changed to LAND Mode")
                self.fail_to(LAND)
            else:
                v.text(CRITICAL, "EKF Failsafe")

    def _do_set_mode(self, command: Command) -> int:
        p = command.p
        return self.change(int(p[1])) if int(p[0]) & 1 else DENIED

    def _arm_disarm(self, command: Command) -> int:
        p = command.p
        v = self.v
        if p[0] == 1.0:
            return self.arm(force=p[1] == _FORCE_ARM)
        if p[0] != 0.0:
            return DENIED
        if not v.armed:
            return ACCEPTED
        if not v.landed and p[1] != _FORCE_DISARM:
            return FAILED
        self.disarm("command")
        return ACCEPTED

    def _takeoff(self, command: Command) -> int:
        p = command.p
        v = self.v
        if self.mode != GUIDED or not v.armed or not v.landed or not math.isfinite(p[6]):
            return FAILED
        if p[6] < 0.1:
            return FAILED
        self.submode = "takeoff"
        self.takeoff_at = v.now
        here = v.estimated()
        self.takeoff_height, self.takeoff_from = v.home_height() + p[6], float(here[2])
        v.bodies.may_lift[v.index] = True
        v.bodies.goal_moves[v.index] = 0.0
        self.cruise()
        v.go((here[0], here[1], max(self.takeoff_height, float(here[2]))))
        return ACCEPTED

    def _start_mission(self, _: Command) -> int:
        return self.change(AUTO)

    def _enable_fence(self, command: Command) -> int:
        if command.p[0] not in {0.0, 1.0}:
            return DENIED
        self.v.parameters.values["FENCE_ENABLE"] = int(command.p[0])
        return ACCEPTED

    def _command_land(self, _: Command) -> int:
        return self.change(LAND)

    def _command_return(self, _: Command) -> int:
        return self.change(RTL)

    def _reposition(self, command: Command) -> int:
        v, p, x, y = self.v, command.p, command.x, command.y
        if not math.isfinite(p[6]) or x == 2**31 - 1 or y == 2**31 - 1:
            return DENIED
        if self.mode != GUIDED:
            if not int(p[1]) & 1:
                return DENIED
            if self.change(GUIDED) != ACCEPTED:
                return FAILED
        if v.landed:
            return FAILED
        place = (
            *v.environment.geodesy.metres(x * 1e-7, y * 1e-7),
            p[6] - v.environment.geodesy.altitude,
        )
        self.cruise()
        self.submode = "position"
        v.go(place)
        return ACCEPTED

    def _terminate(self, command: Command) -> int:
        if command.p[0] > 0.5:
            self.disarm("terminated")
        return ACCEPTED

    commands: ClassVar[Commands] = {
        dialect.MAV_CMD_COMPONENT_ARM_DISARM: _arm_disarm,
        dialect.MAV_CMD_DO_SET_MODE: _do_set_mode,
        dialect.MAV_CMD_NAV_TAKEOFF: _takeoff,
        dialect.MAV_CMD_MISSION_START: _start_mission,
        dialect.MAV_CMD_DO_FENCE_ENABLE: _enable_fence,
        dialect.MAV_CMD_NAV_LAND: _command_land,
        dialect.MAV_CMD_NAV_RETURN_TO_LAUNCH: _command_return,
        dialect.MAV_CMD_DO_REPOSITION: _reposition,
        dialect.MAV_CMD_DO_FLIGHTTERMINATION: _terminate,
    }
