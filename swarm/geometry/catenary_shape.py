"""Dimensionless relations of a catenary: half angle, stretch, sag and drop.

x is the half angle, half the span over the catenary's parameter; the gradient is rise over span.
Sags and drops are over the span. Functions take arrays (…,) that broadcast; compiled ones take
numbers.
"""

import numpy as np
from numpy.typing import NDArray

from swarm.jit import compiled, inner
from swarm.signatures import Floats1

Floats = NDArray[np.float64]

SMALLEST_HALF_ANGLE = 1e-100
"""Half angle of a strand without slack: it changes no shape, and the tension stays finite."""

VERTICAL = 1e-80
"""Smallest span per length: vertical to any accuracy, and no figure overflows."""

_REVERTED = np.array(
    [
        6.0,
        6 / 5,
        4 / 175,
        -2 / 175,
        676 / 336875,
        1852 / 65690625,
        -237976 / 2299171875,
        2.1262929467491292e-05,
        1.1422663325531922e-06,
        -1.503421006869787e-06,
        2.652176190742275e-07,
    ]
)
"""x² as a power series in log(sinh(x) / x), from the first power up; by reversion."""


@inner
def solve_half_angle(stretch: float) -> float:
    """Return x ≥ 0 with log(sinh(x) / x) = stretch.

    Up to 0.16 the reverted power series is exact to rounding. Beyond, two steps of Halley's method
    are, from the series (below 4) or from the asymptote of x − log 2x.
    """
    if stretch < 4.0:
        square = 0.0
        for coefficient in _REVERTED[::-1]:
            square = square * stretch + coefficient
        x = np.sqrt(stretch * square)
        if stretch <= 0.16:
            return float(x)
    else:
        x = stretch + np.log(2.0 * (stretch + np.log(2.0 * stretch + 4.0)))
    for _ in range(2):
        fading, inverse = np.exp(-2.0 * x), 1.0 / x
        left = 1.0 / (1.0 - fading)
        value = x + np.log((0.5 - 0.5 * fading) * inverse) - stretch
        first = (1.0 + fading) * left - inverse
        second = inverse * inverse - 4.0 * fading * left * left
        x = x - value * first / (first * first - 0.5 * value * second)
    return float(x)


def log_sinhc(x: Floats) -> Floats:
    """Return log(sinh(x) / x), exact to rounding for every x ≥ 0."""
    u = np.minimum(x * x, 1.0)
    term = np.ones_like(u)
    for k in (18, 16, 14, 12, 10, 8, 6, 4):
        term = 1.0 + u * term / (k * (k + 1))
    wide = np.maximum(x, 1.0)
    return np.where(
        x < 1.0,
        np.log1p(u / 6.0 * term),
        wide + np.log1p(-np.exp(-2.0 * wide)) - np.log(2.0 * wide),
    )


def sinh_minus_argument(x: Floats) -> Floats:
    """Return sinh x − x for x ≥ 0, without cancellation."""
    u = np.minimum(x * x, 1.0)
    term = np.ones_like(u)
    for k in (16, 14, 12, 10, 8, 6, 4):
        term = 1.0 + u * term / (k * (k + 1))
    return np.where(x < 1.0, x * u / 6.0 * term, np.sinh(x) - x)


def sag_per_span(x: Floats, gradient: Floats) -> Floats:
    """Return sag over span of a strand of half angle x whose chord rises by ``gradient`` per metre.

    The curve is farthest below the chord where it is parallel to it, at θ* = arsinh(gradient),
    δ = θ* − θ_start along from the start.
    """
    stretch = log_sinhc(x)
    at_middle = gradient * np.exp(-stretch)
    middle = np.arcsinh(at_middle)
    ratio = -gradient * np.expm1(-stretch)
    ratio = ratio / (np.hypot(1.0, gradient) + np.hypot(1.0, at_middle))
    delta = x + np.where(
        np.abs(ratio) < 0.5,
        2.0 * np.arctanh(np.clip(ratio, -0.5, 0.5)),
        np.arcsinh(gradient) - middle,
    )
    near = 2.0 * np.hypot(1.0, gradient) * np.sinh(
        0.5 * np.minimum(delta, 1.0)
    ) ** 2 - gradient * sinh_minus_argument(np.minimum(delta, 1.0))
    far = gradient * delta - np.hypot(1.0, gradient) + np.cosh(middle - x)
    return np.where(delta < 1.0, near, far) / (2.0 * x)


def half_angle_for_sag(sag: Floats, gradient: Floats) -> Floats:
    """Invert :func:`sag_per_span` for x by Newton's method in logarithms."""
    taut = sag == 0.0
    target = np.where(taut, 1.0, sag)
    x = np.arcsinh(4.0 * target / np.hypot(1.0, gradient))
    for _ in range(40):
        value = sag_per_span(x, gradient)
        middle = np.arcsinh(gradient / np.exp(log_sinhc(x)))
        turning = np.tanh(middle) * (1.0 / x - 1.0 / np.tanh(x)) - 1.0
        growth = 0.5 * turning * (np.sinh(middle - x) - gradient) / value - 1.0
        change = np.log(target / value) / growth
        x = x * np.exp(np.clip(change, -1.0, 1.0))
        if np.all(np.abs(change) < 1e-13):
            break
    return np.where(taut, SMALLEST_HALF_ANGLE, x)


def half_angle_for_drop(drop: Floats, fraction: Floats, gradient: Floats) -> Floats:
    """Invert :func:`drop_at` for x by bisection of its logarithm."""
    found = np.empty(drop.size)
    fraction, gradient = (np.broadcast_to(each, drop.shape) for each in (fraction, gradient))
    _bisect(drop.flatten(), fraction.flatten(), gradient.flatten(), found)
    return found.reshape(drop.shape)


@compiled
def _bisect(drop: Floats1, fraction: Floats1, gradient: Floats1, found: Floats1) -> None:
    """Write half angles (k,) between 1e-11 and 400, in 60 halvings: to the last bits."""
    for k in range(len(drop)):
        low, high = -25.0, 6.0
        for _ in range(60):
            middle = 0.5 * (low + high)
            if drop_at(np.exp(middle), fraction[k], gradient[k]) < drop[k]:
                low = middle
            else:
                high = middle
        found[k] = np.exp(0.5 * (low + high))


@inner
def drop_at(x: float, fraction: float, gradient: float) -> float:
    """Return the distance below the chord at a fraction of the span, over the span.

    It is the chord's height minus the catenary's. The first term is the drop of a level strand,
    the second vanishes with the gradient and in the middle of the span.
    """
    sinh = np.sinh(x)
    level = np.sinh(x * fraction) * np.sinh(x * (1.0 - fraction)) / x
    if gradient == 0.0:
        return float(level)
    side = 2.0 * fraction - 1.0
    tilt = side - np.sinh(x * side) / sinh
    return float(level * np.hypot(1.0, gradient * x / sinh) + 0.5 * gradient * tilt)
