"""The catenary: an inextensible, perfectly flexible cable between two points; also on a floor.

In the plane of ``up`` (against the effective gravity) and ``heading`` (the horizontal direction
from start to end) the strand is ``a·(θ, cosh θ)`` up to a shift, where θ runs over an interval of
length ``2x`` whose middle is ``artanh(rise / length)`` and the half angle ``x`` solves
``sinh(x) / x = √(length² − rise²) / span``. ``sinh θ`` is the slope, ``a·cosh θ`` the tension per
weight of a metre, ``a·sinh θ`` the arc length from the lowest point (Routh, *Statics*, § 443).

All figures come from differences that do not cancel, so that nearly taut and deeply slack strands
are as exact as others. A vertical strand is the limit of a vanishing span, computed at a span of
``1e-80`` lengths.

First the relations without dimensions, of arrays (…,) that broadcast or, compiled, of numbers; then
one strand, compiled; points of many strands at the same fractions of their arcs, which takes a
third of the time of one strand after the other; batches; batches that partly lie on the floor. What
takes two end points of one strand assumes vertical gravity and a floor at z = 0. Metres, z up.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from swarm.errors import SwarmError
from swarm.jit import compiled, inner
from swarm.signatures import Floats1, Floats2, Floats3, contiguous

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
        factor = 1.0 / (1.0 - fading)
        value = x + np.log((0.5 - 0.5 * fading) * inverse) - stretch
        first = (1.0 + fading) * factor - inverse
        second = inverse * inverse - 4.0 * fading * factor * factor
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
    angles = np.empty(drop.size)
    fraction, gradient = (np.broadcast_to(each, drop.shape) for each in (fraction, gradient))
    _bisect(drop.flatten(), fraction.flatten(), gradient.flatten(), angles)
    return angles.reshape(drop.shape)


@compiled
def _bisect(drop: Floats1, fraction: Floats1, gradient: Floats1, angles: Floats1) -> None:
    """Write half angles (k,) between 1e-11 and 400, in 60 halvings: to the last bits."""
    for k in range(len(drop)):
        low, high = -25.0, 6.0
        for _ in range(60):
            middle = 0.5 * (low + high)
            if drop_at(np.exp(middle), fraction[k], gradient[k]) < drop[k]:
                low = middle
            else:
                high = middle
        angles[k] = np.exp(0.5 * (low + high))


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


SMALL_TURN = 1e-2
"""Length over parameter below which a difference of two arsinh loses two digits and more."""
_LEAST_SPAN = 1e-6
"""Smallest span over length of one strand; a smaller one counts as this, which moves an end by a
millionth."""
LEAST_HALF_ANGLE = 1e-6
"""At this half angle a strand sags by a quarter of a millionth of its span."""
_SMALLEST_HEIGHT = 1e-18
"""Metres; replaces a height of 0 over the floor, where a branch's derivative is 0 / 0."""
_SMALLEST_SURPLUS = 1e-30
"""Metres; replaces a surplus that is 0 by rounding, of which the solver takes the logarithm."""
_NEWTON_STEPS = 60
"""Steps of at most 2 in log a: enough for every ratio of parameter to height up to e¹²⁰."""
_CONVERGED = 1e-9
"""A last Newton step of this size leaves an error of about its square, below rounding."""


class Catenary(NamedTuple):
    """A solved strand; metres.

    ``parameter`` is a, the horizontal tension over the weight of a metre; ``slope`` is sinh θ at
    the start, the rise per horizontal metre there; ``span`` and ``rise`` are the horizontal and
    vertical distance from start to end.
    """

    length: float
    parameter: float
    slope: float
    span: float
    rise: float


@inner
def solve(span: float, rise: float, length: float, smallest: float) -> tuple[float, float, float]:
    """Return half angle x, parameter a and start slope of the catenary of a strand.

    ½ log(1 + (length² − chord²) / span²) = log(sinh(x) / x) (Routh, *Statics*, § 443). x is at
    least ``smallest``. ``span`` must be positive; a chord beyond ``length`` counts as ``length``.
    """
    chord = math.sqrt(span * span + rise * rise)
    excess = max(length - chord, 0.0) * (length + chord)
    x = max(solve_half_angle(0.5 * math.log1p(excess / (span * span))), smallest)
    # sinh and cosh of the middle angle are rise and length over the level length of the same x.
    level = math.sqrt(excess + span * span)
    sinh = x * (level / span)
    slope = (rise * math.sqrt(1.0 + sinh * sinh) - length * sinh) / level
    return x, span / (2.0 * x), slope


@inner
def solve_catenary(start: Floats, end: Floats, length: float) -> Catenary:
    """Return the catenary between two points (3,), which are at most ``length`` apart.

    Its half angle is at least LEAST_HALF_ANGLE, its span at least a millionth of its length.
    """
    east, north, rise = end[0] - start[0], end[1] - start[1], end[2] - start[2]
    span = max(math.sqrt(east * east + north * north), _LEAST_SPAN * length)
    _, parameter, slope = solve(span, rise, length, LEAST_HALF_ANGLE)
    return Catenary(length, parameter, slope, span, rise)


@inner
def arc_start(first: float) -> tuple[float, float, float]:
    """Return the slope ``first`` at the start, √(1 + slope²), and arsinh of the slope."""
    cosh = np.sqrt(1.0 + first * first)
    return first, cosh, np.copysign(np.log(abs(first) + cosh), first)


@inner
def offset_from(
    start: tuple[float, float, float], fraction: float, turning: float
) -> tuple[float, float]:
    """Return the angle θ − θ₀ and the height over length gained up to a fraction of the arc.

    ``start`` is :func:`arc_start`, ``turning`` length over parameter. With slopes A at the start
    and B at the point, and C = √(1 + slope²): the height is arc · (A + B)/(C_A + C_B), which does
    not cancel. The angle is arsinh B − arsinh A, or where it is small, from
    tanh(Δθ/2) = (B − A)/(C_A + C_B).
    """
    first, cosh_first, angle_first = start
    turned = fraction * turning
    slope = first + turned
    cosh = np.sqrt(1.0 + slope * slope)
    total = cosh_first + cosh
    if turning < SMALL_TURN:
        angle = small_angle(turned / total)
    else:
        angle = np.copysign(np.log(abs(slope) + cosh), slope) - angle_first
    return angle, fraction * ((slope + first) / total)


@inner
def small_angle(half: float) -> float:
    """Return 2 artanh of a small number, by its series."""
    return half * (2.0 + half * half * (2 / 3 + half * half * (2 / 5)))


@inner
def sample_strand(start: Floats, end: Floats, length: float, points: Floats) -> None:
    """Write points (k, 3) of a strand at equal distances along its arc, both ends included."""
    strand = solve_catenary(start, end, length)
    last = len(points) - 1
    first, turning = arc_start(strand.slope), length / strand.parameter
    for k in range(last + 1):
        angle, height = offset_from(first, k / last, turning)
        along = strand.parameter / strand.span * angle
        points[k, 0] = start[0] + along * (end[0] - start[0])
        points[k, 1] = start[1] + along * (end[1] - start[1])
        points[k, 2] = start[2] + length * height


@inner
def strand_polygon(start: Floats, end: Floats, length: float, points: Floats) -> Catenary:
    """Write corners (k, 3) of a polygon along a strand, at equal distances in plan view.

    So, steep or level, every edge is as far from the strand as every other; corners at equal
    distances along the arc would cut off the bottom of a narrow loop. Corners lie below the strand
    by as much as edges lie above it. Return the catenary.
    """
    strand = solve_catenary(start, end, length)
    span, parameter, slope = strand.span, strand.parameter, strand.slope
    last = len(points) - 1
    # Hyperbolic functions by powers of one exponential: of the angle at the start, and per piece.
    root = math.sqrt(1.0 + slope * slope)
    begun = slope + root if slope > 0.0 else 1.0 / (root - slope)
    half = math.exp(0.25 * span / parameter / last)
    lower = 0.25 * parameter * (half - 1.0 / half) ** 2
    piece, turned = half * half, 1.0
    for k in range(last + 1):
        share, here = k / last, begun * turned
        up = 0.5 * parameter * (turned - 1.0 / turned) * (here - 1.0 / here)
        if 0 < k < last:
            here *= turned
            up -= 0.5 * lower * (here + 1.0 / here)
        points[k, 0] = start[0] + share * (end[0] - start[0])
        points[k, 1] = start[1] + share * (end[1] - start[1])
        points[k, 2] = start[2] + up
        turned *= piece
    return strand


@inner
def max_drop_below_ends(start: Floats, end: Floats, length: float, moved: float) -> float:
    """Return an upper bound of how far a strand is below its lower end.

    Each end moves by up to ``moved`` metres. A strand that reaches d below is at least as long as
    two straight lines to that depth: length² ≥ span² + (2d + rise)².
    """
    x, y = end[0] - start[0], end[1] - start[1]
    span = max(math.sqrt(x * x + y * y) - 2.0 * moved, 0.0)
    rise = max(float(abs(end[2] - start[2])) - 2.0 * moved, 0.0)
    return max(0.5 * (math.sqrt(max(length**2 - span**2, 0.0)) - rise), 0.0)


@inner
def max_depth(chord: float, rise: float, length: float) -> float:
    """Return an upper bound of how far a strand is below its chord, along its gravity.

    Its chord is at least ``chord`` and rises by at most ``rise`` metres. It is at most d below its
    lower end, with length² ≥ span² + (2d + rise)², and its chord at most the rise above that end.
    """
    return 0.5 * (math.sqrt(max(length**2 - chord**2 + rise**2, 0.0)) + rise)


@inner
def max_elevation_sine(rise: float, span: float, reach: float) -> float:
    """Return the sine of the largest elevation of a chord whose ends move by ``reach``, in metres.

    ``reach`` is the movement of one end relative to the other. It turns the chord by an angle
    whose sine is at most reach / chord.
    """
    if reach >= span:
        return 1.0
    square = rise * rise + span * span
    return (abs(rise) * math.sqrt(square - reach * reach) + span * reach) / square


@inner
def min_elevation_sine(rise: float, span: float, reach: float) -> float:
    """Return the sine of the smallest elevation; see :func:`max_elevation_sine`."""
    square = rise * rise + span * span
    if reach * reach >= rise * rise:
        return 0.0
    return (abs(rise) * math.sqrt(square - reach * reach) - span * reach) / square


@inner
def end_forces(
    start: Floats, end: Floats, length: float, weight: float, on_start: Floats, on_end: Floats
) -> None:
    """Write the forces (3,) of a strand on its ends in newtons; it may rest on the floor.

    ``weight`` is the weight of a metre of cable, in newtons.
    """
    strand = solve_catenary(start, end, length)
    span, parameter, slope = strand.span, strand.parameter, strand.slope
    end_slope, lowest = slope + length / parameter, start[2]
    if slope < 0.0 < end_slope:
        lowest -= parameter * (math.sqrt(1.0 + slope * slope) - 1.0)
    up, down = parameter * slope, -parameter * end_slope
    if lowest < 0.0:
        reach = math.hypot(end[0] - start[0], end[1] - start[1])
        parameter, up, down = solve_on_floor(start[2], end[2], length - reach)
        up, down = -up, -down
    for k in range(2):
        on_start[k] = weight * parameter / span * (end[k] - start[k])
        on_end[k] = -on_start[k]
    on_start[2], on_end[2] = weight * up, weight * down


@inner
def solve_on_floor(first: float, last: float, surplus: float) -> tuple[float, float, float]:
    """Return the parameter and the two lifted lengths of a strand that partly lies on the floor.

    ``first`` and ``last`` are the heights of the ends, not negative; ``surplus`` is length − span.
    From height h a branch of parameter a comes down over an arc s = √(h² + 2ah) and a reach
    a·arcosh(1 + h/a); s − reach of both branches add up to the surplus. Newton's method in log a,
    for the logarithm of that sum. The parameter is 0 where surplus cable lies loose.
    """
    if surplus >= first + last:
        return 0.0, first, last
    low, high = max(first, _SMALLEST_HEIGHT), max(last, _SMALLEST_HEIGHT)
    log_a, target = math.log(low + high), math.log(max(surplus, _SMALLEST_SURPLUS))
    for _ in range(_NEWTON_STEPS):
        a = math.exp(log_a)
        at_start, start_rate = _branch_surplus(low, a)
        at_end, end_rate = _branch_surplus(high, a)
        total = at_start + at_end
        step = (target - math.log(total)) * total / ((start_rate + end_rate) * a)
        step = min(max(step, -2.0), 2.0)
        log_a += step
        if abs(step) <= _CONVERGED:
            break
    a = math.exp(log_a)
    return a, math.sqrt(first * (first + 2.0 * a)), math.sqrt(last * (last + 2.0 * a))


@inner
def _branch_surplus(height: float, a: float) -> tuple[float, float]:
    """Return arc − reach of a branch, and its derivative by a."""
    arc = math.sqrt(height * (height + 2.0 * a))
    angle = 2.0 * math.asinh(math.sqrt(0.5 * height / a))
    rate = 2.0 * height / arc - angle
    if angle >= 1.0:
        return arc - a * angle, rate
    # sinh θ − θ of a small θ by its series, where the difference would cancel
    square, series = angle * angle, 1.0
    for k in (16, 14, 12, 10, 8, 6, 4):
        series = 1.0 + square * series / (k * (k + 1))
    return a * angle * (square / 6.0) * series, rate


_TOGETHER = 512
"""Most points that are computed together: what they need fits the fastest cache."""

_ROOT_HALF, _DIGITS = 0x3FE6A09E667F3BCD, 0x000FFFFFFFFFFFFF
"""Bits of √½ as a double, and those of the digits of any double."""

_LOG_2 = math.log(2.0)
"""One more power of two."""


class Arcs(NamedTuple):
    """Length, parameter and start slope (q,) of strands."""

    length: Floats1
    parameter: Floats1
    slope: Floats1


class Vectors(NamedTuple):
    """Starts of strands, and vectors per angle and per height over length, (q, 3)."""

    start: Floats2
    per_angle: Floats2
    per_height: Floats2


class Offsets(NamedTuple):
    """Working memory (m,): angles and heights of points, and what leads to them."""

    angles: Floats1
    heights: Floats1
    slopes: Floats1
    roots: Floats1
    exponents: Floats1


def offsets_memory(fractions: int) -> Offsets:
    """Return memory for strands with so many fractions, which one computation may use at a time."""
    return Offsets(*np.empty((5, max(_TOGETHER, fractions + 1))))


@compiled
def write_points(
    fractions: Floats1, arcs: Arcs, vectors: Vectors, offsets: Offsets, points: Floats3
) -> None:
    """Write points (q, k, 3) of strands (q,) at fractions (k,) of their arcs."""
    row, (angles, heights, _, _, _) = len(fractions) + 1, offsets
    strands = len(angles) // row
    for begin in range(0, len(points), strands):
        end = min(begin + strands, len(points))
        write_offsets(fractions, arcs, (begin, end), offsets)
        for q in range(begin, end):
            first, (start, by_angle, by_height) = (q - begin) * row + 1, vectors_of(vectors, q)
            for k in range(row - 1):
                angle, height = angles[first + k], heights[first + k]
                points[q, k, 0] = start[0] + (angle * by_angle[0] + height * by_height[0])
                points[q, k, 1] = start[1] + (angle * by_angle[1] + height * by_height[1])
                points[q, k, 2] = start[2] + (angle * by_angle[2] + height * by_height[2])


@inner
def vectors_of(
    vectors: Vectors, q: int
) -> tuple[tuple[float, float, float], tuple[float, float, float], tuple[float, float, float]]:
    """Return the vectors of a strand as numbers, which may stay in registers."""
    start, by_angle, by_height = vectors
    return (
        (start[q, 0], start[q, 1], start[q, 2]),
        (by_angle[q, 0], by_angle[q, 1], by_angle[q, 2]),
        (by_height[q, 0], by_height[q, 1], by_height[q, 2]),
    )


@inner
def write_offsets(fractions: Floats, arcs: Arcs, chosen: tuple[int, int], offsets: Offsets) -> None:
    """Write :func:`offset_from` of the chosen strands at the same fractions (k,).

    Angles and heights have rows of k + 1, one after the other; the first of a row is 0.
    Each loop has few arrays: the compiler must be able to tell that they do not overlap.
    """
    begin, row = chosen[0], len(fractions) + 1
    strands = chosen[1] - begin
    size = strands * row
    angles, heights, slopes, roots, _ = offsets
    for q in range(strands):
        first, turning = arcs.slope[begin + q], arcs.length[begin + q] / arcs.parameter[begin + q]
        slopes[q * row] = first
        for k in range(1, row):
            slopes[q * row + k] = first + fractions[k - 1] * turning
    for i in range(size):
        roots[i] = np.sqrt(1.0 + slopes[i] * slopes[i])
    _write_arsinh(offsets, size)
    for q in range(strands):
        begun = angles[q * row]
        for k in range(row):
            angles[q * row + k] -= begun
    for q in range(strands):
        first, root = slopes[q * row], roots[q * row]
        for k in range(1, row):
            mean = (slopes[q * row + k] + first) / (roots[q * row + k] + root)
            heights[q * row + k] = fractions[k - 1] * mean
    for q in range(strands):
        turning = arcs.length[begin + q] / arcs.parameter[begin + q]
        if turning < SMALL_TURN:
            for k in range(1, row):
                half = fractions[k - 1] * turning / (roots[q * row + k] + roots[q * row])
                angles[q * row + k] = small_angle(half)


@inner
def _write_arsinh(offsets: Offsets, size: int) -> None:
    """Write arsinh of the first slopes, with √(1 + slope²) for each, as angles.

    The logarithm of a number m·2ᵉ is e·log 2 + 2 artanh((m − 1) / (m + 1)), the latter by its
    series: with m between √½ and √2, eleven terms leave an error below rounding.
    """
    angles, _, slopes, roots, exponents = offsets
    bits = angles.view(np.int64)
    for i in range(size):
        angles[i] = abs(slopes[i]) + roots[i]
    for i in range(size):
        above = bits[i] - _ROOT_HALF
        exponents[i] = float(above >> 52)
        bits[i] = (above & _DIGITS) + _ROOT_HALF
    for i in range(size):
        part = (angles[i] - 1.0) / (angles[i] + 1.0)
        square = part * part
        series = 1.0 / 21.0
        for power in (19, 17, 15, 13, 11, 9, 7, 5, 3, 1):
            series = 1.0 / power + square * series
        angles[i] = np.copysign(exponents[i] * _LOG_2 + 2.0 * part * series, slopes[i])


STANDARD_GRAVITY = 9.80665
"""m/s², the standard acceleration of gravity (3rd CGPM, 1901)."""

MAX_CHORD_RATIO = 0.985
"""Largest chord over length of a segment in the air. Nearer to taut, errors of the ends grow: the
sag changes by 1.7 m per metre of an end at a ratio of 0.97, and by 9.7 m at 0.999."""

_ROUNDING = 1e-12
"""A chord may exceed the length by this share: coordinates of 1 km are rounded by 1e-13 m."""


class OverStretched(SwarmError):  # noqa: N818 - names the state of the cable
    """A chord is longer than its cable, which does not stretch; lists every such segment.

    ``segments`` are the indices in the batch (one tuple each), ``chords`` and ``lengths`` metres.
    """

    def __init__(self, segments: list[tuple[int, ...]], chords: Floats, lengths: Floats) -> None:
        self.segments, self.chords, self.lengths = segments, chords, lengths
        shown = [
            f"segment {', '.join(map(str, segment)) or '0'}: "
            f"its ends are {chord:.6g} m apart, its cable is {length:.6g} m"
            for segment, chord, length in zip(segments[:10], chords, lengths, strict=False)
        ]
        if len(segments) > 10:
            shown.append(f"and {len(segments) - 10} more")
        super().__init__("over-stretched cable: " + "; ".join(shown))

    def __reduce__(self) -> tuple[type, tuple[object, ...]]:
        """Keep the arguments when the error crosses processes."""
        return type(self), (self.segments, self.chords, self.lengths)


@dataclass(frozen=True, eq=False)
class Catenaries:
    """A batch of hanging strands, solved by :func:`solve_catenaries`.

    Vectors are (…, 3), scalars (…,), metres. Horizontal and vertical mean across and along
    ``down``, which is vertical only in still air and without acceleration.
    """

    start: Floats
    end: Floats
    length: Floats
    down: Floats
    """Unit vector of the effective gravity."""
    heading: Floats
    """Unit vector, horizontal, from start to end; zero where one is straight above the other."""
    span: Floats
    """Horizontal distance of the ends."""
    rise: Floats
    """Height of the end above the start."""
    half_angle: Floats
    """x = span / 2a: 0 where taut; at 1 the sag is a quarter of the span; large where slack."""
    parameter: Floats
    """a, metres: horizontal tension over the weight of a metre; very large where taut."""
    slope: Floats
    """sinh θ at the start: rise per horizontal metre there (negative: downward)."""

    def points(self, fractions: ArrayLike) -> Floats:
        """Return points (…, k, 3) at given fractions (k,) of the arc length of every strand."""
        fractions = _floats(fractions)
        points = np.empty((self.span.size, fractions.size, 3))
        memory = offsets_memory(fractions.size)
        write_points(_flat(fractions), *self._for_kernels(), memory, points)
        return points.reshape(*self.span.shape, fractions.size, 3)

    def _for_kernels(self) -> "tuple[Arcs, Vectors]":
        return (
            Arcs(_flat(self.length), _flat(self.parameter), _flat(self.slope)),
            Vectors(_flat(self.start, 3), _flat(self._per_angle, 3), _flat(self._per_height, 3)),
        )

    def points_at(self, fraction: ArrayLike) -> Floats:
        """Return one point per strand, at its own fraction (…,) of its arc length: (…, 3)."""
        shape = _common_shape(np.shape(fraction), self.span.shape)
        figures: tuple[Floats, ...]
        figures = (_floats(fraction), self.length, self.parameter, self.slope)
        if any(figure.shape != shape for figure in figures):
            figures = tuple(np.broadcast_to(figure, shape) for figure in figures)
        at, length, parameter, slope = (_flat(figure) for figure in figures)
        angle, height = np.empty((2, len(at)))
        _write_offsets(at, Arcs(length, parameter, slope), angle, height)
        angle, height = angle.reshape(*shape, 1), height.reshape(*shape, 1)
        point: Floats = self.start + angle * self._per_angle + height * self._per_height
        return point

    def at_span(self, fraction: ArrayLike) -> Floats:
        """Return the point of each strand at a fraction (…,) of its horizontal span: (…, 3).

        Heights at a crossing of the plan view are found so. A vertical strand has no unique such
        point; one of its points is returned.
        """
        fraction = _floats(fraction)
        turned = self.half_angle * fraction
        start_angle = np.arcsinh(self.slope)
        up = 2.0 * self.parameter * np.sinh(turned) * np.sinh(start_angle + turned)
        along = self.span * fraction
        return self.start + along[..., None] * self.heading - up[..., None] * self.down

    @cached_property
    def lowest_fraction(self) -> Floats:
        """Fraction (…,) of the arc length at which each strand is lowest."""
        fraction: Floats = np.clip(-self.slope * (self.parameter / self.length), 0.0, 1.0)
        return fraction

    def lowest(self) -> Floats:
        """Return the lowest point (…, 3) of each strand; an end where the strand is monotone."""
        return self.points_at(self.lowest_fraction)

    def sag(self) -> Floats:
        """Return the largest distance (…,) of each strand below its chord, along ``down``."""
        return self._span * sag_per_span(self.half_angle, self.rise / self._span)

    def tension(
        self, mass_per_length: ArrayLike, gravity: ArrayLike = STANDARD_GRAVITY
    ) -> tuple[Floats, Floats, Floats]:
        """Return tensions (…,) in newtons: the horizontal part, at the start, and at the end.

        ``mass_per_length`` in kg/m; ``gravity`` is the size of the effective gravity, m/s².
        Tensions of a strand that is taut to the last digit are very large and finite.
        """
        weight = _floats(mass_per_length) * _floats(gravity)
        horizontal = weight * self.parameter
        return (
            horizontal,
            horizontal * np.hypot(1.0, self.slope),
            horizontal * np.hypot(1.0, self._end_slope),
        )

    def end_forces(
        self, mass_per_length: ArrayLike, gravity: ArrayLike = STANDARD_GRAVITY
    ) -> tuple[Floats, Floats]:
        """Return the forces (…, 3) of each strand on the holders of its start and end; newtons.

        Their sum is the weight of the strand. Arguments as for :meth:`tension`.
        """
        weight = _floats(mass_per_length) * _floats(gravity)
        horizontal = (weight * self.parameter)[..., None]
        at_start = horizontal * (self.heading - self.slope[..., None] * self.down)
        at_end = -horizontal * (self.heading - self._end_slope[..., None] * self.down)
        return at_start, at_end

    @property
    def _end_slope(self) -> Floats:
        return self.slope + self.length / self.parameter

    @property
    def _per_angle(self) -> Floats:
        return self.parameter[..., None] * self.heading

    @property
    def _per_height(self) -> Floats:
        return -self.length[..., None] * self.down

    @property
    def _span(self) -> Floats:
        return np.maximum(self.span, VERTICAL * self.length)


def solve_catenaries(
    start: ArrayLike, end: ArrayLike, length: ArrayLike, *, down: ArrayLike = (0.0, 0.0, -1.0)
) -> Catenaries:
    """Return the catenaries of cables of given lengths between given ends.

    ``start``, ``end`` and ``down`` are (…, 3), ``length`` is (…,), metres; they broadcast. ``down``
    is the direction (of any size) of the effective gravity: tilt it for steady wind drag or for a
    constant acceleration.

    Raises :class:`OverStretched` where a chord is longer than its cable.
    """
    start, end, length, down = _floats(start), _floats(end), _floats(length), _floats(down)
    shape = _common_shape(start.shape[:-1], end.shape[:-1], length.shape, down.shape[:-1])
    if not start.shape[:-1] == end.shape[:-1] == length.shape == shape:
        start = np.broadcast_to(start, (*shape, 3))
        end = np.broadcast_to(end, (*shape, 3))
        length = np.broadcast_to(length, shape)
    down = np.broadcast_to(down / np.linalg.norm(down, axis=-1, keepdims=True), (*shape, 3))

    across = end - start
    rise = -_dot(across, down)
    for axis in range(3):
        across[..., axis] += rise * down[..., axis]
    span = np.sqrt(_dot(across, across))
    chord = np.sqrt(span * span + rise * rise)
    _require_reach(chord, length)

    wide = np.maximum(span, VERTICAL * length)
    solved = np.empty((3, span.size))
    _solve_all(_flat(wide), _flat(rise), _flat(length), solved)
    half_angle, parameter, slope = solved.reshape(3, *shape)
    across /= wide[..., None]
    return Catenaries(
        start=start,
        end=end,
        length=length,
        down=down,
        heading=across,
        span=span,
        rise=rise,
        half_angle=half_angle,
        parameter=parameter,
        slope=slope,
    )


def sag_for_length(span: ArrayLike, length: ArrayLike, rise: ArrayLike = 0.0) -> Floats:
    """Return the sag (…,) below the chord of strands of given lengths; metres.

    ``span`` is the horizontal and ``rise`` the vertical distance of its ends. Raises
    :class:`OverStretched`.
    """
    end = np.stack(np.broadcast_arrays(_floats(span), 0.0, _floats(rise)), axis=-1)
    return solve_catenaries(np.zeros(3), end, length).sag()


def length_for_sag(span: ArrayLike, sag: ArrayLike, rise: ArrayLike = 0.0) -> Floats:
    """Return the length (…,) of the strand that sags by ``sag`` below its chord; metres.

    At level ends this is ℓ = 2a·sinh(s/a) = 2√((h + a)² − a²) with h/a = cosh(s/a) − 1, s half the
    span and h the sag (paper eq. 2; its printed length √(s² − a²) is a misprint). ``span`` must be
    positive and ``sag`` not negative.
    """
    span, sag, rise = np.broadcast_arrays(_floats(span), _floats(sag), _floats(rise))
    if not (np.all(span > 0.0) and np.all(sag >= 0.0)):
        raise ValueError("a span must be positive, a sag not negative")
    gradient = rise / span
    x = half_angle_for_sag(sag / span, gradient)
    length: Floats = np.hypot(rise, span * np.exp(log_sinhc(x)))
    return length


def sag_for_drop(
    span: ArrayLike, drop: ArrayLike, fraction: ArrayLike, rise: ArrayLike = 0.0
) -> Floats:
    """Return the sag (…,) of the strand that is ``drop`` below its chord at a fraction of its span.

    ``fraction`` lies strictly between 0 and 1; ``drop`` is positive; metres. A longer cable is
    lower everywhere, so the strand is unique.
    """
    span, drop, fraction, rise = np.broadcast_arrays(
        _floats(span), _floats(drop), _floats(fraction), _floats(rise)
    )
    if not (np.all(span > 0.0) and np.all(drop > 0.0) and np.all((fraction > 0) & (fraction < 1))):
        raise ValueError("a span and a drop must be positive, a fraction between 0 and 1")
    gradient = rise / span
    return span * sag_per_span(half_angle_for_drop(drop / span, fraction, gradient), gradient)


def _require_reach(chord: Floats, length: Floats) -> None:
    if not (np.all(length > 0.0) and np.all(np.isfinite(length)) and np.all(np.isfinite(chord))):
        raise ValueError("cable lengths must be positive, and the ends finite")
    over = chord > length * (1.0 + _ROUNDING)
    if np.any(over):
        segments = [tuple(int(i) for i in index) for index in np.argwhere(over)]
        raise OverStretched(segments, chord[over], length[over])


@compiled
def _solve_all(span: Floats1, rise: Floats1, length: Floats1, solved: Floats2) -> None:
    """Write half angles, parameters and start slopes (3, q)."""
    for q in range(len(span)):
        solved[0, q], solved[1, q], solved[2, q] = solve(
            span[q], rise[q], length[q], SMALLEST_HALF_ANGLE
        )


@compiled
def _write_offsets(fraction: Floats1, arcs: Arcs, angle: Floats1, height: Floats1) -> None:
    """Write :func:`offset_from` of strands (q,) at a fraction (q,) of each."""
    for q in range(len(arcs.length)):
        turning = arcs.length[q] / arcs.parameter[q]
        angle[q], height[q] = offset_from(arc_start(arcs.slope[q]), fraction[q], turning)


def _flat(array: Floats, *last: int) -> Floats:
    """Return the array as a row of numbers or vectors, contiguous and writable for the kernels."""
    return contiguous(array.reshape(-1, *last))


def _common_shape(first: tuple[int, ...], *others: tuple[int, ...]) -> tuple[int, ...]:
    """Return the shape to which arrays broadcast; most have the same one, or none."""
    if all(shape in (first, ()) for shape in others):
        return first
    return np.broadcast_shapes(first, *others)


def _floats(value: ArrayLike) -> Floats:
    return np.asarray(value, dtype=np.float64)


def _dot(a: Floats, b: Floats) -> Floats:
    product: Floats = np.einsum("...i,...i->...", a, b)
    return product


_NEGLIGIBLE = 1e-12
"""Share of the length below which a height or a length on the floor counts as 0: rounding."""

_BELOW_FLOOR = 1e-9
"""Metres by which an end may be below the floor: rounding of coordinates."""


@dataclass(frozen=True, eq=False)
class FloorStrands:
    """A batch of strands, in the air or partly on the floor; from :func:`rest_on_floor`.

    Where its catenary would pass below the floor, a strand comes down as part of a catenary that
    meets the floor tangentially, lies straight, and rises again as part of a catenary with the same
    horizontal tension (no friction, quasi-static). With surplus cable the horizontal tension
    vanishes: both ends hang straight down and the surplus lies loose on the floor.

    Vectors are (…, 3), scalars (…,), metres, z up. Fields other than ``free`` hold where
    ``touching``; elsewhere the strand is the catenary ``free``.
    """

    free: Catenaries
    """The catenaries without a floor."""
    floor: Floats
    touching: NDArray[np.bool_]
    """Whether some of the strand lies on the floor."""
    parameter: Floats
    """a, metres: horizontal tension over the weight of a metre; 0 where cable lies loose."""
    lifted_start: Floats
    """Arc length from the start to the point where the strand touches the floor."""
    lifted_end: Floats

    @property
    def lying(self) -> Floats:
        """Arc length (…,) on the floor, with the loose cable; 0 where nothing touches the floor."""
        return np.where(self.touching, self.free.length - self.lifted_start - self.lifted_end, 0.0)

    def points(self, fractions: ArrayLike) -> Floats:
        """Return points at the given fractions (k,) of the arc length of every strand: (…, k, 3).

        Loose cable is drawn evenly along the straight line on the floor.
        """
        fractions = _floats(fractions)
        arc = fractions * self.free.length[..., None]
        first, last = self.lifted_start[..., None], self.lifted_end[..., None]
        from_end = self.free.length[..., None] - arc
        a = self.parameter[..., None]
        down_start, up_start = _branch(a, np.maximum(first - arc, 0.0))
        down_end, up_end = _branch(a, np.maximum(last - from_end, 0.0))
        reach_start, reach_end = _branch(a, first)[0], _branch(a, last)[0]
        lying = np.maximum(self.lying, _NEGLIGIBLE * self.free.length)[..., None]
        run = np.clip((arc - first) / lying, 0.0, 1.0)
        flat = self.free.span[..., None] - reach_start - reach_end
        along = reach_start - down_start + run * flat + down_end
        height = self.floor[..., None] + up_start + up_end
        plan = self.free.start[..., None, :2] + along[..., None] * self.free.heading[..., None, :2]
        resting = np.concatenate([plan, height[..., None]], axis=-1)
        return np.where(self.touching[..., None, None], resting, self.free.points(fractions))

    def end_forces(
        self, mass_per_length: ArrayLike, gravity: ArrayLike = STANDARD_GRAVITY
    ) -> tuple[Floats, Floats]:
        """Return the forces (…, 3) of each strand on the holders of its start and end; newtons.

        Their sum is the weight of the cable off the floor.
        """
        weight = _floats(mass_per_length) * _floats(gravity)
        heading, down = self.free.heading, self.free.down
        pull = (weight * self.parameter)[..., None] * heading
        at_start = pull + (weight * self.lifted_start)[..., None] * down
        at_end = -pull + (weight * self.lifted_end)[..., None] * down
        free_start, free_end = self.free.end_forces(mass_per_length, gravity)
        touching = self.touching[..., None]
        return np.where(touching, at_start, free_start), np.where(touching, at_end, free_end)


def rest_on_floor(
    start: ArrayLike, end: ArrayLike, length: ArrayLike, floor: ArrayLike = 0.0
) -> FloorStrands:
    """Return the strands of cables between ends above a level floor, on which cable may lie.

    ``start`` and ``end`` are (…, 3), z up, ``length`` and ``floor`` (the floor's z) are (…,); they
    broadcast; metres. Ends may be on the floor, not below it.

    Raises :class:`OverStretched`, and :class:`ValueError` for ends below
    the floor.
    """
    free = solve_catenaries(start, end, length)
    floor = np.broadcast_to(_floats(floor), free.length.shape)
    low, high = _heights(free, floor)
    touching = free.lowest()[..., 2] < floor - _NEGLIGIBLE * free.length
    surplus = free.length - free.span
    solved = np.zeros((3, touching.sum()))
    _solve_all_on_floor(low[touching], high[touching], surplus[touching], solved)
    resting = np.zeros((3, *touching.shape))
    resting[:, touching] = solved
    parameter, lifted_start, lifted_end = resting
    return FloorStrands(
        free=free,
        floor=floor,
        touching=touching,
        parameter=parameter,
        lifted_start=lifted_start,
        lifted_end=lifted_end,
    )


@compiled
def _solve_all_on_floor(first: Floats1, last: Floats1, surplus: Floats1, solved: Floats2) -> None:
    """Write parameters and the two lifted lengths (3, q) of strands that reach the floor."""
    for q in range(len(first)):
        solved[0, q], solved[1, q], solved[2, q] = solve_on_floor(first[q], last[q], surplus[q])


def _heights(free: Catenaries, floor: Floats) -> tuple[Floats, Floats]:
    """Return the heights of both ends above the floor; negligible ones are 0."""
    low, high = free.start[..., 2] - floor, free.end[..., 2] - floor
    if np.any(np.minimum(low, high) < -_BELOW_FLOOR):
        raise ValueError("an end of a strand is below the floor")
    negligible = _NEGLIGIBLE * free.length
    return np.where(low > negligible, low, 0.0), np.where(high > negligible, high, 0.0)


def _branch(a: Floats, arc: Floats) -> tuple[Floats, Floats]:
    """Return how far and how high a point is from the touching point, at an arc length from it."""
    safe = np.where(a > 0.0, a, 1.0)
    across = np.where(a > 0.0, safe * np.arcsinh(arc / safe), 0.0)
    total = np.hypot(arc, a) + a
    up = np.where(total > 0.0, arc / np.where(total > 0.0, total, 1.0) * arc, 0.0)
    return across, up
