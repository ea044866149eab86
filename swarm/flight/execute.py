"""Flying the plan, from the search for the vehicles on: the clock runs from gate to gate.

Before the flight all must be ready, and the operator gives clearance; a team whose ground station
ended is found in the air, and the flight goes on from there. A gate is begun once; its condition is
evaluated at every tick. :data:`GATES` has one row per condition: the actions that begin at it, and
what passes it.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from swarm.flight.contingency import DISARM_AFTER, leave_the_plan
from swarm.flight.failures import OPERATOR, Failure, FailureKind, Response
from swarm.flight.observing import place_team
from swarm.flight.pace import advance_clock, steer_clock
from swarm.flight.preparation import Prepared, readiness, request_streams
from swarm.flight.responding import request, respond
from swarm.flight.result import Outcome
from swarm.flight.stages import Stage, Trigger
from swarm.flight.state import FlightState, Found
from swarm.flight.streams import STREAM_BEFORE_OFFBOARD, continue_rejoining, rejoin
from swarm.flight.tlog import LeftOff
from swarm.mavlink.vehicle import Vehicle
from swarm.planning import Condition
from swarm.planning.assembly import begins_aloft

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
            flight.start_stream(k)
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
        for vehicle in [vehicle for vehicle in unarmed if vehicle.needs_takeoff_command] or unarmed:
            vehicle.arm()
        return False
    flight.streams.expect_armed()
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
            flight.start_stream(k)
            continue
        all_streamed = False
        if flight.progress.first_time(k, "takeoff"):
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
    """Close all grippers, each as soon as its vehicle has no command under way."""
    for vehicle in flight.roster.vehicles:
        if not flight.setup.commands_grippers:
            vehicle.gripped = True
        elif not vehicle.gripped and vehicle.commands.idle:
            vehicle.grip(closed=True)
    return all(vehicle.gripped for vehicle in flight.roster.vehicles)


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
    return near & _slow(flight)


def _slow(flight: FlightState) -> Flags:
    slow: Flags = np.linalg.norm(flight.observation.velocity, axis=1) <= SETTLED_SPEED
    return slow


def _begin_settling(flight: FlightState) -> None:
    flight.progress.settled_since = flight.now


def _settled(flight: FlightState) -> bool:
    if not at_rest(flight).all():
        flight.progress.settled_since = flight.now
    if flight.now - flight.progress.settled_since < SETTLED_FOR:
        return False
    time = flight.setup.gates[flight.progress.gate].time
    before_fold = flight.setup.plan.phase_at(time + 1e-6).name == "fold"
    return _level(flight) if before_fold and flight.progress.first_time(0, "heights") else True


def _level(flight: FlightState) -> bool:
    """Compare heights on the levelled line before the fold: heights decide which strand is above.

    Reported heights are compared with each other, and each with its GPS since the vehicle stood on
    the ground, within the receivers' accuracy. Where they disagree, the operator must decide.
    """
    seen = flight.observation
    heights = seen.position[:, 2] - flight.streams.setpoint[:, 2]
    words = f"levelled line: reported heights differ by up to {np.ptp(heights):.2f} m"
    drift = seen.height_difference - flight.detectors.heights.reference
    known = np.isfinite(drift)
    if known.sum() < 3:
        flight.report("heights", f"{words}; no GPS heights to compare")
        return True
    off = drift - np.median(drift[known])
    accuracy = seen.vertical_accuracy
    allowed = np.fmax(2.0 * accuracy, flight.setup.plan.mission.vehicles.tracking)
    worst = int(np.nanargmax(np.abs(off)))
    flight.report("heights", f"{words}; against GPS by up to {abs(off[worst]):.2f} m")
    wrong = np.flatnonzero(known & np.isfinite(accuracy) & (np.abs(off) > allowed))
    if not len(wrong):
        return True
    names = ", ".join(
        f"{seen.names[k]} by {off[k]:+.2f} m (accuracy {accuracy[k]:.2f} m)" for k in wrong.tolist()
    )
    flight.hold(OPERATOR, f"heights disagree with GPS before the fold: {names}")
    return False


def _land(flight: FlightState) -> None:
    for vehicle in flight.roster.vehicles:
        vehicle.set_mode("land")


def _landed(flight: FlightState) -> bool:
    flight.stop_streams_of_landing()
    for vehicle in flight.roster.vehicles:
        if vehicle.armed and vehicle.on_ground and _waited(flight) > DISARM_AFTER:
            vehicle.disarm()
    return not any(vehicle.armed for vehicle in flight.roster.vehicles)


GATES: Mapping[Condition, GateHandlers] = {
    "armed": GateHandlers(_open_grippers, _armed),
    "airborne": GateHandlers(_no_action, _airborne),
    "gripped": GateHandlers(_no_action, _gripped),
    "settled": GateHandlers(_begin_settling, _settled),
    "released": GateHandlers(_release, _released),
    "landed": GateHandlers(_land, _landed),
}


NOT_READY_TIMEOUT = 5.0
"""Seconds after which a team that is no longer ready ends the flight."""


def prepare(flight: FlightState) -> None:
    """Prepare the vehicles until all are ready."""
    result = flight.preparation.tick(flight.now, flight.timing.real)
    if isinstance(result, Outcome):
        flight.finish(result.word, result.explanation)
    elif isinstance(result, Prepared):
        place_team(flight, result)
        flight.report("flight", "all vehicles are ready")
        flight.change_stage(Trigger.TEAM_READY)
        flight.progress.ready_at = flight.now


def wait_for_clearance(flight: FlightState) -> None:
    """Watch that the vehicles stay ready."""
    findings = readiness(flight.roster.vehicles, flight.setup.fleet, flight.now)
    if not findings:
        flight.progress.ready_at = flight.now
    elif flight.now - flight.progress.ready_at > NOT_READY_TIMEOUT:
        words = "\n".join(finding.message for finding in findings)
        flight.finish("failed", f"no longer ready:\n{words}")


LARGEST = 1.0
"""Metres between a vehicle and its place in the plan up to which the team goes on with it."""
FRESH = 0.5
"""Seconds: oldest report from which a vehicle's place is compared; it moves 1 m at 2 m/s."""
AROUND = 4.0
"""Seconds of mission time around the last recorded one in which the team is searched: it flew on
without setpoints."""
_STEP = 0.05
"""Seconds between compared moments of the plan: 0.1 m at the default speed limit of 2 m/s."""


def find_team(flight: FlightState) -> None:
    """Search the team; once all vehicles are received, go on where they are, and hold.

    A team that is only searched is found once it rests: :attr:`.Resumption.found`.
    """
    ending = flight.resumption.left_off
    if ending is None:
        raise ValueError("this flight was not interrupted")
    if flight.progress.first_time(-1, "search"):
        flight.progress.gate_since = flight.progress.settled_since = flight.now
    for k, vehicle in enumerate(flight.roster.vehicles):
        if flight.received(vehicle) and flight.progress.first_time(k, "streams"):
            request_streams(vehicle, flight.setup.fleet)
    if missing := _missing(flight):
        if flight.now - flight.progress.gate_since > flight.setup.fleet.limits.hold:
            flight.finish(
                "failed", f"not found: {flight.names(missing)}; each vehicle lands by its failsafe"
            )
        return
    if disarmed := [vehicle for vehicle in flight.roster.vehicles if not vehicle.armed]:
        names = flight.names(disarmed)
        flight.finish("failed", f"no longer flying: {names}; the others land by their failsafes")
        return
    found = _place_in_plan(flight, ending)
    landing = any(vehicle.in_mode("land") for vehicle in flight.roster.vehicles)
    if flight.resumption.then is None:
        if landing or not _slow(flight).all():
            flight.progress.settled_since = flight.now
        if flight.now - flight.progress.settled_since >= SETTLED_FOR:
            flight.resumption.found = found
        return
    _go_on(flight, ending, found.time)
    off, plan = found.off, flight.setup.plan
    words = f"found the team at {found.time:.1f} s of the plan, up to {off:.2f} m from it"
    flight.report("resume", words)
    if begins_aloft(plan) and off > plan.mission.vehicles.tracking:
        flight.report("resume", "it has moved since that was planned: it holds once it is there")
        flight.resumption.then = "hold"
    if landing or off > LARGEST:
        why = "vehicles already land" if landing else f"a vehicle is {off:.1f} m from its place"
        words = f"the flight cannot be resumed: {why}"
        leave_the_plan(flight, Response.LAND_HERE, words)
        return
    flight.hold(OPERATOR, "the flight is resumed")
    rejoin(flight)


def follow_order(flight: FlightState) -> None:
    """Do what the operator ordered in advance, once all vehicles follow again."""
    then, streams = flight.resumption.then, flight.streams
    if then is None or then == "hold" or streams.rejoining or not streams.active.all():
        return
    flight.resumption.then = "hold"
    request(flight, "resume" if then == "continue" else then)


def _missing(flight: FlightState) -> list[Vehicle]:
    return [
        vehicle
        for vehicle in flight.roster.vehicles
        if not (flight.received(vehicle, FRESH) and flight.now - vehicle.position_at < FRESH)
        or vehicle.autopilot is None
    ]


def _go_on(flight: FlightState, ending: LeftOff, time: float) -> None:
    """Continue the plan at a mission time, at rest; no vehicle gets setpoints yet."""
    flight.clock.time = time
    flight.clock.set_stopped()
    flight.progress.gate = ending.gate
    flight.streams.expect_armed()
    for vehicle in flight.roster.vehicles:
        vehicle.gripped = ending.gripped
        vehicle.take_events()
    flight.change_stage(Trigger.TEAM_FOUND)


def _place_in_plan(flight: FlightState, ending: LeftOff) -> Found:
    """Return where the team is, by the mission time around the last one that fits best."""
    gates, plan = flight.setup.gates, flight.setup.plan
    low = gates[ending.gate - 1].time if ending.gate else 0.0
    high = gates[ending.gate].time if ending.gate < len(gates) else plan.duration
    times = np.arange(
        max(low, ending.mission_time - AROUND), min(high, ending.mission_time + AROUND), _STEP
    )
    if not len(times):
        times = np.array([ending.mission_time])
    apart = plan.motion.at(times)[0] - flight.observation.position
    off = np.linalg.norm(apart, axis=2).max(axis=1)
    best = int(np.argmin(off))
    return Found(float(times[best]), flight.observation.position.copy(), float(off[best]))


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
                flight.conclude()
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
    flight.progress.waiting, flight.progress.gate_since = True, flight.now
    flight.clock.set_stopped()
    who = "all inner vehicles" if gate.inner else "all"
    flight.report("gate", f"waiting until {who} are {gate.condition}")
    GATES[gate.condition].begin(flight)


def _wait_at_gate(flight: FlightState) -> None:
    gate = flight.setup.gates[flight.progress.gate]
    if flight.holds.causes and gate.condition != "landed":
        flight.progress.gate_since += flight.timing.elapsed
    elif GATES[gate.condition].passed(flight):
        flight.report("gate", f"all are {gate.condition}")
        flight.progress.waiting, flight.progress.gate = False, flight.progress.gate + 1
        flight.clock.set_running()
        if gate.condition == "landed":
            flight.conclude()
    elif flight.now - flight.progress.gate_since > gate.timeout:
        words = f"not all are {gate.condition} in {gate.timeout:g} s"
        respond(flight, Failure(FailureKind.GATE_TIMEOUT, words))
