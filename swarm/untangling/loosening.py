"""A first move out of a tight knot: all vehicles at once, to where margins are larger."""

from dataclasses import replace

import numpy as np
import numpy.typing as npt
from scipy.optimize import minimize

from swarm.folding.crossing_constraints import free_signs
from swarm.folding.penalty import (
    KEPT,
    TeamGeometry,
    missed_margins,
    no_extra_margins,
)

Floats = npt.NDArray[np.float64]

_EXTRA = 0.6
"""Metres beyond the margins that strands and vehicles should keep: a place of the lattice, so that
each can move by one afterwards. Without it 3 of 16 layouts of 5_1 with 8 vehicles are untangled in
two attempts, with it 9."""

_STAY = 0.02
"""Cost of a metre by which a vehicle moves, squared, over that of a missed margin's unit."""

_ITERATIONS = 30
"""Iterations of the quasi-Newton method: a direction is wanted, not the minimum."""

_STEP = 0.25
"""Largest movement of a vehicle between two waypoints, metres: less than half of a margin."""


def loosened(team: TeamGeometry, positions: Floats) -> Floats:
    """Return waypoints (k, n, 3) from positions (n, 3) to where the team keeps larger margins.

    They lead straight there, as far as the margins are kept; k is 0 where no step keeps them. The
    positions themselves are not included.
    """
    none = no_extra_margins(1)
    extra = np.full(1, _EXTRA)
    wanted = replace(none, cable=extra, vehicle=extra, vehicle_cable=extra)
    signs, start = free_signs(1, len(team.lengths)), positions.ravel()

    def cost(flat: Floats) -> tuple[float, Floats]:
        penalty = team.penalty(flat.reshape(1, -1, 3), signs, wanted)
        moved = flat - start
        total = float(penalty.missed[0] + _STAY * (moved**2).sum())
        return total, 2.0 * (penalty.gradient.ravel() + _STAY * moved)

    minimum = minimize(cost, start, jac=True, method="L-BFGS-B", options={"maxiter": _ITERATIONS})
    way = between(positions, minimum.x.reshape(-1, 3))
    missed = np.flatnonzero(missed_margins(team, way) > KEPT)
    return way[: missed[0]] if len(missed) else way


def between(first: Floats, last: Floats) -> Floats:
    """Return waypoints (k, n, 3) on the straight ways from one position (n, 3) to another.

    The last one is included, the first one is not.
    """
    farthest = float(np.linalg.norm(last - first, axis=1).max())
    count = max(int(np.ceil(farthest / _STEP)), 1)
    shares = (np.arange(1, count + 1) / count)[:, None, None]
    waypoints: Floats = first + shares * (last - first)
    return waypoints
