"""ArduCopter (4.6) as a ground station sees it: modes, arming, GUIDED, take-off, failsafes.

Behaviour from ArduPilot's documentation and source (``GCS_Mavlink.cpp``, ``mode_guided.cpp``,
``AP_Arming``, ``events.cpp``), and measurements on its software-in-the-loop build. One
simplification: without a pilot LOITER and similar modes hold, as with centred sticks.
"""

import math

from sitl.autopilots import controller_goals
from sitl.autopilots.ardupilot import checks, commands, failsafes, flight, modes, setpoints
from sitl.autopilots.ardupilot.state import CRITICAL, INFO, POSITION_READY, ArduPilotState
from sitl.autopilots.ardupilot.tables import BRAKE, GUIDED, KINDS, LAND, LOITER, PARAMETERS
from sitl.protocol import sim_parameters, wire
from sitl.protocol.links import DENIED, Command
from sitl.protocol.vehicle import Vehicle

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


class ArduPilot(ArduPilotState):
    """ArduCopter of one vehicle; the methods are those of `sitl.protocol.autopilot.Autopilot`."""

    follows_setpoints = False
    """GUIDED's handling of a setpoint depends on too much to set only the goal."""

    def __init__(self, vehicle: Vehicle) -> None:
        super().__init__(vehicle)
        vehicle.parameters.bytewise = False
        table = {**PARAMETERS, **sim_parameters.PARAMETERS, "SYSID_THISMAV": vehicle.system}
        vehicle.parameters.load(table, KINDS)
        self.apply_gains()

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
        modes.set_home(self)
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
            self.checked = now, checks.refusal(self) is None
        return self.checked[1]

    def handle_command(self, command: Command) -> int | None:
        """Execute a command; return its MAV_RESULT, None for an unknown command."""
        handler = commands.COMMANDS.get(command.number)
        return None if handler is None else handler(self, command)

    def handle_setpoint(self, setpoint: wire.Setpoint) -> None:
        """Accept or ignore SET_POSITION_TARGET_LOCAL_NED."""
        setpoints.accept(self, setpoint)

    def set_mode(self, base: int, custom: int) -> int:
        """Execute the legacy message SET_MODE."""
        return modes.change(self, custom) if base & 1 else DENIED

    def arm(self, force: bool) -> int:
        """Arm if the checks pass; return the MAV_RESULT."""
        return modes.arm(self, force)

    def disarm(self, reason: str) -> None:
        """Stop the motors, on the ground or in flight."""
        modes.disarm(self, reason)

    def pilot_override(self) -> None:
        """Select LOITER, as a pilot's switch does."""
        modes.change(self, LOITER)

    def leave_offboard(self) -> None:
        """Change from GUIDED to BRAKE without a reason that the ground station receives."""
        modes.change(self, BRAKE)

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
                failsafes.watch_ground_station(self)
            return
        if v.bodies.tumbling[v.index] and self._crash_check():
            return
        if slow:
            failsafes.watch(self)
        if v.landed:
            self._on_ground()
            return
        if not self.has_flown:
            v.timers.append((v.now + _ALIGNED_AFTER, self._report_alignment))
        self.has_flown = True
        self.idle_since, self.landed_at = v.now, math.inf
        flight.steer(self)

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
        reason = checks.refusal(self)
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
