"""The flight outside the plan: come to rest where landing or release is open, release the cable and
separate where the policy says so, descend together.

All vehicles descend straight down at one speed, so that chords and levels keep.

On the way it moves no faster than in the plan: errors, clearances and a loss of setpoints slow it
down. Where it cannot move on, or a vehicle flies without setpoints, it stops where it is.
"""

import math
from collections.abc import Collection, Iterable, Mapping, Sequence

import numpy as np
import numpy.typing as npt

from swarm.certification.contingency_windows import above_rotors, longest_chords, rotors_clear
from swarm.flight.detect import SLOW_FROM, STOPPED_RATE
from swarm.flight.failures import ENDS, End, Response, Windows
from swarm.flight.observing import follow_swing, monitor
from swarm.flight.pace import advance_clock, allowed_pace, rewind_end
from swarm.flight.router import answer_limit
from swarm.flight.separation import AWAY, separation_motion, spread_here
from swarm.flight.stages import Stage, Step, StepTrigger, Trigger
from swarm.flight.state import Contingency, FlightState
from swarm.flight.streams import continue_rejoining, outside
from swarm.mavlink.vehicle import Vehicle

LONGEST_HOVER, DESCENT_SPEED = 5.0, 0.2
"""Seconds for which the team waits until a vehicle that lands alone descends, and the speed in m/s
from which it does: ArduPilot hovers for 4 s before the landing of a failsafe (LAND_WITH_DELAY_MS in
its source). In a simulated flight, a team that descended at once pulled the cable taut there."""
TOUCHDOWN = 0.05
"""Height of a setpoint in metres at which a vehicle is commanded to land."""
LAG = 0.5
"""Metres by which a vehicle may stay off its place in a common descent: the largest tracking
error of a vehicle that follows is 0.2 m in winds that plans allow for."""
ARRIVED = 0.1
"""Seconds of mission time between the clock and its target at which the team has arrived."""
DISARM_AFTER = 5.0
"""Seconds on the ground after which a vehicle that has not disarmed by itself is commanded to."""
RELEASE_TIMEOUT, FALLEN_RELEASE_TIMEOUT = 5.0, 1.5
"""Seconds for which the team waits for grippers to open; beside a fall, whose pull grows, less."""
BLIND = 15.0
"""Seconds after the setpoints have come down after which silent vehicles are not waited for."""
FALLEN_TIMEOUT = 40.0
"""Seconds after which nothing is expected from a fallen vehicle: its link may be broken."""
GIVE_UP = 120.0
"""Seconds beyond T after which a landing is given up: from the default ceiling, 30 m, the default
descent at 0.6 m/s takes 50 s."""


def windows(flight: FlightState) -> Windows:
    """Return what the plan and the vehicles' places allow at this moment."""
    landable = flight.setup.windows.can_land(flight.clock.time)
    return Windows.of(landable=landable, releasable=may_release(flight))


def may_release(flight: FlightState) -> bool:
    """Return whether no cable hangs above a rotor: as planned, and where vehicles do not follow.

    Such vehicles stopped by themselves, the others along the path: some decimetres apart.
    """
    if not flight.setup.windows.may_fall(flight.clock.time):
        return False
    return not not_following(flight) or bool(rotors_clear(flight.setup.plan, _places(flight))[0])


def may_release_at(flight: FlightState, vehicles: Collection[int]) -> bool:
    """Return whether the strands beside some vehicles hang above no rotor: these would fall."""
    above = _above_rotors(flight)
    strands = {s for k in vehicles for s in (k - 1, k) if 0 <= s < above.shape[1]}
    return not above[:, sorted(strands)].any()


def turning_below_cable(flight: FlightState) -> list[Vehicle]:
    """Return the vehicles on the ground whose rotors still turn, with cable above them.

    None while a vehicle flies alone: the others keep their heights above it as they descend.
    """
    vehicles, height = flight.roster.vehicles, flight.streams.setpoint[:, 2]
    down = [k for k, vehicle in enumerate(vehicles) if vehicle.on_ground or height[k] <= TOUCHDOWN]
    if not down or _any_flies_alone(flight):
        return []
    gripped = flight.observation.gripped
    held = np.logical_and(gripped[:-1], gripped[1:])
    above = _above_rotors(flight)
    return [vehicles[k] for k in down if above[k, held].any()]


def held_by_cable(flight: FlightState) -> list[int]:
    """Return the one or two vehicles that a caught strand holds back while the others descend.

    They are aside or above by more than LAG, and by twice as much as any other: cable that comes to
    lie on the floor pulls by 0.2 m. Those that land are held where they do not descend. Not while a
    vehicle flies alone: it pulls its neighbours. Positions in a frame that moved show nothing.
    """
    if _any_flies_alone(flight):
        return []
    seen, streams, vehicles = flight.observation, flight.streams, flight.roster.vehicles
    off = seen.position - streams.setpoint
    off[:, 2] = np.maximum(off[:, 2], 0.0)
    error = np.linalg.norm(off, axis=1)
    flies = seen.armed & ~np.array([vehicle.on_ground for vehicle in vehicles])
    flies &= streams.active | (seen.velocity[:, 2] > -DESCENT_SPEED)
    flies[list(flight.placement.moved)] = False
    error = np.where(flies & np.isfinite(error), error, 0.0)
    far = error > LAG
    held = 1 <= far.sum() <= 2 and error[~far].max(initial=0.0) < 0.5 * error[far].min()
    return np.flatnonzero(far).tolist() if held else []


def _any_flies_alone(flight: FlightState) -> bool:
    """Return whether a vehicle in the air follows no setpoints, or may not.

    Those whose setpoints ended as they came down, to let them land, do not count.
    """
    vehicles = flight.roster.vehicles
    alone = [vehicles[k] for k in (flight.contingency.alone if flight.contingency else ())]
    alone += [
        *unanswering(flight),
        *(vehicle for vehicle in vehicles if not flight.received(vehicle)),
    ]
    return any(vehicle.armed and not vehicle.on_ground for vehicle in alone)


def _above_rotors(flight: FlightState) -> npt.NDArray[np.bool_]:
    """Return above which turning rotors which strands are (n, n - 1)."""
    above: npt.NDArray[np.bool_] = above_rotors(flight.setup.plan, _places(flight))[0]
    above[~flight.observation.armed] = False
    return above


def _places(flight: FlightState) -> npt.NDArray[np.float64]:
    """Return the grip points (1, n, 3): as planned, or where vehicles are that do not follow."""
    places, position = flight.streams.setpoint.copy(), flight.observation.position
    for k in not_following(flight):
        if np.isfinite(position[k]).all():
            places[k] = position[k]
    return places[None]


def not_following(flight: FlightState) -> list[int]:
    """Return the vehicles that fly without setpoints."""
    streams = flight.streams
    return [k for k in np.flatnonzero(~streams.active).tolist() if k not in streams.fallen]


def adrift(flight: FlightState) -> list[int]:
    """Return the vehicles that do not know where they are, so that they keep no place."""
    seen, lost = flight.observation, ~flight.observation.position_healthy
    if flight.setup.fleet.frame == "gps":
        lost = lost | seen.poor_fix
    return [k for k in np.flatnonzero(lost).tolist() if k not in flight.streams.fallen]


def waits_to_land(flight: FlightState, since: float) -> bool:
    """Return whether the team must not descend yet, because a vehicle would stay above it.

    A vehicle that flies alone, and does not descend as it is commanded to, is waited for during
    LONGEST_HOVER, and T longer where it is not in a landing mode: one that receives nothing lands
    by itself T after the loss. So is a silent vehicle, which may be one. A pilot's vehicle is not.
    ``since`` is when the last one began to fly without setpoints, or the team left the plan.
    """
    limits, vehicles = flight.setup.fleet.limits, flight.roster.vehicles
    flying = [
        k for k, vehicle in enumerate(vehicles) if vehicle.armed and k not in flight.streams.fallen
    ]
    silent_for = [flight.now - vehicles[k].received_at for k in flying]
    if any(limits.silence < silence <= limits.hold for silence in silent_for):
        return True
    rising = flight.observation.velocity[:, 2]
    hovering = [
        vehicles[k]
        for k in set(not_following(flight)).intersection(flying)
        if not vehicles[k].in_manual_mode
        and flight.received(vehicles[k])
        and rising[k] > -DESCENT_SPEED
    ]
    landing = all(vehicle.in_mode("land") for vehicle in hovering)
    longest = LONGEST_HOVER + (0.0 if landing else limits.hold)
    return bool(hovering) and flight.now - since <= longest


def stays_above(flight: FlightState) -> Vehicle | None:
    """Return a vehicle on the cable that hovers LAG or more above its place in the team's descent.

    Of a silent one the last position counts, until it lands by itself T after it was received. One
    on the ground reports a height above it where its barometer drifts.
    """
    seen, longest = flight.observation, flight.setup.fleet.limits.hold
    above = seen.position[:, 2] - flight.streams.setpoint[:, 2]
    for k, vehicle in enumerate(flight.roster.vehicles):
        flies = vehicle.armed and not vehicle.on_ground and k not in flight.streams.fallen
        descends = flight.received(vehicle) and seen.velocity[k, 2] < -DESCENT_SPEED
        if flies and above[k] > LAG and flight.received(vehicle, longest) and not descends:
            return vehicle if flight.attached else None
    return None


def nearest_open(flight: FlightState, response: Response) -> float | None:
    """Return the mission time at which a response is open, nearest to where the clock can stop.

    Where no release is clear of obstacles, one that drops no cable on a rotor.
    """
    windows_, clock, gates = flight.setup.windows, flight.clock, flight.setup.gates
    choices = [windows_.land] if response is Response.LAND else [windows_.release, windows_.falls]
    gate = flight.progress.gate
    gate_before = gates[gate - 1].time if gate else 0.0
    gate_after = gates[gate].time if gate < len(gates) else flight.setup.plan.duration
    stopping = 0.5 * clock.rate * abs(clock.rate) / clock.steepest
    moment = min(max(clock.time + stopping, gate_before), gate_after)
    moments = (windows_.nearest(each, moment, rewind_end(flight), gate_after) for each in choices)
    return next((each for each in moments if each is not None), None)


def unanswering(flight: FlightState) -> list[Vehicle]:
    """Return the vehicles that may not receive: they have not answered lately."""
    seen, longest = flight.observation, answer_limit(flight.setup.fleet.limits)
    return [
        vehicle
        for k, vehicle in enumerate(flight.roster.vehicles)
        if seen.unanswered_for(k) > longest and k not in flight.streams.fallen
    ]


def contingency_of(flight: FlightState) -> Contingency:
    """Return the flight outside the plan; raises ValueError while the team flies the plan."""
    if flight.contingency is None:
        raise ValueError("the team has not left the plan")
    return flight.contingency


def move_on(flight: FlightState) -> None:
    """Let the clock move towards the chosen moment."""
    follow_swing(flight)
    monitor(flight)
    _notice_alone(flight)
    _notice_motion(flight)
    flight.clock.urgent, flight.clock.target = True, _rate(flight, contingency_of(flight).target)
    advance_clock(flight)


def at_rest(flight: FlightState) -> bool:
    """Return whether the team rests at the chosen moment, or where it must stop."""
    late = flight.now - contingency_of(flight).step_since > flight.setup.fleet.limits.hold
    return flight.clock.stopped and (late or _arrived(flight))


def _arrived(flight: FlightState) -> bool:
    target = contingency_of(flight).target
    return target is None or abs(target - flight.clock.time) < ARRIVED


def _rate(flight: FlightState, target: float | None) -> float:
    """Return the clock's rate towards a mission time, as slow as in the plan where that is needed.

    The team waits for a vehicle that is silent or returns to offboard mode: one that does not
    follow must not be left behind.
    """
    clock = flight.clock
    difference = 0.0 if target is None else target - clock.time
    if abs(difference) < 0.02 or _any_silent(flight) or _rejoins(flight):
        return 0.0
    braking = 0.5 * math.sqrt(2.0 * clock.steepest * abs(difference))
    return math.copysign(min(allowed_pace(flight, backwards=difference < 0.0), braking), difference)


def _any_silent(flight: FlightState) -> bool:
    return not all(flight.received(vehicle) for vehicle in flight.roster.vehicles)


def _rejoins(flight: FlightState) -> bool:
    return bool(flight.streams.rejoining) or flight.guidance.blending


def _notice_alone(flight: FlightState) -> None:
    """Take note of the vehicles that fly without setpoints; if others do now, move no farther."""
    contingency, alone = contingency_of(flight), tuple(not_following(flight))
    if alone != contingency.alone:
        contingency.alone, contingency.alone_since = alone, flight.now
        stop_here(flight, "a vehicle flies without setpoints")


def _notice_motion(flight: FlightState) -> None:
    """Take note that the team moves on, has arrived, or waits for a vehicle.

    One that receives nothing soon lands by itself: the others must not descend before it.
    """
    moves = abs(flight.clock.rate) >= STOPPED_RATE
    waits = _any_silent(flight) or bool(unanswering(flight)) or _rejoins(flight)
    if moves or waits or _arrived(flight):
        contingency_of(flight).moving_at = flight.now


_ANNOUNCED: Mapping[Response, str] = {
    Response.LAND: "landing together",
    Response.LAND_HERE: "landing together",
    Response.RELEASE: "releasing and landing",
    Response.RELEASE_HERE: "landing together",
    Response.RELEASE_FALLEN: "releasing the fallen vehicle, separating and landing",
}


def leave_the_plan(
    flight: FlightState,
    response: Response,
    message: str,
    *,
    move: bool | None = None,
    announced: str = "",
) -> None:
    """Begin a contingency; before the flight, end it.

    ``move`` says whether the team may move along the plan first (None: LAND and RELEASE do). Only a
    team whose vehicles all follow moves: where it can neither land nor release as it stands, and
    keep clear of obstacles, those that left offboard mode are asked to return. ``announced``
    replaces the usual words.
    """
    if flight.stage in {Stage.PREPARE, Stage.READY}:
        flight.finish("interrupted", message)
    if flight.stage is not Stage.EXECUTE:
        return
    flight.report("contingency", f"{announced or _ANNOUNCED[response]}: {message}")
    flight.progress.waiting = flight.progress.rewinding = False
    flight.change_stage(Trigger.LEAVE_PLAN)
    moves = response in {Response.LAND, Response.RELEASE} if move is None else move
    planned, time = flight.setup.windows, flight.clock.time
    closed = not (planned.can_land(time) or planned.can_release(time))
    if moves and flight.attached and (closed or windows(flight) is Windows.NEITHER):
        for k in outside(flight):
            flight.begin_rejoining(k)
    here = response is Response.RELEASE_HERE
    flight.contingency = Contingency(
        response=Response.LAND_HERE if here else response,
        since=flight.now,
        step_since=flight.now,
        target=nearest_open(flight, response) if moves and flight.streams.active.all() else None,
        moving_at=flight.now,
        alone=tuple(not_following(flight)),
        alone_since=flight.now,
    )
    if response is Response.RELEASE_FALLEN:
        _release_fallen(flight)
    if not np.any(flight.streams.expected_armed):
        for vehicle in flight.roster.vehicles:
            vehicle.disarm()
    if here:
        release_if_open(flight)


def release_fallen(flight: FlightState, k: int, message: str) -> None:
    """Release a vehicle that falls, and the cable around it; land the others."""
    if k in flight.streams.fallen:
        return
    flight.streams.give_up(k)
    if flight.stage is Stage.EXECUTE:
        leave_the_plan(flight, Response.RELEASE_FALLEN, message)
    elif flight.contingency is not None:
        _release_fallen(flight)


def stop_here(flight: FlightState, message: str) -> None:
    """Move no farther along the plan: come to rest at the present place, and end there.

    A team that was to release elsewhere releases here only where no cable hangs above a rotor.
    """
    contingency = contingency_of(flight)
    if contingency.target is None or contingency.step is not Step.APPROACH:
        return
    flight.report("contingency", f"stopping here: {message}")
    contingency.target = None
    if contingency.response is Response.RELEASE:
        contingency.response = Response.RELEASE_HERE


def release_if_open(flight: FlightState, message: str = "") -> None:
    """Release the cable in a contingency that keeps it, where no cable hangs above a rotor.

    Elsewhere the team moves no farther.
    """
    stop_here(flight, message)
    contingency = contingency_of(flight)
    early = contingency.step in {Step.APPROACH, Step.DESCEND}
    end = ENDS[Response.RELEASE_HERE][windows(flight)]
    if flight.attached and early and end is End.RELEASE:
        contingency.response, contingency.target = Response.RELEASE, None
        _begin_release(flight)


def tick(flight: FlightState) -> None:
    """Go on, until all vehicles are down and disarmed, or given up."""
    continue_rejoining(flight)
    _STEPS[contingency_of(flight).step](flight)
    if _finished(flight):
        flight.conclude()


# Approach


def _approach(flight: FlightState) -> None:
    """Move to the chosen moment; there, release or descend."""
    move_on(flight)
    if not at_rest(flight):
        return
    contingency, open_ = contingency_of(flight), windows(flight)
    contingency.cornered = flight.attached and open_ is Windows.NEITHER
    if flight.attached and ENDS[contingency.response][open_] is End.RELEASE:
        _begin_release(flight)
        return
    if contingency.response is Response.RELEASE_HERE:
        error = flight.observation.error
        if _release_caught(flight, np.flatnonzero(error > SLOW_FROM * flight.allowed_error)):
            return
    for k in contingency.alone:
        if not (vehicle := flight.roster.vehicles[k]).in_manual_mode:
            _land(flight, k, vehicle)
    if not waits_to_land(flight, contingency.alone_since):
        _begin_descent(flight, StepTrigger.LAND)


# Release


def _begin_release(flight: FlightState) -> None:
    """Release all together; but first at vehicles that have not answered lately.

    They may not receive the command, and the cable that the others release would swing on them.
    """
    vehicles = flight.roster.vehicles
    silent = [vehicle for vehicle in unanswering(flight) if vehicle.gripped]
    contingency_of(flight).change_step(StepTrigger.RELEASE, flight.now)
    if 0 < len(silent) < len(vehicles):
        contingency_of(flight).staggered = True
        names = flight.names(silent)
        flight.report("release", f"releasing first, without recent answers: {names}")
        _open_grippers(flight, [vehicles.index(vehicle) for vehicle in silent])
    else:
        _release_all(flight)


def _release_all(flight: FlightState) -> None:
    contingency_of(flight).staggered = False
    flight.report("release", "releasing all together")
    _open_grippers(flight, range(len(flight.roster.vehicles)))


def _release_caught(flight: FlightState, caught: Iterable[int]) -> bool:
    """Release where a strand is caught and beside it, unless cable hangs above a rotor there.

    A caught strand would hold its vehicles in the air, while the team comes down. Where its
    neighbours cannot release, it does so alone. Return whether there is such a place.
    """
    n = len(flight.roster.vehicles)
    held = _releasable(flight, caught)
    beside = [j for k in held for j in (k, k - 1, k + 1) if 0 <= j < n]
    for order in (list(dict.fromkeys(beside)), held):
        if order and may_release_at(flight, order):
            contingency_of(flight).change_step(StepTrigger.RELEASE, flight.now)
            names = ", ".join(str(k + 1) for k in order)
            flight.report("release", f"releasing where the cable is caught: vehicles {names}")
            _open_grippers(flight, order)
            return True
    return False


def _releasable(flight: FlightState, vehicles: Iterable[int]) -> list[int]:
    """Return which vehicles hold the cable and were not commanded to release before."""
    opening = contingency_of(flight).opening
    return [k for k in vehicles if flight.roster.vehicles[k].gripped and k not in opening]


def _release_fallen(flight: FlightState) -> None:
    """Release at fallen vehicles first, then beside them, then everywhere where that is open.

    Where cable hangs above a rotor, the vehicles that are not beside a fall keep holding: they come
    straight down together. A team that separates or descends goes on meanwhile.
    """
    fallen, contingency = sorted(flight.streams.fallen), contingency_of(flight)
    contingency.response, contingency.target = Response.RELEASE_FALLEN, None
    if contingency.step in {Step.APPROACH, Step.RELEASE}:
        contingency.change_step(StepTrigger.RELEASE, flight.now)
    if not flight.attached:
        return
    n = len(flight.roster.vehicles)
    order = [*fallen, *(k for j in fallen for k in (j - 1, j + 1) if 0 <= k < n)]
    if ENDS[Response.RELEASE_FALLEN][windows(flight)] is End.RELEASE_FALLEN:
        order += range(n)
    names = ", ".join(str(k + 1) for k in dict.fromkeys(order))
    flight.report("release", f"releasing in this order: vehicles {names}")
    _open_grippers(flight, list(dict.fromkeys(order)))


def _open_grippers(flight: FlightState, order: Sequence[int]) -> None:
    contingency_of(flight).opening |= set(order)
    for k in order:
        vehicle = flight.roster.vehicles[k]
        if not (flight.setup.commands_grippers and vehicle.gripped):
            vehicle.gripped = False
        elif not vehicle.commands.contains("release"):
            vehicle.grip(closed=False)


def _release(flight: FlightState) -> None:
    """Wait until the grippers are open and the team is at rest, in the plan or in its descent."""
    flight.clock.urgent, flight.clock.target = True, 0.0
    advance_clock(flight)
    flight.guidance.go_down(flight.timing.moving, 0.0)
    contingency, fallen = contingency_of(flight), flight.streams.fallen
    holding = {
        k: vehicle
        for k, vehicle in enumerate(flight.roster.vehicles)
        if vehicle.gripped and k not in fallen
    }
    waited = flight.now - contingency.step_since
    if contingency.staggered:
        silent = any(vehicle in holding.values() for vehicle in unanswering(flight))
        if not silent or waited > FALLEN_RELEASE_TIMEOUT:
            _release_all(flight)
        return
    at_rest = flight.clock.stopped and flight.guidance.at_rest
    if not at_rest and waited < RELEASE_TIMEOUT:
        return
    closed = [vehicle for k, vehicle in holding.items() if k in contingency.opening]
    if not holding:
        _begin_separation(flight)
    elif not closed or waited > (FALLEN_RELEASE_TIMEOUT if fallen else RELEASE_TIMEOUT):
        if closed:
            flight.report(
                "contingency", f"{flight.names(closed)} still hold the cable: landing here"
            )
        _begin_descent(flight, StepTrigger.STUCK)


# Separation


def _begin_separation(flight: FlightState) -> None:
    """Take the path apart that the plan has for this moment, or away from the team's centre.

    A vehicle that does not follow stays where it is, or drifts without a position; the others move
    away from it. From two such vehicles, no path leads away without leading towards one of them.
    """
    setup, streams = flight.setup, flight.streams
    mission, start = setup.plan.mission, streams.setpoint.copy()
    staying = sorted({*adrift(flight), *not_following(flight)})
    follows, away = streams.active.copy(), AWAY
    follows[staying] = False
    if streams.fallen:
        fallen = min(streams.fallen)
        centre, spread = start[fallen], setup.separations.at(flight.clock.time, fallen)
    elif len(staying) > 1:
        _land_adrift(flight)
        _begin_descent(flight, StepTrigger.SURROUNDED)
        return
    elif staying:
        (stays,) = staying
        position = flight.observation.position[stays]
        if not streams.active[stays] and np.isfinite(position).all():
            start[stays] = position
        centre, spread = start[stays], setup.separations.at(flight.clock.time, stays)
    else:
        centre, away, spread = start.mean(axis=0), 0.0, spread_here(start, mission)
    motion = separation_motion(start, centre, away, spread, mission, follows)
    flight.guidance.follow(motion, flight.timing.moving)
    contingency_of(flight).change_step(StepTrigger.RELEASED, flight.now)


def _separate(flight: FlightState) -> None:
    """Move apart; then stay above a vehicle that lands without setpoints, for T at most.

    A vehicle that drifts is commanded to land when the others have moved out of its way.
    """
    if flight.now - contingency_of(flight).step_since > flight.guidance.duration:
        _land_adrift(flight)
    alone = [
        (k, flight.roster.vehicles[k])
        for k in not_following(flight)
        if not flight.roster.vehicles[k].in_manual_mode
    ]
    for k, vehicle in alone:
        _land(flight, k, vehicle)
    lands = any(
        vehicle.armed and not vehicle.on_ground and flight.received(vehicle) for _, vehicle in alone
    )
    longest = flight.guidance.duration + (flight.setup.fleet.limits.hold if lands else 0.0)
    if flight.now - contingency_of(flight).step_since > longest:
        _begin_descent(flight, StepTrigger.APART)


def _land_adrift(flight: FlightState) -> None:
    """Let vehicles without a position land by themselves: setpoints lead them nowhere."""
    for k in adrift(flight):
        flight.streams.switch(k, on=False)


# Descent


def _begin_descent(flight: FlightState, trigger: StepTrigger) -> None:
    contingency_of(flight).change_step(trigger, flight.now)
    speed = flight.setup.fleet.limits.descent
    flight.guidance.descend(flight.streams.setpoint, speed, flight.timing.moving)


def _descend(flight: FlightState) -> None:
    """Command each vehicle to land when its setpoint has come down, and to disarm after that.

    For a vehicle that stays above, or whose rotors still turn on the ground below cable, the
    descent pauses for T; then the cable is released for the first if it may. Where a caught strand
    holds a vehicle back, it is released as soon as it may; until then, those below it descend.
    """
    contingency, height = contingency_of(flight), flight.streams.setpoint[:, 2]
    alone = {*contingency.alone, *(k for k in not_following(flight) if height[k] > TOUCHDOWN)}
    contingency.alone = tuple(sorted(alone))
    above, longest = stays_above(flight), flight.setup.fleet.limits.hold + LONGEST_HOVER
    patient = contingency.waited <= longest
    if above is not None and not patient:
        release_if_open(flight)
    elif _note_caught(flight):
        _release_held(flight, sorted(contingency.caught))
    if contingency.step is not Step.DESCEND:
        return
    turning = turning_below_cable(flight) if flight.attached and above is None else []
    waits, descends = above is not None or bool(turning), np.ones(len(height), dtype=bool)
    if patient and (waits or contingency.caught):
        descends = _below_caught(flight) & ~np.bool_(waits)
        if not descends[height > TOUCHDOWN].any():
            _note_waiting(flight, above, turning)
    flight.guidance.go_down(flight.timing.moving, descends.astype(float))
    for k, vehicle in enumerate(flight.roster.vehicles):
        if not vehicle.armed:
            flight.streams.switch(k, on=False)
        elif not vehicle.in_manual_mode:
            _land(flight, k, vehicle)
    flight.stop_streams_of_landing()


def _release_held(flight: FlightState, held: Sequence[int]) -> None:
    """Release a strand that holds vehicles back: everywhere, or there."""
    release_if_open(flight)
    if contingency_of(flight).step is Step.DESCEND:
        _release_caught(flight, held)


def _note_caught(flight: FlightState) -> bool:
    """Take note of the vehicles that a strand holds back; return whether there are any.

    Commanded farther down, they would be pulled below the place where it is caught, and the strand
    through their rotors: they rest where they hang.
    """
    contingency = contingency_of(flight)
    held = {*contingency.caught, *held_by_cable(flight)} if flight.attached else ()
    caught = frozenset(() if _any_flies_alone(flight) else _releasable(flight, held))
    for k in caught - contingency.caught:
        flight.guidance.rest(k, float(flight.observation.position[k, 2]))
    contingency.caught = caught
    return bool(caught)


def _below_caught(flight: FlightState) -> npt.NDArray[np.bool_]:
    """Return which vehicles descend (n,) until a caught strand can be released.

    Those whose turning rotors are below it, whatever is below these and their strands, and those
    that chords to these pull down. All others stay where they are. Where a vehicle at the strand
    would be among those that descend, all descend.
    """
    plan, place = flight.setup.plan, flight.streams.setpoint
    above, caught = _above_rotors(flight), sorted(contingency_of(flight).caught)
    aside = np.linalg.norm(place[:, None, :2] - place[:, :2], axis=-1)
    near = aside < plan.mission.clearance.vehicle + 2.0 * plan.mission.vehicles.tracking
    below = near & (place[:, None, 2] > place[:, 2])
    chord = np.linalg.norm(np.diff(place, axis=0), axis=1)
    taut = np.logical_and(*_holders(flight.observation.gripped)) & (chord > longest_chords(plan))
    at_caught = np.zeros(plan.vehicles, dtype=bool)
    at_caught[caught] = True
    descends = np.asarray(above[:, np.logical_or(*_holders(at_caught))].any(axis=1))
    while True:
        upper, lower = _holders(descends)
        more = descends | below[descends].any(axis=0) | above[:, upper | lower].any(axis=1)
        more[:-1] |= taut & lower
        more[1:] |= taut & upper
        if more[caught].any() or not more.any():
            return np.ones_like(descends)
        if np.array_equal(more, descends):
            return descends
        descends = more


def _holders(flags: npt.NDArray[np.bool_]) -> tuple[npt.NDArray[np.bool_], npt.NDArray[np.bool_]]:
    """Return what holds for the first and for the second vehicle of each strand (n − 1,)."""
    return flags[:-1], flags[1:]


def _note_waiting(flight: FlightState, above: Vehicle | None, turning: Sequence[Vehicle]) -> None:
    contingency = contingency_of(flight)
    if above is not None and contingency.waited == 0.0:
        words = f"{flight.name(above)} stays above the others, which wait for it"
        flight.report("contingency", words)
    elif turning and flight.progress.first_time(0, "turning below cable"):
        names = flight.names(turning)
        words = f"waiting until the rotors below cable have stopped: {names}"
        flight.report("contingency", words)
    contingency.waited += flight.timing.elapsed


def _land(flight: FlightState, k: int, vehicle: Vehicle) -> None:
    contingency, system = contingency_of(flight), vehicle.system
    if flight.streams.setpoint[k, 2] <= TOUCHDOWN or not flight.streams.active[k]:
        contingency.landing |= {system}
    if system in contingency.landing:
        if not vehicle.in_mode("land") and (
            flight.received(vehicle) or flight.progress.first_time(k, "land unheard")
        ):
            vehicle.set_mode("land")
        if vehicle.on_ground:
            since = contingency.on_ground_since.setdefault(system, flight.now)
            if flight.now - since > DISARM_AFTER:
                vehicle.disarm()


def _finished(flight: FlightState) -> bool:
    limits, contingency = flight.setup.fleet.limits, contingency_of(flight)
    armed = [
        vehicle
        for k, vehicle in enumerate(flight.roster.vehicles)
        if vehicle.armed and not vehicle.in_manual_mode and not _given_up(flight, k)
    ]
    received = [vehicle for vehicle in armed if flight.received(vehicle, limits.lost)]
    if contingency.down_since is None and contingency.step is Step.DESCEND:
        down = np.all(flight.streams.setpoint[:, 2] <= TOUCHDOWN)
        contingency.down_since = flight.now if down else None
    down_since = contingency.down_since
    blind = down_since is not None and flight.now - down_since > BLIND
    if not armed or (blind and not received):
        return True
    if flight.now - contingency.step_since > GIVE_UP + limits.hold:
        names = flight.names(armed)
        flight.mark_failed(f"still armed long after landing began: {names}")
        return True
    return False


def _given_up(flight: FlightState, k: int) -> bool:
    """Return whether a vehicle fell so long ago that its disarming will not be received."""
    age = flight.now - contingency_of(flight).since
    return k in flight.streams.fallen and age > FALLEN_TIMEOUT


_STEPS = {
    Step.APPROACH: _approach,
    Step.RELEASE: _release,
    Step.SEPARATE: _separate,
    Step.DESCEND: _descend,
}
