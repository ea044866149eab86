"""``swarm knots --plan``: every knot planned and certified, a row each, kept as they come."""

import csv
import io
import json
import re
import time
from collections.abc import Generator, Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
from joblib import Parallel, delayed
from rich.console import Console
from rich.progress import track
from rich.table import Table

from swarm import studies
from swarm.cli.inputs import print_json
from swarm.errors import InputError, Problem
from swarm.files import read_text
from swarm.mission.validation import LARGEST_FILE

_SHOWN = (
    ("knot", "", "knot"),
    ("vehicles", "d", "n"),
    ("cell", ".2f", "cell"),
    ("cable_length", ".1f", "cable"),
    ("fold_time", ".0f", "fold"),
    ("cable_clearance", ".2f", "cable clearance"),
    ("cable_clearance_per_cell", ".3f", "/cell"),
    ("max_tracking_error", ".3f", "e*"),
    ("max_wind", ".1f", "w*"),
    ("planning_time", ".1f", "time"),
    ("cleared", "", ""),
)
"""Columns on the terminal: n vehicles, metres, seconds, and w* in m/s."""


@dataclass(frozen=True)
class Wanted:
    """Which knots, how many at once, where rows are kept, and what the default mission becomes."""

    only: str | None
    jobs: int
    target: Path | None
    overrides: tuple[str, ...]
    robustness: bool


def print_planned(wanted: Wanted, *, as_json: bool, as_csv: bool) -> int:
    """Plan the knots that are wanted, print all rows that are known, and return the exit code.

    An interrupt keeps what is done: in the file, and in what is printed.
    """
    names = _chosen(wanted.only)
    known = _known(wanted.target) if wanted.target else {}
    left = [name for name in names if name not in known]
    interrupted = False
    try:
        for row in _planned(left, wanted):
            known[row["knot"]] = row
            if wanted.target:
                with wanted.target.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(row, ensure_ascii=False) + "\n")
    except KeyboardInterrupt:
        interrupted = True
    rows = [known[name] for name in names if name in known]
    if as_json:
        print_json(rows)
    elif as_csv:
        click.echo(_csv(rows), nl=False)
    else:
        _print(rows)
    if interrupted:
        return 130
    return 0 if all(row["cleared"] for row in rows) else 1


def _chosen(only: str | None) -> list[str]:
    try:
        pattern = re.compile(only or "")
    except re.error as error:
        message = f"expected a regular expression, got {only!r}: {error}"
        raise InputError([Problem("--only", message)]) from None
    names = [name for name in studies.knots_to_plan() if pattern.search(name)]
    if not names:
        raise InputError([Problem("--only", f"no knot of the table matches {only!r}")])
    return names


def _known(target: Path) -> dict[str, dict[str, Any]]:
    """Rows of an earlier run; a last line that an interrupt cut off does not count."""
    if not target.exists():
        return {}
    known: dict[str, dict[str, Any]] = {}
    lines = read_text(target, LARGEST_FILE).splitlines()
    for number, line in enumerate(lines, start=1):
        try:
            row = json.loads(line)
            known[row["knot"]] = {name: row[name] for name in studies.COLUMNS}
        except (ValueError, TypeError, KeyError):
            if number == len(lines):
                break
            place = f"{target}: line {number}"
            raise InputError([Problem(place, "expected a row that --plan wrote")]) from None
    return known


def _planned(names: list[str], wanted: Wanted) -> Iterator[dict[str, Any]]:
    tasks = (
        delayed(studies.plan_row)(
            name, wanted.overrides, time.process_time, robustness=wanted.robustness
        )
        for name in names
    )
    rows: Generator[dict[str, Any], None, None]
    rows = Parallel(n_jobs=wanted.jobs, batch_size=1, return_as="generator_unordered")(tasks)
    with closing(rows):
        yield from track(
            rows,
            total=len(names),
            description="planning",
            console=Console(stderr=True),
            transient=True,
        )


def _csv(rows: list[dict[str, Any]]) -> str:
    text = io.StringIO()
    writer = csv.DictWriter(text, studies.COLUMNS, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def _print(rows: list[dict[str, Any]]) -> None:
    table = Table(box=None, padding=(0, 2, 0, 0), header_style="dim")
    for _, form, heading in _SHOWN:
        table.add_column(heading, justify="right" if form else "left")
    for row in rows:
        table.add_row(*(_cell(name, row[name], form) for name, form, _ in _SHOWN))
    console = Console()
    console.print(table)
    refused = [row for row in rows if not row["cleared"]]
    for row in refused:
        console.print(f"[bold]{row['knot']}[/]: {row['message']}", highlight=False)
    took = sum(row["planning_time"] for row in rows)
    console.print(
        f"{len(rows)} knots, {len(refused)} refused; {took:.0f} s of processor time",
        highlight=False,
    )


def _cell(name: str, value: Any, form: str) -> str:
    if name == "cleared":
        return "[green]cleared[/]" if value else "[bold red]refused[/]"
    return "–" if value is None else format(value, form)
