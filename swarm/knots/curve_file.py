"""Curves in text files: points in rows of x, y, z."""

import re

import numpy as np
from numpy.typing import NDArray

from swarm.errors import InputError, Problem, shown
from swarm.knots.curve_defects import find_defect
from swarm.knots.gauss import KnotError
from swarm.knots.invariants import Identification, identify_curve
from swarm.tables import Table

_INDEX = re.compile(r"[0-9]{1,9}")


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

    A row has three numbers, or an index that counts by one before them, or a heading names the
    columns x, y and z. Commas, semicolons, tabs or spaces separate; lines that begin with # are
    comments. Raises :class:`InputError` with each wrong line (at most MOST_PROBLEMS).
    """
    table = Table(text, source, spaces=True)
    indexed, start = not table.heading and table.columns == 4, 1
    if table.heading:
        columns = table.find({"x": "m", "y": "m", "z": "m"})
    elif table.columns in {0, 3, 4}:
        columns = (1, 2, 3) if indexed else (0, 1, 2)
    else:
        message = "expected three numbers, an index and three numbers, or a heading with x, y and "
        message += f"z, got {table.columns} entries"
        if table.columns == 1:
            message += "; the .xyz of a molecule has no curve"
        raise InputError([Problem(f"{source}: line {table.heading_line}", message)])
    rows: list[list[float]] = []
    lines: list[int] = []
    for line, cells in table:
        rows.append([table.number(line, cells, column) for column in columns])
        lines.append(line)
        if indexed:
            start = start if len(rows) > 1 else int(cells[0]) if _INDEX.fullmatch(cells[0]) else 1
            if cells[0] != str(start + len(rows) - 1):
                message = (
                    f"expected the index {start + len(rows) - 1}, since there are four columns "
                )
                message += f"without a heading, got {shown(cells[0])}"
                raise InputError([*table.problems, Problem(table.place(line, 0), message)])
    if len(rows) < 3 and not table.problems:
        table.add(Problem(source, f"expected at least 3 points, got {len(rows)}"))
    table.finish()
    return np.array(rows), lines
