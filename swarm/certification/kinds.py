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

from swarm.certification.bodies import (
    Body,
    vehicle_segments,
    vehicles_and_strands,
    vehicles_apart,
)
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
    above_floor,
    chords_within,
    derivative_limit,
    height_limit,
    inside_fence,
    inside_fence_in_wind,
)
from swarm.certification.minima import TOLERANCE, Intervals, failing, roots
from swarm.certification.motion_bounds import BoundedMotion
from swarm.certification.on_the_floor import (
    BELOW,
    beside_rotors,
    drawn_out,
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
    files have the tightest moment of one or several kinds, ``words`` its name in reports;
    ``measured`` returns the smallest distance at grip points (k, n, 3) and mission times (k,).
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
    words: str = ""
    measured: Callable[[Plan, Floats, Floats], Tightest | None] | None = None

    def family(self, plan: Plan, spans: CableSpans, cable: HeldCable) -> Family | None:
        """Return its pairs in a plan; None where it never applies."""
        family = self.bound(Case(self, plan, spans, cable))
        return family if family and family.spans and family.names else None


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
