"""What ``swarm fly --resume RECORD`` does: find a team whose ground station died, and go on."""

import sys
from pathlib import Path
from typing import Literal

import click
from pydantic import ValidationError
from rich.console import Console

from swarm.cli.flown import end_with
from swarm.cli.inputs import read_text
from swarm.cli.records import recorded_certificate, recorded_frames, recorded_plan
from swarm.errors import InputError, Problem, Refused
from swarm.flight.flight_plan import ResumedFlight
from swarm.flight.resuming import Then, left_off
from swarm.flight.snapshot import Event, Snapshot
from swarm.ground.flight_process import Flight, fly_apart
from swarm.mission.fleet import Fleet
from swarm.reports.terminal import FlightScreen
from swarm.view import rerun_log

LARGEST_LOG = 1 << 30


def resume_flight(
    context: click.Context,
    record: Path,
    folder: Path,
    control: Path | None,
    *,
    then: Then,
    view: Literal["native", "web"] | None,
    as_json: bool,
) -> None:
    """Take up the flight of a record, and end the command with its exit code."""
    console = Console(quiet=as_json)
    plan, (fleet, tlog) = recorded_plan(record), _recorded(record)
    basis, assessment = recorded_certificate(record)
    flight_plan = ResumedFlight(plan, basis, assessment)
    if fleet.emulated is not None:
        raise Refused("the built-in emulator ended with its ground station: nobody flies any more")
    left = left_off(tlog, plan, fleet, recorded_frames(record, plan))
    attached = "carrying cable" if basis.cable else "without cable"
    console.print(
        f"Broke off at {left.mission_time:.1f} s of the plan, {attached}; looking for "
        f"{plan.vehicles} vehicles.",
        highlight=False,
    )
    folder.mkdir(parents=True, exist_ok=True)
    viewer = rerun_log.start(plan, folder / "flight.rrd", view)
    screen = FlightScreen(plan, console)

    def on_snapshot(snapshot: Snapshot) -> None:
        screen.show(snapshot)
        viewer.offer(snapshot)

    def on_event(event: Event) -> None:
        screen.event(event)
        viewer.offer(event)

    try:
        with screen:
            result = fly_apart(
                Flight(
                    flight_plan,
                    fleet,
                    folder,
                    no_cable=not basis.cable,
                    control=control,
                    left=left,
                    then=then,
                ),
                take_keys=sys.stdin.isatty(),
                on_snapshot=on_snapshot,
                on_event=on_event,
                gives_way=True,
            )
    finally:
        viewer.close()
    end_with(context, plan, assessment, result, folder, as_json=as_json)


def _recorded(record: Path) -> tuple[Fleet, bytes]:
    """Return the fleet and the .tlog of a record, both of bounded size."""
    listed, log = record / "fleet.json", record / "flight.tlog"
    try:
        if log.stat().st_size > LARGEST_LOG:
            raise InputError([Problem(str(log), "too large for a flight")])
        return Fleet.model_validate_json(read_text(listed)), log.read_bytes()
    except OSError as error:
        reason = (error.strerror or "cannot be read").lower()
        raise InputError([Problem(str(log), reason)]) from None
    except ValidationError:
        raise InputError([Problem(str(listed), "expected the fleet of a flight")]) from None
