"""Time-optimal motion of a team along a path under limits on speed and acceleration.

With w for the squared rate of the path's parameter, a vehicle's acceleration q″·w + q′·w′/2 is
linear in w (Verscheure et al. 2009), and the time ∫ dq/√w is convex: the fastest motion is the
minimum of one convex cost, in which squared excesses over the limits are penalized.
"""

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt
import scipy

from swarm.geometry.motion import Motion, through_states
from swarm.jit import compiled
from swarm.signatures import Floats1, Floats2, Floats4

Floats = npt.NDArray[np.float64]

_SMOOTHING = 0.5
"""Units of the parameter over which the squared rate is smoothed: accelerations do not jump."""

_USED = 0.98
"""Share of the squared limits that is used: the penalty permits a small excess."""

_WEIGHTS = (30.0, 300.0, 3000.0)
"""Weights of squared excesses of the acceleration against the relative time, applied in turn."""

_STEPS, _MORE_STEPS = 40, 20
"""Iterations of the quasi-Newton method for each weight, and in each later round."""

_ROUNDS = 5
"""Largest number of rounds in which limits are lowered where polynomials exceed them."""


def time_path(
    parameter: Floats,
    position: Floats,
    first: Floats,
    second: Floats,
    *,
    max_speed: float,
    max_acceleration: float,
    piece: float = 0.2,
) -> Motion:
    """Return the C² motion of a team along a path, as fast as the limits allow.

    ``parameter`` (k,) is evenly spaced; ``position``, ``first`` and ``second`` (k, n, 3) are the
    path and its derivatives by the parameter, which must vanish at both ends. Limits are in m/s and
    m/s². ``piece`` is the approximate duration of a polynomial, seconds.

    Between the samples, polynomials may exceed the limits that hold at the samples. There the
    limits are lowered and the motion is optimized again. The rest of the excess slows the whole
    motion.
    """
    limits = _rate_limits(parameter, first, second, max_speed, max_acceleration)
    log_rates = np.log(np.minimum(limits.cap, 0.5 / np.sqrt(limits.bend.max(axis=1) + 1e-12)))
    for weight in _WEIGHTS:
        log_rates = limits.minimize_time(log_rates, weight, _STEPS)
    motions: list[tuple[float, Motion]] = []
    for _ in range(_ROUNDS):
        motion, chosen = _motion(limits, log_rates, position, first, second, piece)
        excess = _time_factors(motion, max_speed, max_acceleration, 17) ** 2
        motions.append((motion.times[-1] * np.sqrt(max(1.0, excess.max())), motion))
        if excess.max() <= 1.0:
            break
        limits = limits.tightened(chosen, excess)
        log_rates = limits.minimize_time(log_rates, _WEIGHTS[-1], _MORE_STEPS)
    quickest = min(motions, key=lambda timed: timed[0])[1]
    return slow_to_limits(quickest, max_speed, max_acceleration)


def slow_to_limits(motion: Motion, max_speed: float, max_acceleration: float) -> Motion:
    """Return the motion slowed evenly until dense samples keep the limits (m/s, m/s²)."""
    rough = _time_factors(motion, max_speed, max_acceleration, 17)
    closely = np.flatnonzero(rough > _ROUGHLY * rough.max())
    stretch = float(_time_factors(motion, max_speed, max_acceleration, 129, closely).max())
    if stretch <= 1.0:
        return motion
    scale = (stretch * 1.0005) ** -np.arange(6.0)
    return Motion(motion.times * stretch * 1.0005, motion.coefficients * scale[:, None, None])


_ROUGHLY = 0.97
"""Share of the largest speed or acceleration of a piece that a dozen samples reach."""


def _time_factors(
    motion: Motion,
    max_speed: float,
    max_acceleration: float,
    samples: int,
    pieces: npt.NDArray[np.intp] | slice = slice(None),
) -> Floats:
    """Return the least factor (k,) by which time must be stretched in each piece of a motion."""
    durations = np.ascontiguousarray(np.diff(motion.times)[pieces])
    coefficients = np.ascontiguousarray(motion.coefficients[pieces])
    fastest, hardest = np.empty((2, len(durations)))
    _largest_rates(coefficients, durations, samples, fastest, hardest)
    factors: Floats = np.maximum(fastest / max_speed, np.sqrt(hardest / max_acceleration))
    return factors


@compiled
def _largest_rates(
    coefficients: Floats4, durations: Floats1, samples: int, fastest: Floats1, hardest: Floats1
) -> None:
    """Write the largest sampled speeds and accelerations (k,) of any vehicle in each piece."""
    for k in range(len(durations)):
        speed = change = 0.0
        for sample in range(samples):
            u = durations[k] * sample / (samples - 1)
            for i in range(coefficients.shape[2]):
                velocity = acceleration = 0.0
                for x in range(3):
                    c = coefficients[k, :, i, x]
                    rate = c[1] + u * (2 * c[2] + u * (3 * c[3] + u * (4 * c[4] + u * 5 * c[5])))
                    bend = 2 * c[2] + u * (6 * c[3] + u * (12 * c[4] + u * 20 * c[5]))
                    velocity, acceleration = velocity + rate**2, acceleration + bend**2
                speed, change = max(speed, velocity), max(change, acceleration)
        fastest[k], hardest[k] = np.sqrt(speed), np.sqrt(change)


@dataclass(frozen=True, eq=False)
class _RateLimits:
    """Limits on the squared rate w (k,) at samples of the parameter, ``step`` apart.

    The squared ratio of a vehicle's acceleration to its limit is bend·w² + 2·mixed·w·u + slope·u²
    with u = w′/2, each (k, n). The speed limits w to ``cap`` (k,). The squared limits of the
    acceleration are divided by ``tight`` (k,).
    """

    step: float
    bend: Floats
    mixed: Floats
    slope: Floats
    cap: Floats
    tight: Floats

    @cached_property
    def _kernel(self) -> Floats:
        """The weights of a Gaussian: ``gaussian_filter1d`` would compute them at every call."""
        deviation = _SMOOTHING / self.step
        impulse = np.zeros(2 * math.ceil(4.0 * deviation) + 1)
        impulse[len(impulse) // 2] = 1.0
        weights: Floats = scipy.ndimage.gaussian_filter1d(impulse, deviation, mode="constant")
        return weights

    def smooth(self, values: Floats) -> Floats:
        """Return values (k,) smoothed by a symmetric matrix of weights."""
        averages: Floats = scipy.ndimage.correlate1d(values, self._kernel, mode="reflect")
        return averages

    def rate_squared(self, log_rates: Floats) -> Floats:
        """Return the squared rate (k,) for its logarithm before smoothing."""
        return np.minimum(self.smooth(np.exp(log_rates)), self.cap)

    def minimize_time(self, log_rates: Floats, weight: float, steps: int) -> Floats:
        """Return the logarithms of squared rates (k,) for the least time, from an initial guess."""
        step = self.step
        usual = step * float(np.exp(-0.5 * log_rates).sum())

        def cost(log_rates: Floats) -> tuple[float, Floats]:
            rates = np.exp(log_rates)
            w = self.smooth(rates)
            by_w, by_u = np.zeros((2, len(w)))
            limits = self.bend, self.mixed, self.slope, self.tight
            excess = _excess(limits, w, _half_slope(w, step), by_w, by_u)
            fast = np.maximum(w / self.cap - 1.0, 0.0)
            total = (w**-0.5).sum() + weight * (excess + (fast**2).sum())
            slope = weight * (by_w + _half_slope_transposed(by_u, step) + 2.0 * fast / self.cap)
            gradient = self.smooth(slope - 0.5 * w**-1.5) * rates
            return float(step / usual * total), step / usual * gradient

        optimum = scipy.optimize.minimize(
            cost,
            log_rates,
            jac=True,
            method="L-BFGS-B",
            options={"maxiter": steps, "maxcor": 20, "ftol": 1e-7},
        )
        return np.asarray(optimum.x)

    def tightened(self, chosen: npt.NDArray[np.intp], excess: Floats) -> "_RateLimits":
        """Return lower limits at pieces whose ``excess`` (p,), squared, is above 1."""
        by = np.ones(len(self.cap))
        for piece in np.flatnonzero(excess > 1.0):
            around = slice(chosen[piece], chosen[piece + 1] + 1)
            by[around] = np.maximum(by[around], excess[piece])
        wide = scipy.ndimage.maximum_filter1d(by, 2 * round(_SMOOTHING / self.step) + 1)
        return replace(self, tight=self.tight * wide**2)


def _rate_limits(
    parameter: Floats, first: Floats, second: Floats, max_speed: float, max_acceleration: float
) -> _RateLimits:
    slope, bend = (first**2).sum(axis=2), (second**2).sum(axis=2)
    fastest = np.maximum(np.sqrt(slope.max(axis=1)), 1e-12)
    # Where all vehicles rest, speed sets no limit; a rate far above the others is of no use.
    most = 4.0 * (max_speed / max(float(np.percentile(fastest, 90)), 1e-12)) ** 2
    square = max_acceleration**2
    return _RateLimits(
        step=float(parameter[1] - parameter[0]),
        bend=bend / square,
        mixed=(second * first).sum(axis=2) / square,
        slope=slope / square,
        cap=np.minimum((max_speed / fastest) ** 2, most),
        tight=np.ones(len(parameter)),
    )


@compiled
def _excess(
    limits: tuple[Floats2, Floats2, Floats2, Floats1],
    w: Floats1,
    u: Floats1,
    by_w: Floats1,
    by_u: Floats1,
) -> float:
    """Return the sum of squared excesses; add its derivatives to ``by_w`` and ``by_u`` (k,).

    ``limits`` are ``bend``, ``mixed``, ``slope`` and ``tight`` of :class:`_RateLimits`.
    """
    bend, mixed, slope, tight = limits
    total = 0.0
    for k in range(len(w)):
        for i in range(bend.shape[1]):
            along, aside = bend[k, i] * w[k] + mixed[k, i] * u[k], mixed[k, i] * w[k]
            aside += slope[k, i] * u[k]
            over = tight[k] * (along * w[k] + aside * u[k]) - _USED
            if over > 0.0:
                total += over * over
                by_w[k] += 4.0 * over * tight[k] * along
                by_u[k] += 4.0 * over * tight[k] * aside
    return total


def _half_slope(w: Floats, step: float) -> Floats:
    """Return half the derivative of a squared rate (k,)."""
    half_slope: Floats = 0.5 * np.gradient(w, step)
    return half_slope


def _half_slope_transposed(by_u: Floats, step: float) -> Floats:
    """Apply the transpose of :func:`_half_slope`."""
    inner, by_w = by_u[1:-1] / (4.0 * step), np.zeros_like(by_u)
    by_w[2:] += inner
    by_w[:-2] -= inner
    by_w[:2] += by_u[0] / (2.0 * step) * np.array([-1.0, 1.0])
    by_w[-2:] += by_u[-1] / (2.0 * step) * np.array([-1.0, 1.0])
    return by_w


def _motion(
    limits: _RateLimits,
    log_rates: Floats,
    position: Floats,
    first: Floats,
    second: Floats,
    piece: float,
) -> tuple[Motion, npt.NDArray[np.intp]]:
    """Return the motion, and the indices (p,) of the samples between its polynomials."""
    w = limits.rate_squared(log_rates)
    rate = np.sqrt(w)
    times = np.concatenate([[0.0], np.cumsum(2.0 * limits.step / (rate[1:] + rate[:-1]))])
    wanted = np.linspace(0.0, times[-1], int(np.ceil(times[-1] / piece)) + 1)
    chosen = np.unique(np.searchsorted(times, wanted - 1e-9).clip(0, len(times) - 1))
    bend, tangent, u = second[chosen], first[chosen], _half_slope(w, limits.step)[chosen]
    acceleration = bend * w[chosen, None, None] + tangent * u[:, None, None]
    speed = tangent * rate[chosen, None, None]
    motion = through_states(times[chosen], position[chosen], speed, acceleration)
    return motion, chosen
