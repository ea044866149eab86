"""The catenary of one strand, compiled: solved, sampled, and partly on the floor.

:mod:`swarm.geometry.catenary` applies these kernels to batches.
Functions that take two end points assume vertical gravity and a floor at z = 0. Metres, z up.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from swarm.geometry.catenary_shape import solve_half_angle
from swarm.jit import inner

Floats = NDArray[np.float64]

SMALL_TURN = 1e-2
"""Length over parameter below which a difference of two arsinh loses two digits and more."""
_VERTICAL = 1e-6
"""Smallest span over length; a smaller one counts as this, which moves an end by a millionth."""
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
def solve_catenary(start: Floats, end: Floats, length: float, smallest: float) -> Catenary:
    """Return the catenary between two points (3,), which are at most ``length`` apart.

    Its half angle is at least ``smallest``, its span at least a millionth of its length.
    """
    east, north, rise = end[0] - start[0], end[1] - start[1], end[2] - start[2]
    span = max(math.sqrt(east * east + north * north), _VERTICAL * length)
    _, parameter, slope = solve(span, rise, length, smallest)
    return Catenary(length, parameter, slope, span, rise)


@inner
def arc_offset(
    fraction: float, length: float, parameter: float, first: float
) -> tuple[float, float]:
    """Return the angle θ − θ₀ and the height over length gained up to a fraction of the arc.

    ``first`` is the slope at the start.
    """
    return offset_from(arc_start(first), fraction, length / parameter)


@inner
def arc_start(first: float) -> tuple[float, float, float]:
    """Return the slope ``first`` at the start, √(1 + slope²), and arsinh of the slope."""
    cosh = np.sqrt(1.0 + first * first)
    return first, cosh, np.copysign(np.log(abs(first) + cosh), first)


@inner
def offset_from(
    start: tuple[float, float, float], fraction: float, turning: float
) -> tuple[float, float]:
    """Return :func:`arc_offset` from :func:`arc_start`; ``turning`` is length over parameter.

    With slopes A at the start and B at the point, and C = √(1 + slope²): the height is
    arc · (A + B)/(C_A + C_B), which does not cancel. The angle is arsinh B − arsinh A, or where it
    is small, from tanh(Δθ/2) = (B − A)/(C_A + C_B).
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
    strand = solve_catenary(start, end, length, LEAST_HALF_ANGLE)
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
    strand = solve_catenary(start, end, length, LEAST_HALF_ANGLE)
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
    strand = solve_catenary(start, end, length, _VERTICAL)
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
        one, one_rate = _branch_surplus(low, a)
        other, other_rate = _branch_surplus(high, a)
        total = one + other
        step = (target - math.log(total)) * total / ((one_rate + other_rate) * a)
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
