"""Tables that people hand in: cable lists, motions and curves.

Commas, semicolons or tabs separate, or what a first line ``sep=`` names. Text that has two readings
is refused with its line and column: it is never guessed which one is meant.
"""

import csv
import io
import math
import re
from collections.abc import Iterator, Mapping, Sequence

from swarm.errors import InputError, Problem, shown

MOST_PROBLEMS = 20
"""Errors that are reported at once: about a terminal page."""

_NUMBER = re.compile(r"[+-]?(?:[0-9]+[.,]?[0-9]*|[.,][0-9]+)(?:[eE][+-]?[0-9]{1,4})?")
_THOUSANDS = re.compile(r"[+-]?[1-9][0-9]{0,2},[0-9]{3}")
_NOT_FINITE = re.compile(r"[+-]?(?:nan|inf|infinity)", re.IGNORECASE)
_CONTROL = re.compile(r"[\x00-\x08\x0b\x0c\x0e-\x1f\x7f]")
_DECLARED = re.compile(r'"?sep=([,;\t])"?[^\S\t]*', re.IGNORECASE)
_UNIT = re.compile(r"([^\[\](){}]{0,99})[\[(]([^\[\](){}]{0,9})[\])]")
_STAMPS = {1.0: "seconds", 1e3: "milliseconds", 1e6: "microseconds", 1e9: "nanoseconds"}
_LATE, _LATEST = 946_684_800.0, 4_102_444_800.0
"""Seconds from 1970 to 2000 and to 2100."""


class Table:
    """Rows of text cells, each with its line, and the heading if there is one.

    ``heading`` are the names of the columns in lower case, empty without a heading. ``problems``
    are errors so far; :meth:`add` raises :class:`InputError` with all when they are MOST_PROBLEMS,
    and :meth:`finish` when there are any.
    """

    def __init__(self, text: str, source: str, *, spaces: bool = False) -> None:
        """Read the heading; with ``spaces``, blanks separate too.

        Raises :class:`InputError` for control characters, an unclosed quote, and a column twice.
        """
        self.source, self.problems = source, list[Problem]()
        self._decimal: tuple[str, int] | None = None
        self._doubtful: Problem | None = None
        _refuse_control_characters(text, source)
        self._rows = self._read(text, spaces)
        first = next(self._rows, None)
        cells = first[1] if first else []
        self._width = len(cells)
        self.heading: tuple[str, ...] = ()
        self._units: tuple[str, ...] = ()
        self.heading_line = first[0] if first else 1
        if first and not any(_NUMBER.fullmatch(cell) for cell in cells):
            split = [_UNIT.fullmatch(cell) for cell in cells]
            self.heading = tuple(
                (match[1].rstrip() if match else cell).lower()
                for match, cell in zip(split, cells, strict=True)
            )
            self._units = tuple(match[2].strip() if match else "" for match in split)
            self._refuse_same_names()
            self._blank = {k for k, name in enumerate(self.heading) if not name}
            self._first = None
        else:
            self._blank = {k for k, cell in enumerate(cells) if not cell}
            self._first = first

    @property
    def columns(self) -> int:
        """Number of columns; one at the end without name and content is not counted."""
        return self._width - (self._width - 1 in self._blank)

    def find(self, units: Mapping[str, str]) -> tuple[int, ...]:
        """Return the positions of named columns; ``units`` are their names, with their units.

        Raises :class:`InputError` for a missing column, and for one in another unit.
        """
        place = f"{self.source}: line {self.heading_line}"
        missing = [name for name in units if name not in self.heading]
        if missing:
            got = shown(", ".join(self.heading)) if self.heading else "no heading"
            message = f"expected the columns {', '.join(missing)}, got {got}"
            raise InputError([*self.problems, Problem(place, message)])
        positions = tuple(self.heading.index(name) for name in units)
        for (name, unit), column in zip(units.items(), positions, strict=True):
            got = self._units[column].replace("^", "").replace("²", "2")
            if got not in {"", unit}:
                message = f"{name}: expected {unit or 'no unit'}, got {self._units[column]}"
                self.add(Problem(f"{place}, column {column + 1}", message))
        return positions

    def __iter__(self) -> Iterator[tuple[int, list[str]]]:
        """Yield the line and the cells of every row; rows of another width are problems."""
        if self._first:
            yield self._first
        for line, cells in self._rows:
            if len(cells) != self._width:
                message = f"expected as many columns as line {self.heading_line} has "
                message += f"({self._width}), got {len(cells)}"
                if len(cells) > self._width:
                    message += "; decimal commas need semicolons or tabs between columns"
                self.add(Problem(f"{self.source}: line {line}", message))
                continue
            extra = next((k for k in self._blank if cells[k]), None)
            if extra is None:
                yield line, cells
            else:
                message = f"expected nothing in a column without a name, got {shown(cells[extra])}"
                self.add(Problem(self.place(line, extra), message))

    def number(
        self,
        line: int,
        cells: Sequence[str],
        column: int,
        name: str = "",
        least: float = -math.inf,
        most: float = math.inf,
    ) -> float:
        """Return the number in a cell, ``least`` to ``most``; NaN for another, a problem."""
        text = cells[column]
        if not _NUMBER.fullmatch(text):
            finite = "finite " if _NOT_FINITE.fullmatch(text) else ""
            return self.wrong(line, cells, column, name, f"a {finite}number")
        mark = "," if "," in text else "." if "." in text else ""
        if mark == "," and _THOUSANDS.fullmatch(text) and (self._decimal or ".")[0] != ",":
            self._doubtful = self._doubtful or Problem(
                self.place(line, column),
                f"expected a number with one reading, got {text!r}: {text.replace(',', '.')} or "
                f"{text.replace(',', '')}?",
            )
        elif mark:
            self._decimal = self._decimal or (mark, line)
            if self._decimal[0] != mark:
                kind = "points" if mark == "," else "commas"
                where = f"decimal {kind} as in line {self._decimal[1]}"
                return self.wrong(line, cells, column, name, where)
        value = float(text.replace(",", "."))
        if not math.isfinite(value):
            return self.wrong(line, cells, column, name, "a finite number")
        if not least <= value <= most:
            return self.wrong(line, cells, column, name, f"{least:g} to {most:g}")
        return value

    def wrong(
        self, line: int, cells: Sequence[str], column: int, name: str, expected: str
    ) -> float:
        """Add the problem of a cell, and return NaN."""
        message = f"expected {expected}, got {shown(cells[column])}"
        self.add(Problem(self.place(line, column), f"{name}: {message}" if name else message))
        return math.nan

    def place(self, line: int, column: int) -> str:
        """Return the place of a cell for messages; columns count from 1."""
        return f"{self.source}: line {line}, column {column + 1}"

    def add(self, problem: Problem) -> None:
        """Add a problem; raises :class:`InputError` with all of them when they are many."""
        self.problems.append(problem)
        if len(self.problems) >= MOST_PROBLEMS:
            raise InputError(self.problems)

    def finish(self) -> None:
        """Raise :class:`InputError` with the problems, if there are any."""
        if self._doubtful and (self._decimal or ".")[0] != ",":
            self.problems.append(self._doubtful)
        if self.problems:
            raise InputError(self.problems)

    def _read(self, text: str, spaces: bool) -> Iterator[tuple[int, list[str]]]:
        """Yield the line and the cells of rows that are neither empty nor a comment (#)."""
        lines = io.StringIO(text, newline="")
        kept = ("\n" if line.lstrip().startswith("#") else line for line in lines)
        skipped, first = 0, ""
        for first in kept:
            skipped += 1
            if first.strip():
                break
        declared = _DECLARED.fullmatch(first.strip("\r\n"))
        if declared:
            separator, first = declared[1], "\n"
        else:
            unquoted = re.sub(r'"[^"]*"', "", first.strip(" \r\n"))
            separator = next((mark for mark in ";\t," if mark in unquoted), ",")
            if spaces and not {",", ";"} & set(unquoted):
                separator = " "
        if separator == " ":
            for number, line in enumerate(_chained(first, kept), skipped):
                if line.strip():
                    yield number, line.split()
            return
        reader = csv.reader(_chained(first, kept), delimiter=separator, strict=True)
        begun = skipped - 1
        try:
            for row in reader:
                cells = [cell.strip() for cell in row]
                if len(cells) > 1 or any(cells):
                    yield begun + 1, cells
                begun = skipped - 1 + reader.line_num
        except csv.Error as error:
            place = f"{self.source}: line {begun + 1}"
            raise InputError([*self.problems, Problem(place, f"not a table: {error}")]) from None

    def _refuse_same_names(self) -> None:
        for column, name in enumerate(self.heading):
            if name and name in self.heading[:column]:
                message = f"expected each column once, got {shown(name)} again"
                self.add(Problem(self.place(self.heading_line, column), message))
        if self.problems:
            raise InputError(self.problems)


def stamp_problem(text: str) -> str | None:
    """Return the error of a time in seconds that is a stamp since 1970; None for others."""
    time = float(text.replace(",", ".")) if _NUMBER.fullmatch(text) else math.nan
    unit = stamp_unit(time)
    return f"expected seconds from the start, got {text}: a Unix stamp in {unit}" if unit else None


def stamp_unit(number: float) -> str | None:
    """Return the unit in which a number is the time from 1970 to a date from 2000 to 2100."""
    units = (unit for scale, unit in _STAMPS.items() if _LATE <= number / scale <= _LATEST)
    return next(units, None)


def _chained(first: str, rest: Iterator[str]) -> Iterator[str]:
    yield first
    yield from rest


def _refuse_control_characters(text: str, source: str) -> None:
    match = _CONTROL.search(text)
    if match:
        before = text[: match.start()]
        line = 1 + len(re.findall(r"\r\n|\r|\n", before))
        column = 1 + len(re.split(r"[\r\n]", before)[-1])
        message = f"expected text, got the control character {ord(match[0])}"
        raise InputError([Problem(f"{source}: line {line}, character {column}", message)])
