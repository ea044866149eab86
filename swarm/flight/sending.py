"""From where everybody should be to the packets that say so."""

from typing import TYPE_CHECKING

import numpy as np

from swarm.flight.estimation import aimed
from swarm.flight.router import Outgoing

if TYPE_CHECKING:
    from swarm.flight.conductor import Conductor


def setpoints(flight: "Conductor") -> list[Outgoing]:
    """Return the setpoints of this moment for everybody who is streamed to."""
    if flight.frames is None or flight.stage not in {"fly", "leave"}:
        return []
    state = flight.guidance.wanted(flight.clock, flight.moving)
    flight.setpoint, flight.setpoint_velocity, _ = state
    if not np.count_nonzero(flight.streaming):
        return []
    # a setpoint stands until the next one comes: aim at the middle of its time
    lead = 0.5 / flight.fleet.rates.setpoint
    held = flight.carries and all(vehicle.gripped for vehicle in flight.flyers)
    pull = flight.pull.around(flight.clock.time) if held else flight.pull.nothing()
    frames = flight.frames.rotation, flight.frames.translation
    mass = flight.plan.mission.vehicles.mass
    going = state.position, state.velocity, state.acceleration
    states = np.empty((len(flight.systems), 3, 3))
    aimed(going, lead, flight.lift, mass, pull, frames, states)
    sending = flight.team.setpoints(
        flight.systems, flight.streaming, flight.now, states, flight.yaw
    )
    flight.setpoints_sent += len(sending)
    return sending
