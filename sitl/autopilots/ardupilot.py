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
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import common as dialect

from sitl.autopilots import controller_goals, mission_flight, streams
from sitl.autopilots.mission_flight import DONE, LANDING, RETURNING
from sitl.protocol import fences, wire
from sitl.protocol.gripper import GripperRequest
from sitl.protocol.links import ACCEPTED, DENIED, FAILED, Command
from sitl.protocol.parameter_protocol import SIM_PARAMETERS
from sitl.protocol.parameters import INT8, INT16, INT32
from sitl.protocol.vehicle import MissionProgress, Vehicle


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


INFO, WARNING, CRITICAL = 6, 4, 2
"""MAV_SEVERITY."""
POSITION_READY = 42.0
"""Seconds after boot until the estimator has an absolute position."""
_TAKEN_OFF = 0.9
"""Share of the height at which a take-off ends."""
_LOGS_ON = 15.0
"""Seconds for which the log continues after disarming."""


class ArduPilot:
    """ArduCopter of one vehicle; the methods are those of `sitl.protocol.vehicle.Autopilot`.

    ``submode`` is the kind of GUIDED ("takeoff", "posvel", …) or AUTO, ``stage`` the part of RTL
    or of a mission's landing.
    """

    streams = STREAMS

    follows_setpoints = False
    """GUIDED's handling of a setpoint depends on too much to set only the goal."""

    def __init__(self, vehicle: Vehicle) -> None:
        self.v = vehicle
        self.booted = -math.inf
        self.has_origin = True
        self.reset()
        vehicle.parameters.bytewise = False
        table = {**PARAMETERS, **SIM_PARAMETERS, "SYSID_THISMAV": vehicle.system}
        vehicle.parameters.load(table, KINDS)
        self.apply_gains()

    def reset(self) -> None:
        """Set the state after a boot."""
        self.mode = STABILIZE
        self.failsafe = False
        self.landing = False
        self.submode = ""
        self.setpoint_at = self.descend_at = -math.inf
        self.takeoff_at = -math.inf
        self.takeoff_height = self.takeoff_from = 0.0
        self.idle_since = 0.0
        self.has_flown = False
        self.goal: Any = None
        self.stage = ""
        self.stage_at = 0.0
        self.accepted_mask: int | None = None
        self.gcs_connected = self.gcs_lost = False
        self.checked = (-math.inf, False)
        self.radio_known = self.radio_failed = False
        self.radio_lost_at: float | None = None
        self.outside_fences = 0
        self.v.mission_progress = MissionProgress(first=1)
        self.battery_level = 0
        self.battery_low_at = {1: math.inf, 2: math.inf}
        self.position_lost_at: float | None = None
        self.prearm_at = 0.0
        self.tumbled_at: float | None = None
        self.landed_at = math.inf
        self.disarmed_at = -math.inf
        self.slow_at = -math.inf
        self.pilot = False

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

    def note_setpoint(self, data: bytes, now: float) -> None:
        """Do nothing: see `follows_setpoints`."""

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
        set_home(self)
        v.text(INFO, "EKF3 IMU0 origin set")
        v.text(INFO, "EKF3 IMU0 is using GPS")

    def apply_gains(self) -> None:
        """Copy the controller parameters into the bodies."""
        p, b, i = self.v.parameters, self.v.bodies, self.v.index
        controller_goals.gains(
            self.v,
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

    def parameter_changed(self, name: str) -> None:
        """Apply a parameter that PARAM_SET changed."""
        if name.startswith(("PSC_", "ANGLE_", "MOT_SPOOL", "TKOFF_")):
            self.apply_gains()

    def ready_to_arm(self) -> bool:
        """Return the pre-arm bit: the result of the last checks, which run once a second."""
        now = self.v.now
        if not 0.0 <= now - self.checked[0] < _CHECK_INTERVAL:
            self.checked = now, refusal(self) is None
        return self.checked[1]

    def handle_command(self, command: Command) -> int | None:
        """Execute a command; return its MAV_RESULT, None for an unknown command."""
        handler = COMMANDS.get(command.number)
        return None if handler is None else handler(self, command)

    def handle_setpoint(self, setpoint: wire.Setpoint) -> None:
        """Accept or ignore SET_POSITION_TARGET_LOCAL_NED."""
        accept(self, setpoint)

    def set_mode(self, base: int, custom: int) -> int:
        """Execute the legacy message SET_MODE."""
        return change(self, custom) if base & 1 else DENIED

    def arm(self, force: bool) -> int:
        """Arm if the checks pass; return the MAV_RESULT."""
        return arm(self, force)

    def disarm(self, reason: str) -> None:
        """Stop the motors, on the ground or in flight."""
        disarm(self, reason)

    def pilot_override(self) -> None:
        """Select LOITER, as a pilot's switch does."""
        change(self, LOITER)

    def leave_offboard(self) -> None:
        """Change from GUIDED to BRAKE without a reason that the ground station receives."""
        change(self, BRAKE)

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
            self.slow_at = v.now + _SLOW_INTERVAL
        if not v.armed:
            self._report_refusal()
            if slow:
                watch_ground_station(self)
            return
        if v.bodies.tumbling[v.index] and self._crash_check():
            return
        if slow:
            watch(self)
        if v.landed:
            self._on_ground()
            return
        if not self.has_flown:
            v.timers.append((v.now + _ALIGNED_AFTER, self._report_alignment))
        self.has_flown = True
        self.idle_since, self.landed_at = v.now, math.inf
        steer(self)

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
        reason = refusal(self)
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
        elif self.submode in {"takeoff", "auto"} and v.bodies.may_lift[v.index]:
            self.idle_since = v.now
        elif 0 < v.parameters["DISARM_DELAY"] < v.now - self.idle_since:
            self.disarm("idle")


_LOCAL, _LOCAL_OFFSET, _BODY, _BODY_OFFSET = 1, 7, 8, 9
_TAKEOFF_CANCELLED = 0.2
_POSITION, _VELOCITY, _ACCELERATION, _FORCE = 7, 56, 448, 512
_NO_YAW, _YAW_BITS = 1024, 3072
_Vector = tuple[float, float, float]


def accept(copter: ArduPilot, setpoint: wire.Setpoint) -> None:
    """Accept a setpoint in GUIDED; the mask selects position, velocity or acceleration."""
    v = copter.v
    mask = setpoint.mask
    if copter.mode != GUIDED or not v.armed or mask & _FORCE:
        return
    if setpoint.frame not in {_LOCAL, _LOCAL_OFFSET, _BODY, _BODY_OFFSET}:
        return
    if copter.submode == "takeoff" and v.landed:
        if v.now - copter.takeoff_at < _TAKEOFF_CANCELLED:
            v.bodies.may_lift[v.index] = False
    elif not v.bodies.may_lift[v.index] and v.landed:
        return
    position, velocity, acceleration = _in_world(copter, setpoint)
    used = [
        values
        for values, bits in ((position, _POSITION), (velocity, _VELOCITY),
                             (acceleration, _ACCELERATION))
        if not mask & bits
    ]  # fmt: skip
    total = sum(map(sum, used))
    if total - total != 0.0:
        return
    copter.setpoint_at = v.now
    _follow(copter, mask, position, velocity, acceleration)
    if not mask & _NO_YAW and math.isfinite(setpoint.yaw):
        v.bodies.goal_yaw[v.index] = math.pi / 2 - setpoint.yaw


def _follow(
    copter: ArduPilot, mask: int, position: _Vector, velocity: _Vector, acceleration: _Vector
) -> None:
    v, b, i = copter.v, copter.v.bodies, copter.v.index
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
    if kind == copter.submode == "posvel":
        b.set_goal_values(i, goal)
    else:
        copter.submode = kind
        b.goal_moves[i] = 1.0 if kind == "posvel" else 0.0
        hold = 0.0 if kind == "acceleration" else 1.0
        b.set_goal(i, goal, (axes, axes, axes), (hold, hold, hold))
    copter.accepted_mask = ignored | (mask & _YAW_BITS)


def _in_world(copter: ArduPilot, s: wire.Setpoint) -> tuple[_Vector, _Vector, _Vector]:
    """Return position, velocity and acceleration in world ENU, from any of the four frames."""
    v = copter.v
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


_BASIC_READY = 10.0
ALTITUDE, CIRCLE, POLYGON = 1, 2, 4
"""FENCE_TYPE."""


def refusal(copter: ArduPilot) -> str | None:
    """Return why arming would fail now, None if it would succeed."""
    v = copter.v
    needs_position = MODES[copter.mode].position and not copter.position_ok()
    checks = (
        (v.now - copter.booted < _BASIC_READY, "Gyros not calibrated"),
        (bool(v.refuse_arming), v.refuse_arming),
        (needs_position, "Need Position Estimate"),
        (bool(v.bodies.crashed[v.index]), "Motors: Check frame"),
        (v.spec.radio and v.radio_lost, "Radio failsafe on"),
        (copter.gcs_lost, "GCS failsafe on"),
        (bool(beyond_fence(copter)), "Vehicle breaching fence"),
        (copter.battery_level > 0, "Battery 1 low voltage failsafe"),
    )
    return next((f"PreArm: {text}" for failed, text in checks if failed), None)


def beyond_fence(copter: ArduPilot) -> int:
    """Return the fences (bits of FENCE_TYPE) that the vehicle is outside of."""
    v, p = copter.v, copter.v.parameters
    if not p.integer("FENCE_ENABLE") or not copter.position_ok():
        return 0
    here, home = v.estimated(), v.home if v.home is not None else v.origin
    found = 0
    if here[2] - home[2] > p["FENCE_ALT_MAX"]:
        found |= ALTITUDE
    if math.hypot(here[0] - home[0], here[1] - home[1]) > p["FENCE_RADIUS"]:
        found |= CIRCLE
    if fences.breached(v.fence, float(here[0]), float(here[1])):
        found |= POLYGON
    return found & p.integer("FENCE_TYPE")


_RELEASE_GRIPPER = 32
"""FS_OPTIONS."""
_LAND_PAUSE = 4.0
"""Seconds for which a failsafe's landing hovers first (LAND_WITH_DELAY_MS in its source)."""


def change(copter: ArduPilot, number: int, *, failsafe: bool = False) -> int:
    """Change the mode, if it exists and can run; return the MAV_RESULT."""
    v = copter.v
    if number not in MODES:
        v.text(WARNING, f"No such mode {number}")
        return FAILED
    mode = MODES[number]
    if v.armed and mode.position and not copter.position_ok():
        v.text(WARNING, f"Mode change to {mode.name} failed: requires position")
        return FAILED
    if number == copter.mode and not failsafe:
        return ACCEPTED
    if number == AUTO and not _can_start_mission(copter):
        return FAILED
    copter.mode = number
    copter.failsafe = failsafe
    copter.descend_at = v.now + _LAND_PAUSE if failsafe and number == LAND else v.now
    v.environment.event("mode", v.system, mode=mode.name, failsafe=failsafe)
    _begin(copter)
    return ACCEPTED


def fail_to(copter: ArduPilot, mode: int) -> None:
    """Change the mode for a failsafe; the gripper opens too where FS_OPTIONS requires it."""
    v = copter.v
    if v.parameters.integer("FS_OPTIONS") & _RELEASE_GRIPPER:
        v.gripper.start(GripperRequest(v.now, grab=False))
    if mode == RTL and (not copter.position_ok() or v.home is None):
        mode = LAND
    change(copter, mode, failsafe=True)


def _can_start_mission(copter: ArduPilot) -> bool:
    """Return whether a mission exists that AUTO can start now."""
    v = copter.v
    if len(v.mission[0]) <= 1:
        v.text(WARNING, "Mode change to AUTO failed: init failed")
        return False
    if v.armed and v.landed and not mission_flight.starts_with_takeoff(v):
        v.text(CRITICAL, "Auto: Missing Takeoff Cmd")
        return False
    return True


def _begin(copter: ArduPilot) -> None:
    v, p = copter.v, copter.v.parameters
    copter.landing = copter.mode == LAND
    copter.stage = ""
    copter.submode = ""
    v.bodies.goal_moves[v.index] = 0.0
    v.bodies.may_lift[v.index] = False
    cruise(copter)
    if not v.armed:
        return
    controller_goals.hold(v)
    if copter.mode == AUTO:
        copter.submode = "" if v.landed else "auto"
    elif copter.mode == LAND:
        rate = p["LAND_SPEED"] / 100.0 if v.now >= copter.descend_at else 0.0
        controller_goals.descend(v, rate, steer=v.local_valid)


def cruise(copter: ArduPilot) -> None:
    """Set the speed limits of autonomous flight."""
    p = copter.v.parameters
    speeds = (p["WPNAV_SPEED"], p["WPNAV_SPEED_UP"], p["WPNAV_SPEED_DN"])
    controller_goals.limits(copter.v, *(max(0.1, speed / 100.0) for speed in speeds))


def arm(copter: ArduPilot, force: bool) -> int:
    """Arm if the checks pass; return the MAV_RESULT."""
    v = copter.v
    if v.armed:
        return ACCEPTED
    reason = refusal(copter)
    if not force:
        if reason:
            v.text(CRITICAL, reason)
            return FAILED
        if not MODES[copter.mode].armable:
            v.text(CRITICAL, f"Arm: {MODES[copter.mode].name} mode not armable")
            return FAILED
    v.bodies.armed[v.index] = True
    v.bodies.landed[v.index] = True
    v.bodies.may_lift[v.index] = False
    copter.idle_since = v.now
    copter.has_flown = False
    copter.submode = ""
    set_home(copter)
    v.text(INFO, "Arming motors")
    v.environment.event("armed", v.system)
    return ACCEPTED


def disarm(copter: ArduPilot, reason: str) -> None:
    """Stop the motors, on the ground or in flight."""
    v = copter.v
    if not v.armed:
        return
    v.bodies.armed[v.index] = False
    v.bodies.landed[v.index] = True
    copter.disarmed_at = v.now
    v.bodies.goal_moves[v.index] = 0.0
    controller_goals.idle(v)
    copter.submode = ""
    copter.landing = False
    v.text(INFO, "Disarming motors")
    v.environment.event("disarmed", v.system, reason=reason)


def set_home(copter: ArduPilot) -> None:
    """Set home where the vehicle arms; indoors too, once the estimator has an origin."""
    v = copter.v
    if v.global_valid or (v.environment.indoor and v.local_valid):
        v.set_home_here()
        streams.send_now(v, "GPS_GLOBAL_ORIGIN", "HOME_POSITION")


def _land(copter: ArduPilot) -> None:
    """Descend, faster above LAND_ALT_LOW over home; a failsafe's landing waits before it."""
    v, p = copter.v, copter.v.parameters
    if v.now < copter.descend_at:
        return
    home = v.home[2] if v.home is not None else v.origin[2]
    high = float(v.estimated()[2] - home) > p["LAND_ALT_LOW"] / 100.0
    rate = p["WPNAV_SPEED_DN"] if high else p["LAND_SPEED"]
    v.bodies.set_climb_rate(v.index, -rate / 100.0)


def _return(copter: ArduPilot) -> None:
    """Climb, fly home, wait RTL_LOIT_TIME, land."""
    v, p = copter.v, copter.v.parameters
    if v.home is None:
        return
    here, home = v.estimated(), v.home
    away = float(np.hypot(*(home - here)[:2]))
    if copter.stage == "":
        top = max(float(here[2]), float(home[2]) + p["RTL_ALT"] / 100.0)
        copter.goal = np.array([here[0], here[1], top])
        copter.stage = "climb"
        controller_goals.go(v, copter.goal)
    elif copter.stage == "climb" and here[2] > copter.goal[2] - 0.5:
        copter.goal = np.array([home[0], home[1], copter.goal[2]])
        copter.stage = "home"
        controller_goals.go(v, copter.goal)
    elif copter.stage == "home" and away < 0.5:
        copter.stage, copter.stage_at = "wait", v.now
    elif copter.stage == "wait" and v.now - copter.stage_at > p["RTL_LOIT_TIME"] / 1000.0:
        copter.stage, copter.landing = "land", True
        controller_goals.descend(v, p["LAND_SPEED"] / 100.0, steer=True)
    elif copter.stage == "land":
        _land(copter)


def _guided(copter: ArduPilot) -> None:
    """Stop when no setpoint has arrived for GUID_TIMEOUT."""
    v = copter.v
    if copter.submode not in {"posvel", "velocity", "acceleration"}:
        return
    if v.now - copter.setpoint_at > v.parameters["GUID_TIMEOUT"]:
        b, i = v.bodies, v.index
        b.goal_moves[i] = 0.0
        goal = (*b.goal_position[i], *[0.0] * 6)
        if copter.submode != "posvel":
            goal = (*v.estimated(), *[0.0] * 6)
        copter.submode = "stopped"
        b.set_goal(i, goal)


def _fly_mission(copter: ArduPilot) -> None:
    v, p = copter.v, copter.v.parameters
    if copter.submode != "auto":
        return
    if copter.stage == "land":
        _land(copter)
        return
    result = mission_flight.steer(v, p["WPNAV_RADIUS"] / 100.0)
    if result == RETURNING:
        change(copter, RTL)
    elif result == DONE:
        v.mission_progress.restart()
        copter.submode = "done"
        controller_goals.hold(v)
    elif result == LANDING:
        copter.stage, copter.landing = "land", True
        controller_goals.descend(v, p["LAND_SPEED"] / 100.0, steer=True)


def steer(copter: ArduPilot) -> None:
    """Update the goals of the active mode."""
    step = _STEPS.get(copter.mode)
    if step is not None:
        step(copter)


_STEPS = {GUIDED: _guided, RTL: _return, LAND: _land, AUTO: _fly_mission}


_RADIO_IN_AUTO, _GCS_IN_AUTO, _RADIO_IN_GUIDED, _WHILE_LANDING, _GCS_WITH_PILOT = 1, 2, 4, 8, 16
"""FS_OPTIONS: conditions in which a failsafe does not change the mode."""
_RADIO_TIMEOUT = 1.0
"""Seconds without pulses until a radio counts as lost: RC_FS_TIMEOUT's default; measured."""
_ESTIMATOR_TIMEOUT = 8.0
"""Seconds without a receiver until the estimator's variances are a failure: measured on 4.6.2.

The dead reckoning failsafe (FS_DR_ENABLE) does not come before it: it needs an estimate of the
wind (EK3_DRAG_BCOEF_X), which multicopters have only where somebody has measured their drag."""
_FENCES = {ALTITUDE: "Max Alt", CIRCLE: "Circle", POLYGON: "Polygon"}


def watch(copter: ArduPilot) -> None:
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


def watch_ground_station(copter: ArduPilot) -> None:
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


def _ground_station_lost(copter: ArduPilot) -> None:
    v, p = copter.v, copter.v.parameters
    action = GROUND_STATION_LOSS.get(p.integer("FS_GCS_ENABLE"))
    if action is None:
        return
    copter.gcs_lost = True
    if v.landed:
        v.text(WARNING, "GCS Failsafe - Disarming" if v.armed else "GCS Failsafe")
        disarm(copter, "ground station lost")
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
    fail_to(copter, action)


def _watch_radio(copter: ArduPilot) -> None:
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
        disarm(copter, "radio failsafe")
    elif copter.mode == LAND and (options & _WHILE_LANDING or copter.failsafe):
        v.text(WARNING, "Radio Failsafe - Continuing Landing")
    elif copter.mode == AUTO and options & _RADIO_IN_AUTO:
        v.text(WARNING, "Radio Failsafe - Continuing Auto Mode")
    elif copter.mode == GUIDED and options & _RADIO_IN_GUIDED:
        v.text(WARNING, "Radio Failsafe - Continuing Guided Mode")
    else:
        v.text(WARNING, "Radio Failsafe")
        fail_to(copter, action)


def _watch_fence(copter: ArduPilot) -> None:
    """Act when the vehicle leaves a fence (FENCE_ACTION)."""
    v, p = copter.v, copter.v.parameters
    outside = beyond_fence(copter)
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
        disarm(copter, "fence breached")
    else:
        fail_to(copter, action)


def _watch_battery(copter: ArduPilot) -> None:
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
                fail_to(copter, action)


def _watch_position(copter: ArduPilot) -> None:
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
            fail_to(copter, LAND)
        else:
            v.text(CRITICAL, "EKF Failsafe")


_FORCE_ARM, _FORCE_DISARM = 2989, 21196


def _do_set_mode(copter: ArduPilot, command: Command) -> int:
    p = command.p
    return change(copter, int(p[1])) if int(p[0]) & 1 else DENIED


def _arm_disarm(copter: ArduPilot, command: Command) -> int:
    p = command.p
    v = copter.v
    if p[0] == 1.0:
        return arm(copter, force=p[1] == _FORCE_ARM)
    if p[0] != 0.0:
        return DENIED
    if not v.armed:
        return ACCEPTED
    if not v.landed and p[1] != _FORCE_DISARM:
        return FAILED
    disarm(copter, "command")
    return ACCEPTED


def _takeoff(copter: ArduPilot, command: Command) -> int:
    p = command.p
    v = copter.v
    if copter.mode != GUIDED or not v.armed or not v.landed or not math.isfinite(p[6]):
        return FAILED
    if p[6] < 0.1:
        return FAILED
    copter.submode = "takeoff"
    copter.takeoff_at = v.now
    home = v.home if v.home is not None else v.origin
    here = v.estimated()
    copter.takeoff_height, copter.takeoff_from = float(home[2]) + p[6], float(here[2])
    v.bodies.may_lift[v.index] = True
    v.bodies.goal_moves[v.index] = 0.0
    cruise(copter)
    controller_goals.go(v, (here[0], here[1], max(copter.takeoff_height, float(here[2]))))
    return ACCEPTED


def _start_mission(copter: ArduPilot, _: Command) -> int:
    """Start the mission, from the ground too, without arming."""
    v = copter.v
    if change(copter, AUTO) != ACCEPTED or not v.armed:
        return FAILED
    copter.submode = "auto"
    v.bodies.may_lift[v.index] = True
    steer(copter)
    return ACCEPTED


def _jump(copter: ArduPilot, command: Command) -> int:
    number, v = command.p[0], copter.v
    found = math.isfinite(number) and v.mission_progress.jump_to(int(number), len(v.mission[0]))
    return ACCEPTED if found else DENIED


def _enable_fence(copter: ArduPilot, command: Command) -> int:
    if command.p[0] not in {0.0, 1.0}:
        return DENIED
    copter.v.parameters.values["FENCE_ENABLE"] = int(command.p[0])
    return ACCEPTED


def _command_land(copter: ArduPilot, _: Command) -> int:
    return change(copter, LAND)


def _command_return(copter: ArduPilot, _: Command) -> int:
    return change(copter, RTL)


def _reposition(copter: ArduPilot, command: Command) -> int:
    p, x, y = command.p, command.x, command.y
    v = copter.v
    if not math.isfinite(p[6]) or x == 2**31 - 1 or y == 2**31 - 1:
        return DENIED
    if copter.mode != GUIDED:
        if not int(p[1]) & 1:
            return DENIED
        if change(copter, GUIDED) != ACCEPTED:
            return FAILED
    if v.landed:
        return FAILED
    place = (
        *v.environment.geodesy.metres(x * 1e-7, y * 1e-7),
        p[6] - v.environment.geodesy.altitude,
    )
    cruise(copter)
    copter.submode = "position"
    controller_goals.go(v, place)
    return ACCEPTED


def _speed(copter: ArduPilot, command: Command) -> int:
    controller_goals.set_speed(copter.v, command.p[1])
    return ACCEPTED


def _terminate(copter: ArduPilot, command: Command) -> int:
    if command.p[0] > 0.5:
        disarm(copter, "terminated")
    return ACCEPTED


COMMANDS: dict[int, Callable[[ArduPilot, Command], int]] = {
    dialect.MAV_CMD_COMPONENT_ARM_DISARM: _arm_disarm,
    dialect.MAV_CMD_DO_SET_MODE: _do_set_mode,
    dialect.MAV_CMD_NAV_TAKEOFF: _takeoff,
    dialect.MAV_CMD_MISSION_START: _start_mission,
    dialect.MAV_CMD_DO_SET_MISSION_CURRENT: _jump,
    dialect.MAV_CMD_DO_FENCE_ENABLE: _enable_fence,
    dialect.MAV_CMD_NAV_LAND: _command_land,
    dialect.MAV_CMD_NAV_RETURN_TO_LAUNCH: _command_return,
    dialect.MAV_CMD_DO_REPOSITION: _reposition,
    dialect.MAV_CMD_DO_CHANGE_SPEED: _speed,
    dialect.MAV_CMD_DO_FLIGHTTERMINATION: _terminate,
}


_SLOW_INTERVAL = 0.4
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
