"""What a flight does in each of its stages, every tick."""

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Final

from swarm.flight.failure_detection import watch
from swarm.flight.failures import failure
from swarm.flight.gates import GATES
from swarm.flight.grip_slip import watch_grasps
from swarm.flight.measuring import look, measure
from swarm.flight.pace import advance_clock, bound_hold, steer
from swarm.flight.preparation import Prepared
from swarm.flight.readiness import readiness
from swarm.flight.rejoining import bring_back
from swarm.flight.result import Outcome
from swarm.flight.resuming import find, go_on
from swarm.flight.straying import watch_stray

if TYPE_CHECKING:
    from swarm.flight.conductor import Conductor

_NO_LONGER_READY = 5.0


def _prepare(flight: "Conductor") -> None:
    result = flight.preparation.tick(flight.now)
    if isinstance(result, Outcome):
        flight.finish_as(result.word, result.explanation)
    elif isinstance(result, Prepared):
        flight.fly_with(result.flyers)
        flight.frames, flight.yaw, flight.audit = result.frames, result.yaw, result.audit
        measure(flight)
        flight.start_position = flight.position.copy()
        flight.say("flight", "all vehicles are ready")
        flight.enter("ready")


def _find(flight: "Conductor") -> None:
    if flight.left_off is not None:
        find(flight, flight.left_off)


def _ready(flight: "Conductor") -> None:
    findings = readiness(flight.flyers, flight.fleet, flight.now)
    if not findings:
        flight.stage_since = flight.now
    elif flight.now - flight.stage_since > _NO_LONGER_READY:
        words = "\n".join(finding.message for finding in findings)
        flight.finish_as("failed", f"no longer ready:\n{words}")


def _fly(flight: "Conductor") -> None:
    watch(flight)
    bring_back(flight)
    go_on(flight)
    look(flight)
    watch_grasps(flight)
    watch_stray(flight)
    bound_hold(flight)
    if flight.stage != "fly":
        return
    if not flight.waiting:
        steer(flight)
        if advance_clock(flight):
            if flight.gate < len(flight.gates):
                _reach_gate(flight)
            else:
                flight.conclude()
    if flight.waiting:
        _wait_at_gate(flight)


def _reach_gate(flight: "Conductor") -> None:
    flight.waiting = True
    flight.gate_since = flight.now
    flight.clock.set_stopped()
    gate = flight.gates[flight.gate]
    who = "all inner vehicles" if gate.inner else "all"
    flight.say("gate", f"waiting until {who} are {gate.condition}")
    GATES[gate.condition].begin(flight, flight.now)


def _wait_at_gate(flight: "Conductor") -> None:
    gate = flight.gates[flight.gate]
    if flight.holds and gate.condition != "landed":
        flight.gate_since += flight.now - flight.last
    elif GATES[gate.condition].passed(flight, flight.now):
        flight.say("gate", f"all are {gate.condition}")
        flight.waiting = False
        flight.gate += 1
        flight.clock.set_running()
        if gate.condition == "landed":
            flight.conclude()
    elif flight.now - flight.gate_since > gate.timeout:
        failure(flight, "gate timed out", f"not all are {gate.condition} in {gate.timeout:g} s")


def _leave(flight: "Conductor") -> None:
    watch(flight)
    if flight.way_out is not None and flight.way_out.tick() and flight.stage == "leave":
        flight.conclude()


STAGES: Final[Mapping[str, Callable[["Conductor"], None]]] = {
    "prepare": _prepare,
    "ready": _ready,
    "find": _find,
    "fly": _fly,
    "leave": _leave,
    "finished": lambda _: None,
}
