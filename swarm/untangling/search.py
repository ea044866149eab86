"""A motion from a folded knot to the straight line, found by moving a few vehicles at a time.

An open chain is never locked by its topology: its ends can be led back out of every loop. The
search knows no order in which to do that. In each step, all places on a lattice are found that one
vehicle, or two or three neighbours together, can reach without missing a margin, while the others
rest; of these they move to the one where the chain is least tangled. Before each round of steps all
vehicles move apart. Where no step makes the chain less tangled, random ones follow. The fold is the
motion backwards.
"""

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from swarm.folding.penalty import KEPT, TeamGeometry, missed_margins
from swarm.untangling.free_space import FreeSpace, free_space
from swarm.untangling.loosening import between, loosened
from swarm.untangling.moved_vehicle import Group, team_state
from swarm.untangling.tangle import HEADINGS, not_ahead

Floats = npt.NDArray[np.float64]
Progress = Callable[[str, float], None]

SPACING = 0.6
"""Distance of the lattice's places, metres. Margins of strands are larger, also with their own
movement: a strand cannot pass another between two places."""

_FINER, _FEW = 0.5, 30
"""Factor of the distance where fewer places than that are free: in a tight knot, steps of 0.6 m
often leave none."""

_GROUPS = (1, 1, 2, 3)
"""Numbers of vehicles that move together, one of which is drawn for each step. With single vehicles
only, 8_18 with 11 is not untangled in 10 attempts; with these, in 2 of 10."""

_NEARLY = 0.2
"""Share of a move's gain that is given up for a shorter way."""

_GAIN, _ROUND_GAIN = 0.004, 0.02
"""Least gain of a move, and of a round of moves; a crossing is about 0.5."""

_HEAT, _HEATS = 0.03, 3
"""By how much a random move may tangle the chain, for each round without a gain, up to so many."""

_PATIENCE, _ROUNDS = 8, 60
"""Rounds in a row without a gain, and rounds, after which an attempt is given up. Attempts that
succeed take 3 to 12 rounds for 5_1 with 8 vehicles, up to 42 for 8_18 with 11."""

_LINE_SHARE = 0.79
"""Chord of a segment on the line over its length; as :attr:`Margins.chord_ratio`."""

_SHORTENINGS = 2
"""Number of times that waypoints are shortened."""


def untangle(
    team: TeamGeometry, knot: Floats, rng: np.random.Generator, progress: Progress | None = None
) -> Floats | None:
    """Return waypoints (k, n, 3) from a folded knot (n, 3) to a level line.

    The margins are kept at all waypoints, which are at most 0.25 m or a place of the lattice apart.
    None where the attempt finds no way; another ``rng`` gives another attempt.
    """
    ways, positions, idle, most = [knot[None]], knot, 0, 0.0
    for _ in range(_ROUNDS):
        last = _to_line(team, positions)
        if last is not None:
            return np.concatenate([*ways, last])
        ways.append(loosened(team, positions))
        if len(ways[-1]):
            positions = ways[-1][-1]
        gain = 0.0
        for vehicle in rng.permutation(len(knot)):
            space = _space(team, positions, _group(int(vehicle), len(knot), rng))
            if space is None:
                return None
            chosen = _chosen(space, idle, rng)
            tangled, most = float(space.tangles[chosen]), max(most, float(space.tangles[0]))
            gain += float(space.tangles[0]) - tangled
            ways.append(space.way(chosen)[1:])
            positions = space.teams(np.array([chosen]))[0]
        if progress:
            progress("untangling the knot", 1.0 - tangled / most)
        idle = 0 if gain > _ROUND_GAIN else idle + 1
        if idle > _PATIENCE:
            return None
    return None


def _group(vehicle: int, count: int, rng: np.random.Generator) -> Group:
    """Return some neighbours that include a vehicle; the whole ends of the cable where it is one.

    An end that moves together with its neighbours is led out of a loop like a rod.
    """
    size = min(int(rng.choice(_GROUPS)), count - 1)
    if vehicle in (0, count - 1):
        begin = 0 if vehicle == 0 else count - size
    else:
        begin = min(max(vehicle - int(rng.integers(size)), 0), count - size)
    return Group(begin, begin + size)


def _space(team: TeamGeometry, positions: Floats, group: Group) -> FreeSpace | None:
    """Return the free displacements of vehicles, on a finer lattice where few are free."""
    space = free_space(team, positions, group, SPACING)
    if space is None or len(space.offsets) >= _FEW:
        return space
    finer = free_space(team, positions, group, _FINER * SPACING)
    return finer if finer is not None and len(finer.offsets) > len(space.offsets) else space


def _chosen(space: FreeSpace, idle: int, rng: np.random.Generator) -> int:
    """Return where to move: to the least tangled place, or to a nearer one like it.

    Where none is less tangled, stay; after rounds without a gain, move at random.
    """
    values = space.tangles
    gain = float(values[0] - values.min())
    if gain >= _GAIN:
        good = np.flatnonzero(values <= values.min() + _NEARLY * gain)
        return int(good[space.steps[good].argmin()])
    if not idle:
        return 0
    return int(rng.choice(np.flatnonzero(values <= values[0] + _HEAT * min(idle, _HEATS))))


def _to_line(team: TeamGeometry, positions: Floats) -> Floats | None:
    """Return waypoints (k, n, 3) straight to a level line; None where that misses a margin."""
    along = np.concatenate([[0.0], np.cumsum(_LINE_SHARE * team.lengths)])
    along -= along.mean()
    missing = np.zeros(len(HEADINGS))
    not_ahead(team_state(positions, team.lengths), 0, len(team.lengths), missing)
    for heading in HEADINGS[np.argsort(missing, kind="stable")[:3]]:
        line = np.zeros_like(positions)
        line[:, :2] = positions[:, :2].mean(axis=0)
        line[:, :2] += along[:, None] * np.array([np.cos(heading), np.sin(heading)])
        way = between(positions, line)
        if missed_margins(team, way).max() <= KEPT:
            return way
    return None


def shortened(team: TeamGeometry, waypoints: Floats) -> Floats:
    """Return waypoints (k, n, 3) with straight ways in place of detours, where margins permit.

    Long parts are replaced first, then shorter ones, several times over.
    """
    for _ in range(_SHORTENINGS):
        reach = len(waypoints) // 2
        while reach >= 2:
            begin = 0
            while begin + reach < len(waypoints):
                way = between(waypoints[begin], waypoints[begin + reach])
                if len(way) <= reach and missed_margins(team, way).max() <= KEPT:
                    parts = waypoints[: begin + 1], way, waypoints[begin + reach + 1 :]
                    waypoints = np.concatenate(parts)
                begin += max(reach // 2, 1)
            reach //= 2
    return waypoints
