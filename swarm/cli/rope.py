"""What ``swarm dry-run --rope`` does: move a rope with contact, and tell which knot it is in."""

import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np
from rich.console import Console

from swarm import planner
from swarm.cli.inputs import print_json, progress_bar
from swarm.cli.trials import paper_mission
from swarm.errors import InputError, Problem, SwarmError
from swarm.files import write_text
from swarm.flight.trace import Trace
from swarm.ground.record_reader import recorded_flight, recorded_plan
from swarm.mission import Mission
from swarm.planning import Plan
from swarm.reports.plots import save
from swarm.reports.rope_plots import Moved, rope_figure
from swarm.reports.rope_report import rope_report

if TYPE_CHECKING:
    from swarm.analysis.rope import RopeRun
    from swarm.analysis.rope_model import Grips


def run_rope(
    context: click.Context,
    mission: Mission,
    planned: planner.PlanningResult,
    *,
    links: int | None,
    no_contact: bool,
    flown: Path | None,
    plot: Path | None,
    report: Path | None,
    compare: bool,
    as_json: bool,
) -> None:
    """Move the rope, print or write what it did, and end the command with its exit code.

    The plan need not be cleared: a rope harms nobody, and shows what would happen.
    """
    try:
        from swarm.analysis import rope  # noqa: PLC0415 - an optional extra
    except ImportError:
        raise SwarmError("a rope needs MuJoCo: pip install 'swarm-ground-station[rope]'") from None
    console = Console(quiet=as_json)
    plan = recorded_plan(flown) if flown else planned.plan
    grips = (
        _flown_grips(recorded_flight(flown, plan).trace, flown)
        if flown
        else rope.planned_grips(plan)
    )
    label = "as flown" if flown else "this plan"
    work: list[tuple[str, Plan, Grips]] = [(label, plan, grips)]
    if compare:
        with progress_bar(Console(stderr=True)) as progress:
            other = planner.plan(paper_mission(mission), progress).plan
        work.append(("the paper's trajectory", other, rope.planned_grips(other)))
    runs: list[tuple[str, Plan, RopeRun, float]] = []
    for name, one, motion in work:
        began = time.perf_counter()
        with progress_bar(Console(stderr=True)) as progress:
            run = rope.simulate_rope(
                one, motion, links=links, contact=not no_contact, wind=_wind(one), progress=progress
            )
        runs.append((name, one, run, time.perf_counter() - began))
    told = [
        {"trajectory": name, "took": took, **rope.told(run, one)} for name, one, run, took in runs
    ]
    if plot or report:
        figure = rope_figure(
            [_moved(name, run) for name, _, run, _ in runs], plan.mission.clearance.cable
        )
        if plot:
            save(figure, plot)
        if report:
            write_text(report, rope_report(plan, planned.assessment, told, figure))
    if as_json:
        print_json(told[0] if len(told) == 1 else {"ours": told[0], "paper": told[1]})
    else:
        for one_told in told:
            _print(one_told, plan, console)
    run = runs[0][2]
    context.exit(0 if run.as_planned and not run.void else 1)


def _wind(plan: Plan) -> tuple[float, float, float]:
    return (plan.mission.wind.steady, 0.0, 0.0)


def _flown_grips(trace: Trace, record: Path) -> "Grips":
    """Return where the vehicles were reported in fold and hold, on the flight's own clock."""
    from swarm.analysis.rope_model import Grips  # noqa: PLC0415 - an optional extra

    known = np.isin(np.array(trace.phase, dtype=str), ["fold", "hold"])
    known &= np.isfinite(trace.position).all(axis=(1, 2))
    if known.sum() < 2:
        raise InputError([Problem(str(record), "expected a flight that reached its fold")])
    return Grips(trace.time[known], trace.position[known])


def _moved(name: str, run: "RopeRun") -> Moved:
    """What is drawn of a run: at each moment of the segment that strays farthest."""
    beyond = np.where(run.stray > run.swing, run.stray, -np.inf).max(axis=1, initial=-np.inf)
    return Moved(
        label=name,
        verdict=_verdict(run),
        times=run.times,
        stray=run.stray.max(axis=1, initial=0.0),
        farther=np.where(np.isfinite(beyond), beyond, np.nan),
        apart=run.apart,
        still_apart=run.still_apart,
        shape=run.shape,
    )


def _verdict(run: "RopeRun") -> str:
    if run.void:
        return "shows nothing"
    hand = "" if run.chirality == "none" else f", {run.chirality}-handed"
    return f"{run.knot}{hand}" + ("" if run.as_planned else " (not as planned)")


def _print(told: dict[str, Any], plan: Plan, console: Console) -> None:
    def say(words: str) -> None:
        console.print(words, highlight=False, soft_wrap=True)

    knot = told["knot"]
    hand = "" if knot["chirality"] == "none" else f" {knot['chirality']}-handed"
    say(
        f"\n[bold]A rope of {told['links']} links moved by {told['trajectory']}[/], "
        f"{told['simulated']:.0f} s in {told['took']:.0f} s"
    )
    if told["void"]:
        say("[bold red]This run shows nothing:[/]")
        for reason in told["void"]:
            say(f"  {reason}")
    style = "green" if knot["as_planned"] and not told["void"] else "red"
    kept = "it keeps the knot" if told["tightened"] else "the knot is"
    asked = f"{plan.knot.type} {plan.knot.chirality}-handed".replace(" none-handed", "")
    say(f"{kept.capitalize()} [{style}]{knot['type']}{hand}[/] (asked for: {asked})")
    if told["tightened"]:
        say(f"pulled until its ends were {told['ends_apart']:.2f} m apart")
    smallest = told["smallest_distance"]
    if smallest is not None:
        still = told["smallest_distance_of_quasi_static_cable"]
        say(
            f"segments that share no vehicle came as close as {smallest:.2f} m "
            f"(the quasi-static cable: {still:.2f} m)"
        )
    stray = told["stray"]
    say(
        f"strayed from the quasi-static cable by up to {stray['largest']:.2f} m: segment "
        f"{stray['segment']} at {stray['time']:.0f} s, for which the budget's models of sway and a "
        f"stop allow {stray['sway_and_stop']:.2f} m then"
    )
    farther = stray["farther"]
    if farther["share"]:
        say(
            f"it strayed farther than these, by up to {farther['by']:.2f} m, at "
            f"{farther['share']:.0%} of moments and segments: strands swing on after a movement, "
            "which the budget leaves out"
        )
    depth, stretch, speed = told["penetration"], told["stretch"], told["speed"]
    say(
        f"deepest penetration {depth['radii']:.2f} radii (void beyond {depth['most']:g}), largest "
        f"stretch {stretch['share']:.2%} (void beyond {stretch['most']:.0%}), top speed "
        f"{speed['metres_per_second']:.1f} m/s (void beyond {speed['most']:g})"
    )
