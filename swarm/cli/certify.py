"""``swarm certify``: certify an external trajectory."""

from pathlib import Path

import click
from rich.console import Console

from swarm.cli.inputs import FILE, JSON, REPORT, SET, print_json, progress_bar
from swarm.exports import assessment_object
from swarm.files import read_text, write_text
from swarm.front.certificates import Cable, Motion
from swarm.front.certificates import certify as certify_motion
from swarm.mission import Mission, mission_for_knot, parse_mission
from swarm.mission.validation import LARGEST_FILE
from swarm.reports.plan import certificate_report, print_findings


@click.command()
@click.argument("motion", type=FILE)
@click.option(
    "--cable",
    required=True,
    type=FILE,
    metavar="SEGMENTS",
    help="Lengths of the segments in metres: JSON (a list, or a plan's JSON) or CSV.",
)
@click.option(
    "--clearance",
    "clearances",
    multiple=True,
    metavar="KEY=METRES",
    help="Require another clearance: cable, vehicle, downwash, vehicle_cable or floor.",
)
@click.option(
    "--mission",
    type=FILE,
    help="Mission file with cable, vehicles, clearances, wind and workspace.",
)
@click.option("--robustness", is_flag=True, help="Compute e* and w* too; takes longer.")
@SET
@JSON
@REPORT
@click.pass_context
def certify(
    context: click.Context,
    motion: Path,
    cable: Path,
    clearances: tuple[str, ...],
    mission: Path | None,
    robustness: bool,
    overrides: tuple[str, ...],
    as_json: bool,
    report: Path | None,
) -> None:
    """Certify MOTION, a table of every grip point's motion as `swarm plan --export` writes it.

    The order of the phases determines when the cable is gripped and released; its state between
    follows from the motion.

    Prints the knot of the cable at the end, the smallest distances for every tracking error within
    vehicles.tracking, and all violations. Exit code 0 without violations, otherwise 1.

    Example: swarm certify motion.csv --cable segments.csv --clearance cable=0.2
    """
    overrides = (*overrides, *(f"clearance.{clearance}" for clearance in clearances))
    trajectory = Motion.from_csv(motion)
    segments = Cable.from_file(cable)
    _print_read(motion, trajectory, cable, segments)
    limits = _limits(mission, overrides)
    with progress_bar(Console(stderr=True)) as progress:
        assessment = certify_motion(
            trajectory, cable=segments, mission=limits, robustness=robustness, progress=progress
        ).assessment
    if report:
        write_text(report, certificate_report(motion.name, assessment, limits.vehicles.tracking))
    if as_json:
        print_json(assessment_object(assessment))
    else:
        print_findings(assessment.findings, Console())
    context.exit(0 if assessment.cleared else 1)


def _print_read(motion: Path, trajectory: Motion, cable: Path, segments: Cable) -> None:
    """Print what was read on stderr, for comparison with what was meant."""
    times, vehicles = trajectory.table.states.shape[:2]
    start, end = trajectory.table.time[[0, -1]]
    count, total = len(segments.lengths), sum(segments.lengths)
    click.echo(f"{motion}: {vehicles} vehicles, {times} times, {start:g} to {end:g} s", err=True)
    click.echo(f"{cable}: {count} segment{'s'[: count > 1]}, {total:.3f} m in total", err=True)


def _limits(mission: Path | None, overrides: tuple[str, ...]) -> Mission:
    """Return the mission with the limits; its knot has no effect on the certificate."""
    if mission is not None:
        return parse_mission(read_text(mission, LARGEST_FILE), str(mission), overrides)
    return mission_for_knot("overhand", ["limits.accept_negative_budget=true", *overrides])
