"""``swarm failures``: failure tests, one fault per flight; without a mission, the responses."""

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import click
from click.core import ParameterSource
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from swarm import planner
from swarm.cli.inputs import (
    JOBS,
    JSON,
    OUTPUT,
    REPLAN,
    SCHEDULER,
    SET,
    VERBOSE,
    missions,
    print_json,
    refuse_option_conflicts,
)
from swarm.cli.planning import load_source, require_cleared
from swarm.files import write_text
from swarm.flight.failures import response_rows
from swarm.flight.stages import Stage, mermaid
from swarm.reports.failures_report import failures_report
from swarm.reports.failures_text import print_failures
from swarm.simulation.fault_injection import (
    SYSTEM_FAILURE_CASES,
    TEAM_AUTOPILOTS,
    FailureTest,
    FailureTestSettings,
    TeamAutopilots,
    run_failure_tests,
)
from swarm.simulation.fault_injection.failure_cases import cases_of
from swarm.simulation.fault_injection.results_file import (
    append_results,
    open_results,
    results_header,
)


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


@dataclass(frozen=True)
class FailureOptions:
    """The options of the failure tests."""

    repeat: int
    team: tuple[TeamAutopilots, ...]
    filter: tuple[str, ...]
    seed: int
    jobs: int | None
    scheduler: str | None
    output: Path | None
    report: Path | None


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
@click.option("--seed", default=1, show_default=True, help="Seed of all random values.")
@JOBS
@SCHEDULER
@click.option(
    "-o",
    "--output",
    type=OUTPUT,
    help="Append each result (JSON lines); results that the file holds are not flown again.",
)
@click.option("--report", type=OUTPUT, help="Write a report (one HTML file).")
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
    **options: Any,
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
    refuse_option_conflicts(options, {}, [("jobs", "scheduler")])
    planned = load_source(mission, overrides, replan=replan, flight=True).planned()
    require_cleared(context, planned, verbose=verbose, as_json=as_json)
    run_failures(context, planned, FailureOptions(**options), as_json=as_json)


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


def run_failures(
    context: click.Context,
    planned: planner.PlanningResult,
    options: FailureOptions,
    *,
    as_json: bool,
) -> None:
    """Run the failure tests, print or write the results, and exit with their code."""
    tests = [test.document() for test in _run(planned, options)]
    if options.report:
        write_text(options.report, failures_report(planned.plan, tests, SYSTEM_FAILURE_CASES))
    if as_json:
        print_json({"failures": tests})
    else:
        print_failures(tests, Console(), system_cases=not options.filter)
    context.exit(0 if all(test["passed"] for test in tests) else 1)


def _run(planned: planner.PlanningResult, options: FailureOptions) -> tuple[FailureTest, ...]:
    cases = cases_of(planned.plan, options.filter)
    teams = [team for team in TEAM_AUTOPILOTS if not options.team or team in options.team]
    header = results_header(planned.plan, options.seed)
    console = Console(stderr=True)
    with Progress(
        TextColumn("failure tests"), BarColumn(bar_width=30), MofNCompleteColumn(),
        TimeRemainingColumn(), console=console, transient=True, disable=not console.is_terminal,
    ) as bar:  # fmt: skip
        task = bar.add_task("failure tests", total=None)
        return run_failure_tests(
            planned.certified(),
            FailureTestSettings(cases, teams, options.repeat, options.seed),
            jobs=options.jobs,
            scheduler=options.scheduler,
            progress=lambda done, total: bar.update(task, completed=done, total=total),
            earlier_results=open_results(options.output, header) if options.output else (),
            on_result=partial(append_results, options.output) if options.output else None,
        )
