"""The gates of a plan: what is asked of the team at each, and when it is passed.

A gate is begun once and then asked every tick. The table :data:`GATES` has one row per condition.
"""

import math
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from swarm.errors import Refused
from swarm.planning import Condition, Plan

if TYPE_CHECKING:
    from swarm.flight.conductor import Conductor
    from swarm.mavlink.vehicle import Vehicle

STREAM_BEFORE_OFFBOARD = 1.0
"""Seconds of setpoints before offboard mode is asked for (PX4 wants a stream first)."""
STREAM_AFTER_TAKEOFF = 0.8
"""Share of the take-off height at which an autopilot that took off by itself is streamed to."""
TAKEOFF_HEIGHT = 1.0
SETTLED_FOR = 1.0
SETTLED_SPEED = 0.3
DISARM_AFTER = 5.0


class Row(NamedTuple):
    """What to do when a gate is reached, and how to tell that it is passed."""

    begin: "Callable[[Conductor, float], None]"
    passed: "Callable[[Conductor, float], bool]"


def _nothing(_flight: "Conductor", _now: float) -> None:
    pass


def _armed(flight: "Conductor", now: float) -> bool:
    """Bring everybody into offboard mode, then arm, then take off where that is needed.

    Every step is taken by all before the next one begins, so that nobody sits armed and waiting
    longer than its disarm timer allows (PX4: COM_DISARM_PRFLT, 10 s from arming). Those that take
    off by themselves are armed first: the others wait on the ground until they have.
    """
    flyers = flight.flyers
    for k, vehicle in enumerate(flyers):
        if not vehicle.needs_takeoff_command:
            flight.stream(k)
    if now - flight.gate_since < STREAM_BEFORE_OFFBOARD:
        return False
    waiting = [vehicle for vehicle in flyers if not vehicle.in_mode("offboard")]
    if waiting and not any(vehicle.armed for vehicle in flyers):
        for vehicle in waiting:
            vehicle.set_mode("offboard")
        return False
    unarmed = [vehicle for vehicle in flyers if not vehicle.armed]
    if unarmed:
        for vehicle in [one for one in unarmed if one.needs_takeoff_command] or unarmed:
            vehicle.arm()
        return False
    flight.expect_armed()
    grounded = False
    for k, vehicle in enumerate(flyers):
        if not vehicle.needs_takeoff_command or flight.streaming[k]:
            continue
        height = flight.height_above_start(k)
        if height >= STREAM_AFTER_TAKEOFF * TAKEOFF_HEIGHT:
            flight.stream(k)
            continue
        grounded = True
        if flight.first_time(k, "takeoff"):
            vehicle.take_off(TAKEOFF_HEIGHT)
    return not grounded


def _airborne(flight: "Conductor", _now: float) -> bool:
    return all(v.airborne or v.landed_state == 0 for v in flight.flyers) and bool(
        np.all(flight.position[:, 2] > 0.3)
    )


def _gripped(flight: "Conductor", _now: float) -> bool:
    """Close the grippers one after the other, in order along the cable."""
    for vehicle in flight.flyers:
        if vehicle.gripped:
            continue
        if flight.grips:
            if vehicle.commands.idle:
                vehicle.grip(closed=True)
            return False
        vehicle.gripped = True
    return True


def _releasing(flight: "Conductor") -> "list[Vehicle]":
    """Who lets go at this gate: all, or all but those at the cable's ends."""
    return flight.flyers[1:-1] if flight.gates[flight.gate].inner else flight.flyers


def _release(flight: "Conductor", _now: float) -> None:
    for vehicle in _releasing(flight):
        if flight.grips:
            vehicle.grip(closed=False)
        else:
            vehicle.gripped = False


def _released(flight: "Conductor", _now: float) -> bool:
    return not any(vehicle.gripped for vehicle in _releasing(flight))


def _settled(flight: "Conductor", now: float) -> bool:
    near = flight.error <= max(flight.budget, 1e-9)
    slow = np.linalg.norm(flight.velocity, axis=1) <= SETTLED_SPEED
    if not bool(np.all(near & slow)):
        flight.settled_since = now
    if now - flight.settled_since < SETTLED_FOR:
        return False
    before_fold = flight.plan.phase_at(flight.gates[flight.gate].time + 1e-6).name == "fold"
    if before_fold and flight.first_time(0, "heights"):
        return _level(flight)
    return True


def _level(flight: "Conductor") -> bool:
    """Compare heights on the levelled line, before the fold: altitude is what decides the knot.

    Reported heights against each other, and each against its satellites since it stood on the
    ground, as far as those are good enough to tell. Holds for the operator where they disagree.
    """
    heights = flight.position[:, 2] - flight.setpoint[:, 2]
    words = f"levelled line: reported heights differ by up to {np.ptp(heights):.2f} m"
    gaps = np.array([vehicle.height_difference for vehicle in flight.flyers])
    moved = gaps - flight.reports.heights
    known = np.isfinite(moved)
    if known.sum() < 3:
        flight.say("heights", f"{words}; nothing else tells of heights")
        return True
    off = moved - np.median(moved[known])
    good_to = np.array([vehicle.vertical_accuracy for vehicle in flight.flyers])
    allowed = np.fmax(2.0 * good_to, flight.plan.mission.vehicles.tracking)
    worst = int(np.nanargmax(np.abs(off)))
    flight.say("heights", f"{words}; against satellites by up to {abs(off[worst]):.2f} m")
    wrong = np.flatnonzero(known & np.isfinite(good_to) & (np.abs(off) > allowed))
    if not len(wrong):
        return True
    names = ", ".join(
        f"{flight.name(flight.flyers[k])} by {off[k]:+.2f} m (good to {good_to[k]:.2f} m)"
        for k in wrong
    )
    flight.hold("operator", f"heights disagree with satellites before the fold: {names}")
    return False


def _begin_settling(flight: "Conductor", now: float) -> None:
    flight.settled_since = now


def _land(flight: "Conductor", _now: float) -> None:
    for vehicle in flight.flyers:
        vehicle.set_mode("land")


def _landed(flight: "Conductor", now: float) -> bool:
    flight.stop_streams_of_landing()
    for vehicle in flight.flyers:
        if vehicle.armed and vehicle.on_ground and now - flight.gate_since > DISARM_AFTER:
            vehicle.disarm()
    return not any(vehicle.armed for vehicle in flight.flyers)


GATES: Mapping[Condition, Row] = {
    "armed": Row(_nothing, _armed),
    "airborne": Row(_nothing, _airborne),
    "gripped": Row(_nothing, _gripped),
    "settled": Row(_begin_settling, _settled),
    "released": Row(_release, _released),
    "landed": Row(_land, _landed),
}


def check_rest(plan: Plan) -> None:
    """Raise :class:`Refused` where the plan moves at a gate, at which the clock would stop dead."""
    for gate in plan.gates:
        _, velocity, acceleration = plan.motion.at(gate.time)
        fastest = float(np.linalg.norm(velocity, axis=1).max())
        strongest = float(np.linalg.norm(acceleration, axis=1).max())
        if not (fastest <= 1e-3 and strongest <= 0.05 and math.isfinite(gate.timeout)):
            raise Refused(
                f"the plan moves at the gate at {gate.time:.2f} s "
                f"({fastest:.3f} m/s, {strongest:.3f} m/s²); it must rest there"
            )
