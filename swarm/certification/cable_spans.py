"""The spans of mission time in which vehicles hold the cable, by the state of the cable.

The grip, the release and the spans with cable on the floor follow from the one legal order of
phases; the statements of a phase are only compared with it. In a plan with another order, the cable
counts as hanging all the time. Whether cable really lies, is drawn out in a line or descends
without change is certified from the motion itself (:mod:`.on_the_floor`).

Of two segments that share a vehicle, the parts beyond the exempt length of cable at the shared grip
are compared.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from swarm.planning import CableState, Plan
from swarm.planning.phase_order import DeclaredCable, declared_cable, phase_order_error

Spans = list[tuple[float, float]]

LYING = 0.25
"""Metres above the floor up to which a grip point holds cable that counts as lying on it."""


@dataclass(frozen=True)
class CableSpans:
    """Spans of mission time in which vehicles hold the cable, by the state of the cable.

    ``dragged``: all of it on the floor; ``lifting``: a line, partly on the floor; ``aloft``: every
    segment hangs free; ``landing``: all vehicles descend vertically together. All vehicles hold the
    cable from ``gripped`` to ``released``. ``problems`` are contradictions within the plan, with
    their times; with any, all of the held cable counts as aloft.
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
        """Spans in which cable may lie on the floor, except at the end of a landing."""
        return merge([*self.dragged, *self.lifting])

    @property
    def suspended(self) -> Spans:
        """Spans in which every segment hangs free, until it touches the floor in a landing."""
        return merge([*self.aloft, *self.landing])

    @property
    def hanging(self) -> Spans:
        """Spans in which cable may hang."""
        return merge([*self.lifting, *self.suspended])

    @property
    def ever(self) -> Spans:
        """Spans in which the cable is held."""
        return merge([*self.dragged, *self.hanging])


def cable_spans(plan: Plan) -> CableSpans:
    """Return the spans in which a plan holds its cable, and contradictions within the plan."""
    start, end = float(plan.motion.times[0]), float(plan.motion.times[-1])
    if not len(plan.layout.lengths):
        return CableSpans([], [], [], [], start, start)
    problems = _order_problems(plan)
    if problems:
        return CableSpans([], [], [(start, end)], [], start, end, tuple(problems))
    order = declared_cable([phase.name for phase in plan.phases], attached=_attached(plan))
    edges = [phase.start for phase in plan.phases] + [end]
    gripped, released = edges[order.held_from], edges[order.held_until]
    problems = [*_state_problems(plan, order), *_gate_problems(plan, order, gripped, released)]
    problems += _floor_problems(plan, order, gripped, released)
    if problems:
        return CableSpans([], [], [(gripped, released)], [], gripped, released, tuple(problems))

    def spans(state: CableState) -> Spans:
        held_phases = list(zip(plan.phases, order.cable, strict=True))
        chosen = held_phases[order.held_from : order.held_until]
        return merge([(p.start, p.end) for p, cable in chosen if cable == state])

    return CableSpans(
        spans("floor"), spans("lifting"), spans("aloft"), spans("landing"), gripped, released
    )


def merge(spans: Spans) -> Spans:
    """Return spans in order of time, adjoining ones merged, empty ones removed."""
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
    """Gaps and overlaps between phases, and phases in an order that is not allowed."""
    start, end = float(plan.motion.times[0]), float(plan.motion.times[-1])
    if not plan.phases:
        return [("the plan has no phases", start)]
    problems: list[tuple[str, float]] = []
    clock, before = start, None
    for phase in plan.phases:
        if not (phase.start == clock and phase.end >= phase.start):
            problems.append(
                (f"{phase.name} lasts from {phase.start:g} to {phase.end:g} s, but the phase "
                 f"before it ends at {clock:g} s", clock)
            )  # fmt: skip
        wrong = phase_order_error(before, phase.name)
        if wrong:
            problems.append((f"the order of the phases is not allowed: {wrong}", phase.start))
        clock, before = phase.end, phase.name
    if clock != end:
        problems.append((f"the phases end at {clock:g} s and the motion at {end:g} s", end))
    return problems


def _state_problems(plan: Plan, order: DeclaredCable) -> list[tuple[str, float]]:
    """Phases whose state of the cable does not follow from their order."""
    problems = []
    for index, (phase, expected) in enumerate(zip(plan.phases, order.cable, strict=True)):
        free = not order.held_from <= index < order.held_until
        if phase.cable == expected or (free and phase.cable in {"floor", "free"}):
            continue
        problems.append(
            (f"{phase.name} has the cable {phase.cable}; expected {expected}, by the times of the "
             f"grip and the release", phase.start)
        )  # fmt: skip
    return problems


def _gate_problems(
    plan: Plan, order: DeclaredCable, gripped: float, released: float
) -> list[tuple[str, float]]:
    """Gates at which vehicles grip or release against the order of phases."""
    problems = []
    last = plan.phases[order.held_until].end if order.inner_first else released
    for gate in plan.gates:
        match gate.condition:
            case "gripped":
                allowed, what = [gripped], "grip the cable"
            case "released":
                allowed = [released] if gate.inner or not order.inner_first else [last]
                what = "release the cable"
            case _:
                continue
        never = gate.condition == "released" and order.held_until == len(plan.phases)
        if gate.time in ([float(plan.motion.times[-1])] if never else allowed):
            continue
        message = f"vehicles {what} at {gate.time:g} s; no phase that allows it ends there"
        problems.append((message, gate.time))
    return problems


def _floor_problems(
    plan: Plan, order: DeclaredCable, gripped: float, released: float
) -> list[tuple[str, float]]:
    """Grips and releases of cable on the floor that are too high above it."""
    moments = [(gripped, "grip")] if order.gripped_by_vehicles else []
    if order.held_until < len(plan.phases) and order.held_until > 0:
        before = order.cable[order.held_until - 1]
        if before in {"floor", "landing"}:
            moments.append((released, "release"))
    problems = []
    for time, what in moments:
        highest = float(plan.motion.at(time)[0][:, 2].max())
        if not highest <= LYING:
            problems.append(
                (
                    f"vehicles {what} the cable on the floor, but hold it {highest:.2f} m above it",
                    time,
                )
            )
    return problems


Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.intp]

MOST_EXEMPT = 0.5
"""Largest exempt share of the shorter of two neighbours: half of every segment is compared."""


def exempt_length(plan: Plan) -> float:
    """Return the exempt length of cable on either side of a vehicle, metres.

    Neighbouring segments meet at their vehicle. From this arc length on, each must keep the cable
    clearance from all of the other: they must diverge at about 15° or more.
    """
    mission = plan.mission
    return 4.0 * (mission.clearance.cable + mission.cable.diameter + mission.vehicles.tracking)


def exempt_lengths(lengths: Floats, beyond: float) -> Floats:
    """Return the exempt lengths (n − 2,) on either side of the inner vehicles, metres."""
    shorter = np.minimum(lengths[:-1], lengths[1:])
    exempt: Floats = np.minimum(beyond, MOST_EXEMPT * shorter)
    return exempt


def all_pairs(lengths: Floats, beyond: float, *, once: bool = False) -> tuple[Ints, Floats]:
    """Return all pairs (q, 2) of segments to compare, and the compared parts (q, 2, 2).

    Each of two neighbours is compared with the whole of the other from ``beyond`` metres of cable
    away from their shared vehicle, or from half of the shorter one where that is less: two entries
    per pair, of which the second leaves out what the first compares with ``once``.
    """
    first, second = np.triu_indices(len(lengths), 1)
    pairs = np.stack([first, second], axis=1)
    whole = np.tile([0.0, 1.0], (len(pairs), 2, 1))
    neighbours = second == first + 1
    i, j = pairs[neighbours].T
    left, right = whole[neighbours].copy(), whole[neighbours].copy()
    near = exempt_lengths(lengths, beyond)
    left[:, 0, 1] = 1.0 - near / lengths[i]
    right[:, 1, 0] = near / lengths[j]
    if once:
        right[:, 0, 0] = left[:, 0, 1]
    return (
        np.concatenate([pairs[~neighbours], pairs[neighbours], pairs[neighbours]]),
        np.concatenate([whole[~neighbours], left, right]),
    )
