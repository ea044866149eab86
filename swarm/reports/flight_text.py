"""The outcome of a flight on the terminal."""

from rich.console import Console
from rich.table import Table

from swarm.certification.assessment import Assessment
from swarm.certification.kinds import FIGURES
from swarm.flight.result import Adherence, FlightResult
from swarm.flight.swinging import flown_swing
from swarm.planning import Plan
from swarm.reports.findings_text import print_verdict
from swarm.reports.flight_json import outcome_object
from swarm.reports.formatting import certified_metres, together
from swarm.reports.verdicts import flight_verdict
from swarm.verification import TrackingStatistics, Verification


def print_outcome(
    plan: Plan,
    result: FlightResult,
    verification: Verification,
    assessment: Assessment,
    console: Console,
) -> None:
    """Print the verdict, flown beside certified distances, tracking error and timing."""
    if result.stall:
        line = f"[bold red]{result.stall[0].upper()}{result.stall[1:]}.[/]"
        console.print(line, highlight=False, soft_wrap=True)
    outcome = outcome_object(plan, result, verification, assessment)
    print_verdict(flight_verdict(plan, outcome), console)
    if not result.basis.cable and len(plan.layout.lengths):
        words = "Flown without cable: the knot above is the one that these positions would tie."
        console.print(words, highlight=False, soft_wrap=True)
    _print_measurements(plan, verification, assessment, console)
    swing = flown_swing(plan, result.trace)
    if swing is not None:
        line = f"Swing of the cable: {swing.words}"
        console.print(line, highlight=False, soft_wrap=True)
    statistics = result.statistics
    line = f"{statistics.duration:.0f} s of flight, {statistics.setpoints} setpoints, "
    line += f"at most {statistics.gap[0]:.2f} s apart"
    if statistics.lateness:
        line += f", late by {statistics.lateness[0] * 1e3:.2f} ms (median), "
        line += f"{statistics.lateness[1] * 1e3:.1f} ms (99 %)"
    if statistics.cpu is not None:
        line += f", {statistics.cpu:.0%} of a core"
    console.print(line, style="dim", highlight=False, soft_wrap=True)


def print_verification(
    plan: Plan,
    verification: Verification,
    assessment: Assessment,
    console: Console,
    *,
    positions: str = "reported positions",
) -> None:
    """Print the knot that ``positions`` imply, distances beside certified ones, tracking errors.

    Lines that do not apply, without a cable or before the fold, are left out.
    """
    if len(plan.layout.lengths):
        console.print(_knot_line(plan, verification, positions), highlight=False, soft_wrap=True)
    _print_measurements(plan, verification, assessment, console)


def _print_measurements(
    plan: Plan, verification: Verification, assessment: Assessment, console: Console
) -> None:
    table = _clearance_table(verification, assessment)
    if table.row_count:
        console.print(table)
    line = _tracking_line(verification.tracking, plan.mission.vehicles.tracking)
    console.print(line, highlight=False, soft_wrap=True)
    for note in verification.notes:
        console.print(f"[yellow]note[/] {note}", highlight=False, soft_wrap=True)


def print_adherence(adherence: Adherence, console: Console) -> None:
    """Print one line if the flight was outside its certificate."""
    if not adherence.within:
        line = f"[bold red]{adherence.words[0].upper()}{adherence.words[1:]}.[/]"
        console.print(line, highlight=False, soft_wrap=True)


def _knot_line(plan: Plan, verification: Verification, positions: str) -> str:
    planned = f"{plan.knot.type} {_hand(plan.knot.chirality)}".strip() or "none"
    style = "green" if verification.as_planned else "bold red"
    if verification.knot == "unknown":
        return f"The knot of the cable is [{style}]unknown[/] (planned: {planned})"
    implied = f"{verification.knot} {_hand(verification.chirality)}".strip()
    if not plan.knot.type and verification.knot == "0_1":
        implied = "none"
    return f"Knot implied by the {positions}: [{style}]{implied}[/] (planned: {planned})"


def _clearance_table(verification: Verification, assessment: Assessment) -> Table:
    table = Table(box=None, padding=(0, 2, 0, 0), header_style="dim")
    table.add_column("smallest distance")
    for heading in ("flown", "certified", "required", "between"):
        table.add_column(heading, justify="right")
    for figure, flown in verification.distances.items():
        certified = assessment.distances[figure]
        if flown is None:
            continue  # not measured, or the plan has no two such bodies
        enough = flown.distance >= certified.required
        table.add_row(
            FIGURES[figure],
            f"[{'green' if enough else 'red'}]{flown.distance:.2f} m[/]",
            certified_metres(certified.distance),
            f"{certified.required:.2f} m",
            together(flown.between),
        )
    return table


def _tracking_line(errors: tuple[TrackingStatistics, ...], tracking_radius: float) -> str:
    in_fold = [error for error in errors if error.phase == "fold"]
    vehicles = [error for error in in_fold if error.vehicle]
    if not vehicles:
        return "The fold was not flown: it has no tracking error"
    worst = max(vehicles, key=lambda error: error.largest)
    rms = next(error.rms for error in in_fold if error.vehicle == 0)
    style = "green" if worst.largest <= tracking_radius else "red"
    return (
        f"Tracking error in the fold: {rms:.3f} m RMS, [{style}]{worst.largest:.3f} m at most[/] "
        f"(vehicle {worst.vehicle}); certified for {tracking_radius:g} m"
    )


def _hand(chirality: str) -> str:
    return "" if chirality == "none" else f"{chirality}-handed"
