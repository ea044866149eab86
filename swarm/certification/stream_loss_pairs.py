"""How near the pairs of a team come after lost setpoints, in one box of a coast; compiled.

A case touches the pairs which its vehicle holds: what all others keep among themselves is as
certified. Of what is left of a clearance in a box, functions return a lower bound, and what is left
in the box's middle.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from swarm.certification.stream_loss_team import Standing
from swarm.geometry import catenary_kernel
from swarm.geometry.distance import polyline_distance
from swarm.geometry.sensitivity import (
    BOTH_ENDS,
    LARGEST_RATIO,
    elevation_class,
    movement_bound,
    ratio_range,
)
from swarm.jit import compiled

Floats = npt.NDArray[np.float64]

TOLERANCE = 0.005
"""Metres by which a clearance may fall short and still count as kept: exactly at a limit nothing
can be told."""
_PIECES = 16


class Kept(NamedTuple):
    """What is to be kept: chords no longer than ``tautest`` (n − 1,), vehicles ``beside`` or
    ``under`` each other, strands (their middles) ``strands`` apart, metres. ``lengths`` (n − 1,)
    are theirs; ``norm`` and ``integral`` are the tables of their sensitivity.
    """

    tautest: Floats
    beside: float
    under: float
    strands: float
    lengths: Floats
    norm: Floats
    integral: Floats


class Sketches(NamedTuple):
    """Points (n − 1, k, 3) of strands between vehicles where they stand, how far (n − 1,) strands
    bow out between these, and which are drawn (n − 1,)."""

    points: Floats
    bow: Floats
    drawn: npt.NDArray[np.bool_]


def sketches_for(strands: int) -> Sketches:
    """Room for so many strands."""
    points = np.empty((strands, _PIECES + 1, 3))
    return Sketches(points, np.empty(strands), np.zeros(strands, dtype=np.bool_))


@compiled
def left_of_pairs(case: int, half: float, standing: Standing, kept: Kept) -> tuple[float, float]:
    """What is left of chords and between vehicles."""
    place, along, loose = standing.place, standing.along, standing.loose
    low = here = np.inf
    for i in range(len(loose)):
        for j in range(i + 1, len(loose)):
            if case not in (0, i + 1, j + 1):
                continue
            x, y = place[j, 0] - place[i, 0], place[j, 1] - place[i, 1]
            z, turn = place[j, 2] - place[i, 2], 0.0
            for axis in range(3):
                turn += (along[j, axis] - along[i, axis]) ** 2
            moved = np.sqrt(turn) * half + loose[i] + loose[j]
            left = max(np.sqrt(x * x + y * y) - kept.beside, abs(z) - kept.under)
            if j == i + 1:
                left = min(left, kept.tautest[i] - np.sqrt(x * x + y * y + z * z))
            low, here = min(low, left - moved), min(here, left)
    return float(low), float(here)


@compiled
def left_of_strands(
    case: int, half: float, standing: Standing, kept: Kept, sketches: Sketches
) -> tuple[float, float]:
    """What is left between strands that share no vehicle."""
    sketches.drawn[:] = False
    count, low, here = len(kept.lengths), np.inf, np.inf
    for i in range(count):
        held = case in (0, i + 1, i + 2)
        for j in range(
            i + 2 if held else max(i + 2, case - 2), count if held else min(case, count)
        ):
            first, second = _moved(i, j, standing.along, standing.loose, half)
            apart = _boxes_apart(standing.place, kept.lengths, i, j, first, second, kept.strands)
            if apart < kept.strands:
                left = _left_of(i, j, (first, second), standing.place, kept, sketches)
                low, here = min(low, left[0]), min(here, left[1])
    return low, here


@compiled
def _left_of(
    i: int, j: int, moved: tuple[float, float], place: Floats, kept: Kept, sketches: Sketches
) -> tuple[float, float]:
    """What is left between two strands whose ends move."""
    off = _off(i, moved[0], place, kept, sketches) + _off(j, moved[1], place, kept, sketches)
    # From above by the points, from below by a spacing less: lines through points that are a
    # spacing apart come nearer by a spacing at most, half of it on each.
    most = _between_points(sketches.points[i], sketches.points[j]) - kept.strands
    least = most - kept.lengths.max() / _PIECES
    if least < off and most >= off - TOLERANCE:
        limit = most + kept.strands
        least = most = (
            polyline_distance(sketches.points[i], sketches.points[j], limit)[0] - kept.strands
        )
    return least - off, most


@compiled
def _off(i: int, moved: float, place: Floats, kept: Kept, sketches: Sketches) -> float:
    """How far a strand and what is between its points can be off when its ends move; draws it."""
    start, end, length = place[i], place[i + 1], kept.lengths[i]
    rise = end[2] - start[2]
    span = np.sqrt((end[0] - start[0]) ** 2 + (end[1] - start[1]) ** 2)
    chord = np.sqrt(span * span + rise * rise)
    if not sketches.drawn[i]:
        sketches.drawn[i] = True
        sketches.bow[i] = _drawn(start, end, max(length, chord / LARGEST_RATIO), sketches.points[i])
    if chord + 2.0 * moved >= LARGEST_RATIO * length:
        return np.inf
    steep = elevation_class(catenary_kernel.max_elevation_sine(rise, span, 2.0 * moved))
    level, upright = movement_bound(
        kept.norm, kept.integral, steep, BOTH_ENDS, 1,
        ratio_range(chord / length, 2.0 * moved / length),
    )  # fmt: skip
    return float(sketches.bow[i] + np.sqrt(level * level + upright * upright) * moved)


@compiled
def _drawn(start: Floats, end: Floats, length: float, points: Floats) -> float:
    """Write a strand's points (k, 3); how far it bows out between these at most."""
    catenary_kernel.sample_strand(start, end, length, points)
    arc, shortest = length / (len(points) - 1), np.inf
    for k in range(len(points) - 1):
        square = 0.0
        for axis in range(3):
            square += (points[k + 1, axis] - points[k, axis]) ** 2
        shortest = min(shortest, square)
    return 0.5 * float(np.sqrt(max(arc * arc - shortest, 0.0)))


@compiled
def _between_points(first: Floats, second: Floats) -> float:
    """Smallest distance of points (k, 3) from others."""
    least = np.inf
    for i in range(len(first)):
        x, y, z = first[i, 0], first[i, 1], first[i, 2]
        for j in range(len(second)):
            square = (second[j, 0] - x) ** 2 + (second[j, 1] - y) ** 2 + (second[j, 2] - z) ** 2
            least = min(least, square)
    return float(np.sqrt(least))


@compiled
def _moved(i: int, j: int, along: Floats, loose: Floats, half: float) -> tuple[float, float]:
    """How far the ends of two strands may move, but for what all four go together."""
    common = (
        0.25 * (along[i, 0] + along[i + 1, 0] + along[j, 0] + along[j + 1, 0]),
        0.25 * (along[i, 1] + along[i + 1, 1] + along[j, 1] + along[j + 1, 1]),
        0.25 * (along[i, 2] + along[i + 1, 2] + along[j, 2] + along[j + 1, 2]),
    )
    return (
        max(_end(i, common, along, loose, half), _end(i + 1, common, along, loose, half)),
        max(_end(j, common, along, loose, half), _end(j + 1, common, along, loose, half)),
    )


@compiled
def _end(
    k: int, common: tuple[float, float, float], along: Floats, loose: Floats, half: float
) -> float:
    """How far one end may move but for what is common."""
    square = 0.0
    for axis in range(3):
        square += (along[k, axis] - common[axis]) ** 2
    return float(np.sqrt(square) * half + loose[k])


@compiled
def _boxes_apart(
    place: Floats, lengths: Floats, i: int, j: int, moved: float, other_moved: float, enough: float
) -> float:
    """Distance that two strands keep because of the upright boxes that they cannot leave.

    Where that is ``enough`` or more, not necessarily how much.
    """
    square = 0.0
    for axis in range(3):
        low = min(place[i, axis], place[i + 1, axis]) - moved
        high = max(place[i, axis], place[i + 1, axis]) + moved
        other_low = min(place[j, axis], place[j + 1, axis]) - other_moved
        other_high = max(place[j, axis], place[j + 1, axis]) + other_moved
        if axis == 2:
            if square >= enough * enough:
                return enough
            low -= _dip(place, lengths, i, moved)
            other_low -= _dip(place, lengths, j, other_moved)
        gap = max(low - other_high, other_low - high, 0.0)
        square += gap * gap
    return float(np.sqrt(square))


@compiled
def _dip(place: Floats, lengths: Floats, i: int, moved: float) -> float:
    """How far a strand can come down below its lower end.

    One that comes down by d is at least as long as two straight lines down to there: length² ≥
    span² + (2d + rise)².
    """
    x, y = place[i + 1, 0] - place[i, 0], place[i + 1, 1] - place[i, 1]
    span = max(np.sqrt(x * x + y * y) - 2.0 * moved, 0.0)
    rise = max(abs(place[i + 1, 2] - place[i, 2]) - 2.0 * moved, 0.0)
    return float(max(0.5 * (np.sqrt(max(lengths[i] ** 2 - span**2, 0.0)) - rise), 0.0))
