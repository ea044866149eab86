"""How much strands miss the distances that they should keep from each other; compiled.

Functions add, for every moment, the squares of what is missed in units of a margin to ``missed``
(s,), and half the derivative of these by all places to ``slopes`` (s, n, 3). Strands are given by
outlines (s, n − 1, k, 3), the middles and reaches of their boxes (s, n − 1, 3) and chords over
lengths (s, n − 1). A *place* on one is the index of a piece plus a fraction of that piece.
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
    point_movement,
    sag_response,
)
from swarm.folding.margins import Margins
from swarm.geometry.distance import (
    Box,
    boxes_closer,
    point_distance,
    polyline_distance,
    polyline_distance_sized,
)
from swarm.jit import compiled

Floats = npt.NDArray[np.float64]

PREFERRED = 0.25
"""Share of a margin's unit that is wanted beyond the margin."""


@compiled
def penalize_strands(
    points: Floats,
    middle: Floats,
    reach: Floats,
    ratio: Floats,
    sides: npt.NDArray[np.int8],
    more: Floats,
    margins: Margins,
    missed: Floats,
    slopes: Floats,
) -> None:
    """Strands that do not share a vehicle; ``sides`` (s, pairs) as in :class:`Sides`."""
    count = ratio.shape[1]
    wanted = margins.cable + PREFERRED * (margins.cable + 2.0 * margins.tracking)
    lifted, error = np.empty(count), np.empty(count)
    for s in range(len(points)):
        for i in range(count):
            lifted[i] = sag_response(ratio[s, i])
            error[i] = margins.tracking * max_point_movement(lifted[i])
        pair = -1
        for i in range(count):
            for j in range(i + 2, count):
                pair += 1
                most = wanted + more[s] + error[i] + error[j]
                box = Box(middle[s, i], reach[s, i])
                if boxes_closer(box, Box(middle[s, j], reach[s, j]), most):
                    missed[s] += _pair(
                        points[s], i, j, lifted, sides[s, pair], most, more[s], margins, slopes[s]
                    )


@compiled
def _pair(
    points: Floats,
    i: int,
    j: int,
    lifted: Floats,
    side: int,
    most: float,
    more: float,
    margins: Margins,
    slopes: Floats,
) -> float:
    """Square of what two strands miss, which is nothing where they are so far apart."""
    one, other = points[i], points[j]
    unit = margins.cable + 2.0 * margins.tracking
    push = np.zeros(3)
    beyond = -side * crossing_height(one, other) if side else 0.0
    if beyond > 0.0:
        # The wrong one is over: loops come out of others upward and downward, not through them.
        here, there = plan_crossing(one, other)
        distance, push[2] = -beyond, side
        error = point_movement(lifted[i], here, 1.0) + point_movement(lifted[j], there, 1.0)
    else:
        distance, here, there = polyline_distance(one, other, most)
        if distance >= most:
            return 0.0
        error, here, there = _answered(
            one, lifted[i], here, other, lifted[j], there, distance, push
        )
    short = PREFERRED - (distance - margins.cable - more - margins.tracking * error) / unit
    if short <= 0.0:
        return 0.0
    push *= -short / unit
    add_to_ends(slopes, i, here, lifted[i], one, push)
    push *= -1.0
    add_to_ends(slopes, j, there, lifted[j], other, push)
    return float(short * short)


@compiled
def _answered(
    one: Floats,
    lifted: float,
    here: float,
    other: Floats,
    lifted_other: float,
    there: float,
    distance: float,
    towards: Floats,
) -> tuple[float, float, float]:
    """How the distance of strands answers their ends, and at which shares of them they are near.

    Writes the unit vector (3,) from the second to the first there.
    """
    upright = _towards(one, here, other, there, distance, towards)
    here, there = here / PIECES, there / PIECES
    error = point_movement(lifted, here, upright) + point_movement(lifted_other, there, upright)
    return error, here, there


@compiled
def spare_margins(
    one: Floats, ratio: Floats, other: Floats, ratio_other: Floats, margins: Margins, found: Floats
) -> None:
    """Write by how much strands (q, k, 3) keep more than their distance from others, pair by pair.

    They do not share a vehicle.
    """
    towards = np.empty(3)
    for q in range(len(one)):
        lifted, lifted_other = sag_response(ratio[q]), sag_response(ratio_other[q])
        distance, here, there = polyline_distance(one[q], other[q], np.inf)
        error, _, _ = _answered(
            one[q], lifted, here, other[q], lifted_other, there, distance, towards
        )
        found[q] = distance - margins.cable - margins.tracking * error


class MarginCache(NamedTuple):
    """Neighbouring strands that need no look: what they keep beyond what is wanted.

    ``spare`` (s, n − 2) are metres, negative where nothing is known, and ``places``
    (s, n − 2, 3, 3) where their three vehicles were then.
    """

    spare: Floats
    places: Floats


def empty_margin_cache(moments: int, segments: int) -> MarginCache:
    """Nothing known of so many moments."""
    pairs = max(segments - 1, 0)
    return MarginCache(np.full((moments, pairs), -1.0), np.zeros((moments, pairs, 3, 3)))


@compiled
def penalize_neighbours(
    points: Floats,
    ratio: Floats,
    lengths: Floats,
    more: Floats,
    margins: Margins,
    calm: MarginCache,
    missed: Floats,
    slopes: Floats,
) -> None:
    """Strands that meet at a vehicle, beyond its hand.

    The free part of each is held against all of the other. What is ``calm`` is left out, and noted
    anew where it is not; it holds for as long as nothing but places changes.
    """
    free = np.maximum(0.5, 1.0 - margins.exempt / lengths)
    unit = margins.cable + 2.0 * margins.tracking
    enough = 1.3 * margins.cable + 2.6 * margins.tracking
    part, sizes = np.empty((PIECES + 1, 3)), np.empty((2, PIECES))
    for s in range(len(points)):
        wanted = margins.cable + PREFERRED * unit + more[s]
        for i in range(len(lengths) - 1):
            before, after = points[s, i], points[s, i + 1]
            if _calm(
                before, after, ratio[s, i], ratio[s, i + 1], calm.spare[s, i], calm.places[s, i]
            ):
                continue
            for k in range(PIECES):
                sizes[0, k] = point_distance(before[k], before[k + 1])
                sizes[1, k] = point_distance(after[k], after[k + 1])
            error = max_far_end_movement(ratio[s, i]) + max_far_end_movement(ratio[s, i + 1])
            reach = wanted + margins.tracking * error
            sine = _sine(before, after)
            ends, begins = _along(sizes[0], free[i]), _along(sizes[1], 1.0 - free[i + 1])
            room, room_after = _level(before, ends, after[0]), _level(after, begins, after[0])
            if sine == 1.0 and more[s] == 0.0 and min(room, room_after) > enough:
                calm.spare[s, i] = min(room, room_after) - enough
                continue
            spare = np.inf
            for own, free_to, near in ((i, ends, room), (i + 1, begins, room_after)):
                left = near * sine - reach
                if left < 0.0:
                    left = _beyond_hand(
                        points[s], sizes, ratio[s], lengths, i, own, free_to, part, reach, sine,
                        wanted, margins, missed[s : s + 1], slopes[s],
                    )  # fmt: skip
                spare = min(spare, left)
            calm.spare[s, i] = spare


@compiled
def _calm(
    before: Floats, after: Floats, ratio: float, ratio_after: float, spare: float, places: Floats
) -> bool:
    """Whether strands cannot have used up what they had to spare; notes their vehicles, if not."""
    ends = (before[0], after[0], after[-1])
    if spare > 0.0:
        farthest = 0.0
        for k in range(3):
            farthest = max(farthest, point_distance(ends[k], places[k]))
        if (
            spare
            > (
                max_point_movement(sag_response(ratio))
                + max_point_movement(sag_response(ratio_after))
            )
            * farthest
        ):
            return True
    for k in range(3):
        for axis in range(3):
            places[k, axis] = ends[k][axis]
    return False


@compiled
def _sine(before: Floats, after: Floats) -> float:
    """How near in plan view, over its distance from their vehicle, a strand's point may be to the
    neighbouring strand: sine of the angle between them, or 1 where that is not acute.

    Each lies in a vertical plane and only gets farther from the vehicle in plan view.
    """
    back_x, back_y = before[0, 0] - after[0, 0], before[0, 1] - after[0, 1]
    ahead_x, ahead_y = after[-1, 0] - after[0, 0], after[-1, 1] - after[0, 1]
    if back_x * ahead_x + back_y * ahead_y <= 0.0:
        return 1.0
    sizes = np.sqrt((back_x**2 + back_y**2) * (ahead_x**2 + ahead_y**2))
    return float(abs(back_x * ahead_y - back_y * ahead_x) / sizes)


@compiled
def _level(points: Floats, place: float, at: Floats) -> float:
    """Distance in plan view from a place on a polyline to a point."""
    piece = min(int(place), len(points) - 2)
    share = place - piece
    x = (1.0 - share) * points[piece, 0] + share * points[piece + 1, 0] - at[0]
    y = (1.0 - share) * points[piece, 1] + share * points[piece + 1, 1] - at[1]
    return float(np.sqrt(x * x + y * y))


@compiled
def _beyond_hand(
    points: Floats,
    sizes: Floats,
    ratio: Floats,
    lengths: Floats,
    first: int,
    own: int,
    free_to: float,
    part: Floats,
    reach: float,
    sine: float,
    wanted: float,
    margins: Margins,
    missed: Floats,
    slopes: Floats,
) -> float:
    """The free part of one strand against all of its neighbour, where nearer than reach.

    Returns what is left beyond what is wanted. The strands are the ``first`` and the next one;
    ``sizes`` (2, PIECES) are those of their pieces. The strand is free up to the place ``free_to``;
    ``part`` (PIECES + 1, 3) is written over.
    """
    beside = 2 * first + 1 - own
    strand, other, outward = points[own], points[beside], own > beside
    low, high = _nearer(strand, reach, sine, outward)
    from_, to = _nearer(other, reach, sine, not outward)
    if outward:
        low = min(int(free_to), PIECES - 1)
    else:
        high = min(int(free_to), PIECES - 1) + 2
    for k in range(low, high):
        _point(strand, _free(float(k), free_to, not outward), part[k])
    distance, here, there = polyline_distance_sized(
        part[low:high], other[from_:to], sizes[beside - first, from_ : to - 1], reach
    )
    if distance >= reach:
        return 0.0
    here, there = here + low, there + from_
    push = np.empty(3)
    upright = _towards(part, here, other, there, distance, push)
    piece = min(int(here), PIECES - 1)
    begin = _free(float(piece), free_to, not outward)
    here = begin + (here - piece) * (_free(piece + 1.0, free_to, not outward) - begin)
    at_end = 0.0 if outward else 1.0
    tracking = margins.tracking
    error = far_end_movement(
        strand, ratio[own], ratio[own] * lengths[own],
        abs(_share_of(sizes[own - first], here) - at_end), upright, tracking,
    )  # fmt: skip
    error += far_end_movement(
        other, ratio[beside], ratio[beside] * lengths[beside],
        abs(_share_of(sizes[beside - first], there) - 1.0 + at_end), upright, tracking,
    )  # fmt: skip
    left = distance - wanted - tracking * error
    if left < 0.0:
        short = -left / (margins.cable + 2.0 * tracking)
        missed[0] += short * short
        push *= -short / (margins.cable + 2.0 * tracking)
        add_to_ends(slopes, own, here / PIECES, sag_response(ratio[own]), strand, push)
        push *= -1.0
        add_to_ends(slopes, beside, there / PIECES, sag_response(ratio[beside]), other, push)
    return left


@compiled
def _nearer(points: Floats, reach: float, sine: float, outward: bool) -> tuple[int, int]:
    """The points of a strand, from one to before the other, between which it may come so near.

    In plan view they are equally far apart, and each is at least ``sine`` times as far from the
    other strand as from the vehicle that holds both; the strand leads ``outward`` from there, or
    toward it.
    """
    x, y = points[-1, 0] - points[0, 0], points[-1, 1] - points[0, 1]
    step = np.sqrt(x * x + y * y) / PIECES * sine
    count = PIECES
    while count > 1 and step * (count - 1) >= reach:
        count -= 1
    return (0, count + 1) if outward else (PIECES - count, PIECES + 1)


@compiled
def _free(place: float, free_to: float, first: bool) -> float:
    """The place on the free part of a strand that is next to a place; the first's hand ends it."""
    return min(place, free_to) if first else max(place, free_to)


@compiled
def _along(sizes: Floats, share: float) -> float:
    """The place on a polyline with pieces of these sizes (k,) after a share of its length."""
    left = share * sizes.sum()
    for k in range(len(sizes)):
        if sizes[k] >= left:
            return float(k + left / max(sizes[k], 1e-12))
        left -= sizes[k]
    return float(len(sizes))


@compiled
def _share_of(sizes: Floats, place: float) -> float:
    """The share before a place on it of the length of a polyline with pieces of sizes (k,)."""
    piece = min(int(place), len(sizes) - 1)
    before = sizes[:piece].sum() + (place - piece) * sizes[piece]
    return float(before / max(sizes.sum(), 1e-12))


@compiled
def _point(points: Floats, place: float, found: Floats) -> None:
    """Write the point (3,) of a polyline at a place: index of the piece plus fraction along it."""
    piece = min(int(place), len(points) - 2)
    share = place - piece
    for axis in range(3):
        found[axis] = (1.0 - share) * points[piece, axis] + share * points[piece + 1, axis]


@compiled
def _towards(
    one: Floats, here: float, other: Floats, there: float, distance: float, found: Floats
) -> float:
    """Write the unit vector (3,) from a place on the second polyline to one on the first.

    Returns how much of it is vertical; all of it where they touch.
    """
    piece, beside = min(int(here), len(one) - 2), min(int(there), len(other) - 2)
    share, part = here - piece, there - beside
    for axis in range(3):
        apart = (1.0 - share) * one[piece, axis] + share * one[piece + 1, axis]
        apart -= (1.0 - part) * other[beside, axis] + part * other[beside + 1, axis]
        found[axis] = apart / max(distance, 1e-6)
    return min(abs(found[2]), 1.0) if distance > 1e-3 else 1.0


@compiled
def crossing_heights(one: Floats, other: Floats, found: Floats) -> None:
    """Write :func:`crossing_height` of strands (q, k, 3) and others, pair by pair."""
    for q in range(len(one)):
        found[q] = crossing_height(one[q], other[q])


@compiled
def crossing_height(one: Floats, other: Floats) -> float:
    """How high a strand passes over another where they cross in plan view, 0 where they do not."""
    here, there = plan_crossing(one, other)
    if not (0.0 < here < 1.0 and 0.0 < there < 1.0):
        return 0.0
    return height_at_span(one, here) - height_at_span(other, there)


@compiled
def plan_crossing(one: Floats, other: Floats) -> tuple[float, float]:
    """The shares of two strands' spans at which the lines along them cross in plan view.

    A strand hangs in a vertical plane, so from above both are straight. −1 where they are parallel.
    """
    u_x, u_y = one[-1, 0] - one[0, 0], one[-1, 1] - one[0, 1]
    w_x, w_y = other[-1, 0] - other[0, 0], other[-1, 1] - other[0, 1]
    apart_x, apart_y = other[0, 0] - one[0, 0], other[0, 1] - one[0, 1]
    area = u_x * w_y - u_y * w_x
    if abs(area) < 1e-12:
        return -1.0, -1.0
    return (apart_x * w_y - apart_y * w_x) / area, (apart_x * u_y - apart_y * u_x) / area


@compiled
def height_at_span(points: Floats, share: float) -> float:
    """Height of a strand's outline at a share of its span in plan view."""
    place = share * (len(points) - 1)
    piece = min(int(place), len(points) - 2)
    return float(points[piece, 2] + (place - piece) * (points[piece + 1, 2] - points[piece, 2]))
