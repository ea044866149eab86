"""The cable with inertia: one chain of masses, held at some arc lengths, that swings and falls.

It has the interface of :class:`sitl.cable.rope.Rope`, whose cable follows statics. Held nodes move
with their grip points; the chain's tension there pulls on the vehicles, one step later.
"""

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sitl.cable.chain_dynamics import Chain, ChainSpec, advance
from sitl.cable.grips import SPACING, caught, nearest_free, slid
from sitl.cable.rope import CYLINDER_DRAG, Rope
from sitl.physics.dynamics import STEP
from sitl.physics.geodesy import GRAVITY
from sitl.physics.motion import AIR_DENSITY
from sitl.world import CableSpec

Array = NDArray[np.float64]

LINK = 0.25
"""Length of a link in metres: a strand of four metres has sixteen masses."""
_STEPS = 4
"""Steps of the chain in one of the vehicles: 5 ms."""
_TANGENTIAL_DRAG = 0.02
"""Friction coefficient of the cable's surface along the flow: assumed."""
_FRICTION = 0.3
"""Friction coefficient of the cable on the floor: assumed."""
_CLOSING_TIME = 0.2
"""Seconds in which a closed gripper draws the caught cable to its grip point."""


@dataclass(frozen=True, eq=False)
class SpanState:
    """The unbroken spans between grips: largest tension (N), chord and length (m), each (k,)."""

    tension: Array
    chord: Array
    length: Array


class SwingingRope:
    """State of the cable: grips, breaks, the chain, and its positions at the samples.

    ``grips`` are (arc length, holder) in order, ``shape`` (m, 3) the samples at ``arc`` (m,).
    ``force_interval`` is 1: the chain advances with each call of `forces`, by one `STEP`.
    """

    force_interval = 1

    def __init__(self, spec: CableSpec, floor: float, wind: Array) -> None:
        self.spec = spec
        points = np.array(spec.points, dtype=float)
        steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
        along = np.concatenate([[0.0], np.cumsum(steps)])
        self.length = float(along[-1])
        self.floor = floor
        self.arc = np.linspace(0.0, self.length, max(2, int(np.ceil(self.length / SPACING)) + 1))
        self.grips: list[tuple[float, int]] = []
        self.breaks: list[float] = []
        self._spec = _chain_spec(spec, floor)
        self._offsets: dict[int, Array] = {}
        points[:, 2] = np.maximum(points[:, 2], self._spec.floor)
        self._wind = np.asarray(wind, dtype=float)
        self._place_nodes(self._node_arcs(), along, points, np.zeros_like(points))

    def set_wind(self, wind: Array) -> None:
        """Set the steady wind (m/s, ENU) along the whole cable."""
        self._wind = np.asarray(wind, dtype=float)
        self._chain.air[:] = self._wind

    def set_wash(self, speed: Array, stride: int = 1) -> None:
        """Set the downwash of each vehicle at every ``stride``-th sample (k, n), m/s.

        The largest one counts at each node; that of the holders of a span is omitted on it: it
        meets the cable only close to their grips.
        """
        arc = self.arc[::stride]
        felt = speed.copy()
        arcs = [grip for grip, _ in self.grips]
        behind = np.searchsorted(arcs, arc, side="right")
        for number, (_, holder) in enumerate(self.grips):
            if holder < felt.shape[1]:
                felt[(behind == number) | (behind == number + 1), holder] = 0.0
        self._chain.air[:] = self._wind
        self._chain.air[:, 2] -= np.interp(self._nodes, arc, felt.max(axis=1))

    def grab(self, vehicle: int, grip_point: Array) -> float | None:
        """Close a gripper; return the arc length that it holds, None if no cable is in reach."""
        arc = caught(self.grips, self.arc, self.shape, grip_point)
        if arc is not None:
            self.attach(vehicle, arc)
            self._offsets[vehicle] = self.position_at(arc) - grip_point
        return arc

    def attach(self, vehicle: int, arc: float) -> None:
        """Attach the cable to a holder at an arc length."""
        self.grips = sorted([*self.grips, (arc, vehicle)])
        self._rebuild()

    def release(self, vehicle: int) -> bool:
        """Detach the cable from a holder; return whether it was attached."""
        kept = [grip for grip in self.grips if grip[1] != vehicle]
        if len(kept) == len(self.grips):
            return False
        self.grips = kept
        self._offsets.pop(vehicle, None)
        self._rebuild()
        return True

    def slide(self, vehicle: int, distance: float) -> None:
        """Move a grip along the cable, at most to its neighbours, a break or the cable's ends."""
        self.grips = slid(self.grips, vehicle, distance, [0.0, *self.breaks, self.length])
        self._rebuild()

    def nearest_free(self, arc: float) -> float:
        """Return the arc length nearest to ``arc`` that is at least SPACING from all grips."""
        return nearest_free(self.grips, self.arc, arc)

    def position_at(self, arc: float) -> Array:
        """Return the position (3,) of the cable at an arc length."""
        position: Array = self._at(np.array([arc]))[0]
        return position

    def forces(self, grips: Array, velocity: Array) -> Array:
        """Advance the chain by `STEP`; return its forces on all holders, newtons, ENU (n, 3).

        ``grips`` (n, 3) are the grip points of all holders; ``velocity`` is not needed here. A link
        beyond the breaking load breaks.
        """
        del velocity
        chain, held = self._chain, self._held
        target = chain.place.copy()
        for node, (_, holder) in zip(held, self.grips, strict=True):
            target[node] = grips[holder] + self._drawn_in(holder)
        advance(chain, self._spec, target, STEP, _STEPS)
        force = np.zeros_like(grips)
        pull = _pulls(chain)
        pull[:, 2] -= GRAVITY * chain.mass
        for node, (_, holder) in zip(held, self.grips, strict=True):
            force[holder] += pull[node]
        self._break_overloaded()
        return force

    def _break_overloaded(self) -> None:
        """Break the link of largest tension in each span, if it exceeds the breaking load."""
        for first, last in itertools.pairwise(self._held):
            worst = first + int(np.argmax(self._chain.tension[first:last]))
            whole = self._chain.intact[first:last].all()
            if whole and self._chain.tension[worst] > self.spec.breaking_load:
                self.breaks = sorted([*self.breaks, float(self._nodes[worst : worst + 2].mean())])
                self._chain.intact[worst] = False

    def _drawn_in(self, holder: int) -> Array | float:
        """Return the rest of a caught cable's distance from its grip point, and reduce it."""
        if holder not in self._offsets:
            return 0.0
        self._offsets[holder] = self._offsets[holder] * float(np.exp(-STEP / _CLOSING_TIME))
        rest: Array = self._offsets[holder]
        return rest

    def within_reach(self, centre: Array, radius: Array) -> bool:
        """Return whether a node is close enough for a disc of any vehicle to touch the cable."""
        gaps = np.linalg.norm(self._chain.place[:, None] - centre, axis=2)
        return bool((gaps < radius + 2.0 * LINK).any())

    def update(self, grips: Array, interval: float, *, solved: bool = False) -> Array:
        """Return the present positions of all samples (m, 3); the chain advances in `forces`."""
        del grips, interval, solved
        self.shape = self._at(self.arc)
        return self.shape

    @property
    def solved(self) -> SpanState:
        """State of the unbroken spans between neighbouring grips."""
        tension, chord, length = [], [], []
        for (first, one), (last, other) in itertools.pairwise(
            zip(self._held, self.grips, strict=True)
        ):
            if self._chain.intact[first:last].all():
                tension.append(self._chain.tension[first:last].max())
                chord.append(np.linalg.norm(self._chain.place[last] - self._chain.place[first]))
                length.append(other[0] - one[0])
        return SpanState(np.array(tension), np.array(chord), np.array(length))

    def _at(self, arc: Array) -> Array:
        return _interpolate(arc, self._nodes, self._chain.place)

    def _rebuild(self) -> None:
        """Take the present state to new nodes, after a grip or a release."""
        self._place_nodes(self._node_arcs(), self._nodes, self._chain.place, self._chain.velocity)

    def _node_arcs(self) -> Array:
        """Return arc lengths of nodes: one at every grip, the others about LINK apart."""
        count = max(2, int(np.ceil(self.length / LINK)) + 1)
        arcs = np.linspace(0.0, self.length, count)
        if not self.grips:
            return arcs
        held = np.array([arc for arc, _ in self.grips])
        near = np.abs(arcs[:, None] - held).min(axis=1)
        ends = (arcs == 0.0) | (arcs == self.length)
        return np.union1d(arcs[(near > 0.5 * LINK) | (ends & (near > 0.02))], held)

    def _place_nodes(self, arcs: Array, known: Array, place: Array, velocity: Array) -> None:
        """Put nodes at ``arcs`` (k,), their state interpolated from (m, 3) at ``known`` (m,)."""
        self._held = np.searchsorted(arcs, np.array([arc for arc, _ in self.grips]))
        is_held = np.zeros(len(arcs), dtype=bool)
        is_held[self._held] = True
        intact = np.ones(len(arcs) - 1, dtype=bool)
        intact[np.searchsorted(arcs, np.array(self.breaks)) - 1] = False
        rest = np.diff(arcs)
        mass = 0.5 * self.spec.mass_per_length * (np.append(rest, 0.0) + np.append(0.0, rest))
        self._nodes = arcs
        self._chain = Chain(
            place=_interpolate(arcs, known, place),
            velocity=_interpolate(arcs, known, velocity),
            mass=mass,
            mobility=np.where(is_held, 0.0, 1.0 / mass),
            air=np.tile(self._wind, (len(arcs), 1)),
            rest=rest,
            intact=intact,
            tension=np.zeros(len(rest)),
        )
        self.shape = self._at(self.arc)


AnyRope = Rope | SwingingRope


def make_rope(spec: CableSpec, floor: float, wind: Array) -> AnyRope:
    """Return the cable in the model that its specification names."""
    return (SwingingRope if spec.model == "swinging" else Rope)(spec, floor, wind)


def _chain_spec(spec: CableSpec, floor: float) -> ChainSpec:
    drag = 0.5 * AIR_DENSITY * spec.diameter
    return ChainSpec(
        mass_per_length=spec.mass_per_length,
        stiffness=spec.stiffness,
        normal_drag=drag * CYLINDER_DRAG,
        tangential_drag=drag * np.pi * _TANGENTIAL_DRAG,
        floor=floor + 0.5 * spec.diameter,
        friction=_FRICTION,
        gravity=GRAVITY,
    )


def _interpolate(arcs: Array, known: Array, values: Array) -> Array:
    """Return vectors (k, 3) at arc lengths (k,), between ``values`` (m, 3) at ``known`` (m,)."""
    return np.column_stack([np.interp(arcs, known, values[:, x]) for x in range(3)])


def _pulls(chain: Chain) -> Array:
    """Return the forces of the links on the nodes (n, 3), newtons."""
    step = np.diff(chain.place, axis=0)
    along = step / np.maximum(np.linalg.norm(step, axis=1, keepdims=True), 1e-9)
    pull = chain.tension[:, None] * along
    total = np.zeros_like(chain.place)
    total[:-1] += pull
    total[1:] -= pull
    return total
