"""``swarm fly --resume RECORD``: take over a team whose ground station failed in flight."""

import sys
from dataclasses import replace
from pathlib import Path

import click
from rich.console import Console

from swarm.certification.certificate import without_cable
from swarm.cli.flight_session import Viewer, displays, end_flight
from swarm.cli.planning import prepare_flight
from swarm.errors import Refused
from swarm.flight.flight_plan import ResumedFlight, confirmed_basis
from swarm.flight.resuming import left_off
from swarm.ground.callbacks import FlightCallbacks
from swarm.ground.flight_process import FlightRequest, fly_in_process
from swarm.ground.fly import FlyOptions
from swarm.ground.record_folder import control_socket
from swarm.ground.record_reader import (
    recorded_certificate,
    recorded_fleet,
    recorded_frames,
    recorded_log,
    recorded_plan,
)
from swarm.planner import certify_again

LARGEST_LOG = 1 << 30
"""Bytes of the packets of the interrupted flight."""


def resume_flight(
    context: click.Context,
    record: Path,
    folder: Path,
    options: FlyOptions,
    *,
    view: Viewer | None,
    as_json: bool,
) -> None:
    """Resume the flight of a record with ``options``, and exit with its code."""
    console = Console(quiet=as_json)
    plan, fleet = recorded_plan(record), recorded_fleet(record)
    log = recorded_log(record, LARGEST_LOG)
    basis, assessment = recorded_certificate(record)
    flight_plan = ResumedFlight(plan, basis, assessment)
    if fleet.emulated is not None:
        raise Refused("the built-in emulator ended with its ground station: no vehicle is flying")
    left = left_off(log, plan, fleet, recorded_frames(record, plan))
    attached = "carrying cable" if basis.cable else "without cable"
    console.print(
        f"Interrupted at {left.mission_time:.1f} s of the plan, {attached}; searching for "
        f"{plan.vehicles} vehicles.",
        highlight=False,
    )
    flight = FlightRequest(
        flight_plan,
        fleet,
        folder,
        replace(options, no_cable=not basis.cable, control=control_socket(folder), left=left),
    )
    prepare_flight()
    with displays(plan, folder, view, console) as shown, shown.screen:
        result = fly_in_process(
            flight,
            FlightCallbacks(on_snapshot=shown.on_snapshot, on_event=shown.on_event),
            read_keys=sys.stdin.isatty(),
            low_priority=True,
        )
    # What the report states as certified is shown again: now there is time for it.
    again = certify_again(plan if basis.cable else without_cable(plan), assessment.robustness)
    basis = confirmed_basis(plan, result.basis)
    kept = replace(result.adherence, certified=basis.max_tracking_error)
    result = replace(result, basis=basis, adherence=kept)
    end_flight(context, plan, again.assessment, result, folder, as_json=as_json)
