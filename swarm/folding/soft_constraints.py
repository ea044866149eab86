"""Costs of missed margins, for the planner's choice among many motions.

Fast and sampled: only the certificate bounds distances. All distances are between nominal
positions, so each margin includes what tracking errors may take of a clearance. The tauter a
strand, the more it moves with its ends.
"""

from typing import TypeVar

import numpy as np
import numpy.typing as npt

from swarm.folding.margins import Margins
from swarm.folding.outlines import Outlines
from swarm.folding.strand_clearance import spare_margins
from swarm.jit import compiled

Floats = npt.NDArray[np.float64]
Numbers = TypeVar("Numbers", float, Floats)


def strand_costs(one: Outlines, other: Outlines, margins: Margins) -> Floats:
    """Return the cost (b,) of the distance of strands, pair by pair; they share no vehicle."""
    spare = np.empty(len(one.points))
    spare_margins(one, other, margins, spare)
    return margin_cost(spare / (margins.cable + 2.0 * margins.tracking))


@compiled
def margin_cost(margin: Numbers) -> Numbers:
    """Return the cost of margins in units of the required one: steep below 0, slight below 1."""
    short = np.maximum(-margin, 0.0)
    slight = np.maximum(1.0 - margin, 0.0)
    cost: Numbers = 5.0 * short + 10.0 * short**2 + 5e-3 * slight**2
    return cost


@compiled
def vehicle_cost(one: Floats, other: Floats, margins: Margins) -> float:
    """Return the cost of the distance of two vehicles at positions (3,)."""
    error = 2.0 * margins.tracking
    level = np.hypot(one[0] - other[0], one[1] - other[1]) / (margins.vehicle + error)
    above = abs(one[2] - other[2]) / (margins.downwash + error)
    return float(margin_cost(2.0 * (max(level, above) - 1.0) + 0.2))
