"""Search for smaller grid diagrams of the same knot by a random walk of Cromwell's moves.

Commutations are random, on the torus (which includes translations). Every edge of length 1 is
destabilised. After many moves without progress, the grid is stabilised at a random corner. The walk
is deterministic for a seed.
"""

from collections.abc import Iterator
from random import Random

from swarm.knots.grid import Grid

MOVES = 100_000
"""Attempted moves before a search ends: about a third of a second."""

_PATIENCE = 100
"""Moves without a smaller grid after which the grid is stabilised."""

_APART = 5
"""Commutations after a stabilisation before edges are destabilised again, per column."""


def minimise_grid(grid: Grid, *, target: int = 2, moves: int = MOVES, seed: int = 1) -> Grid:
    """Return the smallest grid diagram of the same knot on the walk.

    The walk ends at size ``target`` or after ``moves`` attempted moves.
    """
    walk = GridWalk(grid, seed)
    walk.shrink()
    best = walk.grid()
    stuck = 0
    free = 0
    for _ in range(moves):
        if best.size <= max(target, 2):
            break
        moved = walk.commute()
        if free:
            free -= 1
        elif moved:
            walk.shrink()
        if walk.size < best.size:
            best, stuck = walk.grid(), 0
        stuck += 1
        if stuck % _PATIENCE == 0 and walk.size < best.size + 2:
            # The new edge must move away before the next destabilisation, which would undo it.
            walk.stabilise()
            free = _APART * walk.size
    return best


def random_grids(grid: Grid, *, seed: int = 1, apart: int = 30) -> Iterator[Grid]:
    """Yield grid diagrams of the same knot and size, endlessly, ``apart`` moves between them."""
    walk = GridWalk(grid, seed)
    while True:
        for _ in range(apart):
            walk.commute()
        yield walk.grid()


class GridWalk:
    """A grid on the torus under random moves: ends of columns and of rows, from 0."""

    def __init__(self, grid: Grid, seed: int) -> None:
        self._set([(low - 1, high - 1) for low, high in grid.columns])
        self.random = Random(seed).random

    def _set(self, columns: list[tuple[int, int]]) -> None:
        rows: list[list[int]] = [[] for _ in columns]
        for column, pair in enumerate(columns):
            for row in pair:
                rows[row].append(column)
        self.size = len(columns)
        self.sides = (columns, [(one, two) for one, two in rows])

    def state(self) -> tuple[list[tuple[int, int]], list[tuple[int, int]]]:
        """Return the state for :meth:`restore`."""
        return list(self.sides[0]), list(self.sides[1])

    def restore(self, state: tuple[list[tuple[int, int]], list[tuple[int, int]]]) -> None:
        """Restore an earlier grid of the same size."""
        self.sides = state

    def grid(self) -> Grid:
        """Return the current grid diagram."""
        return Grid(tuple((a + 1, b + 1) if a < b else (b + 1, a + 1) for a, b in self.sides[0]))

    def commute(self) -> bool:
        """Exchange two random neighbouring columns or rows; False where that changes the knot."""
        pick = int(self.random() * 2 * self.size)
        side, here = divmod(pick, self.size)
        lines, cross = self.sides[side], self.sides[1 - side]
        there = here + 1 if here + 1 < self.size else 0
        one, two = lines[here], lines[there]
        a, b = one
        c, d = two
        if a in two or b in two:
            return False
        if ((a < c) == (c < b)) != ((a < d) == (d < b)):
            return False
        lines[here], lines[there] = two, one
        for line in one:
            e, f = cross[line]
            cross[line] = (there, f) if e == here else (e, there)
        for line in two:
            e, f = cross[line]
            cross[line] = (here, f) if e == there else (e, here)
        return True

    def shrink(self) -> bool:
        """Destabilise every edge of length 1; return whether there was one."""
        found = False
        while self.size > 2:
            last = self.size - 1
            for side in (0, 1):
                for place, (one, two) in enumerate(self.sides[side]):
                    step = one - two
                    if step in {1, -1, last, -last}:
                        self._merge(side, place)
                        break
                else:
                    continue
                break
            else:
                return found
            found = True
        return found

    def _merge(self, side: int, place: int) -> None:
        lines = self.sides[side]
        one, two = lines.pop(place)
        kept, gone = (one, two) if one < two else (two, one)
        # The higher of the two perpendicular lines is merged into the lower one.
        renamed = [tuple(kept if e == gone else e - (e > gone) for e in pair) for pair in lines]
        self._set_side(side, renamed)

    def _set_side(self, side: int, lines: list[tuple[int, ...]]) -> None:
        pairs = [(pair[0], pair[1]) for pair in lines]
        self._set(pairs)
        if side == 1:
            self.sides = (self.sides[1], self.sides[0])

    def stabilise(self) -> None:
        """Add an edge of length 1 at a random corner, in one of four ways."""
        side = int(self.random() * 2)
        place = int(self.random() * self.size)
        end = int(self.random() * 2)
        own_later, far_right = self.random() < 0.5, self.random() < 0.5
        lines = self.sides[side]
        row = lines[place][end]
        own, far = (row + 1, row) if own_later else (row, row + 1)
        moved = []
        for number, pair in enumerate(lines):
            here = own if number == place else far
            moved.append(tuple(here if e == row else e + (e > row) for e in pair))
        moved.insert(place + far_right, (row, row + 1))
        self._set_side(side, moved)
