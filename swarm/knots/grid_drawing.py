"""The direct construction of a grid diagram from a planar diagram of the same knot.

The diagram is drawn upward, row by row. Unfinished strands end at the top, in an order from left to
right, and crossings are added one after another. Each strand is a vertical line. A crossing adds
one or two horizontal edges: the upper strand continues straight, and the lower one steps across
beneath it. Two neighbouring ends of the same edge are joined by another horizontal edge. Every
horizontal edge has a row of its own.

The drawn part is a disc of the sphere, so its loose ends have a cyclic order: the first strand on
the left is also a neighbour of the last one on the right. A rotation of that order is a translation
of the grid on the torus.
"""

from swarm.knots.diagram import Diagram
from swarm.knots.grid import Grid
from swarm.knots.simplify import without_nugatory

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

    def _join(self, one: int, two: int) -> None:
        """Draw a cap: a horizontal edge that ends two columns."""
        self.row += 1
        self.ends[one].append(self.row)
        self.ends[two].append(self.row)

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
