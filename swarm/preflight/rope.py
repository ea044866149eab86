"""The same motion with a rope of hundreds of links: inertia, self-contact, air drag and wind.

The cable model is quasi-static and knows no contact. Here grip points move a rope (MuJoCo), and
the knot is identified from where the rope is at the end. The rope has no bending stiffness; its
nodes are point masses on links of fixed length, which collide as capsules of the cable's diameter.

A simulated rope can pass through itself. So penetration, stretch and speed are watched, and beyond
the stated limits the run is void: it shows nothing. With contact switched off it shows nothing
either, since the last hanging shape alone would decide which knot comes out.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Final

import mujoco
import numpy as np
import numpy.typing as npt

from swarm.cable.catenary import STANDARD_GRAVITY, hang
from swarm.cable.distance import strand_strand
from swarm.errors import Refused, SwarmError
from swarm.knots.curve import curve_gauss
from swarm.knots.gauss import same_code
from swarm.knots.invariants import identify_curve
from swarm.plans import Plan
from swarm.preflight.air import AIR_DENSITY, DRAG_COEFFICIENT
from swarm.preflight.budget import budgets
from swarm.preflight.certificate import tightest_moments
from swarm.preflight.topology import layout_code

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.intp]
Progress = Callable[[str, float], None]

STEP: Final = 0.002
"""Seconds; at 5 ms strands were seen to pass through each other."""

TIGHTENING_STEP: Final = 0.0005
"""Seconds, once the inner vehicles have let go: rope that falls three metres is so much faster."""

SAMPLE_INTERVAL: Final = 0.2
LINK: Final = 0.17
"""Metres of a link where no number of links is asked for."""

MOST_PENETRATION: Final = 1.5
"""Radii; strands that are two radii deep in each other may leave on the other side."""

MOST_STRETCH: Final = 0.01
"""Share of a link's length, farther than BESIDE_GRIP from all grips."""

BESIDE_GRIP: Final = 0.3
"""Metres of rope. A held node is put from place to place, and no constraint knows how fast it
moves: links beside it lag by its speed times two steps, some millimetres."""

MOST_SPEED: Final = 12.0
"""m/s of any node; faster is a spike of the solver, not a rope of this kind."""

CONTACT_STEPS: Final = 2
"""Steps in which contacts and links answer, MuJoCo's least: a strand comes in by its speed times
this, and may leave on the other side."""

STIFF: Final = "0.99 0.999 0.001"
"""Impedance of links and contacts (MuJoCo's solimp): by default short links stretch by 3 %."""

FRICTION: Final = 0.3
_DRAG_EVERY: Final = 5
_WATCH_EVERY: Final = 5
_TAUT: Final = 0.9995
_STRANDS: Final = 24


@dataclass(frozen=True, eq=False)
class Grips:
    """Where the grip points (k, n, 3) are at increasing times (k,), seconds; straight between."""

    times: Floats
    places: Floats

    def at(self, times: Floats) -> Floats:
        """Return the grip points (m, n, 3) at times (m,)."""
        k = np.clip(np.searchsorted(self.times, times, side="right") - 1, 0, len(self.times) - 2)
        share = (times - self.times[k]) / (self.times[k + 1] - self.times[k])
        before, after = self.places[k], self.places[k + 1]
        found: Floats = before + np.clip(share, 0.0, 1.0)[:, None, None] * (after - before)
        return found


@dataclass(frozen=True)
class RopeRun:
    """What a rope did. Lengths in metres, times in seconds, all arrays of the same k samples.

    ``knot``, ``chirality`` and ``gauss`` are of the rope at the end, its ends closed upwards;
    ``as_planned`` compares the crossing code with the layout's, or after tightening the knot with
    the plan's. ``penetration`` is the deepest of all contacts, ``stretch`` the largest of links
    that are not beside a grip, ``speed`` the fastest of all nodes. ``void`` says why the run shows
    nothing; empty where it does show something. ``stray`` is the largest distance of a node from
    the quasi-static cable between the same grips, ``apart`` the smallest between segments that
    share no vehicle, surface to surface.
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
    apart: Floats
    shape: Floats


def planned_grips(plan: Plan) -> Grips:
    """Return the planned grip points over fold and hold, as finely as the rope is stepped."""
    start, end = plan.phase("fold").start, plan.phase("hold").end
    times = np.append(np.arange(start, end, 5 * STEP), end)
    return Grips(times, plan.motion.at(times)[0])


def move_rope(
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
    rope = _Rope(plan, _hanging(start, lengths, counts), held, contact, np.array(wind))
    log = _Log(plan, counts, held)
    pulled = _tightening(plan)
    whole = float(grips.times[-1] - grips.times[0]) + (pulled.times[-1] if pulled else 0.0)
    for done in rope.run(grips, log):
        if progress:
            progress("moving the rope", done / whole)
    if pulled is not None:
        folded = float(grips.times[-1] - grips.times[0])
        held, speeds = held[[0, -1]], rope.speeds()
        rope = _Rope(plan, rope.nodes(), held, contact, np.array(wind), speeds, TIGHTENING_STEP)
        log.tightening = True
        for done in rope.run(pulled, log):
            if progress:
                progress("tightening the rope", (folded + done) / whole)
    return _judged(plan, rope, log, whole, contact, tightened=pulled is not None)


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
        parts.append(hang(start, end, reach).points(np.linspace(0.0, 1.0, count + 1))[1:])
    return np.concatenate(parts)


def _tightening(plan: Plan) -> Grips | None:
    """The ends' motion (k, 2, 3) after the inner vehicles let go; None where nothing tightens."""
    phases = [phase for phase in plan.phases if phase.name == "tighten"]
    if not phases:
        return None
    times = np.append(np.arange(phases[0].start, phases[0].end, 5 * STEP), phases[0].end)
    return Grips(times - times[0], plan.motion.at(times)[0][:, [0, -1]])


class _Rope:
    """A rope in MuJoCo: a one-dimensional flex whose held nodes are moved from outside."""

    def __init__(
        self,
        plan: Plan,
        nodes: Floats,
        held: Ints,
        contact: bool,
        wind: Floats,
        speeds: Floats | None = None,
        step: float = STEP,
    ) -> None:
        self._step = step
        cable = plan.mission.cable
        links = np.linalg.norm(np.diff(nodes, axis=0), axis=1)
        mass = cable.mass_per_length * float(links.mean())
        self._model = mujoco.MjModel.from_xml_string(
            _description(nodes, set(held.tolist()), 0.5 * cable.diameter, mass, contact, step)
        )
        self._data = mujoco.MjData(self._model)
        self._start = nodes
        self._free = np.setdiff1d(np.arange(len(nodes)), held)
        self._held = held
        if speeds is not None:
            self._data.qvel[:] = speeds[self._free].ravel()
        mujoco.mj_forward(self._model, self._data)
        self._rest = self._model.flexedge_length0.copy()
        arc = np.append(0.0, np.cumsum(links))
        middles = 0.5 * (arc[1:] + arc[:-1])
        self._away = np.abs(middles[:, None] - arc[held]).min(axis=1) > BESIDE_GRIP
        self._load = 0.5 * AIR_DENSITY * DRAG_COEFFICIENT * cable.diameter
        self._wind = wind
        self._speed_of_held = np.zeros((len(held), 3))

    def nodes(self) -> Floats:
        """Return the nodes (m, 3)."""
        return np.array(self._data.flexvert_xpos)

    def speeds(self) -> Floats:
        """Return the nodes' velocities (m, 3)."""
        velocity = np.zeros((len(self._start), 3))
        velocity[self._free] = self._data.qvel.reshape(-1, 3)
        velocity[self._held] = self._speed_of_held
        return velocity

    def run(self, grips: Grips, log: "_Log") -> Iterator[float]:
        """Step through the motion, writing to the log; yields the seconds done, now and then."""
        model, data = self._model, self._data
        step = self._step
        steps = round(float(grips.times[-1] - grips.times[0]) / step)
        every = round(SAMPLE_INTERVAL / step)
        for begin in range(0, steps, every):
            count = min(every, steps - begin)
            times = grips.times[0] + step * np.arange(begin, begin + count + 1)
            places = grips.at(times)
            for k in range(count):
                self._speed_of_held = (places[k + 1] - places[k]) / step
                data.mocap_pos[:] = places[k + 1]
                if k % _DRAG_EVERY == 0:
                    self._drag()
                mujoco.mj_step(model, data)
                if k % _WATCH_EVERY == 0:
                    self._watch(log)
            log.sample(float(times[-1]), self.nodes(), places[-1])
            yield step * (begin + count)

    def _drag(self) -> None:
        """Drag of a cylinder across the flow on every node's share of the rope (Morison)."""
        nodes, velocity = self._data.flexvert_xpos, self.speeds()
        along = np.empty_like(nodes)
        along[1:-1] = nodes[2:] - nodes[:-2]
        along[0], along[-1] = nodes[1] - nodes[0], nodes[-1] - nodes[-2]
        size = np.sqrt(np.einsum("ij,ij->i", along, along))
        along /= size[:, None]
        air = self._wind - velocity
        air -= np.einsum("ij,ij->i", air, along)[:, None] * along
        flow = np.sqrt(np.einsum("ij,ij->i", air, air))
        force = (0.5 * self._load * size * flow)[:, None] * air
        self._data.qfrc_applied[:] = force[self._free].ravel()

    def _watch(self, log: "_Log") -> None:
        data = self._data
        stretch = data.flexedge_length / self._rest - 1.0
        log.stretch = max(log.stretch, float(stretch[self._away].max(initial=0.0)))
        velocity = data.qvel.reshape(-1, 3)
        log.speed = max(log.speed, float(np.sqrt(np.einsum("ij,ij->i", velocity, velocity).max())))
        if data.ncon:
            depth = -data.contact.dist[data.contact.flex[:, 0] == data.contact.flex[:, 1]]
            log.contacts = max(log.contacts, len(depth))
            log.penetration = max(log.penetration, float(depth.max(initial=0.0)))


class _Log:
    """What is written down while a rope moves."""

    def __init__(self, plan: Plan, counts: Ints, held: Ints) -> None:
        self._plan, self._counts, self._held = plan, counts, held
        self._pairs = np.stack(np.triu_indices(len(counts), 2), axis=1)
        self.penetration = self.stretch = self.speed = 0.0
        self.contacts = 0
        self.tightening = False
        self.times: list[float] = []
        self.stray: list[float] = []
        self.apart: list[float] = []

    def sample(self, time: float, nodes: Floats, places: Floats) -> None:
        if self.tightening:
            return
        still = _hanging(places, self._plan.layout.lengths, self._counts)
        self.times.append(time)
        self.stray.append(float(np.linalg.norm(nodes - still, axis=1).max()))
        self.apart.append(self._apart(nodes))

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
    plan: Plan, rope: _Rope, log: _Log, whole: float, contact: bool, *, tightened: bool
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
    if log.penetration > MOST_PENETRATION * radius:
        void.append(
            f"strands were {log.penetration / radius:.2f} radii deep in each other; more than "
            f"{MOST_PENETRATION:g} is not to be trusted"
        )
    if log.stretch > MOST_STRETCH:
        void.append(f"a link was stretched by {log.stretch:.1%}, more than {MOST_STRETCH:.0%}")
    if log.speed > MOST_SPEED:
        void.append(f"a node moved at {log.speed:.1f} m/s, faster than {MOST_SPEED:g} m/s")
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
        contacts=log.contacts,
        penetration=log.penetration,
        stretch=log.stretch,
        speed=log.speed,
        void=tuple(void),
        times=np.array(log.times),
        stray=np.array(log.stray),
        apart=np.array(log.apart),
        shape=nodes,
    )


def sway_budget(plan: Plan) -> float:
    """Return the sway that the budget allows for: the most at any of the tightest moments, metres.

    Leaning with the planned acceleration and the swing after a stop, of both strands together.
    """
    rows = budgets(plan, tightest_moments(plan, checks=("cable clearance",)))
    return max((row.sway + row.stop for row in rows), default=0.0)


def _description(
    nodes: Floats, held: set[int], radius: float, mass: float, contact: bool, step: float
) -> str:
    """Return the rope as MuJoCo's XML: point masses that slide freely, and held ones."""
    answer = CONTACT_STEPS * step
    bodies = []
    slides = "".join(f'<joint type="slide" axis="{axis}"/>' for axis in ("1 0 0", "0 1 0", "0 0 1"))
    point = f'<inertial pos="0 0 0" mass="{mass:.9g}" diaginertia="1e-9 1e-9 1e-9"/>'
    for k, place in enumerate(nodes):
        at = " ".join(f"{value:.12g}" for value in place)
        inner = "" if k in held else slides + point
        mocap = ' mocap="true"' if k in held else ""
        bodies.append(f'<body name="n{k}" pos="{at}"{mocap}>{inner}</body>')
    names = " ".join(f"n{k}" for k in range(len(nodes)))
    links = " ".join(f"{k} {k + 1}" for k in range(len(nodes) - 1))
    collide = "auto" if contact else "none"
    floor = (
        f'<geom type="plane" size="500 500 1" friction="0.3" solref="{answer} 1"/>'
        if contact
        else ""
    )
    return f"""<mujoco>
  <compiler boundinertia="1e-12"/>
  <option timestep="{step}" integrator="implicitfast" solver="Newton" jacobian="sparse"
    gravity="0 0 {-STANDARD_GRAVITY}"/>
  <size memory="256M"/>
  <worldbody>{floor}{"".join(bodies)}</worldbody>
  <deformable>
    <flex name="rope" dim="1" radius="{radius:.9g}" body="{names}"
      vertex="{" ".join(["0 0 0"] * len(nodes))}" element="{links}">
      <contact selfcollide="{collide}" condim="3" solref="{answer} 1" solimp="{STIFF}"
        friction="{FRICTION} 0.005 0.0001"/>
    </flex>
  </deformable>
  <equality><flex flex="rope" solref="{answer} 1" solimp="{STIFF}"/></equality>
</mujoco>"""


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
        "smallest_distance": float(run.apart.min()) if np.isfinite(run.apart).all() else None,
        "stray": {"largest": float(run.stray.max(initial=0.0)), "budget": sway_budget(plan)},
    }
