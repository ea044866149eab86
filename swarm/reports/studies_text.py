"""Studies of many plans on the terminal: the table of all knots, and a Pareto front."""

from collections.abc import Mapping, Sequence
from statistics import fmean
from typing import Any

from rich.console import Console
from rich.table import Table

from swarm.certification.assessment import rounded_down

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


def print_plan_rows(rows: Sequence[Mapping[str, Any]], console: Console) -> None:
    """Print the table of planned knots, and the reasons of those that were refused.

    ``rows`` have the keys of :data:`swarm.studies.COLUMNS`.
    """
    table = Table(box=None, padding=(0, 2, 0, 0), header_style="dim")
    for _, form, heading in _SHOWN_COLUMNS:
        table.add_column(heading, justify="right" if form else "left")
    for row in rows:
        table.add_row(*(_cell(name, row[name], form) for name, form, _ in _SHOWN_COLUMNS))
    console.print(table)
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


def print_front(
    points: Sequence[Mapping[str, Any]], refused: Sequence[str], console: Console
) -> None:
    """Print a Pareto front, the shortest cable first, and the refused variants.

    ``points`` have the fields of :class:`swarm.studies.FrontPoint`.
    """
    table = Table(box=None, padding=(0, 2, 0, 0), header_style="dim")
    table.add_column("variant")
    for name in ("vehicles", "cell", "cable", "fold", "e*", "payload"):
        table.add_column(name, justify="right")
    table.add_column("")
    for point in sorted(points, key=lambda point: float(point["cable_length"])):
        table.add_row(
            point["variant"],
            str(point["vehicles"]),
            f"{point['cell']:.2f} m" if point["cell"] else "–",
            f"{point['cable_length']:.1f} m",
            f"{point['fold_time']:.0f} s",
            f"{rounded_down(point['max_tracking_error'], 3):.3f} m",
            f"{1e3 * point['payload']:.0f} g",
            "[dim]dominated[/]" if point["dominated"] else "",
        )
    console.print(table)
    for variant in refused:
        console.print(f"refused: {variant}", style="yellow", highlight=False)


def _cell(name: str, value: Any, form: str) -> str:
    if name == "cleared":
        return "[green]cleared[/]" if value else "[bold red]refused[/]"
    if name in _HELD and value is not None:
        value = rounded_down(value, int(form[1]))
    return "–" if value is None else format(value, form)
