"""A plan on the terminal: figures, tightest moments, clearance budget and findings."""

from typing import Final

import numpy as np
from rich.console import Console, RenderableType
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from swarm.certification.assessment import Assessment, Tightest, Window
from swarm.certification.budget import Budget
from swarm.certification.clearances import Moment
from swarm.certification.findings import Finding
from swarm.planning import Plan
from swarm.reports.formatting import metres, seconds
from swarm.reports.wording import CERTIFIED, certified_in_words, knot_in_words

SEVERITY_STYLES: Final = {"error": "bold red", "warning": "yellow", "info": "dim"}
_IN_TABLES: Final = frozenset({"tightest", "budget"})
"""Checks whose findings the summary shows as tables."""


def print_plan_summary(plan: Plan, assessment: Assessment, console: Console) -> None:
    """Print a plan's figures and tables, then the findings, the worst first, and the verdict."""
    console.print(_headline(plan, assessment))
    tables = [_figures(plan, assessment)]
    if plan.vehicles > 1:
        tables.append(_clearances(plan, assessment))
    if assessment.tightest:
        tables.append(_tightest_moments(assessment.tightest))
    if assessment.budget:
        tables.append(_budget(assessment.budget))
    for number, table in enumerate(tables):
        console.print(Padding(table, (min(number, 1), 0, 0, 2), expand=False))
    listed = assessment.findings
    if assessment.moments:
        listed = tuple(finding for finding in listed if finding.check not in _IN_TABLES)
    print_findings(listed, assessment.cleared, console, certified_in_words(plan))


def print_findings(
    findings: tuple[Finding, ...], cleared: bool, console: Console, certified: str = CERTIFIED
) -> None:
    """Print the findings, errors before warnings before remarks, and the verdict."""
    if findings:
        console.print(Padding(findings_table(findings), (1, 0, 0, 2), expand=False))
    errors = sum(finding.severity == "error" for finding in findings)
    verdict = (
        Text(f"Cleared: {certified}.", "green")
        if cleared
        else Text(f"Refused: {errors} error{'s' if errors > 1 else ''}.", "bold red")
    )
    console.print(Padding(verdict, (1, 0, 0, 0), expand=False))


def _headline(plan: Plan, assessment: Assessment) -> Text:
    line = Text(f"{plan.mission.name}: ", "bold")
    if not plan.knot.type:
        return line.append("no knot, a flight through formations", "bold")
    line.append(f"knot {knot_in_words(plan.knot.type, plan.knot.chirality)}", "bold")
    if (assessment.knot, assessment.chirality) != (plan.knot.type, plan.knot.chirality):
        line.append(f"; the planned cable is {assessment.knot}, {assessment.chirality}", "bold red")
    return line


def _figures(plan: Plan, assessment: Assessment) -> Table:
    table = Table.grid(padding=(0, 2))
    table.add_column(style="dim")
    table.add_column()
    for name, value in _rows(plan, assessment):
        table.add_row(name, value)
    return table


def _rows(plan: Plan, assessment: Assessment) -> list[tuple[str, str]]:
    layout, lengths, robustness = plan.layout, plan.layout.lengths, assessment.robustness
    rows = [("Gauss code", plan.knot.gauss)] if plan.knot.type else []
    grid = f", cell {metres(layout.cell)}" if layout.cell > 0 else ""
    size = 0 if plan.mission.layout.corners is not None else len(plan.knot.grid_columns)
    rows += [
        ("Layout", f"{size}×{size} grid{grid}" if size else "given corners"),
        ("Vehicles", str(plan.vehicles)),
    ]
    if len(lengths):
        count = f"{len(lengths)} segment{'s' if len(lengths) > 1 else ''}"
        each = f"{metres(lengths.min())} to {metres(lengths.max())}"
        rows += [
            ("Cable", f"{metres(lengths.sum())} in {count} of {each}"),
            ("Sags", f"{metres(layout.sags.min())} to {metres(layout.sags.max())}"),
        ]
    else:
        rows.append(("Cable", "none"))
    fold = plan.phase("fold")
    duration = f"{seconds(plan.duration)}, of which the fold {seconds(fold.end - fold.start)}"
    rows.append(("Duration", duration))
    tracking = plan.mission.vehicles.tracking
    error = f"certified for {metres(tracking) if tracking > 0 else '0 (geometry only)'}"
    if robustness.tracking is not None:
        error += f", valid up to {metres(robustness.tracking)}"
    rows.append(("Tracking error", error))
    if robustness.wind is not None:
        rows.append(("Steady wind", f"valid up to {robustness.wind:.1f} m/s"))
    stops = assessment.contingencies
    if stops is not None:
        rows += [
            ("On a stop", f"can land together {_window(stops.land)}"),
            ("", f"can release {_window(stops.release)}"),
            ("", f"longest stop {seconds(stops.stop_time)}, {metres(stops.stop_distance)}"),
        ]
    return rows


def _window(window: Window) -> str:
    near = f", at most {seconds(window.wait)} away" if 0.0 < window.share < 1.0 else ""
    return f"{window.share:.0%} of the time{near}"


def _tightest_moments(moments: tuple[Moment, ...]) -> Table:
    table = Table(box=None, padding=(0, 2, 0, 0), header_style="dim")
    table.add_column("Tightest")
    for name in ("certified", "required", "margin", "at"):
        table.add_column(name, justify="right")
    table.add_column("between")
    for moment in moments:
        table.add_row(
            moment.check,
            metres(max(moment.distance, 0.0)),
            metres(moment.required),
            Text(f"{moment.margin:+.2f} m", "bold red" if moment.margin < 0.0 else "green"),
            seconds(moment.time),
            " and ".join(moment.between),
        )
    return table


_BUDGET: Final = (
    ("available", "available"),
    ("tracking", "tracking"),
    ("sag", "amplification"),
    ("length", "length"),
    ("grip", "grip"),
    ("sway", "sway"),
    ("stop", "stop"),
    ("wind", "wind"),
    ("wash", "wash"),
    ("required", "required"),
    ("remaining", "remaining"),
)


def _budget(rows: tuple[Budget, ...]) -> Table:
    """Return the clearance budget of pairs of strands, in centimetres."""
    table = Table(box=None, padding=(0, 1, 0, 0), header_style="dim")
    table.add_column("Budget, cm")
    for name, _ in _BUDGET:
        table.add_column(name, justify="right")
    for row in rows:
        pair = " and ".join(name.removeprefix("segment ") for name in row.between)
        values = [f"{100.0 * getattr(row, field):.0f}" for _, field in _BUDGET]
        table.add_row(f"segments {pair} at {seconds(row.time)}", *values)
    return table


def _clearances(plan: Plan, assessment: Assessment) -> Table:
    table = Table(box=None, padding=(0, 2, 0, 0), header_style="dim")
    table.add_column("Smallest distance")
    for name in ("certified", "required", "at"):
        table.add_column(name, justify="right")
    table.add_column("between")
    for kind, tightest in (
        ("cable to cable", assessment.cable),
        ("vehicle to vehicle", assessment.vehicle),
        ("vehicle to cable", assessment.vehicle_cable),
    ):
        if "cable" not in kind or len(plan.layout.lengths):
            table.add_row(kind, *_tightest(tightest))
    return table


def _tightest(tightest: Tightest) -> tuple[RenderableType, ...]:
    if not np.isfinite(tightest.distance):
        return ("–", metres(tightest.required), "–", "–")
    sufficient = tightest.distance >= tightest.required
    return (
        Text(metres(tightest.distance), "green" if sufficient else "bold red"),
        metres(tightest.required),
        seconds(tightest.time),
        " and ".join(tightest.between),
    )


def findings_table(findings: tuple[Finding, ...]) -> Table:
    """Return a table of findings, errors before warnings before remarks."""
    order = list(SEVERITY_STYLES)
    table = Table(box=None, padding=(0, 2, 0, 0), header_style="dim")
    table.add_column("Finding", no_wrap=True)
    table.add_column("check", no_wrap=True)
    table.add_column("message", ratio=1)
    table.add_column("at", justify="right", no_wrap=True)
    for finding in sorted(findings, key=lambda finding: order.index(finding.severity)):
        when = "" if finding.at_time is None else seconds(finding.at_time)
        severity = Text(finding.severity, SEVERITY_STYLES[finding.severity])
        table.add_row(severity, finding.check, Text(finding.message), when)
    return table
