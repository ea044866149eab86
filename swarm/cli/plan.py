"""``swarm plan``: plan a mission, check the plan, and show or export it."""

from dataclasses import asdict
from pathlib import Path

import click
from rich.console import Console

from swarm import exports, planner
from swarm.cli.exporting import FLOWN, PLANNED, export_plan, require_suffix
from swarm.cli.inputs import (
    FILE,
    JSON,
    MISSION,
    OUTPUT,
    REPLAN,
    REPORT,
    SET,
    VERBOSE,
    print_json,
    progress_bar,
)
from swarm.cli.planning import load_source, refuse_with_plan_file
from swarm.errors import Refused
from swarm.files import write_bytes, write_text
from swarm.front.files import is_plan_file, load_fleet
from swarm.front.plan_files import certified_plan_file
from swarm.mission import Mission
from swarm.planning.estimates import require_fleet
from swarm.reports.plan import plan_report, print_plan_summary
from swarm.reports.studies import print_front


@click.command()
@MISSION
@SET
@REPLAN
@JSON
@VERBOSE
@click.option(
    "--save",
    type=OUTPUT,
    help="Write the cleared plan with its certificate (FILE.plan), to be reviewed and flown.",
)
@click.option(
    "--export",
    type=OUTPUT,
    help="Write the motion of every grip point (ENU, SI): .csv, .mcap, .parquet or .rosbag, every "
    "0.05 s; a cleared plan also as .skyc or .crazyswarm, as swarm export.",
)
@click.option(
    "--plot",
    type=OUTPUT,
    help="Plot grid diagram, plan view and folded cable (PNG); with --front, the Pareto front.",
)
@click.option(
    "--vehicles",
    metavar="N|fewest|auto",
    help="Number of vehicles, in place of vehicles.count: fewest searches for the smallest.",
)
@click.option(
    "--fleet",
    "fleet_file",
    type=FILE,
    help="Fleet file: plan for its tracking error, as swarm check --hop measured it.",
)
@REPORT
@click.option(
    "--sheet",
    type=OUTPUT,
    help="Write a layout sheet to print (HTML): cable, grip marks, pads, lay line.",
)
@click.option(
    "--front",
    is_flag=True,
    help="Plan variants of the mission, with fewer vehicles too, and list their vehicles, cable, "
    "fold time, e* and payload (Pareto front).",
)
@click.pass_context
def plan(
    context: click.Context,
    /,
    mission: str,
    overrides: tuple[str, ...],
    replan: bool,
    as_json: bool,
    verbose: bool,
    front: bool,
    vehicles: str | None,
    fleet_file: Path | None,
    **files: Path | None,
) -> None:
    """Plan MISSION (a mission or plan file, or the name of a knot), check the plan, and print it.

    The first line is the verdict; warnings and errors are the last lines.

    Exit code 0 if the plan is cleared for flight, 1 if it is refused.

    A mission that was planned before with this version is not planned again: the plan is read
    from the user's cache and certified again. --save writes a plan file, which other commands take
    as MISSION; its certificate is computed again each time it is read.

    Example: swarm plan missions/overhand.yaml --save overhand.plan --plot plan.png
    """
    if vehicles is not None:
        overrides = (*overrides, f"vehicles.count={vehicles}")
    if files["export"]:
        require_suffix(files["export"], PLANNED)
    if is_plan_file(mission):
        refuse_with_plan_file(mission, {"--fleet": fleet_file})
    fleet = load_fleet(fleet_file) if fleet_file else None
    source = load_source(mission, overrides, replan=replan, fleet=fleet)
    if fleet is not None and isinstance(source.given, Mission):
        require_fleet(source.given, fleet)
    if front:
        others = (files[name] for name in ("save", "export", "report", "sheet"))
        if any(others) or replan or not isinstance(source.given, Mission):
            raise click.UsageError(
                "--front can be combined with --plot, --set, --vehicles, --fleet and --json only"
            )
        context.exit(_front(source.given, as_json, files["plot"]))
    try:
        planned = source.planned()
    except Refused as refusal:
        if as_json and isinstance(source.given, Mission):
            print_json(exports.refusal_object(source.given, refusal))
        raise
    _write_files(planned, **files)
    if as_json:
        print_json(exports.plan_object(planned.plan, planned.assessment))
    else:
        print_plan_summary(planned.plan, planned.assessment, Console(), verbose=verbose)
    if files["save"]:
        _say_saved(files["save"], planned)
    if files["export"] and not planned.assessment.cleared and files["export"].suffix in FLOWN:
        click.echo(f"{files['export']}: not written: the plan is refused", err=True)
    context.exit(0 if planned.assessment.cleared else 1)


def _write_files(
    planned: planner.PlanningResult,
    *,
    save: Path | None,
    export: Path | None,
    plot: Path | None,
    report: Path | None,
    sheet: Path | None,
) -> None:
    if save and planned.assessment.cleared:
        write_bytes(save, certified_plan_file(planned.certified()))
    if export and (planned.assessment.cleared or export.suffix not in FLOWN):
        export_plan(planned, export)
    if plot:
        from swarm.reports import plots  # noqa: PLC0415 - slow to import

        plots.save(plots.plan_figure(planned.plan), plot)
    if report:
        write_text(report, plan_report(planned.plan, planned.assessment))
    if sheet:
        from swarm.reports.layout_sheet import layout_sheet  # noqa: PLC0415 - slow to import

        write_text(sheet, layout_sheet(planned.plan))


def _say_saved(path: Path, planned: planner.PlanningResult) -> None:
    """Print the digest by which a saved plan is recognised, or that a refused plan is not saved."""
    if planned.assessment.cleared:
        words = f"{path}: saved; digest {planned.certificate.digest}"
    else:
        words = f"{path}: not written: the plan is refused"
    click.echo(words, err=True)


def _front(mission: Mission, as_json: bool, plot: Path | None) -> int:
    """Print the Pareto front of a mission; return exit code 1 if no variant is cleared."""
    from swarm import studies  # noqa: PLC0415 - slow to import

    with progress_bar(Console(stderr=True)) as progress:
        runs = list(studies.pareto_front(mission, progress))
    points = studies.mark_dominated([run for run in runs if isinstance(run, studies.FrontPoint)])
    refused = [run for run in runs if isinstance(run, str)]
    if plot and points:
        from swarm.reports.plots import save  # noqa: PLC0415 - slow to import
        from swarm.reports.study_plots import pareto_figure  # noqa: PLC0415

        save(pareto_figure([asdict(point) for point in points]), plot)
    if as_json:
        print_json({"plans": [asdict(point) for point in points], "refused": refused})
    else:
        print_front([asdict(point) for point in points], refused, Console())
    return 0 if points else 1
