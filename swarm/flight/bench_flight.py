"""The same flight for vehicles that cannot hold a cable: raised, with larger errors allowed."""

from dataclasses import replace

import numpy as np

from swarm.certification.certificate import CertifiedPlan, certify, without_cable
from swarm.flight.flight_plan import CableFreeFlight
from swarm.geometry.motion import Motion
from swarm.mission.fleet import Fleet
from swarm.planning import Plan

RAISED = 1.0
"""Metres. Vehicles stand on their legs when they grab the cable; simulated ones drift by up to half
a metre, and an autopilot that is pressed on the ground detects a landing."""


def is_bare(fleet: Fleet, *, no_cable: bool) -> bool:
    """Return whether the vehicles cannot hold a cable, as simulated ones: only they can collide."""
    return no_cable and fleet.gripper == "none"


def raised(
    flight_plan: CertifiedPlan, fleet: Fleet, *, no_cable: bool
) -> CertifiedPlan | CableFreeFlight:
    """Return a plan for vehicles that cannot hold a cable, flown RAISED higher.

    It is certified again, without cable. It is the plan itself where it does not descend to the
    floor between take-off and landing, or where the ceiling is too low.
    """
    plan = flight_plan.plan
    highest = float(plan.motion.at(plan.motion.times)[0][..., 2].max()) + RAISED
    grabs = any(phase.name == "grab" for phase in plan.phases)
    fits = highest + plan.mission.vehicles.grip_offset <= plan.mission.workspace.ceiling
    if not (is_bare(fleet, no_cable=no_cable) and grabs and fits):
        return flight_plan
    lifted = _lifted(plan)
    return CableFreeFlight(lifted, certify(without_cable(lifted)), "raised")


def _lifted(plan: Plan) -> Plan:
    """Return the plan whose first piece, from rest to rest, climbs RAISED higher.

    It takes as much longer as the least climb becomes higher, so that no vehicle is faster.
    """
    times, coefficients = plan.motion.times.copy(), plan.motion.coefficients.copy()
    first = float(times[1] - times[0])
    low, high = plan.motion.at(times[:2])[0][..., 2]
    longer = 1.0 + RAISED / float((high - low).min())
    coefficients[0] /= longer ** np.arange(6)[:, None, None]
    powers = (longer * first) ** np.arange(3, 6)
    coefficients[0, 3:, :, 2] += RAISED * (np.array([10.0, -15.0, 6.0]) / powers)[:, None]
    coefficients[1:, 0, :, 2] += RAISED
    delay = (longer - 1.0) * first
    times[1:] += delay

    def later(time: float) -> float:
        return time + delay if time > plan.motion.times[0] else time

    return replace(
        plan,
        motion=Motion(times, coefficients),
        phases=tuple(replace(p, start=later(p.start), end=later(p.end)) for p in plan.phases),
        gates=tuple(replace(gate, time=later(gate.time)) for gate in plan.gates),
    )
