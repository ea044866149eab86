"""Points of many catenaries at the same fractions of their arcs, compiled for vectors of numbers.

One strand after the other, as :mod:`.catenary_kernel` computes them, takes three times as long.
"""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from swarm.geometry.catenary_kernel import SMALL_TURN, small_angle
from swarm.jit import compiled, inner
from swarm.signatures import Floats1, Floats2, Floats3

Floats = npt.NDArray[np.float64]

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
    """Write :func:`.catenary_kernel.arc_offset` of the chosen strands at the same fractions (k,).

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
    found, _, slopes, roots, exponents = offsets
    bits = found.view(np.int64)
    for i in range(size):
        found[i] = abs(slopes[i]) + roots[i]
    for i in range(size):
        above = bits[i] - _ROOT_HALF
        exponents[i] = float(above >> 52)
        bits[i] = (above & _DIGITS) + _ROOT_HALF
    for i in range(size):
        part = (found[i] - 1.0) / (found[i] + 1.0)
        square = part * part
        series = 1.0 / 21.0
        for power in (19, 17, 15, 13, 11, 9, 7, 5, 3, 1):
            series = 1.0 / power + square * series
        found[i] = np.copysign(exponents[i] * _LOG_2 + 2.0 * part * series, slopes[i])
