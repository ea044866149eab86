"""What a result is for its readers: a verdict, tables and lines, printed here on the terminal.

Each subject declares its verdict and its tables once; :mod:`swarm.reports.pages` shows the same
ones as HTML.
"""

import base64
import io
from collections import Counter
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final, Literal

from rich import table as rich_table
from rich.console import Console
from rich.markup import escape
from rich.padding import Padding
from rich.text import Text

from swarm.certification.findings import Finding
from swarm.reports.formatting import counted, seconds

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Level = Literal["", "good", "warn", "bad", "dim", "small", "strong"]
STYLES: Final[dict[Level, str]] = {
    "": "",
    "good": "green",
    "warn": "yellow",
    "bad": "bold red",
    "dim": "dim",
    "small": "dim",
    "strong": "bold",
}
"""Styles of the terminal; pages have classes with the names of the levels."""

SEVERITIES: Final[dict[str, Level]] = {"info": "dim", "warning": "warn", "error": "bad"}
"""Severities of findings, the worst last: the end of the output is what stays on the screen."""

LISTED: Final = 3
"""Findings of one check and severity that are listed without ``--verbose``; a plan far outside its
limits has dozens that differ in time and vehicle only."""


@dataclass(frozen=True)
class Verdict:
    """A result in words, the level of its worst row, and what the words leave out."""

    level: Level
    words: str
    details: str = ""


@dataclass(frozen=True)
class Cell:
    """Words at a level."""

    words: str
    level: Level = ""


Words = str | Cell | tuple[str | Cell, ...]
"""The content of a cell; a tuple has a line each."""


@dataclass(frozen=True)
class Table:
    """A table with its headings; the columns in ``numbers`` (from 0) are aligned to the right.

    Words of the columns in ``whole`` are never broken. ``gap`` is the distance of columns on the
    terminal, in characters.
    """

    columns: Sequence[str]
    rows: Sequence[Sequence[Words]]
    numbers: Collection[int] = ()
    whole: Collection[int] = ()
    gap: int = 2

    def without(self, *columns: int) -> "Table":
        """Return the table without some of its columns; those after them keep their alignment."""
        kept = [k for k in range(len(self.columns)) if k not in columns]
        return replace(
            self,
            columns=[self.columns[k] for k in kept],
            rows=[[row[k] for k in kept] for row in self.rows],
            numbers=[place for place, k in enumerate(kept) if k in self.numbers],
            whole=[place for place, k in enumerate(kept) if k in self.whole],
        )


@dataclass(frozen=True)
class Picture:
    """A figure as a ``data:`` URI, with a description for screen readers.

    A ``wide`` picture fills the page's width.
    """

    uri: str
    description: str
    wide: bool = False


def picture(figure: "Figure", description: str, *, wide: bool = False) -> Picture:
    """Return a figure as a PNG that is embedded in the page."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=120)
    data = base64.b64encode(buffer.getvalue()).decode("ascii")
    return Picture(f"data:image/png;base64,{data}", description, wide)


def compared(words: str, value: float, required: float) -> Cell:
    """Return a distance, green where it is at least ``required``, otherwise red."""
    return Cell(words, "good" if value >= required else "bad")


def drawn(table: Table) -> rich_table.Table:
    """Return a table for the terminal."""
    lines = rich_table.Table(box=None, padding=(0, table.gap, 0, 0), header_style="dim")
    for k, heading in enumerate(table.columns):
        justify: Literal["right", "left"] = "right" if k in table.numbers else "left"
        lines.add_column(heading, justify=justify, no_wrap=k in table.whole)
    for row in table.rows:
        lines.add_row(*map(_drawn_cell, row))
    return lines


def _drawn_cell(words: Words) -> Text | str:
    if isinstance(words, tuple):
        return Text("\n").join(Text.assemble(_drawn_cell(line)) for line in words)
    return Text(words.words, STYLES[words.level]) if isinstance(words, Cell) else escape(words)


def indented(table: rich_table.Table, above: int = 1) -> Padding:
    """Return a table two characters from the edge, with empty lines above it."""
    return Padding(table, (above, 0, 0, 2), expand=False)


def say(console: Console, *lines: str, style: str | None = None) -> None:
    """Print lines of markup, which the terminal wraps."""
    for line in lines:
        console.print(line, style=style, highlight=False, soft_wrap=True)


def print_verdict(verdict: Verdict, console: Console, *, verbose: bool = False) -> None:
    """Print a verdict: wrapped at words on a terminal, one line in a pipe.

    With ``verbose`` its details too, in lines of their own.
    """
    wrapped = console.is_terminal
    console.print(Text(verdict.words, STYLES[verdict.level]), soft_wrap=not wrapped)
    if verbose and verdict.details:
        console.print(verdict.details, soft_wrap=not wrapped, highlight=False)


def findings_table(findings: Iterable[Finding], *, worst_first: bool = False) -> Table:
    """Return a table of findings, remarks before warnings before errors or the other way round."""
    order = list(SEVERITIES)
    ranked = sorted(
        findings,
        key=lambda finding: order.index(finding.severity) * (-1 if worst_first else 1),
    )
    rows = [
        (
            Cell(finding.severity, SEVERITIES[finding.severity]),
            finding.check,
            Cell(finding.message),
            "" if finding.at_time is None else seconds(finding.at_time),
        )
        for finding in ranked
    ]
    return Table(("Finding", "check", "message", "at"), rows, numbers=(3,), whole=(0, 1, 3))


def shortened(findings: Sequence[Finding]) -> list[Finding]:
    """Return at most :data:`LISTED` findings of a check and severity, and the number of the others.

    The number is the message of a finding of its own.
    """
    kinds = Counter((finding.severity, finding.check) for finding in findings)
    shown: Counter[tuple[str, str]] = Counter()
    listed = []
    for finding in findings:
        kind = finding.severity, finding.check
        shown[kind] += 1
        others = kinds[kind] - LISTED
        if shown[kind] <= LISTED:
            listed.append(finding)
        elif shown[kind] == LISTED + 1:
            words = f"and {counted(others, 'more ' + finding.severity)} of this check (--verbose)"
            listed.append(Finding(finding.severity, finding.check, words))
    return listed
