"""When the cable is held and what it does then: declared by the order of phases, and checked.

What a phase says of itself decides nothing here. From the one legal order of phases follow the
grip, the release, and where cable may lie on the floor; in a plan with another order all cable
counts as hanging, all the time. That cable lies, is drawn out in a line or comes down as it hung is
then shown of the motion itself, by the evaluators below.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from swarm.certification.branch_and_bound import Boxes, Enclosure
from swarm.certification.motion_bounds import Course
from swarm.certification.strands import Team
from swarm.planning import CableState, Plan
from swarm.planning.phase_order import DeclaredCable, declared_cable, phase_order_error

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.intp]
Spans = list[tuple[float, float]]

LYING = 0.25
"""Metres above the floor up to which a grip point may hold cable that counts as lying on it."""

RIGID = 0.005
"""Metres by which a team that comes down with a knot may change its shape: rounding of files, and
what yes or no may be wrong by (:data:`swarm.certification.branch_and_bound.TOLERANCE`)."""

BELOW = 0.005
"""Metres by which a grip point may be below the floor, on which it stands; for the same reasons."""

_SAME = 1e-6
"""Seconds by which times may differ that are one moment."""


@dataclass(frozen=True)
class Held:
    """Spans of mission time in which vehicles hold the cable, by what it does.

    ``dragged``: all of it on the floor; ``lifting``: a line, partly on the floor; ``aloft``: every
    segment hangs free; ``landing``: all come straight down together. ``gripped`` and ``released``
    are when it is held from and until when by all. ``problems`` are contradictions in what the plan
    says of itself, with their times; where there are any, all that is held counts as aloft.
    """

    dragged: Spans
    lifting: Spans
    aloft: Spans
    landing: Spans
    gripped: float
    released: float
    problems: tuple[tuple[str, float], ...] = ()

    @property
    def low(self) -> Spans:
        """Spans in which cable may lie on the floor, but for the end of a landing."""
        return adjoining([*self.dragged, *self.lifting])

    @property
    def hanging(self) -> Spans:
        """Spans in which cable may hang."""
        return adjoining([*self.lifting, *self.aloft, *self.landing])

    @property
    def ever(self) -> Spans:
        """Spans in which the cable is held at all."""
        return adjoining([*self.dragged, *self.hanging])


def held(plan: Plan) -> Held:
    """Return when a plan holds its cable, and where what the plan says is contradictory."""
    start, end = float(plan.motion.times[0]), float(plan.motion.times[-1])
    if not len(plan.layout.lengths):
        return Held([], [], [], [], start, start)
    problems = _order_problems(plan)
    if problems:
        return Held([], [], [(start, end)], [], start, end, tuple(problems))
    says = declared_cable([phase.name for phase in plan.phases], attached=_attached(plan))
    edges = [phase.start for phase in plan.phases] + [end]
    gripped, released = edges[says.held_from], edges[says.held_until]
    problems = [*_state_problems(plan, says), *_gate_problems(plan, says, gripped, released)]
    problems += _floor_problems(plan, says, gripped, released)
    if problems:
        return Held([], [], [(gripped, released)], [], gripped, released, tuple(problems))

    def spans(state: CableState) -> Spans:
        held_phases = list(zip(plan.phases, says.cable, strict=True))
        chosen = held_phases[says.held_from : says.held_until]
        return adjoining([(p.start, p.end) for p, cable in chosen if cable == state])

    return Held(
        spans("floor"), spans("lifting"), spans("aloft"), spans("landing"), gripped, released
    )


def adjoining(spans: Spans) -> Spans:
    """Return spans in order of time, adjoining ones as one, without empty ones."""
    merged: Spans = []
    for start, end in sorted(spans):
        if end <= start:
            continue
        if merged and start <= merged[-1][1]:
            merged[-1] = (merged[-1][0], max(end, merged[-1][1]))
        else:
            merged.append((start, end))
    return merged


def _attached(plan: Plan) -> bool:
    return plan.mission.grab == "attached"


def _order_problems(plan: Plan) -> list[tuple[str, float]]:
    """Where phases leave time out, overlap, or come in an order that no flight has."""
    start, end = float(plan.motion.times[0]), float(plan.motion.times[-1])
    if not plan.phases:
        return [("the plan has no phases", start)]
    found: list[tuple[str, float]] = []
    clock, before = start, None
    for phase in plan.phases:
        if not (abs(phase.start - clock) <= _SAME and phase.end >= phase.start):
            found.append(
                (f"{phase.name} lasts from {phase.start:g} to {phase.end:g} s, but what comes "
                 f"before it ends at {clock:g} s", clock)
            )  # fmt: skip
        wrong = phase_order_error(before, phase.name)
        if wrong:
            found.append((f"the phases are in no order that a flight has: {wrong}", phase.start))
        clock, before = phase.end, phase.name
    if not abs(clock - end) <= _SAME:
        found.append((f"the phases end at {clock:g} s and the motion at {end:g} s", end))
    return found


def _state_problems(plan: Plan, says: DeclaredCable) -> list[tuple[str, float]]:
    """Phases that say of the cable what does not follow from their order."""
    found = []
    for index, (phase, expected) in enumerate(zip(plan.phases, says.cable, strict=True)):
        unheld = not says.held_from <= index < says.held_until
        if phase.cable == expected or (unheld and phase.cable in {"floor", "free"}):
            continue
        found.append(
            (f"{phase.name} says that the cable is {phase.cable}, but from the grip at its time "
             f"and the release follows {expected}", phase.start)
        )  # fmt: skip
    return found


def _gate_problems(
    plan: Plan, says: DeclaredCable, gripped: float, released: float
) -> list[tuple[str, float]]:
    """Gates at which vehicles grip or let go when the order of phases says otherwise."""
    found = []
    last = plan.phases[says.held_until].end if says.inner_first else released
    for gate in plan.gates:
        match gate.condition:
            case "gripped":
                allowed, what = [gripped], "grip the cable"
            case "released":
                allowed = [released] if gate.inner or not says.inner_first else [last]
                what = "let go of the cable"
            case _:
                continue
        never = gate.condition == "released" and says.held_until == len(plan.phases)
        at_end = never and abs(gate.time - float(plan.motion.times[-1])) <= _SAME
        if at_end or (not never and any(abs(gate.time - time) <= _SAME for time in allowed)):
            continue
        message = f"vehicles {what} at {gate.time:g} s, where no phase ends that allows it"
        found.append((message, gate.time))
    return found


def _floor_problems(
    plan: Plan, says: DeclaredCable, gripped: float, released: float
) -> list[tuple[str, float]]:
    """Grips of cable on the floor, and releases of cable that was put down, too high above it."""
    moments = [(gripped, "are to grip the cable on the floor")] if says.gripped_by_vehicles else []
    if says.held_until < len(plan.phases) and says.held_until > 0:
        before = says.cable[says.held_until - 1]
        if before in {"floor", "landing"}:
            moments.append((released, "are to let go of the cable on the floor"))
    found = []
    for time, what in moments:
        highest = float(plan.motion.at(time)[0][:, 2].max())
        if not highest <= LYING:
            found.append((f"vehicles {what}, but hold it {highest:.2f} m above", time))
    return found


def _in_time(high: Floats, doubt: Floats, place: Floats) -> Enclosure:
    nothing = np.zeros_like(high)
    return Enclosure(high - doubt, high, np.stack([doubt, nothing, nothing], axis=1), place)


@dataclass(frozen=True, eq=False)
class Above:
    """Room between vehicles' grip points and a height; per vehicle. Negative below it.

    ``sign`` 1 asks for grip points above ``height``, −1 for grip points below it.
    """

    course: Course
    height: float
    sign: float

    def __call__(self, boxes: Boxes) -> Enclosure:
        """Enclose the margin in each box."""
        time, half, when = boxes.instants()
        team = Team.at(self.course, time, half)
        place = team.position[when, boxes.pair]
        climb = np.abs(team.velocity[when, boxes.pair, 2]) * half[when]
        climb += team.swerve[when, boxes.pair]
        return _in_time(self.sign * (place[:, 2] - self.height), climb, place)


@dataclass(frozen=True, eq=False)
class DrawnOut:
    """How far from bent by 60° a line is at its inner vehicles, in plan view; per inner vehicle.

    Metres by which the shorter chord reaches further along the longer one than half its length.
    Strands that hang from a line so little bent, or lie below it, keep away from each other.
    """

    course: Course

    def __call__(self, boxes: Boxes) -> Enclosure:
        """Enclose the margin in each box."""
        time, half, when = boxes.instants()
        team = Team.at(self.course, time, half)
        middle = boxes.pair + 1
        at, velocity = team.position[when, middle], team.velocity[when, middle]
        before = (at - team.position[when, middle - 1])[:, :2]
        after = (team.position[when, middle + 1] - at)[:, :2]
        sizes = np.stack([np.linalg.norm(chord, axis=1) for chord in (before, after)])
        along = np.einsum("bi,bi->b", before, after) / np.maximum(sizes.max(axis=0), 1e-12)
        growth = sum(
            team.drift(when, other, velocity) + team.swerve[when, middle]
            for other in (middle - 1, middle + 1)
        )
        return _in_time(along - 0.5 * sizes.min(axis=0), 1.5 * np.asarray(growth), at)


@dataclass(frozen=True, eq=False)
class BesideRotors:
    """What chords are lower, beside either end's vehicle, than the rim of its rotor disc.

    Cable on the floor or below a chord stays out of both discs where the chord rises less than the
    rim does; per segment, in metres at its far end, for every displacement in the tracking ball.
    """

    course: Course
    tracking: float
    rim: float
    """Height of the disc over the grip, per metre from its axis to the rim."""

    def __call__(self, boxes: Boxes) -> Enclosure:
        """Enclose the margin in each box."""
        time, half, when = boxes.instants()
        team = Team.at(self.course, time, half)
        first, last = boxes.pair, boxes.pair + 1
        step = team.position[when, last] - team.position[when, first]
        span, rise = np.hypot(step[:, 0], step[:, 1]), np.abs(step[:, 2])
        growth = team.drift(when, last, team.velocity[when, first]) + team.swerve[when, first]
        ball = 2.0 * self.tracking
        high = self.rim * (span - ball) - (rise + ball)
        middle = 0.5 * (team.position[when, first] + team.position[when, last])
        return _in_time(high, (1.0 + self.rim) * growth, middle)


@dataclass(frozen=True, eq=False)
class AsItHung:
    """Metres by which a team may still change its shape, that comes straight down from ``starts``.

    ``starts`` (s,) are the times at which it begins to; per vehicle. Distances are then what they
    were, and strands hang as they hung, until they touch the floor.
    """

    course: Course
    starts: Floats

    def __call__(self, boxes: Boxes) -> Enclosure:
        """Enclose the margin in each box."""
        time, half, when = boxes.instants()
        team = Team.at(self.course, time, half)
        begun = np.searchsorted(self.starts, time, side="right") - 1
        moved = team.position - self.course.motion.at(self.starts)[0][begun]
        moved[..., 2] -= moved[:, :1, 2].copy()
        down = team.velocity[when, 0] * [0.0, 0.0, 1.0]
        doubt = team.drift(when, boxes.pair, down) + team.swerve[when, 0]
        high = RIGID - np.linalg.norm(moved[when, boxes.pair], axis=-1)
        return _in_time(high, doubt, team.position[when, boxes.pair])
