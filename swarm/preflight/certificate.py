"""The smallest clearances of a plan over continuous time, for every tracking error within the ball.

Each kind of clearance is a family of pairs with an evaluator that bounds the margin of a pair over
an interval of time; :func:`swarm.preflight.search.smallest` bisects. "Certified" means: in the
quasi-static cable model, every segment the catenary of its length between its two grip points.
"""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from swarm.plans import Phase, Plan
from swarm.preflight.bodies import Body, VehiclePairs, VehicleStrands, vehicle_segments
from swarm.preflight.course import Course
from swarm.preflight.limits import (
    AboveFloor,
    AccelerationLeft,
    BelowCeiling,
    InsideFence,
    Slack,
    SpeedLeft,
)
from swarm.preflight.reach import ReachPairs, ReachVehicles
from swarm.preflight.search import Boxes, Evaluator, Minima, holds, roots, short_boxes, smallest
from swarm.preflight.strands import HeldCable, StrandPairs, all_pairs

Floats = npt.NDArray[np.float64]
Spans = list[tuple[float, float]]
Place = tuple[float, float, float]
Progress = Callable[[str, float], None]

STILL_AIR = (0.0, 0.0, -1.0)
_DRAGGED = frozenset({"contract", "spread"})
"""Phases in which the cable is held and drawn along the floor."""

ROOT = 1.0
"""Seconds; the widest interval that is tried."""


CLEARANCES = (
    "cable clearance",
    "neighbouring segments",
    "reach on the floor",
    "vehicle clearance",
    "vehicle-cable clearance",
    "rotor disc",
    "floor",
)
"""Checks whose moments are distances to compare, for the five that are always reported."""


@dataclass(frozen=True)
class Moment:
    """The tightest moment of two things.

    ``distance`` is the certified lower bound over the whole plan, within the tracking ball;
    ``required`` what is asked; both metres. ``time`` and ``where`` tell where it was found.
    """

    check: str
    between: tuple[str, str]
    distance: float
    required: float
    time: float
    where: Place

    @property
    def margin(self) -> float:
        """What is left of the distance after the requirement; negative where it fails."""
        return self.distance - self.required


@dataclass(frozen=True)
class Family:
    """Pairs of one kind whose margins are bounded together."""

    check: str
    names: Sequence[tuple[str, str]]
    required: float
    spans: Spans
    evaluate: Evaluator

    def roots(self) -> Boxes:
        """Return boxes of a root's width for all pairs over all spans of time."""
        return roots(len(self.names), self.spans, ROOT)


def segment_name(index: int) -> str:
    """Name a segment, counted from 1 along the cable."""
    return f"segment {index + 1}"


def vehicle_name(index: int) -> str:
    """Name a vehicle, counted from 1 along the cable."""
    return f"vehicle {index + 1}"


def beyond_shared_vehicle(plan: Plan) -> float:
    """Cable, in metres, on either side of a vehicle that counts as being in its hand.

    Neighbouring segments meet at their vehicle; from this arc length on each must keep the cable
    clearance from all of the other, so they have to diverge at about 15° or more.
    """
    mission = plan.mission
    return 4.0 * (mission.clearance.cable + mission.cable.diameter + mission.vehicles.tracking)


def tightest_moments(
    plan: Plan,
    *,
    tracking: float | None = None,
    down: Place = STILL_AIR,
    checks: Sequence[str] | None = None,
    progress: Progress | None = None,
) -> tuple[Moment, ...]:
    """Return the tightest moments of each kind of clearance, at most five per kind.

    ``tracking`` replaces the mission's; ``down`` is the unit vector of the effective gravity;
    ``checks`` names the kinds to look at (default: all).
    """
    if tracking is None:
        tracking = plan.mission.vehicles.tracking
    wanted = [
        family
        for family in families(plan, tracking, down)
        if checks is None or family.check in checks
    ]
    found: list[Moment] = []
    for done, family in enumerate(wanted):
        if progress:
            progress("certificate", done / len(wanted))
        found += moments_of(family)
    if progress:
        progress("certificate", 1.0)
    return tuple(found)


def shortfalls(plan: Plan, checks: Collection[str]) -> tuple[Moment, ...]:
    """Return where clearances of the named checks do not hold.

    Of every pair, the worst moment of every second or less in which it fails: what is to be mended.
    """
    found: list[Moment] = []
    for family in families(plan, plan.mission.vehicles.tracking, STILL_AIR):
        if family.check in checks:
            found += _short(family)
    return tuple(found)


def _short(family: Family) -> list[Moment]:
    seconds = family.roots()
    minima = short_boxes(family.evaluate, seconds)
    failing = np.flatnonzero(minima.low < 0.0)
    return [_moment(family, int(seconds.pair[k]), minima, int(k)) for k in failing]


def certified(plan: Plan, *, tracking: float, down: Place = STILL_AIR) -> bool:
    """Whether every clearance holds with that tracking ball and effective gravity.

    Much quicker than :func:`tightest_moments`, since it measures nothing beyond yes and no.
    """
    return all(holds(family.evaluate, family.roots()) for family in families(plan, tracking, down))


def moments_of(family: Family) -> list[Moment]:
    """Return the tightest moments of a family, at most five, tightest first."""
    minima = smallest(family.evaluate, len(family.names), family.roots())
    moments: list[Moment] = []
    for pair in minima.tightest():
        if family.names[pair] in (moment.between for moment in moments):
            continue  # of the two entries of a pair of neighbours, the tighter one came first
        moments.append(_moment(family, pair, minima, pair))
    return moments


def _moment(family: Family, pair: int, minima: Minima, entry: int) -> Moment:
    x, y, z = (float(value) for value in minima.place[entry])
    return Moment(
        check=family.check,
        between=family.names[pair],
        distance=float(minima.low[entry]) + family.required,
        required=family.required,
        time=float(minima.time[entry]),
        where=(x, y, z),
    )


def spans_of(plan: Plan, chosen: Callable[[Phase], bool]) -> Spans:
    """Return start and end of the phases that are chosen, adjoining ones as one."""
    spans: Spans = []
    for phase in plan.phases:
        if not chosen(phase) or phase.end <= phase.start:
            continue
        if spans and spans[-1][1] == phase.start:
            spans[-1] = (spans[-1][0], phase.end)
        else:
            spans.append((phase.start, phase.end))
    return spans


def families(plan: Plan, tracking: float, down: Place) -> tuple[Family, ...]:
    """Return everything that must keep apart, with when and how far; no family is empty."""
    mission, count = plan.mission, plan.vehicles
    clearance, vehicles, diameter = mission.clearance, mission.vehicles, mission.cable.diameter
    course = Course(plan.motion)
    cable = HeldCable(course, plan.layout.lengths, tracking, down)
    aloft = spans_of(plan, lambda phase: phase.cable == "aloft")
    low = spans_of(plan, lambda phase: phase.cable == "lifting" or phase.name in _DRAGGED)
    held = spans_of(plan, lambda phase: phase.cable in {"aloft", "lifting", "landing"})
    always = [(float(plan.motion.times[0]), float(plan.motion.times[-1]))]

    pairs, parts = all_pairs(plan.layout.lengths, beyond_shared_vehicle(plan))
    neighbours = pairs[:, 1] == pairs[:, 0] + 1
    apart = pairs[~neighbours]
    team = np.stack(np.triu_indices(count, 1), axis=1)
    other, own = vehicle_segments(count)
    segments = [(segment_name(i), "its length") for i in range(count - 1)]

    def strands(which: npt.NDArray[np.bool_], check: str) -> Family:
        names = [(segment_name(i), segment_name(j)) for i, j in pairs[which]]
        evaluate = StrandPairs(cable, pairs[which], parts[which], diameter, clearance.cable)
        return Family(check, names, clearance.cable, aloft, evaluate)

    def bodies(chosen: npt.NDArray[np.intp], check: str, required: float) -> Family:
        names = [(vehicle_name(i), segment_name(j)) for i, j in chosen]
        evaluate = VehicleStrands(
            cable, chosen, Body(vehicles.radius, vehicles.grip_offset), diameter,
            np.full(len(chosen), required),
        )  # fmt: skip
        return Family(check, names, required, aloft, evaluate)

    every = (
        Family(
            "taut", segments, 0.0, held, Slack(cable),
        ),
        strands(~neighbours, "cable clearance"),
        strands(neighbours, "neighbouring segments"),
        Family(
            "reach on the floor",
            [(segment_name(i), segment_name(j)) for i, j in apart],
            clearance.cable, low, ReachPairs(cable, apart, diameter, clearance.cable),
        ),
        Family(
            "reach on the floor",
            [(vehicle_name(i), segment_name(j)) for i, j in other],
            clearance.vehicle_cable,
            low,
            ReachVehicles(
                cable,
                other,
                vehicles.radius,
                vehicles.grip_offset,
                diameter,
                clearance.vehicle_cable,
            ),
        ),
        Family(
            "over-stretched on the floor",
            segments,
            0.0,
            spans_of(plan, lambda phase: phase.name in _DRAGGED),
            Slack(HeldCable(course, plan.layout.lengths, 0.0), share=1.0),
        ),
        Family(
            "vehicle clearance",
            [(vehicle_name(i), vehicle_name(j)) for i, j in team],
            clearance.vehicle, always,
            VehiclePairs(course, team, tracking, clearance.vehicle, clearance.downwash),
        ),
        bodies(other, "vehicle-cable clearance", clearance.vehicle_cable),
        bodies(own, "rotor disc", 0.0),
        Family(
            "floor", [(segment_name(i), "the floor") for i in range(count - 1)],
            clearance.floor, aloft, AboveFloor(cable, diameter, clearance.floor),
        ),
        Family(
            "ceiling", [(vehicle_name(i), "the ceiling") for i in range(count)], 0.0, always,
            BelowCeiling(course, tracking, mission.workspace.ceiling, vehicles.grip_offset),
        ),
        *_fences(plan, course, tracking, aloft, always),
    )  # fmt: skip
    return tuple(family for family in every if family.spans and family.names)


def limits(plan: Plan) -> tuple[Family, ...]:
    """Return the limits of vehicles' motion: their margins are m/s and m/s², not metres.

    Of the acceleration, what braking along the path needs is kept: a setpoint's acceleration is
    r²a + ṙv at the clock's rate r.
    """
    vehicles = plan.mission.vehicles
    course = Course(plan.motion)
    always = [(float(plan.motion.times[0]), float(plan.motion.times[-1]))]
    names = [(vehicle_name(i), "") for i in range(plan.vehicles)]
    reserve = vehicles.max_acceleration - vehicles.braking_acceleration
    return (
        Family("speed", names, 0.0, always, SpeedLeft(course, vehicles.max_speed)),
        Family("acceleration", names, 0.0, always, AccelerationLeft(course, reserve)),
    )


def _fences(
    plan: Plan, course: Course, tracking: float, aloft: Spans, always: Spans
) -> tuple[Family, ...]:
    if plan.mission.workspace.fence is None:
        return ()
    fence = np.array(plan.mission.workspace.fence)
    who = np.arange(plan.vehicles)
    half = 0.5 * plan.mission.cable.diameter
    radius = plan.mission.vehicles.radius
    return (
        Family(
            "fence", [(vehicle_name(i), "the fence") for i in range(len(who))], 0.0, always,
            InsideFence(course, tracking, fence, who, who, np.full(len(who), radius)),
        ),
        Family(
            "fence", [(segment_name(i), "the fence") for i in range(len(who) - 1)], 0.0, aloft,
            InsideFence(course, tracking, fence, who[:-1], who[1:], np.full(len(who) - 1, half)),
        ),
    )  # fmt: skip
