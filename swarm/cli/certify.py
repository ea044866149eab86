"""``swarm certify``: check anybody's trajectories in the cable model."""

import csv
from pathlib import Path

import click
from rich.console import Console

from swarm.certification.assess import assess
from swarm.certification.assessment import Assessment
from swarm.certification.motion_file import plan_of_motion, read_lengths, read_motion
from swarm.cli.inputs import JSON, SET, print_json, progress_bar
from swarm.errors import InputError, Problem
from swarm.exports import finding_object, tightest_object
from swarm.files import read_text
from swarm.mission import Mission, mission_for_knot, parse_mission
from swarm.mission.validation import LARGEST_FILE
from swarm.reports.plan_summary import findings

LARGEST_MOTION = 500_000_000
"""Bytes; an hour of a hundred vehicles is less."""


@click.command()
@click.argument("motion", type=click.Path(dir_okay=False, path_type=Path))
@click.option(
    "--cable",
    required=True,
    type=click.Path(dir_okay=False, path_type=Path),
    metavar="SEGMENTS",
    help="Lengths of the segments in metres: JSON (a list, or a plan's JSON) or CSV.",
)
@click.option(
    "--clearance",
    "clearances",
    multiple=True,
    metavar="KEY=METRES",
    help="Ask for another clearance: cable, vehicle, downwash, vehicle_cable or floor.",
)
@click.option(
    "--mission",
    type=click.Path(dir_okay=False, path_type=Path),
    help="Take cable, vehicles, clearances, wind and workspace from a mission file.",
)
@click.option("--robustness", is_flag=True, help="Find e* and w* too; takes longer.")
@SET
@JSON
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
) -> None:
    """Certify MOTION, a table of every grip point's motion as `swarm plan --export` writes it.

    The order of the phases says when the cable is gripped and let go of; while it is held, what it
    does follows from the motion.

    Says which knot the cable ends in, how close things come for every tracking error within
    vehicles.tracking, and what fails. Exit code 0 when everything holds, 1 when it does not.
    """
    overrides = (*overrides, *(f"clearance.{clearance}" for clearance in clearances))
    try:
        path = motion
        moved = read_motion(read_text(motion, LARGEST_MOTION), str(motion))
        path = cable
        lengths = read_lengths(read_text(cable, LARGEST_FILE), str(cable))
    except csv.Error as error:
        raise InputError([Problem(str(path), f"not valid CSV: {error}")]) from None
    plan = plan_of_motion(moved, lengths, _limits(mission, overrides))
    with progress_bar(Console(stderr=True)) as progress:
        assessment = assess(plan, progress=progress, robustness=robustness)
    if as_json:
        print_json(_object(assessment))
    else:
        findings(assessment.findings, assessment.cleared, Console())
    context.exit(0 if assessment.cleared else 1)


def _limits(mission: Path | None, overrides: tuple[str, ...]) -> Mission:
    """Return the mission whose limits are meant; its knot says nothing about the motion."""
    if mission is not None:
        return parse_mission(read_text(mission, LARGEST_FILE), str(mission), overrides)
    return mission_for_knot("overhand", overrides)


def _object(assessment: Assessment) -> dict[str, object]:
    return {
        "cleared": assessment.cleared,
        "findings": [finding_object(finding) for finding in assessment.findings],
        "knot": {
            "type": assessment.knot,
            "chirality": assessment.chirality,
            "gauss": assessment.gauss,
        },
        "clearance": {
            "cable": tightest_object(assessment.cable),
            "vehicle": tightest_object(assessment.vehicle),
            "vehicle_cable": tightest_object(assessment.vehicle_cable),
        },
        "robustness": {
            "tracking": assessment.robustness.tracking,
            "wind": assessment.robustness.wind,
        },
    }
