"""The mission clock, and the setpoints of this moment: the plan at the clock's time, or a
contingency's motion.

Mission time advances at a rate between −1 and 1 that is C¹ in real time. All quantities are of grip
points, mission ENU, SI. Inside the plan, setpoints are a function of mission time alone; a vehicle
that joins from elsewhere is blended in. Outside the plan the team follows a motion in real time, or
descends straight down.
"""

import math
from bisect import bisect_right
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from swarm.flight import estimation
from swarm.geometry.motion import Motion
from swarm.planning.clock_limits import (
    BANDWIDTH,
    SMOOTH,
    URGENT_BANDWIDTH,
    ClockLimits,
    moved_on,
)

Floats = npt.NDArray[np.float64]

_CLOSE = 1e-3
"""Rate, and its slope per second, that count as reached: 2 mm/s at the default speed limit."""


@dataclass
class MissionClock:
    """Mission time and its rate.

    The rate's slope is continuous and within ``limits``: setpoints then accelerate for a change of
    rate by no more than plans keep in reserve, and less where nothing is ``urgent``. A ``prompt``
    change, to slow down for errors, begins at once too, and is as slow as ordinary ones.
    """

    limits: ClockLimits
    time: float = 0.0
    rate: float = 0.0
    slope: float = 0.0
    target: float = 0.0
    urgent: bool = False
    prompt: bool = False

    @property
    def steepest(self) -> float:
        """The largest slope of the rate now, 1/s."""
        return self.limits.at(self.time, urgent=self.urgent)

    def set_running(self) -> None:
        """Run at full rate from now on; only for moments at which the plan is at rest."""
        self.rate = self.target = 1.0
        self.slope = 0.0

    def set_stopped(self) -> None:
        """Stand still from now on; only for moments at which the plan is at rest."""
        self.rate = self.target = self.slope = 0.0

    @property
    def stopped(self) -> bool:
        """Whether mission time stands still."""
        return self.rate == 0.0 and self.slope == 0.0

    def advance(self, duration: float, lowest: float, highest: float) -> None:
        """Move on by a short real time, within bounds of mission time."""
        bandwidth = URGENT_BANDWIDTH if self.urgent else BANDWIDTH
        rise = math.inf if self.urgent or self.prompt else SMOOTH
        self.time, self.rate, self.slope = moved_on(
            (self.time, self.rate, self.slope),
            self.target,
            self.steepest,
            bandwidth,
            rise,
            duration,
        )
        if abs(self.target - self.rate) < _CLOSE and abs(self.slope) < _CLOSE:
            self.rate, self.slope = self.target, 0.0
        if not lowest <= self.time <= highest:
            self.time = max(lowest, min(highest, self.time))
            self.set_stopped()


SHORTEST_BLEND = 2.0
"""Shortest duration of a blend into the plan, seconds."""
BLEND_SPEED = 0.3
"""Mean speed in m/s that a blend adds at most."""
RAMP = 1.0
"""Seconds in which a descent reaches its speed, or stops."""


class State(NamedTuple):
    """Position, velocity and acceleration (n, 3) of the grip points."""

    position: Floats
    velocity: Floats
    acceleration: Floats


@dataclass(frozen=True)
class Descent:
    """A descent straight down from setpoints (n, 3), at one speed and down to the floor.

    ``depth`` (n,) metres have been descended at ``time``; ``rate`` (n,), 0…1, is the share of the
    speed.
    """

    start: Floats
    speed: float
    time: float
    depth: Floats
    rate: Floats

    def advanced(self, time: float, rate: Floats | float) -> "Descent":
        """Return the descent at a later time, whose rates have changed towards others."""
        duration = time - self.time
        change = np.clip(rate - self.rate, -duration / RAMP, duration / RAMP)
        depth = self.depth + self.speed * (self.rate + 0.5 * change) * duration
        return replace(self, time=time, depth=depth, rate=self.rate + change)

    def resting(self, k: int, height: float) -> "Descent":
        """Return the descent with vehicle ``k`` at rest at a height above its setpoint."""
        depth, rate = self.depth.copy(), self.rate.copy()
        depth[k] = max(min(depth[k], self.start[k, 2] - height), 0.0)
        rate[k] = 0.0
        return replace(self, depth=depth, rate=rate)

    @property
    def state(self) -> State:
        """The setpoints of this moment."""
        position, velocity = self.start.copy(), np.zeros_like(self.start)
        floor = np.minimum(self.start[:, 2], 0.0)
        position[:, 2] = np.maximum(self.start[:, 2] - self.depth, floor)
        velocity[:, 2] = np.where(position[:, 2] > 0.0, -self.speed * self.rate, 0.0)
        return State(position, velocity, np.zeros_like(self.start))


class Sampler:
    """Evaluates a motion at one moment, quickly: a binary search and a compiled loop."""

    def __init__(self, motion: Motion) -> None:
        self._times = motion.times.tolist()
        self._coefficients = np.ascontiguousarray(motion.coefficients)

    def at(self, time: float, rate: float = 1.0, slope: float = 0.0) -> State:
        """Return the state at a time; outside the motion, its nearest end at rest.

        ``rate`` is the rate of its time, and ``slope`` the derivative of that rate in 1/s.
        """
        times = self._times
        inside = min(max(time, times[0]), times[-1])
        piece = min(bisect_right(times, inside) - 1, len(times) - 2)
        if inside != time:
            rate = slope = 0.0
        coefficients = self._coefficients[piece]
        states = np.empty((3, *coefficients.shape[1:]))
        estimation.evaluate_piece(coefficients, inside - times[piece], rate, slope, states)
        return State(states[0], states[1], states[2])


class Guidance:
    """The setpoints of n vehicles."""

    def __init__(self, motion: Motion) -> None:
        n = motion.coefficients.shape[2]
        self._plan = Sampler(motion)
        self._blend = np.zeros((n, 3))
        self._blend_since = np.zeros(n)
        self._blend_time = np.ones(n)
        self.blending = False
        self._separation: tuple[float, float, Sampler] | None = None
        self.duration = 0.0
        self._descent: Descent | None = None

    def planned(self, time: float) -> State:
        """Return the plan's state at a mission time."""
        return self._plan.at(time)

    def join(self, k: int, position: Floats, time: float, now: float) -> None:
        """Blend a vehicle from a position (3,) into the plan, from mission ``time`` on."""
        self._blend[k] = position - self._plan.at(time).position[k]
        self._blend_since[k] = now
        distance = float(np.linalg.norm(self._blend[k]))
        self._blend_time[k] = max(SHORTEST_BLEND, 1.875 * distance / BLEND_SPEED)
        self.blending = True

    def follow(self, motion: Motion, now: float) -> None:
        """Leave the plan for a motion in real time that begins at rest at the present setpoints."""
        start = float(motion.times[0])
        self._separation = now, start, Sampler(motion)
        self.duration = float(motion.times[-1]) - start
        self._descent = None

    def descend(self, start: Floats, speed: float, now: float) -> None:
        """Leave the plan straight down from setpoints (n, 3) at rest, all at the same speed."""
        nothing = np.zeros(len(start))
        self._descent = Descent(start.copy(), speed, now, depth=nothing, rate=nothing)
        self._separation = None

    @property
    def at_rest(self) -> bool:
        """Whether the setpoints rest, of a team that descended or has not left the plan."""
        return self._descent is None or not self._descent.rate.any()

    def go_down(self, now: float, rate: Floats | float) -> None:
        """Go on with the descent until now, at rates that change towards ``rate`` (0 or 1)."""
        if self._descent is not None:
            self._descent = self._descent.advanced(now, rate)

    def rest(self, k: int, height: float) -> None:
        """Let a vehicle rest in the descent, at a height above its setpoint: there it hangs."""
        if self._descent is not None:
            self._descent = self._descent.resting(k, height)

    @property
    def descending(self) -> bool:
        """Whether the team descends straight down."""
        return self._descent is not None

    def state(self, clock: MissionClock, now: float) -> State:
        """Return the setpoints of this moment."""
        if self._descent is not None:
            return self._descent.state
        if self._separation is not None:
            since, start, sampler = self._separation
            return sampler.at(start + now - since)
        state = self._plan.at(clock.time, clock.rate, clock.slope)
        return self._blended(state, now) if self.blending else state

    def _blended(self, state: State, now: float) -> State:
        u = np.clip((now - self._blend_since) / self._blend_time, 0.0, 1.0)[:, None]
        time = self._blend_time[:, None]
        fraction = 1.0 - u**3 * (10.0 - 15.0 * u + 6.0 * u**2)
        slowing = -30.0 * u**2 * (1.0 - u) ** 2 / time
        bending = -60.0 * u * (1.0 - u) * (1.0 - 2.0 * u) / time**2
        if np.all(u >= 1.0):
            self._blend[:] = 0.0
            self.blending = False
        return State(
            state.position + self._blend * fraction,
            state.velocity + self._blend * slowing,
            state.acceleration + self._blend * bending,
        )
