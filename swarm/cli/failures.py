"""``swarm failures``: failure tests, one fault per flight; without a mission, the responses."""

from functools import partial
from pathlib import Path

import click
from click.core import ParameterSource
from rich.console import Console
from rich.table import Table

from swarm.cli.inputs import (
    JOBS,
    JSON,
    OUTPUT,
    REPLAN,
    REPORT,
    SCHEDULER,
    SEED,
    SET,
    VERBOSE,
    counting_bar,
    missions,
    print_json,
    refuse_option_conflicts,
)
from swarm.cli.planning import load_source, require_cleared
from swarm.files import write_text
from swarm.flight.failures import response_rows
from swarm.flight.stages import Stage, mermaid
from swarm.reports.failures import failures_report, print_failures
from swarm.simulation.failure_cases import cases_of
from swarm.simulation.failure_tests import (
    FailureTestSettings,
    append_results,
    open_results,
    results_header,
    run_failure_tests,
)
from swarm.simulation.stepped_simulation import TEAM_AUTOPILOTS, TeamAutopilots


def print_responses(*, whole: bool, diagram: bool) -> None:
    """Print the table of responses, ``whole`` or on the plan only, or the diagram of stages."""
    if diagram:
        click.echo(mermaid())
        return
    heading, *rows = response_rows()
    count = len(heading) if whole else 3
    table = Table(*heading[:count])
    for row in rows:
        if whole or row[1] == Stage.EXECUTE.name.lower():
            table.add_row(*row[:count])
    Console(width=None if whole else 100).print(table, highlight=False)


@click.command()
@click.argument("mission", metavar="[MISSION]", required=False, shell_complete=missions)
@SET
@REPLAN
@JSON
@VERBOSE
@click.option(
    "--table",
    is_flag=True,
    help="Without MISSION, print every cell: each failure, on the plan and outside it, under all "
    "open windows.",
)
@click.option(
    "--diagram", is_flag=True, help="Without MISSION, print the stages of a flight in Mermaid."
)
@click.option(
    "--repeat",
    type=click.IntRange(1, 1000),
    default=2,
    show_default=True,
    help="Random times per fault.",
)
@click.option(
    "--team",
    multiple=True,
    type=click.Choice(["px4", "ardupilot", "mixed"]),
    help="Autopilots of the team; can be repeated.  [default: each]",
)
@click.option("--filter", multiple=True, metavar="TEXT", help="Only cases whose name has TEXT.")
@SEED
@JOBS
@SCHEDULER
@click.option(
    "-o",
    "--output",
    type=OUTPUT,
    help="Append each result (JSON lines); results that the file holds are not flown again.",
)
@REPORT
@click.pass_context
def failures(
    context: click.Context,
    /,
    mission: str | None,
    overrides: tuple[str, ...],
    replan: bool,
    as_json: bool,
    verbose: bool,
    table: bool,
    diagram: bool,
    repeat: int,
    team: tuple[TeamAutopilots, ...],
    filter: tuple[str, ...],  # noqa: A002 - the name of the option
    seed: int,
    jobs: int | None,
    scheduler: str | None,
    output: Path | None,
    report: Path | None,
) -> None:
    """Run failure tests on MISSION, or print the team's response to every failure.

    With MISSION (a mission or plan file, or the name of a knot), every known fault is injected,
    one per simulated flight, with PX4, ArduPilot and mixed teams. Exit code 0 if the team responds
    to each as the table says; otherwise 1.

    Without MISSION, the table of responses is printed.

    Example: swarm failures missions/overhand.yaml --filter link --report failures.html
    """
    if mission is None:
        _refuse_without_mission(context)
        print_responses(whole=table, diagram=diagram)
        return
    if table or diagram:
        raise click.UsageError("--table and --diagram are of the responses: leave MISSION out")
    refuse_option_conflicts({"jobs": jobs, "scheduler": scheduler}, {}, [("jobs", "scheduler")])
    planned = load_source(mission, overrides, replan=replan, flight=True).planned()
    require_cleared(context, planned, verbose=verbose, as_json=as_json)
    teams = [autopilots for autopilots in TEAM_AUTOPILOTS if not team or autopilots in team]
    settings = FailureTestSettings(cases_of(planned.plan, filter), teams, repeat, seed)
    header = results_header(planned.plan, seed)
    with counting_bar("failure tests") as progress:
        results = run_failure_tests(
            planned.certified(),
            settings,
            jobs=jobs,
            scheduler=scheduler,
            progress=progress,
            earlier_results=open_results(output, header) if output else (),
            on_result=partial(append_results, output) if output else None,
        )
    tests = [result.document() for result in results]
    if report:
        write_text(report, failures_report(planned.plan, tests))
    if as_json:
        print_json({"failures": tests})
    else:
        print_failures(tests, Console(), system_cases=not filter)
    context.exit(0 if all(test["passed"] for test in tests) else 1)


def _refuse_without_mission(context: click.Context) -> None:
    """Raise a usage error for options of the failure tests, which need a mission."""
    names = [
        max(option.opts, key=len)
        for option in context.command.params
        if option.name not in ("mission", "table", "diagram")
        and option.name is not None
        and context.get_parameter_source(option.name) is ParameterSource.COMMANDLINE
    ]
    if names:
        raise click.UsageError(f"{', '.join(names)}: expected a MISSION to fly failure tests on")
