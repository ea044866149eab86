"""How much the things of a team miss the distances that they should keep: costs for the planner.

Quick and sampled, for choosing among many motions; what holds for certain is said by the
certificate alone. All distances are between nominal places, so each asks for what tracking errors
may eat on top of the clearance. A strand answers its ends the more, the tauter it is.
"""

from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from swarm.folding.end_sensitivity import PIECES
from swarm.folding.margins import Margins
from swarm.folding.strand_clearance import spare_margins
from swarm.geometry import catenary_kernel
from swarm.geometry.distance import Box, bounding_boxes, point_distance
from swarm.jit import compiled

Floats = npt.NDArray[np.float64]
Index = Any
Numbers = TypeVar("Numbers", float, Floats)


@dataclass(frozen=True, eq=False)
class Outlines:
    """Hanging strands: outlines (…, PIECES + 1, 3), their boxes, chord per length, length (…,)."""

    points: Floats
    middle: Floats
    reach: Floats
    ratio: Floats
    length: Floats

    def __getitem__(self, which: Index) -> "Outlines":
        return Outlines(
            self.points[which],
            self.middle[which],
            self.reach[which],
            self.ratio[which],
            self.length[which],
        )


def outline_strands(start: Floats, end: Floats, length: npt.ArrayLike) -> Outlines:
    """Hang strands of given lengths between ends (…, 3); over-stretched ones are straight."""
    chord = np.linalg.norm(end - start, axis=-1)
    length = np.broadcast_to(np.asarray(length, dtype=np.float64), chord.shape)
    points = np.empty((*chord.shape, PIECES + 1, 3))
    middle, reach = np.empty(start.shape), np.empty(start.shape)
    corners = points.reshape(-1, PIECES + 1, 3)
    _outlined(start.reshape(-1, 3), end.reshape(-1, 3), length.ravel(), corners)
    bounding_boxes(corners, Box(middle.reshape(-1, 3), reach.reshape(-1, 3)))
    return Outlines(points, middle, reach, chord / length, length)


@compiled
def _outlined(start: Floats, end: Floats, length: Floats, points: Floats) -> None:
    """Fill in the outlines (q, k, 3) of strands; over-stretched ones are straight."""
    for q in range(len(length)):
        chord = point_distance(start[q], end[q])
        catenary_kernel.strand_polygon(
            start[q], end[q], max(length[q], chord * 1.001 + 1e-9), points[q]
        )


def strand_costs(one: Outlines, other: Outlines, margins: Margins) -> Floats:
    """Cost (b,) of strands being too close to others, pair by pair; they do not share a vehicle."""
    kept = np.empty(len(one.points))
    spare_margins(one.points, one.ratio, other.points, other.ratio, margins, kept)
    return margin_cost(kept / (margins.cable + 2.0 * margins.tracking))


@compiled
def margin_cost(margin: Numbers) -> Numbers:
    """Cost of margins in units of what is wanted: steep below 0, slight below 1."""
    short = np.maximum(-margin, 0.0)
    slight = np.maximum(1.0 - margin, 0.0)
    cost: Numbers = 5.0 * short + 10.0 * short**2 + 5e-3 * slight**2
    return cost


@compiled
def vehicle_cost(one: Floats, other: Floats, margins: Margins) -> float:
    """Cost of a vehicle at (3,) being too close to another."""
    error = 2.0 * margins.tracking
    level = np.hypot(one[0] - other[0], one[1] - other[1]) / (margins.vehicle + error)
    above = abs(one[2] - other[2]) / (margins.downwash + error)
    return float(margin_cost(2.0 * (max(level, above) - 1.0) + 0.2))
