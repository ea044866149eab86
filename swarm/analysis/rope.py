"""The same motion with a rope of hundreds of links: inertia, self-contact, air drag and wind.

The cable model is quasi-static and knows no contact. Here grip points move a rope (MuJoCo), and
the knot is identified from where the rope is at the end. The rope has no bending stiffness; its
nodes are point masses on links of fixed length, which collide as capsules of the cable's diameter.

A simulated rope can pass through itself. So penetration, stretch and speed are watched, and beyond
the stated limits the run is void: it shows nothing. With contact switched off it shows nothing
either, since the last hanging shape alone would decide which knot comes out.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from swarm.analysis.rope_model import STEP, TIGHTENING_STEP, Grips, Rope, Seen
from swarm.analysis.swing import largest_swings
from swarm.certification.topology import layout_code
from swarm.errors import Refused, SwarmError
from swarm.geometry.catenary import solve_catenaries
from swarm.geometry.distance import strand_strand
from swarm.knots.curve import curve_gauss
from swarm.knots.gauss import same_code
from swarm.knots.invariants import identify_curve
from swarm.planning import Plan

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.intp]
Progress = Callable[[str, float], None]

LINK: Final = 0.17
"""Metres of a link where no number of links is asked for."""

MOST_PENETRATION: Final = 1.5
"""Radii; strands that are two radii deep in each other may leave on the other side."""

MOST_STRETCH: Final = 0.01
"""Share of a link's length, farther than BESIDE_GRIP from all grips."""

MOST_SPEED: Final = 12.0
"""m/s of any node; faster is a spike of the solver, not a rope of this kind."""

_TAUT: Final = 0.9995
_STRANDS: Final = 24
_AROUND: Final = 5
"""Samples of the grips' motion before and after a moment that tell how they accelerate at it."""


@dataclass(frozen=True)
class RopeRun:
    """What a rope did. Lengths in metres, times in seconds, all arrays of the same k samples.

    ``knot``, ``chirality`` and ``gauss`` are of the rope at the end, its ends closed upwards;
    ``as_planned`` compares the crossing code with the layout's, or after tightening the knot with
    the plan's. ``penetration`` is the deepest of all contacts, ``stretch`` the largest of links
    that are not beside a grip, ``speed`` the fastest of all nodes. ``void`` says why the run shows
    nothing; empty where it does show something. ``stray`` (k, m) is the largest distance of a node
    of each segment from the quasi-static cable between the same grips, ``swing`` (k, m) how far the
    budget's models of sway and a stop let that segment move at that moment. ``apart`` is the
    smallest distance between segments that share no vehicle, surface to surface, and
    ``still_apart`` that of the quasi-static cable.
    """

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
    void: tuple[str, ...]
    times: Floats
    stray: Floats
    swing: Floats
    apart: Floats
    still_apart: Floats
    shape: Floats


def planned_grips(plan: Plan) -> Grips:
    """Return the planned grip points over fold and hold, as finely as the rope is stepped."""
    start, end = plan.phase("fold").start, plan.phase("hold").end
    times = np.append(np.arange(start, end, 5 * STEP), end)
    return Grips(times, plan.motion.at(times)[0])


def simulate_rope(
    plan: Plan,
    grips: Grips,
    *,
    links: int | None = None,
    contact: bool = True,
    wind: tuple[float, float, float] = (0.0, 0.0, 0.0),
    progress: Progress | None = None,
) -> RopeRun:
    """Move a rope by its grip points and identify its knot at the end.

    ``links`` are dealt out over the segments by their lengths (None: LINK metres each), ``wind``
    blows in m/s, ENU. Where the plan tightens, its inner vehicles then let go and the ends pull
    apart. Raises :class:`Refused` where the rope is too short for the grips at the beginning.
    """
    lengths = plan.layout.lengths
    start = grips.places[0]
    if np.any(np.linalg.norm(np.diff(start, axis=0), axis=1) > _TAUT * lengths):
        raise Refused("the rope cannot hang between its grips: they begin too far apart")
    counts = _links_of(lengths, links or max(len(lengths), round(lengths.sum() / LINK)))
    held = np.concatenate([[0], np.cumsum(counts)])
    seen, log = Seen(), _Log(plan, grips, counts, held)
    cable, air = plan.mission.cable, np.array(wind)
    rope = Rope(cable, _hanging(start, lengths, counts), held, contact, air, seen)
    pulled = _tightening(plan)
    whole = float(grips.times[-1] - grips.times[0]) + (pulled.times[-1] if pulled else 0.0)
    for time, places in rope.run(grips):
        log.sample(time, rope.nodes(), places)
        if progress:
            progress("moving the rope", (time - float(grips.times[0])) / whole)
    if pulled is not None:
        folded = float(grips.times[-1] - grips.times[0])
        held, speeds = held[[0, -1]], rope.speeds()
        rope = Rope(cable, rope.nodes(), held, contact, air, seen, speeds, TIGHTENING_STEP)
        for time, _ in rope.run(pulled):
            if progress:
                progress("tightening the rope", (folded + time) / whole)
    return _judged(plan, rope, seen, log, whole, contact, tightened=pulled is not None)


def _links_of(lengths: Floats, links: int) -> Ints:
    """Deal links out by length, at least two to each segment."""
    share = lengths / lengths.sum() * links
    counts: Ints = np.maximum(np.floor(share).astype(np.intp), 2)
    for k in np.argsort(counts - share)[: max(0, links - int(counts.sum()))]:
        counts[k] += 1
    return counts


def _hanging(places: Floats, lengths: Floats, counts: Ints) -> Floats:
    """Nodes (m, 3) of the quasi-static cable between grip points (n, 3)."""
    parts = [places[:1]]
    for start, end, length, count in zip(places, places[1:], lengths, counts, strict=False):
        reach = max(float(length), float(np.linalg.norm(end - start)) / _TAUT)
        parts.append(
            solve_catenaries(start, end, reach).points(np.linspace(0.0, 1.0, count + 1))[1:]
        )
    return np.concatenate(parts)


def _tightening(plan: Plan) -> Grips | None:
    """The ends' motion (k, 2, 3) after the inner vehicles let go; None where nothing tightens."""
    phases = [phase for phase in plan.phases if phase.name == "tighten"]
    if not phases:
        return None
    times = np.append(np.arange(phases[0].start, phases[0].end, 5 * STEP), phases[0].end)
    return Grips(times - times[0], plan.motion.at(times)[0][:, [0, -1]])


class _Log:
    """Where a rope was while it was folded, every SAMPLE_INTERVAL."""

    def __init__(self, plan: Plan, grips: Grips, counts: Ints, held: Ints) -> None:
        self._plan, self._grips, self._counts, self._held = plan, grips, counts, held
        self._pairs = np.stack(np.triu_indices(len(counts), 2), axis=1)
        self.times: list[float] = []
        self.stray: list[Floats] = []
        self.swing: list[Floats] = []
        self.apart: list[float] = []
        self.still_apart: list[float] = []

    def sample(self, time: float, nodes: Floats, places: Floats) -> None:
        lengths = self._plan.layout.lengths
        still = _hanging(places, lengths, self._counts)
        self.times.append(time)
        stray = np.linalg.norm(nodes - still, axis=1)
        # a segment's first and last nodes are in its grips, where nothing strays
        self.stray.append(np.maximum.reduceat(stray, self._held[:-1]))
        braking = self._plan.mission.vehicles.braking_acceleration
        self.swing.append(largest_swings(places, self._acceleration(time), lengths, braking))
        self.apart.append(self._apart(nodes))
        self.still_apart.append(self._apart(still))

    def _acceleration(self, time: float) -> Floats:
        """The grips' acceleration (n, 3) about a moment, from where they are around it."""
        times = self._grips.times
        step = _AROUND * float(np.median(np.diff(times)))
        within = max(min(time, float(times[-1]) - step), float(times[0]) + step)
        before, now, after = self._grips.at(within + step * np.array([-1.0, 0.0, 1.0]))
        acceleration: Floats = (before - 2.0 * now + after) / step**2
        return acceleration

    def _apart(self, nodes: Floats) -> float:
        if not len(self._pairs):
            return np.inf
        share = np.linspace(0.0, 1.0, _STRANDS + 1)
        strands = []
        for begin, count in zip(self._held, self._counts, strict=False):
            part = nodes[begin : begin + count + 1]
            at = share * count
            strands.append(
                np.stack([np.interp(at, np.arange(count + 1), part[:, i]) for i in range(3)], -1)
            )
        nearest = float(strand_strand(np.array(strands), self._pairs).distance.min())
        return nearest - self._plan.mission.cable.diameter


def _judged(
    plan: Plan, rope: Rope, seen: Seen, log: _Log, whole: float, contact: bool, *, tightened: bool
) -> RopeRun:
    nodes = rope.nodes()
    radius = 0.5 * plan.mission.cable.diameter
    knot, chirality, gauss, as_planned = "unknown", "none", "", False
    try:
        found = identify_curve(nodes)
        knot, chirality = found.name, str(found.chirality)
        as_planned = (knot, chirality) == (plan.knot.type, plan.knot.chirality)
        code = curve_gauss(nodes)
        gauss = code.signed_text()
        if not tightened:
            as_planned &= same_code(code, layout_code(plan.layout))
    except SwarmError:
        pass
    void = []
    if not contact:
        void.append("contact is switched off: whatever knot comes out, it shows nothing")
    if seen.penetration > MOST_PENETRATION * radius:
        void.append(
            f"strands were {seen.penetration / radius:.2f} radii deep in each other; more than "
            f"{MOST_PENETRATION:g} is not to be trusted"
        )
    if seen.stretch > MOST_STRETCH:
        void.append(f"a link was stretched by {seen.stretch:.1%}, more than {MOST_STRETCH:.0%}")
    if seen.speed > MOST_SPEED:
        void.append(f"a node moved at {seen.speed:.1f} m/s, faster than {MOST_SPEED:g} m/s")
    return RopeRun(
        links=len(nodes) - 1,
        simulated=whole,
        contact=contact,
        knot=knot,
        chirality=chirality,
        gauss=gauss,
        as_planned=as_planned,
        tightened=tightened,
        span=float(np.linalg.norm(nodes[-1] - nodes[0])),
        contacts=seen.contacts,
        penetration=seen.penetration,
        stretch=seen.stretch,
        speed=seen.speed,
        void=tuple(void),
        times=np.array(log.times),
        stray=np.array(log.stray).reshape(-1, len(plan.layout.lengths)),
        swing=np.array(log.swing).reshape(-1, len(plan.layout.lengths)),
        apart=np.array(log.apart),
        still_apart=np.array(log.still_apart),
        shape=nodes,
    )


def stray_told(run: RopeRun) -> dict[str, Any]:
    """Return how far a rope strayed, as one JSON-ready object: where farthest, and what the
    budget's models of sway and a stop make of it there; how often it strayed farther than these,
    and by how much."""
    if not run.stray.size:
        return {"largest": 0.0, "farther": {"share": 0.0, "by": 0.0}}
    moment, segment = np.unravel_index(int(run.stray.argmax()), run.stray.shape)
    farther = run.stray - run.swing
    return {
        "largest": float(run.stray[moment, segment]),
        "segment": int(segment) + 1,
        "time": float(run.times[moment]),
        "sway_and_stop": float(run.swing[moment, segment]),
        "farther": {
            "share": float(np.mean(farther > 0.0)),
            "by": max(float(farther.max()), 0.0),
        },
    }


def told(run: RopeRun, plan: Plan) -> dict[str, Any]:
    """Return a run as one JSON-ready object."""
    radius = 0.5 * plan.mission.cable.diameter
    return {
        "links": run.links,
        "simulated": run.simulated,
        "contact": run.contact,
        "tightened": run.tightened,
        "knot": {
            "type": run.knot,
            "chirality": run.chirality,
            "gauss": run.gauss,
            "as_planned": run.as_planned,
        },
        "void": list(run.void),
        "contacts": run.contacts,
        "penetration": {
            "metres": run.penetration,
            "radii": run.penetration / radius,
            "most": MOST_PENETRATION,
        },
        "stretch": {"share": run.stretch, "most": MOST_STRETCH},
        "speed": {"metres_per_second": run.speed, "most": MOST_SPEED},
        "ends_apart": run.span,
        "smallest_distance": _smallest(run.apart),
        "smallest_distance_of_quasi_static_cable": _smallest(run.still_apart),
        "stray": stray_told(run),
    }


def _smallest(apart: Floats) -> float | None:
    return float(apart.min()) if np.isfinite(apart).all() else None
