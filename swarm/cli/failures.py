"""``swarm dry-run --failures``: failure tests, one injected fault per simulated flight."""

from dataclasses import dataclass
from functools import partial
from pathlib import Path

import click
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from swarm import planner
from swarm.cli.inputs import print_json
from swarm.files import write_text
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

TIMES = 2
"""Random times of each fault, with each autopilot, by default."""


@dataclass(frozen=True)
class FailureOptions:
    """The options of ``--failures``."""

    times: int | None
    team: tuple[TeamAutopilots, ...]
    row: tuple[str, ...]
    seed: int
    jobs: int | None
    report: Path | None
    results: Path | None


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
        print_failures(tests, Console(), system_cases=not options.row)
    context.exit(0 if all(test["passed"] for test in tests) else 1)


def _run(planned: planner.PlanningResult, options: FailureOptions) -> tuple[FailureTest, ...]:
    cases = cases_of(planned.plan, options.row)
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
            FailureTestSettings(cases, teams, options.times or TIMES, options.seed),
            jobs=options.jobs,
            progress=lambda done, total: bar.update(task, completed=done, total=total),
            earlier_results=open_results(options.results, header) if options.results else (),
            on_result=partial(append_results, options.results) if options.results else None,
        )
