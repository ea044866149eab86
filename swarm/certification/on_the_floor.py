"""Certified conditions for cable on the floor, half lifted or descending; no model of friction.

It lies, is drawn out, or descends without change: where these hold, the model of hanging cable is
not needed. A segment of length ℓ between grip points p and q stays within the ellipsoid
|x − p| + |x − q| ≤ ℓ, whatever its shape. All displaced ones stay within that of ℓ + 2·tracking.
Where these ellipsoids are apart, segments cannot entangle. Neighbours share a vehicle and are not
compared.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from swarm.certification.branch_and_bound import Boxes, Enclosure
from swarm.certification.motion_bounds import BoundedMotion, TeamStates
from swarm.certification.strand_pieces import HeldCable
from swarm.geometry.distance import norms, point_segment, segment_segment

Floats = npt.NDArray[np.float64]
RIGID = 0.005
"""Metres by which a team may change its shape in what counts as a common vertical descent. No
distance relies on it: hanging strands are certified in the descent as in any other motion."""

BELOW = 1e-6
"""Metres by which a grip point may be below the floor: the last digit of motion files. No distance
relies on it."""


@dataclass(frozen=True, eq=False)
class DrawnOut:
    """Margins of a line's bends to 60° in plan view; per inner vehicle, metres.

    The projection of the shorter chord on the longer one, less half the shorter one's length.
    Strands of a line with smaller bends keep apart, whether they hang or lie below it.
    """

    motion: BoundedMotion

    def __call__(self, boxes: Boxes) -> Enclosure:
        """Enclose the margin in each box."""
        time, half, instant = boxes.instants()
        team = TeamStates.at(self.motion, time, half)
        middle = boxes.group + 1
        at, velocity = team.position[instant, middle], team.velocity[instant, middle]
        before = (at - team.position[instant, middle - 1])[:, :2]
        after = (team.position[instant, middle + 1] - at)[:, :2]
        sizes = np.stack([np.linalg.norm(chord, axis=1) for chord in (before, after)])
        along = np.einsum("bi,bi->b", before, after) / np.maximum(sizes.max(axis=0), 1e-12)
        growth = sum(
            team.drift(instant, other, velocity) + team.deviation[instant, middle]
            for other in (middle - 1, middle + 1)
        )
        high = along - 0.5 * sizes.min(axis=0)
        return Enclosure.over_time(high, 1.5 * np.asarray(growth), at)


@dataclass(frozen=True, eq=False)
class BesideRotors:
    """Margins of chords to the rims of the rotor discs at both ends; per segment, metres.

    Cable on the floor or below a chord stays out of both discs where the chord rises less than the
    line from a grip to the rim. At the segment's far end, for every displacement within the
    tracking radius.
    """

    motion: BoundedMotion
    tracking: float
    rim: float
    """Height of the disc over the grip, per metre from its axis to the rim."""

    def __call__(self, boxes: Boxes) -> Enclosure:
        """Enclose the margin in each box."""
        time, half, instant = boxes.instants()
        team = TeamStates.at(self.motion, time, half)
        first, last = boxes.group, boxes.group + 1
        step = team.position[instant, last] - team.position[instant, first]
        span, rise = np.hypot(step[:, 0], step[:, 1]), np.abs(step[:, 2])
        growth = team.drift(instant, last, team.velocity[instant, first])
        growth += team.deviation[instant, first]
        ball = 2.0 * self.tracking
        high = self.rim * (span - ball) - (rise + ball)
        middle = 0.5 * (team.position[instant, first] + team.position[instant, last])
        return Enclosure.over_time(high, (1.0 + self.rim) * growth, middle)


@dataclass(frozen=True, eq=False)
class RigidDescent:
    """Margins of a team's change of shape to RIGID while it descends; per vehicle, metres.

    ``starts`` (s,) are the times at which a descent begins.
    """

    motion: BoundedMotion
    starts: Floats

    def __call__(self, boxes: Boxes) -> Enclosure:
        """Enclose the margin in each box."""
        time, half, instant = boxes.instants()
        team = TeamStates.at(self.motion, time, half)
        begun = np.searchsorted(self.starts, time, side="right") - 1
        moved = team.position - self.motion.at(self.starts)[0][begun]
        moved[..., 2] -= moved[:, :1, 2].copy()
        down = team.velocity[instant, 0] * [0.0, 0.0, 1.0]
        doubt = team.drift(instant, boxes.group, down) + team.deviation[instant, 0]
        high = RIGID - np.linalg.norm(moved[instant, boxes.group], axis=-1)
        return Enclosure.over_time(high, doubt, team.position[instant, boxes.group])


Ints = npt.NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class ReachPairs:
    """Distances between the ellipsoids of two segments, surface to surface, less the required one.

    ``pairs`` (q, 2) of segments that are not neighbours.
    """

    cable: HeldCable
    pairs: Ints
    diameter: float
    required: float

    def __call__(self, boxes: Boxes) -> Enclosure:
        """Enclose the margin in each box."""
        time, half, instant = boxes.instants()
        team = TeamStates.at(self.cable.motion, time, half)
        first, second = self.pairs[boxes.group].T
        ends_first, ends_second = _ends(team, instant, first), _ends(team, instant, second)
        mean = 0.25 * sum(
            team.velocity[instant, vehicle] for vehicle in (first, first + 1, second, second + 1)
        )
        ball = 2.0 * self.cable.tracking
        lengths = self.cable.lengths
        drift_first, drift_second = (
            2.0 * np.maximum(*(team.drift(instant, k, mean) for k in (segment, segment + 1)))
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
            for direction in (_unit(towards) for towards in directions)
            for spare_first, spare_second in ((drift_first, drift_second), (0.0, 0.0))
        ]
        shift = self.diameter + self.required
        low, high = np.max(gaps[::2], axis=0) - shift, np.max(gaps[1::2], axis=0) - shift
        place = _at(ends_first, closest.first) + 0.5 * between
        return Enclosure(low, high, (high - low)[:, None], place)


@dataclass(frozen=True, eq=False)
class ReachVehicles:
    """Distances of vehicles from the ellipsoids of others' segments, less the required distance.

    ``pairs`` (q, 2) of a vehicle and a segment that it does not hold. A vehicle is a capsule from
    its grip point ``height`` upwards, with ``radius``.
    """

    cable: HeldCable
    pairs: Ints
    radius: float
    height: float
    diameter: float
    required: float

    def __call__(self, boxes: Boxes) -> Enclosure:
        """Enclose the margin in each box."""
        time, half, instant = boxes.instants()
        team = TeamStates.at(self.cable.motion, time, half)
        vehicle, segment = self.pairs[boxes.group].T
        grip = team.position[instant, vehicle]
        axis = np.stack([grip, grip + np.array([0.0, 0.0, self.height])], axis=1)
        ends = _ends(team, instant, segment)
        # A step of d changes the sum of the distances from the ends by 2d at most.
        sums = sum(point_segment(ends[:, side], axis).distance for side in (0, 1))
        high = 0.5 * (sums - self.cable.lengths[segment]) - 2.0 * self.cable.tracking
        high -= self.radius + 0.5 * self.diameter + self.required
        frame = team.velocity[instant, vehicle]
        drift = np.maximum(*(team.drift(instant, k, frame) for k in (segment, segment + 1)))
        drift += team.deviation[instant, vehicle]
        return Enclosure.over_time(high, drift, grip)


def _gap(normal: Floats, first: tuple[Floats, Floats], second: tuple[Floats, Floats]) -> Floats:
    """Gap (b,) between two ellipsoids (foci, sum of distances) along unit vectors, either way."""
    apart = np.einsum("bi,bi->b", second[0].mean(axis=1) - first[0].mean(axis=1), normal)
    gap: Floats = np.abs(apart) - _half_width(normal, *first) - _half_width(normal, *second)
    return gap


def _half_width(normal: Floats, foci: Floats, distances: Floats) -> Floats:
    chord = foci[:, 1] - foci[:, 0]
    along = np.einsum("bi,bi->b", chord, normal)
    squared = distances * distances - np.einsum("bi,bi->b", chord, chord) + along * along
    width: Floats = 0.5 * np.sqrt(np.maximum(squared, along * along))
    return width


def _ends(team: TeamStates, instant: Ints, segment: Ints) -> Floats:
    return np.stack([team.position[instant, segment], team.position[instant, segment + 1]], axis=1)


def _at(ends: Floats, along: Floats) -> Floats:
    return ends[:, 0] + along[:, None] * (ends[:, 1] - ends[:, 0])


def _unit(vector: Floats) -> Floats:
    """Return unit vectors (b, 3); straight up for a vector of no length."""
    size = norms(vector)[..., None]
    return np.where(size > 1e-12, vector / np.maximum(size, 1e-12), [0.0, 0.0, 1.0])
