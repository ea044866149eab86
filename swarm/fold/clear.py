"""How much the things of a team miss the distances that they should keep: costs for the planner.

Quick and sampled, for choosing among many motions; what holds for certain is said by the
certificate alone. All distances are between nominal places, so each asks for what tracking errors
may eat on top of the clearance. A strand answers its ends the more, the tauter it is.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from swarm.cable.catenary import hang
from swarm.compiled import compiled
from swarm.fold.answer import PIECES, Numbers
from swarm.fold.margins import Margins
from swarm.fold.tangles import boxed, margins_kept

Floats = npt.NDArray[np.float64]
Index = Any


@dataclass(frozen=True, eq=False)
class Strands:
    """Hanging strands: points (…, PIECES + 1, 3), their boxes, chord per length and length (…,)."""

    points: Floats
    middle: Floats
    reach: Floats
    ratio: Floats
    length: Floats

    def __getitem__(self, which: Index) -> "Strands":
        return Strands(
            self.points[which],
            self.middle[which],
            self.reach[which],
            self.ratio[which],
            self.length[which],
        )


def strands(start: Floats, end: Floats, length: npt.ArrayLike) -> Strands:
    """Hang strands of given lengths between ends (…, 3); over-stretched ones are straight."""
    chord = np.linalg.norm(end - start, axis=-1)
    length = np.broadcast_to(np.asarray(length, dtype=np.float64), chord.shape)
    enough = np.maximum(length, chord * 1.001 + 1e-9)
    points = hang(start, end, enough).points(np.linspace(0.0, 1.0, PIECES + 1))
    middle, reach = np.empty(start.shape), np.empty(start.shape)
    boxed(points.reshape(-1, *points.shape[-2:]), middle.reshape(-1, 3), reach.reshape(-1, 3))
    return Strands(points, middle, reach, chord / length, length)


def strand_cost(one: Strands, other: Strands, margins: Margins) -> Floats:
    """Cost (b,) of strands being too close to others, pair by pair; they do not share a vehicle."""
    kept = np.empty(len(one.points))
    margins_kept(one.points, one.ratio, other.points, other.ratio, margins, kept)
    return shortfall(kept / (margins.cable + 2.0 * margins.tracking))


def meeting(one: Strands, other: Strands) -> tuple[Floats, Floats]:
    """Where strands (b) and others meet in plan view, as shares (b,) of their spans, 0…1 within.

    A strand hangs in a vertical plane, so from above both are straight.
    """
    p, q = one.points[:, 0, :2], other.points[:, 0, :2]
    return shares(p, one.points[:, -1, :2] - p, q, other.points[:, -1, :2] - q)


def shares(p: Floats, u: Floats, q: Floats, w: Floats) -> tuple[Floats, Floats]:
    """Shares (b,) of u (b, 2) and w at which lines from p along u and from q along w meet.

    Where they are parallel they meet at infinity.
    """
    area = _cross(u, w)
    parallel = np.abs(area) < 1e-12
    area = np.where(parallel, 1.0, area)
    here, there = _cross(q - p, w) / area, _cross(q - p, u) / area
    return np.where(parallel, np.inf, here), np.where(parallel, np.inf, there)


def _cross(one: Floats, other: Floats) -> Floats:
    product: Floats = one[..., 0] * other[..., 1] - one[..., 1] * other[..., 0]
    return product


@compiled
def shortfall(margin: Numbers) -> Numbers:
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
    return float(shortfall(2.0 * (max(level, above) - 1.0) + 0.2))
