"""The table of clearances: a row for each kind, which everything else walks.

A row states which objects are compared, what is required of them and when; by which bound the
certificate shows it (branch and bound, :mod:`.minima`), and whether wind, swing and tracking errors
count in that; the place of its margin in :mod:`.team_margins`, by which the live monitor and the
certificate of lost setpoints compare it; how it is measured at reported positions; which margin of
a schedule a repair enlarges; and its name in messages, files and reports.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final, Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from swarm.certification.bodies import Body, VehiclePairs, VehicleStrands, vehicle_segments
from swarm.certification.branch_and_bound import Boxes, Evaluator
from swarm.certification.cable_spans import LYING, CableSpans, Spans, all_pairs, exempt_length
from swarm.certification.distances import (
    Tightest,
    closest_segments,
    closest_vehicle_and_segment,
    closest_vehicles,
    segment_name,
    vehicle_name,
)
from swarm.certification.far_apart import FarPairs, FarVehicles
from swarm.certification.limits import (
    AboveFloor,
    DerivativeLimit,
    HeightLimit,
    InsideFence,
    InsideFenceInWind,
    Slack,
)
from swarm.certification.minima import TOLERANCE, Intervals, failing, roots
from swarm.certification.motion_bounds import BoundedMotion
from swarm.certification.on_the_floor import (
    BELOW,
    BesideRotors,
    DrawnOut,
    ReachPairs,
    ReachVehicles,
    RigidDescent,
)
from swarm.certification.strand_pieces import HeldCable
from swarm.certification.strands import StrandPairs
from swarm.certification.team_margins import (
    BODIES,
    CEILING,
    CHORDS,
    DISCS,
    FENCE,
    FLOOR,
    NEIGHBOURS,
    STRANDS,
    VEHICLES,
)
from swarm.geometry.catenary import MAX_CHORD_RATIO
from swarm.mission import Mission
from swarm.planning import Plan
from swarm.planning.phase_motion import usable_acceleration

Floats = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]
Names = list[tuple[str, str]]

_STRAND: Final = ((0.0, 1.0),)
"""Interval of the fractions of a strand."""

_LIMIT_TOLERANCE: Final = 1e-4
"""m/s and m/s²; to which the largest speeds and accelerations are computed: a tenth of the last
digit that findings show."""

ROOT = 1.0
"""Largest width in seconds of an initial box; bounds of wider ones are too weak to be of use."""

When = Literal[
    "always", "held", "dragged", "low", "lifted or hanging", "hanging", "aloft", "landing", "pieces"
]
_TIMES: Final[Mapping[str, str]] = {
    "always": "always",
    "pieces": "always",
    "held": "held",
    "dragged": "on the floor",
    "low": "on the floor, lifted",
    "lifted or hanging": "lifted, aloft, landing",
    "hanging": "aloft, landing",
    "aloft": "aloft",
    "landing": "landing",
}
"""The spans of time in which a kind applies, in words."""


class Case(NamedTuple):
    """What is certified: a plan, the spans of its cable, and the held cable in its motion.

    The cable has the tracking radius, the largest tilt of gravity and the tube of the swing.
    """

    plan: Plan
    spans: CableSpans
    cable: HeldCable

    @property
    def motion(self) -> BoundedMotion:
        """The motion with its bounds."""
        return self.cable.motion

    def during(self, when: When) -> Spans:
        """Return spans of mission time."""
        times, spans = self.plan.motion.times, self.spans
        match when:
            case "always":
                return [(float(times[0]), float(times[-1]))]
            case "pieces":
                return list(pairwise(times.tolist()))
            case "held":
                return spans.ever
            case "hanging":
                return spans.suspended
            case "lifted or hanging":
                return spans.hanging
            case _:
                found: Spans = getattr(spans, when)
                return found

    def segments(self, other: str) -> Names:
        """Return the names of each segment and another object."""
        return [(segment_name(i), other) for i in range(self.plan.vehicles - 1)]

    def vehicles(self, other: str) -> Names:
        """Return the names of each vehicle and another object."""
        return [(vehicle_name(i), other) for i in range(self.plan.vehicles)]


@dataclass(frozen=True)
class Family:
    """Pairs of one kind whose margins are bounded together.

    ``others`` are the intervals of the coordinates beside time into which the evaluator divides a
    pair. ``far`` tells for initial boxes whether their margins are shown to be positive without a
    search. ``tolerance`` is the difference of reported and true margins at which a search may end.
    """

    kind: "Kind"
    names: Sequence[tuple[str, str]]
    required: float
    spans: Intervals
    evaluate: Evaluator
    others: Intervals = ()
    far: Callable[[Boxes], Flags] | None = None
    tolerance: float = TOLERANCE

    @property
    def check(self) -> str:
        """The name of its kind in findings."""
        return self.kind.check

    def failing(self) -> tuple[int, float] | None:
        """Return pair and time of a margin that is not shown to be kept, if any."""
        boxes, initial = self.doubtful()
        return failing(self.evaluate, boxes, initial, self.tolerance)

    def doubtful(self) -> tuple[Boxes, int]:
        """Return the initial boxes whose margins may be negative, and the number of all."""
        boxes = self.roots()
        initial = len(boxes)
        return boxes if self.far is None else boxes.taken(~self.far(boxes)), initial

    def roots(self) -> Boxes:
        """Return the initial boxes for all pairs over all spans of time."""
        return roots(len(self.names), self.spans, ROOT, self.others)


class Bound(NamedTuple):
    """The pairs of objects of a kind by their names, and what bounds their margins.

    The other fields as in :class:`.Family`; ``spans`` replace those of the kind.
    """

    names: Names
    evaluate: Evaluator
    others: Intervals = ()
    far: Callable[[Boxes], Flags] | None = None
    tolerance: float = TOLERANCE
    spans: Spans | None = None


@dataclass(frozen=True, eq=False)
class Kind:
    """One kind of clearance.

    ``check`` is its name in findings, files and errors; ``objects`` and ``rule`` say in words what
    is compared and required. ``bound`` makes its :class:`Bound` for a case and the required
    distance in metres, ``required``, at the times ``when``; None where a plan has no such objects.
    Margins have a ``unit``; those in metres count for e* and w*. Others are to a ``limit``.

    ``tracking``, ``wind`` and ``swing`` tell whether tracking errors, winds and the tube of the
    swing count in the bound. ``place`` is that of its margin in :mod:`.team_margins`, where the
    live monitor and the certificate of lost setpoints compare it. ``margin`` is the field of
    :class:`swarm.folding.penalty.ExtraMargins` that a repair enlarges; ``budget`` tells whether the
    clearance budget has rows of such pairs.

    ``failure`` is the message where it fails, by default for distances. Kinds that are ``listed``
    are distances that are reported together, tightest first. ``figure`` is the key under which
    files have the tightest moment of one or several kinds, ``words`` its name in reports;
    ``measured`` returns the smallest distance at grip points (k, n, 3) and mission times (k,).
    """

    check: str
    objects: str
    rule: str
    when: When
    bound: Callable[[Case, float], Bound | None]
    required: Callable[[Mission], float] = lambda _: 0.0
    limit: Callable[[Mission], float] = lambda _: 0.0
    unit: str = "m"
    tracking: bool = True
    wind: bool = False
    swing: bool = False
    place: int | None = None
    margin: str | None = None
    budget: bool = False
    failure: str = ""
    listed: bool = False
    figure: str = ""
    words: str = ""
    measured: Callable[[Plan, Floats, Floats], Tightest | None] | None = None

    def family(self, case: Case) -> Family | None:
        """Return its pairs with spans and required distance; None where it never applies."""
        required = self.required(case.plan.mission)
        bound = self.bound(case, required)
        if bound is None:
            return None
        spans = self.during(case) if bound.spans is None else bound.spans
        if not spans or not bound.names:
            return None
        return Family(
            self, bound.names, required, spans, bound.evaluate, bound.others, bound.far,
            bound.tolerance,
        )  # fmt: skip

    def during(self, case: Case) -> Spans:
        """Return the spans of mission time in which it applies."""
        return case.during(self.when)


def _chords(case: Case, _: float) -> Bound:
    return Bound(case.segments("its length"), Slack(case.cable))


def _two_segments(case: Case, required: float, *, neighbours: bool) -> Bound:
    plan, cable = case.plan, case.cable
    every, every_part = all_pairs(plan.layout.lengths, exempt_length(plan), once=bool(cable.tilts))
    chosen = (every[:, 1] == every[:, 0] + 1) == neighbours
    pairs, parts, diameter = every[chosen], every_part[chosen], plan.mission.cable.diameter
    return Bound(
        [(segment_name(i), segment_name(j)) for i, j in pairs],
        StrandPairs(cable, pairs, parts, diameter, required),
        (*cable.tilts, *_STRAND, *_STRAND),
        # Boxes around neighbours, which meet at their vehicle, are never apart.
        None if neighbours else FarPairs(cable, pairs, required + diameter),
    )


def _segments_apart(case: Case, required: float) -> Bound:
    return _two_segments(case, required, neighbours=False)


def _neighbours_apart(case: Case, required: float) -> Bound:
    return _two_segments(case, required, neighbours=True)


def _above_floor(case: Case, required: float) -> Bound:
    cable = case.cable
    others = (*cable.tilts, *_STRAND) if cable.tilts else ()
    evaluate = AboveFloor(cable, case.plan.mission.cable.diameter, required)
    return Bound(case.segments("the floor"), evaluate, others)


def _reach_of_segments(case: Case, required: float) -> Bound:
    first, second = np.triu_indices(case.plan.vehicles - 1, 2)
    pairs = np.stack([first, second], axis=1)
    names = [(segment_name(i), segment_name(j)) for i, j in pairs]
    return Bound(names, ReachPairs(case.cable, pairs, case.plan.mission.cable.diameter, required))


def _reach_of_vehicles(case: Case, required: float) -> Bound:
    mission = case.plan.mission
    pairs, _ = vehicle_segments(case.plan.vehicles)
    return Bound(
        [(vehicle_name(i), segment_name(j)) for i, j in pairs],
        ReachVehicles(
            case.cable, pairs, mission.vehicles.radius, mission.vehicles.grip_offset,
            mission.cable.diameter, required,
        ),
    )  # fmt: skip


def _not_overstretched(case: Case, _: float) -> Bound:
    cable = HeldCable(case.motion, case.plan.layout.lengths, 0.0)
    return Bound(case.segments("its length"), Slack(cable, share=1.0))


def _lying(case: Case, _: float) -> Bound:
    return Bound(case.vehicles("the floor"), HeightLimit(case.motion, LYING, -1.0))


def _drawn_out(case: Case, _: float) -> Bound:
    line = [(segment_name(i), segment_name(i + 1)) for i in range(case.plan.vehicles - 2)]
    return Bound(line, DrawnOut(case.motion))


def _beside_rotors(case: Case, _: float) -> Bound:
    vehicles, half = case.plan.mission.vehicles, 0.5 * case.plan.mission.cable.diameter
    rim = max(vehicles.grip_offset - half, 0.0) / (vehicles.radius + half)
    evaluate = BesideRotors(case.motion, case.cable.tracking, rim)
    return Bound(case.segments("its vehicles"), evaluate)


def _straight_down(case: Case, _: float) -> Bound:
    begins = np.array([start for start, _ in case.spans.landing])
    return Bound(case.vehicles("the others"), RigidDescent(case.motion, begins))


def _two_vehicles(case: Case, required: float) -> Bound:
    pairs = np.stack(np.triu_indices(case.plan.vehicles, 1), axis=1)
    downwash = case.plan.mission.clearance.downwash
    return Bound(
        [(vehicle_name(i), vehicle_name(j)) for i, j in pairs],
        VehiclePairs(case.motion, pairs, case.cable.tracking, required, downwash),
    )


def _above_ground(case: Case, _: float) -> Bound:
    evaluate = HeightLimit(case.motion, -BELOW, 1.0)
    return Bound(case.vehicles("the floor"), evaluate, tolerance=BELOW)


def _below_ceiling(case: Case, _: float) -> Bound:
    mission = case.plan.mission
    height = mission.workspace.ceiling - mission.vehicles.grip_offset - case.cable.tracking
    return Bound(case.vehicles("the ceiling"), HeightLimit(case.motion, height, sign=-1.0))


def _vehicle_and_segment(case: Case, required: float, *, own: bool) -> Bound:
    cable, mission = case.cable, case.plan.mission
    radius, height = mission.vehicles.radius, mission.vehicles.grip_offset
    diameter = mission.cable.diameter
    pairs = vehicle_segments(case.plan.vehicles)[1 if own else 0]
    distances = np.full(len(pairs), required)
    return Bound(
        [(vehicle_name(i), segment_name(j)) for i, j in pairs],
        VehicleStrands(cable, pairs, Body(radius, height), diameter, distances),
        (*cable.tilts, *_STRAND),
        None if own else FarVehicles(cable, pairs, radius, height, required + 0.5 * diameter),
    )


def _other_segments(case: Case, required: float) -> Bound:
    return _vehicle_and_segment(case, required, own=False)


def _own_segments(case: Case, required: float) -> Bound:
    return _vehicle_and_segment(case, required, own=True)


def _vehicles_inside(case: Case, _: float) -> Bound | None:
    mission, vehicles = case.plan.mission, np.arange(case.plan.vehicles)
    if mission.workspace.fence is None:
        return None
    fence = np.array(mission.workspace.fence)
    reach = np.full(len(vehicles), mission.vehicles.radius)
    evaluate = InsideFence(case.motion, case.cable.tracking, fence, vehicles, vehicles, reach)
    return Bound(case.vehicles("the fence"), evaluate)


def _segments_inside(case: Case, _: float) -> Bound | None:
    """In wind only cable that hangs free."""
    cable, mission, vehicles = case.cable, case.plan.mission, np.arange(case.plan.vehicles)
    if mission.workspace.fence is None:
        return None
    fence, names = np.array(mission.workspace.fence), case.segments("the fence")
    if cable.tilts:
        evaluate = InsideFenceInWind(cable, fence, mission.cable.diameter)
        others, spans = (*cable.tilts, *_STRAND), case.during("hanging")
        return Bound(names, evaluate, others, spans=spans)
    reach = np.full(len(vehicles) - 1, 0.5 * mission.cable.diameter)
    if cable.tube is not None:
        reach += cable.tube.whole.max(axis=0)
    ends = vehicles[:-1], vehicles[1:]
    return Bound(names, InsideFence(case.motion, cable.tracking, fence, *ends, reach))


def _speed(case: Case, _: float) -> Bound:
    evaluate = DerivativeLimit(case.motion, case.plan.mission.vehicles.max_speed, 1)
    return Bound(case.vehicles(""), evaluate, tolerance=_LIMIT_TOLERANCE)


def _acceleration(case: Case, _: float) -> Bound:
    """The reserve for braking along the path is not available: a setpoint's acceleration is
    r²a + ṙv at the clock's rate r."""
    evaluate = DerivativeLimit(case.motion, usable_acceleration(case.plan.mission), 2)
    return Bound(case.vehicles(""), evaluate, tolerance=_LIMIT_TOLERANCE)


def _cable(mission: Mission) -> float:
    return mission.clearance.cable


def _vehicle(mission: Mission) -> float:
    return mission.clearance.vehicle


def _vehicle_cable(mission: Mission) -> float:
    return mission.clearance.vehicle_cable


_BEYOND: Final = "{short:.3f} m beyond {other}: {one}{errors}"

KINDS: Final = (
    Kind(
        "taut", "chord and length", "the inequality above", "lifted or hanging", _chords,
        place=CHORDS, margin="chord",
        failure=f"{{short:.3f}} m of chord beyond {MAX_CHORD_RATIO:.1%} of the length of "
        "{one}{errors}",
    ),
    Kind(
        "cable clearance", "two segments that share no vehicle, surface to surface",
        "`clearance.cable`", "hanging", _segments_apart, _cable, wind=True, swing=True,
        place=STRANDS, margin="cable", budget=True, listed=True,
        figure="cable", words="cable to cable", measured=closest_segments,
    ),
    Kind(
        "neighbouring segments", "two segments that share a vehicle, beyond the exempt length",
        "`clearance.cable`", "hanging", _neighbours_apart, _cable, wind=True, swing=True,
        place=NEIGHBOURS, margin="neighbour", budget=True, listed=True, figure="cable",
        words="cable to cable",
    ),
    Kind(
        "floor", "a segment and the floor", "`clearance.floor`", "aloft", _above_floor,
        lambda mission: mission.clearance.floor, wind=True, swing=True, place=FLOOR, listed=True,
    ),
    Kind(
        "reach on the floor", "the reach of two segments that share no vehicle",
        "`clearance.cable`", "low", _reach_of_segments, _cable, listed=True,
    ),
    Kind(
        "reach on the floor", "a vehicle and the reach of others' segments",
        "`clearance.vehicle_cable`", "low", _reach_of_vehicles, _vehicle_cable, listed=True,
    ),
    Kind(
        "over-stretched on the floor", "chord and length on the floor", "no longer than the cable",
        "dragged", _not_overstretched, tracking=False,
        failure="{short:.3f} m of chord beyond the length of {one} on the floor",
    ),
    Kind(
        "lying", "a grip point with its cable on the floor", f"at most {LYING:g} m above it",
        "dragged", _lying, tracking=False,
        failure=f"{{one}} is more than {LYING:g} m above the floor while its cable must lie there",
    ),
    Kind(
        "drawn out", "two neighbouring chords in plan view", "within 60° of a line", "low",
        _drawn_out, tracking=False,
        failure="{one} and {other} are more than 60° off a line in plan view while cable can lie "
        "on the floor",
    ),
    Kind(
        "beside rotors", "chord and rotor discs", "less steep than the line from grip to rim",
        "low", _beside_rotors,
        failure="{one} is too steep beside the rotors of its vehicles while cable can lie on the "
        "floor",
    ),
    Kind(
        "straight down", "the shape of the team in a common descent", "unchanged", "landing",
        _straight_down, tracking=False,
        failure="{one} does not descend vertically together with the others: their knot would "
        "change its shape",
    ),
    Kind(
        "vehicle clearance", "two vehicles, centre to centre",
        "`clearance.vehicle` horizontally **or** `clearance.downwash` vertically", "always",
        _two_vehicles, _vehicle, place=VEHICLES, margin="vehicle", listed=True,
        figure="vehicle", words="vehicle to vehicle", measured=closest_vehicles,
    ),
    Kind(
        "ground", "a grip point and the floor", "above", "always", _above_ground, tracking=False,
        failure="{short:.3f} m below the floor: {one}",
    ),
    Kind(
        "ceiling", "a vehicle and the ceiling", "below", "always", _below_ceiling, place=CEILING,
        failure=_BEYOND,
    ),
    Kind(
        "vehicle-cable clearance", "a vehicle and the segments of others",
        "`clearance.vehicle_cable`", "hanging", _other_segments, _vehicle_cable, wind=True,
        swing=True, place=BODIES, margin="vehicle_cable", listed=True,
        figure="vehicle_cable", words="vehicle to cable", measured=closest_vehicle_and_segment,
    ),
    Kind(
        "rotor disc", "a vehicle and its own segments", "outside its rotor disc", "hanging",
        _own_segments, wind=True, swing=True, place=DISCS, margin="rotor_disc", listed=True,
        failure="{other} enters the rotor disc of its own {one}{errors}",
    ),
    Kind(
        "fence", "a vehicle and the fence", "inside", "always", _vehicles_inside, wind=True,
        place=FENCE, failure=_BEYOND,
    ),
    Kind(
        "fence", "a segment and the fence", "inside", "held", _segments_inside, wind=True,
        swing=True, place=FENCE, failure=_BEYOND,
    ),
    Kind(
        "speed", "speed", "`vehicles.max_speed`", "pieces", _speed,
        limit=lambda mission: mission.vehicles.max_speed, unit="m/s", tracking=False,
        failure="{reached:.3f} m/s for {one}{others}; {vehicles.max_speed:g} m/s allowed",
    ),
    Kind(
        "acceleration", "acceleration", "limit; braking along the path is kept in reserve",
        "pieces", _acceleration, limit=usable_acceleration, unit="m/s²", tracking=False,
        failure="{reached:.3f} m/s² for {one}{others}; {usable:g} m/s² "
        "allowed ({vehicles.max_acceleration:g} less {vehicles.braking_acceleration:g} to brake)",
    ),
)  # fmt: skip

FIGURES: Final[Mapping[str, str]] = {kind.figure: kind.words for kind in KINDS if kind.figure}
"""The keys of distances in files, and their names in reports."""

MEASURED: Final = {kind.figure: kind for kind in KINDS if kind.measured}
"""The kinds that are measured at reported positions, by the keys of their distances in files."""


def kind_of(check: str) -> Kind:
    """Return the first kind with the name of a check."""
    return next(kind for kind in KINDS if kind.check == check)


def required_distances(mission: Mission) -> dict[str, float]:
    """Return the required distances of what is measured, metres, by their keys in files."""
    return {figure: kind.required(mission) for figure, kind in MEASURED.items()}


def measured_distances(plan: Plan, place: Floats, time: Floats) -> dict[str, Tightest | None]:
    """Return the smallest distances at grip points (k, n, 3) and mission times (k,), by their keys.

    None where a plan has no two such objects, or without positions.
    """
    return {
        figure: kind.measured(plan, place, time) if kind.measured and len(place) else None
        for figure, kind in MEASURED.items()
    }


MATRIX: Final = (
    "certificate", "tracking errors", "wind", "swing", "lost setpoints", "live monitor", "budget",
    "flown", "repaired",
)  # fmt: skip
"""Columns of the matrix of who compares a kind, or what counts in it."""


def coverage(kind: Kind) -> tuple[str, ...]:
    """Return the cells of a kind in the MATRIX: when it is compared, yes, or no."""
    live = "aloft" if kind.when != "always" else "unless cable lies on the floor"
    counts = kind.tracking, kind.wind, kind.swing
    uses = kind.budget, kind.measured is not None, kind.margin is not None
    compared = kind.place is not None
    return (
        _TIMES[kind.when], *map(_yes, counts), "in the fold" if compared else "no",
        live if compared else "no", *map(_yes, uses),
    )  # fmt: skip


def _yes(applies: bool) -> str:
    return "yes" if applies else "no"


def coverage_table() -> str:
    """Return the matrix of all kinds as Markdown."""
    head = ("check", "objects", "required", *MATRIX)
    rows = [(kind.check, kind.objects, kind.rule, *coverage(kind)) for kind in KINDS]
    return (
        "\n".join(f"| {' | '.join(cells)} |" for cells in (head, ["---"] * len(head), *rows))
        .replace("| --- ", "|---")
        .replace("|--- |", "|---|")
    )
