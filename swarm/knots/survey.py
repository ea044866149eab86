"""The whole table put to the test: every knot's grid found again by search, and named again."""

from collections.abc import Iterator
from dataclasses import dataclass

from swarm.knots.diagram import Diagram
from swarm.knots.draw import drawn
from swarm.knots.invariants import identify_diagram
from swarm.knots.search import MOVES, minimised
from swarm.knots.table import TableKnot, table


@dataclass(frozen=True)
class SurveyRow:
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


def surveyed(knot: TableKnot, *, moves: int = MOVES) -> SurveyRow:
    """Search a grid from the knot's code, without the table's grid, and name what was found."""
    target = knot.crossings + 2 if knot.diagram.alternating else 2
    grid = minimised(drawn(knot.diagram), target=target, moves=moves)
    known = identify_diagram(Diagram(grid.code))
    chirality = "right" if knot.chiral else "none"
    right = (
        known.name == knot.name
        and known.chirality == chirality
        and grid.size == knot.arc_index
        and identify_diagram(Diagram(knot.grid.code)).candidates == known.candidates
    )
    return SurveyRow(knot.name, grid.size, knot.arc_index, known.name, known.chirality, right)


def survey() -> Iterator[SurveyRow]:
    """A row for every knot of the table."""
    return (surveyed(knot) for knot in table().values())
