"""``swarm plan``: plan a mission, check it, and show or export the result."""

from pathlib import Path

import click
from rich.console import Console

from swarm import api, exports
from swarm.cli.inputs import JSON, MISSION, SET, load_mission, print_json, progress_bar, write_text
from swarm.errors import Refused
from swarm.view.plots import plot_plan
from swarm.view.report import plan_report
from swarm.view.sheet import layout_sheet
from swarm.view.summary import plan_summary


@click.command()
@MISSION
@SET
@JSON
@click.option(
    "--export",
    type=click.Path(dir_okay=False, path_type=Path),
    help="Write every grip point's motion as CSV (ENU, SI, every 0.05 s).",
)
@click.option(
    "--plot",
    type=click.Path(dir_okay=False, path_type=Path),
    help="Draw grid diagram, plan view and folded cable as PNG.",
)
@click.option(
    "--report",
    type=click.Path(dir_okay=False, path_type=Path),
    help="Write a page (HTML, needs no network) about the plan.",
)
@click.option(
    "--sheet",
    type=click.Path(dir_okay=False, path_type=Path),
    help="Write a lay-out sheet to print (HTML): cable, grip marks, pads, lay line.",
)
@click.pass_context
def plan(
    context: click.Context,
    mission: str,
    overrides: tuple[str, ...],
    as_json: bool,
    export: Path | None,
    plot: Path | None,
    report: Path | None,
    sheet: Path | None,
) -> None:
    """Plan MISSION (a file or a knot's name), check it, and print the plan.

    Exit code 0 when the plan is cleared for flight, 1 when it is refused.
    """
    loaded = load_mission(mission, overrides)
    try:
        with progress_bar(Console(stderr=True)) as progress:
            planned = api.plan(loaded, progress)
    except Refused as refusal:
        if as_json:
            print_json(exports.refusal_object(loaded, refusal))
        raise
    if export:
        write_text(export, "\n".join(exports.motion_rows(planned.plan)) + "\n")
    if plot:
        plot_plan(planned.plan, plot)
    if report:
        write_text(report, plan_report(planned.plan, planned.assessment))
    if sheet:
        write_text(sheet, layout_sheet(planned.plan))
    if as_json:
        print_json(exports.plan_object(planned.plan, planned.assessment))
    else:
        plan_summary(planned.plan, planned.assessment, Console())
    context.exit(0 if planned.assessment.cleared else 1)
