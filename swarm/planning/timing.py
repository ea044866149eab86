"""How fast a team flies a path: as fast as everybody's limits on speed and acceleration allow.

With w for the squared rate of the path's parameter, a vehicle's acceleration q″·w + q′·w′/2 is
linear in it (Verscheure et al. 2009), and the time ∫ dq/√w is convex: the quickest flight is the
minimum of one convex cost, with what exceeds the limits squared and weighed.
"""

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.ndimage import gaussian_filter1d, maximum_filter1d
from scipy.optimize import minimize

from swarm.geometry.motion import Motion, through_states
from swarm.jit import compiled

Floats = npt.NDArray[np.float64]

_EVEN = 0.5
"""Units of the parameter over which the squared rate is evened out: accelerations do not jump."""

_ROOM = 0.98
"""Share of the squared limits that is used up: weighed squares are exceeded by a little."""

_WEIGHTS = (30.0, 300.0, 3000.0)
"""Weight of squared accelerations beyond the limits', next to the share of the time that it takes,
one after the other."""

_STEPS, _MORE_STEPS = 40, 20
"""Steps of the quasi-Newton method for each weight, and in rounds after that."""

_ROUNDS = 5
"""So often limits are lowered where polynomials exceed them between the samples."""


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
    """Fly a path of the team as fast as the limits allow, C².

    ``parameter`` (k,) is evenly spaced; ``position``, ``first`` and ``second`` (k, n, 3) are the
    path and its derivatives by the parameter, which must all be at rest at both ends (vanishing
    derivatives). ``piece`` is about the duration of a polynomial, in seconds.

    Polynomials exceed between the samples what is kept at these: there limits are lowered, and the
    quickest flight is found again. What they exceed at last, all of the flight is slowed by.
    """
    pace = _pace(parameter, first, second, max_speed, max_acceleration)
    wishes = np.log(np.minimum(pace.cap, 0.5 / np.sqrt(pace.bend.max(axis=1) + 1e-12)))
    for weight in _WEIGHTS:
        wishes = pace.quickest(wishes, weight, _STEPS)
    flights: list[tuple[float, Motion]] = []
    for _ in range(_ROUNDS):
        motion, chosen = _flown(pace, wishes, position, first, second, piece)
        excess = _stretches(motion, max_speed, max_acceleration, 17) ** 2
        flights.append((motion.times[-1] * np.sqrt(max(1.0, excess.max())), motion))
        if excess.max() <= 1.0:
            break
        pace = pace.tightened(chosen, excess)
        wishes = pace.quickest(wishes, _WEIGHTS[-1], _MORE_STEPS)
    quickest = min(flights, key=lambda flight: flight[0])[1]
    return slow_to_limits(quickest, max_speed, max_acceleration)


def slow_to_limits(motion: Motion, max_speed: float, max_acceleration: float) -> Motion:
    """Stretch time evenly until dense samples keep the limits; unchanged where they do."""
    rough = _stretches(motion, max_speed, max_acceleration, 17)
    closely = np.flatnonzero(rough > _ROUGHLY * rough.max())
    stretch = float(_stretches(motion, max_speed, max_acceleration, 129, closely).max())
    if stretch <= 1.0:
        return motion
    scale = (stretch * 1.0005) ** -np.arange(6.0)
    return Motion(motion.times * stretch * 1.0005, motion.coefficients * scale[:, None, None])


_ROUGHLY = 0.97
"""Share of a piece's largest speed or acceleration that a dozen samples do not miss."""


def _stretches(
    motion: Motion,
    max_speed: float,
    max_acceleration: float,
    samples: int,
    pieces: npt.NDArray[np.intp] | slice = slice(None),
) -> Floats:
    """By how much time is to be stretched (k,), at least, for each of a motion's pieces (k,)."""
    durations = np.ascontiguousarray(np.diff(motion.times)[pieces])
    coefficients = np.ascontiguousarray(motion.coefficients[pieces])
    fastest, hardest = np.empty((2, len(durations)))
    _most(coefficients, durations, samples, fastest, hardest)
    found: Floats = np.maximum(fastest / max_speed, np.sqrt(hardest / max_acceleration))
    return found


@compiled
def _most(
    coefficients: Floats, durations: Floats, samples: int, fastest: Floats, hardest: Floats
) -> None:
    """Write the largest speeds and accelerations (k,) of anybody in pieces, as sampled."""
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
class _Pace:
    """What limits the squared rate w (k,) at samples of the parameter, ``step`` apart.

    The square of a vehicle's acceleration over its limit is bend·w² + 2·mixed·w·u + slope·u² with u
    = w′/2, each (k, n); w is at most ``cap`` (k,) for the speed. ``tight`` (k,) is what the squared
    limits are divided by.
    """

    step: float
    bend: Floats
    mixed: Floats
    slope: Floats
    cap: Floats
    tight: Floats

    def even(self, wishes: Floats) -> Floats:
        """Even values (k,) out, by weights that are symmetric as a matrix."""
        found: Floats = gaussian_filter1d(wishes, _EVEN / self.step, mode="reflect")
        return found

    def rate_squared(self, wishes: Floats) -> Floats:
        """The squared rate (k,) from the logarithm of what is wished."""
        return np.minimum(self.even(np.exp(wishes)), self.cap)

    def quickest(self, wishes: Floats, weight: float, steps: int) -> Floats:
        """Wishes (k,) for the quickest flight, from some to begin with."""
        step = self.step
        usual = step * float(np.exp(-0.5 * wishes).sum())

        def cost(wishes: Floats) -> tuple[float, Floats]:
            wished = np.exp(wishes)
            w = self.even(wished)
            by_w, by_u = np.zeros_like(w), np.zeros_like(w)
            excess = _excess(
                self.bend, self.mixed, self.slope, self.tight, w, _rise(w, step), by_w, by_u
            )
            fast = np.maximum(w / self.cap - 1.0, 0.0)
            total = (w**-0.5).sum() + weight * (excess + (fast**2).sum())
            slope = weight * (by_w + _rise_back(by_u, step) + 2.0 * fast / self.cap)
            gradient = self.even(slope - 0.5 * w**-1.5) * wished
            return float(step / usual * total), step / usual * gradient

        found = minimize(
            cost,
            wishes,
            jac=True,
            method="L-BFGS-B",
            options={"maxiter": steps, "maxcor": 20, "ftol": 1e-7},
        )
        return np.asarray(found.x)

    def tightened(self, chosen: npt.NDArray[np.intp], excess: Floats) -> "_Pace":
        """With lower limits where pieces between chosen samples exceed them: that (k,), squared."""
        by = np.ones(len(self.cap))
        for piece in np.flatnonzero(excess > 1.0):
            around = slice(chosen[piece], chosen[piece + 1] + 1)
            by[around] = np.maximum(by[around], excess[piece])
        wide = maximum_filter1d(by, 2 * round(_EVEN / self.step) + 1)
        return replace(self, tight=self.tight * wide**2)


def _pace(
    parameter: Floats, first: Floats, second: Floats, max_speed: float, max_acceleration: float
) -> _Pace:
    slope, bend = (first**2).sum(axis=2), (second**2).sum(axis=2)
    fastest = np.maximum(np.sqrt(slope.max(axis=1)), 1e-12)
    # Where everybody rests, speed sets no limit, but no rate is any use that is much above others.
    most = 4.0 * (max_speed / max(float(np.percentile(fastest, 90)), 1e-12)) ** 2
    square = max_acceleration**2
    return _Pace(
        step=float(parameter[1] - parameter[0]),
        bend=bend / square,
        mixed=(second * first).sum(axis=2) / square,
        slope=slope / square,
        cap=np.minimum((max_speed / fastest) ** 2, most),
        tight=np.ones(len(parameter)),
    )


@compiled
def _excess(
    bend: Floats,
    mixed: Floats,
    slope: Floats,
    tight: Floats,
    w: Floats,
    u: Floats,
    by_w: Floats,
    by_u: Floats,
) -> float:
    """Sum of squares of what squared accelerations exceed; adds its derivatives to two (k,)."""
    total = 0.0
    for k in range(len(w)):
        for i in range(bend.shape[1]):
            along, aside = bend[k, i] * w[k] + mixed[k, i] * u[k], mixed[k, i] * w[k]
            aside += slope[k, i] * u[k]
            over = tight[k] * (along * w[k] + aside * u[k]) - _ROOM
            if over > 0.0:
                total += over * over
                by_w[k] += 4.0 * over * tight[k] * along
                by_u[k] += 4.0 * over * tight[k] * aside
    return total


def _rise(w: Floats, step: float) -> Floats:
    """Half the derivative of a squared rate (k,)."""
    found: Floats = 0.5 * np.gradient(w, step)
    return found


def _rise_back(by_u: Floats, step: float) -> Floats:
    """The transpose of :func:`_rise`."""
    inner, found = by_u[1:-1] / (4.0 * step), np.zeros_like(by_u)
    found[2:] += inner
    found[:-2] -= inner
    found[:2] += by_u[0] / (2.0 * step) * np.array([-1.0, 1.0])
    found[-2:] += by_u[-1] / (2.0 * step) * np.array([-1.0, 1.0])
    return found


def _flown(
    pace: _Pace, wishes: Floats, position: Floats, first: Floats, second: Floats, piece: float
) -> tuple[Motion, npt.NDArray[np.intp]]:
    """The flight, and the samples (p,) that its polynomials go through, ``piece`` seconds apart."""
    w = pace.rate_squared(wishes)
    rate = np.sqrt(w)
    times = np.concatenate([[0.0], np.cumsum(2.0 * pace.step / (rate[1:] + rate[:-1]))])
    wanted = np.linspace(0.0, times[-1], int(np.ceil(times[-1] / piece)) + 1)
    chosen = np.unique(np.searchsorted(times, wanted - 1e-9).clip(0, len(times) - 1))
    bend, tangent, u = second[chosen], first[chosen], _rise(w, pace.step)[chosen]
    acceleration = bend * w[chosen, None, None] + tangent * u[:, None, None]
    speed = tangent * rate[chosen, None, None]
    motion = through_states(times[chosen], position[chosen], speed, acceleration)
    return motion, chosen
