"""What ``swarm fly --resume RECORD`` does: find a team whose ground station died, and go on."""

import sys
from pathlib import Path
from typing import Literal

import click
from rich.console import Console

from swarm.cli.flown import end_with
from swarm.errors import Refused
from swarm.flight.flight_plan import ResumedFlight
from swarm.flight.resuming import Then, left_off
from swarm.flight.snapshot import Event, Snapshot
from swarm.ground.flight_process import FlightRequest, fly_in_process
from swarm.ground.record_reader import (
    recorded_certificate,
    recorded_fleet,
    recorded_frames,
    recorded_log,
    recorded_plan,
)
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
    plan, fleet = recorded_plan(record), recorded_fleet(record)
    basis, assessment = recorded_certificate(record)
    flight_plan = ResumedFlight(plan, basis, assessment)
    if fleet.emulated is not None:
        raise Refused("the built-in emulator ended with its ground station: nobody flies any more")
    left = left_off(recorded_log(record, LARGEST_LOG), plan, fleet, recorded_frames(record, plan))
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
            result = fly_in_process(
                FlightRequest(
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
