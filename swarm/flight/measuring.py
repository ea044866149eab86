"""Where everybody is: what vehicles say, brought to this moment and into the mission's frame."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from swarm.certification.monitor import LOOKAHEAD, Clearances, Monitor
from swarm.flight import estimation
from swarm.planning import CableState

if TYPE_CHECKING:
    from swarm.flight.conductor import Conductor

Floats = npt.NDArray[np.float64]

FRESHEST = 0.5
"""Seconds over which a position is carried on with its velocity."""
TRACE_INTERVAL = 0.1
MONITOR_INTERVAL = 0.1
FRESH_IN_TRACE = 1.0


def measure(flight: "Conductor") -> None:
    """Bring what the vehicles say to this moment, in mission ENU, as grip points."""
    if flight.frames is None:
        return
    n = len(flight.rows)
    found = flight.measured = estimation.Measured(np.empty((3, n, 3)), np.empty((2, n)))
    times = flight.now, FRESHEST, flight.fleet.limits.silence, flight.now - flight.last
    estimation.measure(
        flight.team.telemetry.values, flight.rows, flight.frames.inverse, flight.lift,
        flight.setpoint, flight.setpoint_velocity, flight.streaming, times,
        found.places, found.numbers,
    )  # fmt: skip
    flight.position, flight.velocity, flight.error = found.position, found.velocity, found.error


def follow_jump(flight: "Conductor", k: int, jump: Floats) -> None:
    """Move a vehicle's frame with its position, which jumped by (3,) metres while it did not.

    Its setpoints then ask it to stay where it is, and not to fly the jump.
    """
    if flight.frames is None:
        return
    by = np.zeros((len(flight.flyers), 3))
    by[k] = -jump
    flight.frames = flight.frames.shifted(by)
    flight.measured.reported[k] -= jump
    flight.position[k] -= jump


@dataclass
class Sight:
    """Where everybody was when the clearances were looked at last, and where they were heading.

    ``moments`` (2, n, 3) are grip points, mission ENU. All distances are worked out for those who
    ask; the clock mostly needs to know no more than that the strands' are ample.
    """

    monitor: Monitor
    moments: Floats
    cable: CableState

    @cached_property
    def clearances(self) -> Clearances:
        """Distances now; the margin is the smaller of now and ahead."""
        here, ahead = self.monitor.clearances(self.moments, self.cable)
        return replace(here, margin=min(here.margin, ahead.margin))

    @cached_property
    def pace(self) -> float:
        """The rate at which the clock may run, 0…1."""
        return self.monitor.clock_rate(self.moments, self.cable)


def look(flight: "Conductor") -> None:
    """Look at the clearances, now and a moment ahead, ten times a second."""
    if flight.now < flight.next_look or flight.open_loop or flight.stray_limit is not None:
        return
    if np.count_nonzero(np.isfinite(flight.position)) < flight.position.size:
        return
    flight.next_look = flight.now + MONITOR_INTERVAL
    phase = flight.phase
    if phase.cable == "floor" or flight.waiting:
        flight.sight = None
        return
    held = any(v.gripped for v in flight.flyers) and not flight.bare
    cable = phase.cable if held else "free"
    moments = np.array((flight.position, flight.position + LOOKAHEAD * flight.velocity))
    flight.sight = Sight(flight.monitor, moments, cable)


def keep_trace(flight: "Conductor") -> None:
    """Add this moment to what was flown, ten times a second."""
    if flight.frames is None or flight.now < flight.next_trace:
        return
    flight.next_trace = flight.now + TRACE_INTERVAL
    phase = flight.phase.name if flight.stage == "fly" else ""
    position = flight.position.copy()
    position[flight.now - flight.measured.at > FRESH_IN_TRACE] = np.nan
    flight.flown.append((flight.now, flight.clock.time, position, flight.setpoint.copy(), phase))
