"""The table of knots in ``swarm.knots``: how it is made, and a check of the whole table.

No plan and no flight needs this package.
"""

from collections.abc import Iterator
from dataclasses import dataclass

from swarm.knots.diagram import Diagram
from swarm.knots.grid_search import MOVES, grid_of_diagram, minimise_grid
from swarm.knots.invariants import identify_diagram
from swarm.knots.table import TableKnot, knot_table


@dataclass(frozen=True)
class TableCheck:
    """The check of one knot: the grid size found by a search, and the knot of that grid.

    ``arc_index`` is that of the table. ``chirality`` is the identified one, "none" for a knot that
    equals its mirror image. ``right`` states whether all agree.
    """

    name: str
    found: int
    arc_index: int
    identified: str
    chirality: str
    right: bool


def check_knot(knot: TableKnot, *, moves: int = MOVES) -> TableCheck:
    """Return the check of a knot: a grid search from its code, without the table's grid."""
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
    """Yield the check of every knot of the table."""
    return (check_knot(knot) for knot in knot_table().values())
