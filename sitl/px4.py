"""PX4 (1.16) as a ground station meets it: modes, arming, offboard, failsafes, landing.

Behaviour from PX4's documentation and source (``commander``: ``UserModeIntention``,
``failsafe.cpp``, ``HealthAndArmingChecks``; ``mavlink_receiver``), and measurements on its
software-in-the-loop build. In one place it is milder: a mode's detailed preflight texts are a few.
"""

import math
from typing import Any

from sitl import controller_goals, fault_mapping, px4_commands, px4_failsafes, px4_flight, wire
from sitl.px4_tables import (
    BY_NUMBER,
    FALLBACK,
    MODES,
    OFFBOARD_LOSS,
    PARAMETERS,
)
from sitl.route import Route
from sitl.vehicle import (
    ACCEPTED,
    DENIED,
    TEMPORARILY_REJECTED,
    Command,
    Vehicle,
)

_BOOT_TIME = 12.0
_SLOW_BEAT = 0.4
_MOVED = 1.0
"""Metres from home at which a vehicle that is not armed takes its place for its home."""
_AUTO, _OFFBOARD = 4, 6
_UNHEALTHY = "Resolve system health failures first"
_INFO, _CRITICAL, _EMERGENCY = 6, 2, 0


class Px4:
    """The commander and navigator of one PX4 vehicle."""

    def __init__(self, vehicle: Vehicle) -> None:
        self.v = vehicle
        self.has_origin = True
        table = {**PARAMETERS, **fault_mapping.PARAMETERS}
        table["MAV_SYS_ID"] = vehicle.system
        vehicle.parameters.load(table)
        self._fresh()
        self.apply_gains()
        vehicle.bodies.land_time[vehicle.index] = 0.9

    def _fresh(self) -> None:
        self.intended = "LOITER"
        self.after_disarm = "LOITER"
        self.state = "LOITER"
        self.failsafe = False
        self.landing = False
        self.offboard_at = -math.inf
        self._offboard: wire.Setpoint | bytes | None = None
        self.armed_at = 0.0
        self.flew = False
        self.landed_at: float | None = None
        self.goal: Any = None
        self.stage = ""
        self.pilot = False
        self.latched: str | None = None
        self.delay_until: float | None = None
        self.delayed: str | None = None
        self.battery_level = 0
        self.battery_at_arming = 0
        self.gcs_seen = self.gcs_known = False
        self.radio_seen = False
        self.radio_lost_at: float | None = None
        self.outside = False
        self.route = Route(self.v, 0)
        self.all_axes = False
        self.slow_at = -math.inf
        self.tumbled = False
        self.ready_at = -math.inf

    @property
    def offboard(self) -> wire.Setpoint | None:
        """The last setpoint that was taken."""
        if isinstance(self._offboard, bytes):
            self._offboard = wire.setpoint_in(self._offboard)
        return self._offboard

    @offboard.setter
    def offboard(self, setpoint: wire.Setpoint) -> None:
        self._offboard = setpoint

    @property
    def follows(self) -> bool:
        """Whether setpoints of all axes are followed, and another one is nothing new."""
        return self.state == "OFFBOARD" and self.all_axes

    def followed(self, data: bytes, now: float) -> None:
        """Note a setpoint that has been taken already, while `follows`."""
        self.offboard_at, self._offboard = now, data

    @property
    def target_mask(self) -> int | None:
        """Type mask of POSITION_TARGET_LOCAL_NED; None while nothing is controlled."""
        if not self.v.armed:
            return None
        return self.offboard.mask if self.state == "OFFBOARD" and self.offboard else 0

    # Parameters.

    def apply_gains(self) -> None:
        """Carry controller parameters into the batch."""
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
        b.touch()

    def parameter_changed(self, name: str) -> None:
        """React to PARAM_SET."""
        if name.startswith(("MPC_", "COM_SPOOLUP")):
            self.apply_gains()

    def restart(self) -> None:
        """Boot: estimator and checks need a while before arming is possible."""
        self._fresh()
        self.ready_at = self.v.now + _BOOT_TIME
        self.v.later.append((self.ready_at, self._found_home))

    def _found_home(self) -> None:
        if self.v.global_valid:
            self.v.home_is_here()
        self.v.text(_INFO, "Ready for takeoff!\t")

    @property
    def logging(self) -> bool:
        """Whether it logs: SDLOG_MODE 0 does while it is armed."""
        return self.v.armed

    @property
    def critical(self) -> bool:
        """Whether HEARTBEAT says that a failsafe is active."""
        return self.failsafe and self.v.armed

    @property
    def taking_off(self) -> bool:
        """Whether it climbs in its take-off mode."""
        return self.state == "TAKEOFF"

    # What is possible.

    def offboard_signal(self) -> bool:
        """Whether the setpoint stream is alive (COM_OF_LOSS_T)."""
        return self.v.now - self.offboard_at <= self.v.parameters["COM_OF_LOSS_T"]

    def has(self, need: str) -> bool:
        """Whether one of the things that modes need is there."""
        v = self.v
        if need == "offboard":
            return self.offboard_signal() and v.local_valid
        if need == "local":
            return v.local_valid
        if need == "global":
            return v.global_valid
        if need == "home":
            return v.home is not None
        if need == "mission":
            return bool(v.mission[0])
        return (self.pilot or self.v.spec.radio) and not self.v.radio_lost

    def can_run(self, mode: str) -> bool:
        """Whether a mode's needs are met."""
        return all(self.has(need) for need in MODES[mode].needs)

    def ready(self) -> bool:
        """The pre-arm bit: health and the intended mode would allow arming now."""
        return self.refusal() is None

    def refusal(self) -> str | None:
        """Why arming would be denied now, None if it would not."""
        v = self.v
        if v.now < self.ready_at:
            return _UNHEALTHY
        if v.refuse_arming:
            return v.refuse_arming
        if MODES[self.intended].prevents_arming:
            return f"Mode '{MODES[self.intended].label}' prevents arming"
        alone = not self.gcs_seen and v.parameters["NAV_DLL_ACT"] > 0
        weak = self.battery_level >= 2 or px4_failsafes.beyond_fence(self)
        if alone or weak or not self.can_run(self.intended) or v.bodies.crashed[v.index]:
            return _UNHEALTHY
        return None

    # Numbers in HEARTBEAT.

    def custom_mode(self) -> int:
        """Main and sub mode of the state that flies, as PX4 packs them."""
        mode = MODES[self.state]
        return mode.main << 16 | mode.sub << 24

    def base_mode(self) -> int:
        """MAV_MODE_FLAG bits of the state that flies."""
        mode = MODES[self.state]
        flags = 1 | 16
        if mode.main == _AUTO:
            flags |= 4 | 8
        elif mode.main != _OFFBOARD:
            flags |= 64
        return flags | (128 if self.v.armed else 0)

    # Commands.

    def command(self, command: Command) -> int | None:
        """Carry out a command; return its result, None if this autopilot does not know it."""
        handler = px4_commands.COMMANDS.get(command.number)
        return None if handler is None else handler(self, command)

    def set_mode(self, base: int, custom: int) -> int:
        """Legacy SET_MODE: the custom mode as one number."""
        if not base & 1:
            return DENIED
        return self.change(BY_NUMBER.get((custom >> 16 & 0xFF, custom >> 24 & 0xFF)))

    def change(self, name: str | None) -> int:
        """Take a mode that the user wants, if it can run; return the MAV_RESULT."""
        if name is None:
            return DENIED
        if self.state == "TERMINATION":
            return TEMPORARILY_REJECTED
        if self.v.armed and not self.can_run(name):
            label = MODES[name].label
            self.v.text(_CRITICAL, f"Switching to mode '{label}' is currently not possible\t")
            return TEMPORARILY_REJECTED
        self.intend(name)
        return ACCEPTED

    def intend(self, name: str) -> None:
        """Take a mode as the user's wish; it clears failsafes that wait for a mode change."""
        self.intended = name
        self.latched = None
        self.delay_until = None
        self.goal = None
        self.stage = ""
        if not MODES[name].prevents_arming:
            self.after_disarm = name
        self.evaluate()

    def arm(self, force: bool) -> int:
        """Arm, if nothing speaks against it; return the MAV_RESULT."""
        v = self.v
        if v.armed:
            return ACCEPTED
        reason = self.refusal()
        if reason and not force:
            v.text(_CRITICAL, f"Arming denied: {reason}\t")
            return TEMPORARILY_REJECTED
        v.bodies.armed[v.index] = True
        v.bodies.landed[v.index] = True
        self.armed_at = v.now
        self.flew = False
        self.landed_at = None
        self.battery_at_arming = self.battery_level
        self.radio_seen, self.radio_lost_at = v.radio_heard, None
        self.outside = False
        if v.global_valid:
            v.home_is_here()
        v.text(_INFO, "Armed by external command\t")
        v.around.event("armed", v.system)
        self.state = ""
        self.evaluate()
        return ACCEPTED

    def disarm(self, text: str) -> None:
        """Stop the motors, wherever the vehicle is."""
        v = self.v
        if not v.armed:
            return
        v.bodies.armed[v.index] = False
        v.bodies.landed[v.index] = True
        controller_goals.idle(v)
        self.intended = self.after_disarm
        self.latched = None
        self.delay_until = None
        v.text(_INFO, f"{text}\t")
        v.around.event("disarmed", v.system, reason=text)
        self.evaluate()

    def terminate(self) -> None:
        """Flight termination: motors off, no way back."""
        v = self.v
        self.intended = self.state = "TERMINATION"
        self.failsafe = True
        v.bodies.armed[v.index] = False
        v.text(_EMERGENCY, "Flight termination active\t")
        v.around.event("terminated", v.system)

    def setpoint(self, setpoint: wire.Setpoint) -> None:
        """Take SET_POSITION_TARGET_LOCAL_NED."""
        px4_flight.take(self, setpoint)

    # What flies.

    def tick(self) -> float:
        """Look at timers and conditions, up to twenty-five times a second."""
        self._look()
        v = self.v
        if v.armed:
            if not self._steadily_offboard():
                return -math.inf
            return min(self.slow_at, self.offboard_at + v.parameters["COM_OF_LOSS_T"])
        return self.slow_at

    def _look(self) -> None:
        v = self.v
        if v.bodies.tumbling[v.index] and not self.tumbled:
            self.tumbled = True
            v.text(_EMERGENCY, "Attitude failure detected\t")
        if v.now >= self.slow_at:
            self.slow_at = v.now + _SLOW_BEAT
            px4_failsafes.watch_battery(self)
            px4_failsafes.watch_ground_station(self)
            if v.armed:
                px4_failsafes.watch_radio(self)
                px4_failsafes.watch_fence(self)
            else:
                self._follow_home()
        elif self._steadily_offboard():
            return
        self.evaluate()
        if not v.armed:
            return
        if not v.landed:
            if not self.flew:
                self._took_off()
            self.flew = True
            self.landed_at = None
            px4_flight.steer(self)
        elif self.flew:
            self._after_landing()
        elif v.now - self.armed_at > v.parameters["COM_DISARM_PRFLT"] > 0:
            self.disarm("Disarmed by auto preflight disarming")

    def _took_off(self) -> None:
        v = self.v
        if v.global_valid:
            v.home_is_here()
        v.text(_INFO, "Takeoff detected\t")

    def _follow_home(self) -> None:
        """Home goes with a vehicle that is carried elsewhere, or has landed there."""
        v = self.v
        if v.home is not None and v.global_valid and math.dist(v.home, v.estimated()) > _MOVED:
            v.home_is_here()

    def _steadily_offboard(self) -> bool:
        """Whether nothing needs looking at: the most frequent case, for speed."""
        if not (self.state == self.intended == "OFFBOARD" and self.flew and self.latched is None):
            return False
        return self.offboard_signal() and self.v.local_valid and not self.v.landed

    def _after_landing(self) -> None:
        v = self.v
        if self.landed_at is None:
            self.landed_at = v.now
            v.text(_INFO, "Landing detected\t")
            v.around.event("landed", v.system)
        wait = v.parameters["COM_DISARM_LAND"]
        if 0 <= wait < v.now - self.landed_at:
            self.disarm("Disarmed by landing")

    def evaluate(self) -> None:
        """Find the state that flies: the user's mode, or what failsafes make of it."""
        v = self.v
        if self.state == "TERMINATION":
            return
        if not v.armed:
            self._enter(self.intended, failsafe=False)
            return
        if self.delay_until is not None and v.now >= self.delay_until:
            self.latched, self.delay_until = self.delayed, None
        wanted, failsafe = self.intended, False
        if self.latched and self.intended != "LAND":
            wanted, failsafe = self.latched, True
        if "offboard" in MODES[wanted].needs and not self.offboard_signal():
            wanted = OFFBOARD_LOSS.get(v.parameters.integer("COM_OBL_RC_ACT"), "POSCTL")
            failsafe = True
            if wanted == "DISARM":
                self.disarm("Disarmed by failsafe")
                return
            if wanted == "TERMINATION":
                self.terminate()
                return
        while not self.can_run(wanted):
            failsafe = True
            wanted = FALLBACK.get(wanted, "DESCEND" if "pilot" in MODES[wanted].needs else "RTL")
        self._enter(wanted, failsafe)

    def _enter(self, name: str, failsafe: bool) -> None:
        if name == self.state and failsafe == self.failsafe:
            return
        v = self.v
        if failsafe and not self.failsafe and v.armed:
            v.text(_CRITICAL, f"Failsafe activated: {MODES[name].label}\t")
        self.failsafe = failsafe
        if name == self.state:
            return
        self.state = name
        self.landing = name in {"LAND", "DESCEND"}
        self.stage = ""
        v.around.event("mode", v.system, mode=name, failsafe=failsafe)
        if v.armed:
            px4_flight.begin(self, name)

    def pilot_takes_over(self) -> None:
        """A pilot's sticks move: Position mode, and the user's intention with it."""
        self.pilot = True
        self.intend("POSCTL")

    def leave(self) -> None:
        """Leave offboard for no reason that anybody sees."""
        self.intend("LOITER")
