"""The table of clearances: a row for each kind, which everything else walks.

A row states which objects are compared, what is required of them and when; by which bound the
certificate shows it (branch and bound, :mod:`.minima`), and whether wind, swing and tracking errors
count in that; the place of its margin in :mod:`.team_margins`, by which the live monitor and the
certificate of lost setpoints compare it; how it is measured at reported positions; which margin of
a schedule a repair enlarges; and its name in messages, files and reports.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Final, Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from swarm.certification.bodies import (
    Body,
    vehicle_segments,
    vehicles_and_strands,
    vehicles_apart,
)
from swarm.certification.branch_and_bound import Boxes, Evaluator
from swarm.certification.cable_spans import (
    LYING,
    CableSpans,
    Spans,
    all_pairs,
    cable_spans,
    exempt_length,
)
from swarm.certification.distances import (
    Samples,
    Tightest,
    beside_obstacles,
    closest_neighbours,
    closest_rotor_disc,
    closest_segments,
    closest_to_fence,
    closest_to_floor,
    closest_to_obstacles,
    closest_vehicle_and_segment,
    closest_vehicles,
    segment_name,
    vehicle_name,
)
from swarm.certification.far_apart import FarPairs, FarVehicles
from swarm.certification.limits import (
    above_floor,
    beside_solids,
    chords_within,
    derivative_limit,
    height_limit,
    inside_fence,
    inside_fence_in_wind,
    vehicles_beside_solids,
)
from swarm.certification.minima import TOLERANCE, Intervals, boxes_of, failing, roots
from swarm.certification.motion_bounds import BoundedMotion
from swarm.certification.on_the_floor import (
    BELOW,
    beside_rotors,
    drawn_out,
    reach_beside_solids,
    reach_of_segments,
    reach_of_vehicles,
    straight_down,
)
from swarm.certification.strand_pieces import HeldCable
from swarm.certification.strands import strands_apart
from swarm.certification.team_margins import (
    BODIES,
    CEILING,
    CHORDS,
    DISCS,
    FENCE,
    FLOOR,
    NEIGHBOURS,
    OBSTACLES,
    STRANDS,
    VEHICLES,
)
from swarm.geometry.catenary import MAX_CHORD_RATIO
from swarm.geometry.motion import straight_between
from swarm.geometry.solids import grown, obstacles_of
from swarm.mission import Mission
from swarm.planning import Plan
from swarm.planning.phase_motion import usable_acceleration

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.intp]
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
    """What is certified: a kind, for a plan, with the spans of its cable and the held cable.

    The cable has the tracking radius, the largest tilt of gravity and the tube of the swing.
    """

    kind: "Kind"
    plan: Plan
    spans: CableSpans
    cable: HeldCable

    @property
    def mission(self) -> Mission:
        """The mission of the plan."""
        return self.plan.mission

    @property
    def required(self) -> float:
        """The required distance of the kind, metres."""
        return self.kind.required(self.plan.mission)

    @property
    def motion(self) -> BoundedMotion:
        """The motion with its bounds."""
        return self.cable.motion

    def family(
        self,
        names: Names,
        evaluate: Evaluator,
        others: Intervals = (),
        *,
        far: Callable[[Boxes], Flags] | None = None,
        tolerance: float = TOLERANCE,
        when: When | None = None,
    ) -> "Family":
        """Return the pairs with these names as a family, ``when`` the kind applies by default."""
        spans = self._during(when or self.kind.when)
        return Family(self.kind, names, self.required, spans, evaluate, others, far, tolerance)

    def _during(self, when: When) -> Spans:
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
                periods: Spans = getattr(spans, when)
                return periods

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


@dataclass(frozen=True, eq=False)
class Kind:
    """One kind of clearance.

    ``check`` is its name in findings, files and errors; ``objects`` and ``rule`` say in words what
    is compared and required, ``when`` at which times. ``bound`` makes its :class:`Family` with the
    distance in metres that is ``required``; None where a plan has no such objects. Margins have a
    ``unit``; those in metres count for e* and w*. Others are to a ``limit``.

    ``tracking``, ``wind`` and ``swing`` tell whether tracking errors, winds and the tube of the
    swing count in the bound. ``place`` is that of its margin in :mod:`.team_margins`, where the
    live monitor and the certificate of lost setpoints compare it. ``margin`` is the field of
    :class:`swarm.folding.penalty.ExtraMargins` that a repair enlarges; ``budget`` tells whether the
    clearance budget has rows of such pairs.

    ``failure`` is the message where it fails, by default for distances. Kinds that are ``listed``
    are distances that are reported together, tightest first. ``figure`` is the key under which
    files have the tightest moment of one or several kinds.

    ``flown`` is the key under which files have the smallest distance of a flight, ``words`` its
    name in reports, "" where no record has it: ``unmeasured`` says why. It is that of the sent
    setpoints where tracking errors do not count in the bound, of reported positions otherwise.
    ``measured`` returns it for samples at which the kind applies, by default the bound itself.
    """

    check: str
    objects: str
    rule: str
    when: When
    bound: Callable[[Case], Family | None]
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
    flown: str = ""
    words: str = ""
    unmeasured: str = ""
    measured: Callable[[Samples], Tightest | None] | None = None

    def family(self, plan: Plan, spans: CableSpans, cable: HeldCable) -> Family | None:
        """Return its pairs in a plan; None where it never applies."""
        family = self.bound(Case(self, plan, spans, cable))
        return family if family and family.spans and family.names else None

    @property
    def flown_by(self) -> Literal["setpoints", "positions"]:
        """Where vehicles count as being in a flight."""
        return "positions" if self.tracking else "setpoints"

    def smallest_in(self, track: "Track") -> Tightest | None:
        """Return the smallest distance of a flight; None where the kind never applied."""
        family = self.family(track.plan, track.spans, track.cable)
        rows = track.rows(family.spans) if family else np.empty(0, dtype=np.intp)
        if family is None or not len(rows):
            return None
        if self.measured is not None:
            return self.measured(track.during(tuple(family.spans)))
        pairs = np.arange(len(family.names)).repeat(len(rows))
        moments = np.tile(rows.astype(np.float64), len(family.names))
        margins = family.evaluate(boxes_of(pairs, moments, np.zeros(len(pairs)), ())).high
        least = int(np.argmin(margins))
        distance, row = family.required + float(margins[least]), rows[least % len(rows)]
        time = float(track.samples.time[row])
        return Tightest(distance, family.required, time, family.names[pairs[least]])


@dataclass(frozen=True, eq=False)
class Track:
    """Samples of a flight as an exact motion, with the number of a sample in place of the time.

    The bounds of all kinds apply to it: ``plan`` has the motion, ``spans`` are those of the samples
    at which the mission clock was in the plan's. ``cable`` is held exactly there, in still air.
    """

    samples: Samples
    plan: Plan
    spans: CableSpans
    cable: HeldCable
    _during: dict[tuple[tuple[float, float], ...], Samples] = field(
        default_factory=dict, repr=False
    )

    @staticmethod
    def of(samples: Samples) -> "Track":
        """Return the track of at least one sample."""
        plan, place, time = samples.plan, samples.place, samples.time
        motion = straight_between(np.arange(len(place) + 1.0), np.concatenate([place, place[-1:]]))
        every = cable_spans(plan)
        held = (every.dragged, every.lifting, every.aloft, every.landing)
        dragged, lifting, aloft, landing = (_runs(time, spans) for spans in held)
        spans = replace(every, dragged=dragged, lifting=lifting, aloft=aloft, landing=landing)
        cable = HeldCable(BoundedMotion(motion), plan.layout.lengths, 0.0)
        return Track(samples, replace(plan, motion=motion), spans, cable)

    def during(self, spans: tuple[tuple[float, float], ...]) -> Samples:
        """Return the samples within spans: the same for the same, which compute strands once."""
        if spans not in self._during:
            self._during[spans] = self.samples.taken(self.rows(spans))
        return self._during[spans]

    def rows(self, spans: Intervals) -> Ints:
        """Return the numbers of the samples within spans."""
        number = np.arange(len(self.samples.place))
        return np.flatnonzero(_within(number, spans))


def _within(values: Floats | Ints, spans: Intervals) -> Flags:
    inside = np.zeros(len(values), dtype=np.bool_)
    for start, end in spans:
        inside |= (values >= start) & (values <= end)
    return inside


def _runs(time: Floats, spans: Spans) -> Spans:
    """Return the runs of samples at mission times within spans, each to before its next sample."""
    edges = np.flatnonzero(np.diff(_within(time, spans), prepend=False, append=False))
    return [(float(first), last - 0.5) for first, last in edges.reshape(-1, 2).tolist()]


def _chords(case: Case) -> Family:
    return case.family(case.segments("its length"), chords_within(case.cable))


def _two_segments(case: Case, *, neighbours: bool) -> Family:
    plan, cable = case.plan, case.cable
    every, every_part = all_pairs(plan.layout.lengths, exempt_length(plan), once=bool(cable.tilts))
    chosen = (every[:, 1] == every[:, 0] + 1) == neighbours
    pairs, parts, diameter = every[chosen], every_part[chosen], case.mission.cable.diameter
    return case.family(
        [(segment_name(i), segment_name(j)) for i, j in pairs],
        strands_apart(cable, pairs, parts, diameter + case.required),
        (*cable.tilts, *_STRAND, *_STRAND),
        # Boxes around neighbours, which meet at their vehicle, are never apart.
        far=None if neighbours else FarPairs(cable, pairs, case.required + diameter),
    )


def _segments_apart(case: Case) -> Family:
    return _two_segments(case, neighbours=False)


def _neighbours_apart(case: Case) -> Family:
    return _two_segments(case, neighbours=True)


def _above_floor(case: Case) -> Family:
    cable = case.cable
    others = (*cable.tilts, *_STRAND) if cable.tilts else ()
    evaluate = above_floor(cable, case.mission.cable.diameter, case.required)
    return case.family(case.segments("the floor"), evaluate, others)


def _reach_of_segments(case: Case) -> Family:
    first, second = np.triu_indices(case.plan.vehicles - 1, 2)
    pairs = np.stack([first, second], axis=1)
    names = [(segment_name(i), segment_name(j)) for i, j in pairs]
    apart = case.mission.cable.diameter + case.required
    return case.family(names, reach_of_segments(case.cable, pairs, apart))


def _reach_of_vehicles(case: Case) -> Family:
    vehicles, cable = case.mission.vehicles, case.mission.cable
    pairs, _ = vehicle_segments(case.plan.vehicles)
    around = vehicles.radius + 0.5 * cable.diameter + case.required
    return case.family(
        [(vehicle_name(i), segment_name(j)) for i, j in pairs],
        reach_of_vehicles(case.cable, pairs, vehicles.grip_offset, around),
    )


def _not_overstretched(case: Case) -> Family:
    cable = HeldCable(case.motion, case.plan.layout.lengths, 0.0)
    return case.family(case.segments("its length"), chords_within(cable, share=1.0))


def _lying(case: Case) -> Family:
    return case.family(case.vehicles("the floor"), height_limit(case.motion, LYING, -1.0))


def _drawn_out(case: Case) -> Family:
    line = [(segment_name(i), segment_name(i + 1)) for i in range(case.plan.vehicles - 2)]
    return case.family(line, drawn_out(case.motion))


def _beside_rotors(case: Case) -> Family:
    vehicles, half = case.mission.vehicles, 0.5 * case.mission.cable.diameter
    rim = max(vehicles.grip_offset - half, 0.0) / (vehicles.radius + half)
    evaluate = beside_rotors(case.motion, case.cable.tracking, rim)
    return case.family(case.segments("its vehicles"), evaluate)


def _straight_down(case: Case) -> Family:
    begins = np.array([start for start, _ in case.spans.landing])
    return case.family(case.vehicles("the others"), straight_down(case.motion, begins))


def _two_vehicles(case: Case) -> Family:
    pairs = np.stack(np.triu_indices(case.plan.vehicles, 1), axis=1)
    downwash = case.mission.clearance.downwash
    return case.family(
        [(vehicle_name(i), vehicle_name(j)) for i, j in pairs],
        vehicles_apart(case.motion, pairs, case.cable.tracking, case.required, downwash),
    )


def _above_ground(case: Case) -> Family:
    evaluate = height_limit(case.motion, -BELOW, 1.0)
    return case.family(case.vehicles("the floor"), evaluate, tolerance=BELOW)


def _below_ceiling(case: Case) -> Family:
    mission = case.mission
    height = mission.workspace.ceiling - mission.vehicles.grip_offset - case.cable.tracking
    return case.family(case.vehicles("the ceiling"), height_limit(case.motion, height, sign=-1.0))


def _vehicle_and_segment(case: Case, *, own: bool) -> Family:
    cable, mission = case.cable, case.mission
    radius, height = mission.vehicles.radius, mission.vehicles.grip_offset
    diameter, required = mission.cable.diameter, case.required
    pairs = vehicle_segments(case.plan.vehicles)[1 if own else 0]
    far = None if own else FarVehicles(cable, pairs, radius, height, required + 0.5 * diameter)
    return case.family(
        [(vehicle_name(i), segment_name(j)) for i, j in pairs],
        vehicles_and_strands(cable, pairs, Body(radius, height), diameter, required),
        (*cable.tilts, *_STRAND),
        far=far,
    )


def _other_segments(case: Case) -> Family:
    return _vehicle_and_segment(case, own=False)


def _own_segments(case: Case) -> Family:
    return _vehicle_and_segment(case, own=True)


def _vehicles_inside(case: Case) -> Family | None:
    mission, vehicles = case.mission, np.arange(case.plan.vehicles)
    if mission.workspace.fence is None:
        return None
    fence = np.array(mission.workspace.fence)
    reach = np.full(len(vehicles), mission.vehicles.radius)
    evaluate = inside_fence(case.motion, case.cable.tracking, fence, (vehicles, vehicles), reach)
    return case.family(case.vehicles("the fence"), evaluate)


def _segments_inside(case: Case) -> Family | None:
    """In wind only cable that hangs free."""
    cable, mission, vehicles = case.cable, case.mission, np.arange(case.plan.vehicles)
    if mission.workspace.fence is None:
        return None
    fence, names = np.array(mission.workspace.fence), case.segments("the fence")
    if cable.tilts:
        evaluate = inside_fence_in_wind(cable, fence, mission.cable.diameter)
        others = (*cable.tilts, *_STRAND)
        return case.family(names, evaluate, others, when="hanging")
    reach = np.full(len(vehicles) - 1, 0.5 * mission.cable.diameter)
    if cable.tube is not None:
        reach += cable.tube.whole.max(axis=0)
    ends = vehicles[:-1], vehicles[1:]
    return case.family(names, inside_fence(case.motion, cable.tracking, fence, ends, reach))


def _beside(count: int, solids: Floats) -> Ints:
    """Return the pairs (q, 2) of each of the first objects and a solid."""
    return np.stack(np.divmod(np.arange(count * len(solids)), max(len(solids), 1)), axis=1)


def _vehicles_beside_obstacles(case: Case) -> Family:
    vehicles, solids = case.mission.vehicles, obstacles_of(case.mission)
    evaluate = vehicles_beside_solids(
        case.motion, case.cable.tracking, grown(solids, vehicles.radius, vehicles.grip_offset),
        _beside(case.plan.vehicles, solids), case.required,
    )  # fmt: skip
    return case.family(beside_obstacles(case.mission, vehicle_name, case.plan.vehicles), evaluate)


def _segments_beside_obstacles(case: Case) -> Family:
    cable, solids, count = case.cable, obstacles_of(case.mission), case.plan.vehicles - 1
    diameter, pairs = case.mission.cable.diameter, _beside(count, solids)
    return case.family(
        beside_obstacles(case.mission, segment_name, count),
        beside_solids(cable, solids, pairs, diameter, case.required),
        (*cable.tilts, *_STRAND),
    )


def _reach_beside_obstacles(case: Case) -> Family:
    solids, count = obstacles_of(case.mission), case.plan.vehicles - 1
    required = case.required + 0.5 * case.mission.cable.diameter
    evaluate = reach_beside_solids(case.cable, solids, _beside(count, solids), required)
    return case.family(beside_obstacles(case.mission, segment_name, count), evaluate)


def _speed(case: Case) -> Family:
    evaluate = derivative_limit(case.motion, case.mission.vehicles.max_speed, 1)
    return case.family(case.vehicles(""), evaluate, tolerance=_LIMIT_TOLERANCE)


def _acceleration(case: Case) -> Family:
    """The reserve for braking along the path is not available: a setpoint's acceleration is
    r²a + ṙv at the clock's rate r."""
    evaluate = derivative_limit(case.motion, usable_acceleration(case.mission), 2)
    return case.family(case.vehicles(""), evaluate, tolerance=_LIMIT_TOLERANCE)


def _cable(mission: Mission) -> float:
    return mission.clearance.cable


def _vehicle(mission: Mission) -> float:
    return mission.clearance.vehicle


def _vehicle_cable(mission: Mission) -> float:
    return mission.clearance.vehicle_cable


def _obstacle(mission: Mission) -> float:
    return mission.clearance.obstacle


_COARSE: Final = "a record times setpoints to ms: too coarse beside limits that plans reach"
_BEYOND: Final = "{short:.3f} m beyond {other}: {one}{errors}"
_TOO_NEAR: Final = (
    "{short:.3f} m too near {other}: {one}{errors}; move it, or the mission's origin away from it"
)

KINDS: Final = (
    Kind(
        "taut", "chord and length", "the inequality above", "lifted or hanging", _chords,
        place=CHORDS, margin="chord", flown="chord", words="chord to its limit",
        failure=f"{{short:.3f}} m of chord beyond {MAX_CHORD_RATIO:.1%} of the length of "
        "{one}{errors}",
    ),
    Kind(
        "cable clearance", "two segments that share no vehicle, surface to surface",
        "`clearance.cable`", "hanging", _segments_apart, _cable, wind=True, swing=True,
        place=STRANDS, margin="cable", budget=True, listed=True,
        figure="cable", flown="cable", words="cable to cable", measured=closest_segments,
    ),
    Kind(
        "neighbouring segments", "two segments that share a vehicle, beyond the exempt length",
        "`clearance.cable`", "hanging", _neighbours_apart, _cable, wind=True, swing=True,
        place=NEIGHBOURS, margin="neighbour", budget=True, listed=True, figure="cable",
        flown="neighbours", words="cable to next cable", measured=closest_neighbours,
    ),
    Kind(
        "floor", "a segment and the floor", "`clearance.floor`", "aloft", _above_floor,
        lambda mission: mission.clearance.floor, wind=True, swing=True, place=FLOOR, listed=True,
        flown="floor", words="cable to floor", measured=closest_to_floor,
    ),
    Kind(
        "reach on the floor", "the reach of two segments that share no vehicle",
        "`clearance.cable`", "low", _reach_of_segments, _cable, listed=True,
        flown="cable_reach", words="reach of two cables",
    ),
    Kind(
        "reach on the floor", "a vehicle and the reach of others' segments",
        "`clearance.vehicle_cable`", "low", _reach_of_vehicles, _vehicle_cable, listed=True,
        flown="vehicle_reach", words="vehicle to reach",
    ),
    Kind(
        "over-stretched on the floor", "chord and length on the floor", "no longer than the cable",
        "dragged", _not_overstretched, tracking=False, flown="stretch",
        words="chord on the floor",
        failure="{short:.3f} m of chord beyond the length of {one} on the floor",
    ),
    Kind(
        "lying", "a grip point with its cable on the floor", f"at most {LYING:g} m above it",
        "dragged", _lying, tracking=False, flown="lying", words="grip to lying height",
        failure=f"{{one}} is more than {LYING:g} m above the floor while its cable must lie there",
    ),
    Kind(
        "drawn out", "two neighbouring chords in plan view", "within 60° of a line", "low",
        _drawn_out, tracking=False, flown="drawn_out", words="bend on the floor",
        failure="{one} and {other} are more than 60° off a line in plan view while cable can lie "
        "on the floor",
    ),
    Kind(
        "beside rotors", "chord and rotor discs", "less steep than the line from grip to rim",
        "low", _beside_rotors, flown="beside_rotors", words="chord to rotor rim",
        failure="{one} is too steep beside the rotors of its vehicles while cable can lie on the "
        "floor",
    ),
    Kind(
        "straight down", "the shape of the team in a common descent", "unchanged", "landing",
        _straight_down, tracking=False, flown="straight_down", words="shape in the descent",
        failure="{one} does not descend vertically together with the others: their knot would "
        "change its shape",
    ),
    Kind(
        "vehicle clearance", "two vehicles, centre to centre",
        "`clearance.vehicle` horizontally **or** `clearance.downwash` vertically", "always",
        _two_vehicles, _vehicle, place=VEHICLES, margin="vehicle", listed=True,
        figure="vehicle", flown="vehicle", words="vehicle to vehicle", measured=closest_vehicles,
    ),
    Kind(
        "ground", "a grip point and the floor", "above", "always", _above_ground, tracking=False,
        unmeasured="by standing vehicles a record knows the floor, where setpoints begin and end",
        failure="{short:.3f} m below the floor: {one}",
    ),
    Kind(
        "ceiling", "a vehicle and the ceiling", "below", "always", _below_ceiling, place=CEILING,
        failure=_BEYOND, flown="ceiling", words="vehicle to ceiling",
    ),
    Kind(
        "vehicle-cable clearance", "a vehicle and the segments of others",
        "`clearance.vehicle_cable`", "hanging", _other_segments, _vehicle_cable, wind=True,
        swing=True, place=BODIES, margin="vehicle_cable", listed=True,
        figure="vehicle_cable", flown="vehicle_cable", words="vehicle to cable",
        measured=closest_vehicle_and_segment,
    ),
    Kind(
        "rotor disc", "a vehicle and its own segments", "outside its rotor disc", "hanging",
        _own_segments, wind=True, swing=True, place=DISCS, margin="rotor_disc", listed=True,
        failure="{other} enters the rotor disc of its own {one}{errors}", flown="rotor_disc",
        words="own rotor disc", measured=closest_rotor_disc,
    ),
    Kind(
        "fence", "a vehicle and the fence", "inside", "always", _vehicles_inside, wind=True,
        place=FENCE, failure=_BEYOND, flown="vehicle_fence", words="vehicle to fence",
    ),
    Kind(
        "fence", "a segment and the fence", "inside", "held", _segments_inside, wind=True,
        swing=True, place=FENCE, failure=_BEYOND, flown="cable_fence", words="cable to fence",
        measured=closest_to_fence,
    ),
    Kind(
        "obstacle", "a vehicle, upright, and an obstacle", "`clearance.obstacle`", "always",
        _vehicles_beside_obstacles, _obstacle, place=OBSTACLES, listed=True, failure=_TOO_NEAR,
        flown="vehicle_obstacle", words="vehicle to obstacle",
    ),
    Kind(
        "obstacle", "a segment and an obstacle", "`clearance.obstacle`", "hanging",
        _segments_beside_obstacles, _obstacle, wind=True, swing=True, place=OBSTACLES, listed=True,
        failure=_TOO_NEAR, flown="cable_obstacle", words="cable to obstacle",
        measured=closest_to_obstacles,
    ),
    Kind(
        "obstacle", "the reach of a segment and an obstacle", "`clearance.obstacle`", "low",
        _reach_beside_obstacles, _obstacle, listed=True, failure=_TOO_NEAR,
        flown="obstacle_reach", words="reach to obstacle",
    ),
    Kind(
        "speed", "speed", "`vehicles.max_speed`", "pieces", _speed,
        limit=lambda mission: mission.vehicles.max_speed, unit="m/s", tracking=False,
        unmeasured=_COARSE,
        failure="{reached:.3f} m/s for {one}{others}; {vehicles.max_speed:g} m/s allowed",
    ),
    Kind(
        "acceleration", "acceleration", "limit; braking along the path is kept in reserve",
        "pieces", _acceleration, limit=usable_acceleration, unit="m/s²", tracking=False,
        unmeasured=_COARSE,
        failure="{reached:.3f} m/s² for {one}{others}; {usable:g} m/s² "
        "allowed ({vehicles.max_acceleration:g} less {vehicles.braking_acceleration:g} to brake)",
    ),
)  # fmt: skip

FIGURES: Final[Mapping[str, str]] = {
    kind.figure: kind.words for kind in KINDS if kind.figure and kind.figure == kind.flown
}
"""The keys of certified distances in files, and their names in reports."""

MEASURED: Final = {kind.flown: kind for kind in KINDS if kind.flown}
"""The kinds whose smallest distance in a flight is measured, by its key in files."""

SWINGING: Final = {f"emulated_{key}": kind for key, kind in MEASURED.items() if kind.swing}
"""Those that are measured in the emulator's swinging cable, too, by the keys of that distance."""


def kind_of(check: str) -> Kind:
    """Return the first kind with the name of a check."""
    return next(kind for kind in KINDS if kind.check == check)


def required_distances(mission: Mission) -> dict[str, float]:
    """Return the required distances of what is measured, metres, by their keys in files."""
    return {key: kind.required(mission) for key, kind in MEASURED.items()}


class Flown(NamedTuple):
    """What vehicles did in a plan's phases: reported ``positions`` and sent ``setpoints``.

    Both (k, n, 3) are grip points at mission times ``time`` (k,), NaN where not known. ``shapes``
    (k, n − 1, m, 3) is the cable where it is known, as polylines of equal arcs.
    """

    time: Floats
    positions: Floats
    setpoints: Floats
    shapes: Floats | None = None

    def track(self, plan: Plan, by: Literal["setpoints", "positions"]) -> Track | None:
        """Return the track of the samples at which the whole team is known; None without any.

        A plan begins when its clock leaves its first moment: until then, vehicles arm.
        """
        place = self.positions if by == "positions" else np.round(self.setpoints, _SETPOINT_DIGITS)
        known = np.isfinite(place).all(axis=(1, 2)) & (self.time > plan.motion.times[0])
        shapes = None if self.shapes is None else self.shapes[known]
        return (
            Track.of(Samples(plan, place[known], self.time[known], shapes)) if known.any() else None
        )


_SETPOINT_DIGITS: Final = 4
"""Decimals of setpoints, in metres, that the 32-bit floats of packets keep, up to 1 km."""


def measured_distances(plan: Plan, flown: Flown) -> dict[str, Tightest | None]:
    """Return the smallest distances of a flight at the times to which the certificate applies.

    By their keys; None where a plan has no such objects, or without samples.
    """
    tracks = {by: flown.track(plan, by) for by in ("setpoints", "positions")}
    return {
        key: kind.smallest_in(track) if (track := tracks[kind.flown_by]) else None
        for key, kind in MEASURED.items()
    }


def swinging_distances(plan: Plan, flown: Flown) -> dict[str, Tightest | None]:
    """Return the smallest distances of cable with known shapes, as :func:`measured_distances`."""
    track = flown.track(plan, "positions") if flown.shapes is not None else None
    return {key: kind.smallest_in(track) if track else None for key, kind in SWINGING.items()}


MATRIX: Final = (
    "certificate", "tracking errors", "wind", "swing", "lost setpoints", "live monitor", "budget",
    "flown", "repaired",
)  # fmt: skip
"""Columns of the matrix of who compares a kind, or what counts in it."""


def unmeasured() -> dict[str, list[str]]:
    """Return the checks that no flight shows to hold, by the reason."""
    reasons: dict[str, list[str]] = {}
    for kind in KINDS:
        if not kind.flown:
            reasons.setdefault(kind.unmeasured, []).append(kind.check)
    return reasons


def coverage(kind: Kind) -> tuple[str, ...]:
    """Return the cells of a kind in the MATRIX: when it is compared, by what, yes, or no."""
    live = "aloft" if kind.when != "always" else "unless cable lies on the floor"
    counts = kind.tracking, kind.wind, kind.swing
    compared = kind.place is not None
    return (
        _TIMES[kind.when], *map(_yes, counts), "in the fold" if compared else "no",
        live if compared else "no", _yes(kind.budget),
        f"by {kind.flown_by}" if kind.flown else f"no: {kind.unmeasured}",
        _yes(kind.margin is not None),
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
