"""The cable with inertia: one chain of masses, held at some arc lengths, that swings and falls.

`sitl.cable.rope` is the cable that follows statics. Held nodes have
the masses of their vehicles: chain and vehicles are advanced together over a step, and the mean
force of that step then acts on the vehicles in theirs, so that the momentum that one loses is what
the other gains. Grip points that turn about their vehicles drift along.

Compiled steps of a chain of point masses on elastic links: gravity, drag, floor, held nodes.

Each step moves the masses freely and then restores the lengths of all links at once: with the
compliance of the links, the Lagrange multipliers of a chain solve one tridiagonal system (extended
position-based dynamics, Macklin et al. 2016; SHAKE's directions, Ryckaert et al. 1977). A taut
chain stretches as its stiffness says, at any step. The masses of the holders are part of the same
system: a force that would act on them one step later feeds energy into a taut chain.
"""

import itertools
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from sitl.cable.grips import Cable, FreeMotion
from sitl.cable.rope import CYLINDER_DRAG, Rope
from sitl.physics.dynamics import STEP, Array
from sitl.physics.geodesy import GRAVITY
from sitl.physics.motion import AIR_DENSITY
from sitl.world import CableSpec
from swarm.jit import allocates, compiled, inner
from swarm.signatures import Bools1, Floats1, Floats2

_ITERATIONS = 4
"""Largest number of Newton steps per time step: slack links may join after the first."""
_DAMPING_TIME = 0.01
"""Seconds: the damping of a link over its stiffness. Two vehicles of 1.5 kg on four metres of taut
default cable bounce with a tenth of the critical damping."""
_PARTS = 16
"""Parts into which a step of the chain may be cut."""
_TOLERANCE = 1e-6
"""Error of a link's length in metres at which the iteration ends: on a link of 0.25 m of the
default stiffness, 6 mN."""


class ChainSpec(NamedTuple):
    """Constants of a chain: kg/m, axial stiffness EA in N, drag coefficients across and along in
    N·s²/m³ per metre, height of a resting axis, friction with the floor, gravity in m/s²."""

    mass_per_length: float
    stiffness: float
    normal_drag: float
    tangential_drag: float
    floor: float
    friction: float
    gravity: float


class Chain(NamedTuple):
    """State of a chain of n nodes.

    ``place`` and ``velocity`` (n, 3), ``mass`` (n,) of the cable at the nodes in kg, ``held`` (n,)
    whether a holder carries the node; ``mobility`` (n,) the inverse of the mass that resists the
    links: the node's own, its holder's, or 0 for a holder that nothing moves; ``air`` (n, 3)
    velocity of the air; ``rest`` (n − 1,) unstretched lengths of the links, ``intact`` (n − 1,)
    whether a link is unbroken. Means over the last interval, N: ``tension`` (n − 1,) of the links,
    ``pull`` (n, 3) of the links on the nodes.
    """

    place: Floats2
    velocity: Floats2
    mass: Floats1
    held: Bools1
    mobility: Floats1
    air: Floats2
    rest: Floats1
    intact: Bools1
    tension: Floats1
    pull: Floats2


class Guidance(NamedTuple):
    """Motion of the held nodes but for the forces of the links, (n, 3) each; other rows are unused.

    ``acceleration`` in m/s² of the holders, whose velocity is that of their node; ``drift`` in
    metres over the interval, beside their own motion: a grip point turns about its vehicle.
    """

    acceleration: Floats2
    drift: Floats2


@compiled
@allocates
def advance(chain: Chain, spec: ChainSpec, guidance: Guidance, interval: float, steps: int) -> None:
    """Advance a chain by ``interval`` seconds in ``steps`` steps, in place.

    Steps that are too long for the chain's directions are cut: in the recoil of a broken or
    released end, and where a jerk draws it taut.
    """
    nodes = len(chain.place)
    _clear(chain.tension, chain.pull)
    after, system = np.empty((nodes, 3)), np.empty((5, nodes - 1))
    impulse = np.empty((nodes - 1, 3))
    done, parts, size = 0, steps * _PARTS, _PARTS
    while done < parts:
        share = size / parts
        step = share * interval
        _move_freely(chain, spec, guidance, step, share, after)
        far = _turns_far(chain, after)
        if not (far and size > 1):
            _restore_links(chain, spec, after, system, impulse, -step if far else step)
            far = _too_tight(chain, system[4])
        if far and size > 1:
            size //= 2
            continue
        _add_means(chain, system[4], impulse, 1.0 / (step * interval))
        _touch_floor(chain, spec, after)
        for i in range(nodes):
            drift = share if chain.held[i] else 0.0
            for x in range(3):
                moved = after[i, x] - chain.place[i, x] - drift * guidance.drift[i, x]
                chain.velocity[i, x] = moved / step
                chain.place[i, x] = after[i, x]
        done += size
        if size < _PARTS and done % (2 * size) == 0:
            size *= 2


@inner
def _clear(scalars: Array, vectors: Array) -> None:
    """Write 0 to scalars (m,) and vectors (k, 3).

    Assignments to slices would say the same, and take seconds to compile.
    """
    for j in range(len(scalars)):
        scalars[j] = 0.0
    for i in range(len(vectors)):
        for x in range(3):
            vectors[i, x] = 0.0


@inner
def _too_tight(chain: Chain, multiplier: Array) -> bool:
    """Return whether nodes between taut links oscillate too fast for the step.

    Their frequency is at most 2·√(T / (m·l)). Verlet's method with the directions before the step
    is stable up to 2 / step for small oscillations; up to a third of that (T·step² / (m·l) of 0.1),
    thrown teams of three gain no energy. ``multiplier`` (n − 1,) is T times the step squared.
    """
    for j in range(len(multiplier)):
        lightest = 0.0
        for i in range(j, j + 2):
            if not chain.held[i]:
                lightest = max(lightest, chain.mobility[i])
        if multiplier[j] * lightest > 0.1 * chain.rest[j]:
            return True
    return False


@inner
def _add_means(chain: Chain, multiplier: Array, impulse: Array, scale: float) -> None:
    """Add a step's tensions and forces on the nodes to the means of the interval."""
    for j in range(len(multiplier)):
        chain.tension[j] += scale * multiplier[j]
        for x in range(3):
            chain.pull[j, x] += scale * impulse[j, x]
            chain.pull[j + 1, x] -= scale * impulse[j, x]


@inner
@allocates
def _move_freely(
    chain: Chain, spec: ChainSpec, guidance: Guidance, step: float, share: float, after: Array
) -> None:
    """Write the positions after a step without forces in the links.

    ``share`` of the drift belongs to this step.
    """
    last = len(after) - 1
    tangent, relative = np.empty(3), np.empty(3)
    for i in range(last + 1):
        if chain.held[i]:
            for x in range(3):
                push = guidance.acceleration[i, x]
                after[i, x] = chain.place[i, x] + share * guidance.drift[i, x]
                after[i, x] += step * (chain.velocity[i, x] + step * push)
            continue
        before, behind = max(i - 1, 0), min(i + 1, last)
        size = along = 0.0
        for x in range(3):
            tangent[x] = chain.place[behind, x] - chain.place[before, x]
            relative[x] = chain.velocity[i, x] - chain.air[i, x]
            size += tangent[x] ** 2
            along += relative[x] * tangent[x]
        size = max(np.sqrt(size), 1e-9)
        along /= size
        across = 0.0
        for x in range(3):
            tangent[x] /= size
            relative[x] -= along * tangent[x]
            across += relative[x] ** 2
        across = spec.normal_drag / spec.mass_per_length * np.sqrt(across)
        along *= spec.tangential_drag / spec.mass_per_length * abs(along)
        for x in range(3):
            # drag as an implicit factor, so that it never reverses a velocity
            push = -across * relative[x] / (1.0 + step * across) - along * tangent[x]
            if x == 2:
                push -= spec.gravity
            after[i, x] = chain.place[i, x] + step * (chain.velocity[i, x] + step * push)


@inner
@allocates
def _restore_links(
    chain: Chain, spec: ChainSpec, after: Array, system: Array, impulse: Array, step: float
) -> None:
    """Move nodes until links have the length that their tension gives them.

    A negative ``step`` takes the new directions instead of those before the step. The last row of
    ``system`` (5, n − 1) returns the multipliers, tension times step squared, and ``impulse``
    (n − 1, 3) their vectors.
    """
    lower, diagonal, upper, error, total = system
    links, inverse = len(error), chain.mobility
    active = np.empty(links, dtype=np.bool_)
    now, along = np.empty((links, 3)), np.empty((links, 3))
    length, before = np.empty(links), np.empty(links)
    _directions(chain.place, along, before)
    viscous = _DAMPING_TIME / abs(step)
    _clear(total, impulse)
    for _ in range(_ITERATIONS):
        _directions(after, now, length)
        if step < 0.0:
            for j in range(links):
                for x in range(3):
                    along[j, x] = now[j, x]
        for j in range(links):
            active[j] = chain.intact[j] and (length[j] > chain.rest[j] or total[j] > 0.0)
        worst = 0.0
        for j in range(links):
            lower[j] = upper[j] = error[j] = 0.0
            diagonal[j] = 1.0
            if not active[j]:
                continue
            compliance = chain.rest[j] / (spec.stiffness * step * step)
            stretching = viscous * (length[j] - max(before[j], chain.rest[j]))
            error[j] = length[j] - chain.rest[j] + stretching - compliance * total[j]
            worst = max(worst, abs(error[j]))
            diagonal[j] = (inverse[j] + inverse[j + 1]) * _dot(now, j, along, j)
            diagonal[j] = (1.0 + viscous) * diagonal[j] + compliance
            if j > 0 and active[j - 1]:
                lower[j] = -(1.0 + viscous) * inverse[j] * _dot(now, j, along, j - 1)
            if j < links - 1 and active[j + 1]:
                upper[j] = -(1.0 + viscous) * inverse[j + 1] * _dot(now, j, along, j + 1)
        if worst < _TOLERANCE:
            return
        _solve_tridiagonal(lower, diagonal, upper, error)
        for j in range(links):
            change = max(error[j], -total[j])  # a link pulls and never pushes
            total[j] += change
            for x in range(3):
                push = change * along[j, x]
                after[j, x] += inverse[j] * push
                after[j + 1, x] -= inverse[j + 1] * push
                impulse[j, x] += push


@inner
def _directions(place: Array, along: Array, length: Array) -> None:
    """Write the unit vectors (n − 1, 3) and the lengths (n − 1,) of the links."""
    for j in range(len(length)):
        square = 0.0
        for x in range(3):
            along[j, x] = place[j + 1, x] - place[j, x]
            square += along[j, x] ** 2
        length[j] = max(np.sqrt(square), 1e-12)
        for x in range(3):
            along[j, x] /= length[j]


@inner
def _turns_far(chain: Chain, after: Array) -> bool:
    """Return whether a link turns by more than about 45° in the step.

    Otherwise the directions before the step are used, as in SHAKE, which keeps the energy of an
    oscillation; a recoiling end that turns faster is restored along its new directions.
    """
    for j in range(len(after) - 1):
        dot = square = before = 0.0
        for x in range(3):
            link = after[j + 1, x] - after[j, x]
            was = chain.place[j + 1, x] - chain.place[j, x]
            dot += link * was
            square += link * link
            before += was * was
        if dot * abs(dot) < 0.5 * square * before:
            return True
    return False


@inner
def _touch_floor(chain: Chain, spec: ChainSpec, after: Array) -> None:
    """Keep free nodes above the floor; friction slows nodes by what presses them to it.

    That is what moves them below the floor: weight, air that blows down, and what links pull.
    """
    for i in range(len(after)):
        if chain.held[i] or after[i, 2] > spec.floor:
            continue
        pressed = spec.floor - after[i, 2]
        after[i, 2] = spec.floor
        east, north = after[i, 0] - chain.place[i, 0], after[i, 1] - chain.place[i, 1]
        moved = np.sqrt(east * east + north * north)
        share = max(0.0, 1.0 - spec.friction * pressed / max(moved, 1e-12))
        after[i, 0] = chain.place[i, 0] + share * east
        after[i, 1] = chain.place[i, 1] + share * north


@inner
def _dot(a: Array, i: int, b: Array, j: int) -> float:
    """Return the product of row i of ``a`` and row j of ``b``."""
    return float(a[i, 0] * b[j, 0] + a[i, 1] * b[j, 1] + a[i, 2] * b[j, 2])


LINK = 0.17
"""Length of a link in metres: a strand of four metres has 24 masses. In the fold of the overhand,
nodes are then within 3 cm of a chain with links and steps of half the length and a quarter of the
time (5 cm with 0.25 m, 1.4 cm at 99 % of moments with 0.125 m)."""
_STEPS = 4
"""Steps of the chain in one of the vehicles: 5 ms. With two or eight, nodes are as exact; with two,
most steps of a fold would be cut."""
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


class SwingingRope(Cable):
    """State of the cable with inertia: a chain.

    ``force_interval`` is 1: the chain advances with each call of `forces`, by one `STEP`.
    """

    force_interval = 1

    def __init__(self, spec: CableSpec, floor: float, wind: Array) -> None:
        super().__init__(spec, floor)
        self._spec = _chain_spec(spec, floor)
        self._offsets: dict[int, Array] = {}
        self._grips = np.zeros((0, 3))
        points = self.initial
        points[:, 2] = np.maximum(points[:, 2], self._spec.floor)
        self._wind = np.asarray(wind, dtype=float)
        self._place_nodes(self._node_arcs(), self.along, points, np.zeros_like(points))

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

    def attach(self, vehicle: int, arc: float, grip_point: Array | None = None) -> None:
        """Attach the cable to a holder at an arc length.

        It is then drawn to the ``grip_point`` (3,) from where it lies; None: it is there already.
        """
        if grip_point is not None:
            self._offsets[vehicle] = self.position_at(arc) - grip_point
        super().attach(vehicle, arc)

    def release(self, vehicle: int) -> bool:
        """Detach the cable from a holder; return whether it was attached."""
        released = super().release(vehicle)
        if released:
            self._offsets.pop(vehicle, None)
        return released

    def position_at(self, arc: float) -> Array:
        """Return the position (3,) of the cable at an arc length."""
        position: Array = self._at(np.array([arc]))[0]
        return position

    def forces(
        self,
        grips: Array,
        velocity: Array,
        free: FreeMotion | None = None,
        interval: float = STEP,
    ) -> Array:
        """Advance the chain by ``interval``; return its mean forces on all holders, N, ENU (n, 3).

        ``grips`` and ``velocity`` (n, 3) are the grip points and velocities of all holders at the
        beginning of the step, ``free`` their motion without the cable in it; without that, they
        are moved to ``grips`` by the end of the step, whatever the cable does. A link beyond the
        breaking load breaks.
        """
        chain = self._chain
        nodes, holders = self._held, [holder for _, holder in self.grips]
        drift, push = np.zeros(chain.place.shape), np.zeros(chain.place.shape)
        if holders:
            drift[nodes] = grips[holders] + self._drawn_in(interval) - chain.place[nodes]
            chain.mobility[nodes], chain.velocity[nodes] = 0.0, 0.0
        if holders and free is not None:
            mobility = free.mobility[holders]
            mobile = (mobility > 0.0)[:, None]
            push[nodes] = free.acceleration[holders]
            push[nodes, 2] -= GRAVITY * chain.mass[nodes] * mobility
            chain.mobility[nodes] = mobility
            chain.velocity[nodes] = np.where(mobile, velocity[holders], 0.0)
            drift[nodes] += np.where(mobile, self._turned(grips, velocity)[holders], 0.0)
            push[nodes] = np.where(mobile, push[nodes], 0.0)
        self._grips = grips.copy()
        steps = max(1, round(_STEPS * interval / STEP))
        advance(chain, self._spec, Guidance(push, drift), interval, steps)
        force = np.zeros(grips.shape)
        if holders:
            force[holders] = chain.pull[nodes]
            force[holders, 2] -= GRAVITY * chain.mass[nodes]
        self._break_overloaded()
        return force

    def _turned(self, grips: Array, velocity: Array) -> Array:
        """Return how far grip points moved about their vehicles in the last step (n, 3)."""
        if len(self._grips) != len(grips):
            return np.zeros_like(grips)
        turned: Array = grips - self._grips - STEP * velocity
        return turned

    def _break_overloaded(self) -> None:
        """Break the link of largest tension in each span, if it exceeds the breaking load."""
        if self._chain.tension.max(initial=0.0) <= self.spec.breaking_load:
            return
        for first, last in itertools.pairwise(self._held):
            worst = first + int(np.argmax(self._chain.tension[first:last]))
            whole = self._chain.intact[first:last].all()
            if whole and self._chain.tension[worst] > self.spec.breaking_load:
                self.breaks = sorted([*self.breaks, float(self._nodes[worst : worst + 2].mean())])
                self._chain.intact[worst] = False

    def _drawn_in(self, interval: float) -> Array:
        """Return the caught cable's remaining distances from all grip points; reduce them."""
        rest, decay = np.zeros((len(self.grips), 3)), float(np.exp(-interval / _CLOSING_TIME))
        for row, (_, holder) in enumerate(self.grips):
            if holder in self._offsets:
                self._offsets[holder] *= decay
                rest[row] = self._offsets[holder]
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
        for (first, (start, _)), (last, (stop, _)) in itertools.pairwise(
            zip(self._held, self.grips, strict=True)
        ):
            if self._chain.intact[first:last].all():
                tension.append(self._chain.tension[first:last].max())
                chord.append(np.linalg.norm(self._chain.place[last] - self._chain.place[first]))
                length.append(stop - start)
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
            held=is_held,
            mobility=np.where(is_held, 0.0, 1.0 / mass),
            air=np.tile(self._wind, (len(arcs), 1)),
            rest=rest,
            intact=intact,
            tension=np.zeros(len(rest)),
            pull=np.zeros((len(arcs), 3)),
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


@inner
def _solve_tridiagonal(lower: Array, diagonal: Array, upper: Array, right: Array) -> None:
    """Solve a tridiagonal system in place (Thomas); ``right`` becomes the solution."""
    n = len(right)
    for j in range(1, n):
        factor = lower[j] / diagonal[j - 1]
        diagonal[j] -= factor * upper[j - 1]
        right[j] -= factor * right[j - 1]
    right[n - 1] /= diagonal[n - 1]
    for j in range(n - 2, -1, -1):
        right[j] = (right[j] - upper[j] * right[j + 1]) / diagonal[j]
