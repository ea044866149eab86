"""Studies of many plans on the terminal: the table of all knots, and a Pareto front."""

from collections.abc import Mapping, Sequence
from statistics import fmean
from typing import Any

from rich.console import Console

from swarm.certification.assessment import rounded_down
from swarm.reports.result import Cell, Table, drawn

Document = Mapping[str, Any]

_SHOWN_COLUMNS = (
    ("knot", "", "knot"),
    ("vehicles", "d", "n"),
    ("grid_vehicles", "d", "2N−1"),
    ("cell", ".2f", "cell"),
    ("cable_length", ".1f", "cable"),
    ("fold_time", ".0f", "fold"),
    ("cable_clearance", ".2f", "clearance"),
    ("cable_clearance_per_cell", ".3f", "/cell"),
    ("max_tracking_error", ".3f", "e*"),
    ("max_wind", ".1f", "w*"),
    ("budget", "+.2f", "budget"),
    ("planning_time", ".1f", "time"),
    ("cleared", "", ""),
)
"""Column, format and heading: n vehicles, those of the grid, metres, seconds, and w* in m/s."""

_HELD = frozenset({"max_tracking_error", "max_wind"})
"""Columns of values up to which a plan is certified."""


def print_plan_rows(rows: Sequence[Document], console: Console) -> None:
    """Print the table of planned knots, and the reasons of those that were refused.

    ``rows`` have the keys of :data:`swarm.studies.COLUMNS`.
    """
    cells = [[_cell(name, row[name], form) for name, form, _ in _SHOWN_COLUMNS] for row in rows]
    numbers = [k for k, (_, form, _) in enumerate(_SHOWN_COLUMNS) if form]
    console.print(drawn(Table([heading for *_, heading in _SHOWN_COLUMNS], cells, numbers)))
    refused = [row for row in rows if not row["cleared"]]
    for row in refused:
        console.print(f"[bold]{row['knot']}[/]: {row['message']}", highlight=False)
    time = sum(row["planning_time"] for row in rows)
    shares = [row["vehicles"] / row["grid_vehicles"] for row in rows if row["cleared"]]
    fewer = (
        f"; vehicles: {fmean(shares):.1%} of 2N−1 in the mean"
        if any(share < 1.0 for share in shares)
        else ""
    )
    console.print(
        f"{len(rows)} knots, {len(refused)} refused{fewer}; {time:.0f} s of processor time",
        highlight=False,
    )


def print_front(points: Sequence[Document], refused: Sequence[str], console: Console) -> None:
    """Print a Pareto front, the shortest cable first, and the refused variants.

    ``points`` have the fields of :class:`swarm.studies.FrontPoint`.
    """
    rows = [
        (
            point["variant"],
            str(point["vehicles"]),
            f"{point['cell']:.2f} m" if point["cell"] else "–",
            f"{point['cable_length']:.1f} m",
            f"{point['fold_time']:.0f} s",
            f"{rounded_down(point['max_tracking_error'], 3):.3f} m",
            f"{1e3 * point['payload']:.0f} g",
            Cell("dominated", "dim") if point["dominated"] else "",
        )
        for point in sorted(points, key=lambda point: float(point["cable_length"]))
    ]
    columns = ("variant", "vehicles", "cell", "cable", "fold", "e*", "payload", "")
    console.print(drawn(Table(columns, rows, numbers=range(1, 7))))
    for variant in refused:
        console.print(f"refused: {variant}", style="yellow", highlight=False)


def _cell(name: str, value: Any, form: str) -> str | Cell:
    if name == "cleared":
        return Cell("cleared", "good") if value else Cell("refused", "bad")
    if name in _HELD and value is not None:
        value = rounded_down(value, int(form[1]))
    return "–" if value is None else format(value, form)
