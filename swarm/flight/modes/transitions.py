"""The only place where the stage of a flight changes."""

from swarm.flight.stages import Trigger, next_stage
from swarm.flight.state import FlightState, Mode


def change_stage(flight: FlightState, trigger: Trigger) -> None:
    """Go to the stage that the table of transitions has; ValueError where it has none."""
    flight.mode = Mode(next_stage(flight.stage, trigger), flight.now)
