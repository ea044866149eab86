"""``swarm dry-run --trials``: many simulated flights under varied conditions."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from swarm import planner
from swarm.cli.inputs import print_json
from swarm.cli.planning import plan_paper_trajectory
from swarm.errors import Interrupted
from swarm.files import write_text
from swarm.flight.flight_plan import ComparisonFlight, FlightPlan
from swarm.front.trials import Trials, TrialSeries, fly_series, load_scenario
from swarm.reports.trials_text import print_trials
from swarm.simulation.monte_carlo.results import write_results


@dataclass(frozen=True)
class TrialOptions:
    """The options of ``--trials``."""

    trials: int
    scenario: Path | None
    seed: int
    jobs: int | None
    scheduler: str | None
    results: Path | None
    plot: Path | None
    report: Path | None
    compare: bool


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
    interrupted = False
    for flight_plan in flights:
        # the paper has no mission clock: with ours its trajectory would stop, not come close
        open_loop = bool(runs)
        series = TrialSeries(options.trials, options.seed, spread, faults, open_loop=open_loop)
        trials, interrupted = _fly(flight_plan, series, options)
        runs.append(trials)
        if interrupted:
            break
    summaries = [trials.summary() for trials in runs]
    if options.results:
        flown = [(trials.plan, trials.trials) for trials in runs]
        write_results(options.results, flown, options.seed, spread)
    if options.plot or options.report:
        _write_figures(planned, runs, summaries, options)
    if as_json:
        both = {"ours": summaries[0], "paper": summaries[-1]}
        print_json(both if len(runs) > 1 else summaries[0])
    else:
        for summary in summaries:
            print_trials(summary, Console())
    if interrupted:
        raise Interrupted(f"stopped after {sum(map(len, runs))} trials")
    context.exit(0 if _passed(summaries[0]) else 1)


def _passed(summary: Mapping[str, Any]) -> bool:
    """Whether all trials without a failing vehicle are completed, and all keep the certificate."""
    sound = summary["without_failure"]
    return sound["completed"]["count"] == sound["trials"] and not summary["certificate"]["below"]


def _fly(
    flight_plan: FlightPlan, series: TrialSeries, options: TrialOptions
) -> tuple[Trials, bool]:
    """Return the trials that were flown, and whether an interrupt ended them; show progress."""
    console = Console(stderr=True)
    with Progress(
        TextColumn("{task.description}"), BarColumn(bar_width=30), MofNCompleteColumn(),
        TimeRemainingColumn(), console=console, transient=True, disable=not console.is_terminal,
    ) as bar:  # fmt: skip
        method = flight_plan.plan.mission.fold.method
        task = bar.add_task(f"trials ({method})", total=series.trials)
        trials, interrupted = fly_series(
            flight_plan, series, options.jobs, options.scheduler, lambda: bar.advance(task)
        )
    if not len(trials):
        raise Interrupted("stopped before the first trial was completed")
    return trials, interrupted


def _write_figures(
    planned: planner.PlanningResult,
    runs: list[Trials],
    summaries: list[Mapping[str, Any]],
    options: TrialOptions,
) -> None:
    from swarm.reports.plots import save  # noqa: PLC0415 - slow to import
    from swarm.reports.trial_plots import KINDS, trial_distances, trials_figure  # noqa: PLC0415
    from swarm.reports.trials_report import trials_report  # noqa: PLC0415

    distances = [trial_distances(run.plan, run.trials, run.certified) for run in runs]
    required = runs[0].required
    if options.plot:
        save(trials_figure(distances, required), options.plot)
    if options.report:
        # one figure per distance, so that a phone shows them one below the other
        figures = [trials_figure(distances, required, [kind]) for kind in KINDS]
        page = trials_report(planned.plan, planned.assessment, summaries, figures)
        write_text(options.report, page)
