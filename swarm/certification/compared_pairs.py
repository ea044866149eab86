"""Which parts of which strands are compared: those beyond the exempt length of a shared grip."""

import numpy as np
import numpy.typing as npt

from swarm.planning import Plan

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.intp]

MOST_EXEMPT = 0.5
"""Largest exempt share of the shorter of two neighbours: half of every segment is compared."""


def exempt_length(plan: Plan) -> float:
    """Return the exempt length of cable on either side of a vehicle, metres.

    Neighbouring segments meet at their vehicle. From this arc length on, each must keep the cable
    clearance from all of the other: they must diverge at about 15° or more.
    """
    mission = plan.mission
    return 4.0 * (mission.clearance.cable + mission.cable.diameter + mission.vehicles.tracking)


def exempt_lengths(lengths: Floats, beyond: float) -> Floats:
    """Return the exempt lengths (n − 2,) on either side of the inner vehicles, metres."""
    shorter = np.minimum(lengths[:-1], lengths[1:])
    found: Floats = np.minimum(beyond, MOST_EXEMPT * shorter)
    return found


def all_pairs(lengths: Floats, beyond: float, *, once: bool = False) -> tuple[Ints, Floats]:
    """Return all pairs (q, 2) of segments to compare, and the compared parts (q, 2, 2).

    Each of two neighbours is compared with the whole of the other from ``beyond`` metres of cable
    away from their shared vehicle, or from half of the shorter one where that is less: two entries
    per pair, of which the second leaves out what the first compares with ``once``.
    """
    first, second = np.triu_indices(len(lengths), 1)
    pairs = np.stack([first, second], axis=1)
    whole = np.tile([0.0, 1.0], (len(pairs), 2, 1))
    neighbours = second == first + 1
    i, j = pairs[neighbours].T
    left, right = whole[neighbours].copy(), whole[neighbours].copy()
    near = exempt_lengths(lengths, beyond)
    left[:, 0, 1] = 1.0 - near / lengths[i]
    right[:, 1, 0] = near / lengths[j]
    if once:
        right[:, 0, 0] = left[:, 0, 1]
    return (
        np.concatenate([pairs[~neighbours], pairs[neighbours], pairs[neighbours]]),
        np.concatenate([whole[~neighbours], left, right]),
    )
