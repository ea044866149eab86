"""From a detected failure to the team's response, as the policy says."""

from swarm.flight import policy
from swarm.flight.detect import STALLED
from swarm.flight.ending import mark_failed
from swarm.flight.failures import Failure, Finding, HoldCause, Recovery
from swarm.flight.holds import end_failures, hold
from swarm.flight.modes.contingency import (
    leave_the_plan,
    release_fallen,
    release_if_open,
    stop_here,
)
from swarm.flight.observing import shift_frame
from swarm.flight.policy import Response
from swarm.flight.state import FlightState
from swarm.flight.streams import stop_stream


def respond(flight: FlightState, finding: Finding) -> None:
    """Respond to a failure or to the end of one."""
    if isinstance(finding, Recovery):
        _recover(flight, finding)
    else:
        _fail(flight, finding)


def _recover(flight: FlightState, recovery: Recovery) -> None:
    vehicle = None if recovery.vehicle is None else flight.roster.vehicles[recovery.vehicle]
    end_failures(flight, recovery.kinds, vehicle.system if vehicle else None)
    flight.report(recovery.event, recovery.message, vehicle)


def _fail(flight: FlightState, failure: Failure) -> None:
    kind, k, message = failure.kind, failure.vehicle, failure.message
    row, vehicle = policy.TABLE[kind], None if k is None else flight.roster.vehicles[k]
    if row.ends_stream and k is not None:
        stop_stream(flight, k)
    if failure.jump is not None and k is not None:
        shift_frame(flight, k, failure.jump, kind)
    if failure.known:
        return
    flight.report("failure", f"{kind}: {message}", vehicle)
    if row.irreversible:
        mark_failed(flight, _with_cause(flight, failure))
    match policy.response_to(kind, flight.stage):
        case Response.REPORT:
            pass
        case Response.HOLD:
            hold(flight, HoldCause(kind, vehicle.system if vehicle else None), message)
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
