"""``swarm export``: write a flight or a plan as a file for another program."""

from dataclasses import replace
from pathlib import Path

import click

from swarm.cli.exporting import PLANNED, SAMPLED, export_plan, export_samples, require_suffix
from swarm.cli.inputs import REPLAN, SET, Output
from swarm.cli.planning import load_source
from swarm.errors import InputError, Problem
from swarm.formats.samples import Samples, sampled_flight
from swarm.ground.record_reader import recorded_events, recorded_flight, recorded_plan


@click.command()
@click.argument("source", metavar="RECORD|MISSION|FILE.plan")
@click.option(
    "-o",
    "--output",
    required=True,
    type=Output(path_type=Path),
    help="The file or folder to write; the end of its name chooses the format.",
)
@SET
@REPLAN
def export(source: str, output: Path, overrides: tuple[str, ...], replan: bool) -> None:
    """Write a flight RECORD (a folder), or the plan of a MISSION, for another program.

    \b
    .mcap     Foxglove and PlotJuggler: vehicles, cable, events and figures over time
    .parquet  tables: one row per moment, one column per figure of a vehicle
    .rosbag   ROS 2 (Jazzy): a bag, which is a folder, with positions, frames and cable

    Of a plan only:

    \b
    .csv         the motion of every grip point, for swarm certify
    .skyc        Skybrush: a show file
    .crazyswarm  Crazyswarm2: a folder with one trajectory per vehicle

    A flight has the reported positions and the sent setpoints, from its .tlog. A mission is planned
    first; a refused plan is not written (swarm plan --export writes it, but not for a program that
    flies).

    Example: swarm export flights/2025-06-01T10-00-00-overhand --output flight.mcap
    """
    record = Path(source)
    if record.is_dir():
        given = [name for name, value in (("--set", overrides), ("--replan", replan)) if value]
        if given:
            message = f"{source} is a flight record, which is not planned again"
            raise InputError([Problem(name, message) for name in given])
        require_suffix(output, SAMPLED)
        export_samples(_flight(record), output)
    else:
        require_suffix(output, PLANNED)
        planned = load_source(source, overrides, replan=replan).planned()
        planned.certified()
        note = export_plan(planned, output)
        if note:
            click.echo(f"{output}: {note}", err=True)
    click.echo(f"{output}")


def _flight(record: Path) -> Samples:
    """Return the flight of a record, with its events on the clock of its positions."""
    plan = recorded_plan(record)
    log = recorded_flight(record, plan)
    events = [replace(event, time=event.time - log.event_time) for event in recorded_events(record)]
    return sampled_flight(plan, log.trace, log.started, tuple(events))
