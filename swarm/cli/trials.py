"""``swarm trials``: many simulated flights under varied conditions."""

from collections.abc import Mapping
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from swarm import planner
from swarm.certification.kinds import MEASURED
from swarm.cli.inputs import (
    FILE,
    JOBS,
    JSON,
    MISSION,
    OUTPUT,
    REPLAN,
    SCHEDULER,
    SET,
    VERBOSE,
    print_json,
    refuse_option_conflicts,
)
from swarm.cli.planning import load_source, plan_paper_trajectory, require_cleared
from swarm.errors import Interrupted, SwarmError
from swarm.files import write_text
from swarm.flight.flight_plan import ComparisonFlight, FlightPlan
from swarm.front.trials import Trials, TrialSeries, fly_series, load_scenario
from swarm.reports.trials_text import print_trials
from swarm.simulation.monte_carlo import workers_starting
from swarm.simulation.monte_carlo.results import write_results


@dataclass(frozen=True)
class TrialOptions:
    """The options of the command."""

    count: int
    scenario: Path | None
    seed: int
    jobs: int | None
    scheduler: str | None
    output: Path | None
    plot: Path | None
    report: Path | None
    compare: bool


@click.command()
@MISSION
@SET
@REPLAN
@JSON
@VERBOSE
@click.option(
    "-n",
    "--count",
    type=click.IntRange(1, 100_000),
    default=100,
    show_default=True,
    help="Number of trials, each under other conditions.",
)
@click.option("--scenario", type=FILE, help="Distributions of the conditions, and faults (YAML).")
@click.option("--seed", default=1, show_default=True, help="Seed of all random values.")
@click.option("--compare", is_flag=True, help="Also fly the paper's trajectory.")
@JOBS
@SCHEDULER
@click.option("-o", "--output", type=OUTPUT, help="Write one row per trial (Parquet).")
@click.option("--plot", type=OUTPUT, help="Plot the distributions of the distances (PNG).")
@click.option("--report", type=OUTPUT, help="Write a report (one HTML file).")
@click.pass_context
def trials(
    context: click.Context,
    /,
    mission: str,
    overrides: tuple[str, ...],
    replan: bool,
    as_json: bool,
    verbose: bool,
    **options: Any,
) -> None:
    """Simulate many flights of MISSION, each under other conditions.

    MISSION is a mission or plan file, or the name of a knot.

    Each trial has its own wind, delays, packet loss, tracking, grip and length errors, and
    sometimes a failing vehicle; the same seed gives the same trials. swarm dry-run --trial NUMBER
    repeats one of them.

    Exit code 0 if all trials without a failing vehicle are completed and keep the certificate;
    otherwise 1.

    Example: swarm trials missions/overhand.yaml --count 200 --report trials.html
    """
    refuse_option_conflicts(options, {}, [("jobs", "scheduler")])
    given = TrialOptions(**options)
    source = load_source(mission, overrides, replan=replan, flight=True)
    # the processes that fly the trials start while the plan is computed
    with workers_starting(given.jobs) if given.scheduler is None else nullcontext():
        planned = source.planned()
    require_cleared(context, planned, verbose=verbose, as_json=as_json)
    run_trials(context, planned, given, as_json=as_json)


def run_trials(
    context: click.Context, planned: planner.PlanningResult, options: TrialOptions, *, as_json: bool
) -> None:
    """Fly the trials, print or write their summaries, and exit with their code."""
    spread, faults = load_scenario(options.scenario)
    flights: list[FlightPlan] = [planned.certified()]
    if options.compare:
        paper = plan_paper_trajectory(planned.plan.mission)
        flights.append(ComparisonFlight(paper.plan, paper.certificate))
    runs: list[Trials] = []
    ended: SwarmError | None = None
    for flight_plan in flights:
        # the paper has no mission clock: with ours its trajectory would stop, not come close
        open_loop = bool(runs)
        series = TrialSeries(options.count, options.seed, spread, faults, open_loop=open_loop)
        flown, ended = _fly(flight_plan, series, options)
        runs.append(flown)
        if ended:
            break
    summaries = [run.summary() for run in runs]
    if options.output:
        tables = [(run.plan, run.trials) for run in runs]
        write_results(options.output, tables, options.seed, spread)
    if options.plot or options.report:
        _write_figures(planned, runs, summaries, options)
    if as_json:
        both = {"ours": summaries[0], "paper": summaries[-1]}
        print_json(both if len(runs) > 1 else summaries[0])
    else:
        for summary in summaries:
            print_trials(summary, Console())
    if ended:
        raise type(ended)(f"{ended} after {sum(map(len, runs))} trials")
    context.exit(0 if _passed(summaries[0]) else 1)


def _passed(summary: Mapping[str, Any]) -> bool:
    """Whether all trials without a failing vehicle are completed, and all keep the certificate."""
    sound = summary["without_failure"]
    return sound["completed"]["count"] == sound["trials"] and not summary["certificate"]["below"]


def _fly(
    flight_plan: FlightPlan, series: TrialSeries, options: TrialOptions
) -> tuple[Trials, SwarmError | None]:
    """Return the trials that were flown, and what ended them early; show progress."""
    console = Console(stderr=True)
    with Progress(
        TextColumn("{task.description}"), BarColumn(bar_width=30), MofNCompleteColumn(),
        TimeRemainingColumn(), console=console, transient=True, disable=not console.is_terminal,
    ) as bar:  # fmt: skip
        method = flight_plan.plan.mission.fold.method
        task = bar.add_task(f"trials ({method})", total=series.trials)
        flown, ended = fly_series(
            flight_plan, series, options.jobs, options.scheduler, lambda: bar.advance(task)
        )
    if isinstance(ended, Interrupted) and not len(flown):
        raise Interrupted("stopped before the first trial was completed")
    if ended and not len(flown):
        raise ended
    return flown, ended


def _write_figures(
    planned: planner.PlanningResult,
    runs: list[Trials],
    summaries: list[Mapping[str, Any]],
    options: TrialOptions,
) -> None:
    from swarm.reports.plots import save  # noqa: PLC0415 - slow to import
    from swarm.reports.trial_plots import trial_distances, trials_figure  # noqa: PLC0415
    from swarm.reports.trials_report import trials_report  # noqa: PLC0415

    distances = [trial_distances(run.plan, run.trials, run.certified) for run in runs]
    required = runs[0].required
    if options.plot:
        save(trials_figure(distances, required), options.plot)
    if options.report:
        # one figure per distance, so that a phone shows them one below the other
        figures = [trials_figure(distances, required, [kind]) for kind in MEASURED]
        page = trials_report(planned.plan, planned.assessment, summaries, figures)
        write_text(options.report, page)
