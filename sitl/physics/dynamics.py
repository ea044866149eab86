"""Point-mass vehicles, all in one batch: controller, thrust lag, drag, ground, land detector.

Model. The motors give a specific thrust ``f`` (m/s²) that follows the commanded one as a
second-order system (attitude loop and motors together, natural frequency 14 rad/s); then
``v̇ = f − g ẑ − c (v − wind) + F/m``. The commanded thrust comes from the cascade that both
autopilots fly: position error × P + velocity feed-forward → limits → velocity error × P + I +
acceleration feed-forward → limits of acceleration, tilt and thrust (PX4 user guide, "Controller
Diagrams"; ArduPilot ``AC_PosControl``). With full feed-forward a healthy vehicle tracks a path at
1–2 m/s with 0.05–0.1 m RMS: 0.10 m was measured on ArduCopter, more on PX4's simple simulator,
whose drag is larger.

ENU, SI, radians; arrays are (n, 3) or (n,). The controller sees the *estimate*: truth + bias +
slow noise. Vehicles stand on legs as long as their dropper: the centre is at floor + grip offset.
"""

import math
import struct
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from sitl.physics import motion, wind
from sitl.physics.geodesy import GRAVITY
from sitl.world import World

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

STEP = 0.02
_GOAL = struct.Struct("3d")
_LANE, _WANTED = 8 * motion.LANES, 8 * motion.PLACE
_LARGEST_INTEGRAL = 5.0
_NOISE_TIME = 4.0
NOISE_SIGMA = np.array([0.015, 0.015, 0.02])
_DISTURBANCE_TIME = 2.0
"""Seconds over which disturbances change."""


class Rows(NamedTuple):
    """What telemetry says, as lists over the vehicles: positions as estimated, the rest as it is.

    ``yaw`` is counter-clockwise from east, as in `Bodies`.
    """

    position: list[list[float]]
    velocity: list[list[float]]
    thrust: list[list[float]]
    yaw: list[float]
    yaw_rate: list[float]
    tumbling: list[bool]


class Bodies:
    """State of all vehicles and what their autopilots want of them.

    Autopilots set goals through `aim` and `stage`, gains, limits and flags directly, followed by
    `touch`; `step` advances everything by `STEP` seconds.
    """

    def __init__(self, world: World, rng: np.random.Generator) -> None:
        self.rng = rng
        self.floor = world.floor
        self._make_state(world)
        self._make_goals(world)
        self._make_flags()
        self._make_air(world)
        self.touch()

    def _make_state(self, world: World) -> None:
        specs = world.vehicles
        n = self.count = len(specs)
        self.mass = np.array([s.mass for s in specs])
        self.radius = np.array([s.radius for s in specs])
        self.grip_offset = np.array([s.grip_offset for s in specs])
        self.thrust_limit = np.array([2.0 * (s.mass + s.payload) * GRAVITY / s.mass for s in specs])
        self.max_acceleration = np.array([s.max_acceleration for s in specs])
        self.now = np.zeros((n, 3, motion.LANES))
        self._tuned = np.zeros((n, motion.TUNINGS))
        self.marks = np.zeros((3, n), dtype=bool)
        self._share()
        self.position[:] = [s.pad for s in specs]
        self.position[:, 2] = np.maximum(self.position[:, 2], world.floor) + self.grip_offset
        self.yaw = np.pi / 2 - np.array([s.heading for s in specs])
        self.yaw_rate = np.zeros(n)
        self.bias = np.zeros((n, 3))
        self.noise = np.zeros((n, 3))
        self._fresh = np.zeros((2 * n + 1, 3))
        self.noise_scale = np.zeros((n, 1))
        self.frames = np.ones((n, 5))
        self._spoken = np.zeros((n, 12), np.float32)

    def _make_goals(self, world: World) -> None:
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
        self.advance = np.zeros(n)
        self._axes: dict[int, tuple[float, ...]] = {}
        self.velocity_goal = np.zeros((n, 3))

    def _make_flags(self) -> None:
        n = self.count
        self.cruising = bytes([1] * n + [0] * 2 * n)
        self.nothing = bytes(8 * n)
        self.landings = 0
        self.landed[:] = True
        self.may_lift = np.zeros(n, dtype=bool)
        self.contact = np.zeros(n)
        self.armed_for = np.zeros(n)
        self.lifting = np.zeros(n)
        self.spool_time = np.ones(n)
        self.ramp_time = np.full(n, 1.5)
        self.land_time = np.full(n, 0.9)
        self.cut_time = np.full(n, 0.35)
        self.health = np.ones(n)
        self.crashed = np.zeros(n, dtype=bool)
        self.tumble = np.zeros(n)
        self.fooled = np.zeros(n, dtype=bool)
        self.drift = np.zeros((n, 3))
        self.share = np.zeros(n)
        self._hard = np.zeros(n, dtype=bool)
        self.settled = False

    def _make_air(self, world: World) -> None:
        n = self.count
        self.drag = np.full(n, 0.20)
        self.steady_wind = np.tile(np.array(world.wind.steady, dtype=float), (n, 1))
        self.wind = self.steady_wind.copy()
        self.gust_intensity = world.wind.gust
        self.gust = np.zeros((n + 1, 3))
        self.disturbance = np.zeros((n, 3))
        self._disturbance_sigma = np.array([[spec.disturbance] for spec in world.vehicles])
        self._disturbed = bool(self._disturbance_sigma.any())
        self.wash = np.zeros((n, 3))
        self.apart = np.full((n, n), np.inf)

    def _share(self) -> None:
        """Make the views of the arrays that hold several things."""
        now = self.now
        self.position = now[..., motion.POSITION]
        self.velocity = now[..., motion.VELOCITY]
        self.thrust = now[..., motion.THRUST]
        self.thrust_rate = now[..., motion.THRUST_RATE]
        self.integral = now[..., motion.INTEGRAL]
        self.goal_position = now[..., motion.PLACE]
        self.goal_velocity = now[..., motion.SPEED]
        self.goal_acceleration = now[..., motion.ACCELERATION]
        self._offset = now[..., motion.OFFSET]
        self._pushed = now[..., motion.PUSH]
        self._bytes = memoryview(cast("Any", now)).cast("B")
        self.armed, self.landed, self.tumbling = self.marks

    def __getstate__(self) -> dict[str, Any]:
        return {key: value for key, value in vars(self).items() if key != "_bytes"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """A copy's arrays share memory as the original's do."""
        self.__dict__.update(state)
        self._share()
        self.touch()

    # The way in for autopilots.

    def touch(self) -> None:
        """Renew what is derived from gains, axes, biases and air, after changing any of them."""
        tuned = self._tuned
        tuned[:, motion.GAIN :][:, :3] = self.position_gain * self.position_axes
        tuned[:, motion.RATE_GAIN :][:, :3] = self.velocity_gain * self.velocity_axes
        tuned[:, motion.INTEGRAL_GAIN :][:, :3] = STEP * self.integral_gain * self.velocity_axes
        tuned[:, motion.DRAG :] = np.column_stack(
            (
                self.drag, self.speed_limit, self.climb_limit, self.descend_limit,
                self.max_acceleration, self.tilt_limit, self.thrust_limit, self.health,
                self.floor + self.grip_offset,
            )
        )  # fmt: skip
        self._per_mass = 1.0 / self.mass[:, None]
        self._renew_air()
        self._noise_sigma = NOISE_SIGMA * (self.noise_scale > 0)
        self._noisy = bool(self.noise_scale.any())

    def _renew_air(self) -> None:
        self._rows: Rows | None = None
        self._said: bytes | None = None
        motion.renew_air(self.now, self.bias, self.noise, self.drag, self.wind, self.wash)
        self._disturb()

    def _disturb(self) -> None:
        """Add the disturbances to what the air does."""
        if self._disturbed:
            self.now[..., motion.AIR] += self.disturbance

    def aim(
        self,
        i: int,
        goal: tuple[float, ...],
        position_axes: tuple[float, float, float] = (1.0, 1.0, 1.0),
        velocity_axes: tuple[float, float, float] = (1.0, 1.0, 1.0),
    ) -> None:
        """Set one vehicle's goal: position, velocity, acceleration (9 numbers, world ENU)."""
        self.stage(i, goal)
        axes = (*position_axes, *velocity_axes)
        if self._axes.get(i) != axes:
            self._axes[i] = axes
            self.position_axes[i] = position_axes
            self.velocity_axes[i] = velocity_axes
            self.touch()

    def stage(self, i: int, goal: tuple[float, ...]) -> None:
        """As `aim` with all axes, which are controlled already; the quickest way in."""
        px, py, pz, vx, vy, vz, ax, ay, az = goal
        put, at = _GOAL.pack_into, i * 3 * _LANE + _WANTED
        put(self._bytes, at, px, vx, ax)
        put(self._bytes, at + _LANE, py, vy, ay)
        put(self._bytes, at + 2 * _LANE, pz, vz, az)

    def climb(self, i: int, rate: float) -> None:
        """Change the vertical velocity of one vehicle's goal (m/s, up)."""
        self.goal_velocity[i, 2] = rate

    # Reading.

    def estimated(self) -> Array:
        """Where each vehicle's estimator believes its centre to be, world ENU (n, 3)."""
        estimate: Array = self.position + self._offset
        return estimate

    def rows(self) -> Rows:
        """Return what telemetry says, as lists, made once a step."""
        if self._rows is None:
            self._rows = Rows(
                (self.position + self._offset).tolist(),
                self.velocity.tolist(),
                self.thrust.tolist(),
                self.yaw.tolist(),
                self.yaw_rate.tolist(),
                self.tumbling.tolist(),
            )
        return self._rows

    def said(self) -> bytes:
        """Return `motion.said` as bytes, made once a step."""
        if self._said is None:
            motion.said(
                self.now, self.tumbling, self.tumble, self.yaw, self.yaw_rate, self.frames,
                self._spoken,
            )  # fmt: skip
            self._said = self._spoken.tobytes()
        return self._said

    def lift(self) -> Array:
        """Return the upward thrust of each vehicle in newtons (n,), at least 0."""
        lift: Array = np.maximum(self.thrust[:, 2], 0.0) * self.mass
        return lift

    def grip_points(self) -> Array:
        """Where the grip points are: a stiff dropper along the body's own down axis (n, 3)."""
        points = np.empty((self.count, 3))
        motion.grips(self.now, self.grip_offset, points)
        return points

    # One step.

    def push(self, force: Array) -> None:
        """Set the external force on every vehicle (newtons, (n, 3)) until it is set again."""
        self._pushed[:] = force * self._per_mass

    def step(self) -> Flags | None:
        """Advance by `STEP`; return which vehicles have just hit the ground hard, or None."""
        self._rows = self._said = None
        hard = self._hard
        if not motion.advance(
            self.now, self._tuned, self.share, self.crashed, STEP, self.velocity_goal, hard
        ):
            return None
        self.crashed |= hard
        self.health[hard] = 0.0
        self.touch()
        return hard.copy()

    def wander(self, interval: float) -> None:
        """Advance estimator noise, gusts and downwash by ``interval`` seconds (call at 10 Hz).

        Noise is first-order Gauss–Markov, `NOISE_SIGMA` metres over `_NOISE_TIME` seconds; so are
        disturbances, m/s² over `_DISTURBANCE_TIME` seconds.
        """
        keep, gust_keep, fresh = 1.0, 1.0, self._fresh
        if self._noisy:
            keep = math.exp(-interval / _NOISE_TIME)
            fresh[: self.count] = self.rng.standard_normal((self.count, 3))
        if self.gust_intensity > 0:
            fresh[self.count :] = self.rng.standard_normal((self.count + 1, 3))
            gust_keep = wind.gust_keeps(self.steady_wind[0], interval)
        self._rows = self._said = None
        motion.breathe(
            self.now, fresh, (keep, gust_keep), interval,
            (_LARGEST_INTEGRAL, float(self.gust_intensity), wind.WASH_FACTOR), self.noise,
            self._noise_sigma, self.bias, self.drift, self.gust, self.steady_wind, self.wind,
            self.wash, self.drag, self.mass, self.radius, self.apart,
        )  # fmt: skip
        if self._disturbed:
            keeps = math.exp(-interval / _DISTURBANCE_TIME)
            drawn = self._disturbance_sigma * self.rng.standard_normal((self.count, 3))
            self.disturbance = keeps * self.disturbance + math.sqrt(1.0 - keeps**2) * drawn
            self._disturb()
