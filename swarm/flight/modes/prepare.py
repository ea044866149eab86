"""Before the flight: find the vehicles, wait until all are ready, wait for clearance."""

from swarm.flight.ending import finish
from swarm.flight.modes.transitions import change_stage
from swarm.flight.observing import place_team
from swarm.flight.preparation import Prepared
from swarm.flight.progress import all_ready
from swarm.flight.readiness import readiness
from swarm.flight.result import Outcome
from swarm.flight.stages import Trigger
from swarm.flight.state import FlightState

NOT_READY_TIMEOUT = 5.0
"""Seconds after which a team that is no longer ready ends the flight."""


def prepare(flight: FlightState) -> None:
    """Prepare the vehicles until all are ready."""
    result = flight.preparation.tick(flight.now, flight.timing.real)
    if isinstance(result, Outcome):
        finish(flight, result.word, result.explanation)
    elif isinstance(result, Prepared):
        place_team(flight, result)
        flight.report("flight", "all vehicles are ready")
        change_stage(flight, Trigger.TEAM_READY)
        all_ready(flight)


def wait_for_clearance(flight: FlightState) -> None:
    """Watch that the vehicles stay ready."""
    findings = readiness(flight.roster.vehicles, flight.setup.fleet, flight.now)
    if not findings:
        all_ready(flight)
    elif flight.now - flight.progress.ready_at > NOT_READY_TIMEOUT:
        words = "\n".join(finding.message for finding in findings)
        finish(flight, "failed", f"no longer ready:\n{words}")
