"""Flights without cable: a hop that measures the vehicles, and a plan raised for vehicles that
cannot hold a cable.

In a test hop all vehicles go straight up from their pads, hover, and land. Its errors decide the
tracking radius with which to plan (`vehicles.tracking`). They neither slow nor hold the clock, but
all vehicles land where one error exceeds ERROR_LIMIT, or two vehicles are nearer to each other than
the mission allows.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from swarm.certification.assessment import rounded_down
from swarm.certification.certificate import CertifiedPlan, certify, without_cable
from swarm.certification.findings import Finding
from swarm.errors import Refused
from swarm.flight.flight_plan import CableFreeFlight, FlightPlan
from swarm.flight.trace import Trace
from swarm.geometry.motion import Motion, at_rest, concatenate, leg
from swarm.mission.fleet import Fleet
from swarm.planning import Gate, Phase, Plan

Floats = npt.NDArray[np.float64]

HEIGHT = 2.0
"""Metres by which grip points rise."""
SETTLE = 5.0
"""Seconds at the top before the measurement begins: take-off has its own errors."""
HOVER = 30.0
"""Seconds of hovering that are measured. Errors of an estimator last for some 4 s (PX4 1.16, SIH),
so that each vehicle shows about seven independent ones."""
ERROR_LIMIT = 1.5
"""Metres of tracking error beyond which all land: a quarter of the height remains below then. The
worst of nine PX4 1.16 in their own simulator was 1.3 m off once in a minute."""
SPREAD = 4.0
"""Tracking radius for planning per RMS error: one in a hundred flights of a minute with nine
vehicles exceeds it, where errors are normal, along one direction, and independent every 3 s."""
_SPEED = 0.5
"""m/s up and down: only the hover at the top is measured."""


def hop(flight_plan: FlightPlan) -> CableFreeFlight:
    """Return the hop of a plan's vehicles from the plan's pads.

    Straight up and down from pads at rest, so that only their distances count; raises
    :class:`Refused` where pads are nearer than the mission's clearance and its tracking allow, or
    where the ceiling is too low.
    """
    plan = flight_plan.plan
    mission = plan.mission
    vehicles, clearance = mission.vehicles, mission.clearance
    pads = plan.motion.at(0.0)[0]
    nearest = _nearest(pads) - 2.0 * vehicles.tracking
    if nearest < clearance.vehicle:
        raise Refused(
            f"pads are {nearest:.2f} m apart with tracking errors; a hop needs "
            f"{clearance.vehicle:g} m"
        )
    up = pads + np.array([0.0, 0.0, HEIGHT])
    highest = float(up[:, 2].max()) + vehicles.grip_offset + ERROR_LIMIT
    if highest > mission.workspace.ceiling:
        raise Refused(
            f"a hop may go up to {highest:.1f} m; the ceiling is {mission.workspace.ceiling:g} m"
        )
    thrust = 0.5 * (vehicles.max_acceleration - vehicles.braking_acceleration)
    speed = min(_SPEED, vehicles.max_speed)
    parts = {
        "takeoff": concatenate(leg(pads, up, speed, thrust), at_rest(up, SETTLE)),
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
        Gate(phases[0].end - SETTLE, "airborne", 20.0),
        Gate(clock, "landed", 60.0),
    )
    flown = Plan(
        mission=mission,
        knot=plan.knot,
        layout=plan.layout,
        motion=concatenate(*parts.values()),
        phases=tuple(phases),
        gates=gates,
        path=up,
        notes=("a hop: straight up and down, no cable attached",),
    )
    flown = without_cable(flown)
    return CableFreeFlight(flown, certify(flown), "hop")


def _nearest(pads: Floats) -> float:
    """Return the smallest level distance between pads (n, 3), metres."""
    first, second = np.triu_indices(len(pads), 1)
    apart = np.linalg.norm(pads[first, :2] - pads[second, :2], axis=1)
    return float(apart.min(initial=np.inf))


@dataclass(frozen=True)
class ErrorSize:
    """Errors in metres: root of their mean square, and the largest."""

    rms: float
    largest: float


@dataclass(frozen=True)
class Hover:
    """The hover errors of a vehicle (counted from 1): horizontal, vertical, and both together.

    ``seconds`` is the duration of the measurement.
    """

    vehicle: int
    seconds: float
    level: ErrorSize
    up: ErrorSize
    both: ErrorSize

    @property
    def tracking(self) -> float:
        """Tracking radius in metres to plan with: the largest error, or SPREAD times the RMS."""
        return max(self.both.largest, SPREAD * self.both.rms)


def hovers(trace: Trace) -> tuple[Hover, ...]:
    """Return the hover errors of each vehicle in a hop; vehicles without positions are left out.

    Errors are of reported positions, without the errors of the estimator itself.
    """
    hovering = np.array([phase == "hold" for phase in trace.phase], dtype=bool)
    times = trace.time[hovering]
    error = trace.position[hovering] - trace.setpoint[hovering]
    measured = []
    for k in range(trace.position.shape[1]):
        known = np.isfinite(error[:, k]).all(axis=1)
        if known.any():
            off_by, when = error[known, k], times[known]
            measured.append(
                Hover(
                    vehicle=k + 1,
                    seconds=float(when[-1] - when[0]),
                    level=_spread(np.hypot(off_by[:, 0], off_by[:, 1])),
                    up=_spread(np.abs(off_by[:, 2])),
                    both=_spread(np.linalg.norm(off_by, axis=1)),
                )
            )
    return tuple(measured)


def _spread(sizes: Floats) -> ErrorSize:
    return ErrorSize(float(np.sqrt(np.mean(sizes**2))), float(sizes.max()))


def tracking_to_plan_with(measured: Sequence[Hover], vehicles: int) -> float | None:
    """Return the `vehicles.tracking` that the worst vehicle needs, metres, rounded up to 0.01.

    None where one of the ``vehicles`` was not measured for all of HOVER.
    """
    if len(measured) < vehicles or min(hover.seconds for hover in measured) < 0.9 * HOVER:
        return None
    return math.ceil(100.0 * max(hover.tracking for hover in measured) - 1e-9) / 100.0


def hover_findings(trace: Trace, flight_plan: CertifiedPlan) -> list[Finding]:
    """Return the hover errors of all vehicles against a plan's tracking radius and its e*.

    First the tracking radius to plan with, then each vehicle's errors.
    """
    measured, vehicles = hovers(trace), flight_plan.plan.vehicles
    if not measured:
        return [Finding("error", "hop", "no positions were reported while hovering")]
    tracking = flight_plan.plan.mission.vehicles.tracking
    limit = flight_plan.assessment.robustness.tracking
    most = tracking if limit is None else max(tracking, limit)
    held = f"{rounded_down(most, 2):.2f} m"
    findings = [_advice(measured, tracking_to_plan_with(measured, vehicles), tracking, most)]
    for hover in measured:
        words = (
            f"vehicle {hover.vehicle}: level {hover.level.rms:.3f} m RMS, "
            f"{hover.level.largest:.3f} m at most; up {hover.up.rms:.3f} m RMS, "
            f"{hover.up.largest:.3f} m at most"
        )
        if hover.both.largest > most:
            words += f"; the plan holds up to {held}"
            findings.append(Finding("error", "hop", words))
        elif hover.both.largest > tracking:
            words += f"; the plan is certified for {tracking:g} m, would hold {held}"
            findings.append(Finding("warning", "hop", words))
        else:
            findings.append(Finding("info", "hop", words))
    return findings


def _advice(
    measured: Sequence[Hover], needed: float | None, tracking: float, most: float
) -> Finding:
    """Return the `vehicles.tracking` that is needed to plan with, and whether the plan has it."""
    if needed is None:
        words = f"not all vehicles hovered for {HOVER:g} s: no vehicles.tracking to plan with"
        return Finding("error", "hop", words)
    rms, largest = (
        max(getattr(hover.both, name) for hover in measured) for name in ("rms", "largest")
    )
    words = (
        f"plan with vehicles.tracking of {needed:.2f} m at least: the larger of {SPREAD:g} × "
        f"{rms:.3f} m (RMS of the worst vehicle) and {largest:.3f} m (largest error); "
        f"the plan has {tracking:g} m"
    )
    if needed <= tracking:
        return Finding("info", "hop", words)
    if largest <= most:
        return Finding("warning", "hop", f"{words} and would hold {rounded_down(most, 2):.2f} m")
    return Finding("error", "hop", f"{words} and holds up to {rounded_down(most, 2):.2f} m")


RAISED = 1.0
"""Metres. Vehicles stand on their legs when they grab the cable; simulated ones drift by up to half
a metre, and an autopilot that is pressed on the ground detects a landing."""

_AT_REST = 1e-6
"""Speed below which a breakpoint is a rest, m/s: rounding leaves less."""


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
    """Return the plan whose first climb, from rest to rest, goes RAISED higher.

    It takes as much longer as the least climb becomes higher, so that no vehicle is faster.
    """
    times, coefficients = plan.motion.times.copy(), plan.motion.coefficients.copy()
    places, velocities, _ = plan.motion.at(times)
    rest = 1 + int(np.argmax(np.abs(velocities[1:]).max(axis=(1, 2)) < _AT_REST))
    low, high = places[0, :, 2], places[rest, :, 2]
    higher = 1.0 + RAISED / (high - low)
    longer = float(higher.max())
    climb = coefficients[:rest]
    climb[:, 0, :, 2] -= low
    climb[..., 2] *= higher
    climb[:, 0, :, 2] += low
    climb /= longer ** np.arange(6)[:, None, None]
    coefficients[rest:, 0, :, 2] += RAISED
    delay = (longer - 1.0) * float(times[rest] - times[0])
    times[:rest] = times[0] + longer * (times[:rest] - times[0])
    times[rest:] += delay

    def later(time: float) -> float:
        return time + delay if time > plan.motion.times[0] else time

    return replace(
        plan,
        motion=Motion(times, coefficients),
        phases=tuple(replace(p, start=later(p.start), end=later(p.end)) for p in plan.phases),
        gates=tuple(replace(gate, time=later(gate.time)) for gate in plan.gates),
    )
