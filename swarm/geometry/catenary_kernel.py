"""Hanging strands for looking at them many times a second, one at a time, compiled.

The same catenaries as :mod:`swarm.geometry.catenary` and :mod:`swarm.geometry.floor` have in
batches, for vertical gravity and a floor at z = 0.
"""

import math

import numpy as np
from numpy.typing import NDArray

from swarm.geometry.catenary_shape import solve_half_angle
from swarm.jit import compiled

Floats = NDArray[np.float64]

_VERTICAL = 1e-6
"""Span over length below which a strand counts as hanging straight down and up again."""
_TAUTEST = 1e-6
"""Smallest half angle: its strand sags by a quarter of a millionth of its span."""
_NEARLY_ON_FLOOR = 1e-18
"""Metres of height that stand for none at all."""
_NEWTON, _SETTLED = 60, 1e-9


@compiled
def solve_catenary(
    start: Floats, end: Floats, length: float, taut: float
) -> tuple[float, float, float]:
    """Span, parameter and slope at the start of the catenary between two points (3,).

    The half angle is at least ``taut``. No chord may be longer than its strand.
    """
    east, north, rise = end[0] - start[0], end[1] - start[1], end[2] - start[2]
    square = east * east + north * north
    span = max(math.sqrt(square), _VERTICAL * length)
    excess = max(length * length - square - rise * rise, 0.0)
    x = max(solve_half_angle(0.5 * math.log1p(excess / (span * span))), taut)
    level = math.sqrt(excess + span * span)
    sinh = x * (level / span)
    slope = (rise * math.sqrt(1.0 + sinh * sinh) - length * sinh) / level
    return span, span / (2.0 * x), slope


@compiled
def max_drop_below_ends(start: Floats, end: Floats, length: float) -> float:
    """How far a strand may come down below its lower end, at most.

    One that comes down by d is at least as long as two straight lines down to there:
    length² ≥ span² + (2d + rise)².
    """
    level = length * length - (end[0] - start[0]) ** 2 - (end[1] - start[1]) ** 2
    drop = 0.5 * (math.sqrt(max(level, 0.0)) - float(abs(end[2] - start[2])))
    return max(drop, 0.0)


@compiled
def max_elevation_sine(rise: float, span: float, reach: float) -> float:
    """Sine of the largest elevation that a chord may get, with its ends moving by ``reach``.

    That is relative to each other, in metres as ``rise`` and ``span``; it turns the chord by an
    angle of which the sine is reach / chord at most.
    """
    if reach >= span:
        return 1.0
    square = rise * rise + span * span
    return (abs(rise) * math.sqrt(square - reach * reach) + span * reach) / square


@compiled
def min_elevation_sine(rise: float, span: float, reach: float) -> float:
    """As :func:`max_elevation_sine`, of the smallest elevation; 0 where the chord may get level."""
    square = rise * rise + span * span
    if reach * reach >= rise * rise:
        return 0.0
    return (abs(rise) * math.sqrt(square - reach * reach) - span * reach) / square


@compiled
def sample_strand(start: Floats, end: Floats, length: float, points: Floats) -> None:
    """Fill ``points`` (k, 3) with those of a strand, equally far apart along it."""
    span, parameter, slope = solve_catenary(start, end, length, _TAUTEST)
    first, angle = math.sqrt(1.0 + slope * slope), math.asinh(slope)
    last = len(points) - 1
    for k in range(last + 1):
        here = slope + length / parameter * (k / last)
        along = parameter / span * (math.asinh(here) - angle)
        points[k, 0] = start[0] + along * (end[0] - start[0])
        points[k, 1] = start[1] + along * (end[1] - start[1])
        points[k, 2] = start[2] + parameter * (math.sqrt(1.0 + here * here) - first)


@compiled
def strand_polygon(start: Floats, end: Floats, length: float, points: Floats) -> None:
    """Fill ``points`` (k, 3) with the corners of a polygon that goes along a strand.

    They are equally far apart in plan view. So, steep or level, every edge is as far from the
    strand as every other, where corners that are equally far apart along it cut off the bottom of a
    narrow loop. Corners lie below the strand by as much as edges lie above it.
    """
    span, parameter, slope = solve_catenary(start, end, length, _TAUTEST)
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


@compiled
def end_forces(
    start: Floats, end: Floats, length: float, weight: float, on_start: Floats, on_end: Floats
) -> None:
    """Fill in the forces (3,) of a strand on its ends, newtons; it may rest on the floor.

    ``weight`` is of a metre of it.
    """
    span, parameter, slope = solve_catenary(start, end, length, _VERTICAL)
    end_slope, lowest = slope + length / parameter, start[2]
    if slope < 0.0 < end_slope:
        lowest -= parameter * (math.sqrt(1.0 + slope * slope) - 1.0)
    up, down = parameter * slope, -parameter * end_slope
    if lowest < 0.0:
        first, last = max(start[2], _NEARLY_ON_FLOOR), max(end[2], _NEARLY_ON_FLOOR)
        reach = math.hypot(end[0] - start[0], end[1] - start[1])
        parameter, up, down = _on_floor(first, last, length - reach)
    for k in range(2):
        on_start[k] = weight * parameter / span * (end[k] - start[k])
        on_end[k] = -on_start[k]
    on_start[2], on_end[2] = weight * up, weight * down


@compiled
def _on_floor(first: float, last: float, surplus: float) -> tuple[float, float, float]:
    """Parameter, and lifted lengths downward, of a strand that partly lies on the floor.

    ``first`` and ``last`` are the ends' heights, ``surplus`` is cable over span. From height h a
    branch of parameter a comes down over an arc s = √(h² + 2ah) and a reach a·arcosh(1 + h/a); both
    branches' s − reach are the surplus. Newton in log a against its logarithm; 0 where cable lies
    loose.
    """
    if surplus >= first + last:
        return 0.0, -first, -last
    log_a, target = math.log(first + last), math.log(surplus)
    for _ in range(_NEWTON):
        a = math.exp(log_a)
        less, slope = _branch(first, a)
        other, steeper = _branch(last, a)
        left = less + other
        step = (target - math.log(left)) * left / ((slope + steeper) * a)
        step = min(max(step, -2.0), 2.0)
        log_a += step
        if abs(step) <= _SETTLED:
            break
    a = math.exp(log_a)
    return a, -math.sqrt(first * (first + 2.0 * a)), -math.sqrt(last * (last + 2.0 * a))


@compiled
def _branch(height: float, a: float) -> tuple[float, float]:
    """By how much a branch is longer than its reach, and how fast that grows with a."""
    arc = math.sqrt(height * (height + 2.0 * a))
    angle = 2.0 * math.asinh(math.sqrt(0.5 * height / a))
    slope = 2.0 * height / arc - angle
    if angle >= 1.0:
        return arc - a * angle, slope
    square = angle * angle
    # sinh θ − θ of a small θ by its series, where the difference would cancel
    series = 1.0 + square / 42.0 * (1.0 + square / 72.0 * (1.0 + square / 110.0))
    return a * angle * (square / 6.0) * (1.0 + square / 20.0 * series), slope
