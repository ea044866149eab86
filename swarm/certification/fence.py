"""Certified margins to a fence: of vehicles, of cable, and of cable in wind."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from swarm.certification.branch_and_bound import Boxes, Enclosure
from swarm.certification.motion_bounds import BoundedMotion, TeamStates
from swarm.certification.strand_pieces import Displacement, HeldCable, Pieces, Selection, pieces
from swarm.certification.strands import unit
from swarm.geometry.distance import segment_segment

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
        ends[..., 2] = 0.0
        sides = _sides(self.fence)
        distance = segment_segment(ends[:, None], sides[None]).distance.min(axis=1)
        inside = _inside(ends[:, 0], sides) & _inside(ends[:, 1], sides)
        high = np.where(inside, distance, -distance)
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
        """Enclose the margin in each box; coordinates are time and the strand's fraction."""
        time, half, instant = boxes.instants()
        team = TeamStates.at(self.cable.motion, time, half)
        segment = boxes.group
        strand = pieces(
            team,
            self.cable,
            Selection.unlimited(instant, segment, boxes.middle[:, 1], boxes.half[:, 1]),
            Displacement.of_both_ends(np.zeros((len(boxes), 3)), self.cable.tracking),
        )
        flat = strand.ends * [1.0, 1.0, 0.0]
        sides = _sides(self.fence)
        walls = [self._from_wall(strand, flat, side) for side in sides]
        low, high = (np.min([wall[k] for wall in walls], axis=0) for k in (0, 1))
        in_time = np.max([wall[2] for wall in walls], axis=0)
        grips = team.position[instant, segment], team.position[instant, segment + 1]
        inside = _inside(grips[0], sides) & _inside(grips[1], sides)
        # A strand with a grip outside is outside, at whatever distance.
        high = np.where(inside, high, np.minimum(high, -_OUTSIDE))
        low = np.where(inside, low, np.minimum(low, -_OUTSIDE))
        size = np.maximum(high - low - in_time, 0.0)
        return Enclosure(low, high, np.stack([in_time, size], axis=1), strand.ends.mean(axis=1))

    def _from_wall(
        self, strand: Pieces, flat: Floats, side: Floats
    ) -> tuple[Floats, Floats, Floats]:
        """Bounds (b,) of pieces' distances from a side (2, 3), and their doubt from time."""
        walls = np.broadcast_to(side, (len(flat), 2, 3))
        closest = segment_segment(flat, walls)
        at_strand = flat[:, 0] + closest.first[:, None] * (flat[:, 1] - flat[:, 0])
        at_wall = side[0] + closest.second[:, None] * (side[1] - side[0])
        normal = unit(at_strand - at_wall)
        reach = np.einsum("bki,bi->bk", flat, normal).min(axis=1)
        wall = np.einsum("ki,bi->bk", side, normal).max(axis=1)
        moved = strand.movement(closest.first, normal)
        half = 0.5 * self.diameter
        low = reach - wall - strand.bow - moved.piece - half - strand.swing.most
        high = closest.distance + strand.bow - moved.tracking - half - strand.swing.least
        return low, high, moved.point - moved.tracking + strand.swing.in_time


def _sides(fence: Floats) -> Floats:
    """The sides (m, 2, 3) of a fence (m, 2), on the ground."""
    corners = np.pad(fence, ((0, 0), (0, 1)))
    return np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)


def _inside(point: Floats, sides: Floats) -> npt.NDArray[np.bool_]:
    """Whether points (b, 3) lie within the polygon with sides (m, 2, 3), in plan view."""
    x, y = point[:, None, 0], point[:, None, 1]
    (x0, y0), (x1, y1) = sides[:, 0, :2].T, sides[:, 1, :2].T
    straddles = (y0 > y) != (y1 > y)
    rise = np.where(y1 == y0, 1.0, y1 - y0)
    crossed = straddles & (x < x0 + (y - y0) / rise * (x1 - x0))
    inside: npt.NDArray[np.bool_] = np.count_nonzero(crossed, axis=1) % 2 == 1
    return inside
