"""Compiled steps of a chain of point masses on elastic links: gravity, drag, floor, held nodes.

Each step moves the masses freely and then restores the lengths of all links at once: with the
compliance of the links, the Lagrange multipliers of a chain solve one tridiagonal system (extended
position-based dynamics, Macklin et al. 2016; SHAKE's directions, Ryckaert et al. 1977). A taut
chain stretches as its stiffness says, at any step. The masses of the holders are part of the same
system: a force that would act on them one step later feeds energy into a taut chain.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from swarm.geometry.lumped_mass import solve_tridiagonal
from swarm.jit import allocates, compiled, inner
from swarm.signatures import Bools1, Floats1, Floats2

Array = NDArray[np.float64]

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
        _touch_floor(chain, spec, after, step)
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
        solve_tridiagonal(lower, diagonal, upper, error)
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
def _touch_floor(chain: Chain, spec: ChainSpec, after: Array, step: float) -> None:
    """Keep free nodes above the floor; friction slows nodes that lie on it."""
    for i in range(len(after)):
        if chain.held[i] or after[i, 2] > spec.floor:
            continue
        after[i, 2] = spec.floor
        east, north = after[i, 0] - chain.place[i, 0], after[i, 1] - chain.place[i, 1]
        moved = np.sqrt(east * east + north * north)
        kept = max(0.0, 1.0 - spec.friction * spec.gravity * step * step / max(moved, 1e-12))
        after[i, 0] = chain.place[i, 0] + kept * east
        after[i, 1] = chain.place[i, 1] + kept * north


@inner
def _dot(a: Array, i: int, b: Array, j: int) -> float:
    """Return the product of row i of ``a`` and row j of ``b``."""
    return float(a[i, 0] * b[j, 0] + a[i, 1] * b[j, 1] + a[i, 2] * b[j, 2])
