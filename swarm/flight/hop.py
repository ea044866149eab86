"""A short hop: everybody straight up from its pad, hovering, and down again, with nothing attached.

How well vehicles hover is what a plan's tracking ball must hold; it is measured, not believed.
"""

import numpy as np

from swarm.errors import Refused
from swarm.flight.flight_plan import CableFreeFlight
from swarm.flight.trace import Trace
from swarm.plans import Gate, Phase, Plan
from swarm.preflight.certify import CertifiedPlan, certify, without_cable
from swarm.preflight.findings import Finding
from swarm.trajectory import at_rest, followed, leg

HEIGHT = 2.0
"""Metres by which grip points rise."""
HOVER = 15.0
"""Seconds of hovering."""
_SPEED = 0.5


def hop(proven: CertifiedPlan) -> CableFreeFlight:
    """Return the hop of a plan's vehicles from the plan's pads.

    Straight up and down from pads at rest, so that only their distances count; raises
    :class:`Refused` where pads are nearer than the mission's clearance and its tracking allow.
    """
    plan = proven.plan
    mission = plan.mission
    vehicles, clearance = mission.vehicles, mission.clearance
    pads = plan.motion.at(0.0)[0]
    first, second = np.triu_indices(len(pads), 1)
    apart = np.linalg.norm(pads[first, :2] - pads[second, :2], axis=1) - 2.0 * vehicles.tracking
    nearest = float(apart.min(initial=np.inf))
    if nearest < clearance.vehicle:
        raise Refused(
            f"pads are {nearest:.2f} m apart with tracking errors; a hop needs "
            f"{clearance.vehicle:g} m"
        )
    up = pads + np.array([0.0, 0.0, HEIGHT])
    thrust = 0.5 * (vehicles.max_acceleration - vehicles.braking_acceleration)
    speed = min(_SPEED, vehicles.max_speed)
    parts = {
        "takeoff": leg(pads, up, speed, thrust),
        "hold": at_rest(up, HOVER),
        "land": leg(up, pads, speed, thrust),
    }
    phases, clock = [], 0.0
    for name, part in parts.items():
        end = clock + float(part.times[-1] - part.times[0])
        phases.append(Phase(name, clock, end, "free", False))  # type: ignore[arg-type]
        clock = end
    gates = (
        Gate(0.0, "armed", 60.0),
        Gate(phases[0].end, "airborne", 20.0),
        Gate(phases[0].end, "settled", 30.0),
        Gate(clock, "landed", 60.0),
    )
    flown = Plan(
        mission=mission,
        knot=plan.knot,
        layout=plan.layout,
        motion=followed(*parts.values()),
        phases=tuple(phases),
        gates=gates,
        path=up,
        notes=("a hop: straight up and down, nothing attached",),
    )
    return CableFreeFlight(flown, certify(without_cable(flown)), "hop")


def hover_findings(trace: Trace, proven: CertifiedPlan) -> list[Finding]:
    """Return how well everybody hovered in a hop, against the plan's tracking ball and its e*.

    Errors are of reported positions: what an estimator does not see is not in them.
    """
    tracking = proven.plan.mission.vehicles.tracking
    limit = proven.assessment.robustness.tracking
    largest_allowed = tracking if limit is None else limit
    hovering = np.array([phase == "hold" for phase in trace.phase], dtype=bool)
    error = np.linalg.norm(trace.position[hovering] - trace.setpoint[hovering], axis=2)
    if not np.isfinite(error).any():
        return [Finding("error", "hop", "no positions were reported while hovering")]
    largest = np.nanmax(error, axis=0)
    rms = np.sqrt(np.nanmean(error**2, axis=0))
    findings = []
    for number, (most, typical) in enumerate(zip(largest.tolist(), rms.tolist(), strict=True), 1):
        words = f"vehicle {number} hovers within {most:.3f} m ({typical:.3f} m RMS)"
        if not most <= largest_allowed:
            words += f"; the plan holds up to {largest_allowed:g} m"
            findings.append(Finding("error", "hop", words))
        elif most > tracking:
            words += f"; the plan is certified for {tracking:g} m, would hold {largest_allowed:g} m"
            findings.append(Finding("warning", "hop", words))
        else:
            findings.append(Finding("info", "hop", f"{words}; certified for {tracking:g} m"))
    return findings
