"""Certified margins to limits: of chords, heights, speeds and accelerations, and to the fence."""

from typing import Literal

import numpy as np
import numpy.typing as npt

from swarm.certification.branch_and_bound import (
    BoxArrays,
    Boxes,
    Enclosure,
    EnclosureArrays,
    Evaluator,
    same_in,
)
from swarm.certification.motion_bounds import (
    BoundedMotion,
    Grip,
    Instant,
    TeamStates,
    ends_at,
    instant_at,
    over_time,
)
from swarm.certification.strand_pieces import (
    CableTables,
    Displacement,
    Gravity,
    HeldCable,
    Part,
    Piece,
    gravity_in,
    held_piece,
    held_strand,
    is_bounded,
    kept_from_plane,
    largest_movement,
    piece_movement,
    strand_point,
    write_unbounded,
)
from swarm.geometry.catenary import MAX_CHORD_RATIO
from swarm.geometry.distance import Vector, difference, dot, moved, segment_distance, unit
from swarm.geometry.sensitivity import BOTH_ENDS
from swarm.geometry.solids import distances, half_space, plane_between, rows
from swarm.jit import compiled, inner
from swarm.signatures import Floats1, Floats2, Floats3, Ints2, contiguous

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.intp]

FLOOR = half_space((0.0, 0.0, 0.0), (0.0, 0.0, 1.0))
"""The floor, as a solid."""


def chords_within(cable: HeldCable, share: float = MAX_CHORD_RATIO) -> Evaluator:
    """Bound the margins of chords to ``share`` of their length, with both ends displaced."""

    def margin(team: TeamStates, instant: Ints, first: Ints) -> tuple[Floats, Floats, Floats]:
        start, end = team.position[instant, first], team.position[instant, first + 1]
        allowed = share * cable.lengths[first] - 2.0 * cable.tracking
        growth = team.drift(instant, first + 1, team.velocity[instant, first])
        growth += team.deviation[instant, first]
        return allowed - np.linalg.norm(end - start, axis=-1), growth, 0.5 * (start + end)

    return over_time(cable.motion, margin)


def above_floor(cable: HeldCable, diameter: float, required: float) -> Evaluator:
    """Bound the heights of the lowest points of strands above the floor, less the required height.

    In wind, coordinates are time, tilt and a fraction.
    """
    if cable.tilts:
        segments = np.arange(len(cable.lengths))
        pairs = np.stack([segments, np.zeros_like(segments)], axis=1)
        return beside_solids(cable, rows([FLOOR]), pairs, diameter, required)

    def evaluate(boxes: Boxes) -> Enclosure:
        bounds = Enclosure.not_found(boxes)
        limits = 0.5 * diameter, required
        _write_heights(cable.tables, limits, boxes.arrays(), bounds.arrays())
        return bounds

    return evaluate


def beside_solids(
    cable: HeldCable, solids: Floats, pairs: Ints, diameter: float, required: float
) -> Evaluator:
    """Bound the distances of strands from convex solids (m, 12), less the required distance.

    ``pairs`` (q, 2) of a segment and a solid. Coordinates are time, in wind tilt, and a fraction.
    """
    kept = contiguous(pairs), contiguous(solids), 0.5 * diameter, required

    def evaluate(boxes: Boxes) -> Enclosure:
        bounds = Enclosure.not_found(boxes)
        _write_beside_solids(cable.tables, *kept, boxes.arrays(), bounds.arrays())
        return bounds

    return evaluate


def vehicles_beside_solids(
    motion: BoundedMotion, tracking: float, solids: Floats, pairs: Ints, required: float
) -> Evaluator:
    """Bound the distances of grip points from convex solids (m, 12), less the required distance.

    ``pairs`` (q, 2) of a vehicle and a solid, :func:`swarm.geometry.solids.grown` by the vehicle.
    """

    def margin(team: TeamStates, instant: Ints, group: Ints) -> tuple[Floats, Floats, Floats]:
        vehicle, solid = pairs[group].T
        place = team.position[instant, vehicle]
        # A distance changes by at most a metre per metre.
        moved = team.drift(instant, vehicle, np.zeros_like(place))
        return distances(solids[solid], place) - tracking - required, moved, place

    return over_time(motion, margin)


def height_limit(motion: BoundedMotion, height: float, sign: float) -> Evaluator:
    """Bound the vertical distances of grip points from a height; per vehicle.

    ``sign`` 1 requires grip points above ``height``, −1 below it.
    """

    def margin(team: TeamStates, instant: Ints, vehicle: Ints) -> tuple[Floats, Floats, Floats]:
        place = team.position[instant, vehicle]
        climb = np.abs(team.velocity[instant, vehicle, 2]) * team.half[instant]
        climb += team.deviation[instant, vehicle]
        return sign * (place[:, 2] - height), climb, place

    return over_time(motion, margin)


def derivative_limit(motion: BoundedMotion, largest: float, order: Literal[1, 2]) -> Evaluator:
    """Bound the margins of a derivative of vehicles' positions to ``largest``; per vehicle.

    ``order`` 1 limits speeds in m/s, 2 accelerations in m/s², with those that jumps of velocity
    hide (:attr:`.BoundedMotion.kinks`).
    """
    change = motion.acceleration_bound if order == 1 else motion.jerk_bound

    def margin(team: TeamStates, instant: Ints, vehicle: Ints) -> tuple[Floats, Floats, Floats]:
        time, half, state = team.time, team.half, motion.at(team.time)
        bound = change(time - half, time + half)[instant, vehicle]
        size = np.linalg.norm(state[order][instant, vehicle], axis=-1)
        if order == 2:
            piece = np.searchsorted(motion.tables.joints, time, side="right")
            size += motion.kinks[piece[instant], vehicle]
        return largest - size, bound * half[instant], state[0][instant, vehicle]

    return over_time(motion, margin)


@compiled
def _write_heights(
    cable: CableTables, heights: tuple[float, float], boxes: BoxArrays, bounds: EnclosureArrays
) -> None:
    """Write the margins of strands' lowest points to the sum of two ``heights``."""
    for b in range(len(boxes.group)):
        segment, time, half = boxes.group[b], boxes.middle[b, 0], boxes.half[b, 0]
        during, at_once = instant_at(cable.motion, time, half), instant_at(cable.motion, time, 0.0)
        moved, _ = _lowest(cable, segment, during)
        still, lowest = _lowest(cable, segment, at_once)
        high = lowest[2] - still - heights[0] - heights[1]
        # The whole strand's sensitivity bounds the lowest point's: only time is halved.
        width = max(moved - still, 0.0)
        bounds.low[b], bounds.high[b], bounds.widths[b, 0] = high - width, high, width
        bounds.place[b, 0], bounds.place[b, 1], bounds.place[b, 2] = lowest


@inner
def _lowest(cable: CableTables, segment: int, instant: Instant) -> tuple[float, Vector]:
    """Return a bound of the vertical movement of a strand, and its lowest point."""
    grips = ends_at(cable.motion, instant, segment)
    displacement = Displacement(_level_velocity(grips), BOTH_ENDS, cable.tracking, 0.0)
    still = Gravity((0.0, 0.0, -1.0), 0.0, 0.0, 0.0)
    held = held_strand(cable, segment, grips, instant, displacement, still)
    piece = held_piece(cable, held, instant, Part(0.5, 0.5, 0.0, 1.0))
    catenary = piece.strand.catenary
    along = min(max(-catenary.slope * catenary.parameter / catenary.length, 0.0), 1.0)
    lowest = strand_point(piece.strand, along)
    normal = 0.0, 0.0, 1.0
    largest = largest_movement(cable, piece, normal, still)
    moved = piece_movement(cable, piece, normal, along, still, largest).piece + piece.swing.most
    return moved, lowest


@compiled
def _write_beside_solids(
    cable: CableTables, pairs: Ints2, solids: Floats2, radius: float, required: float,
    boxes: BoxArrays, bounds: EnclosureArrays,
) -> None:  # fmt: skip
    """Write the margins of pieces of strands of a radius beside solids (m, 12)."""
    known, k = -1, boxes.middle.shape[1] - 1
    for b in range(len(boxes.group)):
        middle, half, (segment, which) = boxes.middle[b], boxes.half[b], pairs[boxes.group[b]]
        solid = solids[which]
        if known < 0 or not same_in(boxes, known, b, k):
            known, gravity = b, gravity_in(cable, middle, half)
            if is_bounded(gravity):
                instant = instant_at(cable.motion, middle[0], half[0])
                grips = ends_at(cable.motion, instant, segment)
                along = _along_slab(grips, solid)
                displacement = Displacement(along, BOTH_ENDS, cable.tracking, 0.0)
                held = held_strand(cable, segment, grips, instant, displacement, gravity)
        if not is_bounded(gravity):
            write_unbounded(gravity, b, bounds)
            continue
        piece = held_piece(cable, held, instant, Part(middle[k], half[k], 0.0, 1.0))
        here, normal, wall = plane_between(solid, piece.near, piece.far)
        low, high, uncertainty = kept_from_plane(cable, piece, normal, here, gravity)
        bounds.low[b] = low - wall - radius - required
        bounds.high[b] = high - wall - radius - required
        bounds.widths[b, 0], bounds.widths[b, k] = uncertainty[0], uncertainty[3]
        if k > 1:
            bounds.widths[b, 1], bounds.widths[b, 2] = uncertainty[1], uncertainty[2]
        for axis in range(3):
            bounds.place[b, axis] = 0.5 * (piece.near[axis] + piece.far[axis])


@inner
def _along_slab(grips: tuple[Grip, Grip], solid: Floats) -> Vector:
    """Return the mean velocity of two grip points along a half-space, which changes no distance.

    Nothing beside other solids.
    """
    if solid[4] < np.inf:
        return 0.0, 0.0, 0.0
    normal, mean = (solid[7], solid[8], solid[9]), _mean_velocity(grips)
    return moved(mean, -dot(normal, mean), normal)


@inner
def _level_velocity(grips: tuple[Grip, Grip]) -> Vector:
    """Return the mean velocity of two grip points without its vertical part."""
    mean = _mean_velocity(grips)
    return mean[0], mean[1], 0.0


@inner
def _mean_velocity(grips: tuple[Grip, Grip]) -> Vector:
    first, second = grips[0].velocity, grips[1].velocity
    return 0.5 * (first[0] + second[0]), 0.5 * (first[1] + second[1]), 0.5 * (first[2] + second[2])


_OUTSIDE = 1e-6
"""Metres by which a strand with a grip outside counts as outside: any positive number will do."""


def inside_fence(
    motion: BoundedMotion, tracking: float, fence: Floats, ends: tuple[Ints, Ints], reach: Floats
) -> Evaluator:
    """Bound the distances of objects from a fence in plan view, in still air; negative outside.

    ``fence`` (m, 2). An object lies straight between two grip points (q,) in plan view (twice the
    same for a vehicle) and extends to the side by ``reach`` (q,).
    """

    def margin(team: TeamStates, instant: Ints, group: Ints) -> tuple[Floats, Floats, Floats]:
        first, last = ends[0][group], ends[1][group]
        places = np.stack([team.position[instant, first], team.position[instant, last]], axis=1)
        high = np.empty(len(group))
        _write_inside(places, contiguous(sides_of(fence)), np.empty((2, 3)), high)
        still = np.zeros((len(group), 3))
        drift = np.maximum(team.drift(instant, first, still), team.drift(instant, last, still))
        return high - tracking - reach[group], drift, places.mean(axis=1)

    return over_time(motion, margin)


def inside_fence_in_wind(cable: HeldCable, fence: Floats, diameter: float) -> Evaluator:
    """Bound the distances of strands that lean in the wind from a fence; negative outside.

    ``fence`` (m, 2). A strand with both grips inside is inside where it is apart from every side of
    the fence, seen as a vertical wall. Coordinates are time, tilt and the strand's fraction.
    """

    def evaluate(boxes: Boxes) -> Enclosure:
        bounds = Enclosure.not_found(boxes)
        sides, chord = contiguous(sides_of(fence)), np.empty((2, 3))
        _write_inside_in_wind(
            cable.tables, sides, 0.5 * diameter, boxes.arrays(), chord, bounds.arrays()
        )
        return bounds

    return evaluate


def inside_fence_by(lines: Floats, fence: Floats) -> Floats:
    """Return how far polylines (…, m, 3) are from a fence (m, 2) in plan view; negative outside."""
    pieces = np.stack([lines[..., :-1, :], lines[..., 1:, :]], axis=-2)
    every = pieces.reshape(-1, 2, 3)
    margins = np.empty(len(every))
    _write_inside(contiguous(every), contiguous(sides_of(fence)), np.empty((2, 3)), margins)
    least: Floats = margins.reshape(pieces.shape[:-2]).min(axis=-1)
    return least


def sides_of(fence: Floats) -> Floats:
    """Return the sides (m, 2, 3) of a fence (m, 2), on the ground."""
    corners = np.pad(fence, ((0, 0), (0, 1)))
    return np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)


@compiled
def _write_inside(ends: Floats3, sides: Floats3, chord: Floats2, margins: Floats1) -> None:
    """Write :func:`inside_by` of objects (b, 2, 3)."""
    for b in range(len(margins)):
        margins[b] = inside_by(ends[b, 0], ends[b, 1], sides, chord)


@inner
def inside_by(start: Floats, end: Floats, sides: Floats, chord: Floats) -> float:
    """Return how far a straight line between two points (3,) is from a fence in plan view.

    Negative where an end is outside of its ``sides`` (m, 2, 3). ``chord`` (2, 3) is memory.
    """
    chord[0, 0], chord[0, 1], chord[0, 2] = start[0], start[1], 0.0
    chord[1, 0], chord[1, 1], chord[1, 2] = end[0], end[1], 0.0
    least = np.inf
    for side in sides:
        least = min(least, segment_distance(chord, 0, side, 0)[0])
    apart, point, other = float(np.sqrt(least)), chord[0], chord[1]
    inside = _within((point[0], point[1], 0.0), sides)
    return apart if inside and _within((other[0], other[1], 0.0), sides) else -apart


@compiled
def _write_inside_in_wind(
    cable: CableTables, sides: Floats3, radius: float, boxes: BoxArrays, chord: Floats2,
    bounds: EnclosureArrays,
) -> None:  # fmt: skip
    """Write the margins of strands of a radius to the sides (m, 2, 3) of a fence, in boxes.

    ``chord`` (2, 3) is memory.
    """
    for b in range(len(boxes.group)):
        middle, half, segment = boxes.middle[b], boxes.half[b], boxes.group[b]
        gravity = gravity_in(cable, middle, half)
        if not is_bounded(gravity):
            write_unbounded(gravity, b, bounds)
            continue
        instant = instant_at(cable.motion, middle[0], half[0])
        grips = ends_at(cable.motion, instant, segment)
        displacement = Displacement((0.0, 0.0, 0.0), BOTH_ENDS, cable.tracking, 0.0)
        held = held_strand(cable, segment, grips, instant, displacement, gravity)
        piece = held_piece(cable, held, instant, Part(middle[3], half[3], 0.0, 1.0))
        low, high = np.inf, np.inf
        for side in sides:
            to_low, to_high, uncertainty = _from_wall(cable, piece, side, chord, gravity)
            low, high = min(low, to_low - radius), min(high, to_high - radius)
            for k in range(4):
                bounds.widths[b, k] = max(bounds.widths[b, k], uncertainty[k])
        if not (_within(grips[0].place, sides) and _within(grips[1].place, sides)):
            # A strand with a grip outside is outside, at whatever distance.
            low, high = min(low, -_OUTSIDE), min(high, -_OUTSIDE)
        bounds.low[b], bounds.high[b] = low, high
        for axis in range(3):
            bounds.place[b, axis] = 0.5 * (piece.near[axis] + piece.far[axis])


@inner
def _from_wall(
    cable: CableTables, piece: Piece, side: Floats, chord: Floats, gravity: Gravity
) -> tuple[float, float, tuple[float, float, float, float]]:
    """Return bounds of a piece's distance from a side (2, 3), and their widths.

    ``chord`` (2, 3) is memory.
    """
    near, far = (piece.near[0], piece.near[1], 0.0), (piece.far[0], piece.far[1], 0.0)
    begin, end = (side[0, 0], side[0, 1], 0.0), (side[1, 0], side[1, 1], 0.0)
    chord[0, 0], chord[0, 1], chord[1, 0], chord[1, 1] = near[0], near[1], far[0], far[1]
    _, here, there = segment_distance(chord, 0, side, 0)
    at_strand = moved(near, here, difference(far, near))
    normal = unit(difference(at_strand, moved(begin, there, difference(end, begin))))
    wall = max(dot(begin, normal), dot(end, normal))
    low, high, uncertainty = kept_from_plane(cable, piece, normal, here, gravity)
    return low - wall, high - wall, uncertainty


@inner
def _within(point: Vector, sides: Floats3) -> bool:
    """Return whether a point lies within the polygon with sides (m, 2, 3), in plan view."""
    inside = False
    for side in sides:
        if (side[0, 1] > point[1]) != (side[1, 1] > point[1]):
            share = (point[1] - side[0, 1]) / (side[1, 1] - side[0, 1])
            if point[0] < side[0, 0] + share * (side[1, 0] - side[0, 0]):
                inside = not inside
    return inside
