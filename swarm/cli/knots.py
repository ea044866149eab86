"""``swarm knots`` and ``swarm identify``: the catalogue, and the names of curves."""

import csv
from collections.abc import Iterator
from math import isfinite
from pathlib import Path
from typing import Any

import click
import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import track
from rich.table import Table

from swarm.cli.inputs import JSON, SET, print_json
from swarm.cli.knots_planned import Wanted, print_planned
from swarm.errors import InputError, Problem
from swarm.files import read_text
from swarm.knots.catalog import KnotChoice, lookup_knot, table_names
from swarm.knots.curve_defects import find_defect
from swarm.knots.gauss import KnotError
from swarm.knots.invariants import Identification, identify_curve
from swarm.knots.names import COMMON_NAMES
from swarm.knots.table_check import TableCheck, check_table
from swarm.mission.validation import LARGEST_FILE
from swarm.reports.grid_text import grid_text

_SHOWN = 80
"""Characters of a wrong entry that are shown."""


@click.command()
@click.argument("name", required=False)
@JSON
@click.option(
    "--plot",
    type=click.Path(dir_okay=False, path_type=Path),
    help="Draw the grid diagram of NAME as PNG.",
)
@click.option(
    "--table",
    "whole_table",
    is_flag=True,
    help="Search every knot's grid diagram anew, name it again, and print the outcome.",
)
@click.option("--plan", "planning", is_flag=True, help="Plan and certify every knot; see below.")
@click.option("--only", metavar="REGEX", help="With --plan: only knots whose names match.")
@click.option(
    "--jobs", type=click.IntRange(1, 64), default=1, help="With --plan: so many at the same time."
)
@click.option(
    "--to",
    "target",
    type=click.Path(dir_okay=False, path_type=Path),
    help="With --plan: add rows to this file (JSON lines); knots in it are not planned again.",
)
@click.option("--csv", "as_csv", is_flag=True, help="With --plan: print the table as CSV.")
@click.option("--no-robustness", is_flag=True, help="With --plan: without e* and w*.")
@SET
@click.pass_context
def knots(
    context: click.Context,
    name: str | None,
    as_json: bool,
    plot: Path | None,
    whole_table: bool,
    planning: bool,
    only: str | None,
    jobs: int,
    target: Path | None,
    as_csv: bool,
    no_robustness: bool,
    overrides: tuple[str, ...],
) -> None:
    """List the knots, or show the one called NAME.

    NAME is a knot of the table (8_18), a common name (overhand, "carrick mat"), torus(p,q), a
    mirror image (m3_1) or a sum (3_1#m3_1).

    With --plan, every prime knot to ten crossings and some sums and torus knots are planned with
    the default mission (and --set) and certified: vehicles, cable, fold time, clearances, e*, w*,
    processor time, and what was tried where nothing was cleared. Exit code 1 if any was not.
    """
    if planning:
        if name or plot or whole_table:
            raise click.UsageError("--plan is of many knots: use --only instead of a NAME")
        wanted = Wanted(only, jobs, target, overrides, not no_robustness)
        context.exit(print_planned(wanted, as_json=as_json, as_csv=as_csv))
    if only or target or as_csv or no_robustness or overrides or jobs > 1:
        raise click.UsageError("these options belong to --plan")
    if name is None and plot is not None:
        raise click.UsageError("--plot needs the NAME of a knot")
    if whole_table:
        if name is not None:
            raise click.UsageError("--table is of all knots: leave NAME out")
        context.exit(_print_survey(as_json))
    if name is None:
        _print_list(as_json)
        return
    choice = lookup_knot(name)
    if plot is not None:
        # Drawing takes a second to load, which names and curves need not wait for.
        from swarm.reports.grid_plot import plot_grid  # noqa: PLC0415

        plot_grid(choice, plot)
    if as_json:
        print_json(knot_object(choice))
    else:
        _print_knot(choice)


def knot_object(choice: KnotChoice) -> dict[str, Any]:
    """What ``swarm knots NAME --json`` prints."""
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


def _print_list(as_json: bool) -> None:
    choices = [lookup_knot(name) for name in table_names()]
    if as_json:
        print_json([knot_object(choice) for choice in choices])
        return
    common: dict[str, list[str]] = {}
    for word, name in COMMON_NAMES.items():
        common.setdefault(name, []).append(word)
    table = Table("knot", "arc index", "vehicles", "mirror image", "also called", box=None)
    for choice in choices:
        mirror = "the same" if choice.chirality == "none" else "another"
        words = ", ".join(common.get(choice.name, ()))
        table.add_row(choice.name, str(choice.grid.size), str(choice.vehicles), mirror, words)
    console = Console()
    console.print(table)
    sums = ", ".join(f"{word} = {name}" for word, name in COMMON_NAMES.items() if "#" in name)
    console.print(
        f"\n{len(choices)} prime knots to ten crossings. Sums: {sums}; any other as 3_1#m4_1. "
        "Torus knots: torus(3,5). Mirror images: m3_1.",
        highlight=False,
    )


def _print_knot(choice: KnotChoice) -> None:
    console = Console(highlight=False)
    hand = {
        "none": "its own mirror image",
        "right": "right-handed; its mirror image is another knot",
        "left": "left-handed; its mirror image is another knot",
    }[choice.chirality]
    facts = Table.grid(padding=(0, 2))
    opened = choice.opening
    for key, value in (
        ("knot", f"{choice.title or choice.name}, {hand}"),
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


def _print_survey(as_json: bool) -> int:
    rows: list[TableCheck] = list(
        track(
            check_table(),
            total=len(table_names()),
            description="searching grids",
            console=Console(stderr=True),
            transient=True,
        )
    )
    wrong = [row for row in rows if not row.right]
    if as_json:
        print_json([vars(row) for row in rows])
        return 1 if wrong else 0
    table = Table("knot", "N found", "arc index", "identified", "chirality", "", box=None)
    for row in rows:
        table.add_row(
            row.name,
            str(row.found),
            str(row.arc_index),
            row.identified,
            row.chirality,
            "" if row.right else "WRONG",
        )
    console = Console()
    console.print(table)
    console.print(f"{len(rows)} knots, {len(wrong)} wrong", highlight=False)
    return 1 if wrong else 0


@click.command()
@click.argument("file", type=click.Path(dir_okay=False, path_type=Path))
@click.option("--closed", is_flag=True, help="The last point is joined to the first.")
@JSON
def identify(file: Path, closed: bool, as_json: bool) -> None:
    """Name the knot of the curve in FILE: rows of x, y, z, or columns with these names.

    The ends of an open curve are taken straight up and joined above it.
    """
    known, count = _identified(read_text(file, LARGEST_FILE), str(file), closed)
    if as_json:
        print_json(identification_object(known))
        return
    console = Console(highlight=False)
    console.print(f"{known}", style="bold")
    console.print(f"{count} points; at most {known.crossings} crossings")
    console.print(f"Jones polynomial      {_polynomial(known.invariants['jones'])}")
    console.print(f"Alexander polynomial  {_polynomial(known.invariants['alexander'])}")


def _identified(text: str, place: str, closed: bool) -> tuple[Identification, int]:
    """The knot of a file's curve, and how many points it has; errors say where in the file."""
    points, lines = parse_curve(text, place)
    wrong = find_defect(points, closed=closed)
    if wrong:
        numbers = " and ".join(str(lines[index]) for index in wrong.points)
        where = f": line{'s' * (len(wrong.points) > 1)} {numbers}" if numbers else ""
        raise InputError([Problem(f"{place}{where}", wrong.message)])
    try:
        return identify_curve(points, closed=closed), len(points)
    except KnotError as error:
        raise InputError([Problem(place, str(error))]) from None


def identification_object(known: Identification) -> dict[str, Any]:
    """What ``swarm identify --json`` prints."""
    return {
        "name": known.name,
        "chirality": known.chirality,
        "crossings": known.crossings,
        "candidates": list(known.candidates),
        "invariants": known.invariants,
    }


def parse_curve(text: str, place: str) -> tuple[NDArray[np.float64], list[int]]:
    """Points (n, 3) from rows of three numbers, or from the columns called x, y and z; their lines.

    Commas, semicolons or spaces separate; lines that begin with # do not count. Raises InputError
    that names each wrong line (at most ten).
    """
    lines = list(_fields(text))
    columns, width = (0, 1, 2), 3
    if lines and not any(map(_is_number, lines[0][1])):
        number, header = lines.pop(0)
        words = [field.lower() for field in header]
        if not {"x", "y", "z"} <= set(words):
            got = ", ".join(header)[:_SHOWN]
            message = f"expected numbers, or columns called x, y and z, got {got}"
            raise InputError([Problem(f"{place}: line {number}", message)])
        columns, width = (words.index("x"), words.index("y"), words.index("z")), len(words)
    rows: list[list[float]] = []
    kept: list[int] = []
    problems: list[Problem] = []
    for number, fields in lines:
        where = f"{place}: line {number}"
        if len(fields) != width:
            problems.append(Problem(where, f"expected {width} numbers, got {len(fields)} entries"))
            continue
        chosen = [fields[column] for column in columns]
        wrong = [field for field in chosen if not _is_number(field) or not isfinite(float(field))]
        if wrong:
            problems.append(Problem(where, f'expected finite numbers, got "{wrong[0][:_SHOWN]}"'))
        else:
            rows.append([float(field) for field in chosen])
            kept.append(number)
    if len(rows) < 3 and not problems:
        problems.append(Problem(place, f"expected at least 3 points, got {len(rows)}"))
    if problems:
        raise InputError(problems[:10])
    return np.array(rows), kept


def _fields(text: str) -> Iterator[tuple[int, list[str]]]:
    """Line number and entries of every line that says something."""
    for number, line in enumerate(text.removeprefix("\ufeff").splitlines(), 1):
        bare = line.strip()
        if bare and not bare.startswith("#"):
            marked = "," in bare or ";" in bare
            try:
                entries = next(csv.reader([bare.replace(";", ",")])) if marked else bare.split()
            except csv.Error:
                entries = [bare]  # one entry is longer than any number
            yield number, [entry.strip() for entry in entries]


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _polynomial(coefficients: dict[int, int] | None) -> str:
    """A polynomial in t, lowest power first."""
    if coefficients is None:
        return "not computed: too many crossings"
    terms = []
    for power, coefficient in coefficients.items():
        size = "" if abs(coefficient) == 1 and power else str(abs(coefficient))
        variable = "" if power == 0 else "t" if power == 1 else f"t^{power}"
        terms.append(("- " if coefficient < 0 else "+ ") + size + variable)
    return " ".join(terms).removeprefix("+ ")
