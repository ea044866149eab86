"""``swarm rope``: simulate a rope with contact, and identify its knot."""

from pathlib import Path

import click
from rich.console import Console

from swarm.cli.inputs import (
    FOLDER,
    OUTPUT,
    REPORT,
    print_json,
    progress_bar,
    refuse_option_conflicts,
)
from swarm.cli.planning import Given, plan_paper_trajectory, with_mission
from swarm.errors import SwarmError
from swarm.files import write_text
from swarm.ground.record_reader import recorded_flight, recorded_plan, true_trace
from swarm.reports.rope import print_rope, rope_report

PAPER = "the paper's trajectory"


@click.command()
@with_mission(verbose=False)
@click.option(
    "--links",
    type=click.IntRange(20, 5000),
    help="Number of links of the rope.  [default: one for each 0.17 m of cable]",
)
@click.option("--no-contact", is_flag=True, help="No contact; strands pass through each other.")
@click.option(
    "--flown",
    type=FOLDER,
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
@REPORT
@click.pass_context
def rope(
    context: click.Context,
    given: Given,
    /,
    links: int | None,
    no_contact: bool,
    flown: Path | None,
    truth: bool,
    compare: bool,
    plot: Path | None,
    report: Path | None,
) -> None:
    """Simulate a rope of hundreds of links with contact, moved along the plan of MISSION.

    MISSION is a mission or plan file, or the name of a knot. The rope (MuJoCo) moves along the
    planned motion of the grip points; then its knot is identified. No vehicle flies, so a refused
    plan is moved too.

    Exit code 0 if the rope has the planned knot and the simulation is valid; otherwise 1.

    Example: swarm rope missions/overhand.yaml --plot rope.png
    """
    options = {"truth": truth, "flown": flown, "compare": compare}
    refuse_option_conflicts(options, {"truth": ("flown",)}, [("compare", "flown")])
    planned = given.source().planned()
    try:
        from swarm.rope import (  # noqa: PLC0415 - an optional extra
            flown_grips,
            planned_grips,
            simulate_rope,
        )
    except ImportError:
        raise SwarmError("a rope needs MuJoCo: pip install 'swarm-ground-station[rope]'") from None
    plan = planned.plan
    if flown:
        plan = recorded_plan(flown)
        log = recorded_flight(flown, plan)
        trace = true_trace(flown, log) if truth else log.trace
        trajectories = [("as flown", plan, flown_grips(trace, str(flown)))]
    else:
        trajectories = [("this plan", plan, planned_grips(plan))]
    if compare:
        paper = plan_paper_trajectory(plan.mission).plan
        trajectories.append((PAPER, paper, planned_grips(paper)))
    runs = []
    for name, moved, grips in trajectories:
        with progress_bar(Console(stderr=True)) as progress:
            runs.append(
                simulate_rope(
                    moved,
                    grips,
                    name,
                    links=links,
                    contact=not no_contact,
                    wind=(moved.mission.wind.steady, 0.0, 0.0),
                    progress=progress,
                )
            )
    documents = [run.document() for run in runs]
    if plot or report:
        from swarm.reports import plots, study_plots  # noqa: PLC0415 - slow to import

        curves = list(map(study_plots.rope_curves, runs))
        figure = study_plots.rope_figure(curves, plan.mission.clearance.cable)
        if plot:
            plots.save(figure, plot)
        if report:
            write_text(report, rope_report(plan, planned.assessment, documents, figure))
    if given.as_json:
        both = {"ours": documents[0], "paper": documents[-1]}
        print_json(both if compare else documents[0])
    else:
        for document in documents:
            print_rope(document, plan, Console())
    context.exit(0 if runs[0].as_planned and not runs[0].invalid else 1)
