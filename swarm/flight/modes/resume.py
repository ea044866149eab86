"""Resume a flight whose ground station ended: find the team in the air, and go on from there."""

from dataclasses import replace

import numpy as np

from swarm.flight.ending import finish
from swarm.flight.failures import OPERATOR
from swarm.flight.holds import hold
from swarm.flight.modes.contingency import leave_the_plan
from swarm.flight.modes.rejoin import rejoin
from swarm.flight.modes.transitions import change_stage
from swarm.flight.operator import request
from swarm.flight.policy import Response
from swarm.flight.preparation import request_streams
from swarm.flight.progress import begin_search, first_time, resume_at
from swarm.flight.resuming import LeftOff
from swarm.flight.stages import Trigger
from swarm.flight.state import FlightState
from swarm.flight.streams import expect_armed
from swarm.mavlink.vehicle import Vehicle

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
    """Search the team; once all vehicles are received, go on where they are, and hold."""
    left = flight.resumption.left_off
    if left is None:
        raise ValueError("this flight was not interrupted")
    if first_time(flight, -1, "search"):
        begin_search(flight)
    for k, vehicle in enumerate(flight.roster.vehicles):
        if flight.received(vehicle) and first_time(flight, k, "streams"):
            request_streams(vehicle, flight.setup.fleet)
    if missing := _missing(flight):
        if flight.now - flight.progress.gate_since > flight.setup.fleet.limits.hold:
            names = ", ".join(flight.name(vehicle) for vehicle in missing)
            finish(flight, "failed", f"not found: {names}; each vehicle lands by its failsafe")
        return
    if disarmed := [vehicle for vehicle in flight.roster.vehicles if not vehicle.armed]:
        names = ", ".join(flight.name(vehicle) for vehicle in disarmed)
        finish(flight, "failed", f"no longer flying: {names}; the others land by their failsafes")
        return
    time, off = _place_in_plan(flight, left)
    _go_on(flight, left, time)
    flight.report(
        "resume", f"found the team at {time:.1f} s of the plan, up to {off:.2f} m from it"
    )
    landing = any(vehicle.in_mode("land") for vehicle in flight.roster.vehicles)
    if landing or off > LARGEST:
        why = "vehicles already land" if landing else f"a vehicle is {off:.1f} m from its place"
        words = f"the flight cannot be resumed: {why}"
        leave_the_plan(flight, Response.LAND_HERE, words)
        return
    hold(flight, OPERATOR, "the flight is resumed")
    rejoin(flight)


def follow_order(flight: FlightState) -> None:
    """Do what the operator ordered in advance, once all vehicles follow again."""
    then, streams = flight.resumption.then, flight.streams
    if then == "hold" or streams.rejoining or not streams.active.all():
        return
    flight.resumption = replace(flight.resumption, then="hold")
    request(flight, "resume" if then == "continue" else then)


def _missing(flight: FlightState) -> list[Vehicle]:
    return [
        vehicle
        for vehicle in flight.roster.vehicles
        if not (flight.received(vehicle, FRESH) and flight.now - vehicle.position_at < FRESH)
        or vehicle.autopilot is None
    ]


def _go_on(flight: FlightState, left: LeftOff, time: float) -> None:
    """Continue the plan at a mission time, at rest; no vehicle gets setpoints yet."""
    flight.clock.time = time
    flight.clock.set_stopped()
    resume_at(flight, left.gate)
    expect_armed(flight)
    for vehicle in flight.roster.vehicles:
        vehicle.gripped = left.gripped
        vehicle.take_events()
    change_stage(flight, Trigger.TEAM_FOUND)


def _place_in_plan(flight: FlightState, left: LeftOff) -> tuple[float, float]:
    """Return the mission time around the last one that fits best, and the largest distance."""
    gates, plan = flight.setup.gates, flight.setup.plan
    low = gates[left.gate - 1].time if left.gate else 0.0
    high = gates[left.gate].time if left.gate < len(gates) else plan.duration
    times = np.arange(
        max(low, left.mission_time - AROUND), min(high, left.mission_time + AROUND), _STEP
    )
    if not len(times):
        times = np.array([left.mission_time])
    apart = plan.motion.at(times)[0] - flight.observation.position
    off = np.linalg.norm(apart, axis=2).max(axis=1)
    best = int(np.argmin(off))
    return float(times[best]), float(off[best])
