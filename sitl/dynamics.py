"""Point-mass vehicles, all in one batch: controller, thrust lag, drag, ground, land detector.

Model. The motors give a specific thrust ``f`` (m/s²) that follows the commanded one as a
second-order system (attitude loop and motors together, natural frequency `_THRUST_FREQUENCY`); then
``v̇ = f − g ẑ − c (v − wind) + F/m``. The commanded thrust comes from the cascade that both
autopilots fly: position error × P + velocity feed-forward → limits → velocity error × P + I +
acceleration feed-forward → limits of acceleration, tilt and thrust (PX4 user guide, "Controller
Diagrams"; ArduPilot ``AC_PosControl``). With full feed-forward a healthy vehicle tracks a path at
1–2 m/s with 0.05–0.1 m RMS: 0.10 m was measured on ArduCopter, more on PX4's simple simulator,
whose drag is larger.

ENU, SI, radians; arrays are (n, 3) or (n,). The controller sees the *estimate*: truth + bias +
slow noise. Vehicles stand on legs as long as their dropper: the centre is at floor + grip offset.
"""

import numpy as np
from numpy.typing import NDArray

from sitl.world import World

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

GRAVITY = 9.80665
STEP = 0.02
_THRUST_FREQUENCY = 14.0
_THRUST_DAMPING = 0.9
_YAW_RATE = 1.0
_IDLE_THRUST = 0.08 * GRAVITY
_SLOW_VERTICAL = 0.25
_SLOW_HORIZONTAL = 1.5
_DESCENDING = -0.25
_CLIMBING = 0.25
_CRASH_SPEED = 3.0
_NOISE_TIME = 4.0
NOISE_SIGMA = np.array([0.015, 0.015, 0.02])
AIR_DENSITY = 1.2


class Bodies:
    """State of all vehicles and what their autopilots want of them.

    The autopilots write ``goal_*``, the ``*_axes`` masks (1 where an axis is controlled), limits
    and flags; `step` advances everything by `STEP` seconds.
    """

    def __init__(self, world: World, rng: np.random.Generator) -> None:
        specs = world.vehicles
        n = self.count = len(specs)
        self.rng = rng
        self.floor = world.floor
        column = np.array
        self.mass = column([s.mass for s in specs])
        self.radius = column([s.radius for s in specs])
        self.grip_offset = column([s.grip_offset for s in specs])
        self.thrust_limit = column([2.0 * (s.mass + s.payload) * GRAVITY / s.mass for s in specs])
        self.max_acceleration = column([s.max_acceleration for s in specs])
        self.position = column([s.pad for s in specs], dtype=float)
        self.position[:, 2] = np.maximum(self.position[:, 2], world.floor) + self.grip_offset
        self.velocity = np.zeros((n, 3))
        self.acceleration = np.zeros((n, 3))
        self.thrust = np.zeros((n, 3))
        self.thrust_rate = np.zeros((n, 3))
        self.integral = np.zeros((n, 3))
        self.yaw = np.pi / 2 - column([s.heading for s in specs])
        self.yaw_rate = np.zeros(n)

        self.goal_position = self.position.copy()
        self.goal_velocity = np.zeros((n, 3))
        self.goal_acceleration = np.zeros((n, 3))
        self.goal_yaw = self.yaw.copy()
        self.position_axes = np.zeros((n, 3))
        self.velocity_axes = np.zeros((n, 3))
        self.speed_limit = column([s.max_speed for s in specs])
        self.climb_limit = np.full(n, 3.0)
        self.descend_limit = np.full(n, 1.5)
        self.tilt_limit = np.full(n, np.tan(np.deg2rad(45.0)))
        self.position_gain = np.ones((n, 3))
        self.velocity_gain = np.ones((n, 3))
        self.integral_gain = np.zeros((n, 3))

        self.armed = np.zeros(n, dtype=bool)
        self.may_lift = np.zeros(n, dtype=bool)
        self.landed = np.ones(n, dtype=bool)
        self.contact = np.zeros(n)
        self.armed_for = np.zeros(n)
        self.lifting = np.zeros(n)
        self.spool_time = np.ones(n)
        self.ramp_time = np.full(n, 1.5)
        self.land_time = np.full(n, 0.9)
        self.cut_time = np.full(n, 0.35)
        self.health = np.ones(n)
        self.crashed = np.zeros(n, dtype=bool)
        self.drag = np.full(n, 0.20)

        self.bias = np.zeros((n, 3))
        self.noise = np.zeros((n, 3))
        self.noise_scale = np.zeros((n, 1))
        self.estimate_moved = np.zeros((n, 3))
        self.wind = np.tile(np.array(world.wind.steady, dtype=float), (n, 1))
        self.steady_wind = self.wind.copy()
        self.gust_intensity = world.wind.gust
        self._gust = np.zeros((n + 1, 3))
        self.wash = np.zeros((n, 3))
        self.velocity_goal = np.zeros((n, 3))

    def estimated(self) -> Array:
        """Where each vehicle's estimator believes its centre to be, world ENU (n, 3)."""
        return self.position + self.bias + self.noise

    def grip_points(self) -> Array:
        """Where the grip points are: a stiff dropper along the body's own down axis (n, 3)."""
        length = np.sqrt(np.einsum("ij,ij->i", self.thrust, self.thrust))
        flying = length > 1.0
        if not flying.any():
            points = self.position.copy()
            points[:, 2] -= self.grip_offset
            return points
        scale = self.grip_offset / np.where(flying, length, 1.0)
        down = self.thrust * scale[:, None]
        down[~flying] = 0.0
        down[~flying, 2] = self.grip_offset[~flying]
        return self.position - down

    def step(self, force: Array) -> Flags | None:
        """Advance by `STEP` under external ``force`` (newtons, (n, 3)).

        Returns which vehicles have just hit the ground hard, or None.
        """
        command = self._command()
        dt = STEP
        frequency = _THRUST_FREQUENCY
        self.thrust_rate += dt * (
            frequency**2 * (command - self.thrust)
            - 2 * _THRUST_DAMPING * frequency * self.thrust_rate
        )
        self.thrust += dt * self.thrust_rate
        acceleration = self.thrust + force / self.mass[:, None]
        acceleration -= self.drag[:, None] * (self.velocity - self.wind - self.wash)
        acceleration[:, 2] -= GRAVITY
        self.acceleration = acceleration
        self.velocity += dt * acceleration
        self.position += dt * self.velocity
        turn = (self.goal_yaw - self.yaw + np.pi) % (2 * np.pi) - np.pi
        self.yaw_rate = np.clip(2.0 * turn, -_YAW_RATE, _YAW_RATE) * ~self.landed
        self.yaw += dt * self.yaw_rate
        hit = self._ground()
        self._detect_landing()
        return hit

    def _command(self) -> Array:
        """Commanded specific thrust after the health of the motors (n, 3)."""
        error = self.goal_position - self.position - self.bias - self.noise
        goal = self.position_gain * error
        goal *= self.position_axes
        goal += self.goal_velocity
        speed = np.hypot(goal[:, 0], goal[:, 1])
        goal[:, :2] *= (self.speed_limit / np.maximum(speed, self.speed_limit))[:, None]
        np.clip(goal[:, 2], -self.descend_limit, self.climb_limit, out=goal[:, 2])
        self.velocity_goal = goal
        miss = goal - self.velocity
        miss *= self.velocity_axes
        wanted = self.velocity_gain * miss
        wanted += self.goal_acceleration
        wanted += self.integral
        reach = np.hypot(wanted[:, 0], wanted[:, 1])
        limit = self.max_acceleration
        wanted[:, :2] *= (limit / np.maximum(reach, limit))[:, None]
        wanted[:, 2] += GRAVITY
        airborne = self._lift()
        self.integral += (STEP * airborne)[:, None] * self.integral_gain * miss
        np.clip(self.integral, -5.0, 5.0, out=self.integral)
        self.integral *= (airborne > 0)[:, None]
        ceiling = airborne * self.thrust_limit
        up = wanted[:, 2]
        np.clip(up, np.minimum(_IDLE_THRUST, ceiling), ceiling, out=up)
        reach = np.hypot(wanted[:, 0], wanted[:, 1])
        limit = self.tilt_limit * up
        wanted[:, :2] *= (limit / np.maximum(reach, limit + 1e-9))[:, None]
        wanted *= self.health[:, None]
        return wanted

    def _lift(self) -> Array:
        """Share of full thrust that each vehicle may use: 0 standing, ramping up on take-off."""
        self.armed_for = np.where(self.armed, self.armed_for + STEP, 0.0)
        ready = self.armed & self.may_lift & (self.armed_for > self.spool_time)
        climbing = (self.velocity_goal[:, 2] > _CLIMBING) | (self.goal_acceleration[:, 2] > 1.0)
        started = ready & self.landed & (climbing | (self.lifting > 0))
        self.lifting = np.where(
            self.landed, np.where(started, self.lifting + STEP, 0.0), self.lifting + STEP
        )
        share = np.minimum(self.lifting / self.ramp_time, 1.0)
        if (self.contact > self.cut_time).any():
            share = np.where(self.contact > self.cut_time, 0.1, share)
        return share * self.armed

    def _ground(self) -> Flags | None:
        """Keep the legs above the floor, with friction; tell who came down hard."""
        height = self.position[:, 2] - self.grip_offset - self.floor
        touching = height <= 0.0
        if not touching.any():
            return None
        hard = touching & (self.velocity[:, 2] < -_CRASH_SPEED) & ~self.crashed
        self.position[touching, 2] = self.floor + self.grip_offset[touching]
        self.velocity[touching, 2] = np.maximum(self.velocity[touching, 2], 0.0)
        self.velocity[touching, :2] *= 0.5
        still = touching & (self.thrust[:, 2] < GRAVITY)
        self.velocity[still, :2] = 0.0
        if hard.any():
            self.crashed |= hard
            self.health[hard] = 0.0
            return hard
        return None

    def _detect_landing(self) -> None:
        """Both autopilots' idea of a landing: told to go down, and not going anywhere.

        It is an inference, not a sensor. A vehicle that hangs on its neighbours' cable while told
        to descend fulfils it, and its thrust is cut (PX4 #11683, #15718).
        """
        velocity = self.velocity
        quiet = (
            (np.abs(velocity[:, 2]) < _SLOW_VERTICAL)
            & (np.abs(velocity[:, 0]) < _SLOW_HORIZONTAL)
            & (np.abs(velocity[:, 1]) < _SLOW_HORIZONTAL)
        )
        down = self.velocity_goal[:, 2] < _DESCENDING
        candidate = self.armed & ~self.landed & quiet & down & (self.lifting > 1.0)
        self.contact = np.where(candidate, self.contact + STEP, 0.0)
        left = self.position[:, 2] > self.floor + self.grip_offset + 0.05
        self.landed = (self.landed & ~(left & self.armed)) | (self.contact > self.land_time)

    def wander(self, interval: float) -> None:
        """Advance estimator noise, gusts and downwash by ``interval`` seconds (call at 10 Hz).

        Noise is first-order Gauss–Markov, `NOISE_SIGMA` metres over `_NOISE_TIME` seconds. Gusts
        are Dryden's first-order longitudinal filter on every axis (MIL-F-8785C, low altitude), four
        fifths of it common to the whole team, whose vehicles are close together.
        """
        keep = np.exp(-interval / _NOISE_TIME)
        fresh = self.rng.standard_normal((self.count, 3))
        self.noise = keep * self.noise + np.sqrt(1 - keep**2) * NOISE_SIGMA * fresh
        self.noise *= self.noise_scale > 0
        if self.gust_intensity > 0:
            speed = max(1.0, float(np.linalg.norm(self.steady_wind[0])))
            keep = np.exp(-interval * speed / 30.0)
            fresh = self.rng.standard_normal((self.count + 1, 3)) * (1.0, 1.0, 0.5)
            self._gust = keep * self._gust + np.sqrt(1 - keep**2) * self.gust_intensity * fresh
            self.wind = self.steady_wind + 0.8 * self._gust[0] + 0.6 * self._gust[1:]
        self._downwash()

    def _downwash(self) -> None:
        """Air pushed down on vehicles below others, as a vertical wind in their drag.

        Momentum theory gives the far-wake speed ``2 √(T / 2ρA)``; below, the jet is a turbulent
        round one: Gaussian in radius, widening by a tenth of its length, slowing accordingly
        (Pope, "Turbulent Flows", 5.1; Jain et al., ICRA 2020, for multirotors). The felt force is
        a multiple of body drag, because the rotors lose thrust in it.
        """
        self.wash[:] = 0.0
        if self.count < 2:
            return
        across = self.position[:, None, :2] - self.position[None, :, :2]
        distance = np.einsum("ijk,ijk->ij", across, across)
        if not (distance < 4.0).sum() > self.count:
            return
        below = self.position[None, :, 2] - self.position[:, None, 2]
        jet = (
            2
            * np.sqrt(np.maximum(self.thrust[:, 2], 0) * self.mass / (2 * AIR_DENSITY * np.pi))
            / self.radius
        )
        width = self.radius[None, :] * 0.7 + 0.1 * np.maximum(below, 0.0)
        speed = jet[None, :] * (0.7 * self.radius[None, :] / width)
        speed = speed * np.exp(-distance / (2 * width**2)) * ((below > 0.1) & (below < 10.0))
        self.wash[:, 2] = -3.0 * speed.max(axis=1)
