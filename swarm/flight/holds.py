"""Holds of the mission clock, each with a typed cause."""

from collections.abc import Iterable
from dataclasses import replace

from swarm.flight.failures import OPERATOR, FailureKind, HoldCause
from swarm.flight.state import FlightState


def hold(flight: FlightState, cause: HoldCause, message: str) -> None:
    """Hold the clock until the cause has ended; a second hold of the same cause changes nothing."""
    causes = flight.holds.causes
    if cause not in causes:
        flight.holds = replace(flight.holds, causes={**causes, cause: message})
        flight.report("hold", f"holding: {message}")


def end_operator_hold(flight: FlightState) -> None:
    """End the operator's hold."""
    _end(flight, [OPERATOR])


def end_failures(flight: FlightState, kinds: Iterable[FailureKind], system: int | None) -> None:
    """End the holds by failures of these kinds, of a vehicle and of the team."""
    _end(flight, [HoldCause(kind, of) for kind in kinds for of in (system, None)])


def end_vehicle(flight: FlightState, system: int) -> None:
    """End every hold by a failure of a vehicle."""
    _end(flight, [cause for cause in flight.holds.causes if cause.system == system])


def _end(flight: FlightState, ended: Iterable[HoldCause]) -> None:
    gone = set(ended)
    causes = flight.holds.causes
    if not gone.isdisjoint(causes):
        left = {cause: message for cause, message in causes.items() if cause not in gone}
        flight.holds = replace(flight.holds, causes=left)
