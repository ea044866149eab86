"""From a detected failure, or a command of the operator, to what the team does about it."""

from collections.abc import Callable, Mapping
from typing import NamedTuple

from swarm.flight.contingency import (
    leave_the_plan,
    release_fallen,
    release_if_open,
    stop_here,
)
from swarm.flight.detect import STALLED
from swarm.flight.failures import OPERATOR, Failure, Finding, HoldCause, Recovery, Response
from swarm.flight.observing import shift_frame
from swarm.flight.pace import rewind_limit
from swarm.flight.requests import REQUESTS, Request, request_words
from swarm.flight.stages import Stage
from swarm.flight.state import FlightState
from swarm.flight.streams import outside, rejoin


def respond(flight: FlightState, finding: Finding) -> None:
    """Respond to a failure or to the end of one."""
    if isinstance(finding, Recovery):
        _recover(flight, finding)
    else:
        _fail(flight, finding)


def _recover(flight: FlightState, recovery: Recovery) -> None:
    vehicle = None if recovery.vehicle is None else flight.roster.vehicles[recovery.vehicle]
    flight.holds.end_failures(recovery.kinds, vehicle.system if vehicle else None)
    flight.report(recovery.event, recovery.message, vehicle)


def _fail(flight: FlightState, failure: Failure) -> None:
    kind, k, message = failure.kind, failure.vehicle, failure.message
    vehicle = None if k is None else flight.roster.vehicles[k]
    if kind.responses.ends_stream and k is not None:
        flight.streams.switch(k, on=False)
    if failure.jump is not None and k is not None:
        shift_frame(flight, k, failure.jump, kind)
    if failure.known:
        return
    flight.report("failure", f"{kind}: {message}", vehicle)
    if kind.responses.irreversible:
        flight.mark_failed(_with_cause(flight, failure))
    match kind.response(flight.stage):
        case Response.REPORT:
            pass
        case Response.HOLD:
            flight.hold(HoldCause(kind, vehicle.system if vehicle else None), message)
        case Response.RELEASE_FALLEN:
            if k is not None:
                release_fallen(flight, k, message)
        case Response.RELEASE_HERE if flight.contingency is not None:
            release_if_open(flight, message)
        case Response.LAND_HERE if flight.contingency is not None:
            stop_here(flight, message)
        case response:
            leave_the_plan(flight, response, message)


def _with_cause(flight: FlightState, failure: Failure) -> str:
    """Return a vehicle's failure in words, after those of other vehicles for which the team holds:
    the first cause is the cause."""
    k = failure.vehicle
    own = None if k is None else flight.roster.vehicles[k].system
    held = flight.holds.causes.items() if k is not None else ()
    causes = [
        words
        for cause, words in held
        if cause == STALLED or (cause.failure and cause.system not in {None, own})
    ]
    return "; ".join([*causes, failure.message])


class Availability(NamedTuple):
    """Whether a command is possible now; its effect, or the reason against it."""

    open: bool
    words: str


def request(flight: FlightState, command: Request, author: str = "") -> str:
    """Carry out a command of an operator, the ``author``, where it is possible; return its effect
    in words."""
    answer = available(flight)[command]
    flight.report("operator", request_words(command, author, answer.words))
    if answer.open:
        _COMMANDS[command].act(flight)
    return answer.words


def available(flight: FlightState) -> Mapping[Request, Availability]:
    """Return the effect of every command at this moment of the flight."""
    if flight.stage is Stage.FINISHED:
        return dict.fromkeys(REQUESTS, Availability(False, "the flight has ended"))
    if flight.stage is Stage.RESUME:
        closed = Availability(False, "the team has not been found yet")
        end = Availability(
            True, "ends here: each vehicle lands by its failsafe after the fleet's hold time"
        )
        return {**dict.fromkeys(REQUESTS, closed), "interrupt": end}
    if flight.stage in {Stage.PREPARE, Stage.READY}:
        closed = Availability(False, "no vehicle flies yet")
        end = Availability(True, "ends here: no vehicle is armed")
        answers: tuple[Request, ...] = ("go", "refuse")
        effects = {command: _COMMANDS[command].effect(flight) for command in answers}
        return {**dict.fromkeys(REQUESTS, closed), "interrupt": end, **effects}
    if flight.contingency is not None:
        closed = Availability(False, "the team has already left the plan")
        still: tuple[Request, ...] = ("kill", "interrupt")
        effects = {command: _COMMANDS[command].effect(flight) for command in still}
        return {**dict.fromkeys(REQUESTS, closed), **effects}
    return {command: row.effect(flight) for command, row in _COMMANDS.items()}


COUNTDOWN = 3
"""Seconds from the go of a screen until vehicles are armed."""


def _go(flight: FlightState) -> Availability:
    if flight.stage is not Stage.READY:
        return _refuse(flight)
    if flight.go_given is not None:
        return Availability(False, "the go is given")
    team = f"arms {flight.setup.plan.vehicles} vehicles and flies"
    words = f"{team}, after {COUNTDOWN} s in which it can be refused"
    asked = flight.go_asked is not None
    return Availability(asked, words if asked else "nothing is asked now")


def _refuse(flight: FlightState) -> Availability:
    if flight.stage not in {Stage.PREPARE, Stage.READY}:
        return Availability(False, "the flight has begun")
    asked = flight.go_asked is not None
    words = "ends here: no vehicle is armed" if asked else "nothing is asked now"
    return Availability(asked, words)


def _do_go(flight: FlightState) -> None:
    flight.go_given = flight.now


def _hold(flight: FlightState) -> Availability:
    if flight.holds.causes:
        return Availability(False, f"already holding: {flight.holds.message}")
    limit = flight.setup.fleet.limits.hold
    return Availability(True, f"all stop along the path; after {limit:g} s all land together")


def _resume(flight: FlightState) -> Availability:
    if flight.progress.rewinding:
        return Availability(True, "stops the rewind, and continues the plan")
    if not flight.holds.causes:
        return Availability(False, "the clock is not held")
    return Availability(True, "continues the plan")


def _rewind(flight: FlightState) -> Availability:
    if not flight.phase.reversible:
        return Availability(False, f"the phase {flight.phase.name} does not run backwards")
    if flight.progress.waiting:
        return Availability(False, "the clock waits at a gate")
    end, why = rewind_limit(flight)
    back = flight.clock.time - end
    if back < 0.5:
        return Availability(False, f"cannot rewind beyond {end:.1f} s: {why}")
    return Availability(
        True, f"rewinds along the path by up to {back:.0f} s, to {end:.1f} s ({why}), then holds"
    )


def _land(flight: FlightState) -> Availability:
    if flight.setup.windows.can_land(flight.clock.time):
        return Availability(True, "all descend straight down together, here")
    obstacles = flight.setup.plan.mission.workspace.obstacles
    obstacle = ", or an obstacle is below" if obstacles else ""
    return Availability(
        True, f"a vehicle is above another{obstacle}: moves to where all can land, then lands"
    )


def _release(flight: FlightState) -> Availability:
    if not flight.attached:
        return Availability(False, "no vehicle holds the cable")
    if flight.setup.windows.can_release(flight.clock.time):
        return Availability(True, "releases the cable, separates upwards and lands")
    if flight.setup.windows.may_fall(flight.clock.time):
        return Availability(
            True,
            "an obstacle is above or below a vehicle: moves to where none is, if the plan "
            "has such a place, then releases",
        )
    return Availability(
        True, "cable hangs above a vehicle: moves to where none does, then releases"
    )


def _rejoin(flight: FlightState) -> Availability:
    away = outside(flight)
    if not away:
        return Availability(False, "every vehicle that can get setpoints does")
    names = flight.names(flight.roster.vehicles[k] for k in away)
    if not flight.clock.stopped:
        return Availability(False, f"the clock still runs: {names} can rejoin when the team holds")
    return Availability(True, f"returns {names} to the team, from its position, and holds")


def _abort(flight: FlightState) -> Availability:
    if flight.attached and flight.setup.windows.may_fall(flight.clock.time):
        near = not flight.setup.windows.can_release(flight.clock.time)
        separates = "separates as far as obstacles allow" if near else "separates upwards"
        return Availability(True, f"releases the cable here, {separates} and lands")
    return Availability(True, "all descend straight down together, here")


def _do_hold(flight: FlightState) -> None:
    flight.progress.rewinding = False
    flight.hold(OPERATOR, "operator command")


def _do_resume(flight: FlightState) -> None:
    flight.progress.rewinding = False
    flight.holds.end([OPERATOR])


def _do_rewind(flight: FlightState) -> None:
    flight.holds.end([OPERATOR])
    flight.progress.rewinding = True


def _do_abort(flight: FlightState) -> None:
    """Choose the quickest end that drops no cable on a rotor."""
    release = flight.attached and flight.setup.windows.may_fall(flight.clock.time)
    response = Response.RELEASE if release else Response.LAND_HERE
    leave_the_plan(flight, response, "operator command: abort", move=False)


def _do_kill(flight: FlightState) -> None:
    flight.mark_failed("killed by the operator")
    for k, vehicle in enumerate(flight.roster.vehicles):
        flight.streams.switch(k, on=False)
        vehicle.kill()
    flight.streams.expect_armed(armed=False)
    if flight.stage is Stage.EXECUTE:
        words = "killed by the operator"
        leave_the_plan(flight, Response.LAND_HERE, words, announced="all motors stopped")


def _do_interrupt(flight: FlightState) -> None:
    again, flight.ending.interrupted = flight.ending.interrupted, True
    if flight.stage in {Stage.PREPARE, Stage.READY}:
        flight.finish("interrupted", "interrupted before anything was armed")
    elif flight.stage is Stage.RESUME:
        flight.finish("interrupted", "interrupted before the team was found")
    elif flight.stage is Stage.EXECUTE and (again or flight.progress.waiting):
        response = Response.LAND_HERE if again else Response.LAND
        leave_the_plan(flight, response, "interrupted")
    elif flight.stage is Stage.EXECUTE:
        flight.progress.rewinding = False
        flight.hold(OPERATOR, "interrupted")


class _Command(NamedTuple):
    """A command of the operator: whether it is possible now, with its effect; and its action."""

    effect: Callable[[FlightState], Availability]
    act: Callable[[FlightState], None]


_COMMANDS: Mapping[Request, _Command] = {
    "go": _Command(_go, _do_go),
    "refuse": _Command(_refuse, lambda flight: flight.finish("refused", "refused by the operator")),
    "hold": _Command(_hold, _do_hold),
    "resume": _Command(_resume, _do_resume),
    "rewind": _Command(_rewind, _do_rewind),
    "land": _Command(
        _land, lambda flight: leave_the_plan(flight, Response.LAND, "operator command: land")
    ),
    "release": _Command(
        _release,
        lambda flight: leave_the_plan(flight, Response.RELEASE, "operator command: release"),
    ),
    "rejoin": _Command(_rejoin, rejoin),
    "abort": _Command(_abort, _do_abort),
    "kill": _Command(
        lambda _: Availability(True, "stops all motors at once, also in the air"), _do_kill
    ),
    "interrupt": _Command(
        lambda _: Availability(True, "holds, then lands all together; again: lands at once"),
        _do_interrupt,
    ),
}
