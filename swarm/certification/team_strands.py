"""Smallest distances of a team's strands, computed only where they can be the smallest; compiled.

Distances are those of :func:`swarm.certification.monitor.pair_distance`. Boxes around the strands
bound them from below; points are sampled for pairs whose bound is below what is asked for.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from swarm.certification.monitor import FAR, RequiredNow, least_between, sampled_distance
from swarm.geometry.catenary_kernel import max_drop_below_ends
from swarm.geometry.distance import point_distance
from swarm.jit import inner
from swarm.signatures import Bools1, Floats1, Floats2, Floats3

Floats = npt.NDArray[np.float64]


class TeamStrands(NamedTuple):
    """Strands of n grip points, and what is known of their distances.

    ``boxes`` (n − 1, 6) contain them (smallest, largest coordinates), ``moved`` (6,) one that has
    moved. ``bound`` and ``distance`` (n − 1, n − 1) are of pairs i < j − 1, NaN where a distance is
    not computed; ``least`` (n − 1,) is the smallest bound of a row. ``points`` (n − 1, k, 3) are of
    the ``sampled`` (n − 1,) strands.
    """

    boxes: Floats2
    moved: Floats1
    bound: Floats2
    distance: Floats2
    least: Floats1
    points: Floats3
    sampled: Bools1


def allocate_strands(points: Floats) -> TeamStrands:
    """Return memory; ``points`` (n − 1, k, 3) is used for the points of strands."""
    count = len(points)
    bound, distance = np.empty((2, count, count))
    sampled = np.empty(count, dtype=np.bool_)
    boxes, least = np.empty((count, 6)), np.empty(count)
    return TeamStrands(boxes, np.empty(6), bound, distance, least, points, sampled)


@inner
def place(grips: Floats, required: RequiredNow, strands: TeamStrands) -> bool:
    """Take the strands between grip points (n, 3); return whether all chords are shorter."""
    count = len(strands.least)
    _forget_points(strands, 0, count)
    for i in range(count):
        if point_distance(grips[i], grips[i + 1]) >= required.lengths[i]:
            return False
        _write_box(grips, i, required, strands.boxes[i])
    for i in range(count):
        strands.least[i] = np.inf
        for j in range(i + 2, count):
            apart = _box_distance(strands.boxes[i], strands.boxes[j])
            strands.distance[i, j] = np.nan
            if apart >= required.near + FAR:
                strands.bound[i, j] = strands.distance[i, j] = apart
            else:
                strands.bound[i, j] = least_between(apart * apart, required.spacing)
            strands.least[i] = min(strands.least[i], strands.bound[i, j])
    return True


@inner
def _forget_points(strands: TeamStrands, first: int, last: int) -> None:
    """Mark that strands have no points yet; in a loop, which takes less to compile than a slice."""
    for i in range(first, last):
        strands.sampled[i] = False


@inner
def nearest(
    grips: Floats, without: int, required: RequiredNow, strands: TeamStrands, below: float
) -> float:
    """Return the smallest distance of placed strands; ``below`` where none is below that.

    Strands that vehicle ``without`` holds do not count (−1: all do).
    """
    for i in range(len(strands.least)):
        if without in (i, i + 1) or strands.least[i] >= below:
            continue
        for j in range(i + 2, len(strands.least)):
            if without in (j, j + 1) or strands.bound[i, j] >= below:
                continue
            if np.isnan(strands.distance[i, j]):
                sampled = strands.points, strands.sampled
                strands.distance[i, j] = sampled_distance(grips, (i, j), required, sampled)
            below = min(below, strands.distance[i, j])
    return below


@inner
def nearest_of(
    grips: Floats, vehicle: int, required: RequiredNow, strands: TeamStrands, below: float
) -> float:
    """Return the smallest distance of a vehicle's strands; ``below`` where none is below that.

    Only this vehicle is elsewhere in ``grips`` (n, 3) than in the placed strands, which stay.
    """
    count = len(strands.least)
    first, last = max(vehicle - 1, 0), min(vehicle + 1, count)
    _forget_points(strands, first, last)
    for i in range(first, last):
        _write_box(grips, i, required, strands.moved)
        for j in range(count):
            if abs(i - j) > 1:
                apart = _box_distance(strands.moved, strands.boxes[j])
                if apart < required.near + FAR:
                    if least_between(apart * apart, required.spacing) >= below:
                        continue
                    pair = min(i, j), max(i, j)
                    sampled = strands.points, strands.sampled
                    apart = sampled_distance(grips, pair, required, sampled)
                below = min(below, apart)
    _forget_points(strands, first, last)
    return below


@inner
def _write_box(grips: Floats, i: int, required: RequiredNow, box: Floats) -> None:
    """Write the axis-aligned box (6,) that contains strand i."""
    for axis in range(3):
        box[axis] = min(grips[i, axis], grips[i + 1, axis])
        box[3 + axis] = max(grips[i, axis], grips[i + 1, axis])
    box[2] -= max_drop_below_ends(grips[i], grips[i + 1], required.lengths[i], 0.0)


@inner
def _box_distance(one: Floats, other: Floats) -> float:
    """Return the distance of two boxes (6,)."""
    square = 0.0
    for axis in range(3):
        gap = max(one[axis] - other[3 + axis], other[axis] - one[3 + axis], 0.0)
        square += gap * gap
    return float(np.sqrt(square))
