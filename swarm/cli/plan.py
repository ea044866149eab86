"""``swarm plan``: plan a mission, check the plan, and show or export it."""

from dataclasses import asdict
from pathlib import Path

import click
from rich.console import Console

from swarm import exports, planner, studies
from swarm.cli.inputs import JSON, MISSION, SET, VERBOSE, print_json, progress_bar
from swarm.cli.planning import plan_mission
from swarm.errors import Refused
from swarm.files import write_text
from swarm.front.files import load_mission
from swarm.mission import Mission
from swarm.reports.layout_sheet import layout_sheet
from swarm.reports.plan_summary import print_plan_summary
from swarm.reports.studies_text import print_front

FILE = click.Path(dir_okay=False, path_type=Path)


@click.command()
@MISSION
@SET
@JSON
@VERBOSE
@click.option(
    "--export", type=FILE, help="Write the motion of every grip point (CSV; ENU, SI, every 0.05 s)."
)
@click.option(
    "--plot",
    type=FILE,
    help="Plot grid diagram, plan view and folded cable (PNG); with --front, the Pareto front.",
)
@click.option("--report", type=FILE, help="Write a report (one HTML file).")
@click.option(
    "--sheet",
    type=FILE,
    help="Write a layout sheet to print (HTML): cable, grip marks, pads, lay line.",
)
@click.option(
    "--front",
    is_flag=True,
    help="Plan variants of the mission, and list their cable, fold time and e* (Pareto front).",
)
@click.pass_context
def plan(
    context: click.Context,
    /,
    mission: str,
    overrides: tuple[str, ...],
    as_json: bool,
    verbose: bool,
    front: bool,
    **files: Path | None,
) -> None:
    """Plan MISSION (a file or the name of a knot), check the plan, and print it.

    The first line is the verdict; warnings and errors are the last lines.

    Exit code 0 if the plan is cleared for flight, 1 if it is refused.

    Example: swarm plan missions/overhand.yaml --plot plan.png --export motion.csv
    """
    loaded = load_mission(mission, overrides)
    if front:
        if files["export"] or files["report"] or files["sheet"]:
            raise click.UsageError("--front can be combined with --plot, --set and --json only")
        context.exit(_front(loaded, as_json, files["plot"]))
    try:
        planned = plan_mission(loaded)
    except Refused as refusal:
        if as_json:
            print_json(exports.refusal_object(loaded, refusal))
        raise
    _write_files(planned, **files)
    if as_json:
        print_json(exports.plan_object(planned.plan, planned.assessment))
    else:
        print_plan_summary(planned.plan, planned.assessment, Console(), verbose=verbose)
    context.exit(0 if planned.assessment.cleared else 1)


def _write_files(
    planned: planner.PlanningResult,
    *,
    export: Path | None,
    plot: Path | None,
    report: Path | None,
    sheet: Path | None,
) -> None:
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


def _front(mission: Mission, as_json: bool, plot: Path | None) -> int:
    """Print the Pareto front of a mission; return exit code 1 if no variant is cleared."""
    with progress_bar(Console(stderr=True)) as progress:
        found = list(studies.pareto_front(mission, progress))
    points = studies.mark_dominated([one for one in found if isinstance(one, studies.FrontPoint)])
    refused = [one for one in found if isinstance(one, str)]
    if plot and points:
        from swarm.reports.plots import pareto_figure, save  # noqa: PLC0415 - slow to import

        save(pareto_figure([asdict(point) for point in points]), plot)
    if as_json:
        print_json({"plans": [asdict(point) for point in points], "refused": refused})
    else:
        print_front([asdict(point) for point in points], refused, Console())
    return 0 if points else 1
