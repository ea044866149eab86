"""``swarm verify``: tell from a flight's record what was flown."""

from pathlib import Path

import click
import numpy as np
from rich.console import Console

from swarm.cli.inputs import JSON, print_json
from swarm.cli.outcome import flown_object, print_flown
from swarm.cli.view import recorded_plan
from swarm.errors import InputError, Problem
from swarm.flight.trace import Trace
from swarm.preflight.assess import assess
from swarm.verify import judge


@click.command()
@click.argument("record", type=click.Path(path_type=Path))
@JSON
@click.pass_context
def verify(context: click.Context, record: Path, as_json: bool) -> None:
    """Recompute from RECORD (a flight's folder) which knot was flown, and how closely.

    Judges the positions that the vehicles reported, in the cable model, against the recorded plan.
    Exit code 0 when they imply the knot that was asked for, 1 when they do not.
    """
    plan, trace = recorded_plan(record), recorded_trace(record)
    assessment, flown = assess(plan), judge(plan, trace)
    if as_json:
        print_json({"record": str(record), **flown_object(flown, assessment)})
    else:
        print_flown(plan, flown, assessment, Console())
    context.exit(0 if flown.as_planned else 1)


def recorded_trace(record: Path) -> Trace:
    """Return the trace that a record's folder holds; raises :class:`InputError` without one."""
    path = record / "trace.npz"
    try:
        with np.load(path, allow_pickle=False) as data:
            return Trace(
                time=data["time"],
                mission_time=data["mission_time"],
                position=data["position"],
                setpoint=data["setpoint"],
                phase=tuple(str(name) for name in data["phase"]),
            )
    except (OSError, ValueError, KeyError, EOFError):
        reason = "expected a flight's record with trace.npz in it"
        raise InputError([Problem(str(record), reason)]) from None
