"""A simulated rope of hundreds of links on a plan's motion: inertia, self-contact, drag and wind.

The cable model of the certificate is quasi-static and has no contact. Here grip points move a rope
(MuJoCo), and the knot is identified from its shape at the end. The rope has no bending stiffness;
its nodes are point masses on links of fixed length, which collide as capsules of the cable's
diameter.

A simulated rope can pass through itself. Therefore penetration, stretch and speed are checked, and
beyond the stated limits a run is invalid. A run without contact is invalid too: its last hanging
shape alone would determine the knot.

It is compared with bounds on the movement of strands by sway and by a stop, in any direction, with
the models of the budget, which counts the movement along the line between two strands, at its
tightest moments. Neither model includes residual swing: a strand leans with the present
acceleration of its ends, and swings after one stop from rest.
"""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from swarm.certification.budget import DIRECTIONS, NEARLY_STRAIGHT, effective_gravity
from swarm.certification.topology import ties_planned_knot
from swarm.errors import InputError, Problem, Refused, SwarmError
from swarm.flight.trace import Trace
from swarm.geometry.catenary import solve_catenaries
from swarm.geometry.distance import strand_strand
from swarm.knots.curve import curve_gauss
from swarm.knots.invariants import identify_curve
from swarm.planning import Plan
from swarm.rope.model import STEP, TIGHTENING_STEP, Conditions, Extremes, Grips, Rope

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.intp]
Progress = Callable[[str, float], None]

_FRACTIONS: Final = np.linspace(0.0, 1.0, 33)
"""Points of a strand whose movement is compared: 10 cm apart on a strand of 3 m."""


def largest_swings(
    positions: Floats, acceleration: Floats, lengths: Floats, braking: float
) -> Floats:
    """Return the largest movement (m,) of each of m strands, metres.

    ``positions`` and ``acceleration`` (m + 1, 3) are of the grip points, m and m/s²; ``lengths``
    (m,) of the strands; ``braking`` in m/s² is the braking reserve of all vehicles.
    """
    start, end = positions[:-1], positions[1:]
    drawn = np.maximum(lengths, np.linalg.norm(end - start, axis=1) / NEARLY_STRAIGHT)

    def movement(by: Floats) -> Floats:
        leaning = solve_catenaries(start, end, drawn, down=effective_gravity(by)).points(_FRACTIONS)
        farthest: Floats = np.linalg.norm(leaning - still, axis=-1).max(axis=-1)
        return farthest

    still = solve_catenaries(start, end, drawn).points(_FRACTIONS)
    sway = movement(0.5 * (acceleration[:-1] + acceleration[1:]))
    headings = 2.0 * math.pi * np.arange(DIRECTIONS) / DIRECTIONS
    level = braking * np.stack([np.cos(headings), np.sin(headings), 0.0 * headings], axis=1)
    stop: Floats = np.max([movement(np.tile(by, (len(lengths), 1))) for by in level], axis=0)
    return sway + stop


LINK: Final = 0.17
"""Length of a link in metres unless a number of links is given; shorter links stretch more (1.9 %
at 2200 links of a figure-eight)."""

MOST_PENETRATION: Final = 1.5
"""Radii; strands that are two radii deep in each other may leave on the other side."""

MOST_STRETCH: Final = 0.01
"""Share of a link's length, farther than BESIDE_GRIP from all grips."""

MOST_SPEED: Final = 12.0
"""m/s of any node; a faster one is a numerical spike: free fall from 7 m."""

_SAMPLES: Final = 24
"""Pieces of a strand for distances: 12 cm of a strand of 3 m."""
_STEPS_AROUND: Final = 5
"""Samples of the grips' motion before and after a moment for their acceleration."""


@dataclass(frozen=True)
class RopeRun:
    """Result of a simulated rope. Lengths in metres, times in seconds, k samples.

    ``trajectory`` names the motion of its grip points; ``computing_time`` is that of the computer.
    ``knot``, ``chirality`` and ``gauss`` are of the rope at the end, its ends closed upwards;
    ``as_planned`` compares them with the plan by
    :func:`swarm.certification.topology.ties_planned_knot`, after tightening by the knot's name.
    ``span`` is the distance of the rope's ends. ``penetration`` is the deepest of all
    contacts, ``stretch`` the largest of links away from grips, ``speed`` the largest of all nodes.
    ``invalid`` lists the reasons why the run is invalid. ``deviation`` (k, m) is the largest
    distance of a node of each segment from the quasi-static cable between the same grips,
    ``allowed_swing`` (k, m) the largest movement of that segment by sway and a stop in the budget's
    models. ``distance`` (k,) is the smallest distance between segments that share no vehicle,
    surface to surface, and ``static_distance`` (k,) that of the quasi-static cable. ``shape``
    (nodes, 3) is the rope at the end.
    """

    plan: Plan
    trajectory: str
    computing_time: float
    links: int
    simulated: float
    contact: bool
    knot: str
    chirality: str
    gauss: str
    as_planned: bool
    tightened: bool
    span: float
    contacts: int
    penetration: float
    stretch: float
    speed: float
    invalid: tuple[str, ...]
    times: Floats
    deviation: Floats
    allowed_swing: Floats
    distance: Floats
    static_distance: Floats
    shape: Floats

    def document(self) -> dict[str, Any]:
        """Return the run as one JSON-ready object."""
        radius = 0.5 * self.plan.mission.cable.diameter
        return {
            "trajectory": self.trajectory,
            "computing_time": self.computing_time,
            "links": self.links,
            "simulated": self.simulated,
            "contact": self.contact,
            "tightened": self.tightened,
            "knot": {
                "type": self.knot,
                "chirality": self.chirality,
                "gauss": self.gauss,
                "as_planned": self.as_planned,
            },
            "invalid": list(self.invalid),
            "contacts": self.contacts,
            "penetration": {
                "metres": self.penetration,
                "radii": self.penetration / radius,
                "limit": MOST_PENETRATION,
            },
            "stretch": {"share": self.stretch, "limit": MOST_STRETCH},
            "speed": {"metres_per_second": self.speed, "limit": MOST_SPEED},
            "end_distance": self.span,
            "smallest_distance": _smallest(self.distance),
            "smallest_distance_of_quasi_static_cable": _smallest(self.static_distance),
            "deviation": self._deviation(),
        }

    def _deviation(self) -> dict[str, Any]:
        """Return the deviation from the quasi-static cable as one JSON-ready object.

        The largest deviation with segment and time, and the swing that the budget's models allow
        there; the share of samples beyond these models, and by how much at most.
        """
        if not self.deviation.size:
            return {"largest": 0.0, "beyond_models": {"share": 0.0, "by": 0.0}}
        moment, segment = np.unravel_index(int(self.deviation.argmax()), self.deviation.shape)
        beyond = self.deviation - self.allowed_swing
        return {
            "largest": float(self.deviation[moment, segment]),
            "segment": int(segment) + 1,
            "time": float(self.times[moment]),
            "allowed_swing": float(self.allowed_swing[moment, segment]),
            "beyond_models": {
                "share": float(np.mean(beyond > 0.0)),
                "by": max(float(beyond.max()), 0.0),
            },
        }


def _smallest(distance: Floats) -> float | None:
    return float(distance.min()) if np.isfinite(distance).all() else None


def planned_grips(plan: Plan) -> Grips:
    """Return the planned grip points over fold and hold, every five steps of the simulation."""
    start, end = plan.phase("fold").start, plan.phase("hold").end
    times = np.append(np.arange(start, end, 5 * STEP), end)
    return Grips(times, plan.motion.at(times)[0])


def flown_grips(trace: Trace, record: str) -> Grips:
    """Return the reported grip points of a flight in fold and hold, on the clock of the flight.

    Raises :class:`InputError` that names the ``record`` if the flight did not reach its fold.
    """
    known = np.isin(np.array(trace.phase, dtype=str), ["fold", "hold"])
    known &= np.isfinite(trace.position).all(axis=(1, 2))
    if known.sum() < 2:
        raise InputError([Problem(record, "expected a flight that reached its fold")])
    return Grips(trace.time[known], trace.position[known])


def simulate_rope(
    plan: Plan,
    grips: Grips,
    trajectory: str = "this plan",
    *,
    links: int | None = None,
    contact: bool = True,
    wind: tuple[float, float, float] = (0.0, 0.0, 0.0),
    progress: Progress | None = None,
) -> RopeRun:
    """Move a rope by its grip points and identify its knot at the end.

    ``trajectory`` names their motion. ``links`` are distributed over the segments by length (None:
    LINK metres each); ``wind`` is in m/s, ENU. Where the plan tightens, its inner vehicles then
    release and the ends move apart. Raises :class:`Refused` without cable, or where it is too short
    for the grips at the beginning.
    """
    began = time.perf_counter()
    lengths = plan.layout.lengths
    if not len(lengths):
        raise Refused("the mission has no cable, and so no rope")
    start = grips.places[0]
    if np.any(np.linalg.norm(np.diff(start, axis=0), axis=1) > NEARLY_STRAIGHT * lengths):
        raise Refused("the rope cannot hang between its grips: they begin too far apart")
    counts = _distribute_links(lengths, links or max(len(lengths), round(lengths.sum() / LINK)))
    held = np.concatenate([[0], np.cumsum(counts)])
    extremes, log = Extremes(), _Log(plan, grips, counts, held)
    cable, air = plan.mission.cable, np.array(wind)
    conditions = Conditions(contact, air)
    rope = Rope(cable, _quasi_static(start, lengths, counts), held, conditions, extremes)
    tightening = _tightening(plan)
    folding = float(grips.times[-1] - grips.times[0])
    duration = folding + (tightening.times[-1] if tightening else 0.0)
    for moment, places in rope.run(grips):
        log.sample(moment, rope.nodes(), places)
        if progress:
            progress("moving the rope", (moment - float(grips.times[0])) / duration)
    if tightening is not None:
        conditions = Conditions(contact, air, TIGHTENING_STEP)
        rope = Rope(cable, rope.nodes(), held[[0, -1]], conditions, extremes, rope.velocities())
        for moment, _ in rope.run(tightening):
            if progress:
                progress("tightening the rope", (folding + moment) / duration)
    nodes = rope.nodes()
    knot, chirality, gauss, as_planned = _knot(plan, nodes, tightened=tightening is not None)
    return RopeRun(
        plan=plan,
        trajectory=trajectory,
        computing_time=time.perf_counter() - began,
        links=len(nodes) - 1,
        simulated=duration,
        contact=contact,
        knot=knot,
        chirality=chirality,
        gauss=gauss,
        as_planned=as_planned,
        tightened=tightening is not None,
        span=float(np.linalg.norm(nodes[-1] - nodes[0])),
        contacts=extremes.contacts,
        penetration=extremes.penetration,
        stretch=extremes.stretch,
        speed=extremes.speed,
        invalid=_reasons_invalid(extremes, 0.5 * cable.diameter, contact=contact),
        times=np.array(log.times),
        deviation=np.array(log.deviation).reshape(-1, len(lengths)),
        allowed_swing=np.array(log.allowed_swing).reshape(-1, len(lengths)),
        distance=np.array(log.distance),
        static_distance=np.array(log.static_distance),
        shape=nodes,
    )


def _distribute_links(lengths: Floats, links: int) -> Ints:
    """Number of links of each segment by its length, at least two."""
    share = lengths / lengths.sum() * links
    counts: Ints = np.maximum(np.floor(share).astype(np.intp), 2)
    for k in np.argsort(counts - share)[: max(0, links - int(counts.sum()))]:
        counts[k] += 1
    return counts


def _quasi_static(places: Floats, lengths: Floats, counts: Ints) -> Floats:
    """Nodes (m, 3) of the quasi-static cable between grip points (n, 3)."""
    parts = [places[:1]]
    for start, end, length, count in zip(places, places[1:], lengths, counts, strict=False):
        drawn = max(float(length), float(np.linalg.norm(end - start)) / NEARLY_STRAIGHT)
        fractions = np.linspace(0.0, 1.0, count + 1)
        parts.append(solve_catenaries(start, end, drawn).points(fractions)[1:])
    return np.concatenate(parts)


def _tightening(plan: Plan) -> Grips | None:
    """The ends' motion (k, 2, 3) after the inner vehicles' release; None without tightening."""
    phases = [phase for phase in plan.phases if phase.name == "tighten"]
    if not phases:
        return None
    times = np.append(np.arange(phases[0].start, phases[0].end, 5 * STEP), phases[0].end)
    return Grips(times - times[0], plan.motion.at(times)[0][:, [0, -1]])


class _Log:
    """Samples of a rope while it is folded, compared with the quasi-static cable."""

    def __init__(self, plan: Plan, grips: Grips, counts: Ints, held: Ints) -> None:
        self.plan = plan
        self._grips, self._counts, self._held = grips, counts, held
        self._pairs = np.stack(np.triu_indices(len(counts), 2), axis=1)
        self.times: list[float] = []
        self.deviation: list[Floats] = []
        self.allowed_swing: list[Floats] = []
        self.distance: list[float] = []
        self.static_distance: list[float] = []

    def sample(self, time: float, nodes: Floats, places: Floats) -> None:
        lengths = self.plan.layout.lengths
        static = _quasi_static(places, lengths, self._counts)
        self.times.append(time)
        deviation = np.linalg.norm(nodes - static, axis=1)
        # A segment's first and last nodes are held, without deviation.
        self.deviation.append(np.maximum.reduceat(deviation, self._held[:-1]))
        braking = self.plan.mission.vehicles.braking_acceleration
        acceleration = self._acceleration(time)
        self.allowed_swing.append(largest_swings(places, acceleration, lengths, braking))
        self.distance.append(self._distance(nodes))
        self.static_distance.append(self._distance(static))

    def _acceleration(self, time: float) -> Floats:
        """The grips' acceleration (n, 3) at a moment, by central differences."""
        times = self._grips.times
        step = _STEPS_AROUND * float(np.median(np.diff(times)))
        within = max(min(time, float(times[-1]) - step), float(times[0]) + step)
        before, now, after = self._grips.at(within + step * np.array([-1.0, 0.0, 1.0]))
        acceleration: Floats = (before - 2.0 * now + after) / step**2
        return acceleration

    def _distance(self, nodes: Floats) -> float:
        if not len(self._pairs):
            return np.inf
        share = np.linspace(0.0, 1.0, _SAMPLES + 1)
        strands = []
        for begin, count in zip(self._held, self._counts, strict=False):
            part = nodes[begin : begin + count + 1]
            at = share * count
            strands.append(
                np.stack([np.interp(at, np.arange(count + 1), part[:, i]) for i in range(3)], -1)
            )
        nearest = float(strand_strand(np.array(strands), self._pairs).distance.min())
        return nearest - self.plan.mission.cable.diameter


def _knot(plan: Plan, nodes: Floats, *, tightened: bool) -> tuple[str, str, str, bool]:
    """Type, chirality and crossing code of a rope, and whether it has the planned knot."""
    knot, chirality, gauss, as_planned = "unknown", "none", "", False
    try:
        identified = identify_curve(nodes)
        knot, chirality = identified.name, str(identified.chirality)
        code = curve_gauss(nodes)
        gauss = code.signed_text()
        as_planned = (
            (knot, chirality) == (plan.knot.type, plan.knot.chirality)
            if tightened
            else ties_planned_knot(plan, identified, code)
        )
    except SwarmError:
        pass
    return knot, chirality, gauss, as_planned


def _reasons_invalid(extremes: Extremes, radius: float, *, contact: bool) -> tuple[str, ...]:
    """Reasons why a run is invalid; empty for a valid one."""
    reasons = []
    if not contact:
        reasons.append("contact is disabled: the resulting knot is no evidence")
    if extremes.penetration > MOST_PENETRATION * radius:
        reasons.append(
            f"strands penetrated each other by {extremes.penetration / radius:.2f} radii, more "
            f"than {MOST_PENETRATION:g}"
        )
    if extremes.stretch > MOST_STRETCH:
        reasons.append(
            f"a link was stretched by {extremes.stretch:.1%}, more than {MOST_STRETCH:.0%}"
        )
    if extremes.speed > MOST_SPEED:
        reasons.append(f"a node moved at {extremes.speed:.1f} m/s, faster than {MOST_SPEED:g} m/s")
    return tuple(reasons)
