"""A plan on the terminal: the verdict, about ten lines of figures, then warnings and errors."""

import numpy as np
from rich.console import Console
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from swarm.certification.assessment import Assessment, Contingencies, rounded_down
from swarm.certification.distances import Tightest
from swarm.certification.kinds import FIGURES
from swarm.knots.catalog import lookup_knot
from swarm.planning import Plan
from swarm.planning.few_vehicles import least_vehicles
from swarm.reports.findings_text import findings_table, print_verdict, shortened
from swarm.reports.formatting import certified_metres, metres, seconds, together
from swarm.reports.plan_details import print_details
from swarm.reports.verdicts import plan_verdict
from swarm.reports.wording import knot_in_words


def print_plan_summary(
    plan: Plan, assessment: Assessment, console: Console, *, verbose: bool = False
) -> None:
    """Print the verdict, the figures, and the warnings and errors: the worst last.

    With ``verbose`` also the tightest moments, the clearance budget and all remarks, before the
    warnings.
    """
    print_verdict(plan_verdict(plan, assessment), console, verbose=verbose)
    console.print(Padding(_figures(plan, assessment), (1, 0, 0, 2), expand=False))
    if verbose:
        print_details(plan, assessment, console)
    problems = [finding for finding in assessment.findings if finding.severity != "info"]
    if problems:
        listed = problems if verbose else shortened(problems)
        console.print(Padding(findings_table(listed), (1, 0, 0, 2), expand=False))
    if not verbose:
        words = "All checks, tightest moments and budget: swarm plan with --verbose or --report"
        console.print(Padding(Text(words, "dim"), (1, 0, 0, 0), expand=False))


def _figures(plan: Plan, assessment: Assessment) -> Table:
    table = Table.grid(padding=(0, 2))
    table.add_column(style="dim", no_wrap=True)
    table.add_column()
    for name, value in [*_team_rows(plan, assessment), *_check_rows(plan, assessment)]:
        table.add_row(name, value)
    return table


def _team_rows(plan: Plan, assessment: Assessment) -> list[tuple[str, Text | str]]:
    lengths = plan.layout.lengths
    rows: list[tuple[str, Text | str]] = [("knot", _knot(plan, assessment))]
    rows.append(("vehicles", f"{plan.vehicles}, {_layout(plan)}"))
    if plan.mission.vehicles.count == "fewest" and plan.layout.cell == 0.0:
        rows += [("", reason) for reason in _why_not_fewer(plan)]
    if len(lengths):
        count = f"{len(lengths)} segment{'s' if len(lengths) > 1 else ''}"
        each = f"{metres(lengths.min())} to {metres(lengths.max())}"
        rows.append(("cable", f"{metres(lengths.sum())} in {count} of {each}"))
    folding = plan.phase("fold").duration
    duration = (
        f"{seconds(plan.flight_duration)}: fold {folding:.1f}, "
        f"other {plan.duration - folding:.1f}, gates {plan.expected_waits:.1f}, "
        f"slowing {plan.expected_slowing:.1f}"
    )
    rows.append(("duration", duration))
    return rows


def _why_not_fewer(plan: Plan) -> list[str]:
    """Return what smaller numbers of vehicles lacked, by the notes of a search for the fewest."""
    end = f"folded with {plan.vehicles} vehicles"
    before = plan.notes[1 : plan.notes.index(end)] if end in plan.notes else ()
    return [note for note in before if not note.startswith(("folded", "increased"))]


def _layout(plan: Plan) -> str:
    size = len(plan.knot.grid_columns)
    if not size or plan.mission.layout.corners is not None:
        return "given corners"
    if plan.layout.cell == 0.0:
        bound = least_vehicles(lookup_knot(plan.knot.type).crossings)
        return f"searched layout (lower bound {bound}, grid {2 * size - 1})"
    return f"{size}×{size} grid, cell {metres(plan.layout.cell)}"


def _knot(plan: Plan, assessment: Assessment) -> Text:
    line = Text(knot_in_words(plan.knot.type, plan.knot.chirality))
    planned = plan.knot.type, plan.knot.chirality
    if plan.knot.type and (assessment.knot, assessment.chirality) != planned:
        cable = knot_in_words(assessment.knot, assessment.chirality)
        line.append(f"; the planned cable is {cable}", "bold red")
    return line


def _check_rows(plan: Plan, assessment: Assessment) -> list[tuple[str, Text | str]]:
    robustness, tracking = assessment.robustness, plan.mission.vehicles.tracking
    done = "certified" if assessment.cleared else "checked"
    error = f"{done} for {metres(tracking) if tracking > 0 else '0 (geometry only)'}"
    if robustness.tracking is not None:
        error += f", holds up to {certified_metres(robustness.tracking)} (e*)"
    rows: list[tuple[str, Text | str]] = [("tracking error", error)]
    if robustness.wind is not None:
        wind = rounded_down(robustness.wind, 1)
        rows.append(("steady wind", f"holds up to {wind:.1f} m/s (w*)"))
    if plan.vehicles > 1:
        rows += [
            (FIGURES[name], _distance(one))
            for name, one in assessment.distances.items()
            if np.isfinite(one.distance)
        ]
    if assessment.budget:
        worst = min(assessment.budget, key=lambda row: row.remaining)
        words = f"{certified_metres(worst.remaining)} remain if all effects come together, at "
        style = "yellow" if worst.remaining < 0.0 else ""
        rows.append(("budget", Text(words + seconds(worst.time), style)))
    if assessment.contingencies is not None:
        rows.append(("on a stop", _contingencies(assessment.contingencies)))
    return rows


def _contingencies(stops: Contingencies) -> str:
    return (
        f"can land together {stops.land.share:.0%} of the time, release {stops.release.share:.0%}"
    )


def _distance(tightest: Tightest) -> Text:
    """Return a certified distance with the required one, its bodies and its time."""
    enough = tightest.distance >= tightest.required
    text = Text(certified_metres(max(tightest.distance, 0.0)), "green" if enough else "bold red")
    words = f", {metres(tightest.required)} required: {together(tightest.between)} at "
    return text.append(words + seconds(tightest.time), "none")
