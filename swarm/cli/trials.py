"""What ``swarm dry-run --trials`` does: fly many, keep what is done, tell what they say."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import click
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from swarm import planner
from swarm.cli.inputs import print_json, progress_bar
from swarm.errors import Interrupted
from swarm.files import read_text, write_text
from swarm.flight.flight_plan import ComparisonFlight, FlightPlan
from swarm.mission import Mission
from swarm.mission.validation import LARGEST_FILE
from swarm.planning import Plan
from swarm.reports.trial_plots import KINDS, NAMES, trial_distances, trials_figure
from swarm.simulation.loop import Fault
from swarm.simulation.monte_carlo import (
    CLEARANCES,
    CertifiedClearances,
    Spread,
    Trial,
    certify_clearances,
    fly_trials,
    process_count,
    read_scenario,
    summary,
)
from swarm.simulation.monte_carlo.results import write_results


def load_scenario(path: Path | None) -> tuple[Spread, tuple[Fault, ...]]:
    """Return what is drawn, and the faults of every trial; the usual ones without a file."""
    return read_scenario(read_text(path, LARGEST_FILE), str(path)) if path else (Spread(), ())


def paper_mission(mission: Mission) -> Mission:
    """Return the same mission with the paper's own trajectory."""
    return mission.model_copy(
        update={"fold": mission.fold.model_copy(update={"method": "paper"})}, deep=True
    )


def run_trials(
    context: click.Context,
    mission: Mission,
    planned: planner.PlanningResult,
    *,
    trials: int,
    scenario: Path | None,
    seed: int,
    jobs: int | None,
    scheduler: str | None,
    results: Path | None,
    plot: Path | None,
    report: Path | None,
    compare: bool,
    as_json: bool,
) -> None:
    """Fly the trials, print or write what they say, and end the command with its exit code."""
    console = Console(quiet=as_json)
    spread, faults = load_scenario(scenario)
    runs: list[tuple[Plan, FlightPlan]] = [(planned.plan, planned.certified())]
    if compare:
        with progress_bar(Console(stderr=True)) as progress:
            other = planner.plan(paper_mission(mission), progress)
        runs.append((other.plan, ComparisonFlight(other.plan, other.certificate)))
    done: list[tuple[Plan, list[Trial], CertifiedClearances]] = []
    interrupted = False
    for plan, flight_plan in runs:
        # the paper has no clock that waits: with ours its trajectory would stop, not come close
        open_loop = plan is not planned.plan
        flown, interrupted = _fly(
            flight_plan, spread, seed, trials, faults, jobs, scheduler, open_loop=open_loop
        )
        if not flown:
            raise Interrupted("stopped before any trial was done")
        together = 1 if interrupted else process_count(jobs)
        done.append((plan, flown, certify_clearances(plan, flown, together)))
        if interrupted:
            break
    told = [
        summary(plan, flown, seed=seed, spread=spread, certified=certified)
        for plan, flown, certified in done
    ]
    if results:
        write_results(results, [(plan, flown) for plan, flown, _ in done], seed, spread)
    if plot or report:
        from swarm.reports.plots import save  # noqa: PLC0415 - slow to import
        from swarm.reports.trials_report import trials_report  # noqa: PLC0415 - slow to import

        drawn = [trial_distances(plan, flown, certified) for plan, flown, certified in done]
        required = {name: getattr(planned.plan.mission.clearance, name) for name in CLEARANCES}
        if plot:
            save(trials_figure(drawn, required), plot)
        if report:
            # one by one, so that a phone shows them one below the other
            figures = [trials_figure(drawn, required, [kind]) for kind in KINDS]
            page = trials_report(planned.plan, planned.assessment, told, figures)
            write_text(report, page)
    if as_json:
        print_json(told[0] if len(told) == 1 else {"ours": told[0], "paper": told[1]})
    else:
        for one in told:
            print_summary(one, console)
    if interrupted:
        raise Interrupted(f"stopped after {sum(len(flown) for _, flown, _ in done)} trials")
    context.exit(0 if _as_certified(told[0]) else 1)


def _as_certified(told: Mapping[str, Any]) -> bool:
    """Whether all trials without a failing vehicle went as planned, none below its certificate."""
    sound = told["without_failure"]
    return sound["completed"]["count"] == sound["trials"] and not told["certificate"]["below"]


def _fly(
    flight_plan: FlightPlan,
    spread: Spread,
    seed: int,
    trials: int,
    faults: Sequence[Fault],
    jobs: int | None,
    scheduler: str | None,
    *,
    open_loop: bool,
) -> tuple[list[Trial], bool]:
    """Fly with a progress bar; return the trials done, and whether it was interrupted."""
    flown: list[Trial] = []
    console = Console(stderr=True)
    flying = fly_trials(
        flight_plan, spread, seed=seed, trials=range(trials), faults=faults, jobs=jobs,
        scheduler=scheduler, open_loop=open_loop,
    )  # fmt: skip
    with Progress(
        TextColumn("{task.description}"), BarColumn(bar_width=30), MofNCompleteColumn(),
        TimeRemainingColumn(), console=console, transient=True, disable=not console.is_terminal,
    ) as bar:  # fmt: skip
        task = bar.add_task(f"trials ({flight_plan.plan.mission.fold.method})", total=trials)
        try:
            for trial in flying:
                flown.append(trial)
                bar.advance(task)
        except KeyboardInterrupt:
            flying.close()
            return sorted(flown, key=lambda one: one.number), True
    return sorted(flown, key=lambda one: one.number), False


def print_summary(told: Mapping[str, Any], console: Console) -> None:
    """Print what trials say: completion, distances with intervals, harm, reasons, the worst."""
    sound, failing = told["without_failure"], told["with_failure"]
    name = "the paper's trajectory" if told["method"] == "paper" else "this plan"
    console.print(f"\n[bold]{told['trials']} trials of {name}[/], seed {told['seed']}")
    _say(console, f"completed, no vehicle failing: {_share(sound['completed'], sound['trials'])}")
    if failing["trials"]:
        _say(
            console,
            f"completed, one vehicle failing: {_share(failing['completed'], failing['trials'])}",
        )
    table = Table(box=None, padding=(0, 2, 0, 0), header_style="dim")
    table.add_column("smallest distance")
    for head in ("required", "in the worst", "5 % below", "half below"):
        table.add_column(head, justify="right", no_wrap=True)
    for kind, values in sound["clearance"].items():
        if values["count"]:
            table.add_row(NAMES[kind], f"{values['required']:.2f} m", *_distribution_cells(values))
    console.print(table)
    error = sound["tracking_error"]
    if error["count"]:
        _say(
            console,
            f"tracking errors: up to {error['quantiles']['0.5']['value']:.2f} m in half of the "
            f"trials, {error['largest']:.2f} m in the worst; {sound['outside_tracking_radius']} of "
            f"{sound['trials']} trials left the tracking ball that the plan is certified for",
        )
    _say(
        console,
        f"trials with rotor strikes: {told['trials_with_rotor_strikes']}, with collisions of "
        f"vehicles: {told['trials_with_collisions']}; vehicles lost: {told['vehicles_lost']}",
    )
    for words, count in told["reasons"].items():
        _say(console, f"not completed: {count} × {words}")
    checked = told["certificate"]
    style = "red" if checked["below"] else "green"
    _say(
        console,
        f"[{style}]{len(checked['below'])} of {checked['compared']} trials came closer than was "
        "certified for their tracking error[/]",
    )
    for one in told["worst"][:3]:
        cable = "unknown" if one["cable"] is None else f"{one['cable']:.2f} m"
        words = ", ".join(filter(None, (one["failing"], one["reason"])))
        _say(
            console,
            f"worth a look: trial {one['trial']} (cable {cable}{', ' + words if words else ''})",
        )
    if told["method"] != "paper":
        _say(
            console,
            f"see one again: swarm dry-run … --seed {told['seed']} --trial "
            f"{told['worst'][0]['trial']} --recording trial.rrd",
        )


def _say(console: Console, words: str) -> None:
    console.print(words, highlight=False, soft_wrap=True)


def _share(share: Mapping[str, Any], trials: int) -> str:
    if share["interval"] is None:
        return "no trials"
    low, high = share["interval"]
    return f"{share['count']} of {trials} ({low:.1%} to {high:.1%} at 95 % confidence)"


def _distribution_cells(values: Mapping[str, Any]) -> list[str]:
    cells = [f"{values['smallest']:.2f} m"]
    for share in ("0.05", "0.5"):
        quantile = values["quantiles"][share]
        low, high = (f"{v:.2f}" if v is not None else "?" for v in quantile["interval"])
        cells.append(f"{quantile['value']:.2f} m ({low} to {high})")
    return cells
