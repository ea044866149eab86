"""Places that some vehicles can reach together while all others rest, on a lattice."""

from dataclasses import dataclass
from typing import Annotated, NamedTuple

import numpy as np
import numpy.typing as npt
from numba import types

from swarm.folding.margins import PenaltyModel
from swarm.folding.penalty import KEPT, TeamGeometry, missed_margins
from swarm.jit import allocates, compiled, inner
from swarm.signatures import Floats1, Floats2, Ints1, Ints2
from swarm.untangling.moved_vehicle import Group, TeamState, missed_by, team_state, update
from swarm.untangling.tangle import HEADINGS, crossed, not_ahead, weighted

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.intp]

_RISE = 0.6
"""Largest height above and below the others, as a share of the longest segment."""

_CHORD = 0.97
"""Largest chord of a segment over its length, less two tracking errors; see MAX_CHORD_RATIO."""


_MOST = 20_000
"""Places after which the search for more ends: the nearest come first, and a later step goes on
from there. 8_14, whose segments of up to 24 m have 100,000 around a vehicle, did not end otherwise
in 10 minutes; that of 8_18, cleared with 10 vehicles, goes beyond it in 1 of 1,000 steps."""

_UNSEEN, _BLOCKED = -1, -2
"""Marks of cells in a lattice that were not visited, and of those that are not free."""


@dataclass(frozen=True, eq=False)
class FreeSpace:
    """Ways of vehicles that move together, without a rotation, while the others rest.

    ``positions`` (n, 3) are those of the team, ``offsets`` (m, 3) displacements of the ``group``,
    of which the first is 0. ``steps`` (m,) are the steps of the lattice on the way to each of them,
    ``before`` (m,) the one before it, and ``tangles`` (m,) how tangled the team is there.
    """

    positions: Floats
    group: Group
    offsets: Floats
    steps: Ints
    before: Ints
    tangles: Floats

    def teams(self, offsets: Ints) -> Floats:
        """Return the positions (k, n, 3) of the team with the vehicles at offsets (k,)."""
        teams = np.repeat(self.positions[None], len(offsets), axis=0)
        teams[:, slice(*self.group)] += self.offsets[offsets][:, None]
        return teams

    def way(self, offset: int) -> Floats:
        """Return the positions (k, n, 3) of the team on the way to an offset; with both ends."""
        way = [offset]
        while way[-1] != 0:
            way.append(int(self.before[way[-1]]))
        return self.teams(np.array(way[::-1], dtype=np.intp))


class _Lattice(NamedTuple):
    """Cells of displacements, ``spacing`` metres apart, and the number of each, or a mark.

    ``home`` (3,) is the cell of no displacement. ``held`` (k, 4) are the ways back along the cable
    to vehicles at rest, and how long they may be.
    """

    numbers: Annotated[Ints, types.int64[:, :, ::1]]
    home: Ints1
    spacing: float
    held: Floats2


class _Found(NamedTuple):
    """Free places in the order in which they were found: cells (m, 3), and as in FreeSpace (m,)."""

    cells: Ints2
    steps: Ints1
    before: Ints1
    tangles: Floats1


def free_space(
    team: TeamGeometry, positions: Floats, group: Group, spacing: float
) -> FreeSpace | None:
    """Return the free displacements of vehicles, ``spacing`` metres apart, of a team (n, 3).

    None where the team misses its margins as it is.
    """
    missed = float(missed_margins(team, positions[None])[0])
    if missed > KEPT:
        return None
    lattice = _within_reach(team, positions, group, spacing)
    state, model = team_state(positions, team.lengths), team.model
    update(state, 0, len(team.lengths), model)
    own = missed_by(state, group, np.inf, model)
    size = min(lattice.numbers.size, _MOST)
    places = _Found(
        np.empty((size, 3), dtype=np.int64),
        np.zeros(size, dtype=np.int64),
        np.zeros(size, dtype=np.int64),
        np.empty(size),
    )
    count = _flood(state, group, lattice, KEPT - missed + own, model, places)
    offsets: Floats = spacing * (places.cells[:count] - lattice.home).astype(np.float64)
    steps, before, tangles = places.steps[:count], places.before[:count], places.tangles[:count]
    return FreeSpace(positions, group, offsets, steps, before, tangles)


def _within_reach(team: TeamGeometry, positions: Floats, group: Group, spacing: float) -> _Lattice:
    """Return the lattice of displacements that cable permits, all unseen."""
    moved = positions[slice(*group)]
    rise = _RISE * float(team.lengths.max())
    low, high = np.full(3, -np.inf), np.full(3, np.inf)
    others = np.delete(positions, slice(*group), axis=0)[:, 2]
    low[2], high[2] = (
        others.min() - rise - moved[:, 2].min(),
        others.max() + rise - moved[:, 2].max(),
    )
    held: list[Floats] = []
    for own, other in ((group.first, group.first - 1), (group.last - 1, group.last)):
        if 0 <= other < len(positions):
            reach = _CHORD * float(team.lengths[min(own, other)]) - 2.0 * team.margins.tracking
            back = positions[other] - positions[own]
            held.append(np.append(back, reach))
            low, high = np.maximum(low, back - reach), np.minimum(high, back + reach)
    first = np.minimum(np.ceil(low / spacing), 0).astype(np.int64)
    last = np.maximum(np.floor(high / spacing), 0).astype(np.int64)
    numbers = np.full(last - first + 1, _UNSEEN, dtype=np.int64)
    return _Lattice(numbers, -first, spacing, np.array(held))


@compiled
@allocates
def _flood(
    team: TeamState,
    group: Group,
    lattice: _Lattice,
    allowed: float,
    model: PenaltyModel,
    places: _Found,
) -> int:
    """Find free displacements from 0 on, the nearest first, until memory is full; return how many.

    One is free where the vehicles and their strands miss at most ``allowed``.
    """
    first, last = max(group.first - 1, 0), min(group.last, len(team.lengths))
    own = team.positions[group.first : group.last].copy()
    missing, resting = np.empty(len(HEADINGS)), np.zeros(len(HEADINGS))
    not_ahead(team, 0, first, resting)
    not_ahead(team, last, len(team.lengths), resting)
    others = crossed(team, 0, len(team.lengths)) - crossed(team, first, last)
    numbers, home = lattice.numbers, lattice.home
    numbers[home[0], home[1], home[2]] = 0
    places.cells[0] = home
    count, seen = 1, 0
    while seen < count:
        _move(team, group, lattice, places.cells[seen], own)
        update(team, first, last, model)
        missing[:] = resting
        not_ahead(team, first, last, missing)
        places.tangles[seen] = weighted(others + crossed(team, first, last), missing)
        for direction in range(6):
            if count == len(places.steps):
                break
            cell = places.cells[count]
            cell[:] = places.cells[seen]
            cell[direction // 2] += 2 * (direction % 2) - 1
            if not _is_unseen(numbers, cell):
                continue
            numbers[cell[0], cell[1], cell[2]] = _BLOCKED
            if not _is_near(lattice, cell):
                continue
            _move(team, group, lattice, cell, own)
            update(team, first, last, model)
            if missed_by(team, group, allowed, model) <= allowed:
                numbers[cell[0], cell[1], cell[2]] = count
                places.steps[count], places.before[count] = places.steps[seen] + 1, seen
                count += 1
        seen += 1
    return count


@inner
def _move(team: TeamState, group: Group, lattice: _Lattice, cell: Ints1, own: Floats) -> None:
    """Displace vehicles from their ``own`` places (k, 3) by the displacement of a cell (3,)."""
    for k in range(len(own)):
        for axis in range(3):
            offset = lattice.spacing * (cell[axis] - lattice.home[axis])
            team.positions[group.first + k, axis] = own[k, axis] + offset


@inner
def _is_unseen(numbers: Ints, cell: Ints) -> bool:
    """Return whether a cell (3,) is in the lattice and was not visited."""
    for axis in range(3):
        if not 0 <= cell[axis] < numbers.shape[axis]:
            return False
    return bool(numbers[cell[0], cell[1], cell[2]] == _UNSEEN)


@inner
def _is_near(lattice: _Lattice, cell: Ints) -> bool:
    """Return whether the cable to the vehicles beside is long enough at a cell (3,)."""
    for k in range(len(lattice.held)):
        square = 0.0
        for axis in range(3):
            offset = lattice.spacing * (cell[axis] - lattice.home[axis])
            square += (offset - lattice.held[k, axis]) ** 2
        if square > lattice.held[k, 3] ** 2:
            return False
    return True
