"""Certified bounds of the distances between strands.

For a box (two strands, an interval of time, a piece of each) both pieces at the middle instant lie
near their chords. A unit vector n that separates the chords also separates the displaced pieces,
less their movement along n: the bow of each piece over its chord, the movement of its grip points
(:mod:`.strand_pieces`), and the radius of the tube in which it swings (:mod:`.swing_tube`).
"""

from dataclasses import dataclass

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
        parts = self.parts[boxes.group]
        a, b = (
            pieces(
                team,
                self.cable,
                Selection(
                    instant, segment, boxes.middle[:, 1 + side], boxes.half[:, 1 + side],
                    parts[:, side],
                ),
                Displacement(frame, np.where(neighbours, ends, BOTH_ENDS), tracking, deviation),
            )
            for side, (segment, ends) in enumerate(((first, NEAR_END), (second, FAR_END)))
        )  # fmt: skip
        found = _distance(a, b, self.diameter + self.required)
        counts = (a.shapes.begin < a.shapes.end) & (b.shapes.begin < b.shapes.end)
        return Enclosure(
            np.where(counts, found.low, np.inf),
            np.where(counts, found.high, np.inf),
            found.doubts,
            found.place,
        )


def _distance(a: Pieces, b: Pieces, required: float) -> Enclosure:
    closest = segment_segment(a.ends, b.ends)
    at_a = a.ends[:, 0] + closest.first[:, None] * (a.ends[:, 1] - a.ends[:, 0])
    at_b = b.ends[:, 0] + closest.second[:, None] * (b.ends[:, 1] - b.ends[:, 0])
    normal = unit(at_a - at_b)
    # Any unit vector gives a true bound: rounding in the closest points does no harm.
    reach_a = np.minimum(*np.einsum("bki,bi->kb", a.ends, normal))
    reach_b = np.maximum(*np.einsum("bki,bi->kb", b.ends, normal))
    moved_a = a.movement(closest.first, normal)
    moved_b = b.movement(closest.second, normal)
    bows = a.bow + b.bow
    moved = moved_a.piece + moved_b.piece + a.swing.most + b.swing.most
    in_ball = moved_a.tracking + moved_b.tracking + a.swing.least + b.swing.least
    in_time = moved_a.point - moved_a.tracking + moved_b.point - moved_b.tracking
    return Enclosure(
        low=reach_a - reach_b - bows - moved - required,
        high=closest.distance + bows - in_ball - required,
        doubts=np.stack(
            [
                in_time + a.swing.in_time + b.swing.in_time,
                2.0 * a.bow + moved_a.piece - moved_a.point + a.swing.in_piece,
                2.0 * b.bow + moved_b.piece - moved_b.point + b.swing.in_piece,
            ],
            axis=1,
        ),
        place=0.5 * (at_a + at_b),
    )


def unit(vector: Floats) -> Floats:
    """Return unit vectors (b, 3); straight up for a vector of no length."""
    size = norms(vector)[..., None]
    return np.where(size > 1e-12, vector / np.maximum(size, 1e-12), [0.0, 0.0, 1.0])
