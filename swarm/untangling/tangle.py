"""How tangled a team is: 0 on a line, and about ½ for each crossing of its strands; compiled.

The measure is the sum of the Gauss integrals of all pairs of strands that share no vehicle, without
their signs, and of the parts by which segments do not yet lead ahead along a line.
"""

import numpy as np
import numpy.typing as npt

from swarm.geometry.distance import gauss_integral
from swarm.jit import compiled, inner
from swarm.signatures import Floats1
from swarm.untangling.moved_vehicle import TeamState

Floats = npt.NDArray[np.float64]

HEADINGS = np.pi / 12.0 * np.arange(24.0)
"""Headings of the line that are compared, radians."""

_COSINES, _SINES = np.cos(HEADINGS), np.sin(HEADINGS)

_AHEAD = 0.45
"""Share of its length by which each segment should lead along the line: half of a taut one."""

_STRAIGHT = 0.15
"""Weight of a segment that does not lead ahead at all, over that of a crossing seen from all
sides."""


@inner
def crossed(team: TeamState, first: int, last: int) -> float:
    """Return the Gauss integrals of pairs with one of the strands ``first`` … ``last`` − 1."""
    total = 0.0
    for i in range(first, last):
        for j in range(len(team.lengths)):
            # A pair of two of these strands counts once.
            if abs(i - j) >= 2 and (j > i or j < first):
                # Two edges to the middle and back are enough for the shape of a strand.
                half = (team.points.shape[1] - 1) // 2
                total += abs(gauss_integral(team.points[i, ::half], team.points[j, ::half]))
    return total


@compiled
def not_ahead(team: TeamState, first: int, last: int, missing: Floats1) -> None:
    """Add by which parts strands ``first`` … ``last`` − 1 do not lead ahead along each heading."""
    for i in range(first, last):
        x = team.positions[i + 1, 0] - team.positions[i, 0]
        y = team.positions[i + 1, 1] - team.positions[i, 1]
        wanted = _AHEAD * team.lengths[i]
        for k in range(len(missing)):
            ahead = (x * _COSINES[k] + y * _SINES[k]) / wanted
            missing[k] += _AHEAD * max(1.0 - ahead, 0.0)


@inner
def weighted(crossings: float, missing: Floats) -> float:
    """Return how tangled a team is, from its Gauss integrals and its parts not ahead."""
    least = np.inf
    for part in missing:
        least = min(least, part)
    return crossings + _STRAIGHT * least
