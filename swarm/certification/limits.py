"""Certified margins to the limits of vehicles and cable: chords, floor, heights, speeds."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from swarm.certification.branch_and_bound import Boxes, Enclosure
from swarm.certification.motion_bounds import BoundedMotion, TeamStates
from swarm.certification.strand_pieces import Displacement, HeldCable, Selection, pieces
from swarm.geometry.catenary import MAX_CHORD_RATIO

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Slack:
    """Margins of chords to ``share`` of their length, with both ends displaced; per segment."""

    cable: HeldCable
    share: float = MAX_CHORD_RATIO

    def __call__(self, boxes: Boxes) -> Enclosure:
        """Enclose the margin in each box."""
        time, half, instant = boxes.instants()
        team = TeamStates.at(self.cable.motion, time, half)
        first, last = boxes.group, boxes.group + 1
        start, end = team.position[instant, first], team.position[instant, last]
        allowed = self.share * self.cable.lengths[first] - 2.0 * self.cable.tracking
        growth = team.drift(instant, last, team.velocity[instant, first])
        growth += team.deviation[instant, first]
        high = allowed - np.linalg.norm(end - start, axis=-1)
        return Enclosure.over_time(high, growth, 0.5 * (start + end))


@dataclass(frozen=True, eq=False)
class AboveFloor:
    """Heights of the lowest points of strands above the floor (z = 0), less the required height."""

    cable: HeldCable
    diameter: float
    required: float

    def __call__(self, boxes: Boxes) -> Enclosure:
        """Enclose the margin in each box."""
        time, half, instant = boxes.instants()
        motion = self.cable.motion
        moved, _ = self._movement(boxes, TeamStates.at(motion, time, half), instant)
        still_team = TeamStates.at(motion, time, np.zeros_like(half))
        still, lowest = self._movement(boxes, still_team, instant)
        high = lowest[:, 2] - still - 0.5 * self.diameter - self.required
        # The whole strand's sensitivity bounds the lowest point's: only time is halved.
        return Enclosure.over_time(high, np.maximum(moved - still, 0.0), lowest)

    def _movement(self, boxes: Boxes, team: TeamStates, instant: Ints) -> tuple[Floats, Floats]:
        """Bounds of the vertical movement of strands (m,), and their lowest points (m, 3)."""
        segment = boxes.group
        level = 0.5 * (team.velocity[instant, segment] + team.velocity[instant, segment + 1])
        level[:, 2] = 0.0
        strand = pieces(
            team, self.cable, Selection.whole(instant, segment),
            Displacement.of_both_ends(level, self.cable.tracking),
        )  # fmt: skip
        # The lowest point is where the tangent is level; in wind, gravity is not vertical.
        strands = strand.strands
        level_slope = strands.heading[:, 2] / strands.down[:, 2]
        along = (level_slope - strands.slope) * strands.parameter / strands.length
        along = np.clip(along, 0.0, 1.0)
        up = np.broadcast_to(np.array([0.0, 0.0, 1.0]), (len(boxes), 3))
        moved = strand.movement(along, up).piece + strand.swing.most
        return moved, strands.points_at(along)


@dataclass(frozen=True, eq=False)
class HeightLimit:
    """Vertical distances of grip points from a height; per vehicle.

    ``sign`` 1 requires grip points above ``height``, −1 below it.
    """

    motion: BoundedMotion
    height: float
    sign: float

    def __call__(self, boxes: Boxes) -> Enclosure:
        """Enclose the margin in each box."""
        time, half, instant = boxes.instants()
        team = TeamStates.at(self.motion, time, half)
        place = team.position[instant, boxes.group]
        climb = np.abs(team.velocity[instant, boxes.group, 2]) * half[instant]
        climb += team.deviation[instant, boxes.group]
        return Enclosure.over_time(self.sign * (place[:, 2] - self.height), climb, place)


@dataclass(frozen=True, eq=False)
class DerivativeLimit:
    """Margins of a derivative of vehicles' positions to ``largest``; per vehicle.

    ``order`` 1 limits speeds in m/s, 2 accelerations in m/s².
    """

    motion: BoundedMotion
    largest: float
    order: Literal[1, 2]

    def __call__(self, boxes: Boxes) -> Enclosure:
        """Enclose the margin in each box."""
        time, half, instant = boxes.instants()
        motion, state = self.motion, self.motion.at(time)
        change = motion.acceleration_bound if self.order == 1 else motion.jerk_bound
        bound = change(time - half, time + half)[instant, boxes.group]
        size = np.linalg.norm(state[self.order][instant, boxes.group], axis=-1)
        place = state[0][instant, boxes.group]
        return Enclosure.over_time(self.largest - size, bound * boxes.half[:, 0], place)
