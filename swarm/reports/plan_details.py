"""All checks of a plan on the terminal: tightest moments, clearance budget and every finding."""

from typing import Final

from rich.console import Console
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from swarm.certification.assessment import Assessment
from swarm.certification.budget import Budget
from swarm.certification.clearances import Moment
from swarm.certification.kinds import KINDS, MATRIX, coverage
from swarm.planning import Plan
from swarm.reports.findings_text import findings_table
from swarm.reports.formatting import certified_metres, metres, seconds, together

IN_TABLES: Final = frozenset({"tightest", "budget"})
"""Checks whose findings are shown as tables."""


def print_details(plan: Plan, assessment: Assessment, console: Console) -> None:
    """Print tightest moments, clearance budget, remarks, and which checks compare what."""
    tables = [_more_figures(plan, assessment)]
    if assessment.tightest:
        tables.append(_tightest_moments(assessment.tightest))
    if assessment.budget:
        tables.append(_budget(assessment.budget))
    remarks = [
        finding
        for finding in assessment.findings
        if finding.severity == "info" and not (assessment.moments and finding.check in IN_TABLES)
    ]
    if remarks:
        tables.append(findings_table(remarks))
    tables.append(_who_compares_what())
    for number, table in enumerate(tables):
        console.print(Padding(table, (min(number, 1), 0, 0, 2), expand=False))


def _more_figures(plan: Plan, assessment: Assessment) -> Table:
    table = Table.grid(padding=(0, 2))
    table.add_column(style="dim", no_wrap=True, min_width=len("vehicle to vehicle"))
    table.add_column()
    if plan.knot.type:
        table.add_row("Gauss code", plan.knot.gauss)
    if len(plan.layout.sags):
        table.add_row(
            "sags", f"{metres(plan.layout.sags.min())} to {metres(plan.layout.sags.max())}"
        )
    stops = assessment.contingencies
    if stops is not None:
        table.add_row("longest stop", f"{seconds(stops.stop_time)}, {metres(stops.stop_distance)}")
    return table


def _tightest_moments(moments: tuple[Moment, ...]) -> Table:
    table = Table(box=None, padding=(0, 2, 0, 0), header_style="dim")
    table.add_column("Tightest")
    for name in ("certified", "required", "margin", "at"):
        table.add_column(name, justify="right")
    table.add_column("between")
    for moment in moments:
        table.add_row(
            moment.check,
            certified_metres(max(moment.distance, 0.0)),
            metres(moment.required),
            Text(f"{moment.margin:+.2f} m", "bold red" if moment.margin < 0.0 else "green"),
            seconds(moment.time),
            " and ".join(moment.between),
        )
    return table


_SHORT: Final = {
    "tracking errors": "errors",
    "lost setpoints": "lost",
    "live monitor": "monitor",
    "repaired": "repair",
}
"""Headings of the matrix that fit into 80 columns."""


def _who_compares_what() -> Table:
    """Return the matrix of all certified checks: what counts in them, who else compares them."""
    table = Table(box=None, padding=(0, 1, 0, 0), header_style="dim")
    table.add_column("Checks", no_wrap=True)
    for name in MATRIX[1:]:
        table.add_column(_SHORT.get(name, name))
    for kind in KINDS:
        marks = ("–" if cell == "no" else "yes" for cell in coverage(kind)[1:])
        table.add_row(kind.check, *marks)
    return table


BUDGET: Final = (
    ("available", "available"),
    ("tracking", "tracking"),
    ("sag", "amplification"),
    ("length", "length"),
    ("grip", "grip"),
    ("swing", "swing"),
    ("excited", "excited"),
    ("wind", "wind"),
    ("wash", "wash"),
    ("required", "required"),
    ("remaining", "remaining"),
)
"""Columns of the clearance budget: heading and field."""


def _budget(rows: tuple[Budget, ...]) -> Table:
    """Return the clearance budget of pairs of strands, in centimetres."""
    table = Table(box=None, padding=(0, 1, 0, 0), header_style="dim")
    table.add_column("Budget, cm")
    for name, _ in BUDGET:
        table.add_column(name, justify="right")
    for row in rows:
        table.add_row(*budget_cells(row))
    return table


def budget_cells(row: Budget) -> list[str]:
    """Return a pair of segments with its time, and the values of :data:`BUDGET` in centimetres."""
    values = [f"{100.0 * getattr(row, field):.0f}" for _, field in BUDGET]
    return [f"{together(row.between)} at {seconds(row.time)}", *values]
