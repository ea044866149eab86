"""What the operator may ask for, what it would do now, and whether its window is open."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Literal, NamedTuple, get_args

from swarm.flight.options import rewind_limit

if TYPE_CHECKING:
    from swarm.flight.conductor import Conductor

Request = Literal["hold", "resume", "rewind", "land", "release", "abort", "kill", "interrupt"]
REQUESTS: tuple[Request, ...] = get_args(Request)


class Wish(NamedTuple):
    """Whether a wish can be granted now, and what would follow, in words."""

    open: bool
    words: str


def available(flight: "Conductor") -> Mapping[Request, Wish]:
    """Return what each wish would do at this moment of the flight."""
    if flight.stage == "finished":
        return dict.fromkeys(REQUESTS, Wish(False, "the flight is over"))
    if flight.stage in {"prepare", "ready"}:
        closed = Wish(False, "nothing flies yet")
        end = Wish(True, "ends here: nothing is armed")
        return {**dict.fromkeys(REQUESTS, closed), "interrupt": end, "abort": closed}
    kill = Wish(True, "stops all motors at once, wherever they are")
    interrupt = Wish(True, "holds, then lands everybody together; again: lands at once")
    if flight.leaving:
        closed = Wish(False, "the team is leaving the plan already")
        return {**dict.fromkeys(REQUESTS, closed), "kill": kill, "interrupt": interrupt}
    return {
        "hold": _hold(flight),
        "resume": _resume(flight),
        "rewind": _rewind(flight),
        "land": _land(flight),
        "release": _release(flight),
        "abort": _abort(flight),
        "kill": kill,
        "interrupt": interrupt,
    }


def _hold(flight: "Conductor") -> Wish:
    if flight.holding:
        return Wish(False, f"already holding: {flight.holding}")
    limit = flight.fleet.limits.hold
    return Wish(True, f"everybody stops along the path; after {limit:g} s all land together")


def _resume(flight: "Conductor") -> Wish:
    if not flight.holding:
        return Wish(False, "nothing is on hold")
    return Wish(True, "goes on with the plan")


def _rewind(flight: "Conductor") -> Wish:
    gate_before = flight.gates[flight.gate - 1].time if flight.gate else 0.0
    end = rewind_limit(flight.phase, gate_before, flight.budget_kept_since)
    if end is None:
        return Wish(False, f"the phase {flight.phase.name} does not run backwards")
    if flight.waiting:
        return Wish(False, "the clock waits at a gate")
    back = flight.clock.time - end
    if back < 0.5:
        return Wish(False, "this is as far back as it is safe")
    return Wish(True, f"goes back along the path by up to {back:.0f} s, then holds")


def _land(flight: "Conductor") -> Wish:
    can_land, _ = flight.options.at(flight.clock.time)
    if can_land:
        return Wish(True, "everybody straight down together, here")
    return Wish(True, "somebody is above somebody: moves to where all can land, then lands")


def _release(flight: "Conductor") -> Wish:
    if not any(vehicle.gripped for vehicle in flight.flyers):
        return Wish(False, "nobody holds the cable")
    _, can_release = flight.options.at(flight.clock.time)
    if can_release:
        return Wish(True, "drops the cable, separates upwards and lands")
    return Wish(True, "cable hangs above a vehicle: moves to where it does not, then releases")


def _abort(flight: "Conductor") -> Wish:
    _, can_release = flight.options.at(flight.clock.time)
    held = any(vehicle.gripped for vehicle in flight.flyers)
    if held and can_release:
        return Wish(True, "drops the cable here, separates upwards and lands")
    return Wish(True, "everybody straight down together, here")
