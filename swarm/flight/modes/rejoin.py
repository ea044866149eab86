"""Return vehicles that left offboard mode to the team, when the operator agrees.

Setpoints to such a vehicle begin at its position; the team holds meanwhile. Without the operator's
consent, a team returns them only to move to where it can land.
"""

from swarm.flight.failures import OPERATOR
from swarm.flight.holds import end_vehicle, hold
from swarm.flight.state import FlightState
from swarm.flight.streams import begin_rejoining, end_rejoining, stop_stream

STREAM_BEFORE_OFFBOARD = 1.0
"""Seconds of setpoints before offboard mode is commanded (PX4 requires a stream first)."""
REJOIN_TIMEOUT = 6.0
"""Seconds after which a vehicle that does not return to offboard mode gets no more setpoints."""


def outside(flight: FlightState) -> list[int]:
    """Return the vehicles that fly without setpoints and could return to the team."""
    streams = flight.streams
    return [
        k
        for k, vehicle in enumerate(flight.roster.vehicles)
        if streams.expected_armed[k]
        and not streams.active[k]
        and vehicle.armed
        and flight.received(vehicle)
        and not vehicle.in_manual_mode
        and k not in streams.fallen
    ]


def rejoin(flight: FlightState) -> None:
    """Send setpoints to the vehicles outside again, from where each is; the team holds."""
    hold(flight, OPERATOR, "vehicles rejoin")
    for k in outside(flight):
        begin_rejoining(flight, k)


def continue_rejoining(flight: FlightState) -> None:
    """Command offboard mode once a stream has run long enough; report which have returned."""
    for k, since in flight.streams.rejoining.items():
        vehicle = flight.roster.vehicles[k]
        waited = flight.now - since
        if vehicle.in_mode("offboard"):
            end_rejoining(flight, k)
            flight.report("rejoin", f"{flight.name(vehicle)} follows again", vehicle)
            end_vehicle(flight, vehicle.system)
        elif waited > REJOIN_TIMEOUT:
            end_rejoining(flight, k)
            stop_stream(flight, k)
            flight.report("rejoin", f"{flight.name(vehicle)} does not rejoin", vehicle)
        elif waited > STREAM_BEFORE_OFFBOARD:
            vehicle.set_mode("offboard")
