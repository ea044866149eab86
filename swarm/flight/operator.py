"""The operator's commands: what each would do now, and whether it is possible."""

from collections.abc import Callable, Mapping
from typing import Literal, NamedTuple, get_args

from swarm.flight.ending import finish, mark_failed, mark_interrupted
from swarm.flight.failures import OPERATOR
from swarm.flight.holds import end_operator_hold, hold
from swarm.flight.modes.contingency import leave_the_plan
from swarm.flight.modes.rejoin import outside, rejoin
from swarm.flight.pace import rewind_limit
from swarm.flight.policy import Response
from swarm.flight.progress import set_rewinding
from swarm.flight.stages import Stage
from swarm.flight.state import FlightState
from swarm.flight.streams import expect_armed, stop_stream

Request = Literal[
    "hold", "resume", "rewind", "land", "release", "rejoin", "abort", "kill", "interrupt"
]
REQUESTS: tuple[Request, ...] = get_args(Request)


class Availability(NamedTuple):
    """Whether a command is possible now; its effect, or the reason against it."""

    open: bool
    words: str


def request(flight: FlightState, command: Request, author: str = "") -> str:
    """Carry out a command of an operator, the ``author``, where it is possible; return its effect
    in words."""
    answer = available(flight)[command]
    by = f" by {author}" if author else ""
    flight.report("operator", f"{command}{by}: {answer.words}")
    if answer.open:
        _ACTIONS[command](flight)
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
        return {**dict.fromkeys(REQUESTS, closed), "interrupt": end, "abort": closed}
    kill = Availability(True, "stops all motors at once, also in the air")
    interrupt = Availability(True, "holds, then lands all together; again: lands at once")
    if flight.contingency is not None:
        closed = Availability(False, "the team has already left the plan")
        return {**dict.fromkeys(REQUESTS, closed), "kill": kill, "interrupt": interrupt}
    return {
        "hold": _hold(flight),
        "resume": _resume(flight),
        "rewind": _rewind(flight),
        "land": _land(flight),
        "release": _release(flight),
        "rejoin": _rejoin(flight),
        "abort": _abort(flight),
        "kill": kill,
        "interrupt": interrupt,
    }


def _hold(flight: FlightState) -> Availability:
    if flight.holds.causes:
        return Availability(False, f"already holding: {flight.holds.message}")
    limit = flight.setup.fleet.limits.hold
    return Availability(True, f"all stop along the path; after {limit:g} s all land together")


def _resume(flight: FlightState) -> Availability:
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
    return Availability(True, "a vehicle is above another: moves to where all can land, then lands")


def _release(flight: FlightState) -> Availability:
    if not flight.attached:
        return Availability(False, "no vehicle holds the cable")
    if flight.setup.windows.can_release(flight.clock.time):
        return Availability(True, "releases the cable, separates upwards and lands")
    return Availability(
        True, "cable hangs above a vehicle: moves to where none does, then releases"
    )


def _rejoin(flight: FlightState) -> Availability:
    away = outside(flight)
    if not away:
        return Availability(False, "every vehicle that can get setpoints does")
    names = ", ".join(flight.name(flight.roster.vehicles[k]) for k in away)
    if not flight.clock.stopped:
        return Availability(False, f"the clock still runs: {names} can rejoin when the team holds")
    return Availability(True, f"returns {names} to the team, from its position, and holds")


def _abort(flight: FlightState) -> Availability:
    if flight.attached and flight.setup.windows.can_release(flight.clock.time):
        return Availability(True, "releases the cable here, separates upwards and lands")
    return Availability(True, "all descend straight down together, here")


def _do_hold(flight: FlightState) -> None:
    set_rewinding(flight, rewinding=False)
    hold(flight, OPERATOR, "operator command")


def _do_resume(flight: FlightState) -> None:
    set_rewinding(flight, rewinding=False)
    end_operator_hold(flight)


def _do_rewind(flight: FlightState) -> None:
    end_operator_hold(flight)
    set_rewinding(flight, rewinding=True)


def _do_land(flight: FlightState) -> None:
    leave_the_plan(flight, Response.LAND, "operator command: land")


def _do_release(flight: FlightState) -> None:
    leave_the_plan(flight, Response.RELEASE, "operator command: release")


def _do_abort(flight: FlightState) -> None:
    """Choose the quickest end that drops no cable on a rotor."""
    release = flight.attached and flight.setup.windows.can_release(flight.clock.time)
    response = Response.RELEASE if release else Response.LAND_HERE
    leave_the_plan(flight, response, "operator command: abort", move=False)


def _do_kill(flight: FlightState) -> None:
    mark_failed(flight, "killed by the operator")
    for k, vehicle in enumerate(flight.roster.vehicles):
        stop_stream(flight, k)
        vehicle.kill()
    expect_armed(flight, armed=False)
    if flight.stage is Stage.EXECUTE:
        words = "killed by the operator"
        leave_the_plan(flight, Response.LAND_HERE, words, announced="all motors stopped")


def _do_interrupt(flight: FlightState) -> None:
    again = mark_interrupted(flight)
    if flight.stage in {Stage.PREPARE, Stage.READY}:
        finish(flight, "interrupted", "interrupted before anything was armed")
    elif flight.stage is Stage.RESUME:
        finish(flight, "interrupted", "interrupted before the team was found")
    elif flight.stage is Stage.EXECUTE and (again or flight.progress.waiting):
        response = Response.LAND_HERE if again else Response.LAND
        leave_the_plan(flight, response, "interrupted")
    elif flight.stage is Stage.EXECUTE:
        set_rewinding(flight, rewinding=False)
        hold(flight, OPERATOR, "interrupted")


_ACTIONS: Mapping[Request, Callable[[FlightState], None]] = {
    "hold": _do_hold,
    "resume": _do_resume,
    "rewind": _do_rewind,
    "land": _do_land,
    "release": _do_release,
    "rejoin": rejoin,
    "abort": _do_abort,
    "kill": _do_kill,
    "interrupt": _do_interrupt,
}
