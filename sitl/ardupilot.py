"""ArduCopter (4.6) as a ground station meets it: modes, arming, GUIDED, take-off, failsafes.

Behaviour from ArduPilot's documentation and source (``GCS_Mavlink.cpp``, ``mode_guided.cpp``,
``AP_Arming``, ``events.cpp``), and measurements on its software-in-the-loop build. Milder in one
place: without a pilot LOITER and its like hold, as with centred sticks.
"""

import math
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import common as dialect

from sitl import demand, fault_ways, wire
from sitl.ardupilot_tables import (
    BATTERY,
    BRAKE,
    DEAD_RECKONING,
    GROUND_STATION_LOSS,
    GUIDED,
    KINDS,
    LAND,
    LOITER,
    MODES,
    PARAMETERS,
    RTL,
    STABILIZE,
)
from sitl.vehicle import ACCEPTED, DENIED, FAILED, Command, Vehicle

FORCE_ARM, FORCE_DISARM = 2989, 21196
_POSITION_READY, _BASIC_READY = 42.0, 10.0
_LOCAL, _LOCAL_OFFSET, _BODY, _BODY_OFFSET = 1, 7, 8, 9
_TAKEOFF_CANCELLED = 0.2
_INFO, _WARNING, _CRITICAL = 6, 4, 2
_SLOW_BEAT = 0.4
_PREARM_EVERY = 30.0
_CRASH_TIME = 2.0
_POSITION, _VELOCITY, _ACCELERATION, _FORCE = 7, 56, 448, 512
_Vector = tuple[float, float, float]


class ArduPilot:
    """The flight code of one ArduCopter vehicle."""

    def __init__(self, vehicle: Vehicle) -> None:
        self.v = vehicle
        vehicle.parameters.bytewise = False
        table = {**PARAMETERS, **fault_ways.PARAMETERS, "SYSID_THISMAV": vehicle.system}
        vehicle.parameters.load(table, KINDS)
        self.booted = -math.inf
        self._fresh()
        self.apply_gains()

    def _fresh(self) -> None:
        self.mode = STABILIZE
        self.failsafe = False
        self.landing = False
        self.submode = ""
        self.setpoint_at = -math.inf
        self.takeoff_at = -math.inf
        self.takeoff_height = 0.0
        self.idle_since = 0.0
        self.flew = False
        self.goal: Any = None
        self.stage = ""
        self.stage_at = 0.0
        self.taken_mask: int | None = None
        self.gcs_seen = False
        self.battery_level = 0
        self.lost_at: float | None = None
        self.prearm_at = 0.0
        self.tumbled_at: float | None = None
        self.slow_at = -math.inf
        self.all_axes = False
        self.pilot = False

    def restart(self) -> None:
        """Boot: some 42 s until the estimator gives a position."""
        v = self.v
        self._fresh()
        self.booted = v.now
        v.later.append((v.now + _POSITION_READY, self._found_position))

    def _found_position(self) -> None:
        v = self.v
        if v.global_valid:
            v.home = np.array(v.estimated())
        v.text(_INFO, "EKF3 IMU0 origin set")
        v.text(_INFO, "EKF3 IMU0 is using GPS")

    def apply_gains(self) -> None:
        """Carry controller parameters into the batch."""
        p, b, i = self.v.parameters, self.v.bodies, self.v.index
        demand.gains(
            self.v,
            (p["PSC_POSXY_P"], p["PSC_POSZ_P"]),
            (p["PSC_VELXY_P"], p["PSC_VELZ_P"]),
            (p["PSC_VELXY_I"], 2.0 * p["PSC_ACCZ_I"]),
        )
        angle = min(80.0, max(10.0, p["ANGLE_MAX"] / 100.0))
        b.tilt_limit[i] = math.tan(math.radians(angle))
        b.spool_time[i] = max(0.1, p["MOT_SPOOL_TIME"])
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
        if v.now - self.booted < _BASIC_READY:
            return "PreArm: Gyros not calibrated"
        if v.refuse_arming:
            return f"PreArm: {v.refuse_arming}"
        if MODES[self.mode].position and not self.position_ok():
            return "PreArm: Need Position Estimate"
        if v.bodies.crashed[v.index]:
            return "PreArm: Motors: Check frame"
        if self.battery_level:
            return "PreArm: Battery 1 low voltage failsafe"
        return None

    def ready(self) -> bool:
        """The pre-arm bit: checks of the present mode are passed."""
        return self.refusal() is None

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
        handler = _COMMANDS.get(command.number)
        return None if handler is None else handler(self, command)

    def set_mode(self, base: int, custom: int) -> int:
        """Legacy SET_MODE."""
        return self._change(custom) if base & 1 else DENIED

    def _do_set_mode(self, command: Command) -> int:
        p = command.p
        return self._change(int(p[1])) if int(p[0]) & 1 else DENIED

    def _change(self, number: int, *, failsafe: bool = False) -> int:
        if number not in MODES:
            self.v.text(_WARNING, f"No such mode {number}")
            return FAILED
        mode = MODES[number]
        if self.v.armed and mode.position and not self.position_ok():
            self.v.text(_WARNING, f"Mode change to {mode.name} failed: requires position")
            return FAILED
        if number == self.mode and not failsafe:
            return ACCEPTED
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
        self._cruise()
        if not v.armed:
            return
        if self.mode == LAND:
            demand.hold(v)
            demand.sink(v, p["LAND_SPEED"] / 100.0, steer=v.local_valid)
        else:
            demand.hold(v)

    def _cruise(self) -> None:
        p = self.v.parameters
        speeds = (p["WPNAV_SPEED"], p["WPNAV_SPEED_UP"], p["WPNAV_SPEED_DN"])
        demand.limits(self.v, *(max(0.1, speed / 100.0) for speed in speeds))

    def _arm_disarm(self, command: Command) -> int:
        p = command.p
        v = self.v
        if p[0] == 1.0:
            return self._arm(force=p[1] == FORCE_ARM)
        if p[0] != 0.0:
            return DENIED
        if not v.armed:
            return ACCEPTED
        if not v.landed and p[1] != FORCE_DISARM:
            return FAILED
        self.disarm("command")
        return ACCEPTED

    def _arm(self, *, force: bool) -> int:
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
        if v.global_valid:
            v.home = np.array(v.estimated())
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
        v.bodies.advance[v.index] = 0.0
        demand.idle(v)
        self.submode = ""
        self.landing = False
        v.text(_INFO, "Disarming motors")
        v.around.event("disarmed", v.system, reason=text)

    def _takeoff(self, command: Command) -> int:
        p = command.p
        v = self.v
        if self.mode != GUIDED or not v.armed or not v.landed or not math.isfinite(p[6]):
            return FAILED
        if p[6] < 0.1:
            return FAILED
        self.submode = "takeoff"
        self.takeoff_at = v.now
        home = v.home if v.home is not None else v.origin
        here = v.estimated()
        self.takeoff_height = float(home[2]) + p[6]
        v.bodies.may_lift[v.index] = True
        v.bodies.advance[v.index] = 0.0
        self._cruise()
        demand.go(v, (here[0], here[1], max(self.takeoff_height, float(here[2]))))
        self.all_axes = True
        return ACCEPTED

    def _land(self, _: Command) -> int:
        return self._change(LAND)

    def _return(self, _: Command) -> int:
        return self._change(RTL)

    def _reposition(self, command: Command) -> int:
        p, x, y = command.p, command.x, command.y
        v = self.v
        if not math.isfinite(p[6]) or x == 2**31 - 1 or y == 2**31 - 1:
            return DENIED
        if self.mode != GUIDED:
            if not int(p[1]) & 1:
                return DENIED
            if self._change(GUIDED) != ACCEPTED:
                return FAILED
        if v.landed:
            return FAILED
        place = (*v.around.geodesy.metres(x * 1e-7, y * 1e-7), p[6] - v.around.geodesy.altitude)
        self._cruise()
        self.submode = "position"
        demand.go(v, place)
        return ACCEPTED

    def _speed(self, command: Command) -> int:
        p = command.p
        v = self.v
        if math.isfinite(p[1]) and p[1] > 0:
            v.bodies.speed_limit[v.index] = min(p[1], v.spec.max_speed)
            v.bodies.touch()
        return ACCEPTED

    def _terminate(self, command: Command) -> int:
        p = command.p
        if p[0] > 0.5:
            self.disarm("terminated")
        return ACCEPTED

    # Setpoints.

    def setpoint(self, setpoint: wire.Setpoint) -> None:
        """Take SET_POSITION_TARGET_LOCAL_NED as GUIDED does, by what its mask leaves."""
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
        self._take(mask, position, velocity, acceleration)
        if not mask & 1024 and math.isfinite(setpoint.yaw):
            v.bodies.goal_yaw[v.index] = math.pi / 2 - setpoint.yaw

    def _take(self, mask: int, position: _Vector, velocity: _Vector, acceleration: _Vector) -> None:
        v, b, i = self.v, self.v.bodies, self.v.index
        zero = (0.0, 0.0, 0.0)
        if mask & _ACCELERATION:
            acceleration = zero
        if not mask & _POSITION and not mask & _VELOCITY:
            kind, taken = "posvel", mask & _ACCELERATION
            goal = (*position, *velocity, *acceleration)
            axes = 1.0
        elif not mask & _POSITION and mask & _ACCELERATION:
            kind, taken = "position", _VELOCITY | _ACCELERATION
            goal, axes = (*position, *zero, *zero), 1.0
        elif mask & _POSITION and not mask & _VELOCITY:
            kind, taken = "velocity", _POSITION | (mask & _ACCELERATION)
            goal, axes = (*v.estimated(), *velocity, *acceleration), 0.0
        elif mask & _POSITION and not mask & _ACCELERATION:
            kind, taken = "acceleration", _POSITION | _VELOCITY
            goal, axes = (*v.estimated(), *zero, *acceleration), 0.0
        else:
            kind, taken = "velocity", _POSITION
            goal, axes = (*v.estimated(), *zero, *zero), 0.0
        if kind == self.submode == "posvel":
            b.stage(i, goal)
        else:
            self.submode = kind
            b.advance[i] = 1.0 if kind == "posvel" else 0.0
            hold = 0.0 if kind == "acceleration" else 1.0
            b.aim(i, goal, (axes, axes, axes), (hold, hold, hold))
        self.taken_mask = taken | (mask & 3072)

    def _in_world(self, s: wire.Setpoint) -> tuple[_Vector, _Vector, _Vector]:
        """Position, velocity, acceleration in world ENU from any of the four frames."""
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
            return
        if v.bodies.tumbling[v.index] and self._fell():
            return
        if slow:
            self._watch()
        if v.landed:
            self._on_ground()
            return
        self.flew = True
        self.idle_since = v.now
        if self.mode == GUIDED:
            self._guided()
        elif self.mode == RTL:
            self._steer_return()
        elif self.mode == LAND:
            self._steer_land()

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
            v.around.event("landed", v.system)
            self.disarm("landed")
        elif self.submode == "takeoff" and v.bodies.may_lift[v.index]:
            self.idle_since = v.now
        elif 0 < v.parameters["DISARM_DELAY"] < v.now - self.idle_since:
            self.disarm("idle")

    def _guided(self) -> None:
        """Velocities are forgotten when no setpoint comes for GUID_TIMEOUT."""
        v = self.v
        if self.submode not in {"posvel", "velocity", "acceleration"}:
            return
        if v.now - self.setpoint_at > v.parameters["GUID_TIMEOUT"]:
            b, i = v.bodies, v.index
            b.advance[i] = 0.0
            goal = (*b.goal_position[i], *[0.0] * 6)
            if self.submode != "posvel":
                goal = (*v.estimated(), *[0.0] * 6)
            self.submode = "stopped"
            b.aim(i, goal)

    def _watch(self) -> None:
        v, p = self.v, self.v.parameters
        latest = v.last_heartbeat.get(p.integer("SYSID_MYGCS"), -math.inf)
        if v.now - latest <= p["FS_GCS_TIMEOUT"]:
            self.gcs_seen = True
        elif self.gcs_seen:
            self.gcs_seen = False
            action = GROUND_STATION_LOSS.get(p.integer("FS_GCS_ENABLE"))
            if action is not None and not v.landed and self.mode != LAND:
                v.text(_WARNING, "GCS Failsafe")
                self._fail_to(action)
        self._watch_battery()
        if v.local_valid and v.global_valid:
            self.lost_at = None
        elif not v.around.indoor or not v.local_valid:
            self._watch_position()

    def _watch_battery(self) -> None:
        v, p = self.v, self.v.parameters
        left = v.charge * p["BATT_CAPACITY"]
        levels = (("LOW", "low"), ("CRT", "critical"))
        for level, (key, word) in enumerate(levels, start=1):
            volts, charge = p[f"BATT_{key}_VOLT"], p[f"BATT_{key}_MAH"]
            if level > self.battery_level and (v.voltage < volts or left < charge):
                self.battery_level = level
                v.text(_WARNING, f"Battery 1 is {word} {v.voltage:.2f}V used {5000 - left:.0f} mAh")
                action = BATTERY.get(p.integer(f"BATT_FS_{key}_ACT"))
                if action is not None and not v.landed:
                    self._fail_to(action)

    def _watch_position(self) -> None:
        """Without GPS: dead reckoning (FS_DR_ENABLE), then the estimator fails (FS_EKF_ACTION)."""
        v, p = self.v, self.v.parameters
        if self.lost_at is None:
            self.lost_at = v.now
            action = DEAD_RECKONING.get(p.integer("FS_DR_ENABLE"))
            if action is not None and not v.landed and v.local_valid:
                v.text(_WARNING, "Dead Reckoning started")
                self._fail_to(action)
        patience = 1.0 if not v.local_valid else p["FS_DR_TIMEOUT"]
        if v.now - self.lost_at > patience and self.mode != LAND:
            v.text(_CRITICAL, "EKF Failsafe")
            if p.integer("FS_EKF_ACTION") in {1, 3} and not v.landed:
                self._fail_to(LAND)

    def _fail_to(self, mode: int) -> None:
        if mode == RTL and (not self.position_ok() or self.v.home is None):
            mode = LAND
        self._change(mode, failsafe=True)

    def _steer_land(self) -> None:
        v, p = self.v, self.v.parameters
        home = v.home[2] if v.home is not None else v.origin[2]
        high = float(v.estimated()[2] - home) > p["LAND_ALT_LOW"] / 100.0
        rate = p["WPNAV_SPEED_DN"] if high else p["LAND_SPEED"]
        v.bodies.climb(v.index, -rate / 100.0)

    def _steer_return(self) -> None:
        """Climb, fly home, wait RTL_LOIT_TIME, land."""
        v, p = self.v, self.v.parameters
        if v.home is None:
            return
        here, home = v.estimated(), v.home
        away = float(np.hypot(*(home - here)[:2]))
        if self.stage == "":
            top = max(float(here[2]), float(home[2]) + p["RTL_ALT"] / 100.0)
            self.goal = np.array([here[0], here[1], top])
            self.stage = "climb"
            demand.go(v, self.goal)
        elif self.stage == "climb" and here[2] > self.goal[2] - 0.5:
            self.goal = np.array([home[0], home[1], self.goal[2]])
            self.stage = "home"
            demand.go(v, self.goal)
        elif self.stage == "home" and away < 0.5:
            self.stage, self.stage_at = "wait", v.now
        elif self.stage == "wait" and v.now - self.stage_at > p["RTL_LOIT_TIME"] / 1000.0:
            self.stage, self.landing = "land", True
            demand.sink(v, p["LAND_SPEED"] / 100.0, steer=True)
        elif self.stage == "land":
            self._steer_land()

    def pilot_takes_over(self) -> None:
        """A pilot's switch selects LOITER."""
        self._change(LOITER)

    def leave(self) -> None:
        """Leave GUIDED for no reason that anybody sees."""
        self._change(BRAKE)


_COMMANDS = {
    dialect.MAV_CMD_COMPONENT_ARM_DISARM: ArduPilot._arm_disarm,
    dialect.MAV_CMD_DO_SET_MODE: ArduPilot._do_set_mode,
    dialect.MAV_CMD_NAV_TAKEOFF: ArduPilot._takeoff,
    dialect.MAV_CMD_NAV_LAND: ArduPilot._land,
    dialect.MAV_CMD_NAV_RETURN_TO_LAUNCH: ArduPilot._return,
    dialect.MAV_CMD_DO_REPOSITION: ArduPilot._reposition,
    dialect.MAV_CMD_DO_CHANGE_SPEED: ArduPilot._speed,
    dialect.MAV_CMD_DO_FLIGHTTERMINATION: ArduPilot._terminate,
}
