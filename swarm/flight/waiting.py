"""What a flight waits for, in words, and the seconds that are left."""

from collections.abc import Callable, Mapping
from typing import Final

from swarm.flight.readiness import readiness
from swarm.flight.stages import Stage, Step
from swarm.flight.state import FlightState
from swarm.flight.words import numbers
from swarm.mavlink.vehicle import Vehicle
from swarm.planning import Condition, Gate

GATE_WORDS: Final[Mapping[Condition, str]] = {
    "armed": "arm",
    "airborne": "be airborne",
    "gripped": "grip the cable",
    "settled": "come to rest at their setpoints",
    "released": "release the cable",
    "landed": "land and disarm",
}
"""What all vehicles have to do at a gate."""

STEP_WORDS: Final[Mapping[Step, str]] = {
    Step.APPROACH: "the clock to stop where all can come down",
    Step.RELEASE: "the grippers to open",
    Step.SEPARATE: "the vehicles to move apart",
    Step.DESCEND: "all vehicles to be down and disarmed",
}
"""What a team outside the plan waits for."""


def waiting_for(flight: FlightState) -> str | None:
    """Return what the mission clock waits for, for use after "waiting for"; None where it runs.

    A hold is not part of it.
    """
    if flight.stage is Stage.PREPARE:
        return _preparation(flight)
    if flight.stage is Stage.READY:
        return "the ground check and the go"
    if flight.contingency is not None and flight.stage is Stage.CONTINGENCY:
        return STEP_WORDS[flight.contingency.step]
    gate = flight.gate
    if flight.stage is not Stage.EXECUTE or not flight.progress.waiting or gate is None:
        return None
    who = "all inner vehicles" if gate.inner else "all vehicles"
    return f"{who} to {GATE_WORDS[gate.condition]} ({gate_name(flight, gate)})"


def gate_name(flight: FlightState, gate: Gate) -> str:
    """Return the name of a gate by the phase that begins behind it."""
    plan = flight.setup.plan
    if gate.time >= plan.duration - 1e-6:
        return "gate at the end"
    return f"gate before {plan.phase_at(gate.time + 1e-6).name}"


def _preparation(flight: FlightState) -> str:
    if not flight.preparation.all_received:
        silent = _of(flight, lambda vehicle: not flight.received(vehicle))
        return f"heartbeats of {silent}" if silent else "heartbeats of all vehicles"
    unready = _of(flight, lambda one: bool(readiness([one], flight.setup.fleet, flight.now)))
    return f"{unready} to be ready" if unready else "all vehicles to be ready"


def _of(flight: FlightState, condition: Callable[[Vehicle], bool]) -> str:
    which = [k for k, one in enumerate(flight.roster.vehicles, 1) if condition(one)]
    return f"vehicle{'s' if len(which) > 1 else ''} {numbers(which)}" if which else ""


def held(flight: FlightState) -> str | None:
    """Return why the team holds; None where it does not, or has left the plan."""
    return flight.holds.message if flight.stage is Stage.EXECUTE else None


def time_left(flight: FlightState) -> float | None:
    """Return the seconds until a wait ends by itself; None where nothing waits.

    After a hold all vehicles land together; after a gate's timeout the table of failures decides.
    """
    since = flight.detectors.hold_timeout.since
    if held(flight) is not None:
        held_for = 0.0 if since is None else flight.now - since
        return max(flight.setup.fleet.limits.hold - held_for, 0.0)
    gate = flight.gate
    if flight.stage is Stage.EXECUTE and flight.progress.waiting and gate is not None:
        return max(gate.timeout - (flight.now - flight.progress.gate_since), 0.0)
    return None


def remaining(flight: FlightState) -> float | None:
    """Return the seconds to the end of the plan at the clock's rate limits; None outside the plan.

    Time at gates, in holds and for vehicles that lag is not part of it.
    """
    if flight.stage is not Stage.EXECUTE:
        return None
    time = flight.clock.time
    return flight.setup.plan.duration - time + flight.stream_loss.delay_after(time)
