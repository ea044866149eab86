"""Knots, identified curves and opened grid diagrams: JSON and terminal."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Final

from rich.console import Console
from rich.table import Table
from rich.text import Text

from swarm.knots.catalog import KnotChoice
from swarm.knots.grid import OpenGrid
from swarm.knots.invariants import Identification
from swarm.knots.names import COMMON_NAMES

if TYPE_CHECKING:
    from swarm.knot_table import TableCheck

_BENDS: Final = {
    (True, True): "└",
    (True, False): "┘",
    (False, True): "┌",
    (False, False): "┐",
}
"""By (edge goes up, edge goes right)."""

_WIDTH: Final = 3
"""Characters per column, so that cells are about square."""


def knot_object(choice: KnotChoice) -> dict[str, Any]:
    """Return a knot with its codes, grid diagram and number of vehicles."""
    return {
        "name": choice.title or choice.name,
        "crossings": choice.crossings,
        "arc_index": choice.grid.size,
        "vehicles": choice.vehicles,
        "gauss": choice.gauss,
        "dt": list(choice.diagram.dt()),
        "chirality": choice.chirality,
        "grid": {"size": choice.grid.size, "columns": [list(pair) for pair in choice.grid.columns]},
    }


def identification_object(identification: Identification) -> dict[str, Any]:
    """Return the name of an identified curve and its invariants."""
    return {
        "name": identification.name,
        "chirality": identification.chirality,
        "crossings": identification.crossings,
        "candidates": list(identification.candidates),
        "invariants": identification.invariants,
    }


def grid_text(opened: OpenGrid) -> Text:
    """Return the opened grid diagram in box characters; the two removed edges are dotted."""
    grid = opened.grid
    text = Text()
    for row in range(grid.size, 0, -1):
        text.append(f"{row:3d}  ", "dim")
        for column in range(1, grid.size + 1):
            for letter, style in _cell(opened, column, row):
                text.append(letter, style)
        text.append("\n")
    numbers = "".join(f"{column:<{_WIDTH}d}" for column in range(1, grid.size + 1))
    text.append("     " + numbers.rstrip(), "dim")
    return text


def _cell(opened: OpenGrid, column: int, row: int) -> list[tuple[str, str]]:
    """Return a cell's character, and the filling towards the next column, with their styles."""
    grid = opened.grid
    (low, high), (left, right) = grid.columns[column - 1], grid.rows[row - 1]
    removed_column, removed_row = opened.removed
    ghost = "dim"
    row_style = ghost if row == removed_row else ""
    column_style = ghost if column == removed_column else ""
    filling = " " * (_WIDTH - 1)
    if left <= column < right:
        filling = ("┄" if row == removed_row else "─") * (_WIDTH - 1)
    if row in (low, high):
        bend = _BENDS[row == low, column == left]
        if (column, row) == opened.removed:
            return [("×", ghost), (filling, row_style)]
        end = (column, row) in (opened.corners[0], opened.corners[-1])
        return [("●" if end else bend, "bold" if end else ""), (filling, row_style)]
    if low < row < high:
        return [("┆" if column == removed_column else "│", column_style), (filling, row_style)]
    if left < column < right:
        return [("┄" if row == removed_row else "─", row_style), (filling, row_style)]
    return [(" ", ""), (filling, row_style)]


_CHIRALITIES = {
    "none": "its own mirror image",
    "right": "right-handed; its mirror image is another knot",
    "left": "left-handed; its mirror image is another knot",
}


def print_knots(choices: Sequence[KnotChoice], console: Console) -> None:
    """Print a table of knots with their vehicles and common names."""
    common: dict[str, list[str]] = {}
    for word, name in COMMON_NAMES.items():
        common.setdefault(name, []).append(word)
    table = Table("knot", "arc index", "vehicles", "mirror image", "common names", box=None)
    for choice in choices:
        mirror = "the same" if choice.chirality == "none" else "another"
        words = ", ".join(common.get(choice.name, ()))
        table.add_row(choice.name, str(choice.grid.size), str(choice.vehicles), mirror, words)
    console.print(table)
    sums = ", ".join(f"{word} = {name}" for word, name in COMMON_NAMES.items() if "#" in name)
    console.print(
        f"\n{len(choices)} prime knots to ten crossings. Sums: {sums}; others such as 3_1#m4_1. "
        "Torus knots: torus(3,5). Mirror images: m3_1.",
        highlight=False,
    )


def print_knot(choice: KnotChoice, console: Console) -> None:
    """Print a knot with its codes and its opened grid diagram."""
    facts = Table.grid(padding=(0, 2))
    opened = choice.opening
    for key, value in (
        ("knot", f"{choice.title or choice.name}, {_CHIRALITIES[choice.chirality]}"),
        ("crossings", str(choice.crossings)),
        ("arc index", f"{choice.grid.size}"),
        ("vehicles", f"{choice.vehicles}, with {choice.vehicles - 1} segments of cable"),
        ("Gauss code", choice.gauss or "(no crossings)"),
        ("signed", choice.diagram.code.signed_text() or "(no crossings)"),
        ("DT code", " ".join(map(str, choice.diagram.dt())) or "(no crossings)"),
        ("columns", " ".join(f"{low}-{high}" for low, high in choice.grid.columns)),
        ("opened", f"{len(opened.crossings)} crossings, {opened.length} cells of cable in plan"),
    ):
        facts.add_row(f"[dim]{key}[/dim]", value)
    console.print(facts)
    for warning in choice.warnings:
        console.print(warning, style="yellow")
    console.print()
    console.print(grid_text(opened))


def print_table_check(checks: Sequence["TableCheck"], console: Console) -> None:
    """Print the check of the whole table, a row per knot."""
    table = Table("knot", "N found", "arc index", "identified", "chirality", "", box=None)
    for check in checks:
        table.add_row(
            check.name,
            str(check.found),
            str(check.arc_index),
            check.identified,
            check.chirality,
            "" if check.right else "WRONG",
        )
    console.print(table)
    wrong = sum(not check.right for check in checks)
    console.print(f"{len(checks)} knots, {wrong} wrong", highlight=False)


def print_identification(identification: Identification, points: int, console: Console) -> None:
    """Print the name of an identified curve, and its invariants."""
    invariants = identification.invariants
    console.print(f"{identification}", style="bold")
    console.print(f"{points} points; at most {identification.crossings} crossings")
    console.print(f"Jones polynomial      {_polynomial(invariants['jones'])}")
    console.print(f"Alexander polynomial  {_polynomial(invariants['alexander'])}")


def _polynomial(coefficients: dict[int, int] | None) -> str:
    """Return a polynomial in t, lowest power first."""
    if coefficients is None:
        return "not computed: too many crossings"
    terms = []
    for power, coefficient in coefficients.items():
        size = "" if abs(coefficient) == 1 and power else str(abs(coefficient))
        variable = "" if power == 0 else "t" if power == 1 else f"t^{power}"
        terms.append(("- " if coefficient < 0 else "+ ") + size + variable)
    return " ".join(terms).removeprefix("+ ")
