"""What the operator may ask for, what it would do now, and whether its window is open."""

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Literal, NamedTuple, get_args

from swarm.flight.pace import rewind_end
from swarm.flight.rejoining import outside, rejoin

if TYPE_CHECKING:
    from swarm.flight.conductor import Conductor

Request = Literal[
    "hold", "resume", "rewind", "land", "release", "rejoin", "abort", "kill", "interrupt"
]
REQUESTS: tuple[Request, ...] = get_args(Request)


class Availability(NamedTuple):
    """Whether a wish can be granted now, and what would follow, in words."""

    open: bool
    words: str


def available(flight: "Conductor") -> Mapping[Request, Availability]:
    """Return what each wish would do at this moment of the flight."""
    if flight.stage == "finished":
        return dict.fromkeys(REQUESTS, Availability(False, "the flight is over"))
    if flight.stage == "find":
        closed = Availability(False, "the team has not been found yet")
        end = Availability(True, "ends here: everybody lands by itself after the fleet's hold time")
        return {**dict.fromkeys(REQUESTS, closed), "interrupt": end}
    if flight.stage in {"prepare", "ready"}:
        closed = Availability(False, "nothing flies yet")
        end = Availability(True, "ends here: nothing is armed")
        return {**dict.fromkeys(REQUESTS, closed), "interrupt": end, "abort": closed}
    kill = Availability(True, "stops all motors at once, wherever they are")
    interrupt = Availability(True, "holds, then lands everybody together; again: lands at once")
    if flight.leaving:
        closed = Availability(False, "the team is leaving the plan already")
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


def _hold(flight: "Conductor") -> Availability:
    if flight.holding:
        return Availability(False, f"already holding: {flight.holding}")
    limit = flight.fleet.limits.hold
    return Availability(
        True, f"everybody stops along the path; after {limit:g} s all land together"
    )


def _resume(flight: "Conductor") -> Availability:
    if not flight.holding:
        return Availability(False, "nothing is on hold")
    return Availability(True, "goes on with the plan")


def _rewind(flight: "Conductor") -> Availability:
    if not flight.phase.reversible:
        return Availability(False, f"the phase {flight.phase.name} does not run backwards")
    if flight.waiting:
        return Availability(False, "the clock waits at a gate")
    back = flight.clock.time - rewind_end(flight)
    if back < 0.5:
        return Availability(False, "this is as far back as it is safe")
    return Availability(True, f"goes back along the path by up to {back:.0f} s, then holds")


def _land(flight: "Conductor") -> Availability:
    if flight.windows.can_land(flight.clock.time):
        return Availability(True, "everybody straight down together, here")
    return Availability(True, "somebody is above somebody: moves to where all can land, then lands")


def _release(flight: "Conductor") -> Availability:
    if not any(vehicle.gripped for vehicle in flight.flyers):
        return Availability(False, "nobody holds the cable")
    if flight.windows.can_release(flight.clock.time):
        return Availability(True, "drops the cable, separates upwards and lands")
    return Availability(
        True, "cable hangs above a vehicle: moves to where it does not, then releases"
    )


def _rejoin(flight: "Conductor") -> Availability:
    away = outside(flight)
    if not away:
        return Availability(False, "everybody who can be streamed to is")
    names = ", ".join(flight.name(flight.flyers[k]) for k in away)
    if not flight.clock.stopped:
        return Availability(False, f"the clock still runs: {names} can rejoin a team that holds")
    return Availability(True, f"takes {names} into the team again, from where it is, and holds")


def _abort(flight: "Conductor") -> Availability:
    held = any(vehicle.gripped for vehicle in flight.flyers)
    if held and flight.windows.can_release(flight.clock.time):
        return Availability(True, "drops the cable here, separates upwards and lands")
    return Availability(True, "everybody straight down together, here")


def _grant_hold(flight: "Conductor") -> None:
    flight.rewinding = False
    flight.hold("operator", "the operator asked")


def _grant_resume(flight: "Conductor") -> None:
    flight.rewinding = False
    flight.holds.pop("operator", None)


def _grant_rewind(flight: "Conductor") -> None:
    flight.holds.pop("operator", None)
    flight.rewinding = True


def _grant_land(flight: "Conductor") -> None:
    flight.leave("land", "the operator asked to land", move=True)


def _grant_release(flight: "Conductor") -> None:
    flight.leave("release", "the operator asked to release", move=True)


def _grant_rejoin(flight: "Conductor") -> None:
    rejoin(flight)


def _grant_abort(flight: "Conductor") -> None:
    """The quickest end that drops nothing on anybody."""
    held = any(vehicle.gripped for vehicle in flight.flyers)
    can_release = flight.windows.can_release(flight.clock.time)
    flight.leave("release" if held and can_release else "land", "the operator aborted", move=False)


def _grant_kill(flight: "Conductor") -> None:
    flight.fail("killed by the operator")
    for k, vehicle in enumerate(flight.flyers):
        flight.streaming[k] = False
        vehicle.kill()
    flight.expected_armed[:] = False
    if flight.stage == "fly":
        flight.leave("land", "killed by the operator", move=False, told="all motors stopped")


def _grant_interrupt(flight: "Conductor") -> None:
    again, flight.interrupted = flight.interrupted, True
    if flight.stage in {"prepare", "ready"}:
        flight.finish_as("interrupted", "interrupted before anything was armed")
    elif flight.stage == "find":
        flight.finish_as("interrupted", "interrupted before the team was found")
    elif flight.stage == "fly" and (again or flight.waiting):
        flight.leave("land", "interrupted", move=not again)
    elif flight.stage == "fly":
        flight.rewinding = False
        flight.hold("operator", "interrupted")


GRANT: Mapping[Request, "Callable[[Conductor], None]"] = {
    "hold": _grant_hold,
    "resume": _grant_resume,
    "rewind": _grant_rewind,
    "land": _grant_land,
    "release": _grant_release,
    "rejoin": _grant_rejoin,
    "abort": _grant_abort,
    "kill": _grant_kill,
    "interrupt": _grant_interrupt,
}
