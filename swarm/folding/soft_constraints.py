"""Costs of missed margins, for the planner's choice among many motions.

Fast and sampled: only the certificate bounds distances. All distances are between nominal
positions, so each margin includes what tracking errors may take of a clearance.
"""

from typing import TypeVar

import numpy as np
import numpy.typing as npt

from swarm.folding.margins import Margins, PenaltyModel
from swarm.folding.outlines import Outlines
from swarm.folding.strand_clearance import spare_margins
from swarm.geometry.sensitivity import sensitivity_tables
from swarm.jit import compiled, inner

Floats = npt.NDArray[np.float64]
Numbers = TypeVar("Numbers", float, Floats)

_MISS, _MISS_SQUARED, _SLIGHT = 5.0, 10.0, 5e-3
"""Cost of a missed unit of margin, of its square, and of the square of the part of one further unit
that is not there: misses cost a thousand times as much as small margins."""

_VEHICLE_UNIT, _VEHICLE_SPARE = 2.0, 0.2
"""Units of margin per required distance of two vehicles beyond it, and units at that distance."""


def strand_costs(first: Outlines, second: Outlines, margins: Margins) -> Floats:
    """Return the cost (b,) of the distance of strands, pair by pair; they share no vehicle."""
    spare = np.empty(len(first.points))
    spare_margins(first, second, PenaltyModel(margins, sensitivity_tables()), spare)
    return margin_costs(spare / (margins.cable + 2.0 * margins.tracking))


def margin_costs(margin: Numbers) -> Numbers:
    """Return the cost of margins in units of the required one: steep below 0, slight below 1."""
    short = np.maximum(-margin, 0.0)
    slight = np.maximum(1.0 - margin, 0.0)
    cost: Numbers = _MISS * short + _MISS_SQUARED * short**2 + _SLIGHT * slight**2
    return cost


margin_cost = compiled(margin_costs)
"""As :func:`margin_costs`, compiled for one margin."""


@inner
def vehicle_cost(first: Floats, second: Floats, margins: Margins) -> float:
    """Return the cost of the distance of two vehicles at positions (3,)."""
    error = 2.0 * margins.tracking
    level = np.hypot(first[0] - second[0], first[1] - second[1]) / (margins.vehicle + error)
    above = abs(first[2] - second[2]) / (margins.downwash + error)
    return float(margin_cost(_VEHICLE_UNIT * (max(level, above) - 1.0) + _VEHICLE_SPARE))
