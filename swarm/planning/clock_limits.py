"""How fast the rate of the mission clock may change along a plan, and how far a stop leads.

A change of the rate by ṙ per second accelerates a vehicle of planned speed v by ṙ·v along its path.
Braking keeps that within the plan's reserve b for the fastest vehicle of the moment. An ordinary
change is smoother: the slope rises and falls steadily, in eight seconds from full rate to rest.
Such a triangle leaves no swing with half that period, and little with shorter ones (Singer and
Seering 1990): 4 s is the period of 12 m of cable whose ends are together, 5.2 √(ℓ/2g).
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
import scipy

from swarm.geometry.motion import Motion
from swarm.jit import compiled
from swarm.signatures import Floats1, Floats2

Floats = npt.NDArray[np.float64]

BANDWIDTH, URGENT_BANDWIDTH = 2.0, 8.0
"""The speed at which the clock's rate approaches its target, ordinarily and urgently, per second:
rates that follow measured errors are smooth, urgent stops begin at once."""

ORDINARY = 0.25
"""Largest slope of the rate, 1/s, where nothing is urgent: halfway from full rate to rest."""

SMOOTH = ORDINARY**2
"""How fast an ordinary slope rises, 1/s²: to ORDINARY while the rate falls from 1 to 1/2."""

URGENT = 1.0
"""Largest slope of the rate in an urgent stop, 1/s: the vehicles then stop about as late as one
that has lost its setpoints (1.0 s); faster stops of slow teams would gain nothing."""

COURSE_STEP = 0.02
"""Seconds between the times of a course: a tick at 50 Hz."""

_STEP = 0.05
"""Seconds of mission time between the samples: at 1 m/s² speeds change by 5 cm/s meanwhile."""

_AROUND = 5
"""Samples before and after a moment whose speeds count for it: the slope follows within 0.1 s."""

_RESPONSE = 1.0 / (4.0 * URGENT_BANDWIDTH) + 0.5 / 20.0
"""Seconds by which the slope follows its target late: the filter's time constant, and half a tick
at the slowest rate of setpoints (20 Hz)."""


@dataclass(frozen=True, eq=False)
class ClockLimits:
    """The largest slope ``urgent`` (k,) of the clock's rate, 1/s, every 0.05 s from ``start``."""

    start: float
    urgent: Floats

    def at(self, time: float, *, urgent: bool) -> float:
        """Return the largest slope at a mission time, 1/s."""
        sample = round((time - self.start) / _STEP)
        limit = float(self.urgent[min(max(sample, 0), len(self.urgent) - 1)])
        return limit if urgent else min(limit, ORDINARY)

    def advance(self, times: Floats, rates: Floats, delay: float) -> Floats:
        """Return the mission seconds that pass until the clock stands, after urgent stops.

        The clock runs at ``rates`` at ``times`` and keeps them for ``delay`` seconds before it
        slows. Arrays of one shape, or of shapes that broadcast.
        """
        slowing = times + (delay + _RESPONSE) * rates
        grid, energy = self._energy
        end = np.interp(np.interp(slowing, grid, energy) + 0.5 * rates**2, energy, grid)
        # The last part, in which the slope is proportional to the rate, is slower.
        tail = 0.5 * np.minimum(rates, URGENT / URGENT_BANDWIDTH) / URGENT_BANDWIDTH
        advance: Floats = end - times + tail
        return advance

    def course(
        self, starts: Floats, rate: float, target: float, duration: float, *, urgent: bool
    ) -> Floats:
        """Return mission times (c, k), COURSE_STEP seconds apart, of clocks that change their rate.

        Each begins at a time of ``starts`` (c,) with ``rate`` and approaches ``target``, as
        :class:`swarm.flight.guidance.MissionClock` does.
        """
        times = np.empty((len(starts), round(duration / COURSE_STEP) + 1))
        times[:, 0] = starts
        _write_courses(self.start, self.urgent, (rate, target), urgent, times)
        return times

    @cached_property
    def _energy(self) -> tuple[Floats, Floats]:
        """Mission times (k,), and half the squared rate that braking up to them takes away."""
        last = self.start + _STEP * (len(self.urgent) - 1)
        grid = np.append(self.start + _STEP * np.arange(len(self.urgent)), last + 10.0)
        limit = np.append(self.urgent, URGENT)
        steps = 0.5 * (limit[1:] + limit[:-1]) * np.diff(grid)
        return grid, np.concatenate([[0.0], np.cumsum(steps)])


def clock_limits(motion: Motion, braking: float) -> ClockLimits:
    """Return the limits for a motion of which ``braking`` (m/s²) is kept in reserve."""
    count = int(np.ceil((motion.times[-1] - motion.times[0]) / _STEP)) + 1
    times = motion.times[0] + _STEP * np.arange(count)
    speed = np.linalg.norm(motion.at(times)[1], axis=2).max(axis=1)
    fastest = scipy.ndimage.maximum_filter1d(speed, 2 * _AROUND + 1, mode="nearest")
    return ClockLimits(float(motion.times[0]), np.minimum(URGENT, braking / (fastest + 1e-9)))


@compiled
def moved_on(
    clock: tuple[float, float, float], target: float, steepest: float, bandwidth: float,
    rise: float, duration: float,
) -> tuple[float, float, float]:  # fmt: skip
    """Return mission time (s), rate and slope (1/s) of a clock after a short ``duration`` (s).

    The slope follows a wanted one at four times the bandwidth, the critically damped case: the rate
    does not overshoot. It rises no faster than ``rise`` (1/s²), and falls likewise as the rate
    approaches its target; a slope in the wrong direction ends at once.
    """
    time, rate, slope = clock
    error = abs(target - rate)
    near = rise / bandwidth**2
    wanted = bandwidth * error if error < near else np.sqrt(2.0 * rise * (error - 0.5 * near))
    wanted = min(wanted, steepest) if target > rate else -min(wanted, steepest)
    change = min(1.0, 4.0 * bandwidth * duration) * (wanted - slope)
    if slope * change >= 0.0:
        change = max(-rise * duration, min(rise * duration, change))
    after = slope + change
    gained = 0.5 * (slope + after) * duration
    return time + (rate + 0.5 * gained) * duration, rate + gained, after


@compiled
def _write_courses(
    start: float, limits: Floats1, rates: tuple[float, float], urgent: bool, times: Floats2
) -> None:
    """Write mission times (c, k) of courses from those in the first column.

    From the first of ``rates`` to the second, with the steepest slopes of :class:`ClockLimits`.
    """
    bandwidth, rise = (URGENT_BANDWIDTH, np.inf) if urgent else (BANDWIDTH, SMOOTH)
    for c in range(len(times)):
        clock = times[c, 0], rates[0], 0.0
        for k in range(1, times.shape[1]):
            sample = min(max(round((clock[0] - start) / _STEP), 0), len(limits) - 1)
            steepest = limits[sample] if urgent else min(limits[sample], ORDINARY)
            clock = moved_on(clock, rates[1], steepest, bandwidth, rise, COURSE_STEP)
            times[c, k] = clock[0]
