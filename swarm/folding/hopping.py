"""Basin hopping for teams in a local minimum, such as strands that were led through each other.

Vehicles with the largest derivatives are displaced for a while, one after another and in one
direction after another, and the team is relaxed from there (Wales and Doye 1997), with a fixed list
of hops.
"""

from itertools import product

import numpy as np
import numpy.typing as npt

from swarm.folding.optimizer import RELAXING, ElasticBand

Floats = npt.NDArray[np.float64]

_MOMENTS = 4
"""Largest number of moments at which hops are tried."""

_ACCEPTED = 0.45
"""Units of missed margin up to which a moment needs no hop."""

_VEHICLES = 2
"""Number of vehicles that are displaced, those with the largest derivatives."""

_HOPS = ((1.7, 4.0, 24), (2.9, 6.0, 32))
"""Displacement in distances that vehicles keep; standard deviation of its Gaussian in stages;
stages before and after in which all vehicles may move."""

_DIRECTIONS = np.array(
    [[1.0, 0, 0], [0, 1.0, 0], [0, 0, -1.0], [-1.0, 0, 0], [0, -1.0, 0], [0, 0, 1.0]]
)
"""Displacements, in the order in which they are tried: both horizontal ways, and down before up."""


def basin_hopping(band: ElasticBand, offsets: Floats) -> Floats:
    """Return offsets (c, n, 3) with fewer moments in a local minimum; the same where none is found.

    ``offsets`` (c, n, 3) are the start.
    """
    for _ in range(_MOMENTS):
        penalty = band.penalty(offsets)
        worst = int(penalty.missed.argmax())
        if penalty.missed[worst] <= _ACCEPTED**2:
            break
        size = np.linalg.norm(penalty.gradient[worst], axis=1)
        moved = _hop(band, offsets, worst // band.density, np.argsort(-size)[:_VEHICLES])
        if moved is None:
            break
        offsets = moved
    return offsets


def _hop(
    band: ElasticBand, offsets: Floats, stage: int, vehicles: npt.NDArray[np.intp]
) -> Floats | None:
    """Return offsets that resolve the moments about a stage after a displacement of one vehicle."""
    margins = band.team.margins
    apart = margins.vehicle + 2.0 * margins.tracking
    for (size, deviation, near), direction, vehicle in product(_HOPS, _DIRECTIONS, vehicles):
        begin, end = stage - near, stage + near
        if begin < 0 or end > len(offsets):
            continue
        bump = np.exp(-0.5 * ((np.arange(begin, end) - stage) / deviation) ** 2)
        moved = offsets.copy()
        moved[begin:end, vehicle] += size * apart * bump[:, None] * direction
        moved = band.relaxed(moved, slice(begin, end), RELAXING)
        moments = slice(begin * band.density, end * band.density)
        if band.penalty(moved, moments).missed.max() <= _ACCEPTED**2:
            return moved
    return None
