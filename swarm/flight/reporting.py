"""What a flight looks like, in words and numbers, for those who watch it."""

from typing import TYPE_CHECKING

import numpy as np

from swarm.flight.operator import available
from swarm.flight.result import Statistics
from swarm.flight.snapshot import Snapshot
from swarm.flight.trace import Trace
from swarm.mavlink.vehicle import Vehicle

if TYPE_CHECKING:
    from swarm.flight.conductor import Conductor


def snapshot_of(flight: "Conductor", now: float) -> Snapshot:
    """Return what a flight looks like at this moment."""
    flyers = flight.flyers
    return Snapshot(
        time=now,
        mission_time=flight.clock.time,
        rate=flight.clock.rate,
        phase=flight.phase.name if flight.stage == "fly" else flight.stage,
        waiting_for=_waiting_for(flight),
        position=flight.position.copy(),
        velocity=flight.velocity.copy(),
        setpoint=flight.setpoint.copy(),
        modes=tuple(vehicle.mode for vehicle in flyers),
        states=tuple(_state(flight, vehicle) for vehicle in flyers),
        armed=tuple(vehicle.armed for vehicle in flyers),
        gripped=tuple(vehicle.gripped for vehicle in flyers),
        battery=np.array([vehicle.battery for vehicle in flyers]),
        link_age=np.array([now - vehicle.received_at for vehicle in flyers]),
        clearances=flight.clearances,
        available={name: (wish.open, wish.words) for name, wish in available(flight).items()},
        round_trip=np.array([vehicle.latest_round_trip for vehicle in flyers]),
        received=np.array([float(vehicle.packets) for vehicle in flyers]),
        lost=np.array([float(vehicle.lost_packets) for vehicle in flyers]),
    )


def statistics_of(flight: "Conductor") -> Statistics:
    """Return what a flight's links did so far."""
    latencies = np.array([x for v in flight.flyers for x in v.commands.latencies])
    known = len(latencies) > 0
    return Statistics(
        duration=flight.now,
        setpoints=flight.setpoints_sent,
        command_latency=(float(np.median(latencies)), float(latencies.max())) if known else None,
        received={v.system: v.packets for v in flight.flyers},
        lost={v.system: v.lost_packets for v in flight.flyers},
        round_trip={v.system: v.round_trip for v in flight.flyers},
        rejected=_rejected(flight),
    )


def trace_of(flight: "Conductor") -> Trace:
    """Return what was flown so far."""
    n = flight.plan.vehicles
    return Trace(
        time=np.array([row[0] for row in flight.flown]),
        mission_time=np.array([row[1] for row in flight.flown]),
        position=np.array([row[2] for row in flight.flown]).reshape(-1, n, 3),
        setpoint=np.array([row[3] for row in flight.flown]).reshape(-1, n, 3),
        phase=tuple(row[4] for row in flight.flown),
    )


def _rejected(flight: "Conductor") -> dict[str, int]:
    by_signature = dict(flight.team.signing.dropped) if flight.team.signing else {}
    others = flight.team.rejected - sum(by_signature.values())
    return {**{str(kind): count for kind, count in by_signature.items()}, "stranger": others}


def _waiting_for(flight: "Conductor") -> str | None:
    if flight.stage == "prepare":
        return "readiness" if flight.preparation.everybody_heard else "heartbeats"
    if flight.stage == "ready":
        return "go"
    if flight.stage == "fly" and flight.waiting and not flight.holds:
        return flight.gates[flight.gate].condition
    return flight.holding


def _state(flight: "Conductor", vehicle: Vehicle) -> str:
    if not flight.heard(vehicle):
        return "silent"
    if not vehicle.armed:
        return "ready" if vehicle.ready else "waiting"
    return "on the ground" if vehicle.on_ground else "flying"
