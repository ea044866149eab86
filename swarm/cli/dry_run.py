"""``swarm dry-run``: the same conductor and packets against the emulator, in virtual time."""

from pathlib import Path

import click
from rich.console import Console

from swarm import api
from swarm.cli.inputs import JSON, MISSION, SET, load_mission, print_json, progress_bar, write_text
from swarm.cli.outcome import outcome_object, print_outcome
from swarm.rehearse import rehearse
from swarm.verify import judge
from swarm.view.report import flight_report
from swarm.view.summary import plan_summary
from swarm.view.terminal import FlightScreen


@click.command("dry-run")
@MISSION
@SET
@JSON
@click.option("--seed", default=1, show_default=True, help="Seed of everything that is random.")
@click.option("--no-cable", is_flag=True, help="Fly with nothing attached, grips simulated.")
@click.option(
    "--report",
    type=click.Path(dir_okay=False, path_type=Path),
    help="Write a page (HTML, needs no network) about the dry run.",
)
@click.pass_context
def dry_run(
    context: click.Context,
    mission: str,
    overrides: tuple[str, ...],
    as_json: bool,
    seed: int,
    no_cable: bool,
    report: Path | None,
) -> None:
    """Fly MISSION (a file or a knot's name) against the emulator in virtual time, and report.

    The same seed gives the same flight. Exit code 0 when it went as planned and the flown
    positions imply the knot, 1 when the plan is refused or another knot came out, 3 when a vehicle
    failed.
    """
    loaded = load_mission(mission, overrides)
    console = Console(quiet=as_json)
    with progress_bar(Console(stderr=True)) as progress:
        planned = api.plan(loaded, progress)
    plan_summary(planned.plan, planned.assessment, console)
    proven = planned.proven()
    with FlightScreen(planned.plan, console) as screen:
        result = rehearse(
            proven, seed=seed, no_cable=no_cable, on_snapshot=screen.show, on_event=screen.event
        )
    flown = judge(planned.plan, result.trace)
    outcome = outcome_object(result, flown, planned.assessment)
    if report:
        page = flight_report(planned.plan, planned.assessment, outcome, result.trace, result.events)
        write_text(report, page)
    if as_json:
        print_json(outcome)
    else:
        print_outcome(planned.plan, result, flown, planned.assessment, console)
    error = result.outcome.error()
    if error is not None:
        raise error
    context.exit(0 if flown.as_planned else 1)
