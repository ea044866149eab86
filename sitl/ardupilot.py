"""ArduCopter (4.6) as a ground station meets it: modes, arming, GUIDED, take-off, failsafes.

Behaviour from ArduPilot's documentation and source (``GCS_Mavlink.cpp``, ``mode_guided.cpp``,
``AP_Arming``, ``events.cpp``), and measurements on its software-in-the-loop build. Milder in one
place: without a pilot LOITER and its like hold, as with centred sticks.
"""

import math
from typing import Any

from sitl import (
    ardupilot_commands,
    ardupilot_failsafes,
    ardupilot_flight,
    controller_goals,
    fault_mapping,
    wire,
)
from sitl.ardupilot_tables import (
    AUTO,
    BRAKE,
    GUIDED,
    KINDS,
    LAND,
    LOITER,
    MODES,
    PARAMETERS,
    STABILIZE,
)
from sitl.route import Route
from sitl.vehicle import ACCEPTED, DENIED, FAILED, Command, Vehicle

_POSITION_READY, _BASIC_READY = 42.0, 10.0
_INFO, _WARNING, _CRITICAL = 6, 4, 2
_SLOW_BEAT = 0.4
_PREARM_EVERY = 30.0
_CRASH_TIME = 2.0
_TAKEN_OFF = 0.9
"""Share of the height at which a take-off is over."""
_ARMING_DELAY = 2.0
"""Seconds for which its motors stand still when it has been armed."""
_CHECKED_EVERY = 1.0
_LOGS_ON = 15.0
"""Seconds for which the log goes on when it is disarmed."""
_ALIGNED_AFTER = 5.0
"""Seconds of flight after which its estimator says that it knows its heading."""
_IDLE_TIME = 0.4
"""Seconds on the ground after which it disarms when it has landed by itself."""


class ArduPilot:
    """The flight code of one ArduCopter vehicle."""

    def __init__(self, vehicle: Vehicle) -> None:
        self.v = vehicle
        vehicle.parameters.bytewise = False
        table = {**PARAMETERS, **fault_mapping.PARAMETERS, "SYSID_THISMAV": vehicle.system}
        vehicle.parameters.load(table, KINDS)
        self.booted = -math.inf
        self.has_origin = True
        self._fresh()
        self.apply_gains()

    def _fresh(self) -> None:
        self.mode = STABILIZE
        self.failsafe = False
        self.landing = False
        self.submode = ""
        self.setpoint_at = -math.inf
        self.takeoff_at = -math.inf
        self.takeoff_height = self.takeoff_from = 0.0
        self.idle_since = 0.0
        self.flew = False
        self.goal: Any = None
        self.stage = ""
        self.stage_at = 0.0
        self.taken_mask: int | None = None
        self.gcs_seen = self.gcs_lost = False
        self.checked = (-math.inf, False)
        self.radio_seen = False
        self.outside = 0
        self.route = Route(self.v, 1)
        self.battery_level = 0
        self.battery_low_at = {1: math.inf, 2: math.inf}
        self.lost_at: float | None = None
        self.prearm_at = 0.0
        self.tumbled_at: float | None = None
        self.landed_at = math.inf
        self.disarmed_at = -math.inf
        self.slow_at = -math.inf
        self.all_axes = False
        self.pilot = False

    def restart(self) -> None:
        """Boot: some 42 s until the estimator gives a position."""
        v = self.v
        self._fresh()
        self.booted = v.now
        self.has_origin = False
        v.later.append((v.now + _POSITION_READY, self._found_position))

    def _found_position(self) -> None:
        v = self.v
        self.has_origin = True
        self._home_is_here()
        v.text(_INFO, "EKF3 IMU0 origin set")
        v.text(_INFO, "EKF3 IMU0 is using GPS")

    def _home_is_here(self) -> None:
        """Home is where it is armed; indoors too, once the estimator has been given an origin."""
        v = self.v
        if v.global_valid or (v.around.indoor and v.local_valid):
            v.home_is_here()
            v.tell("GPS_GLOBAL_ORIGIN", "HOME_POSITION")

    def apply_gains(self) -> None:
        """Carry controller parameters into the batch."""
        p, b, i = self.v.parameters, self.v.bodies, self.v.index
        controller_goals.gains(
            self.v,
            (p["PSC_POSXY_P"], p["PSC_POSZ_P"]),
            (p["PSC_VELXY_P"], p["PSC_VELZ_P"]),
            (p["PSC_VELXY_I"], 2.0 * p["PSC_ACCZ_I"]),
        )
        angle = min(80.0, max(10.0, p["ANGLE_MAX"] / 100.0))
        b.tilt_limit[i] = math.tan(math.radians(angle))
        b.spool_time[i] = _ARMING_DELAY + max(0.1, p["MOT_SPOOL_TIME"])
        b.ramp_time[i] = max(0.1, 0.5 * p["TKOFF_SLEW_TIME"])
        b.land_time[i] = 1.0
        b.cut_time[i] = 0.6
        b.touch()

    def parameter_changed(self, name: str) -> None:
        """React to PARAM_SET."""
        if name.startswith(("PSC_", "ANGLE_", "MOT_SPOOL", "TKOFF_")):
            self.apply_gains()

    # What is possible.

    def position_ok(self) -> bool:
        """Whether the estimator has an absolute position."""
        return self.v.local_valid and self.v.now - self.booted >= _POSITION_READY

    def refusal(self) -> str | None:
        """Why arming would fail now, None if it would not."""
        v = self.v
        needs_position = MODES[self.mode].position and not self.position_ok()
        checks = (
            (v.now - self.booted < _BASIC_READY, "Gyros not calibrated"),
            (bool(v.refuse_arming), v.refuse_arming),
            (needs_position, "Need Position Estimate"),
            (bool(v.bodies.crashed[v.index]), "Motors: Check frame"),
            (v.spec.radio and v.radio_lost, "Radio failsafe on"),
            (self.gcs_lost, "GCS failsafe on"),
            (bool(ardupilot_failsafes.beyond_fence(self)), "Vehicle breaching fence"),
            (self.battery_level > 0, "Battery 1 low voltage failsafe"),
        )
        return next((f"PreArm: {text}" for failed, text in checks if failed), None)

    def ready(self) -> bool:
        """The pre-arm bit: checks of the present mode were passed, when they were last made."""
        now = self.v.now
        if not 0.0 <= now - self.checked[0] < _CHECKED_EVERY:
            self.checked = now, self.refusal() is None
        return self.checked[1]

    @property
    def logging(self) -> bool:
        """Whether it logs: while it is armed, and a while after."""
        return self.v.armed or self.v.now - self.disarmed_at < _LOGS_ON

    @property
    def critical(self) -> bool:
        """Whether HEARTBEAT says that a failsafe is active, in flight or not."""
        return self.failsafe or self.gcs_lost

    @property
    def taking_off(self) -> bool:
        """Whether NAV_TAKEOFF is being carried out: until its height, or a setpoint."""
        if self.submode != "takeoff":
            return False
        height = float(self.v.estimated()[2]) - self.takeoff_from
        return height < _TAKEN_OFF * (self.takeoff_height - self.takeoff_from)

    def custom_mode(self) -> int:
        """The mode's number."""
        return self.mode

    def base_mode(self) -> int:
        """MAV_MODE_FLAG bits."""
        guided = 8 if MODES[self.mode].by_itself or self.mode == LOITER else 0
        return 1 | 16 | 64 | guided | (128 if self.v.armed else 0)

    @property
    def target_mask(self) -> int | None:
        """Type mask of POSITION_TARGET_LOCAL_NED: what GUIDED took."""
        return self.taken_mask if self.mode == GUIDED else None

    # Commands.

    def command(self, command: Command) -> int | None:
        """Carry out a command; return its result, None if this autopilot does not know it."""
        handler = ardupilot_commands.COMMANDS.get(command.number)
        return None if handler is None else handler(self, command)

    def set_mode(self, base: int, custom: int) -> int:
        """Legacy SET_MODE."""
        return self.change(custom) if base & 1 else DENIED

    def change(self, number: int, *, failsafe: bool = False) -> int:
        """Change the mode, if it exists and can run; return the MAV_RESULT."""
        if number not in MODES:
            self.v.text(_WARNING, f"No such mode {number}")
            return FAILED
        mode = MODES[number]
        if self.v.armed and mode.position and not self.position_ok():
            self.v.text(_WARNING, f"Mode change to {mode.name} failed: requires position")
            return FAILED
        if number == self.mode and not failsafe:
            return ACCEPTED
        if number == AUTO and not self._may_start():
            return FAILED
        self.mode = number
        self.failsafe = failsafe
        self.v.around.event("mode", self.v.system, mode=mode.name, failsafe=failsafe)
        self._begin()
        return ACCEPTED

    def _begin(self) -> None:
        v, p = self.v, self.v.parameters
        self.landing = self.mode == LAND
        self.stage = ""
        self.submode = ""
        self.all_axes = False
        v.bodies.advance[v.index] = 0.0
        v.bodies.may_lift[v.index] = False
        self.cruise()
        if not v.armed:
            return
        if self.mode == AUTO:
            controller_goals.hold(v)
            self.submode = "" if v.landed else "auto"
        elif self.mode == LAND:
            controller_goals.hold(v)
            controller_goals.sink(v, p["LAND_SPEED"] / 100.0, steer=v.local_valid)
        else:
            controller_goals.hold(v)

    def cruise(self) -> None:
        """Set the speed limits of flying by itself."""
        p = self.v.parameters
        speeds = (p["WPNAV_SPEED"], p["WPNAV_SPEED_UP"], p["WPNAV_SPEED_DN"])
        controller_goals.limits(self.v, *(max(0.1, speed / 100.0) for speed in speeds))

    def arm(self, force: bool) -> int:
        """Arm, if nothing speaks against it; return the MAV_RESULT."""
        v = self.v
        if v.armed:
            return ACCEPTED
        reason = self.refusal()
        if not force:
            if reason:
                v.text(_CRITICAL, reason)
                return FAILED
            if not MODES[self.mode].armable:
                v.text(_CRITICAL, f"Arm: {MODES[self.mode].name} mode not armable")
                return FAILED
        v.bodies.armed[v.index] = True
        v.bodies.landed[v.index] = True
        v.bodies.may_lift[v.index] = False
        self.idle_since = v.now
        self.flew = False
        self.submode = ""
        self._home_is_here()
        v.text(_INFO, "Arming motors")
        v.around.event("armed", v.system)
        return ACCEPTED

    def disarm(self, text: str) -> None:
        """Stop the motors, wherever the vehicle is."""
        v = self.v
        if not v.armed:
            return
        v.bodies.armed[v.index] = False
        v.bodies.landed[v.index] = True
        self.disarmed_at = v.now
        v.bodies.advance[v.index] = 0.0
        controller_goals.idle(v)
        self.submode = ""
        self.landing = False
        v.text(_INFO, "Disarming motors")
        v.around.event("disarmed", v.system, reason=text)

    def _may_start(self) -> bool:
        """Whether AUTO has a mission that can begin as things stand."""
        v = self.v
        if len(v.mission[0]) <= 1:
            v.text(_WARNING, "Mode change to AUTO failed: init failed")
            return False
        if v.armed and v.landed and not self.route.lifts:
            v.text(_CRITICAL, "Auto: Missing Takeoff Cmd")
            return False
        return True

    follows = False
    """Whatever GUIDED takes depends on too much to be taken in one go."""

    def followed(self, data: bytes, now: float) -> None:
        """Nothing: see `follows`."""

    def setpoint(self, setpoint: wire.Setpoint) -> None:
        """Take SET_POSITION_TARGET_LOCAL_NED."""
        ardupilot_flight.take(self, setpoint)

    # What flies.

    def tick(self) -> float:
        """Look at timers and conditions, up to twenty-five times a second."""
        self._look()
        v = self.v
        if not v.armed:
            return self.slow_at
        if self.mode != GUIDED or v.landed or self.submode not in {"posvel", "stopped"}:
            return -math.inf
        if self.submode == "stopped" or self.tumbled_at is not None:
            return self.slow_at
        return min(self.slow_at, self.setpoint_at + v.parameters["GUID_TIMEOUT"])

    def _look(self) -> None:
        v = self.v
        slow = v.now >= self.slow_at
        if slow:
            self.slow_at = v.now + _SLOW_BEAT
        if not v.armed:
            self._complain()
            if slow:
                ardupilot_failsafes.watch_ground_station(self)
            return
        if v.bodies.tumbling[v.index] and self._fell():
            return
        if slow:
            ardupilot_failsafes.watch(self)
        if v.landed:
            self._on_ground()
            return
        if not self.flew:
            v.later.append((v.now + _ALIGNED_AFTER, self._aligned))
        self.flew = True
        self.idle_since, self.landed_at = v.now, math.inf
        ardupilot_flight.steer(self)

    def _aligned(self) -> None:
        if not self.v.landed:
            for core in (0, 1):
                text = f"EKF3 IMU{core} MAG0 in-flight yaw alignment complete"
                self.v.text(_INFO, text)

    def _fell(self) -> bool:
        """The crash check: turned over for two seconds with motors running, it disarms."""
        v = self.v
        if self.tumbled_at is None:
            self.tumbled_at = v.now
        if v.now - self.tumbled_at < _CRASH_TIME or not v.parameters["FS_CRASH_CHECK"]:
            return False
        v.text(_CRITICAL, "Crash: Disarming: AngErr=90>30, Accel=1.0<3.0")
        self.disarm("crash check")
        return True

    def _complain(self) -> None:
        v = self.v
        if v.now - self.prearm_at < _PREARM_EVERY:
            return
        self.prearm_at = v.now
        reason = self.refusal()
        if reason:
            v.text(_CRITICAL, reason)

    def _on_ground(self) -> None:
        v = self.v
        if self.flew and (self.mode == LAND or self.stage == "land"):
            if self.landed_at == math.inf:
                self.landed_at = v.now
                v.around.event("landed", v.system)
            if v.now - self.landed_at >= _IDLE_TIME:
                self.disarm("landed")
        elif self.submode in {"takeoff", "auto"} and v.bodies.may_lift[v.index]:
            self.idle_since = v.now
        elif 0 < v.parameters["DISARM_DELAY"] < v.now - self.idle_since:
            self.disarm("idle")

    def pilot_takes_over(self) -> None:
        """A pilot's switch selects LOITER."""
        self.change(LOITER)

    def leave(self) -> None:
        """Leave GUIDED for no reason that anybody sees."""
        self.change(BRAKE)
