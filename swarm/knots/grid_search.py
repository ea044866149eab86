"""Small grid diagrams of a knot: drawn from a planar diagram, then reduced by Cromwell's moves.

**Drawing.** The diagram is drawn upward, row by row. Unfinished strands end at the top, in an order
from left to right, and crossings are added one after another. Each strand is a vertical line. A
crossing adds one or two horizontal edges: the upper strand continues straight, and the lower one
steps across beneath it. Two neighbouring ends of the same edge are joined by another horizontal
edge. Every horizontal edge has a row of its own. The drawn part is a disc of the sphere, so its
loose ends have a cyclic order: the first strand on the left is also a neighbour of the last one on
the right. A rotation of that order is a translation of the grid on the torus.

**Reduction** to small size, few crossings and short edges is a random walk, deterministic for a
seed. Commutations are random, on the torus (which includes translations). Every edge of length 1 is
destabilised. After many moves without progress, the grid is stabilised at a random corner.
"""

import math
from collections.abc import Iterator
from random import Random

from swarm.knots.diagram import Diagram, without_nugatory
from swarm.knots.grid import Grid, best_opening

UNKNOT = Grid(((1, 2), (1, 2)))


def grid_of_diagram(diagram: Diagram) -> Grid:
    """Return a grid diagram of a diagram's knot, of a size near the number of crossings + 2."""
    diagram = without_nugatory(diagram)
    if diagram.crossings == 0:
        return UNKNOT
    drawing = _Drawing()
    waiting = list(diagram.pd())
    first = waiting.pop(0)
    drawing.start(first)
    drawing.join_neighbours()
    while waiting:
        row, turn, at = _next(waiting, drawing.edges)
        waiting.remove(row)
        loose = sum(edge in drawing.edges for edge in row)
        if at + loose > len(drawing.edges):
            drawing.turn(at)
            at = 0
        drawing.add(_turned(row, turn), over_first=turn % 2 == 1, at=at)
        drawing.join_neighbours()
    return drawing.grid()


_Row = tuple[int, int, int, int]


def _next(waiting: list[_Row], edges: list[int]) -> tuple[_Row, int, int]:
    """Return a crossing with adjacent loose edges: its row, the first slot, their place.

    Counterclockwise around the crossing from that slot, these edges come from below, left to right.
    Crossings with the most loose edges come first.
    """
    best: tuple[int, _Row, int, int] | None = None
    for row in waiting:
        loose = sum(edge in edges for edge in row)
        if not loose or (best is not None and loose <= best[0]):
            continue
        for turn in range(4):
            run = [row[(turn + k) % 4] for k in range(loose)]
            if run[0] in edges and (edges * 2)[edges.index(run[0]) :][:loose] == run:
                best = (loose, row, turn, edges.index(run[0]))
                break
    if best is None:
        raise AssertionError("a diagram without nugatory crossings always has such a crossing")
    return best[1:]


def _turned(row: _Row, turn: int) -> _Row:
    first, second, third, fourth = row[turn:] + row[:turn]
    return first, second, third, fourth


class _Drawing:
    """The unfinished grid: loose strands and all columns with their rows, from left to right."""

    def __init__(self) -> None:
        self.edges: list[int] = []
        self.loose: list[int] = []
        self.order: list[int] = []
        self.ends: list[list[int]] = []
        self.row = 0

    def _column(self, place: int) -> int:
        """Add a column at a place in the order from left to right, from this row on; return it."""
        self.ends.append([self.row])
        self.order.insert(place, len(self.ends) - 1)
        return len(self.ends) - 1

    def start(self, row: _Row) -> None:
        """Draw the first crossing: two cups, the lower one with the straight upper strand."""
        under_in, over_a, under_out, over_b = row
        self.row += 1
        left, right = self._column(0), self._column(1)
        self.row += 1
        inner, outer = self._column(1), self._column(3)
        self.loose = [left, inner, right, outer]
        self.edges = [over_b, under_out, over_a, under_in]

    def add(self, row: _Row, *, over_first: bool, at: int) -> None:
        """Draw a crossing, its edges counterclockwise, first the loose ones from place ``at``.

        ``over_first`` states whether the first and third edges are the upper strand.
        """
        loose = sum(edge in self.edges for edge in row)
        add = (self._one, self._two, self._three, self._four)[loose - 1]
        add(row, over_first, at)

    def _replace(self, at: int, count: int, edges: list[int], columns: list[int]) -> None:
        self.edges[at : at + count] = edges
        self.loose[at : at + count] = columns

    def _step(self, at: int, *, to_right: bool) -> int:
        """Move the strand at a place under its neighbour into a new column; return the column."""
        self.row += 1
        own, neighbour = self.loose[at], self.loose[at + (1 if to_right else -1)]
        self.ends[own].append(self.row)
        return self._column(self.order.index(neighbour) + to_right)

    def _one(self, row: _Row, over_first: bool, at: int) -> None:
        below, right, above, left = row
        if over_first:
            self.row += 1
            own = self.loose[at]
            first = self._column(self.order.index(own))
            last = self._column(self.order.index(own) + 1)
            self._replace(at, 1, [left, above, right], [first, own, last])
            return
        self.row += 1
        own = self.loose[at]
        first = self._column(self.order.index(own) + 1)
        last = self._column(self.order.index(first) + 1)
        self._replace(at, 1, [below, left, right], [own, first, last])
        stepped = self._step(at, to_right=True)
        self._replace(at, 3, [left, above, right], [first, stepped, last])

    def _two(self, row: _Row, over_first: bool, at: int) -> None:
        _, _, above_right, above_left = row
        left, right = self.loose[at], self.loose[at + 1]
        if over_first:
            stepped = self._step(at + 1, to_right=False)
            self._replace(at, 2, [above_left, above_right], [stepped, left])
        else:
            stepped = self._step(at, to_right=True)
            self._replace(at, 2, [above_left, above_right], [right, stepped])

    def _three(self, row: _Row, over_first: bool, at: int) -> None:
        left, middle, right = self.loose[at : at + 3]
        if over_first:
            stepped = self._step(at + 1, to_right=False)
            self._join(left, right)
            self._replace(at, 3, [row[3]], [stepped])
        else:
            self._join(left, right)
            self._replace(at, 3, [row[3]], [middle])

    def _four(self, row: _Row, over_first: bool, at: int) -> None:
        del row
        first, second, third, fourth = self.loose[at : at + 4]
        lower, upper = (
            ((second, fourth), (first, third))
            if over_first
            else (
                (first, third),
                (second, fourth),
            )
        )
        self._join(*lower)
        self._join(*upper)
        self._replace(at, 4, [], [])

    def _join(self, first: int, second: int) -> None:
        """Draw a cap: a horizontal edge that ends two columns."""
        self.row += 1
        self.ends[first].append(self.row)
        self.ends[second].append(self.row)

    def join_neighbours(self) -> None:
        """Draw caps for adjacent loose ends of the same edge."""
        place = 0
        while place + 1 < len(self.edges):
            if self.edges[place] == self.edges[place + 1]:
                self._join(self.loose[place], self.loose[place + 1])
                self._replace(place, 2, [], [])
                place = max(0, place - 1)
            else:
                place += 1
        if len(self.edges) > 2 and self.edges[0] == self.edges[-1]:
            self.turn(1)
            self.join_neighbours()

    def turn(self, count: int) -> None:
        """Make the first ``count`` loose strands the last: a translation on the torus."""
        place = self.order.index(self.loose[count - 1]) + 1
        self.order = self.order[place:] + self.order[:place]
        self.edges = self.edges[count:] + self.edges[:count]
        self.loose = self.loose[count:] + self.loose[:count]

    def grid(self) -> Grid:
        """Return the finished grid diagram."""
        pairs = (sorted(self.ends[column]) for column in self.order)
        return Grid(tuple((low, high) for low, high in pairs))


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
        self.sides = (columns, [(first, second) for first, second in rows])

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
        first, second = lines[here], lines[there]
        a, b = first
        c, d = second
        if a in second or b in second:
            return False
        if ((a < c) == (c < b)) != ((a < d) == (d < b)):
            return False
        lines[here], lines[there] = second, first
        for line in first:
            e, f = cross[line]
            cross[line] = (there, f) if e == here else (e, there)
        for line in second:
            e, f = cross[line]
            cross[line] = (here, f) if e == there else (e, here)
        return True

    def shrink(self) -> bool:
        """Destabilise every edge of length 1; return whether there was one."""
        shrunk = False
        while self.size > 2:
            last = self.size - 1
            for side in (0, 1):
                for place, (first, second) in enumerate(self.sides[side]):
                    step = first - second
                    if step in {1, -1, last, -last}:
                        self._merge(side, place)
                        break
                else:
                    continue
                break
            else:
                return shrunk
            shrunk = True
        return shrunk

    def _merge(self, side: int, place: int) -> None:
        lines = self.sides[side]
        first, second = lines.pop(place)
        kept, gone = (first, second) if first < second else (second, first)
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


_HOT, _COLD = 1.5, 0.2
"""Temperatures of the annealing, in crossings."""


def smallest_grid(
    grid: Grid,
    *,
    target: int = 2,
    starts: int = 4,
    steps: int = 300,
    moves: int = MOVES,
    fewest: int | None = None,
) -> Grid:
    """Return the smallest grid diagram of the same knot that is found, with a good opening.

    Commutations do not connect all grids of one size, so several searches with different seeds lead
    to ``starts`` grids. Each is annealed for ``steps``; the result is the best of them. With
    ``fewest`` crossings, up to four times as many are searched until that number is reached.
    """
    first = minimise_grid(grid, target=target, moves=moves)
    best = anneal(first, steps=steps)
    for seed in range(2, 4 * starts + 1):
        if seed > starts and (fewest is None or _score(best) < fewest + 1):
            break
        other = minimise_grid(grid, target=first.size, moves=moves, seed=seed)
        if other.size == first.size:
            best = min(best, anneal(other, steps=steps, seed=seed), key=_score)
    return best


def anneal(grid: Grid, *, steps: int, seed: int = 1) -> Grid:
    """Return a grid, connected by commutations, with a good best opening, by annealing.

    Good means fewest crossings, then least total edge length.
    """
    walk = GridWalk(grid, seed)
    chance = Random(seed).random
    best, best_score = grid, _score(grid)
    score = best_score
    for step in range(steps):
        temperature = _HOT * (_COLD / _HOT) ** (step / steps)
        before = walk.state()
        if not walk.commute():
            continue
        other = walk.grid()
        value = _score(other)
        if value > score and chance() >= math.exp((score - value) / temperature):
            walk.restore(before)
            continue
        score = value
        if value < best_score:
            best, best_score = other, value
    return best


def _score(grid: Grid) -> float:
    """Return the crossings of the best opening plus its scaled length, which is less than 1."""
    opening = best_opening(grid)
    if opening is None:
        return float(grid.size**2)
    crossings, length = opening
    return crossings + length / (2 * grid.size**2)
