"""A fold that excites little swing of its cable: input shaping, and slowing where needed.

A zero-vibration shaper (Singer and Seering 1990) replaces a motion by shares of it at delays of
half a period of a mode; a cascade of them is quiet over a band of periods. The lateral modes of a
strand have about the period of a pendulum of 0.8 times its sag (Irvine 1981), which changes during
a fold: the cascade covers the band from the smallest sag of the layout to beyond the largest.
Strands that still leave their catenary by more than the limit lean in the air or are accelerated as
a whole; there the motion is slowed until the simulated swing keeps the limit.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product

import numpy as np
import numpy.typing as npt

from swarm.geometry.catenary import STANDARD_GRAVITY
from swarm.geometry.lumped_mass import TOGETHER, Strands, SwingModel
from swarm.geometry.motion import Motion, through_states
from swarm.threads import side_by_side

Floats = npt.NDArray[np.float64]

_DAMPING = 0.04
"""Damping ratio of a strand's lateral mode by drag, at amplitudes of 0.25 m (measured in the
lumped-mass model)."""

_BEYOND = 1.3
"""Longest period of the cascade over that of the largest sag at rest: sags are larger in the
fold."""

PENDULUM = 0.8
"""A strand's lateral mode swings as a pendulum of this share of its sag (Irvine 1981)."""

_SAMPLE = 0.2
"""Duration of the pieces of a shaped motion, seconds: as those of timed paths."""

SETTLING = 4.0
"""Seconds after the motion in which swing counts, too."""

COMPARED = 0.1
"""Seconds between the moments at which strands are compared with their catenaries."""


@dataclass(frozen=True, eq=False)
class Shaper:
    """Impulses: ``delays`` (k,) in seconds from 0, and their ``shares`` (k,), which sum to 1."""

    delays: Floats
    shares: Floats


def zero_vibration(periods: tuple[float, ...], damping: float = _DAMPING) -> Shaper:
    """Return the cascade of zero-vibration shapers for modes of the given periods, in seconds.

    ``damping`` is the damping ratio of all modes (Singer and Seering 1990, eq. 6).
    """
    decay = math.exp(-damping * math.pi / math.sqrt(1.0 - damping * damping))
    pairs = [((0.0, 1.0 / (1.0 + decay)), (0.5 * t, decay / (1.0 + decay))) for t in periods]
    impulses = list(product(*pairs))
    delays = np.array([sum(delay for delay, _ in chosen) for chosen in impulses])
    shares = np.array([math.prod(share for _, share in chosen) for chosen in impulses])
    order = np.argsort(delays, kind="stable")
    return Shaper(delays[order], shares[order])


def shaper_for(sags: Floats) -> Shaper:
    """Return the shaper for strands that hang with sags (m,), metres, at the end of a fold."""
    shortest, longest = (_period(float(sag)) for sag in (sags.min(), sags.max()))
    return zero_vibration((shortest, math.sqrt(shortest * longest), longest, _BEYOND * longest))


def _period(sag: float) -> float:
    return 2.0 * math.pi * math.sqrt(PENDULUM * sag / STANDARD_GRAVITY)


@dataclass(frozen=True, eq=False)
class PacedMotion:
    """A motion at a varying rate: ``rate`` (k,) at its own times ``at`` (k,), evenly spaced."""

    motion: Motion
    at: Floats
    rate: Floats

    @cached_property
    def time(self) -> Floats:
        """The times (k,), from 0, at which the motion has reached ``at``."""
        pace = 1.0 / self.rate
        steps = np.diff(self.at) * 0.5 * (pace[1:] + pace[:-1])
        time: Floats = np.concatenate([[0.0], np.cumsum(steps)])
        return time

    @cached_property
    def slope(self) -> Floats:
        """Derivative (k,) of the rate by the motion's own time, 1/s."""
        slope: Floats = np.gradient(self.rate, self.at)
        return slope

    def states(self, time: Floats) -> tuple[Floats, Floats, Floats]:
        """Return position, velocity and acceleration (m, n, 3) at times (m,); at rest outside."""
        reached = self.time
        inside = ((time >= 0.0) & (time <= reached[-1]))[:, None, None]
        at = np.interp(time, reached, self.at)
        rate = np.interp(at, self.at, self.rate)[:, None, None]
        slope = np.interp(at, self.at, self.slope)[:, None, None]
        place, velocity, acceleration = self.motion.at(at)
        change = acceleration * rate**2 + velocity * rate * slope
        return place, inside * velocity * rate, inside * change


def shape(paced: PacedMotion, shaper: Shaper) -> Motion:
    """Return the shaped motion, from time 0: the sum of shares of a motion, each with its delay.

    It lasts longer by the largest delay and is C²: quintics through its states every 0.2 s. Speeds
    and accelerations are no larger than those of the paced motion, up to interpolation.
    """
    times = _samples(paced, shaper)
    place, velocity, acceleration = (
        np.zeros((len(times), *paced.motion.coefficients.shape[2:])) for _ in range(3)
    )
    for delay, share in zip(shaper.delays, shaper.shares, strict=True):
        states = paced.states(times - delay)
        place += share * states[0]
        velocity += share * states[1]
        acceleration += share * states[2]
    return through_states(times, place, velocity, acceleration)


def shaped_from(paced: PacedMotion, shaper: Shaper) -> Floats:
    """Return the motion's own times (m, k) whose shares make up its shaped motion, every 0.2 s."""
    delayed = _samples(paced, shaper)[:, None] - shaper.delays
    times: Floats = np.interp(delayed, paced.time, paced.at)
    return times


def _samples(paced: PacedMotion, shaper: Shaper) -> Floats:
    """Return the times of a shaped motion's pieces."""
    duration = paced.time[-1] + shaper.delays[-1]
    return np.linspace(0.0, duration, math.ceil(duration / _SAMPLE) + 1)


def largest_stray(motion: Motion, strands: Sequence[Strands]) -> tuple[Floats, Floats]:
    """Return times (k,) and how far strands (k, n − 1) are from their catenaries then, metres.

    ``strands`` are all of the cable, each with its model, the finest last. The cable is at rest
    when the motion begins; the moments last until four seconds after its end.
    """
    finest = strands[-1].model
    times = np.arange(motion.times[0], motion.times[-1] + SETTLING, finest.step)
    ends, compared = motion.places(times), steps_between_compared(finest)
    strays = np.empty((len(times[::compared]), ends.shape[1] - 1))

    def write(some: Strands) -> None:
        moved = ends[:: round(some.model.step / finest.step)]
        every = steps_between_compared(some.model)
        joints = some.swing_on_each(some.at_rest(ends[0])[None], moved[None], every)[0]
        strays[:, some.segments] = some.strays(joints, moved[::every])

    for _ in side_by_side(write, _side_by_side(strands)):
        pass
    return times[::compared], strays


def _side_by_side(strands: Sequence[Strands]) -> Iterator[Strands]:
    """Yield the strands in groups that are stepped together."""
    for some in strands:
        for first in range(0, len(some.segments), TOGETHER):
            part = slice(first, first + TOGETHER)
            yield replace(some, segments=some.segments[part], lengths=some.lengths[part])


def steps_between_compared(model: SwingModel) -> int:
    """Return the number of steps of a model between compared moments."""
    return max(1, round(COMPARED / model.step))
