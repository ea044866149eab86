"""``swarm dry-run --rope``: simulate a rope with contact, and identify its knot."""

from dataclasses import dataclass
from pathlib import Path

import click
from rich.console import Console

from swarm import planner
from swarm.cli.inputs import print_json, progress_bar
from swarm.cli.planning import plan_paper_trajectory
from swarm.errors import SwarmError
from swarm.files import write_text
from swarm.ground.record_reader import recorded_flight, recorded_plan
from swarm.reports.plots import save
from swarm.reports.rope_plots import rope_figure
from swarm.reports.rope_report import rope_report
from swarm.reports.rope_text import print_rope, rope_curves

PAPER = "the paper's trajectory"


@dataclass(frozen=True)
class RopeOptions:
    """The options of ``--rope``."""

    links: int | None
    no_contact: bool
    flown: Path | None
    plot: Path | None
    report: Path | None
    compare: bool


def run_rope(
    context: click.Context, planned: planner.PlanningResult, options: RopeOptions, *, as_json: bool
) -> None:
    """Simulate the rope, print or write the result, and exit with its code.

    The plan may have errors: no vehicle flies.
    """
    try:
        from swarm.simulation import rope  # noqa: PLC0415 - an optional extra
    except ImportError:
        raise SwarmError("a rope needs MuJoCo: pip install 'swarm-ground-station[rope]'") from None
    if options.flown:
        plan = recorded_plan(options.flown)
        trace = recorded_flight(options.flown, plan).trace
        trajectories = [rope.flown_trajectory(plan, trace, str(options.flown))]
    else:
        plan = planned.plan
        trajectories = [rope.planned_trajectory("this plan", plan)]
    if options.compare:
        paper = plan_paper_trajectory(plan.mission).plan
        trajectories.append(rope.planned_trajectory(PAPER, paper))
    results = []
    for trajectory in trajectories:
        with progress_bar(Console(stderr=True)) as progress:
            results.append(
                rope.simulate_rope(
                    trajectory,
                    links=options.links,
                    contact=not options.no_contact,
                    progress=progress,
                )
            )
    documents = [result.document() for result in results]
    if options.plot or options.report:
        figure = rope_figure(list(map(rope_curves, results)), plan.mission.clearance.cable)
        if options.plot:
            save(figure, options.plot)
        if options.report:
            page = rope_report(plan, planned.assessment, documents, figure)
            write_text(options.report, page)
    if as_json:
        both = {"ours": documents[0], "paper": documents[-1]}
        print_json(both if options.compare else documents[0])
    else:
        for document in documents:
            print_rope(document, plan, Console())
    run = results[0].run
    context.exit(0 if run.as_planned and not run.invalid else 1)
