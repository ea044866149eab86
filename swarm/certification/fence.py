"""Certified margins to a fence: of vehicles, of cable, and of cable in wind."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from swarm.certification.branch_and_bound import BoxArrays, Boxes, Enclosure, EnclosureArrays
from swarm.certification.motion_bounds import BoundedMotion, TeamStates, ends_at, instant_at
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
    write_unbounded,
)
from swarm.geometry.distance import segment_distance
from swarm.geometry.sensitivity import BOTH_ENDS
from swarm.geometry.vectors import Vector, difference, dot, moved, unit
from swarm.jit import compiled, inner
from swarm.signatures import Floats1, Floats2, Floats3, contiguous

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.intp]

_OUTSIDE = 1e-6
"""Metres by which a strand with a grip outside counts as outside: any positive number will do."""


@dataclass(frozen=True, eq=False)
class InsideFence:
    """Distances of objects from a fence in plan view, in still air; negative outside.

    ``fence`` (m, 2). An object lies straight between the grip points ``first`` and ``last`` (q,) in
    plan view (twice the same for a vehicle) and extends to the side by ``reach`` (q,).
    """

    motion: BoundedMotion
    tracking: float
    fence: Floats
    first: Ints
    last: Ints
    reach: Floats

    def __call__(self, boxes: Boxes) -> Enclosure:
        """Enclose the margin in each box."""
        time, half, instant = boxes.instants()
        team = TeamStates.at(self.motion, time, half)
        first, last = self.first[boxes.group], self.last[boxes.group]
        ends = np.stack([team.position[instant, first], team.position[instant, last]], axis=1)
        high = np.empty(len(boxes))
        _write_inside(ends, contiguous(sides_of(self.fence)), np.empty((2, 3)), high)
        still = np.zeros((len(boxes), 3))
        drift = np.maximum(team.drift(instant, first, still), team.drift(instant, last, still))
        high = high - self.tracking - self.reach[boxes.group]
        return Enclosure.over_time(high, drift, ends.mean(axis=1))


@dataclass(frozen=True, eq=False)
class InsideFenceInWind:
    """Distances of strands that lean in the wind from a fence; per segment, negative outside.

    ``fence`` (m, 2). A strand with both grips inside is inside where it is apart from every side of
    the fence, seen as a vertical wall.
    """

    cable: HeldCable
    fence: Floats
    diameter: float

    def __call__(self, boxes: Boxes) -> Enclosure:
        """Enclose the margin in each box; coordinates are time, tilt and the strand's fraction."""
        found = Enclosure.not_found(boxes)
        sides = contiguous(sides_of(self.fence))
        half, chord = 0.5 * self.diameter, np.empty((2, 3))
        _write_margins(self.cable.tables, sides, half, boxes.arrays(), chord, found.arrays())
        return found


def sides_of(fence: Floats) -> Floats:
    """Return the sides (m, 2, 3) of a fence (m, 2), on the ground."""
    corners = np.pad(fence, ((0, 0), (0, 1)))
    return np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)


@compiled
def _write_inside(ends: Floats3, sides: Floats3, chord: Floats2, found: Floats1) -> None:
    """Write :func:`inside_by` of objects (b, 2, 3)."""
    for b in range(len(found)):
        found[b] = inside_by(ends[b, 0], ends[b, 1], sides, chord)


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
def _write_margins(
    cable: CableTables, sides: Floats3, radius: float, boxes: BoxArrays, chord: Floats2,
    found: EnclosureArrays,
) -> None:  # fmt: skip
    """Write the margins of strands of a radius to the sides (m, 2, 3) of a fence, in boxes.

    ``chord`` (2, 3) is memory.
    """
    for b in range(len(boxes.group)):
        middle, half, segment = boxes.middle[b], boxes.half[b], boxes.group[b]
        gravity = gravity_in(cable, middle, half)
        if not is_bounded(gravity):
            write_unbounded(gravity, b, found)
            continue
        instant = instant_at(cable.motion, middle[0], half[0])
        grips = ends_at(cable.motion, instant, segment)
        displacement = Displacement((0.0, 0.0, 0.0), BOTH_ENDS, cable.tracking, 0.0)
        held = held_strand(cable, segment, grips, instant, displacement, gravity)
        piece = held_piece(cable, held, instant, Part(middle[3], half[3], 0.0, 1.0))
        low, high = np.inf, np.inf
        for side in sides:
            to_low, to_high, doubts = _from_wall(cable, piece, side, chord, gravity)
            low, high = min(low, to_low - radius), min(high, to_high - radius)
            for k in range(4):
                found.doubts[b, k] = max(found.doubts[b, k], doubts[k])
        if not (_within(grips[0].place, sides) and _within(grips[1].place, sides)):
            # A strand with a grip outside is outside, at whatever distance.
            low, high = min(low, -_OUTSIDE), min(high, -_OUTSIDE)
        found.low[b], found.high[b] = low, high
        for axis in range(3):
            found.place[b, axis] = 0.5 * (piece.near[axis] + piece.far[axis])


@inner
def _from_wall(
    cable: CableTables, piece: Piece, side: Floats, chord: Floats, gravity: Gravity
) -> tuple[float, float, tuple[float, float, float, float]]:
    """Return bounds of a piece's distance from a side (2, 3), and their doubts.

    ``chord`` (2, 3) is memory.
    """
    near, far = (piece.near[0], piece.near[1], 0.0), (piece.far[0], piece.far[1], 0.0)
    begin, end = (side[0, 0], side[0, 1], 0.0), (side[1, 0], side[1, 1], 0.0)
    chord[0, 0], chord[0, 1], chord[1, 0], chord[1, 1] = near[0], near[1], far[0], far[1]
    _, here, there = segment_distance(chord, 0, side, 0)
    at_strand = moved(near, here, difference(far, near))
    normal = unit(difference(at_strand, moved(begin, there, difference(end, begin))))
    wall = max(dot(begin, normal), dot(end, normal))
    low, high, doubts = kept_from_plane(cable, piece, normal, here, gravity)
    return low - wall, high - wall, doubts


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
