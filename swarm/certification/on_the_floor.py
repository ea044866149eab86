"""Certified conditions for cable on the floor, half lifted or descending; no model of friction.

It lies, is drawn out, or descends without change: where these hold, the model of hanging cable is
not needed. A segment of length ℓ between grip points p and q stays within the ellipsoid
|x − p| + |x − q| ≤ ℓ, whatever its shape. All displaced ones stay within that of ℓ + 2·tracking.
Where these ellipsoids are apart, segments cannot entangle. Neighbours share a vehicle and are not
compared.
"""

import numpy as np
import numpy.typing as npt

from swarm.certification.branch_and_bound import Boxes, Enclosure, Evaluator
from swarm.certification.motion_bounds import BoundedMotion, TeamStates, over_time
from swarm.certification.strand_pieces import HeldCable
from swarm.geometry.distance import norms, point_segment, segment_segment
from swarm.geometry.solids import planes_between

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.intp]
RIGID = 0.005
"""Metres by which a team may change its shape in what counts as a common vertical descent. No
distance relies on it: hanging strands are certified in the descent as in any other motion."""

BELOW = 1e-6
"""Metres by which a grip point may be below the floor: the last digit of motion files. No distance
relies on it."""


def drawn_out(motion: BoundedMotion) -> Evaluator:
    """Bound the margins of a line's bends to 60° in plan view; per inner vehicle, metres.

    The projection of the shorter chord on the longer one, less half the shorter one's length.
    Strands of a line with smaller bends keep apart, whether they hang or lie below it.
    """

    def margin(team: TeamStates, instant: Ints, group: Ints) -> tuple[Floats, Floats, Floats]:
        middle = group + 1
        at, velocity = team.position[instant, middle], team.velocity[instant, middle]
        before = (at - team.position[instant, middle - 1])[:, :2]
        after = (team.position[instant, middle + 1] - at)[:, :2]
        sizes = np.stack([np.linalg.norm(chord, axis=1) for chord in (before, after)])
        along = np.einsum("bi,bi->b", before, after) / np.maximum(sizes.max(axis=0), 1e-12)
        growth = sum(
            team.drift(instant, other, velocity) + team.deviation[instant, middle]
            for other in (middle - 1, middle + 1)
        )
        return along - 0.5 * sizes.min(axis=0), 1.5 * np.asarray(growth), at

    return over_time(motion, margin)


def beside_rotors(motion: BoundedMotion, tracking: float, rim: float) -> Evaluator:
    """Bound the margins of chords to the rims of the rotor discs at both ends; per segment, metres.

    Cable on the floor or below a chord stays out of both discs where the chord rises less than the
    line from a grip to the rim: ``rim`` metres per metre from the disc's axis. At the segment's far
    end, for every displacement within the tracking radius.
    """

    def margin(team: TeamStates, instant: Ints, first: Ints) -> tuple[Floats, Floats, Floats]:
        start, end = team.position[instant, first], team.position[instant, first + 1]
        step = end - start
        span, rise = np.hypot(step[:, 0], step[:, 1]), np.abs(step[:, 2])
        growth = team.drift(instant, first + 1, team.velocity[instant, first])
        growth += team.deviation[instant, first]
        ball = 2.0 * tracking
        high = rim * (span - ball) - (rise + ball)
        return high, (1.0 + rim) * growth, 0.5 * (start + end)

    return over_time(motion, margin)


def straight_down(motion: BoundedMotion, starts: Floats) -> Evaluator:
    """Bound the margins of a team's change of shape to RIGID in a descent; per vehicle, metres.

    ``starts`` (s,) are the times at which a descent begins.
    """

    def margin(team: TeamStates, instant: Ints, vehicle: Ints) -> tuple[Floats, Floats, Floats]:
        begun = np.searchsorted(starts, team.time, side="right") - 1
        moved = team.position - motion.at(starts)[0][begun]
        moved[..., 2] -= moved[:, :1, 2].copy()
        down = team.velocity[instant, 0] * [0.0, 0.0, 1.0]
        width = team.drift(instant, vehicle, down) + team.deviation[instant, 0]
        high = RIGID - np.linalg.norm(moved[instant, vehicle], axis=-1)
        return high, width, team.position[instant, vehicle]

    return over_time(motion, margin)


def reach_of_segments(cable: HeldCable, pairs: Ints, required: float) -> Evaluator:
    """Bound the distances between the ellipsoids of two segments, less the required distance.

    ``pairs`` (q, 2) of segments that are not neighbours; ``required`` is that of their middles.
    """

    def evaluate(boxes: Boxes) -> Enclosure:
        time, half, instant = boxes.instants()
        team = TeamStates.at(cable.motion, time, half)
        first, second = pairs[boxes.group].T
        ends_first, ends_second = _ends(team, instant, first), _ends(team, instant, second)
        mean = 0.25 * sum(
            team.velocity[instant, vehicle] for vehicle in (first, first + 1, second, second + 1)
        )
        ball, lengths = 2.0 * cable.tracking, cable.lengths
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
        low, high = np.max(gaps[::2], axis=0) - required, np.max(gaps[1::2], axis=0) - required
        place = _at(ends_first, closest.first) + 0.5 * between
        return Enclosure(low, high, (high - low)[:, None], place)

    return evaluate


def reach_of_vehicles(cable: HeldCable, pairs: Ints, height: float, required: float) -> Evaluator:
    """Bound the distances of vehicles from the ellipsoids of others' segments, less the required.

    ``pairs`` (q, 2) of a vehicle and a segment that it does not hold. ``required`` is that of the
    segment's middle from the vehicle's axis, from its grip point ``height`` upwards.
    """

    def margin(team: TeamStates, instant: Ints, group: Ints) -> tuple[Floats, Floats, Floats]:
        vehicle, segment = pairs[group].T
        grip = team.position[instant, vehicle]
        axis = np.stack([grip, grip + np.array([0.0, 0.0, height])], axis=1)
        ends = _ends(team, instant, segment)
        # A step of d changes the sum of the distances from the ends by 2d at most.
        sums = sum(point_segment(ends[:, side], axis).distance for side in (0, 1))
        high = 0.5 * (sums - cable.lengths[segment]) - 2.0 * cable.tracking
        high -= required
        frame = team.velocity[instant, vehicle]
        drift = np.maximum(*(team.drift(instant, k, frame) for k in (segment, segment + 1)))
        return high, drift + team.deviation[instant, vehicle], grip

    return over_time(cable.motion, margin)


def reach_beside_solids(
    cable: HeldCable, solids: Floats, pairs: Ints, required: float
) -> Evaluator:
    """Bound the distances of the ellipsoids of segments from convex solids (m, 12).

    Less the required distance of the segments' middles; ``pairs`` (q, 2) of a segment and a solid.
    """

    def evaluate(boxes: Boxes) -> Enclosure:
        time, half, instant = boxes.instants()
        team = TeamStates.at(cable.motion, time, half)
        segment, solid = pairs[boxes.group].T
        ends, rest = _ends(team, instant, segment), np.zeros((len(segment), 3))
        normal, wall = planes_between(solids[solid], ends)
        lengths = cable.lengths[segment] + 2.0 * cable.tracking
        drift = np.maximum(*(team.drift(instant, k, rest) for k in (segment, segment + 1)))
        middle = ends.mean(axis=1)
        beside = np.einsum("bi,bi->b", middle, normal) - wall - required
        low = beside - _half_width(normal, ends, lengths + 2.0 * drift)
        high = beside - _half_width(normal, ends, lengths)
        return Enclosure(low, high, (high - low)[:, None], middle)

    return evaluate


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
