"""A team that has left the plan, and moves along it to where it can land or release.

It moves no faster than in the plan: errors, clearances and a loss of setpoints slow it down. Where
it cannot move on, or a vehicle flies without setpoints, it stops where it is.
"""

import math
from dataclasses import replace

from swarm.flight.detect.standstill import STOPPED_RATE
from swarm.flight.modes.windows import not_following, unanswering
from swarm.flight.observing import follow_swing, monitor
from swarm.flight.pace import advance_clock, allowed_pace
from swarm.flight.policy import Response
from swarm.flight.stages import Step
from swarm.flight.state import Contingency, FlightState

ARRIVED = 0.1
"""Seconds of mission time between the clock and its target at which the team has arrived."""


def contingency_of(flight: FlightState) -> Contingency:
    """Return the flight outside the plan; raises ValueError while the team flies the plan."""
    if flight.contingency is None:
        raise ValueError("the team has not left the plan")
    return flight.contingency


def stopped(flight: FlightState, contingency: Contingency, message: str) -> Contingency:
    """Return the contingency of a team that moves no farther along the plan, and report it.

    A team that was to release elsewhere releases here only where no cable hangs above a rotor.
    """
    if contingency.target is None or contingency.step is not Step.APPROACH:
        return contingency
    flight.report("contingency", f"stopping here: {message}")
    releases = contingency.response is Response.RELEASE
    response = Response.RELEASE_HERE if releases else contingency.response
    return replace(contingency, target=None, response=response)


def move_on(flight: FlightState) -> Contingency:
    """Let the clock move towards the chosen moment; return the contingency after it."""
    follow_swing(flight)
    monitor(flight)
    contingency = _notice_motion(flight, _notice_alone(flight, contingency_of(flight)))
    flight.clock.urgent, flight.clock.target = True, _rate(flight, contingency.target)
    advance_clock(flight)
    return contingency


def at_rest(flight: FlightState) -> bool:
    """Return whether the team rests at the chosen moment, or where it must stop."""
    late = flight.now - contingency_of(flight).step_since > flight.setup.fleet.limits.hold
    return flight.clock.stopped and (late or _arrived(flight, contingency_of(flight)))


def _arrived(flight: FlightState, contingency: Contingency) -> bool:
    target = contingency.target
    return target is None or abs(target - flight.clock.time) < ARRIVED


def _rate(flight: FlightState, target: float | None) -> float:
    """Return the clock's rate towards a mission time, as slow as in the plan where that is needed.

    The team waits for a vehicle that is silent or returns to offboard mode: one that does not
    follow must not be left behind.
    """
    clock = flight.clock
    left = 0.0 if target is None else target - clock.time
    if abs(left) < 0.02 or _any_silent(flight) or _rejoins(flight):
        return 0.0
    braking = 0.5 * math.sqrt(2.0 * clock.steepest * abs(left))
    return math.copysign(min(allowed_pace(flight, backwards=left < 0.0), braking), left)


def _any_silent(flight: FlightState) -> bool:
    return not all(flight.received(vehicle) for vehicle in flight.roster.vehicles)


def _rejoins(flight: FlightState) -> bool:
    return bool(flight.streams.rejoining) or flight.guidance.blending


def _notice_alone(flight: FlightState, contingency: Contingency) -> Contingency:
    alone = tuple(not_following(flight))
    if alone == contingency.alone:
        return contingency
    contingency = replace(contingency, alone=alone, alone_since=flight.now)
    return stopped(flight, contingency, "a vehicle flies without setpoints")


def _notice_motion(flight: FlightState, contingency: Contingency) -> Contingency:
    """Take note that the team moves on, has arrived, or waits for a vehicle.

    One that receives nothing soon lands by itself: the others must not descend before it.
    """
    moves = abs(flight.clock.rate) >= STOPPED_RATE
    waits = _any_silent(flight) or bool(unanswering(flight)) or _rejoins(flight)
    if moves or waits or _arrived(flight, contingency):
        return replace(contingency, moving_at=flight.now)
    return contingency
