"""Flying the plan, from the search for the vehicles on: the clock runs from gate to gate.

Before the flight all must be ready, and the operator gives clearance. A gate is begun once; its
condition is evaluated at every tick. :data:`GATES` has one row per condition: the actions that
begin at it, and what passes it.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from swarm.flight.ending import conclude, finish
from swarm.flight.failures import OPERATOR, Failure, FailureKind
from swarm.flight.holds import hold
from swarm.flight.modes.contingency import DISARM_AFTER, leave_the_plan
from swarm.flight.modes.rejoin import STREAM_BEFORE_OFFBOARD, continue_rejoining
from swarm.flight.modes.resume import follow_order
from swarm.flight.modes.transitions import change_stage
from swarm.flight.observing import place_team
from swarm.flight.pace import advance_clock, steer_clock
from swarm.flight.policy import Response
from swarm.flight.preparation import Prepared
from swarm.flight.progress import (
    all_ready,
    begin_waiting,
    extend_gate,
    first_time,
    not_settled,
    pass_gate,
)
from swarm.flight.readiness import readiness
from swarm.flight.responding import respond
from swarm.flight.result import Outcome
from swarm.flight.stages import Stage, Trigger
from swarm.flight.state import FlightState
from swarm.flight.streams import expect_armed, start_stream, stop_streams_of_landing
from swarm.mavlink.vehicle import Vehicle
from swarm.planning import Condition

Flags = npt.NDArray[np.bool_]

STREAM_AFTER_TAKEOFF = 0.8
"""Share of the take-off height from which a vehicle that takes off by itself gets setpoints."""
TAKEOFF_HEIGHT = 1.0
"""Metres to which a vehicle takes off by itself (ArduPilot): less than the plan's first 2 m."""
AIRBORNE_HEIGHT = 0.3
"""Metres of every grip point above which a team is airborne: more than heights err on pads."""
SETTLED_FOR, SETTLED_SPEED = 1.0, 0.3
"""Seconds for which all must be slower than this, m/s: one that oscillates is faster meanwhile."""


class GateHandlers(NamedTuple):
    """The action that begins at a gate, and the condition that passes it."""

    begin: Callable[[FlightState], None]
    passed: Callable[[FlightState], bool]


def _no_action(_flight: FlightState) -> None:
    pass


def _waited(flight: FlightState) -> float:
    return flight.now - flight.progress.gate_since


def _open_grippers(flight: FlightState) -> None:
    """Open all grippers: PX4 closes its own as it starts, and would acknowledge a grip at once."""
    if flight.setup.commands_grippers:
        for vehicle in flight.roster.vehicles:
            vehicle.grip(closed=False)


def _armed(flight: FlightState) -> bool:
    """Bring all vehicles into offboard mode, then arm, then take off where that is necessary.

    Each step is complete for all before the next one begins, so that no vehicle waits armed for
    longer than its disarm timer allows (PX4: COM_DISARM_PRFLT, 10 s from arming). Vehicles that
    take off by themselves are armed first: the others wait on the ground meanwhile.
    """
    vehicles = flight.roster.vehicles
    for k, vehicle in enumerate(vehicles):
        if not vehicle.needs_takeoff_command:
            start_stream(flight, k)
    opening = any(vehicle.commands.contains("release") for vehicle in vehicles)
    if opening or _waited(flight) < STREAM_BEFORE_OFFBOARD:
        return False
    waiting = [vehicle for vehicle in vehicles if not vehicle.in_mode("offboard")]
    if waiting and not any(vehicle.armed for vehicle in vehicles):
        for vehicle in waiting:
            vehicle.set_mode("offboard")
        return False
    unarmed = [vehicle for vehicle in vehicles if not vehicle.armed]
    if unarmed:
        for vehicle in [one for one in unarmed if one.needs_takeoff_command] or unarmed:
            vehicle.arm()
        return False
    expect_armed(flight)
    return _taken_off(flight)


def _taken_off(flight: FlightState) -> bool:
    """Command take-off where it is necessary; return whether all vehicles get setpoints."""
    all_streamed = True
    for k, vehicle in enumerate(flight.roster.vehicles):
        if not vehicle.needs_takeoff_command or flight.streams.active[k]:
            continue
        start = flight.placement.start_position[k, 2]
        height = float(flight.observation.position[k, 2] - start)
        if height >= STREAM_AFTER_TAKEOFF * TAKEOFF_HEIGHT:
            start_stream(flight, k)
            continue
        all_streamed = False
        if first_time(flight, k, "takeoff"):
            vehicle.take_off(TAKEOFF_HEIGHT)
    return all_streamed


def airborne(flight: FlightState) -> Flags:
    """Return which vehicles (n,) are airborne."""
    reported = [v.airborne or v.landed_state == 0 for v in flight.roster.vehicles]
    both: Flags = (flight.observation.position[:, 2] > AIRBORNE_HEIGHT) & np.array(reported)
    return both


def _airborne(flight: FlightState) -> bool:
    return bool(airborne(flight).all())


def _gripped(flight: FlightState) -> bool:
    """Close the grippers one after the other, in order along the cable."""
    for vehicle in flight.roster.vehicles:
        if vehicle.gripped:
            continue
        if flight.setup.commands_grippers:
            if vehicle.commands.idle:
                vehicle.grip(closed=True)
            return False
        vehicle.gripped = True
    return True


def releasing(flight: FlightState) -> Sequence[Vehicle]:
    """Return the vehicles that release at this gate: all, or all but those at the cable's ends."""
    vehicles, gate = flight.roster.vehicles, flight.gate
    return vehicles[1:-1] if gate is not None and gate.inner else vehicles


def _release(flight: FlightState) -> None:
    for vehicle in releasing(flight):
        if flight.setup.commands_grippers:
            vehicle.grip(closed=False)
        else:
            vehicle.gripped = False


def _released(flight: FlightState) -> bool:
    return not any(vehicle.gripped for vehicle in releasing(flight))


def at_rest(flight: FlightState) -> Flags:
    """Return which vehicles (n,) are at rest at their setpoints."""
    seen = flight.observation
    near: Flags = seen.error <= max(flight.allowed_error, 1e-9)
    slow: Flags = np.linalg.norm(seen.velocity, axis=1) <= SETTLED_SPEED
    return near & slow


def _settled(flight: FlightState) -> bool:
    if not at_rest(flight).all():
        not_settled(flight)
    if flight.now - flight.progress.settled_since < SETTLED_FOR:
        return False
    time = flight.setup.gates[flight.progress.gate].time
    before_fold = flight.setup.plan.phase_at(time + 1e-6).name == "fold"
    return _level(flight) if before_fold and first_time(flight, 0, "heights") else True


def _level(flight: FlightState) -> bool:
    """Compare heights on the levelled line before the fold: heights decide which strand is above.

    Reported heights are compared with each other, and each with its GPS since the vehicle stood on
    the ground, within the receivers' accuracy. Where they disagree, the operator must decide.
    """
    seen = flight.observation
    heights = seen.position[:, 2] - flight.streams.setpoint[:, 2]
    words = f"levelled line: reported heights differ by up to {np.ptp(heights):.2f} m"
    drift = seen.height_gap - flight.detectors.heights.reference
    known = np.isfinite(drift)
    if known.sum() < 3:
        flight.report("heights", f"{words}; no GPS heights to compare")
        return True
    off = drift - np.median(drift[known])
    accuracy = seen.height_accuracy
    allowed = np.fmax(2.0 * accuracy, flight.setup.plan.mission.vehicles.tracking)
    worst = int(np.nanargmax(np.abs(off)))
    flight.report("heights", f"{words}; against GPS by up to {abs(off[worst]):.2f} m")
    wrong = np.flatnonzero(known & np.isfinite(accuracy) & (np.abs(off) > allowed))
    if not len(wrong):
        return True
    names = ", ".join(
        f"{seen.names[k]} by {off[k]:+.2f} m (accuracy {accuracy[k]:.2f} m)" for k in wrong.tolist()
    )
    hold(flight, OPERATOR, f"heights disagree with GPS before the fold: {names}")
    return False


def _land(flight: FlightState) -> None:
    for vehicle in flight.roster.vehicles:
        vehicle.set_mode("land")


def _landed(flight: FlightState) -> bool:
    stop_streams_of_landing(flight)
    for vehicle in flight.roster.vehicles:
        if vehicle.armed and vehicle.on_ground and _waited(flight) > DISARM_AFTER:
            vehicle.disarm()
    return not any(vehicle.armed for vehicle in flight.roster.vehicles)


GATES: Mapping[Condition, GateHandlers] = {
    "armed": GateHandlers(_open_grippers, _armed),
    "airborne": GateHandlers(_no_action, _airborne),
    "gripped": GateHandlers(_no_action, _gripped),
    "settled": GateHandlers(not_settled, _settled),
    "released": GateHandlers(_release, _released),
    "landed": GateHandlers(_land, _landed),
}


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
