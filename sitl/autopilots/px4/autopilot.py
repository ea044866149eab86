"""PX4 (1.16) as a ground station sees it: modes, arming, offboard, failsafes, landing.

Behaviour from PX4's documentation and source (``commander``: ``UserModeIntention``,
``failsafe.cpp``, ``HealthAndArmingChecks``; ``mavlink_receiver``), and measurements on its
software-in-the-loop build. One simplification: few of the detailed preflight texts exist.
"""

import math

from sitl.autopilots import controller_goals
from sitl.autopilots.px4 import checks, commands, failsafes, modes, setpoints
from sitl.autopilots.px4.state import EMERGENCY, INFO, Px4State
from sitl.autopilots.px4.tables import BY_NUMBER, PARAMETERS
from sitl.protocol import sim_parameters, wire
from sitl.protocol.links import DENIED, Command
from sitl.protocol.vehicle import Vehicle

_BOOT_TIME = 12.0
_SLOW_INTERVAL = 0.4
_MOVED = 1.0
"""Distance from home in metres at which a disarmed vehicle sets its home again."""


class Px4(Px4State):
    """PX4 of one vehicle; the methods are those of `sitl.protocol.autopilot.Autopilot`."""

    def __init__(self, vehicle: Vehicle) -> None:
        super().__init__(vehicle)
        table = {**PARAMETERS, **sim_parameters.PARAMETERS}
        table["MAV_SYS_ID"] = vehicle.system
        vehicle.parameters.load(table)
        self.apply_gains()
        vehicle.bodies.land_time[vehicle.index] = 0.9

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
        return checks.refusal(self) is None

    def handle_command(self, command: Command) -> int | None:
        """Execute a command; return its MAV_RESULT, None for an unknown command."""
        handler = commands.COMMANDS.get(command.number)
        return None if handler is None else handler(self, command)

    def set_mode(self, base: int, custom: int) -> int:
        """Execute the legacy message SET_MODE, with the custom mode as one number."""
        if not base & 1:
            return DENIED
        return modes.change(self, BY_NUMBER.get((custom >> 16 & 0xFF, custom >> 24 & 0xFF)))

    def arm(self, force: bool) -> int:
        """Arm if the checks pass; return the MAV_RESULT."""
        return modes.arm(self, force)

    def disarm(self, reason: str) -> None:
        """Stop the motors, on the ground or in flight."""
        modes.disarm(self, reason)

    def handle_setpoint(self, setpoint: wire.Setpoint) -> None:
        """Accept or ignore SET_POSITION_TARGET_LOCAL_NED."""
        setpoints.accept(self, setpoint)

    def pilot_override(self) -> None:
        """Select Position mode, as a pilot's sticks do; it is the user's mode from then on."""
        self.pilot = True
        modes.intend(self, "POSCTL")

    def leave_offboard(self) -> None:
        """Change to Hold without a reason that the ground station receives."""
        modes.intend(self, "LOITER")

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
            failsafes.watch_battery(self)
            failsafes.watch_ground_station(self)
            if v.armed:
                failsafes.watch_radio(self)
                failsafes.watch_fence(self)
            else:
                self._update_home()
        elif self._steadily_offboard():
            return
        modes.evaluate(self)
        if not v.armed:
            return
        if not v.landed:
            if not self.has_flown:
                self._report_takeoff()
            self.has_flown = True
            self.landed_at = None
            modes.steer(self)
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
        return checks.offboard_signal(self) and self.v.local_valid and not self.v.landed

    def _after_landing(self) -> None:
        v = self.v
        if self.landed_at is None:
            self.landed_at = v.now
            v.text(INFO, "Landing detected\t")
            v.environment.event("landed", v.system)
        wait = v.parameters["COM_DISARM_LAND"]
        if 0 <= wait < v.now - self.landed_at:
            self.disarm("Disarmed by landing")
