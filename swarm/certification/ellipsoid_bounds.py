"""Cable on the floor and half lifted: where it can be at all, without a model of friction.

A segment of length ℓ, held at p and q, stays within the ellipsoid |x − p| + |x − q| ≤ ℓ, however it
lies. So do all displaced ones within that of ℓ + 2·tracking. As long as these keep apart nothing
can entangle; neighbours share a vehicle and are not compared.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from swarm.certification.branch_and_bound import Boxes, Enclosure
from swarm.certification.strands import HeldCable, Team, unit
from swarm.geometry.distance import point_segment, segment_segment

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class ReachPairs:
    """Distances between all that two segments can reach, less what is required, surface to surface.

    ``pairs`` (q, 2) of segments that are not neighbours.
    """

    cable: HeldCable
    pairs: Ints
    diameter: float
    required: float

    def __call__(self, boxes: Boxes) -> Enclosure:
        """Enclose the margin in each box."""
        time, half, when = boxes.instants()
        team = Team.at(self.cable.course, time, half)
        first, second = self.pairs[boxes.pair].T
        ends_first, ends_second = _ends(team, when, first), _ends(team, when, second)
        mean = 0.25 * sum(
            team.velocity[when, who] for who in (first, first + 1, second, second + 1)
        )
        ball = 2.0 * self.cable.tracking
        lengths = self.cable.lengths
        drift_first, drift_second = (
            2.0 * np.maximum(*(team.drift(when, who, mean) for who in (segment, segment + 1)))
            for segment in (first, second)
        )
        closest = segment_segment(ends_first, ends_second)
        between = _at(ends_second, closest.second) - _at(ends_first, closest.first)
        directions = [between, ends_second.mean(axis=1) - ends_first.mean(axis=1)]
        directions += [ends_first[:, 1] - ends_first[:, 0], ends_second[:, 1] - ends_second[:, 0]]
        gaps = [
            _gap(
                direction,
                (ends_first, lengths[first] + ball + spare_first),
                (ends_second, lengths[second] + ball + spare_second),
            )
            for direction in (unit(towards) for towards in directions)
            for spare_first, spare_second in ((drift_first, drift_second), (0.0, 0.0))
        ]
        shift = self.diameter + self.required
        low, high = np.max(gaps[::2], axis=0) - shift, np.max(gaps[1::2], axis=0) - shift
        nothing = np.zeros_like(low)
        return Enclosure(
            low,
            high,
            np.stack([high - low, nothing, nothing], axis=1),
            _at(ends_first, closest.first) + 0.5 * between,
        )


@dataclass(frozen=True, eq=False)
class ReachVehicles:
    """Distances of vehicles from all that others' segments can reach, less what is required.

    ``pairs`` (q, 2) of a vehicle and a segment that it does not hold. A vehicle is a rod of
    ``height`` from its grip point upwards, ``radius`` thick.
    """

    cable: HeldCable
    pairs: Ints
    radius: float
    height: float
    diameter: float
    required: float

    def __call__(self, boxes: Boxes) -> Enclosure:
        """Enclose the margin in each box."""
        time, half, when = boxes.instants()
        team = Team.at(self.cable.course, time, half)
        vehicle, segment = self.pairs[boxes.pair].T
        grip = team.position[when, vehicle]
        rod = np.stack([grip, grip + np.array([0.0, 0.0, self.height])], axis=1)
        ends = _ends(team, when, segment)
        # A step of d changes the sum of the distances from the ends by 2d at most.
        sums = sum(point_segment(ends[:, side], rod).distance for side in (0, 1))
        high = 0.5 * (sums - self.cable.lengths[segment]) - 2.0 * self.cable.tracking
        high -= self.radius + 0.5 * self.diameter + self.required
        reference = team.velocity[when, vehicle]
        drift = np.maximum(*(team.drift(when, who, reference) for who in (segment, segment + 1)))
        drift += team.swerve[when, vehicle]
        nothing = np.zeros_like(high)
        return Enclosure(high - drift, high, np.stack([drift, nothing, nothing], axis=1), grip)


def _gap(normal: Floats, first: tuple[Floats, Floats], second: tuple[Floats, Floats]) -> Floats:
    """Gap (b,) between two ellipsoids (foci, length of string) along unit vectors, either way."""
    apart = np.einsum("bi,bi->b", second[0].mean(axis=1) - first[0].mean(axis=1), normal)
    gap: Floats = np.abs(apart) - _half_width(normal, *first) - _half_width(normal, *second)
    return gap


def _half_width(normal: Floats, foci: Floats, string: Floats) -> Floats:
    chord = foci[:, 1] - foci[:, 0]
    along = np.einsum("bi,bi->b", chord, normal)
    squared = string * string - np.einsum("bi,bi->b", chord, chord) + along * along
    width: Floats = 0.5 * np.sqrt(np.maximum(squared, along * along))
    return width


def _ends(team: Team, when: Ints, segment: Ints) -> Floats:
    return np.stack([team.position[when, segment], team.position[when, segment + 1]], axis=1)


def _at(ends: Floats, along: Floats) -> Floats:
    return ends[:, 0] + along[:, None] * (ends[:, 1] - ends[:, 0])
