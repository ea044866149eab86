"""Certified bounds of the distances between strands.

For a box (two strands, an interval of time, a piece of each) both pieces at the middle instant lie
near their chords. A unit vector n that separates the chords also separates the displaced pieces,
less their movement along n: the bow of each piece over its chord, the movement of its grip points
(:mod:`.strand_pieces`), and the radius of the tube in which it swings (:mod:`.swing_tube`).
"""

from dataclasses import dataclass
from typing import Any, TypeVar, cast

import numpy as np
import numpy.typing as npt

from swarm.certification.branch_and_bound import Boxes, Enclosure
from swarm.certification.motion_bounds import TeamStates
from swarm.certification.strand_pieces import (
    Displacement,
    HeldCable,
    Pieces,
    Selection,
    pieces,
)
from swarm.geometry.distance import norms, segment_segment
from swarm.geometry.sensitivity import BOTH_ENDS, FAR_END, NEAR_END

Array = TypeVar("Array", bound=npt.NDArray[Any])
Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class StrandPairs:
    """Distances of strands, surface to surface, less the required distance.

    ``pairs`` (q, 2) of segments, first < second; ``parts`` (q, 2, 2) the fractions between which
    each is compared. The frame of neighbours is their shared grip: in it, tracking errors displace
    the other ends by up to twice the tracking radius.
    """

    cable: HeldCable
    pairs: Ints
    parts: Floats
    diameter: float
    required: float

    def __call__(self, boxes: Boxes) -> Enclosure:
        """Enclose the margin in each box; coordinates are time and both fractions."""
        time, half, instant = boxes.instants()
        team = TeamStates.at(self.cable.motion, time, half)
        first, second = self.pairs[boxes.group].T
        neighbours = second == first + 1
        velocity = team.velocity
        shared = velocity[instant, second]
        mean = 0.25 * (velocity[instant, first] + velocity[instant, first + 1])
        mean += 0.25 * (shared + velocity[instant, second + 1])
        frame = np.where(neighbours[:, None], shared, mean)
        tracking = np.where(neighbours, 2.0 * self.cable.tracking, self.cable.tracking)
        # The shared grip rests in its frame, but the frame itself deviates from uniform motion.
        deviation = np.where(neighbours, team.deviation[instant, second], 0.0)
        # One call for both strands: most batches are so small that the calls take longer than the
        # computation.
        both = pieces(
            team,
            self.cable,
            Selection(
                _twice(instant),
                np.concatenate([first, second]),
                boxes.middle[:, 1:].T.ravel(),
                boxes.half[:, 1:].T.ravel(),
                self.parts[boxes.group].swapaxes(0, 1).reshape(-1, 2),
            ),
            Displacement(
                _twice(frame),
                np.concatenate([np.where(neighbours, end, BOTH_ENDS) for end in _OTHER_ENDS]),
                _twice(tracking),
                _twice(deviation),
            ),
        )
        found = _distance(both, self.diameter + self.required)
        counts = (both.shapes.begin < both.shapes.end).reshape(2, -1).all(axis=0)
        return Enclosure(
            np.where(counts, found.low, np.inf),
            np.where(counts, found.high, np.inf),
            found.doubts,
            found.place,
        )


_OTHER_ENDS = (NEAR_END, FAR_END)
"""Ends of the first and of the second neighbour that do not rest in the frame of their grip."""


def _twice(values: Array) -> Array:
    """Return the values (b, …) for the first strands, and again for the second ones."""
    return cast("Array", np.concatenate([values, values]))


def _distance(both: Pieces, required: float) -> Enclosure:
    """Enclose the distances less the required one of pieces (2b,), b first and b second ones."""
    a, b = both.ends.reshape(2, -1, 2, 3)
    closest = segment_segment(a, b)
    at_a = a[:, 0] + closest.first[:, None] * (a[:, 1] - a[:, 0])
    at_b = b[:, 0] + closest.second[:, None] * (b[:, 1] - b[:, 0])
    normal = unit(at_a - at_b)
    # Any unit vector gives a true bound: rounding in the closest points does no harm.
    reach_a = np.minimum(*np.einsum("bki,bi->kb", a, normal))
    reach_b = np.maximum(*np.einsum("bki,bi->kb", b, normal))
    moved = both.movement(np.concatenate([closest.first, closest.second]), _twice(normal))
    bow_a, bow_b = _halves(both.bow)
    piece_a, piece_b = _halves(moved.piece)
    point_a, point_b = _halves(moved.point)
    tracking_a, tracking_b = _halves(moved.tracking)
    most_a, most_b = _halves(both.swing.most)
    least_a, least_b = _halves(both.swing.least)
    in_time_a, in_time_b = _halves(both.swing.in_time)
    in_time = point_a - tracking_a + point_b - tracking_b + in_time_a + in_time_b
    in_piece = 2.0 * both.bow + moved.piece - moved.point + both.swing.in_piece
    bows = bow_a + bow_b
    return Enclosure(
        low=reach_a - reach_b - bows - (piece_a + piece_b + most_a + most_b) - required,
        high=closest.distance + bows - (tracking_a + tracking_b + least_a + least_b) - required,
        doubts=np.stack([in_time, *_halves(in_piece)], axis=1),
        place=0.5 * (at_a + at_b),
    )


def _halves(values: Floats) -> Floats:
    """Return the values (2b,) of the first and of the second strands: (2, b)."""
    return values.reshape(2, -1)


def unit(vector: Floats) -> Floats:
    """Return unit vectors (b, 3); straight up for a vector of no length."""
    size = norms(vector)[..., None]
    return np.where(size > 1e-12, vector / np.maximum(size, 1e-12), [0.0, 0.0, 1.0])
