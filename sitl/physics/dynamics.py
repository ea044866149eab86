"""Point-mass vehicles in one batch: controller, thrust, drag, landing, estimator errors, wind.

Model. The motors give a specific thrust ``f`` (m/s²) that follows the commanded one as a
second-order system (attitude loop and motors together, natural frequency 14 rad/s); then
``v̇ = f − g ẑ − c (v − wind) + F/m``. The commanded thrust comes from the cascade of both
autopilots: position error × P + velocity feed-forward → limits → velocity error × P + I +
acceleration feed-forward → limits of acceleration, tilt and thrust (PX4 user guide, "Controller
Diagrams"; ArduPilot ``AC_PosControl``). With full feed-forward a healthy vehicle tracks a path at
1–2 m/s with 0.05–0.1 m RMS: 0.10 m was measured on ArduCopter, more on PX4's simple simulator,
whose drag is larger.

ENU, SI, radians; arrays are (n, 3) or (n,). The controller uses the *estimate*: truth + bias +
slow noise. Vehicles stand on legs as long as their dropper: the centre is at floor + grip offset.
"""

import math
import struct
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from sitl.physics import motion
from sitl.physics.geodesy import GRAVITY
from sitl.world import World

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

STEP = 0.02
_GOAL = struct.Struct("3d")
_AXIS, _GOAL_START = 8 * motion.STATE_COLUMNS, 8 * motion.GOAL_POSITION
"""Bytes of one axis of the state, and before its goal."""
_LARGEST_INTEGRAL = 5.0
_NOISE_TIME = 4.0
"""Correlation time of the estimator's noise, seconds."""
NOISE_SIGMA = np.array([0.015, 0.015, 0.02])
"""Standard deviation of the estimator's noise, metres."""
_DISTURBANCE_TIME = 2.0
"""Correlation time of disturbances, seconds."""


_YAW_RATE = 1.0
_RAMP_OVER = 2.0
"""Seconds of lift after which the take-off ramp is over."""
_CLIMBING = 0.25
_LOW_THRUST = 0.7 * GRAVITY
_TUMBLE_RATE = 5.0
_WASH_FACTOR = 3.0
"""Effect of downwash, relative to its drag: rotors lose thrust in descending air, as in a climb."""
_GUST_LENGTH = 30.0
"""Scale length of gusts, metres."""


class Rows(NamedTuple):
    """Values for telemetry as lists over the vehicles: estimated positions, true values otherwise.

    ``yaw`` is counter-clockwise from east, as in `Bodies`.
    """

    position: list[list[float]]
    velocity: list[list[float]]
    thrust: list[list[float]]
    yaw: list[float]
    yaw_rate: list[float]
    tumbling: list[bool]


class Bodies:
    """State of all vehicles, goals of their controllers, air around them.

    Autopilots set goals with `set_goal` and `set_goal_values`; they write gains, limits and flags
    directly, then call `refresh`. `step` advances all vehicles by `STEP` seconds.

    Flags (n,): ``may_lift`` permits a take-off, ``all_cruising`` says that no vehicle needs
    `Bodies.supervise`, ``outside`` are vehicles that `sitl.physics.rigid_bodies` moves,
    ``goal_moves`` is 1 where the goal moves with its velocity. Times in
    seconds (n,): since arming (``armed_time``), since the start of lift (``lift_time``), with the
    condition of a landing (``landing_time``); until lift (``spool_time``), full thrust
    (``ramp_time``), reduced thrust (``cut_time``) and landed (``land_time``). ``frames`` (n, 5) are
    local origins and scales; ``apart`` (n, n) are horizontal distances squared.
    """

    def __init__(self, world: World, rng: np.random.Generator) -> None:
        self.rng = rng
        self.floor = world.floor
        self._create_state(world)
        self._create_goals(world)
        self._create_flags()
        self._create_air(world)
        self.refresh()

    def _create_state(self, world: World) -> None:
        specs = world.vehicles
        n = self.count = len(specs)
        self.mass = np.array([s.mass for s in specs])
        self.radius = np.array([s.radius for s in specs])
        self.grip_offset = np.array([s.grip_offset for s in specs])
        self.thrust_limit = np.array([2.0 * (s.mass + s.payload) * GRAVITY / s.mass for s in specs])
        self.max_acceleration = np.array([s.max_acceleration for s in specs])
        self.state = np.zeros((n, 3, motion.STATE_COLUMNS))
        self._disturbances = np.zeros((n, 3, motion.DISTURBANCE_COLUMNS))
        self._constants = np.zeros((n, motion.CONSTANTS))
        self.status = np.zeros((3, n), dtype=bool)
        self._create_views()
        self.position[:] = [s.pad for s in specs]
        self.position[:, 2] = np.maximum(self.position[:, 2], world.floor) + self.grip_offset
        self.yaw = np.pi / 2 - np.array([s.heading for s in specs])
        self.yaw_rate = np.zeros(n)
        self._random = np.zeros((2 * n + 1, 3))
        self.noise_scale = np.zeros((n, 1))
        self.frames = np.ones((n, 5))
        self._telemetry_rows = np.zeros((n, 12), np.float32)

    def _create_goals(self, world: World) -> None:
        n = self.count
        self.goal_position[:] = self.position
        self.goal_yaw = self.yaw.copy()
        self.position_axes = np.zeros((n, 3))
        self.velocity_axes = np.zeros((n, 3))
        self.speed_limit = np.array([s.max_speed for s in world.vehicles])
        self.climb_limit = np.full(n, 3.0)
        self.descend_limit = np.full(n, 1.5)
        self.tilt_limit = np.full(n, np.tan(np.deg2rad(45.0)))
        self.position_gain = np.ones((n, 3))
        self.velocity_gain = np.ones((n, 3))
        self.integral_gain = np.zeros((n, 3))
        self.goal_moves = np.zeros(n)
        self._axes: dict[int, tuple[float, ...]] = {}
        self.velocity_goal = np.zeros((n, 3))

    def _create_flags(self) -> None:
        n = self.count
        self.cruise_status = bytes([1] * n + [0] * 2 * n)
        self.zero_times = bytes(8 * n)
        self.landed_changes = 0
        self.landed[:] = True
        self.may_lift = np.zeros(n, dtype=bool)
        self.landing_time = np.zeros(n)
        self.armed_time = np.zeros(n)
        self.lift_time = np.zeros(n)
        self.spool_time = np.ones(n)
        self.ramp_time = np.full(n, 1.5)
        self.land_time = np.full(n, 0.9)
        self.cut_time = np.full(n, 0.35)
        self.health = np.ones(n)
        self.heading_error = np.zeros(n)
        self.outside = np.zeros(n, dtype=bool)
        self.crashed = np.zeros(n, dtype=bool)
        self.tumble = np.zeros(n)
        self.false_landing = np.zeros(n, dtype=bool)
        self.thrust_share = np.zeros(n)
        self._hard = np.zeros(n, dtype=bool)
        self.all_cruising = False

    def _create_air(self, world: World) -> None:
        n = self.count
        self.drag = np.full(n, 0.20)
        self.steady_wind[:] = self.wind[:] = world.wind.steady
        self.gust_intensity = world.wind.gust
        self.gust = np.zeros((n + 1, 3))
        self.disturbance = np.zeros((n, 3))
        self._disturbance_sigma = np.array([[spec.disturbance] for spec in world.vehicles])
        self._disturbed = bool(self._disturbance_sigma.any())
        self.apart = np.full((n, n), np.inf)

    def _create_views(self) -> None:
        """Create the views of the arrays with several columns."""
        state, slow = self.state, self._disturbances
        self.position = state[..., motion.POSITION]
        self.velocity = state[..., motion.VELOCITY]
        self.thrust = state[..., motion.THRUST]
        self.thrust_rate = state[..., motion.THRUST_RATE]
        self.integral = state[..., motion.INTEGRAL]
        self.goal_position = state[..., motion.GOAL_POSITION]
        self.goal_velocity = state[..., motion.GOAL_VELOCITY]
        self.goal_acceleration = state[..., motion.GOAL_ACCELERATION]
        self._estimate_error = state[..., motion.ESTIMATE_ERROR]
        self._external = state[..., motion.EXTERNAL]
        self.noise = slow[..., motion.NOISE]
        self._noise_sigma = slow[..., motion.NOISE_SIGMA]
        self.bias = slow[..., motion.BIAS]
        self.drift = slow[..., motion.DRIFT]
        self.steady_wind = slow[..., motion.STEADY_WIND]
        self.wind = slow[..., motion.WIND]
        self.downwash = slow[..., motion.DOWNWASH]
        self._bytes = memoryview(cast("Any", state)).cast("B")
        self.armed, self.landed, self.tumbling = self.status

    def __getstate__(self) -> dict[str, Any]:
        return {key: value for key, value in vars(self).items() if key != "_bytes"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Restore the views: the arrays of a copy share memory as in the original."""
        self.__dict__.update(state)
        self._create_views()
        self.refresh()

    def refresh(self) -> None:
        """Update all derived values after a change of gains, axes, limits, biases or air."""
        constants = self._constants
        constants[:, motion.POSITION_GAIN :][:, :3] = self.position_gain * self.position_axes
        constants[:, motion.VELOCITY_GAIN :][:, :3] = self.velocity_gain * self.velocity_axes
        integral_gain = STEP * self.integral_gain * self.velocity_axes
        constants[:, motion.INTEGRAL_GAIN :][:, :3] = integral_gain
        constants[:, motion.DRAG :] = np.column_stack(
            (
                self.drag, self.speed_limit, self.climb_limit, self.descend_limit,
                self.max_acceleration, self.tilt_limit, self.thrust_limit, self.health,
                self.floor + self.grip_offset, self.mass, self.radius, self.heading_error,
            )
        )  # fmt: skip
        self._per_mass = 1.0 / self.mass[:, None]
        self._update_air()
        self._noise_sigma[:] = NOISE_SIGMA * (self.noise_scale > 0)
        self._noisy = bool(self.noise_scale.any())

    def _update_air(self) -> None:
        self._rows: Rows | None = None
        self._telemetry: bytes | None = None
        motion.update_air(self.state, self._disturbances, self._constants)
        self._add_disturbance()

    def _add_disturbance(self) -> None:
        """Add the random disturbance to the acceleration of the air."""
        if self._disturbed:
            self.state[..., motion.AIR] += self.disturbance

    def set_goal(
        self,
        i: int,
        goal: tuple[float, ...],
        position_axes: tuple[float, float, float] = (1.0, 1.0, 1.0),
        velocity_axes: tuple[float, float, float] = (1.0, 1.0, 1.0),
    ) -> None:
        """Set one vehicle's goal: position, velocity, acceleration (9 numbers, world ENU).

        ``position_axes`` and ``velocity_axes`` are 1 for controlled axes, 0 for others: along axes
        without a velocity setpoint, no integral resists what the cable pulled before. (PX4 adds
        none to an undefined setpoint, ``PositionControl.cpp``; ArduPilot's ``land_nogps_run``
        levels the vehicle.)
        """
        self.set_goal_values(i, goal)
        axes = (*position_axes, *velocity_axes)
        if self._axes.get(i) != axes:
            self._axes[i] = axes
            self.position_axes[i] = position_axes
            self.velocity_axes[i] = velocity_axes
            self.integral[i] *= velocity_axes
            self.refresh()

    def set_goal_values(self, i: int, goal: tuple[float, ...]) -> None:
        """Set the goal of a vehicle whose axes stay as they are; faster than `set_goal`."""
        px, py, pz, vx, vy, vz, ax, ay, az = goal
        put, at = _GOAL.pack_into, i * 3 * _AXIS + _GOAL_START
        put(self._bytes, at, px, vx, ax)
        put(self._bytes, at + _AXIS, py, vy, ay)
        put(self._bytes, at + 2 * _AXIS, pz, vz, az)

    def set_climb_rate(self, i: int, rate: float) -> None:
        """Set the vertical velocity of one vehicle's goal (m/s, up)."""
        self.goal_velocity[i, 2] = rate

    def estimated(self) -> Array:
        """Return the estimated positions of the centres, world ENU (n, 3)."""
        estimate: Array = self.position + self._estimate_error
        return estimate

    def rows(self) -> Rows:
        """Return values for telemetry as lists, computed once a step."""
        if self._rows is None:
            self._rows = Rows(
                (self.position + self._estimate_error).tolist(),
                self.velocity.tolist(),
                self.thrust.tolist(),
                self.yaw.tolist(),
                self.yaw_rate.tolist(),
                self.tumbling.tolist(),
            )
        return self._rows

    def telemetry(self) -> bytes:
        """Return `motion.telemetry_rows` as bytes, computed once a step."""
        if self._telemetry is None:
            motion.telemetry_rows(
                self.state, self.tumbling, self.tumble, (self.yaw, self.yaw_rate), self.frames,
                self._telemetry_rows,
            )  # fmt: skip
            self._telemetry = self._telemetry_rows.tobytes()
        return self._telemetry

    def lift(self) -> Array:
        """Return the upward thrust of each vehicle in newtons (n,), at least 0."""
        lift: Array = np.maximum(self.thrust[:, 2], 0.0) * self.mass
        return lift

    def grip_points(self) -> Array:
        """Return the grip points (n, 3), at the ends of stiff droppers."""
        points = np.empty((self.count, 3))
        motion.grip_points(self.state, self.grip_offset, points)
        return points

    def free_motion(self) -> tuple[Array, Array]:
        """Return accelerations without cable (n, 3), and mobilities (n,): `motion.free_motion`."""
        acceleration, mobility = np.empty((self.count, 3)), np.empty(self.count)
        motion.free_motion(self.state, self._constants, acceleration, mobility)
        return acceleration, mobility

    def set_external_force(self, force: Array) -> None:
        """Set the external force on every vehicle (newtons, (n, 3)) until the next call."""
        self._external[:] = force * self._per_mass

    def step(self) -> Flags | None:
        """Advance by `STEP`; return the flags of vehicles with a hard landing, or None."""
        self._rows = self._telemetry = None
        hard = self._hard
        any_hard = motion.step(
            self.state, self._constants, self.thrust_share, self.crashed, STEP,
            (self.velocity_goal, hard),
        )  # fmt: skip
        if not any_hard:
            return None
        self.crashed |= hard
        self.health[hard] = 0.0
        self.refresh()
        return hard.copy()

    def step_disturbances(self, interval: float) -> None:
        """Advance estimator noise, gusts and downwash by ``interval`` seconds (call at 10 Hz).

        Noise is first-order Gauss–Markov, `NOISE_SIGMA` metres over `_NOISE_TIME` seconds; so are
        disturbances, m/s² over `_DISTURBANCE_TIME` seconds.
        """
        keep, gust_keep, random = 1.0, 1.0, self._random
        if self._noisy:
            keep = math.exp(-interval / _NOISE_TIME)
            random[: self.count] = self.rng.standard_normal((self.count, 3))
        if self.gust_intensity > 0:
            random[self.count :] = self.rng.standard_normal((self.count + 1, 3))
            gust_keep = _gust_persistence(self.steady_wind[0], interval)
        self._rows = self._telemetry = None
        factors = (
            interval, keep, gust_keep, _LARGEST_INTEGRAL, float(self.gust_intensity),
            _WASH_FACTOR,
        )  # fmt: skip
        motion.step_disturbances(
            self.state,
            self._disturbances,
            self._constants,
            (self.gust, random),
            self.apart,
            factors,
        )
        if self._disturbed:
            keep = math.exp(-interval / _DISTURBANCE_TIME)
            drawn = self._disturbance_sigma * self.rng.standard_normal((self.count, 3))
            self.disturbance = keep * self.disturbance + math.sqrt(1.0 - keep**2) * drawn
            self._add_disturbance()

    def supervise(self, interval: float) -> None:
        """Update take-off ramp, land detector and yaw by ``interval`` seconds (call at 25 Hz).

        Vehicles that are moved from outside keep their yaw and whether they stand.
        """
        if self.all_cruising and motion.unchanged(
            self.goal_moves,
            (self.goal_yaw, self.yaw),
            self.status,
            self.landing_time,
            self.velocity_goal,
            self.velocity,
        ):
            return
        if self.goal_moves.tobytes() != self.zero_times:
            self.goal_position += (interval * self.goal_moves)[:, None] * self.goal_velocity
        if self.goal_yaw.tobytes() != self.yaw.tobytes():
            self._turn(interval)
        cruising = self.all_cruising and self.status.tobytes() == self.cruise_status
        if not cruising:
            self.tumble += interval * _TUMBLE_RATE * (self.tumbling & ~self.crashed)
            self._lift(interval)
            up = (self.lift_time > _RAMP_OVER) & (self.thrust_share >= 1.0)
            self.all_cruising = np.count_nonzero(up) == self.count
        down = self.velocity_goal[:, 2] < motion.DESCENDING
        if not cruising or np.count_nonzero(down) or self.landing_time.tobytes() != self.zero_times:
            self._detect_landing(down, interval)
            self.all_cruising = self.all_cruising and self.landing_time.tobytes() == self.zero_times

    def _turn(self, interval: float) -> None:
        turn = (self.goal_yaw - self.yaw + np.pi) % (2 * np.pi) - np.pi
        turn[(abs(turn) < 1e-6) | self.outside] = 0.0
        self.yaw_rate = np.clip(2.0 * turn, -_YAW_RATE, _YAW_RATE) * ~self.landed
        self.yaw += interval * self.yaw_rate
        done = (turn == 0.0) & ~self.outside
        self.yaw[done] = self.goal_yaw[done]

    def _lift(self, interval: float) -> None:
        """Update the usable share of full thrust: 0 on the ground, a ramp at take-off."""
        self.armed_time = np.where(self.armed, self.armed_time + interval, 0.0)
        ready = self.armed & self.may_lift & (self.armed_time > self.spool_time)
        climbing = (self.velocity_goal[:, 2] > _CLIMBING) | (self.goal_acceleration[:, 2] > 1.0)
        started = ready & self.landed & (climbing | (self.lift_time > 0))
        started &= ~self.false_landing
        self.lift_time = np.where(started | ~self.landed, self.lift_time + interval, 0.0)
        share = np.minimum(self.lift_time / self.ramp_time, 1.0)
        share = np.where(self.landing_time > self.cut_time, np.minimum(share, 0.1), share)
        self.thrust_share = share * self.armed

    def _detect_landing(self, down: Flags, interval: float) -> None:
        """Detect landings as both autopilots do: a descent setpoint (``down``) without motion.

        This is an inference, not a sensor. A vehicle that hangs on its neighbours' cable during a
        descent fulfils the condition, and its thrust is cut (PX4 #11683, #15718).
        """
        candidate = down & self.armed & (self.lift_time > 1.0)
        candidate &= ~self.landed
        if np.count_nonzero(candidate):
            candidate &= (np.abs(self.velocity) < motion.SLOW).all(axis=1)
            candidate &= self.thrust[:, 2] < _LOW_THRUST
        if np.count_nonzero(candidate):
            self.landing_time = np.where(candidate, self.landing_time + interval, 0.0)
        else:
            self.landing_time = np.zeros(self.count)
        landed = self.landing_time > self.land_time
        if np.count_nonzero(self.landed):
            off_ground = self.position[:, 2] > self.floor + self.grip_offset + 0.05
            lifted = off_ground & self.armed & ~self.false_landing
            landed |= self.landed & ~lifted
        landed = np.where(self.outside, self.landed, landed)
        if landed.tobytes() != self.landed.tobytes():
            self.landed[:] = landed
            self.landed_changes += 1


def _gust_persistence(steady: Array, interval: float) -> float:
    """Return the share of a gust that persists after ``interval`` seconds in a steady wind (3,).

    Dryden's first-order longitudinal filter on every axis (MIL-F-8785C, low altitude), vertical
    with half the intensity. Four fifths of a gust are common to the whole team, whose vehicles are
    close together.
    """
    return math.exp(-interval * max(1.0, math.hypot(*steady.tolist())) / _GUST_LENGTH)


def downwash_at(places: Array, position: Array, lift: Array, radius: Array) -> Array:
    """Return the downward air speed (m, n) at places (m, 3) under each of n vehicles.

    ``position`` (n, 3) and ``radius`` (n,) are the vehicles', ``lift`` (n,) is their upward thrust
    in newtons.

    Momentum theory gives the far-wake speed ``2 √(T / 2ρA)``; further down the wake is a turbulent
    round jet: Gaussian in radius, its width grows by a tenth of its length and its speed falls
    accordingly (Pope, "Turbulent Flows", 5.1; Jain et al., ICRA 2019, for multirotors).
    """
    across = places[:, None, :2] - position[None, :, :2]
    distance = np.einsum("ijk,ijk->ij", across, across)
    below = position[None, :, 2] - places[:, None, 2]
    jet = 2 * np.sqrt(lift / (2 * motion.AIR_DENSITY * np.pi)) / radius
    width = 0.7 * radius + 0.1 * np.maximum(below, 0.0)
    speed = jet * (0.7 * radius / width) * np.exp(-distance / (2 * width**2))
    downwash: Array = speed * ((below > 0.1) & (below < 10.0))
    return downwash
