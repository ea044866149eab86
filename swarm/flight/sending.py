"""From where everybody should be to the packets that say so."""

from typing import TYPE_CHECKING

import numpy as np

from swarm.flight.team import Outgoing

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
    aim = np.array(((1.0, lead, 0.5 * lead * lead), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)))
    states = np.dot(aim, np.array(state).reshape(3, -1)).reshape(3, -1, 3)
    states[0] += flight.lift
    if flight.carries and all(vehicle.gripped for vehicle in flight.flyers):
        states[2] -= flight.pull.at(flight.clock.time) / flight.plan.mission.vehicles.mass
    sending = flight.team.setpoints(
        flight.systems,
        flight.streaming,
        flight.now,
        flight.frames.to_vehicles(states.transpose(1, 0, 2)),
        flight.yaw,
    )
    flight.setpoints_sent += len(sending)
    return sending
