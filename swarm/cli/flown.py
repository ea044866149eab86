"""What a flight's commands end with: what was flown, in words or JSON, and the exit code."""

from pathlib import Path

import click
from rich.console import Console

from swarm.certification.assessment import Assessment
from swarm.cli.inputs import print_json
from swarm.cli.outcome import outcome_object, print_outcome
from swarm.files import write_text
from swarm.flight.result import FlightResult
from swarm.planning import Plan
from swarm.verification import verify_trace


def end_with(
    context: click.Context,
    plan: Plan,
    assessment: Assessment,
    result: FlightResult,
    folder: Path,
    *,
    as_json: bool,
) -> None:
    """Write the flight's page, tell what was flown, and end the command with its exit code."""
    from swarm.reports.flight_report import flight_report  # noqa: PLC0415 - slow to import

    console = Console(quiet=as_json)
    flown = verify_trace(plan, result.trace)
    outcome = outcome_object(result, flown, assessment)
    page = flight_report(plan, assessment, outcome, result.trace, result.events)
    write_text(folder / "report.html", page)
    if as_json:
        print_json(outcome)
    else:
        print_outcome(plan, result, flown, assessment, console)
        console.print(f"Record: {folder}", soft_wrap=True, highlight=False)
    error = result.error()
    if error is not None:
        raise error
    context.exit(0 if flown.as_planned else 1)
