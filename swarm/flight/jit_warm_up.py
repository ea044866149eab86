"""Compile every function that a flight may call, before the flight.

A first call lasts seconds on a new machine, and half a second without setpoints ends a flight. A
copy of the flight runs through its phases and contingencies on the ground, with vehicles at their
setpoints, and is discarded.
"""

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from pymavlink.dialects.v20 import common

from swarm.flight.clone import branch
from swarm.flight.modes.contingency import leave_the_plan, release_fallen
from swarm.flight.policy import Response
from swarm.flight.stages import Stage
from swarm.flight.state import FlightState, Mode
from swarm.flight.streams import expect_armed
from swarm.mavlink.autopilots import PX4
from swarm.mavlink.frames import shared_frames
from swarm.mavlink.packets import CRC_EXTRAS, Decoder, Encoder
from swarm.mavlink.telemetry_table import packet_rows, read_datagrams
from swarm.mavlink.vehicle import Vehicle
from swarm.planning import Phase

if TYPE_CHECKING:
    from swarm.flight.conductor import Conductor

_SECONDS = 3.0
"""Duration for which each phase is flown: detectors with long intervals run, often enough."""
_LEAN = 0.3
"""Radians by which one vehicle leans to alternating sides: patterns of a slip are computed only for
large residuals."""
_RESPONSES = (Response.LAND, Response.RELEASE, Response.RELEASE_FALLEN)


def lasting(flight: "Conductor") -> tuple[object, ...]:
    """Return the constants of a flight, which its copies share."""
    return flight.state.setup, flight.stream_loss


def warm_up(flight: "Conductor") -> None:
    """Compile all that this flight may call; the flight itself does not change."""
    _receive()
    for phase in flight.plan.phases:
        if phase.end > phase.start:
            _fly(branch(flight, lasting(flight)), phase)
    aloft = [phase for phase in flight.plan.phases if phase.cable == "aloft"]
    for response in _RESPONSES if aloft else ():
        _fly(branch(flight, lasting(flight)), aloft[0], response)


def _receive() -> None:
    """Receive packets of a fictitious vehicle, one by one and all at once."""
    said, vehicle = common.MAVLink_heartbeat_message(2, 12, 0, 0, 3, 3), Vehicle(1)
    data, known = Encoder(1, 1).encode(said), vehicle.telemetry
    for packet in Decoder().feed(data):
        vehicle.receive(packet, 0.0)
    origins = np.array([(len(data), vehicle.row, vehicle.system)])
    rows = packet_rows(data)
    read_datagrams(
        data, origins, CRC_EXTRAS, 0.0, known.values, known.sequences, known.missing, rows
    )


def _fly(spare: "Conductor", phase: Phase, response: Response | None = None) -> None:
    """Fly some of a phase, and then a contingency where a ``response`` is given."""
    flight = spare.state
    n = len(flight.roster.vehicles)
    flight.placement = replace(flight.placement, frames=shared_frames(n, 0.0))
    flight.mode = Mode(Stage.EXECUTE, flight.now)
    flight.clock.time = phase.start + 0.3 * (phase.end - phase.start)
    passed = sum(gate.time <= flight.clock.time for gate in flight.setup.gates)
    flight.progress = replace(flight.progress, gate=passed)
    flight.clock.set_running()
    flight.streams = replace(flight.streams, active=np.ones(n, dtype=np.bool_))
    expect_armed(flight)
    step = 1.0 / flight.setup.fleet.rates.setpoint
    for tick in range(round(_SECONDS / step)):
        now = flight.now + step
        _be_there(flight, now, _LEAN if tick * step % 2.0 < 1.0 else -_LEAN)
        if tick == 1 and response is Response.RELEASE_FALLEN:
            release_fallen(flight, 0, "on the ground")
        elif tick == 1 and response is not None:
            leave_the_plan(flight, response, "on the ground")
        spare.tick(now)
    spare.snapshot(flight.now)


def _be_there(flight: FlightState, now: float, lean: float) -> None:
    """Let every vehicle report the place of its setpoint."""
    state = flight.guidance.state(flight.clock, flight.timing.moving)
    places = state.position + flight.setup.lift
    for k, (vehicle, (east, north, up)) in enumerate(
        zip(flight.roster.vehicles, places.tolist(), strict=True)
    ):
        vehicle.autopilot = vehicle.autopilot or PX4
        vehicle.custom_mode = vehicle.autopilot.custom_mode("offboard")
        vehicle.armed, vehicle.gripped = True, True
        vehicle.landed_state = int(common.MAV_LANDED_STATE_IN_AIR)
        vehicle.received_at = vehicle.heartbeat_at = vehicle.mode_at = vehicle.position_at = now
        vehicle.position, vehicle.velocity = (north, east, -up), (0.0, 0.0, 0.0)
        vehicle.attitude = (lean if k == 0 else 0.0, 0.0, 0.0)
        vehicle.height_difference = vehicle.vertical_accuracy = 0.1
    start = flight.placement.start_position
    start = np.where(np.isfinite(start), start, places * [1.0, 1.0, 0.0])
    flight.placement = replace(flight.placement, start_position=start)
