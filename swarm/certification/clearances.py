"""The smallest clearances of a plan over continuous time, for every tracking error within the ball.

Each kind of clearance is a family of pairs with an evaluator that bounds the margin of a pair over
an interval of time; :func:`swarm.certification.branch_and_bound.smallest` bisects. "Certified"
means: in the quasi-static cable model, every segment the catenary of its length between its two
grip points.
"""

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from swarm.certification.bodies import Body, VehiclePairs, VehicleStrands, vehicle_segments
from swarm.certification.branch_and_bound import (
    TOLERANCE,
    Boxes,
    Evaluator,
    Minima,
    holds,
    roots,
    short_boxes,
    smallest,
)
from swarm.certification.ellipsoid_bounds import ReachPairs, ReachVehicles
from swarm.certification.fence import BlownInsideFence, InsideFence
from swarm.certification.held import (
    BELOW,
    LYING,
    Above,
    AsItHung,
    BesideRotors,
    DrawnOut,
    Held,
    Spans,
    held,
)
from swarm.certification.limits import AboveFloor, AccelerationLeft, Slack, SpeedLeft
from swarm.certification.motion_bounds import Course
from swarm.certification.strands import HeldCable, StrandPairs, all_pairs
from swarm.planning import Plan

Floats = npt.NDArray[np.float64]
Place = tuple[float, float, float]
Progress = Callable[[str, float], None]

STILL_AIR = (0.0, 0.0, -1.0)
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
    ``required`` what is asked; both metres. ``time`` and ``where`` tell where it was found. The
    distance is −∞ where nothing could be shown.
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


def violations(plan: Plan, checks: Collection[str]) -> tuple[Moment, ...]:
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
    return not held(plan).problems and all(
        holds(family.evaluate, family.roots()) for family in families(plan, tracking, down)
    )


def moments_of(family: Family, tolerance: float = TOLERANCE) -> list[Moment]:
    """Return the tightest moments of a family, at most five, tightest first, to a tolerance."""
    minima = smallest(family.evaluate, len(family.names), family.roots(), tolerance=tolerance)
    moments: list[Moment] = []
    for pair in minima.tightest():
        if family.names[pair] in (moment.between for moment in moments):
            continue  # of the two entries of a pair of neighbours, the tighter one came first
        moments.append(_moment(family, pair, minima, pair))
    return moments


def _moment(family: Family, pair: int, minima: Minima, entry: int) -> Moment:
    x, y, z = (float(value) for value in np.nan_to_num(minima.place[entry]))
    return Moment(
        check=family.check,
        between=family.names[pair],
        distance=float(minima.low[entry]) + family.required,
        required=family.required,
        time=float(minima.time[entry]),
        where=(x, y, z),
    )


def families(plan: Plan, tracking: float, down: Place) -> tuple[Family, ...]:
    """Return everything that must keep apart, with when and how far; no family is empty."""
    course, cable_held = Course(plan.motion), held(plan)
    cable = HeldCable(course, plan.layout.lengths, tracking, down)
    every = (
        *_strands(plan, cable, cable_held),
        *_on_the_floor(plan, cable, cable_held),
        *_vehicles(plan, course, tracking),
        *_bodies(plan, cable, cable_held),
        *_fences(plan, cable, cable_held),
    )
    return tuple(family for family in every if family.spans and family.names)


def _always(plan: Plan) -> Spans:
    return [(float(plan.motion.times[0]), float(plan.motion.times[-1]))]


def _segments(plan: Plan, other: str) -> list[tuple[str, str]]:
    return [(segment_name(i), other) for i in range(plan.vehicles - 1)]


def _each_vehicle(plan: Plan, other: str) -> list[tuple[str, str]]:
    return [(vehicle_name(i), other) for i in range(plan.vehicles)]


def _strands(plan: Plan, cable: HeldCable, when: Held) -> tuple[Family, ...]:
    """Strands that hang: not taut, apart, and above the floor."""
    clearance, diameter = plan.mission.clearance, plan.mission.cable.diameter
    pairs, parts = all_pairs(plan.layout.lengths, beyond_shared_vehicle(plan))
    neighbours = pairs[:, 1] == pairs[:, 0] + 1

    def apart(which: npt.NDArray[np.bool_], check: str) -> Family:
        names = [(segment_name(i), segment_name(j)) for i, j in pairs[which]]
        evaluate = StrandPairs(cable, pairs[which], parts[which], diameter, clearance.cable)
        return Family(check, names, clearance.cable, when.aloft, evaluate)

    return (
        Family("taut", _segments(plan, "its length"), 0.0, when.hanging, Slack(cable)),
        apart(~neighbours, "cable clearance"),
        apart(neighbours, "neighbouring segments"),
        Family(
            "floor", _segments(plan, "the floor"), clearance.floor, when.aloft,
            AboveFloor(cable, diameter, clearance.floor),
        ),
    )  # fmt: skip


def _on_the_floor(plan: Plan, cable: HeldCable, when: Held) -> tuple[Family, ...]:
    """Cable that lies or is lifted as a line, and a knot that comes down: that it is so, and apart.

    What the model says of cable that hangs is not asked where these hold.
    """
    clearance, vehicles = plan.mission.clearance, plan.mission.vehicles
    course, diameter = cable.course, plan.mission.cable.diameter
    first, second = np.triu_indices(plan.vehicles - 1, 2)
    apart = np.stack([first, second], axis=1)
    other, _ = vehicle_segments(plan.vehicles)
    half = 0.5 * diameter
    rim = max(vehicles.grip_offset - half, 0.0) / (vehicles.radius + half)
    line = [(segment_name(i), segment_name(i + 1)) for i in range(plan.vehicles - 2)]
    begins = np.array([start for start, _ in when.landing])
    return (
        Family(
            "reach on the floor", [(segment_name(i), segment_name(j)) for i, j in apart],
            clearance.cable, when.low, ReachPairs(cable, apart, diameter, clearance.cable),
        ),
        Family(
            "reach on the floor", [(vehicle_name(i), segment_name(j)) for i, j in other],
            clearance.vehicle_cable, when.low,
            ReachVehicles(
                cable, other, vehicles.radius, vehicles.grip_offset, diameter,
                clearance.vehicle_cable,
            ),
        ),
        Family(
            "over-stretched on the floor", _segments(plan, "its length"), 0.0, when.dragged,
            Slack(HeldCable(course, plan.layout.lengths, 0.0), share=1.0),
        ),
        Family(
            "lying", _each_vehicle(plan, "the floor"), 0.0, when.dragged,
            Above(course, LYING, -1.0),
        ),
        Family("drawn out", line, 0.0, when.low, DrawnOut(course)),
        Family(
            "beside rotors", _segments(plan, "its vehicles"), 0.0, when.low,
            BesideRotors(course, cable.tracking, rim),
        ),
        Family(
            "straight down", _each_vehicle(plan, "the others"), 0.0, when.landing,
            AsItHung(course, begins),
        ),
    )  # fmt: skip


def _vehicles(plan: Plan, course: Course, tracking: float) -> tuple[Family, ...]:
    """Vehicles by themselves: apart, on or above the floor, and below the ceiling."""
    mission, always = plan.mission, _always(plan)
    clearance = mission.clearance
    team = np.stack(np.triu_indices(plan.vehicles, 1), axis=1)
    return (
        Family(
            "vehicle clearance", [(vehicle_name(i), vehicle_name(j)) for i, j in team],
            clearance.vehicle, always,
            VehiclePairs(course, team, tracking, clearance.vehicle, clearance.downwash),
        ),
        Family(
            "ground", _each_vehicle(plan, "the floor"), 0.0, always, Above(course, -BELOW, 1.0),
        ),
        Family(
            "ceiling", _each_vehicle(plan, "the ceiling"), 0.0, always,
            Above(
                course,
                mission.workspace.ceiling - mission.vehicles.grip_offset - tracking,
                sign=-1.0,
            ),
        ),
    )  # fmt: skip


def _bodies(plan: Plan, cable: HeldCable, when: Held) -> tuple[Family, ...]:
    """Vehicles and cable that hangs."""
    vehicles = plan.mission.vehicles
    other, own = vehicle_segments(plan.vehicles)
    body = Body(vehicles.radius, vehicles.grip_offset)

    def bodies(chosen: npt.NDArray[np.intp], check: str, required: float) -> Family:
        names = [(vehicle_name(i), segment_name(j)) for i, j in chosen]
        evaluate = VehicleStrands(
            cable, chosen, body, plan.mission.cable.diameter, np.full(len(chosen), required)
        )
        return Family(check, names, required, when.aloft, evaluate)

    return (
        bodies(other, "vehicle-cable clearance", plan.mission.clearance.vehicle_cable),
        bodies(own, "rotor disc", 0.0),
    )


def limits(plan: Plan) -> tuple[Family, ...]:
    """Return the limits of vehicles' motion: their margins are m/s and m/s², not metres.

    Of the acceleration, what braking along the path needs is kept: a setpoint's acceleration is
    r²a + ṙv at the clock's rate r. Every piece of the motion is looked at by itself, since jerk is
    bounded within pieces only.
    """
    vehicles = plan.mission.vehicles
    course = Course(plan.motion)
    pieces = list(pairwise(plan.motion.times.tolist()))
    names = _each_vehicle(plan, "")
    reserve = vehicles.max_acceleration - vehicles.braking_acceleration
    return (
        Family("speed", names, 0.0, pieces, SpeedLeft(course, vehicles.max_speed)),
        Family("acceleration", names, 0.0, pieces, AccelerationLeft(course, reserve)),
    )


def _fences(plan: Plan, cable: HeldCable, when: Held) -> tuple[Family, ...]:
    """Vehicles and held cable within the fence; in wind only cable that hangs free, as it leans."""
    if plan.mission.workspace.fence is None:
        return ()
    fence = np.array(plan.mission.workspace.fence)
    who, diameter = np.arange(plan.vehicles), plan.mission.cable.diameter
    course, tracking = cable.course, cable.tracking
    reach = np.full(len(who) - 1, 0.5 * diameter)
    upright = InsideFence(course, tracking, fence, who[:-1], who[1:], reach)
    if math.hypot(*cable.down[:2]) > 0.0:
        leaning = BlownInsideFence(cable, fence, diameter)
        strands = Family("fence", _segments(plan, "the fence"), 0.0, when.aloft, leaning)
    else:
        strands = Family("fence", _segments(plan, "the fence"), 0.0, when.ever, upright)
    radius = np.full(len(who), plan.mission.vehicles.radius)
    return (
        Family(
            "fence", _each_vehicle(plan, "the fence"), 0.0, _always(plan),
            InsideFence(course, tracking, fence, who, who, radius),
        ),
        strands,
    )  # fmt: skip
