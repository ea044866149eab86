"""From telemetry to the observation of this tick, and the frames in which it is expressed."""

import numpy as np
import numpy.typing as npt

from swarm.certification.monitor import LOOKAHEAD
from swarm.flight import estimation
from swarm.flight.estimation import Measured
from swarm.flight.failures import FailureKind
from swarm.flight.observation import Observation, Sample
from swarm.flight.preparation import Prepared
from swarm.flight.state import FlightState, Roster
from swarm.flight.swinging import INTERVAL, GripReports, lean

Floats = npt.NDArray[np.float64]

EXTRAPOLATION = 0.5
"""Seconds over which a position is extrapolated with its velocity."""
MONITOR_INTERVAL = 0.1
"""Seconds between the monitor's distances: vehicles approach by 0.4 m at twice the default speed,
and it looks 1.5 s ahead."""


def observe(flight: FlightState) -> None:
    """Express the vehicles' latest reports in mission ENU, at this moment."""
    roster, streams, timing = flight.roster, flight.streams, flight.timing
    measured = flight.observation.measured
    if flight.placement.frames is not None:
        n = len(roster.rows)
        measured = Measured(np.empty((3, n, 3)), np.empty((3, n)))
        silence = flight.setup.fleet.limits.silence
        commanded = streams.setpoint, streams.velocity, streams.active
        times = timing.now, EXTRAPOLATION, silence, timing.elapsed
        estimation.measure(
            flight.team.telemetry.values, roster.rows,
            (*flight.placement.frames.inverse, flight.setup.lift), commanded, times, measured,
        )  # fmt: skip
    flight.observation = Observation.of(
        timing.now, roster.names, flight.team.telemetry.values, roster.rows, measured
    )


def place_team(flight: FlightState, prepared: Prepared) -> None:
    """Take the vehicles, frames and audit of a team that stands ready on its pads."""
    flight.roster, placement = Roster.of(prepared.flyers), flight.placement
    placement.frames, placement.yaw, placement.audit = prepared.frames, prepared.yaw, prepared.audit
    observe(flight)
    placement.start_position = flight.observation.position.copy()


def shift_frame(flight: FlightState, k: int, jump: Floats, kind: FailureKind) -> None:
    """Move a vehicle's frame with its reported position, which jumped by (3,) metres.

    The vehicle did not move. Its setpoints then keep it where it is, and detectors compare in the
    new frame.
    """
    placement = flight.placement
    if placement.frames is None:
        return
    by = np.zeros((len(flight.roster.rows), 3))
    by[k] = -jump
    placement.frames = placement.frames.shifted(by)
    placement.moved |= {k}
    flight.observation = flight.observation.shifted(k, jump)
    flight.detectors.follow_frame(k, jump, kind)


def follow_swing(flight: FlightState) -> None:
    """Estimate the swing of the cable ten times a second, while it is aloft."""
    estimator, before = flight.setup.swing, flight.swing
    aloft = flight.phase.cable == "aloft" and flight.attached and not flight.setup.bare
    if estimator is None or not aloft or flight.placement.frames is None:
        flight.swing = None
        return
    if before is not None and flight.now - before.at < INTERVAL - 1e-6:
        return
    seen, streams = flight.observation, flight.streams
    if not np.isfinite(seen.position).all():
        return
    fresh = flight.now - seen.position_at <= EXTRAPOLATION
    turn, offset = flight.placement.frames.inverse[0], float(flight.setup.lift[2])
    reports = GripReports(
        now=flight.now,
        position=seen.position,
        velocity=np.where(fresh[:, None], seen.velocity, streams.velocity),
        lean=lean(seen.attitude, turn, offset),
        fresh=fresh,
    )
    flight.swing = estimator.follow(before, reports)


def monitor(flight: FlightState) -> None:
    """Update the live monitor with the positions now and a moment ahead, ten times a second."""
    options, seen = flight.setup.options, flight.observation
    if flight.now < flight.next_monitoring or options.open_loop:
        return
    if options.error_limit is not None:
        return
    if np.count_nonzero(np.isfinite(seen.position)) < seen.position.size:
        return
    flight.next_monitoring, phase = flight.now + MONITOR_INTERVAL, flight.phase
    flight.monitored = None
    if phase.cable == "floor" or flight.progress.waiting:
        return
    held = flight.attached and not flight.setup.bare
    cable = phase.cable if held else "free"
    moments = np.array((seen.position, seen.position + LOOKAHEAD * seen.velocity))
    strays = flight.swing.amplitude if flight.swing is not None else None
    flight.monitored = Sample(flight.setup.monitor, moments, cable, strays)
