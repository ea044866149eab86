"""A flight in words and numbers, for displays and records."""

import numpy as np

from swarm.flight.operator import available
from swarm.flight.result import Statistics
from swarm.flight.snapshot import Snapshot
from swarm.flight.stages import Stage
from swarm.flight.state import FlightState
from swarm.flight.waiting import held, remaining, time_left, waiting_for
from swarm.mavlink.vehicle import Vehicle

TRACE_INTERVAL = 0.1
"""Seconds between recorded samples: at 2 m/s 0.2 m, which pages draw as a curve."""
FRESH_IN_TRACE = 1.0
"""Seconds after which a position is recorded as unknown: it would be drawn at rest."""


def record_sample(flight: FlightState) -> None:
    """Record the positions and setpoints of this moment, ten times a second."""
    recorder, seen = flight.recorder, flight.observation
    if flight.placement.frames is None or flight.now < recorder.next_sample:
        return
    recorder.next_sample = flight.now + TRACE_INTERVAL
    phase = flight.phase.name if flight.stage is Stage.EXECUTE else ""
    position = seen.position.copy()
    position[flight.now - seen.measured.at > FRESH_IN_TRACE] = np.nan
    setpoint = flight.streams.setpoint.copy()
    swing = flight.swing if flight.stage is Stage.EXECUTE else None
    stray = swing.stray if swing else np.full(len(flight.setup.plan.layout.lengths), np.nan)
    recorder.sample((flight.now, flight.clock.time), (position, setpoint), phase, stray)


def snapshot_of(flight: FlightState, now: float) -> Snapshot:
    """Return the flight at this moment."""
    vehicles, seen = flight.roster.vehicles, flight.observation
    swing = flight.swing if flight.stage is Stage.EXECUTE else None
    return Snapshot(
        time=now,
        mission_time=flight.clock.time,
        rate=flight.clock.rate,
        phase=flight.phase.name if flight.stage is Stage.EXECUTE else flight.stage.value,
        waiting_for=waiting_for(flight),
        position=seen.position.copy(),
        velocity=seen.velocity.copy(),
        setpoint=flight.streams.setpoint.copy(),
        modes=tuple(vehicle.mode for vehicle in vehicles),
        states=tuple(_state(flight, vehicle) for vehicle in vehicles),
        armed=tuple(vehicle.armed for vehicle in vehicles),
        gripped=tuple(vehicle.gripped for vehicle in vehicles),
        battery=np.array([vehicle.battery for vehicle in vehicles]),
        link_age=np.array([now - vehicle.received_at for vehicle in vehicles]),
        clearances=flight.clearances,
        available={name: (one.open, one.words) for name, one in available(flight).items()},
        round_trip=np.array([vehicle.latest_round_trip for vehicle in vehicles]),
        received=np.array([float(vehicle.packets) for vehicle in vehicles]),
        lost=np.array([float(vehicle.lost_packets) for vehicle in vehicles]),
        held=held(flight),
        time_left=time_left(flight),
        remaining=remaining(flight),
        stray=swing.stray if swing else None,
        cable=swing.states[1] if swing else None,
    )


def statistics_of(flight: FlightState) -> Statistics:
    """Return the statistics of a flight's links so far."""
    latencies = np.array([x for v in flight.roster.vehicles for x in v.commands.latencies])
    known = len(latencies) > 0
    return Statistics(
        duration=flight.now,
        setpoints=flight.streams.sent,
        command_latency=(float(np.median(latencies)), float(latencies.max())) if known else None,
        received={v.system: v.packets for v in flight.roster.vehicles},
        lost={v.system: v.lost_packets for v in flight.roster.vehicles},
        round_trip={v.system: v.round_trip for v in flight.roster.vehicles},
        rejected=_rejected(flight),
        gap=(flight.timing.gap, flight.timing.gap_at),
    )


def _rejected(flight: FlightState) -> dict[str, int]:
    by_signature = dict(flight.team.signing.dropped) if flight.team.signing else {}
    others = flight.team.rejected - sum(by_signature.values())
    return {**{str(kind): count for kind, count in by_signature.items()}, "stranger": others}


def _state(flight: FlightState, vehicle: Vehicle) -> str:
    if not flight.received(vehicle):
        return "silent"
    if not vehicle.armed:
        return "ready" if vehicle.ready else "waiting"
    return "on the ground" if vehicle.on_ground else "flying"
