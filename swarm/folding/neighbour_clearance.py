"""Missed margins between strands that meet at a vehicle; compiled.

As in :mod:`swarm.folding.strand_clearance`, functions add to a penalty. The *free part* of a strand
is the part beyond the exempt length at the shared grip; it is compared with all of the other one.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from swarm.folding.end_sensitivity import (
    PIECES,
    add_to_ends,
    far_end_movement,
    max_far_end_movement,
    max_point_movement,
    sag_response,
)
from swarm.folding.margins import Margins, Penalty
from swarm.folding.outlines import Outlines, direction_between, point_at
from swarm.folding.strand_clearance import PREFERRED
from swarm.geometry.distance import point_distance, polyline_distance_sized
from swarm.jit import compiled
from swarm.signatures import Floats1, Floats2, Floats4

Floats = npt.NDArray[np.float64]

_LEAST_FREE = 0.5
"""Smallest free part of a strand, as a share of its length, however long the exempt length is."""

_OBTUSE_CABLE, _OBTUSE_TRACKING = 1.3, 2.6
"""Multiples of the cable margin and of the tracking error: at an obtuse angle, free parts that
begin at this horizontal distance from the grip have the preferred margin and 2.1 tracking errors
more."""


class MarginCache(NamedTuple):
    """Spare margins of neighbouring strands, computed at earlier positions.

    ``spare`` (s, n − 2) are metres beyond the preferred margin, negative where unknown, and
    ``positions`` (s, n − 2, 3, 3) those of the three vehicles at that time.
    """

    spare: Floats2
    positions: Floats4


def empty_margin_cache(moments: int, segments: int) -> MarginCache:
    """Return a cache without entries for a number of moments."""
    pairs = max(segments - 1, 0)
    return MarginCache(np.full((moments, pairs), -1.0), np.zeros((moments, pairs, 3, 3)))


class _Team(NamedTuple):
    """Outlines (n − 1, k, 3), chord ratios and lengths (n − 1,) of a team at one moment."""

    points: Floats
    ratio: Floats
    lengths: Floats


class _Junction(NamedTuple):
    """Two strands that meet at a vehicle: segments ``first`` and ``first + 1``.

    ``sizes`` (2, PIECES) are the lengths of their edges. Their preferred distance is ``wanted``;
    beyond ``reach`` no margin is missed. In plan view, a point of one is at least ``sine`` times as
    far from the other as from the vehicle. ``part`` (PIECES + 1, 3) is a buffer.
    """

    first: int
    sizes: Floats
    wanted: float
    reach: float
    sine: float
    part: Floats


@compiled
def penalize_neighbours(
    strands: Outlines,
    lengths: Floats1,
    extra: Floats1,
    margins: Margins,
    cache: MarginCache,
    penalty: Penalty,
) -> None:
    """Add the missed margins of strands that meet at a vehicle; ``extra`` (s,) as elsewhere.

    Pairs with a spare margin in the cache are skipped; others are written to it. The cache is valid
    as long as nothing but positions changes.
    """
    points, ratio = strands.points, strands.ratio
    free = np.maximum(_LEAST_FREE, 1.0 - margins.exempt / lengths)
    unit = margins.cable + 2.0 * margins.tracking
    enough = _OBTUSE_CABLE * margins.cable + _OBTUSE_TRACKING * margins.tracking
    part, sizes = np.empty((PIECES + 1, 3)), np.empty((2, PIECES))
    for s in range(len(points)):
        wanted = margins.cable + PREFERRED * unit + extra[s]
        team = _Team(points[s], ratio[s], lengths)
        moment = Penalty(penalty.missed[s : s + 1], penalty.gradient[s : s + 1])
        for i in range(len(lengths) - 1):
            before, after = points[s, i], points[s, i + 1]
            if _is_cached(
                before, after, ratio[s, i], ratio[s, i + 1], cache.spare[s, i],
                cache.positions[s, i],
            ):  # fmt: skip
                continue
            for k in range(PIECES):
                sizes[0, k] = point_distance(before[k], before[k + 1])
                sizes[1, k] = point_distance(after[k], after[k + 1])
            error = max_far_end_movement(ratio[s, i]) + max_far_end_movement(ratio[s, i + 1])
            reach = wanted + margins.tracking * error
            sine = _least_sine(before, after)
            ends = _place_at(sizes[0], free[i])
            begins = _place_at(sizes[1], 1.0 - free[i + 1])
            level = _level_distance(before, ends, after[0])
            level_after = _level_distance(after, begins, after[0])
            if sine == 1.0 and extra[s] == 0.0 and min(level, level_after) > enough:
                cache.spare[s, i] = min(level, level_after) - enough
                continue
            junction = _Junction(i, sizes, wanted, reach, sine, part)
            spare = np.inf
            for own, limit, near in ((i, ends, level), (i + 1, begins, level_after)):
                left = near * sine - reach
                if left < 0.0:
                    left = _penalize_free_part(team, junction, own, limit, margins, moment)
                spare = min(spare, left)
            cache.spare[s, i] = spare


@compiled
def _is_cached(
    before: Floats,
    after: Floats,
    ratio: float,
    ratio_after: float,
    spare: float,
    positions: Floats,
) -> bool:
    """Return whether movement since then cannot have used up a spare margin.

    Otherwise, write the positions of the three vehicles.
    """
    ends = (before[0], after[0], after[-1])
    if spare > 0.0:
        farthest = 0.0
        for k in range(3):
            farthest = max(farthest, point_distance(ends[k], positions[k]))
        movement = max_point_movement(sag_response(ratio))
        movement += max_point_movement(sag_response(ratio_after))
        if spare > movement * farthest:
            return True
    for k in range(3):
        for axis in range(3):
            positions[k, axis] = ends[k][axis]
    return False


@compiled
def _least_sine(before: Floats, after: Floats) -> float:
    """Return the sine of the angle between two strands in plan view, or 1 where it is not acute.

    It is the smallest distance of a point of one from the other, over its distance from their
    vehicle: a strand lies in a vertical plane and its distance from the vehicle only grows.
    """
    back_x, back_y = before[0, 0] - after[0, 0], before[0, 1] - after[0, 1]
    ahead_x, ahead_y = after[-1, 0] - after[0, 0], after[-1, 1] - after[0, 1]
    if back_x * ahead_x + back_y * ahead_y <= 0.0:
        return 1.0
    sizes = np.sqrt((back_x**2 + back_y**2) * (ahead_x**2 + ahead_y**2))
    return float(abs(back_x * ahead_y - back_y * ahead_x) / sizes)


@compiled
def _level_distance(points: Floats, place: float, at: Floats) -> float:
    """Return the distance in plan view from a place on an outline to a point."""
    piece = min(int(place), len(points) - 2)
    share = place - piece
    x = (1.0 - share) * points[piece, 0] + share * points[piece + 1, 0] - at[0]
    y = (1.0 - share) * points[piece, 1] + share * points[piece + 1, 1] - at[1]
    return float(np.sqrt(x * x + y * y))


@compiled
def _penalize_free_part(
    team: _Team, junction: _Junction, own: int, limit: float, margins: Margins, moment: Penalty
) -> float:
    """Add the missed margin of the free part of strand ``own``, which ends at place ``limit``.

    ``moment`` is the penalty of one moment. Return the metres that remain of the preferred margin.
    """
    sizes, part, reach = junction.sizes, junction.part, junction.reach
    neighbour = 2 * junction.first + 1 - own
    points, other, outward = team.points[own], team.points[neighbour], own > neighbour
    own_sizes, other_sizes = sizes[own - junction.first], sizes[neighbour - junction.first]
    low, high = _close_points(points, reach, junction.sine, outward)
    begin, end = _close_points(other, reach, junction.sine, not outward)
    if outward:
        low = min(int(limit), PIECES - 1)
    else:
        high = min(int(limit), PIECES - 1) + 2
    for k in range(low, high):
        point_at(points, _in_free_part(float(k), limit, not outward), part[k])
    distance, here, there = polyline_distance_sized(
        part[low:high], other[begin:end], other_sizes[begin : end - 1], reach
    )
    if distance >= reach:
        return 0.0
    here, there = here + low, there + begin
    push = np.empty(3)
    upright = direction_between(part, here, other, there, distance, push)
    piece = min(int(here), PIECES - 1)
    from_place = _in_free_part(float(piece), limit, not outward)
    to_place = _in_free_part(piece + 1.0, limit, not outward)
    here = from_place + (here - piece) * (to_place - from_place)
    at_end = 0.0 if outward else 1.0
    tracking, ratio, lengths = margins.tracking, team.ratio, team.lengths
    error = far_end_movement(
        points, ratio[own], ratio[own] * lengths[own],
        abs(_share_before(own_sizes, here) - at_end), upright, tracking,
    )  # fmt: skip
    error += far_end_movement(
        other, ratio[neighbour], ratio[neighbour] * lengths[neighbour],
        abs(_share_before(other_sizes, there) - 1.0 + at_end), upright, tracking,
    )  # fmt: skip
    left = distance - junction.wanted - tracking * error
    if left < 0.0:
        short = -left / (margins.cable + 2.0 * tracking)
        moment.missed[0] += short * short
        push *= -short / (margins.cable + 2.0 * tracking)
        gradient = moment.gradient[0]
        add_to_ends(gradient, own, here / PIECES, sag_response(ratio[own]), points, push)
        push *= -1.0
        response = sag_response(ratio[neighbour])
        add_to_ends(gradient, neighbour, there / PIECES, response, other, push)
    return left


@compiled
def _close_points(points: Floats, reach: float, sine: float, outward: bool) -> tuple[int, int]:
    """Return the range of points of an outline that may be within ``reach`` of the neighbour.

    In plan view they are at equal distances, and each is at least ``sine`` times as far from the
    other strand as from the vehicle; the strand leads ``outward`` from there, or toward it.
    """
    x, y = points[-1, 0] - points[0, 0], points[-1, 1] - points[0, 1]
    step = np.sqrt(x * x + y * y) / PIECES * sine
    count = PIECES
    while count > 1 and step * (count - 1) >= reach:
        count -= 1
    return (0, count + 1) if outward else (PIECES - count, PIECES + 1)


@compiled
def _in_free_part(place: float, limit: float, first: bool) -> float:
    """Return the place in the free part that is closest to a place; ``first`` ends at ``limit``."""
    return min(place, limit) if first else max(place, limit)


@compiled
def _place_at(sizes: Floats, share: float) -> float:
    """Return the place on a polyline with edges of lengths (k,) after a share of its length."""
    left = share * sizes.sum()
    for k in range(len(sizes)):
        if sizes[k] >= left:
            return float(k + left / max(sizes[k], 1e-12))
        left -= sizes[k]
    return float(len(sizes))


@compiled
def _share_before(sizes: Floats, place: float) -> float:
    """Return the share of a polyline's length before a place; edges have lengths (k,)."""
    piece = min(int(place), len(sizes) - 1)
    before = sizes[:piece].sum() + (place - piece) * sizes[piece]
    return float(before / max(sizes.sum(), 1e-12))
