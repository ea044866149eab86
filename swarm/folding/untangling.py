"""A motion from a folded knot to the straight line, found by moving one vehicle at a time.

An open chain is never locked by its topology: its ends can be led back out of every loop. The
search knows no order in which to do that. In each step, all places that one vehicle can reach
without missing a margin are found on a lattice, while the others rest; of these it moves to the one
where the chain is least tangled. The fold is the motion backwards.
"""

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from swarm.folding.free_space import KEPT, FreeSpace, free_space, missed_margins
from swarm.folding.outlines import Outlines
from swarm.folding.penalty import TeamGeometry
from swarm.geometry.gauss_integral import gauss_integral
from swarm.jit import compiled
from swarm.signatures import Floats1

Floats = npt.NDArray[np.float64]
Progress = Callable[[str, float], None]

SPACING = 0.6
"""Distance of the lattice's places, metres. Margins of strands are larger, also with their own
movement: a strand cannot pass another between two places."""

_HEADINGS = np.pi / 12.0 * np.arange(24.0)
"""Headings of the line that are compared, radians."""

_AHEAD = 0.45
"""Share of its length by which each segment should lead along the line: half of a taut one."""

_STRAIGHT = 0.15
"""Weight of a segment that does not lead ahead at all, over that of a crossing seen from all
sides."""

_NEARLY = 0.2
"""Share of a move's gain that is given up for a shorter way."""

_GAIN = 0.004
"""Least gain of a move, and of moving every vehicle once; a crossing is about 0.5."""

_SWEEPS = 12
"""Largest number of times that every vehicle is moved."""

_EFFORT = 8e7
"""Places times squared numbers of segments, after which a search is given up: about a minute."""

_LINE_SHARE = 0.79
"""Chord of a segment on the line over its length; as :attr:`Margins.chord_ratio`."""

_SHORTENINGS = 2
"""Number of times that waypoints are shortened."""

_STEP = 0.25
"""Largest movement of a vehicle between two waypoints, metres: less than half of a margin."""


def untangle(team: TeamGeometry, knot: Floats, progress: Progress | None = None) -> Floats | None:
    """Return waypoints (k, n, 3) from a folded knot (n, 3) to a level line.

    The margins are kept at all waypoints, which are at most 0.25 m or a place of the lattice apart.
    None where the search finds no way.
    """
    outward = _from_the_ends(len(knot))
    for order in (outward, outward[::-1]):
        found = _untangled(team, knot, order, progress)
        if found is not None:
            return found
    return None


def _untangled(
    team: TeamGeometry, knot: Floats, order: list[int], progress: Progress | None
) -> Floats | None:
    """As :func:`untangle`, with the vehicles moved in an order, over and over."""
    ways, positions, left = [knot[None]], knot, _EFFORT
    tangled = first = float(_tangle(team, knot[None])[0])
    for _ in range(_SWEEPS):
        before = tangled
        for vehicle in order:
            last = _to_line(team, positions)
            if last is not None:
                return np.concatenate([*ways, last])
            space = free_space(team, positions, vehicle, SPACING)
            if space is None or left < 0.0:
                return None
            left -= len(space.places) * float(len(team.lengths)) ** 2
            way, tangled = _least_tangled(team, space, tangled)
            ways.append(way[1:])
            positions = way[-1]
            if progress:
                progress("untangling the knot", 1.0 - tangled / first)
        if before - tangled < _GAIN:
            return None
    return None


def _from_the_ends(count: int) -> list[int]:
    """Return all vehicles: the first, the last, the second, the last but one …"""
    return sorted(range(count), key=lambda vehicle: min(vehicle, count - 1 - vehicle))


def _least_tangled(team: TeamGeometry, space: FreeSpace, tangled: float) -> tuple[Floats, float]:
    """Return the way to the place where the team is least tangled, or to a nearer one like it."""
    values = _tangle(team, space.teams(np.arange(len(space.places))))
    gain = tangled - float(values.min())
    if gain < _GAIN:
        return space.positions[None], tangled
    good = np.flatnonzero(values <= values.min() + _NEARLY * gain)
    chosen = int(good[space.steps[good].argmin()])
    return space.way(chosen), float(values[chosen])


def _tangle(team: TeamGeometry, positions: Floats) -> Floats:
    """Return how tangled a team (s, n, 3) is: 0 for a line, about 1/2 for each crossing (s,)."""
    found = np.empty(len(positions))
    _write_tangles(team.outlines(positions), found)
    found += _STRAIGHT * _not_ahead(team, positions).min(axis=1)
    return found


@compiled
def _write_tangles(strands: Outlines, found: Floats1) -> None:
    """Write the sums (s,) of Gauss integrals of strands that share no vehicle, without signs."""
    points = strands.points
    for s in range(len(points)):
        found[s] = 0.0
        for i in range(points.shape[1]):
            for j in range(i + 2, points.shape[1]):
                # Two edges to the middle and back are enough for the shape of a strand.
                found[s] += abs(gauss_integral(points[s, i, ::3], points[s, j, ::3]))


def _not_ahead(team: TeamGeometry, positions: Floats) -> Floats:
    """Return by which part segments do not lead ahead along each heading (s, h), summed."""
    directions = np.stack([np.cos(_HEADINGS), np.sin(_HEADINGS)])
    ahead = np.diff(positions[..., :2], axis=1) @ directions
    wanted = _AHEAD * team.lengths[:, None]
    missing: Floats = np.maximum(1.0 - ahead / wanted, 0.0).sum(axis=1) * _AHEAD
    return missing


def _to_line(team: TeamGeometry, positions: Floats) -> Floats | None:
    """Return waypoints (k, n, 3) straight to a level line; None where that misses a margin."""
    along = np.concatenate([[0.0], np.cumsum(_LINE_SHARE * team.lengths)])
    along -= along.mean()
    for heading in _HEADINGS[np.argsort(_not_ahead(team, positions[None])[0], kind="stable")[:3]]:
        line = np.zeros_like(positions)
        line[:, :2] = positions[:, :2].mean(axis=0)
        line[:, :2] += along[:, None] * np.array([np.cos(heading), np.sin(heading)])
        way = between(positions, line)
        if missed_margins(team, way).max() <= KEPT:
            return way
    return None


def between(first: Floats, last: Floats) -> Floats:
    """Return waypoints (k, n, 3) on the straight ways from one position (n, 3) to another.

    The last one is included, the first one is not.
    """
    farthest = float(np.linalg.norm(last - first, axis=1).max())
    count = max(int(np.ceil(farthest / _STEP)), 1)
    shares = (np.arange(1, count + 1) / count)[:, None, None]
    found: Floats = first + shares * (last - first)
    return found


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
