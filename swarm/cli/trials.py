"""``swarm trials``: many simulated flights under varied conditions."""

from collections.abc import Mapping
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import click
from rich.console import Console

from swarm.certification.kinds import FIGURES
from swarm.cli.inputs import (
    FILE,
    JOBS,
    OUTPUT,
    REPORT,
    SCHEDULER,
    SEED,
    counting_bar,
    print_json,
    refuse_option_conflicts,
)
from swarm.cli.planning import Given, plan_paper_trajectory, with_mission
from swarm.errors import Interrupted, SwarmError
from swarm.files import write_text
from swarm.flight.flight_plan import ComparisonFlight, FlightPlan
from swarm.front.trials import Trials, fly_series, load_scenario
from swarm.reports.trials import print_trials, trials_report
from swarm.simulation.trials import workers_starting, write_results


@click.command()
@with_mission()
@click.option(
    "-n",
    "--count",
    type=click.IntRange(1, 100_000),
    default=100,
    show_default=True,
    help="Number of trials, each under other conditions.",
)
@click.option("--scenario", type=FILE, help="Distributions of the conditions, and faults (YAML).")
@SEED
@click.option("--compare", is_flag=True, help="Also fly the paper's trajectory.")
@JOBS
@SCHEDULER
@click.option("-o", "--output", type=OUTPUT, help="Write one row per trial (Parquet).")
@click.option("--plot", type=OUTPUT, help="Plot the distributions of the distances (PNG).")
@REPORT
@click.pass_context
def trials(
    context: click.Context,
    given: Given,
    /,
    count: int,
    scenario: Path | None,
    seed: int,
    compare: bool,
    jobs: int | None,
    scheduler: str | None,
    output: Path | None,
    plot: Path | None,
    report: Path | None,
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
    refuse_option_conflicts({"jobs": jobs, "scheduler": scheduler}, {}, [("jobs", "scheduler")])
    source = given.source(flight=True)
    # the processes that fly the trials start while the plan is computed
    with workers_starting(jobs) if scheduler is None else nullcontext():
        planned = source.planned()
    given.require_cleared(context, planned)
    spread, faults = load_scenario(scenario)
    flights: list[FlightPlan] = [planned.certified()]
    if compare:
        paper = plan_paper_trajectory(planned.plan.mission)
        flights.append(ComparisonFlight(paper.plan, paper.certificate))
    runs: list[Trials] = []
    ended: SwarmError | None = None
    for flight_plan in flights:
        method = flight_plan.plan.mission.fold.method
        with counting_bar(f"trials ({method})", count) as on_trial:
            flown, ended = fly_series(
                flight_plan,
                spread,
                trials=count,
                seed=seed,
                faults=faults,
                jobs=jobs,
                scheduler=scheduler,
                # the paper has no mission clock: with ours it would stop, not come close
                open_loop=bool(runs),
                on_trial=on_trial,
            )
        if ended and not len(flown):
            stopped = Interrupted("stopped before the first trial was completed")
            raise stopped if isinstance(ended, Interrupted) else ended
        runs.append(flown)
        if ended:
            break
    summaries = [run.summary() for run in runs]
    arguments = _repeated_by(given, scenario)
    if output:
        write_results(output, [(run.plan, run.trials) for run in runs], seed, spread)
    if plot or report:
        from swarm.reports import plots, study_plots  # noqa: PLC0415 - slow to import

        distances = [
            study_plots.trial_distances(run.plan, run.trials, run.certified) for run in runs
        ]
        required = runs[0].required
        if plot:
            plots.save(study_plots.trials_figure(distances, required), plot)
        if report:
            # one figure per distance, so that a phone shows them one below the other
            figures = [
                study_plots.trials_figure(distances, required, [figure]) for figure in FIGURES
            ]
            write_text(
                report,
                trials_report(planned.plan, planned.assessment, summaries, figures, arguments),
            )
    if given.as_json:
        both = {"ours": summaries[0], "paper": summaries[-1]}
        print_json(both if len(runs) > 1 else summaries[0])
    else:
        for summary in summaries:
            print_trials(summary, Console(), arguments)
    if ended:
        raise type(ended)(f"{ended} after {sum(map(len, runs))} trials")
    context.exit(0 if _passed(summaries[0]) else 1)


def _repeated_by(given: Given, scenario: Path | None) -> list[str]:
    """Return the arguments with which ``swarm dry-run`` flies the same mission and scenario."""
    overrides = [part for text in given.overrides for part in ("--set", text)]
    return [given.mission, *overrides, *(["--scenario", str(scenario)] if scenario else [])]


def _passed(summary: Mapping[str, Any]) -> bool:
    """Whether all trials without a failing vehicle are completed, and all keep the certificate."""
    sound = summary["without_failure"]
    return sound["completed"]["count"] == sound["trials"] and not summary["certificate"]["below"]
