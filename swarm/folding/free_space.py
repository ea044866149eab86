"""Places that one vehicle can reach while all others rest, on a lattice."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
import scipy

from swarm.folding.crossing_constraints import free_signs
from swarm.folding.penalty import TeamGeometry

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.intp]

KEPT = 0.02
"""Missed margins, squared, up to which a team keeps its margins: the penalty of a single pair
begins a quarter of a unit beyond its margin, so that 0.06 is a kept margin. Jets of vehicles above
cost more than this where they make a vehicle sink by about a tracking error."""

_BATCH = 4000
"""Number of teams whose margins are computed at once: their outlines fit a processor's cache."""

_RISE = 0.6
"""Largest height above and below the others, as a share of the longest segment."""

_CHORD = 0.97
"""Largest chord of a segment over its length, less two tracking errors; see MAX_CHORD_RATIO."""


def missed_margins(team: TeamGeometry, positions: Floats) -> Floats:
    """Return the missed margins (s,), squared and summed, of a team at positions (s, n, 3).

    Vehicles in the jets of others count as well. No strand is required on one side of another.
    """
    missed = np.empty(len(positions))
    for begin in range(0, len(positions), _BATCH):
        some = positions[begin : begin + _BATCH]
        signs = free_signs(len(some), len(team.lengths))
        missed[begin : begin + _BATCH] = team.penalty(some, signs, preferences=True).missed
    return missed


@dataclass(frozen=True, eq=False)
class FreeSpace:
    """The free places of vehicle ``vehicle`` that are connected with its own; the others rest.

    ``positions`` (n, 3) are those of the team. ``cells`` (m, 3) are indices of the free places in
    the lattice, ``places`` (m, 3) their positions, and ``home`` the index of the vehicle's own.
    """

    positions: Floats
    vehicle: int
    cells: Ints
    places: Floats
    home: int

    def teams(self, places: Ints) -> Floats:
        """Return the positions (k, n, 3) of the team with the vehicle at places (k,)."""
        teams = np.repeat(self.positions[None], len(places), axis=0)
        teams[:, self.vehicle] = self.places[places]
        return teams

    @cached_property
    def _tree(self) -> tuple[Floats, Ints]:
        """Distances (m,) from the vehicle's place in steps, and the place before each."""
        index = np.full(self.cells.max(axis=0) + 2, -1, dtype=np.intp)
        index[tuple(self.cells.T)] = np.arange(len(self.cells))
        links = []
        for axis in range(3):
            ahead = index[tuple((self.cells + np.eye(3, dtype=np.intp)[axis]).T)]
            here = np.flatnonzero(ahead >= 0)
            links.append(np.stack([here, ahead[here]]))
        pairs = np.concatenate(links, axis=1)
        shape = (len(self.cells), len(self.cells))
        graph = scipy.sparse.coo_array((np.ones(pairs.shape[1]), tuple(pairs)), shape=shape).tocsr()
        steps, before = scipy.sparse.csgraph.dijkstra(  # type: ignore[call-overload]  # its stubs know no plain int
            graph, directed=False, indices=self.home, return_predecessors=True, unweighted=True
        )
        return steps, before

    @property
    def steps(self) -> Floats:
        """Steps (m,) of the lattice on the way to each place."""
        return self._tree[0]

    def way(self, place: int) -> Floats:
        """Return the positions (k, n, 3) of the team on the way to a place; both ends included."""
        before, places = self._tree[1], [place]
        while places[-1] != self.home:
            places.append(int(before[places[-1]]))
        return self.teams(np.array(places[::-1], dtype=np.intp))


def free_space(
    team: TeamGeometry, positions: Floats, vehicle: int, spacing: float
) -> FreeSpace | None:
    """Return the free places of a vehicle, ``spacing`` metres apart, of a team (n, 3).

    None where the team misses its margins as it is.
    """
    cells, places = _within_reach(team, positions, vehicle, spacing)
    teams = np.repeat(positions[None], len(places), axis=0)
    teams[:, vehicle] = places
    kept = missed_margins(team, teams) <= KEPT
    origin = cells.min(axis=0)
    free = np.zeros(np.ptp(cells, axis=0) + 1, dtype=bool)
    free[tuple((cells - origin).T)] = kept
    regions, _ = scipy.ndimage.label(free)
    own = regions[tuple(-origin)]
    if own == 0:
        return None
    connected = np.flatnonzero(regions[tuple((cells - origin).T)] == own)
    cells, places = cells[connected], places[connected]
    home = int(np.flatnonzero((cells == 0).all(axis=1))[0])
    return FreeSpace(positions, vehicle, cells - origin, places, home)


def _within_reach(
    team: TeamGeometry, positions: Floats, vehicle: int, spacing: float
) -> tuple[Ints, Floats]:
    """Return cells (m, 3), counted from the vehicle's own, and places (m, 3) that cable reaches."""
    lengths, low, high = team.lengths, np.full(3, -np.inf), np.full(3, np.inf)
    rise = _RISE * float(lengths.max())
    others = np.delete(positions, vehicle, axis=0)[:, 2]
    low[2], high[2] = others.min() - rise, others.max() + rise
    held: list[tuple[Floats, float]] = []
    for other, segment in ((vehicle - 1, vehicle - 1), (vehicle + 1, vehicle)):
        if 0 <= other < len(positions):
            reach = _CHORD * float(lengths[segment]) - 2.0 * team.margins.tracking
            held.append((positions[other], reach))
            low = np.maximum(low, positions[other] - reach)
            high = np.minimum(high, positions[other] + reach)
    own = positions[vehicle]
    first = np.minimum(np.ceil((low - own) / spacing), 0).astype(np.intp)
    last = np.maximum(np.floor((high - own) / spacing), 0).astype(np.intp)
    axes = [np.arange(a, b + 1) for a, b in zip(first, last, strict=True)]
    cells = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    places = own + spacing * cells
    near = np.ones(len(cells), dtype=bool)
    for centre, reach in held:
        near &= ((places - centre) ** 2).sum(axis=1) <= reach**2
    near |= (cells == 0).all(axis=1)
    return cells[near], places[near]
