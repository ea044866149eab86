"""``swarm verify``: verify a flight record."""

from datetime import UTC, datetime
from pathlib import Path

import click
from rich.console import Console

from swarm.cli.flight_session import recorded_report
from swarm.cli.inputs import FILE, JSON, OUTPUT, print_json
from swarm.errors import Refused
from swarm.files import write_text
from swarm.front.plans import load_plan
from swarm.ground.ladder import enter
from swarm.ground.record_reader import recorded_plan
from swarm.ground.record_verification import parse_observation, verify_record
from swarm.planning import digest
from swarm.reports.flight import print_record, record_object


@click.command()
@click.argument("record", type=click.Path(path_type=Path))
@JSON
@click.option(
    "--plan",
    "reviewed",
    type=FILE,
    metavar="FILE.plan",
    help="Refuse the record of another plan than this one.",
)
@click.option(
    "--observed",
    metavar="SENTENCE",
    help='Append an observation to the record, such as "3_1 right by camera" or "unknot by Ann".',
)
@click.option(
    "--truth",
    is_flag=True,
    help="Use the emulator's ground truth in the record instead of the vehicles' reports.",
)
@click.option(
    "--plot",
    type=OUTPUT,
    help="Draw the positions in the hold, the tracking errors and the mission clock (PNG).",
)
@click.option("--report", type=OUTPUT, help="Write the page of the flight (one HTML file).")
@click.pass_context
def verify(
    context: click.Context,
    record: Path,
    as_json: bool,
    reviewed: Path | None,
    observed: str | None,
    truth: bool,
    plot: Path | None,
    report: Path | None,
) -> None:
    """Verify a flight RECORD (a folder): implied knot, smallest distances, tracking errors.

    Reads reported positions and sent setpoints from the .tlog and compares them with the recorded
    plan in the cable model: every kind of clearance, while its certificate applies. Exit code 0 if
    they imply the planned knot, the last observation agrees, and cable was carried within the
    certificate; otherwise 1. The record of a flight of real vehicles is entered in the list of
    first tests where it passes one (`swarm check`).

    Example: swarm verify flights/2025-06-01T10-00-00-overhand --plot flight.png
    """
    observation = parse_observation(observed, datetime.now(UTC)) if observed else None
    if reviewed is not None:
        _require_reviewed(record, reviewed)
    verified = verify_record(record, truth=truth)
    if observation is not None:
        verified = verified.observed(observation)
    if plot:
        from swarm.reports.plots import flight_figure, save  # noqa: PLC0415 - slow to import

        save(flight_figure(verified.plan, verified.log.trace), plot)
    if report:
        write_text(report, recorded_report(verified))
    document = record_object(verified)
    enter(verified)
    if as_json:
        print_json(document)
    else:
        print_record(verified, document, Console())
    context.exit(0 if verified.passed else 1)


def _require_reviewed(record: Path, reviewed: Path) -> None:
    """Raise :class:`Refused` for the record of another plan than the one of a plan file."""
    expected, flown = digest(load_plan(reviewed)), digest(recorded_plan(record))
    if expected != flown:
        raise Refused(
            f"{record}: another plan than {reviewed}: expected digest {expected}, got {flown}"
        )
