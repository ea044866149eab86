"""The progress of a flight through its plan: gates, and the way back."""

from dataclasses import replace

from swarm.flight.state import FlightState


def begin_waiting(flight: FlightState) -> None:
    """Let the clock wait at the next gate from now on."""
    flight.progress = replace(flight.progress, waiting=True, gate_since=flight.now)


def pass_gate(flight: FlightState) -> None:
    """Go on after the gate at which the clock waits."""
    flight.progress = replace(flight.progress, waiting=False, gate=flight.progress.gate + 1)


def extend_gate(flight: FlightState) -> None:
    """Exclude the last tick from the time for which the clock has waited at its gate."""
    since = flight.progress.gate_since + flight.timing.elapsed
    flight.progress = replace(flight.progress, gate_since=since)


def begin_search(flight: FlightState) -> None:
    """Begin to search a team that flies already."""
    flight.progress = replace(flight.progress, gate_since=flight.now)


def resume_at(flight: FlightState, gate: int) -> None:
    """Go on with a plan of which so many gates have been passed."""
    flight.progress = replace(flight.progress, gate=gate)


def leave_plan(flight: FlightState) -> None:
    """End waiting and rewinding: the plan is flown no further."""
    flight.progress = replace(flight.progress, waiting=False, rewinding=False)


def not_settled(flight: FlightState) -> None:
    """Begin anew to measure for how long the team has been at rest."""
    flight.progress = replace(flight.progress, settled_since=flight.now)


def all_ready(flight: FlightState) -> None:
    """Note that all vehicles are ready now."""
    flight.progress = replace(flight.progress, ready_at=flight.now)


def set_rewinding(flight: FlightState, *, rewinding: bool) -> None:
    """Let the clock run backwards, or no longer."""
    flight.progress = replace(flight.progress, rewinding=rewinding)


def error_too_large(flight: FlightState) -> None:
    """Note that tracking errors are too large at this mission time to come back to it."""
    flight.progress = replace(flight.progress, error_kept_since=flight.clock.time)


def first_time(flight: FlightState, k: int, action: str) -> bool:
    """Return whether a vehicle's action is new at this gate, and note it."""
    key = (flight.progress.gate, k, action)
    first = key not in flight.progress.done
    if first:
        flight.progress = replace(flight.progress, done=flight.progress.done | {key})
    return first
