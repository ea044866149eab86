"""Lower bounds of what is left to the limits of vehicles, cable and workspace."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from swarm.certification.branch_and_bound import Boxes, Enclosure
from swarm.certification.motion_bounds import Course
from swarm.certification.strands import HeldCable, Team, pieces
from swarm.geometry.sensitivity import BOTH_ENDS

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.intp]

TAUT = 0.985
"""Largest share of its cable's length that a chord may reach, whatever tracking errors do."""


def _in_time(high: Floats, doubt: Floats, place: Floats) -> Enclosure:
    nothing = np.zeros_like(high)
    return Enclosure(high - doubt, high, np.stack([doubt, nothing, nothing], axis=1), place)


@dataclass(frozen=True, eq=False)
class Slack:
    """What chords are short of ``share`` of their cable, when both ends err away; per segment."""

    cable: HeldCable
    share: float = TAUT

    def __call__(self, boxes: Boxes) -> Enclosure:
        """Enclose the margin in each box."""
        time, half, when = boxes.instants()
        team = Team.at(self.cable.course, time, half)
        first, last = boxes.pair, boxes.pair + 1
        start, end = team.position[when, first], team.position[when, last]
        allowed = self.share * self.cable.lengths[boxes.pair] - 2.0 * self.cable.tracking
        growth = team.drift(when, last, team.velocity[when, first]) + team.swerve[when, first]
        high = allowed - np.linalg.norm(end - start, axis=-1)
        return _in_time(high, growth, 0.5 * (start + end))


@dataclass(frozen=True, eq=False)
class AboveFloor:
    """Heights of the lowest points of strands above the floor (z = 0), less what is required."""

    cable: HeldCable
    diameter: float
    required: float

    def __call__(self, boxes: Boxes) -> Enclosure:
        """Enclose the margin in each box."""
        time, half, when = boxes.instants()
        course = self.cable.course
        moved, _ = self._moved(boxes, Team.at(course, time, half), when)
        still, lowest = self._moved(boxes, Team.at(course, time, np.zeros_like(half)), when)
        high = lowest[:, 2] - still - 0.5 * self.diameter - self.required
        # The whole strand's sensitivity stands for the lowest point's: only time is to be cut.
        return _in_time(high, np.maximum(moved - still, 0.0), lowest)

    def _moved(self, boxes: Boxes, team: Team, when: Ints) -> tuple[Floats, Floats]:
        """How far strands move up or down at most (m,), and their lowest points (m, 3)."""
        segment = boxes.pair
        level = 0.5 * (team.velocity[when, segment] + team.velocity[when, segment + 1])
        level[:, 2] = 0.0
        whole = np.ones(len(boxes), dtype=np.intp)
        strand = pieces(
            team, self.cable, when, segment, whole, level,
            np.full(len(boxes), BOTH_ENDS), np.full(len(boxes), self.cable.tracking),
            np.zeros(len(boxes)), np.broadcast_to(np.array([0.0, 1.0]), (len(boxes), 2)),
        )  # fmt: skip
        # Level where heading and slope together are, which in wind is not where gravity's foot is.
        hung = strand.strands
        level_slope = hung.heading[:, 2] / hung.down[:, 2]
        along = np.clip((level_slope - hung.slope) * hung.parameter / hung.length, 0.0, 1.0)
        up = np.broadcast_to(np.array([0.0, 0.0, 1.0]), (len(boxes), 3))
        return strand.movement(along, up)[0], hung.points_at(along)


@dataclass(frozen=True, eq=False)
class SpeedLeft:
    """What vehicles' speeds are short of the largest; per vehicle, m/s."""

    course: Course
    largest: float

    def __call__(self, boxes: Boxes) -> Enclosure:
        """Enclose the margin in each box."""
        time, half, when = boxes.instants()
        position, velocity, _ = self.course.motion.at(time)
        bound = self.course.acceleration_bound(time - half, time + half)[when, boxes.pair]
        speed = np.linalg.norm(velocity[when, boxes.pair], axis=-1)
        return _in_time(self.largest - speed, bound * boxes.half, position[when, boxes.pair])


@dataclass(frozen=True, eq=False)
class AccelerationLeft:
    """What vehicles' accelerations are short of the largest; per vehicle, m/s²."""

    course: Course
    largest: float

    def __call__(self, boxes: Boxes) -> Enclosure:
        """Enclose the margin in each box."""
        time, half, when = boxes.instants()
        position, _, acceleration = self.course.motion.at(time)
        bound = self.course.jerk_bound(time - half, time + half)[when, boxes.pair]
        size = np.linalg.norm(acceleration[when, boxes.pair], axis=-1)
        return _in_time(self.largest - size, bound * boxes.half, position[when, boxes.pair])
