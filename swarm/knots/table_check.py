"""The whole table put to the test: every knot's grid found again by search, and named again."""

from collections.abc import Iterator
from dataclasses import dataclass

from swarm.knots.diagram import Diagram
from swarm.knots.grid_drawing import grid_of_diagram
from swarm.knots.grid_search import MOVES, minimise_grid
from swarm.knots.invariants import identify_diagram
from swarm.knots.table import TableKnot, knot_table


@dataclass(frozen=True)
class TableCheck:
    """One knot: the grid size that a search from its code found, and what that grid is.

    ``arc_index`` is the table's. ``chirality`` is what was identified, "none" for a knot that is
    its own mirror image.
    """

    name: str
    found: int
    arc_index: int
    identified: str
    chirality: str
    right: bool


def check_knot(knot: TableKnot, *, moves: int = MOVES) -> TableCheck:
    """Search a grid from the knot's code, without the table's grid, and name what was found."""
    target = knot.crossings + 2 if knot.diagram.alternating else 2
    grid = minimise_grid(grid_of_diagram(knot.diagram), target=target, moves=moves)
    known = identify_diagram(Diagram(grid.code))
    chirality = "right" if knot.chiral else "none"
    right = (
        known.name == knot.name
        and known.chirality == chirality
        and grid.size == knot.arc_index
        and identify_diagram(Diagram(knot.grid.code)).candidates == known.candidates
    )
    return TableCheck(knot.name, grid.size, knot.arc_index, known.name, known.chirality, right)


def check_table() -> Iterator[TableCheck]:
    """A row for every knot of the table."""
    return (check_knot(knot) for knot in knot_table().values())
