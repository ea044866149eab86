"""Taking vehicles that left offboard mode into the team again, when the operator agrees.

Such a vehicle is not streamed to until its setpoint is where it is; the team holds meanwhile.
"""

from typing import TYPE_CHECKING

from swarm.flight.gates import STREAM_BEFORE_OFFBOARD

if TYPE_CHECKING:
    from swarm.flight.conductor import Conductor

PATIENCE = 6.0
"""Seconds after which a vehicle that does not come back to offboard mode is left alone."""


def outside(flight: "Conductor") -> list[int]:
    """Return who flies without being streamed to and could be taken into the team again."""
    return [
        k
        for k, vehicle in enumerate(flight.flyers)
        if flight.expected_armed[k]
        and not flight.streaming[k]
        and vehicle.armed
        and flight.heard(vehicle)
        and not vehicle.in_manual_mode
        and k not in flight.dead
    ]


def rejoin(flight: "Conductor") -> None:
    """Stream to those outside again, from where each is; the team goes on holding."""
    flight.hold("operator", "vehicles rejoin")
    for k in outside(flight):
        flight.rejoining[k] = flight.now
        flight.stream(k)


def bring_back(flight: "Conductor") -> None:
    """Ask those who rejoin for offboard mode once they have a stream, and say when all are."""
    for k, since in list(flight.rejoining.items()):
        vehicle = flight.flyers[k]
        waited = flight.now - since
        if vehicle.in_mode("offboard"):
            del flight.rejoining[k]
            flight.say("rejoin", f"{flight.name(vehicle)} follows again", vehicle)
            for cause in [c for c in flight.holds if c.endswith(f" {vehicle.system}")]:
                del flight.holds[cause]
        elif waited > PATIENCE:
            del flight.rejoining[k]
            flight.streaming[k] = False
            flight.say("rejoin", f"{flight.name(vehicle)} does not rejoin", vehicle)
        elif waited > STREAM_BEFORE_OFFBOARD:
            vehicle.set_mode("offboard")
