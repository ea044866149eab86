"""Margins of a team at sampled moments after losses of setpoints; compiled."""

from typing import NamedTuple

import numpy as np

from swarm.certification.team_margins import (
    KINDS,
    Query,
    Required,
    Strands,
    Team,
    allocate_strands,
    allocate_team,
    cable_margins,
    smallest,
    vehicle_margins,
)
from swarm.geometry.distance import point_distance
from swarm.jit import compiled, inner
from swarm.signatures import Floats1, Floats2, Floats3, Floats4, Ints1


class Losses(NamedTuple):
    """Positions after losses at k moments, metres ENU.

    ``position`` (k, n, 3) at the loss. At each of s moments after it, ``moved`` (s, k, n, 3) is how
    far vehicles without setpoints have moved, and ``descended`` (s, n) how far one of them has
    descended; ``team`` (s, k, n, 3) are the planned positions of the others, and ``ahead`` those of
    all without setpoints. Within ``tracking`` metres of planned positions, everything is certified;
    with a negative one nothing is, and the plan itself counts as well.
    """

    position: Floats3
    moved: Floats4
    descended: Floats2
    team: Floats4
    ahead: Floats4
    tracking: float


class Memory(NamedTuple):
    """Working memory for one moment of n vehicles; ``margins`` (2, KINDS)."""

    team: Team
    strands: Strands
    margins: Floats2


def allocate_memory(n: int) -> Memory:
    """Return memory for a team."""
    return Memory(allocate_team(n), allocate_strands(n), np.empty((2, KINDS)))


@compiled
def write_margins(
    losses: Losses, required: Required, limits: tuple[float, float], memory: Memory,
    margins: Floats1, vehicles: Ints1,
) -> None:  # fmt: skip
    """Write the smallest margins (k,), and the vehicles (k,) without setpoints (0: the team).

    Those with a vehicle that has left the tracking radius: all others are certified. ``limits`` are
    the margin that counts as found, below which a moment is not computed further, and the one from
    which on none is computed.
    """
    found, enough = limits
    for k in range(len(margins)):
        margins[k], vehicles[k] = enough, 0
        for after in range(len(losses.moved)):
            for who in range(-2 if losses.tracking < 0.0 else -1, losses.position.shape[1]):
                if margins[k] < found:
                    break
                if _place((k, after, who), losses, memory.team) > losses.tracking:
                    margin = _smallest(
                        Query(max(who, -1), (0.0, 0.0, 0.0), found, margins[k]), required, memory
                    )
                    if margin < margins[k]:
                        margins[k], vehicles[k] = margin, max(who + 1, 0)


@inner
def _place(which: tuple[int, int, int], losses: Losses, team: Team) -> float:
    """Move a team to where it is after a loss; return how far a vehicle is off the plan.

    All vehicles without setpoints (−1), one of them, or none (−2).
    """
    (k, after, who), farthest = which, 0.0
    for i in range(len(team.position)):
        planned = losses.ahead[after, k, i] if who == -1 else losses.team[after, k, i]
        for axis in range(3):
            if who in (-1, i):
                moved = losses.moved[after, k, i, axis]
                team.position[i, axis] = losses.position[k, i, axis] + moved
            else:
                team.position[i, axis] = planned[axis]
        if who == i:
            team.position[i, 2] -= losses.descended[after, i]
        farthest = max(farthest, point_distance(team.position[i], planned))
    return farthest


@inner
def _smallest(asked: Query, required: Required, memory: Memory) -> float:
    """Return the smallest margin of a team with its cable aloft; what is ``enough`` without one."""
    low, here = memory.margins
    vehicle_margins(asked, memory.team, required, low, here)
    cable_margins(asked, memory.team, required, memory.strands, low, here)
    return float(smallest(low))
