"""What is compiled when it is first called is called before anybody flies.

A first call takes seconds on a new machine, and setpoints that stay away for half a second end a
flight. So a copy of the flight goes through all of it on the ground, with vehicles that are where
they should be, and is forgotten.
"""

from typing import TYPE_CHECKING

import numpy as np
from pymavlink.dialects.v20 import common

from swarm.flight.clone import branch
from swarm.mavlink.autopilots import PX4
from swarm.mavlink.frames import shared_frames
from swarm.mavlink.packets import CRC_EXTRAS, Decoder, Encoder
from swarm.mavlink.telemetry_table import packet_rows, read_datagrams
from swarm.mavlink.vehicle import Vehicle
from swarm.planning import Phase

if TYPE_CHECKING:
    from swarm.flight.conductor import Conductor
    from swarm.flight.contingency import Kind

_SECONDS = 3.0
"""For which each phase is flown: what looks rarely looks, and often enough to judge."""
_LEAN = 0.3
"""Radians by which one leans, now this way and now that: as much as where a gripper slips, for who
slips is only looked for where somebody is pulled hard."""
_WAYS: tuple["Kind", ...] = ("land", "release", "cut loose")


def lasting(flight: "Conductor") -> tuple[object, ...]:
    """Return what a flight never changes, and its copies share."""
    return (
        flight.flight_plan,
        flight.plan,
        flight.fleet,
        flight.windows,
        flight.separations,
        flight.stream_loss,
        flight.monitor,
        flight.gates,
    )


def warm_up(flight: "Conductor") -> None:
    """Have everything compiled that this flight may call, as one that has not begun."""
    _hear()
    for phase in flight.plan.phases:
        if phase.end > phase.start:
            _fly(branch(flight, lasting(flight)), phase)
    aloft = [phase for phase in flight.plan.phases if phase.cable == "aloft"]
    for way in _WAYS if aloft else ():
        _fly(branch(flight, lasting(flight)), aloft[0], way)


def _hear() -> None:
    """Hear a vehicle that is none, packet by packet and all at once."""
    said, vehicle = common.MAVLink_heartbeat_message(2, 12, 0, 0, 3, 3), Vehicle(1)
    data, known = Encoder(1, 1).encode(said), vehicle.telemetry
    for packet in Decoder().feed(data):
        vehicle.receive(packet, 0.0)
    origins = np.array([(len(data), vehicle.row, vehicle.system)])
    rows = packet_rows(data)
    read_datagrams(
        data, origins, CRC_EXTRAS, 0.0, known.values, known.sequences, known.missing, rows
    )


def _fly(spare: "Conductor", phase: Phase, way: "Kind | None" = None) -> None:
    """Fly some of a phase, and then out of the plan where a ``way`` is given."""
    spare.frames = shared_frames(len(spare.flyers), 0.0)
    spare.enter("fly")
    spare.clock.time = phase.start + 0.3 * (phase.end - phase.start)
    spare.gate = sum(gate.time <= spare.clock.time for gate in spare.gates)
    spare.clock.set_running()
    spare.streaming[:] = True
    spare.expect_armed()
    step = 1.0 / spare.fleet.rates.setpoint
    for tick in range(round(_SECONDS / step)):
        now = spare.now + step
        _be_there(spare, now, _LEAN if tick * step % 2.0 < 1.0 else -_LEAN)
        if way is not None and tick == 1:
            if way == "cut loose":
                spare.dead.add(0)
            spare.leave(way, "on the ground", move=True)
        spare.tick(now)
    spare.snapshot(spare.now)


def _be_there(spare: "Conductor", now: float, lean: float) -> None:
    """Have every vehicle say that it is where its setpoint is."""
    places = spare.guidance.wanted(spare.clock, spare.moving).position + spare.lift
    for k, (vehicle, (east, north, up)) in enumerate(
        zip(spare.flyers, places.tolist(), strict=True)
    ):
        vehicle.autopilot = vehicle.autopilot or PX4
        vehicle.custom_mode = vehicle.autopilot.custom_mode("offboard")
        vehicle.armed, vehicle.gripped = True, True
        vehicle.landed_state = int(common.MAV_LANDED_STATE_IN_AIR)
        vehicle.received_at = vehicle.heartbeat_at = vehicle.mode_at = vehicle.position_at = now
        vehicle.position, vehicle.velocity = (north, east, -up), (0.0, 0.0, 0.0)
        vehicle.attitude = (lean if k == 0 else 0.0, 0.0, 0.0)
        vehicle.height_difference = vehicle.vertical_accuracy = 0.1
    spare.start_position = np.where(
        np.isfinite(spare.start_position), spare.start_position, places * [1.0, 1.0, 0.0]
    )
