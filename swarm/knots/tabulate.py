"""Write ``table.txt``: ``python -m swarm.knots.tabulate``.

The names and Conway notations in ``conway.txt`` are those of Rolfsen's table (Conway 1970, Rolfsen
1976) without the second knot of the Perko pair, numbered as in KnotInfo. The diagrams, chiralities,
polynomials and grid diagrams are computed here.
"""

from importlib import resources
from pathlib import Path

from swarm.knots.alexander import alexander_polynomial
from swarm.knots.chirality import AMPHICHIRAL, is_right_handed
from swarm.knots.connected_sums import table_order
from swarm.knots.conway import diagram_of_conway
from swarm.knots.diagram import Diagram, diagrams_of_dt
from swarm.knots.grid_drawing import grid_of_diagram
from swarm.knots.grid_reduction import smallest_grid
from swarm.knots.jones import jones_polynomial
from swarm.knots.simplify import simplified
from swarm.knots.table import TableKnot

MOVES = 400_000
"""Attempted moves for a knot with an unknown arc index."""


def tabulate_knot(
    name: str, notation: str, *, moves: int = MOVES, starts: int = 24, steps: int = 400
) -> TableKnot:
    """Return the table's entry of a knot from its Conway notation."""
    chiral = name not in AMPHICHIRAL
    drawing = simplified(diagram_of_conway(notation), kicks=500)
    if drawing.crossings != table_order(name)[0]:
        raise RuntimeError(f"{name} has {drawing.crossings} crossings")
    dt = drawing.dt()
    diagram = _right(diagrams_of_dt(dt), chiral)
    # The arc index of an alternating knot is known (Bae and Park 2000).
    target = drawing.crossings + 2 if drawing.alternating else 2
    grid = smallest_grid(
        grid_of_diagram(diagram),
        target=target,
        starts=starts,
        steps=steps,
        moves=moves,
        fewest=drawing.crossings,
    )
    return TableKnot(
        name=name,
        chiral=chiral,
        dt=dt,
        first_sign=diagram.code.passes[0][2],
        jones=tuple(jones_polynomial(diagram).items()),
        alexander=tuple(alexander_polynomial(diagram).items()),
        grid=grid,
    )


def _right(pair: tuple[Diagram, ...], chiral: bool) -> Diagram:
    """Return the right-handed diagram of a mirror pair; the first where both are possible."""
    if chiral:
        for diagram in pair:
            if is_right_handed(jones_polynomial(diagram)):
                return diagram
    return pair[0]


def main() -> None:
    """Write the table next to this file."""
    text = resources.files("swarm.knots").joinpath("conway.txt").read_text(encoding="utf-8")
    lines = []
    for entry in text.splitlines():
        name, notation = entry.split()
        lines.append(tabulate_knot(name, notation).line())
    target = Path(__file__).with_name("table.txt")
    target.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
