"""The table of the 249 prime knots to ten crossings, from ``python -m swarm.knot_table``."""

from dataclasses import dataclass
from functools import cached_property, lru_cache
from importlib import resources

from swarm.knots.diagram import Diagram, diagrams_of_dt
from swarm.knots.gauss import KnotError
from swarm.knots.grid import Grid

Laurent = tuple[tuple[int, int], ...]
"""A polynomial as sorted (power, coefficient) pairs."""


@dataclass(frozen=True)
class TableKnot:
    """A prime knot, right-handed if it is chiral.

    ``first_sign`` is the sign of the first crossing in the diagram of the DT code.
    """

    name: str
    chiral: bool
    dt: tuple[int, ...]
    first_sign: int
    jones: Laurent
    alexander: Laurent
    grid: Grid

    @property
    def crossings(self) -> int:
        """Crossing number."""
        return len(self.dt)

    @property
    def arc_index(self) -> int:
        """Size of the smallest grid diagram."""
        return self.grid.size

    @cached_property
    def diagram(self) -> Diagram:
        """A diagram with the fewest crossings, right-handed if the knot is chiral."""
        return next(
            diagram
            for diagram in diagrams_of_dt(self.dt)
            if diagram.code.passes[0][2] == self.first_sign
        )


def _read_polynomial(text: str) -> Laurent:
    low, coefficients = text.split(":")
    return tuple((k, int(c)) for k, c in enumerate(coefficients.split(","), int(low)) if int(c))


def read_line(line: str) -> TableKnot:
    """Return the knot of a line of the table's file."""
    name, kind, dt, sign, jones, alexander, columns = line.rstrip("\n").split("\t")
    pairs = (column.split("-") for column in columns.split(" "))
    return TableKnot(
        name=name,
        chiral=kind == "chiral",
        dt=tuple(map(int, dt.split(" "))),
        first_sign=1 if sign == "+" else -1,
        jones=_read_polynomial(jones),
        alexander=_read_polynomial(alexander),
        grid=Grid(tuple((int(low), int(high)) for low, high in pairs)),
    )


@lru_cache(maxsize=1)
def knot_table() -> dict[str, TableKnot]:
    """Return all knots of the table by name, in its order."""
    text = resources.files("swarm.knots").joinpath("table.txt").read_text(encoding="utf-8")
    knots = [read_line(line) for line in text.splitlines()]
    return {knot.name: knot for knot in knots}


def prime_knot(name: str) -> TableKnot:
    """Return the knot of a name such as ``8_18``. Raises KnotError for a name not in the table."""
    try:
        return knot_table()[name]
    except KeyError:
        raise KnotError(f'"{name}" is not in the table of prime knots to ten crossings') from None
