"""Flying the plan: the mission clock runs from gate to gate."""

from swarm.flight.ending import conclude
from swarm.flight.failures import Failure, FailureKind
from swarm.flight.modes.contingency import leave_the_plan
from swarm.flight.modes.gates import GATES
from swarm.flight.modes.rejoin import continue_rejoining
from swarm.flight.modes.resume import follow_order
from swarm.flight.pace import advance_clock, steer_clock
from swarm.flight.policy import Response
from swarm.flight.progress import begin_waiting, extend_gate, pass_gate
from swarm.flight.responding import respond
from swarm.flight.stages import Stage
from swarm.flight.state import FlightState


def tick(flight: FlightState) -> None:
    """Advance the clock, or wait at a gate."""
    continue_rejoining(flight)
    follow_order(flight)
    _land_when_interrupted(flight)
    if flight.stage is not Stage.EXECUTE:
        return
    if not flight.progress.waiting:
        steer_clock(flight)
        if advance_clock(flight):
            if flight.gate is not None:
                _reach_gate(flight)
            else:
                conclude(flight)
    if flight.progress.waiting:
        _wait_at_gate(flight)


def _land_when_interrupted(flight: FlightState) -> None:
    """Land together once the operator's interruption has brought the clock to rest."""
    since = flight.detectors.hold_timeout.since
    held = bool(flight.holds.causes) and since is not None and since < flight.now
    if held and flight.ending.interrupted and flight.clock.stopped:
        leave_the_plan(flight, Response.LAND, "interrupted")


def _reach_gate(flight: FlightState) -> None:
    gate = flight.setup.gates[flight.progress.gate]
    begin_waiting(flight)
    flight.clock.set_stopped()
    who = "all inner vehicles" if gate.inner else "all"
    flight.report("gate", f"waiting until {who} are {gate.condition}")
    GATES[gate.condition].begin(flight)


def _wait_at_gate(flight: FlightState) -> None:
    gate = flight.setup.gates[flight.progress.gate]
    if flight.holds.causes and gate.condition != "landed":
        extend_gate(flight)
    elif GATES[gate.condition].passed(flight):
        flight.report("gate", f"all are {gate.condition}")
        pass_gate(flight)
        flight.clock.set_running()
        if gate.condition == "landed":
            conclude(flight)
    elif flight.now - flight.progress.gate_since > gate.timeout:
        words = f"not all are {gate.condition} in {gate.timeout:g} s"
        respond(flight, Failure(FailureKind.GATE_TIMEOUT, words))
