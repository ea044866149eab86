"""Room between a fence and what must stay within it: vehicles, cable, and cable in wind."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from swarm.certification.branch_and_bound import Boxes, Enclosure
from swarm.certification.motion_bounds import Course
from swarm.certification.strands import HeldCable, Pieces, Team, pieces, unit
from swarm.geometry.distance import segment_segment
from swarm.geometry.sensitivity import BOTH_ENDS

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.intp]

_OUTSIDE = 1e-6


@dataclass(frozen=True, eq=False)
class InsideFence:
    """Room between the plan view of things and a fence, in still air; negative outside.

    ``fence`` (m, 2). Things are given by the grip points ``first`` and ``last`` (q,) between which
    they lie straight in plan view (twice the same for a vehicle), and by how far they reach to the
    side ``reach`` (q,).
    """

    course: Course
    tracking: float
    fence: Floats
    first: Ints
    last: Ints
    reach: Floats

    def __call__(self, boxes: Boxes) -> Enclosure:
        """Enclose the margin in each box."""
        time, half, when = boxes.instants()
        team = Team.at(self.course, time, half)
        first, last = self.first[boxes.pair], self.last[boxes.pair]
        ends = np.stack([team.position[when, first], team.position[when, last]], axis=1)
        ends[..., 2] = 0.0
        sides = _sides(self.fence)
        distance = segment_segment(ends[:, None], sides[None]).distance.min(axis=1)
        inside = _inside(ends[:, 0], sides) & _inside(ends[:, 1], sides)
        high = np.where(inside, distance, -distance)
        still = np.zeros((len(boxes), 3))
        drift = np.maximum(team.drift(when, first, still), team.drift(when, last, still))
        high = high - self.tracking - self.reach[boxes.pair]
        nothing = np.zeros_like(high)
        doubts = np.stack([drift, nothing, nothing], axis=1)
        return Enclosure(high - drift, high, doubts, ends.mean(axis=1))


@dataclass(frozen=True, eq=False)
class BlownInsideFence:
    """Room between a fence and strands that lean in the wind; per segment, negative outside.

    ``fence`` (m, 2). A strand whose grips are inside is inside where it keeps away from every side
    of the fence, as from an upright wall.
    """

    cable: HeldCable
    fence: Floats
    diameter: float

    def __call__(self, boxes: Boxes) -> Enclosure:
        """Enclose the margin in each box. Pieces of the strand are the second ones."""
        time, half, when = boxes.instants()
        team = Team.at(self.cable.course, time, half)
        count = len(boxes)
        strand = pieces(
            team, self.cable, when, boxes.pair, boxes.second, np.zeros((count, 3)),
            np.full(count, BOTH_ENDS), np.full(count, self.cable.tracking), np.zeros(count),
            np.broadcast_to(np.array([0.0, 1.0]), (count, 2)),
        )  # fmt: skip
        flat = strand.ends * [1.0, 1.0, 0.0]
        sides = _sides(self.fence)
        walls = [self._from(strand, flat, side) for side in sides]
        low, high = (np.min([wall[k] for wall in walls], axis=0) for k in (0, 1))
        time_doubt = np.max([wall[2] for wall in walls], axis=0)
        grips = team.position[when, boxes.pair], team.position[when, boxes.pair + 1]
        inside = _inside(grips[0], sides) & _inside(grips[1], sides)
        # Of a strand that is held outside, it only matters that it is outside.
        high = np.where(inside, high, np.minimum(high, -_OUTSIDE))
        low = np.where(inside, low, np.minimum(low, -_OUTSIDE))
        nothing = np.zeros(count)
        size = np.maximum(high - low - time_doubt, 0.0)
        doubts = np.stack([time_doubt, nothing, size], axis=1)
        return Enclosure(low, high, doubts, strand.ends.mean(axis=1))

    def _from(self, strand: Pieces, flat: Floats, side: Floats) -> tuple[Floats, Floats, Floats]:
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
        low = reach - wall - strand.bow - moved[0] - half
        high = closest.distance + strand.bow - moved[2] - half
        return low, high, moved[1] - moved[2]


def _sides(fence: Floats) -> Floats:
    """The sides (m, 2, 3) of a fence (m, 2), on the ground."""
    corners = np.pad(fence, ((0, 0), (0, 1)))
    return np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)


def _inside(point: Floats, sides: Floats) -> npt.NDArray[np.bool_]:
    """Whether points (b, 3) lie within the polygon with the given sides (m, 2, 3), in plan view."""
    x, y = point[:, None, 0], point[:, None, 1]
    (x0, y0), (x1, y1) = sides[:, 0, :2].T, sides[:, 1, :2].T
    straddles = (y0 > y) != (y1 > y)
    rise = np.where(y1 == y0, 1.0, y1 - y0)
    crossed = straddles & (x < x0 + (y - y0) / rise * (x1 - x0))
    inside: npt.NDArray[np.bool_] = np.count_nonzero(crossed, axis=1) % 2 == 1
    return inside
