"""Motion of a team as piecewise quintic polynomials.

All grip points share the breakpoints, so that a setpoint of the whole team is one lookup and one
polynomial.
"""

from dataclasses import dataclass
from math import comb

import numpy as np
import numpy.typing as npt

from swarm.jit import compiled, inner
from swarm.signatures import Floats1, Floats2, Floats3, Floats4, contiguous

Floats = npt.NDArray[np.float64]

LEAST_STEP = 1e-4
"""Shortest piece of a motion, seconds: with six decimals, rounding of times becomes part of the
motion below it."""

_FASTEST, _PEAK, _LEAST_LEG = 1.875, 10.0 / np.sqrt(3.0), 1.0
"""Largest speed and acceleration of a quintic from rest to rest, over its means (distance over
duration, and over its square), and its least duration in seconds."""


@dataclass(frozen=True, repr=False)
class Motion:
    """Piecewise quintics of n points.

    ``times`` (k + 1,) are the increasing breakpoints in seconds, ``coefficients`` (k, 6, n, 3) the
    polynomials of each piece in the time since its start, lowest power first, in metres ENU.
    """

    times: Floats
    coefficients: Floats

    def __call__(self, times: npt.ArrayLike) -> tuple[Floats, Floats, Floats]:
        """Return position, velocity and acceleration, each (…, n, 3), as :meth:`at` does."""
        return self.at(times)

    def __repr__(self) -> str:
        count, duration = self.coefficients.shape[2], self.times[-1] - self.times[0]
        pieces = len(self.coefficients)
        return f"<Motion of {count} grip points: {duration:.0f} s in {pieces} quintic pieces>"

    def at(self, times: npt.ArrayLike) -> tuple[Floats, Floats, Floats]:
        """Return position, velocity and acceleration, each (…, n, 3), at times (…,).

        Outside the motion the result is its nearest end, at rest.
        """
        moments, breaks, coefficients = self._for_kernels(times)
        states = np.empty((3, moments.size, *coefficients.shape[2:]))
        _evaluate(breaks, coefficients, moments.reshape(-1), states)
        position, velocity, acceleration = states.reshape(3, *moments.shape, *states.shape[2:])
        return position, velocity, acceleration

    def places(self, times: npt.ArrayLike) -> Floats:
        """Return the positions (…, k, n, 3) of :meth:`at` at times (…, k) alone, in a fifth of the
        time. In memory those of a point are next to each other."""
        moments, breaks, coefficients = self._for_kernels(times)
        count = coefficients.shape[2]
        rows = moments.reshape(-1, *(moments.shape[-1:] or (1,)))
        tracks = np.empty((len(rows), count, rows.shape[1], 3))
        flat = coefficients.reshape(*coefficients.shape[:2], -1)
        _evaluate_places(breaks, flat, rows, np.empty(flat.shape[2]), tracks)
        places: Floats = tracks.swapaxes(1, 2).reshape(*moments.shape, count, 3)
        return places

    def _for_kernels(self, times: npt.ArrayLike) -> tuple[Floats, Floats, Floats]:
        moments = contiguous(np.asarray(times, dtype=np.float64))
        return moments, contiguous(self.times), contiguous(self.coefficients)


def straight_between(times: Floats, places: Floats) -> Motion:
    """Return the motion straight between places (k + 1, n, 3) at times (k + 1,), in metres."""
    coefficients = np.zeros((len(times) - 1, 6, *places.shape[1:]))
    coefficients[:, 0] = places[:-1]
    coefficients[:, 1] = np.diff(places, axis=0) / np.diff(times)[:, None, None]
    return Motion(times, coefficients)


@compiled
def _evaluate_places(
    breaks: Floats1, coefficients: Floats3, times: Floats2, row: Floats1, places: Floats4
) -> None:
    """Write positions (c, n, q, 3) at times (c, q), of polynomials (k, 6, 3 n).

    As :func:`place_in_piece`; a flat ``row`` (3 n,), memory, is a vector for the processor.
    """
    for r in range(times.shape[0]):
        for q in range(times.shape[1]):
            piece, u, _ = find_piece(breaks, times[r, q])
            c = coefficients[piece]
            for i in range(len(row)):
                upper = c[3, i] + u * (c[4, i] + u * c[5, i])
                row[i] = c[0, i] + u * (c[1, i] + u * (c[2, i] + u * upper))
            for i in range(places.shape[1]):
                for x in range(3):
                    places[r, i, q, x] = row[3 * i + x]


@compiled
def _evaluate(breaks: Floats1, coefficients: Floats4, times: Floats1, states: Floats4) -> None:
    """Write positions, velocities and accelerations (3, q, n, 3) at times (q,)."""
    for q in range(len(times)):
        piece, since, moving = find_piece(breaks, times[q])
        for i in range(coefficients.shape[2]):
            evaluate_piece(coefficients[piece], i, since, moving, states[:, q, i])


@inner
def find_piece(breaks: Floats, time: float) -> tuple[int, float, float]:
    """Return the piece at a time, the seconds since its start, and 1; 0 outside the motion."""
    inside = min(max(time, breaks[0]), breaks[-1])
    piece = np.searchsorted(breaks[1:-1], inside, side="right")
    return piece, inside - breaks[piece], 1.0 if inside == time else 0.0


@inner
def evaluate_piece(c: Floats, i: int, u: float, moving: float, state: Floats) -> None:
    """Write the state of point ``i``, ``u`` seconds into a piece ``c`` (6, n, 3).

    ``state`` (3, 3): position, velocity and acceleration; the last two multiplied by ``moving``.
    """
    for x in range(3):
        c2, c3, c4, c5 = c[2, i, x], c[3, i, x], c[4, i, x], c[5, i, x]
        state[0, x] = place_in_piece(c, i, x, u)
        state[1, x] = moving * speed_in_piece(c, i, x, u)
        state[2, x] = moving * (2 * c2 + u * (6 * c3 + u * (12 * c4 + u * 20 * c5)))


@inner
def place_in_piece(c: Floats, i: int, x: int, u: float) -> float:
    """Return coordinate ``x`` of point ``i``, ``u`` seconds into a piece ``c`` (6, n, 3)."""
    c1, c2, c3, c4, c5 = c[1, i, x], c[2, i, x], c[3, i, x], c[4, i, x], c[5, i, x]
    return float(c[0, i, x] + u * (c1 + u * (c2 + u * (c3 + u * (c4 + u * c5)))))


@inner
def speed_in_piece(c: Floats, i: int, x: int, u: float) -> float:
    """Return the derivative of :func:`place_in_piece` by time."""
    c1, c2, c3, c4, c5 = c[1, i, x], c[2, i, x], c[3, i, x], c[4, i, x], c[5, i, x]
    return float(c1 + u * (2 * c2 + u * (3 * c3 + u * (4 * c4 + u * 5 * c5))))


def through_states(
    times: Floats, position: Floats, velocity: Floats, acceleration: Floats
) -> Motion:
    """Return the C² motion through states at given times (quintic Hermite interpolation).

    ``times`` (k + 1,); states (k + 1, n, 3) in metres, m/s and m/s².
    """
    duration = np.diff(times)[:, None, None]
    p0, p1 = position[:-1], position[1:]
    v0, v1 = velocity[:-1] * duration, velocity[1:] * duration
    a0, a1 = acceleration[:-1] * duration**2, acceleration[1:] * duration**2
    step = p1 - p0
    unit = np.stack(
        [
            p0,
            v0,
            a0 / 2,
            10 * step - 6 * v0 - 4 * v1 - 1.5 * a0 + 0.5 * a1,
            -15 * step + 8 * v0 + 7 * v1 + 1.5 * a0 - a1,
            6 * step - 3 * (v0 + v1) - 0.5 * (a0 - a1),
        ],
        axis=1,
    )
    powers = np.diff(times)[:, None] ** np.arange(6)
    return Motion(times, unit / powers[:, :, None, None])


def concatenate(first: Motion, *others: Motion) -> Motion:
    """Return motions one after the other, each shifted in time to follow the one before."""
    times, coefficients = first.times, first.coefficients
    for other in others:
        shifted = other.times - other.times[0] + times[-1]
        times = np.concatenate([times, shifted[1:]])
        coefficients = np.concatenate([coefficients, other.coefficients])
    return Motion(times, coefficients)


def reverse(motion: Motion) -> Motion:
    """Return the motion from its end to its beginning, over the same times."""
    times = motion.times[0] + (motion.times[-1] - motion.times[::-1])
    duration = np.diff(motion.times)[:, None, None]
    coefficients = np.zeros_like(motion.coefficients)
    for power in range(6):  # of the time since a piece's start, which becomes d − u
        for k in range(power + 1):
            share = comb(power, k) * (-1.0) ** k * duration ** (power - k)
            coefficients[:, k] += share * motion.coefficients[:, power]
    return Motion(times, coefficients[::-1])


def at_rest(position: Floats, duration: float) -> Motion:
    """Return the motion that stays at a position (n, 3) for a duration in seconds."""
    coefficients = np.zeros((1, 6, *position.shape))
    coefficients[0, 0] = position
    return Motion(np.array([0.0, duration]), coefficients)


def leg(start: Floats, end: Floats, max_speed: float, max_acceleration: float) -> Motion:
    """Return the motion of all points (n, 3) at once along straight lines, from rest to rest."""
    return staggered_leg(start, end, np.zeros(len(start)), max_speed, max_acceleration)


def staggered_leg(
    start: Floats, end: Floats, delays: Floats, max_speed: float, max_acceleration: float
) -> Motion:
    """As :func:`leg`, with a delay (n,) in seconds for each vehicle.

    Each motion is a quintic from rest to rest; where it would be too fast, a shorter one, which is
    at the largest speed halfway and keeps that for the rest of the way before it goes on. The
    quintic takes 1 s at least, and 0.1 % more than the limits ask for, so that rounding keeps them.
    """
    distance = float(np.linalg.norm(end - start, axis=1).max())
    slowest = max(_LEAST_LEG, _PEAK / _FASTEST * max_speed / max_acceleration)
    curved = min(distance, slowest * max_speed / _FASTEST)
    duration = 1.001 * max(_LEAST_LEG, float(np.sqrt(_PEAK * curved / max_acceleration)))
    part = curved / distance if distance > 0.0 else 1.0
    steady = (1.0 / part - 1.0) * duration / _FASTEST
    middle = [0.5 * duration, 0.5 * duration + steady] if steady > 0.0 else []
    corners = np.array([0.0, *middle, duration + steady])
    times = np.unique(np.append(0.0, delays[:, None] + corners).round(9))
    # Where a vehicle's breakpoint is nearly that of another, one serves both.
    long = (np.diff(times)[:-1] >= LEAST_STEP) & (times[-1] - times[1:-1] >= LEAST_STEP)
    times = times[np.concatenate([[True], long, [True]])]
    since = times[:, None, None] - delays[:, None]
    even = np.clip(since - 0.5 * duration, 0.0, steady)
    s = np.clip((since - even) / duration, 0.0, 1.0)
    step = part * (end - start)
    return through_states(
        times,
        start + step * (s**3 * (10.0 - 15.0 * s + 6.0 * s**2) + _FASTEST * even / duration),
        step * (30.0 * s**2 * (1.0 - s) ** 2) / duration,
        step * (60.0 * s * (1.0 - s) * (1.0 - 2.0 * s)) / duration**2,
    )
