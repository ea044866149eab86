"""Curves in text files: points in rows of x, y, z."""

import csv
from collections.abc import Iterator
from math import isfinite

import numpy as np
from numpy.typing import NDArray

from swarm.errors import InputError, Problem
from swarm.knots.curve_defects import find_defect
from swarm.knots.gauss import KnotError
from swarm.knots.invariants import Identification, identify_curve

_SHOWN = 80
"""Characters of a wrong entry in a message."""
_MAX_PROBLEMS = 10


def identify_text(text: str, source: str, *, closed: bool) -> tuple[Identification, int]:
    """Return the knot of the curve in a text, and the number of its points.

    ``closed`` is as in :func:`swarm.knots.invariants.identify_curve`. Raises :class:`InputError`
    with the lines of wrong numbers, or of points at which the curve meets itself.
    """
    points, lines = parse_curve(text, source)
    defect = find_defect(points, closed=closed)
    if defect:
        numbers = " and ".join(str(lines[index]) for index in defect.points)
        where = f": line{'s' * (len(defect.points) > 1)} {numbers}" if numbers else ""
        raise InputError([Problem(f"{source}{where}", defect.message)])
    try:
        return identify_curve(points, closed=closed), len(points)
    except KnotError as error:
        raise InputError([Problem(source, str(error))]) from None


def parse_curve(text: str, source: str) -> tuple[NDArray[np.float64], list[int]]:
    """Return points (n, 3) and their line numbers.

    A row has three numbers, or a header names the columns x, y and z. Commas, semicolons or spaces
    separate; lines that begin with # are comments. Raises :class:`InputError` with each wrong line
    (at most ten).
    """
    lines = list(_fields(text))
    columns, width = (0, 1, 2), 3
    if lines and not any(map(_is_number, lines[0][1])):
        columns, width = _header(*lines.pop(0), source)
    rows: list[list[float]] = []
    line_numbers: list[int] = []
    problems: list[Problem] = []
    for number, fields in lines:
        where = f"{source}: line {number}"
        if len(fields) != width:
            problems.append(Problem(where, f"expected {width} numbers, got {len(fields)} entries"))
            continue
        chosen = [fields[column] for column in columns]
        wrong = [field for field in chosen if not _is_number(field) or not isfinite(float(field))]
        if wrong:
            problems.append(Problem(where, f'expected finite numbers, got "{wrong[0][:_SHOWN]}"'))
        else:
            rows.append([float(field) for field in chosen])
            line_numbers.append(number)
    if len(rows) < 3 and not problems:
        problems.append(Problem(source, f"expected at least 3 points, got {len(rows)}"))
    if problems:
        raise InputError(problems[:_MAX_PROBLEMS])
    return np.array(rows), line_numbers


def _header(number: int, header: list[str], source: str) -> tuple[tuple[int, int, int], int]:
    """Return the columns of x, y and z, and the number of all columns."""
    names = [field.lower() for field in header]
    if not {"x", "y", "z"} <= set(names):
        got = ", ".join(header)[:_SHOWN]
        message = f"expected numbers, or columns called x, y and z, got {got}"
        raise InputError([Problem(f"{source}: line {number}", message)])
    return (names.index("x"), names.index("y"), names.index("z")), len(names)


def _fields(text: str) -> Iterator[tuple[int, list[str]]]:
    """Yield line number and entries of each line that is neither empty nor a comment."""
    for number, line in enumerate(text.removeprefix("\ufeff").splitlines(), 1):
        bare = line.strip()
        if bare and not bare.startswith("#"):
            separated = "," in bare or ";" in bare
            try:
                entries = next(csv.reader([bare.replace(";", ",")])) if separated else bare.split()
            except csv.Error:
                entries = [bare]  # one entry is longer than any number
            yield number, [entry.strip() for entry in entries]


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
