"""The process that serves a flight to Foxglove: ``python -m swarm.view.foxglove_sink``.

It reads pickles from its standard input: the plan and the output, then snapshots and events. The
same messages go to viewers and into an MCAP log. At the end of the input, also a broken one, it
completes the log.
"""

import os
import sys
import time
from contextlib import ExitStack, suppress
from typing import Any, Final

import foxglove
import numpy as np
import numpy.typing as npt
from foxglove import Context
from foxglove.messages import Color

from swarm.certification.monitor import Clearances
from swarm.flight.snapshot import Event, Snapshot
from swarm.formats.foxglove import OPTIONS, Messages
from swarm.formats.samples import CABLE_POINTS, nanoseconds
from swarm.planning import Plan
from swarm.planning.cable_shape import laid_grip_points
from swarm.reports import scene
from swarm.view.feeds import first_item, items
from swarm.view.viewers import LOOPBACK

Floats = npt.NDArray[np.float64]

PERIOD: Final = 0.1
"""Seconds between two moments that are sent."""
FIELD_PERIOD: Final = 1.0
"""Seconds after which what stands still is sent again: viewers get nothing of before they came."""


def main() -> None:
    """Serve and record what arrives on standard input."""
    source = sys.stdin.buffer
    plan, options = first_item(source)
    context = Context()
    with ExitStack() as sinks:
        if options.path is not None:
            log = foxglove.open_mcap(
                options.path, context=context, allow_overwrite=True, writer_options=OPTIONS
            )
            sinks.callback(log.close)
        flight = FlightMessages(plan, context)
        if options.live is not None:
            name = f"swarm: {plan.mission.name}"
            # where another program has taken the port since, the record is kept all the same
            with suppress(RuntimeError):
                server = foxglove.start_server(
                    name=name, host=LOOPBACK, port=options.port, context=context
                )
                sinks.callback(server.stop)
        for item in items(source):
            flight.begin(time.time() - item.time)
            if isinstance(item, Event):
                flight.event(item)
            else:
                flight.snapshot(item)
    # Without the interpreter's shutdown, in which the library may wait for viewers.
    os._exit(0)


class FlightMessages:
    """Sends a flight: snapshots, thinned out, and events, whose channels are made at once.

    The cable is that of the snapshots where it is estimated, else it hangs in catenaries between
    the grips that hold it.
    """

    def __init__(self, plan: Plan, context: Context) -> None:
        self._plan, self._started = plan, np.nan
        self._messages = Messages(context, plan.mission, plan.vehicles)
        nothing = _nothing_known(plan.vehicles)
        self._messages.announce(
            mission_figures(nothing), vars(Clearances(np.nan, np.nan, np.nan, np.nan, "")),
            vehicle_figures(nothing, 0),
        )  # fmt: skip
        self._above = np.array([0.0, 0.0, plan.mission.vehicles.grip_offset])
        self._held, self._gripped = laid_grip_points(plan), np.zeros(plan.vehicles, dtype=bool)
        self._next = self._next_field = -np.inf

    def begin(self, started: float) -> None:
        """Set when the flight began, in seconds after 1970; the first call counts."""
        if np.isnan(self._started):
            self._started = started

    def event(self, event: Event) -> None:
        """Send an event."""
        self._messages.event(event, self._stamp(event.time))

    def snapshot(self, snapshot: Snapshot) -> None:
        """Send the team at a moment, unless another one was sent just before."""
        self._held, self._gripped = scene.follow_grips(self._held, self._gripped, snapshot)
        if snapshot.time < self._next:
            return
        self._next = snapshot.time + 0.99 * PERIOD
        stamp, messages = self._stamp(snapshot.time), self._messages
        if snapshot.time >= self._next_field:
            self._next_field = snapshot.time + FIELD_PERIOD
            messages.field(self._plan, stamp)
        centres = snapshot.position + self._above
        messages.frames(centres, stamp)
        self._send_scene(snapshot, centres, stamp)
        messages.mission(mission_figures(snapshot), stamp)
        if snapshot.clearances is not None:
            messages.margins(vars(snapshot.clearances), stamp)
        for k in range(self._plan.vehicles):
            messages.vehicle(k, vehicle_figures(snapshot, k), stamp)

    def _send_scene(self, snapshot: Snapshot, centres: Floats, stamp: int) -> None:
        lengths = self._plan.layout.lengths
        strands = scene.shown_strands(snapshot, self._held, self._gripped, lengths, CABLE_POINTS)
        tints = scene.tautness_colours(scene.tautness(self._held, lengths)) / 255.0
        allowed = scene.allowed_error(self._plan, snapshot.mission_time)
        states = [
            Color(r=r / 255.0, g=g / 255.0, b=b / 255.0, a=1.0)
            for r, g, b in map(
                scene.STATE_COLOURS.__getitem__, scene.vehicle_states(snapshot, allowed)
            )
        ]
        self._messages.scene(centres, strands, tints, stamp, states)

    def _stamp(self, seconds: float) -> int:
        return nanoseconds(self._started + seconds)


def _nothing_known(vehicles: int) -> Snapshot:
    """Return a snapshot with every figure that others may have."""
    unknown, words, flags = np.full((vehicles, 3), np.nan), vehicles * ("",), vehicles * (False,)
    return Snapshot(
        time=0.0, mission_time=0.0, rate=0.0, phase="", waiting_for=None, position=unknown,
        velocity=unknown, setpoint=unknown, modes=words, states=words, armed=flags, gripped=flags,
        battery=unknown[:, 0], link_age=unknown[:, 0], windows={"land": None, "release": None},
    )  # fmt: skip


def mission_figures(snapshot: Snapshot) -> dict[str, Any]:
    """Return the clock, what it waits for and who is missing, and how much time is left."""
    return {
        "mission_time": snapshot.mission_time,
        "phase": snapshot.phase,
        "rate": snapshot.rate,
        "gate": snapshot.waiting_for or "",
        "missing": ", ".join(map(str, snapshot.missing)),
        "hold": snapshot.held or "",
        "time_left": _or_unknown(snapshot.time_left),
        "remaining": _or_unknown(snapshot.remaining),
        "landing": _or_unknown(snapshot.landing),
        **{f"until_{name}": _or_unknown(seconds) for name, seconds in snapshot.windows.items()},
    }


def vehicle_figures(snapshot: Snapshot, k: int) -> dict[str, Any]:
    """Return the figures of a vehicle, counted from 0."""
    position, setpoint = snapshot.position[k], snapshot.setpoint[k]
    counted = ("battery", "voltage", "fix", "satellites", "position_age", "link_age")
    more = ("round_trip", "received", "lost")
    return {
        "position": position,
        "setpoint": setpoint,
        "velocity": snapshot.velocity[k],
        "tracking_error": float(np.linalg.norm(position - setpoint)),
        "mode": snapshot.modes[k],
        "state": snapshot.states[k],
        "problem": snapshot.problems[k] if snapshot.problems else "",
        "armed": bool(snapshot.armed[k]),
        "gripped": bool(snapshot.gripped[k]),
        **{name: _at(getattr(snapshot, name), k) for name in (*counted, *more)},
    }


def _or_unknown(value: float | None) -> float:
    return np.nan if value is None else value


def _at(values: Floats, k: int) -> float:
    return float(values[k]) if k < len(values) else np.nan


if __name__ == "__main__":
    main()
