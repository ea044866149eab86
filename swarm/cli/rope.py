"""``swarm rope``: simulate a rope with contact, and identify its knot."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
from rich.console import Console

from swarm import planner
from swarm.cli.inputs import (
    JSON,
    MISSION,
    OUTPUT,
    REPLAN,
    SET,
    print_json,
    progress_bar,
    refuse_option_conflicts,
)
from swarm.cli.planning import load_source, plan_paper_trajectory
from swarm.errors import SwarmError
from swarm.files import write_text
from swarm.ground.record_reader import recorded_flight, recorded_plan, true_trace
from swarm.reports.plots import save
from swarm.reports.rope_plots import rope_figure
from swarm.reports.rope_report import rope_report
from swarm.reports.rope_text import print_rope, rope_curves

PAPER = "the paper's trajectory"


@dataclass(frozen=True)
class RopeOptions:
    """The options of the command."""

    links: int | None
    no_contact: bool
    flown: Path | None
    truth: bool
    plot: Path | None
    report: Path | None
    compare: bool


@click.command()
@MISSION
@SET
@REPLAN
@JSON
@click.option(
    "--links",
    type=click.IntRange(20, 5000),
    help="Number of links of the rope.  [default: one for each 0.17 m of cable]",
)
@click.option("--no-contact", is_flag=True, help="No contact; strands pass through each other.")
@click.option(
    "--flown",
    type=click.Path(file_okay=False, path_type=Path),
    metavar="RECORD",
    help="Use the reported motion of this flight record instead of the plan.",
)
@click.option(
    "--truth",
    is_flag=True,
    help="With --flown: use the emulator's ground truth in the record, not the reports.",
)
@click.option("--compare", is_flag=True, help="Also move the rope on the paper's trajectory.")
@click.option("--plot", type=OUTPUT, help="Plot the rope's distances and its knot (PNG).")
@click.option("--report", type=OUTPUT, help="Write a report (one HTML file).")
@click.pass_context
def rope(
    context: click.Context,
    /,
    mission: str,
    overrides: tuple[str, ...],
    replan: bool,
    as_json: bool,
    **options: Any,
) -> None:
    """Simulate a rope of hundreds of links with contact, moved along the plan of MISSION.

    MISSION is a mission or plan file, or the name of a knot. The rope (MuJoCo) moves along the
    planned motion of the grip points; then its knot is identified. No vehicle flies, so a refused
    plan is moved too.

    Exit code 0 if the rope has the planned knot and the simulation is valid; otherwise 1.

    Example: swarm rope missions/overhand.yaml --plot rope.png
    """
    refuse_option_conflicts(options, {"truth": ("flown",)}, [("compare", "flown")])
    planned = load_source(mission, overrides, replan=replan).planned()
    run_rope(context, planned, RopeOptions(**options), as_json=as_json)


def run_rope(
    context: click.Context, planned: planner.PlanningResult, options: RopeOptions, *, as_json: bool
) -> None:
    """Simulate the rope, print or write the result, and exit with its code."""
    try:
        import swarm_rope  # noqa: PLC0415 - an optional extra
    except ImportError:
        raise SwarmError("a rope needs MuJoCo: pip install 'swarm-ground-station[rope]'") from None
    if options.flown:
        plan = recorded_plan(options.flown)
        flown = recorded_flight(options.flown, plan)
        trace = true_trace(options.flown, flown) if options.truth else flown.trace
        trajectories = [("as flown", plan, swarm_rope.flown_grips(trace, str(options.flown)))]
    else:
        plan = planned.plan
        trajectories = [("this plan", plan, swarm_rope.planned_grips(plan))]
    if options.compare:
        paper = plan_paper_trajectory(plan.mission).plan
        trajectories.append((PAPER, paper, swarm_rope.planned_grips(paper)))
    runs = []
    for name, moved, grips in trajectories:
        with progress_bar(Console(stderr=True)) as progress:
            runs.append(
                swarm_rope.simulate_rope(
                    moved,
                    grips,
                    name,
                    links=options.links,
                    contact=not options.no_contact,
                    wind=(moved.mission.wind.steady, 0.0, 0.0),
                    progress=progress,
                )
            )
    documents = [run.document() for run in runs]
    if options.plot or options.report:
        figure = rope_figure(list(map(rope_curves, runs)), plan.mission.clearance.cable)
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
    context.exit(0 if runs[0].as_planned and not runs[0].invalid else 1)
