"""Missed margins between strands that meet at a vehicle; compiled.

As in :mod:`swarm.folding.strand_clearance`, functions add to a penalty. The *free part* of a strand
is the part beyond the exempt length at the shared grip; it is compared with all of the other one.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from swarm.folding.end_response import add_to_ends, arc_fraction, largest_responses, point_movement
from swarm.folding.margins import Penalty, PenaltyModel, Team
from swarm.folding.outlines import PIECES, direction_between, point_at
from swarm.folding.strand_clearance import preferred_distance
from swarm.geometry.distance import point_distance, polyline_distance, times
from swarm.geometry.sensitivity import FAR_END, FINEST, NEAR_END, error_of_ends, finest_piece
from swarm.jit import compiled, inner
from swarm.signatures import Floats1, Floats2, Floats4

Floats = npt.NDArray[np.float64]

_LEAST_FREE = 0.5
"""Smallest free part of a strand, as a share of its length, however long the exempt length is."""

_NOT_CLOSER = 1.0 + 1e-9
"""Share of a distance of two points at which their strands are certain to be closer."""


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


class Chain(NamedTuple):
    """Strands of a team at one moment, as in :class:`swarm.folding.margins.Team`."""

    points: Floats
    shapes: Floats
    response: Floats


class JunctionMemory(NamedTuple):
    """Working memory: ``sizes`` (2, PIECES) for the lengths of edges, ``part`` (PIECES + 1, 3)."""

    sizes: Floats2
    part: Floats2


def junction_memory() -> JunctionMemory:
    """Return memory, which one computation at a time may use."""
    return JunctionMemory(np.empty((2, PIECES)), np.empty((PIECES + 1, 3)))


class Junction(NamedTuple):
    """Two strands that meet at a vehicle: segments ``first`` and ``first + 1``.

    ``extra`` metres are required beyond the margin.
    """

    first: int
    extra: float
    memory: JunctionMemory


class _FreePart(NamedTuple):
    """The free part of a segment, up to or from the place ``limit`` on its outline.

    The preferred distance is ``wanted``; beyond ``reach`` no margin is missed. In plan view, a
    point of one strand is at least ``sine`` times as far from the other as from the vehicle.
    """

    segment: int
    limit: float
    wanted: float
    reach: float
    sine: float


@compiled
def penalize_neighbours(
    team: Team, extra: Floats1, model: PenaltyModel, cache: MarginCache, memory: JunctionMemory,
    penalty: Penalty,
) -> None:  # fmt: skip
    """Add the missed margins of strands that meet at a vehicle; ``extra`` (s,) as elsewhere.

    Pairs with a spare margin in the cache are skipped; others are written to it. The cache is valid
    as long as nothing but positions changes.
    """
    for s in range(len(team.points)):
        chain = Chain(team.points[s], team.shapes[s], team.response[s])
        points, response = chain.points, chain.response
        moment = Penalty(penalty.missed[s : s + 1], penalty.gradient[s : s + 1])
        for i in range(len(points) - 1):
            before, after = points[i], points[i + 1]
            movement = _movement(before, after, response[i, 0], response[i + 1, 0])
            if _is_cached(before, after, movement, cache.spare[s, i], cache.positions[s, i]):
                continue
            junction = Junction(i, extra[s], memory)
            cache.spare[s, i] = penalize_junction(chain, junction, model, moment)


@inner
def penalize_junction(
    chain: Chain, junction: Junction, model: PenaltyModel, moment: Penalty
) -> float:
    """Add the missed margin of two strands that meet to the penalty of one moment.

    Return the metres that remain of the preferred margin, negative where it is missed.
    """
    i, sizes, margins = junction.first, junction.memory.sizes, model.margins
    before, after = chain.points[i], chain.points[i + 1]
    shape, shape_after = chain.shapes[i], chain.shapes[i + 1]
    for k in range(PIECES):
        sizes[0, k] = point_distance(before[k], before[k + 1])
        sizes[1, k] = point_distance(after[k], after[k + 1])
    wanted, tracking = preferred_distance(margins) + junction.extra, 2.0 * margins.tracking
    reach = wanted + tracking * (chain.response[i, 1] + chain.response[i + 1, 1])
    sine = _least_sine(before, after)
    free, free_after = _free_share(shape, margins.exempt), _free_share(shape_after, margins.exempt)
    ends, begins = _place_at(sizes[0], free), _place_at(sizes[1], 1.0 - free_after)
    level = _level_distance(before, ends, after[0])
    level_after = _level_distance(after, begins, after[0])
    if sine == 1.0:
        # Points farther along move more with the far end, but by less than they are apart.
        at_end, at_start = error_of_ends(FAR_END, tracking), error_of_ends(NEAR_END, tracking)
        piece, piece_after = finest_piece(1, free), finest_piece(1, 1.0 - free_after)
        pieces, pieces_after = (piece, 2 * FINEST - 1), (piece_after, FINEST)
        error, last = largest_responses(shape, pieces, at_start, model.tables)
        error_after, begun = largest_responses(shape_after, pieces_after, at_end, model.tables)
        error, error_after = error + begun, error_after + last
        least = min(level - tracking * error, level_after - tracking * error_after)
        if least > wanted:
            return least - wanted
    spare = np.inf
    for own, limit, near in ((i, ends, level), (i + 1, begins, level_after)):
        remaining = near * sine - reach
        if remaining < 0.0:
            apart = _FreePart(own, limit, wanted, reach, sine)
            remaining = _penalize_free_part(chain, junction, apart, model, moment)
        spare = min(spare, remaining)
    return spare


@inner
def _free_share(shape: Floats, exempt: float) -> float:
    """Return the free part of a strand as a share of its length."""
    return float(max(_LEAST_FREE, 1.0 - exempt / shape[0]))


@inner
def _movement(before: Floats, after: Floats, response: float, response_after: float) -> float:
    """Return by how much the distance of two strands changes per metre of their ends, at most.

    A strand moves by its response, and the line along it in plan view turns about their vehicle.
    """
    x, y = before[0, 0] - before[-1, 0], before[0, 1] - before[-1, 1]
    x_after, y_after = after[-1, 0] - after[0, 0], after[-1, 1] - after[0, 1]
    longer = np.sqrt((x * x + y * y) / max(x_after * x_after + y_after * y_after, 1e-18))
    return float(max(response_after, longer) + max(response, 1.0 / max(longer, 1e-9)))


@inner
def _is_cached(
    before: Floats, after: Floats, movement: float, spare: float, positions: Floats
) -> bool:
    """Return whether movement since then cannot have used up a spare margin.

    ``movement`` is :func:`_movement` of the strands. Otherwise, write the positions of
    the three vehicles.
    """
    ends = (before[0], after[0], after[-1])
    if spare > 0.0:
        farthest = 0.0
        for k in range(3):
            farthest = max(farthest, point_distance(ends[k], positions[k]))
        if spare > movement * farthest:
            return True
    for k in range(3):
        for axis in range(3):
            positions[k, axis] = ends[k][axis]
    return False


@inner
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


@inner
def _level_distance(points: Floats, place: float, at: Floats) -> float:
    """Return the distance in plan view from a place on an outline to a point."""
    piece = min(int(place), len(points) - 2)
    share = place - piece
    x = (1.0 - share) * points[piece, 0] + share * points[piece + 1, 0] - at[0]
    y = (1.0 - share) * points[piece, 1] + share * points[piece + 1, 1] - at[1]
    return float(np.sqrt(x * x + y * y))


@inner
def _penalize_free_part(
    chain: Chain, junction: Junction, free: _FreePart, model: PenaltyModel, moment: Penalty
) -> float:
    """Add the missed margin of a free part to the penalty of one moment.

    Return the metres that remain of the preferred margin.
    """
    points, shapes = chain.points, chain.shapes
    own, limit, reach = free.segment, free.limit, free.reach
    part = junction.memory.part
    neighbour = 2 * junction.first + 1 - own
    outline, other, outward = points[own], points[neighbour], own > neighbour
    low, high = _close_points(outline, reach, free.sine, outward)
    begin, end = _close_points(other, reach, free.sine, not outward)
    if outward:
        low = min(int(limit), PIECES - 1)
    else:
        high = min(int(limit), PIECES - 1) + 2
    for k in range(low, high):
        corner = point_at(outline, _in_free_part(float(k), limit, not outward))
        part[k, 0], part[k, 1], part[k, 2] = corner
    # pieces that are farther than the vehicle's side of the free part need not be compared
    nearest = part[low] if outward else part[high - 1]
    most = min(reach, _NOT_CLOSER * _nearest_corner(nearest, other[begin:end]))
    distance, here, there = polyline_distance(part[low:high], other[begin:end], most)
    if distance >= reach:
        return 0.0
    here, there = here + low, there + begin
    normal = direction_between(part, here, other, there, distance)
    piece = min(int(here), PIECES - 1)
    from_place = _in_free_part(float(piece), limit, not outward)
    to_place = _in_free_part(piece + 1.0, limit, not outward)
    here = from_place + (here - piece) * (to_place - from_place)
    here = arc_fraction(shapes[own], here / PIECES)
    there = arc_fraction(shapes[neighbour], there / PIECES)
    # Seen from the shared grip, the other ends move by up to twice the tracking error.
    tracking, tables = model.margins.tracking, model.tables
    moved = error_of_ends(FAR_END if outward else NEAR_END, 2.0 * tracking)
    error = point_movement(shapes[own], here, normal[2], moved, tables)
    moved = error_of_ends(NEAR_END if outward else FAR_END, 2.0 * tracking)
    error += point_movement(shapes[neighbour], there, normal[2], moved, tables)
    remaining = distance - free.wanted - error
    if remaining < 0.0:
        short = -remaining / (model.margins.cable + 2.0 * tracking)
        moment.missed[0] += short * short
        push, gradient = short / (model.margins.cable + 2.0 * tracking), moment.gradient[0]
        add_to_ends(gradient, own, outline, shapes[own], here, times(-push, normal))
        add_to_ends(gradient, neighbour, other, shapes[neighbour], there, times(push, normal))
    return remaining


@inner
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


@inner
def _nearest_corner(point: Floats, corners: Floats) -> float:
    """Return the distance of the nearest of corners (k, 3) from a point."""
    square = np.inf
    for k in range(len(corners)):
        x, y, z = corners[k, 0] - point[0], corners[k, 1] - point[1], corners[k, 2] - point[2]
        square = min(square, x * x + y * y + z * z)
    return float(np.sqrt(square))


@inner
def _in_free_part(place: float, limit: float, first: bool) -> float:
    """Return the place in the free part that is closest to a place; ``first`` ends at ``limit``."""
    return min(place, limit) if first else max(place, limit)


@inner
def _place_at(sizes: Floats, share: float) -> float:
    """Return the place on a polyline with edges of lengths (k,) after a share of its length."""
    remaining = share * sizes.sum()
    for k in range(len(sizes)):
        if sizes[k] >= remaining:
            return float(k + remaining / max(sizes[k], 1e-12))
        remaining -= sizes[k]
    return float(len(sizes))
