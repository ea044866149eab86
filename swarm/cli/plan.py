"""``swarm plan``: plan a mission, check it, and show or export the result."""

from dataclasses import asdict
from pathlib import Path

import click
import numpy as np
from rich.console import Console
from rich.table import Table

from swarm import exports, planner, studies
from swarm.cli.inputs import JSON, MISSION, SET, print_json, progress_bar
from swarm.errors import Refused
from swarm.files import write_text
from swarm.front.files import load_mission
from swarm.mission import Mission
from swarm.reports.layout_sheet import layout_sheet
from swarm.reports.plan_summary import plan_summary


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
    help="Draw grid diagram, plan view and folded cable as PNG; with --front, all its plans.",
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
@click.option(
    "--front",
    is_flag=True,
    help="List cable against fold time against e* for plans with more and less room.",
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
    front: bool,
) -> None:
    """Plan MISSION (a file or a knot's name), check it, and print the plan.

    Exit code 0 when the plan is cleared for flight, 1 when it is refused.
    """
    loaded = load_mission(mission, overrides)
    if front:
        if export or report or sheet:
            raise click.UsageError("--front is of many plans: of all files it only takes --plot")
        context.exit(_front(loaded, as_json, plot))
    try:
        with progress_bar(Console(stderr=True)) as progress:
            planned = planner.plan(loaded, progress)
    except Refused as refusal:
        if as_json:
            print_json(exports.refusal_object(loaded, refusal))
        raise
    if export:
        write_text(export, "\n".join(exports.motion_rows(planned.plan)) + "\n")
    if plot:
        from swarm.reports.plots import plot_plan  # noqa: PLC0415 - slow to import

        plot_plan(planned.plan, plot)
    if report:
        from swarm.reports.plan_report import plan_report  # noqa: PLC0415 - slow to import

        write_text(report, plan_report(planned.plan, planned.assessment))
    if sheet:
        write_text(sheet, layout_sheet(planned.plan))
    if as_json:
        print_json(exports.plan_object(planned.plan, planned.assessment))
    else:
        plan_summary(planned.plan, planned.assessment, Console())
    context.exit(0 if planned.assessment.cleared else 1)


def _front(mission: Mission, as_json: bool, plot: Path | None) -> int:
    """List plans with more and less room; exit code 1 where none was cleared."""
    with progress_bar(Console(stderr=True)) as progress:
        found = list(studies.pareto_front(mission, progress))
    points = studies.mark_dominated(
        [point for point in found if isinstance(point, studies.FrontPoint)]
    )
    refused = [words for words in found if isinstance(words, str)]
    if plot and points:
        from swarm.reports.plots import front_figure, save  # noqa: PLC0415 - slow to import

        figure = front_figure(
            np.array([point.cable_length for point in points]),
            np.array([point.fold_time for point in points]),
            np.array([point.max_tracking_error for point in points]),
            [point.variant for point in points],
            [point.dominated for point in points],
        )
        save(figure, plot)
    if as_json:
        print_json({"plans": [asdict(point) for point in points], "refused": refused})
        return 0 if points else 1
    table = Table(box=None, padding=(0, 2, 0, 0), header_style="dim")
    table.add_column("variant")
    for name in ("cell", "cable", "fold", "e*"):
        table.add_column(name, justify="right")
    table.add_column("")
    for point in sorted(points, key=lambda point: point.cable_length):
        table.add_row(
            point.variant,
            f"{point.cell:.2f} m",
            f"{point.cable_length:.1f} m",
            f"{point.fold_time:.0f} s",
            f"{point.max_tracking_error:.3f} m",
            "[dim]dominated[/]" if point.dominated else "",
        )
    console = Console()
    console.print(table)
    for words in refused:
        console.print(f"refused: {words}", style="yellow", highlight=False)
    return 0 if points else 1
