"""Compiled steps of a chain of point masses on elastic links: gravity, drag, floor, held nodes.

Each step moves the masses freely and then restores the lengths of all links at once: with the
compliance of the links, the Lagrange multipliers of a chain solve one tridiagonal system (extended
position-based dynamics, Macklin et al. 2016; SHAKE's directions, Ryckaert et al. 1977). A taut
chain stretches as its stiffness says, at any step.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from swarm.geometry.lumped_mass import solve_tridiagonal
from swarm.jit import compiled

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

_ITERATIONS = 4
"""Newton steps per time step; where all links pull, two leave them within micrometres."""


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

    ``place`` and ``velocity`` (n, 3), ``mass`` (n,) in kg, ``mobility`` (n,) its inverse, 0 for
    nodes that are moved from outside, ``air`` (n, 3) velocity of the air; ``rest`` (n − 1,)
    unstretched lengths of the links, ``intact`` (n − 1,) whether a link is unbroken, ``tension``
    (n − 1,) mean tension of the links in the last steps, N.
    """

    place: Array
    velocity: Array
    mass: Array
    mobility: Array
    air: Array
    rest: Array
    intact: Flags
    tension: Array


@compiled
def advance(chain: Chain, spec: ChainSpec, target: Array, interval: float, steps: int) -> None:
    """Advance a chain by ``interval`` seconds in ``steps`` steps, in place.

    Held nodes move in a straight line to ``target`` (n, 3).
    """
    nodes, step = len(chain.place), interval / steps
    chain.tension[:] = 0.0
    after, system = np.empty((nodes, 3)), np.empty((5, nodes - 1))
    for k in range(steps):
        _move_freely(chain, spec, target, step, 1.0 / (steps - k), after)
        _restore_links(chain, spec, after, system, step)
        for j in range(nodes - 1):
            chain.tension[j] += system[4, j] / (step * step * steps)
        _touch_floor(chain, spec, after, step)
        for i in range(nodes):
            for x in range(3):
                chain.velocity[i, x] = (after[i, x] - chain.place[i, x]) / step
                chain.place[i, x] = after[i, x]


@compiled
def _move_freely(
    chain: Chain, spec: ChainSpec, target: Array, step: float, share: float, after: Array
) -> None:
    """Write the positions after a step without forces in the links; held nodes as given."""
    last = len(after) - 1
    tangent, relative = np.empty(3), np.empty(3)
    for i in range(last + 1):
        if chain.mobility[i] == 0.0:
            for x in range(3):
                after[i, x] = chain.place[i, x] + share * (target[i, x] - chain.place[i, x])
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


@compiled
def _restore_links(chain: Chain, spec: ChainSpec, after: Array, system: Array, step: float) -> None:
    """Move free nodes until links have the length that their tension gives them.

    The last row of ``system`` (5, n − 1) returns the multipliers: tension times step squared.
    """
    lower, diagonal, upper, error, total = system
    links, inverse = len(error), chain.mobility
    active = np.empty(links, dtype=np.bool_)
    now, along = np.empty((links, 3)), np.empty((links, 3))
    length = np.empty(links)
    _directions(chain.place, along, length)
    smooth = _directions_agree(after, along)
    total[:] = 0.0
    for _ in range(_ITERATIONS):
        _directions(after, now, length)
        if not smooth:
            along[:] = now
        for j in range(links):
            active[j] = chain.intact[j] and (length[j] > chain.rest[j] or total[j] > 0.0)
        for j in range(links):
            lower[j] = upper[j] = error[j] = 0.0
            diagonal[j] = 1.0
            if not active[j]:
                continue
            compliance = chain.rest[j] / (spec.stiffness * step * step)
            error[j] = length[j] - chain.rest[j] - compliance * total[j]
            diagonal[j] = (inverse[j] + inverse[j + 1]) * _dot(now, j, along, j) + compliance
            if j > 0 and active[j - 1]:
                lower[j] = -inverse[j] * _dot(now, j, along, j - 1)
            if j < links - 1 and active[j + 1]:
                upper[j] = -inverse[j + 1] * _dot(now, j, along, j + 1)
        solve_tridiagonal(lower, diagonal, upper, error)
        for j in range(links):
            change = max(error[j], -total[j])  # a link pulls and never pushes
            total[j] += change
            for x in range(3):
                after[j, x] += inverse[j] * change * along[j, x]
                after[j + 1, x] -= inverse[j + 1] * change * along[j, x]


@compiled
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


@compiled
def _directions_agree(after: Array, along: Array) -> bool:
    """Return whether no link turns by more than about 45° in the step.

    Then the directions before the step are used, as in SHAKE, which keeps the energy of an
    oscillation; a recoiling end that turns faster is restored along its new directions.
    """
    for j in range(len(along)):
        dot = square = 0.0
        for x in range(3):
            link = after[j + 1, x] - after[j, x]
            dot += link * along[j, x]
            square += link * link
        if dot * abs(dot) < 0.5 * square:
            return False
    return True


@compiled
def _touch_floor(chain: Chain, spec: ChainSpec, after: Array, step: float) -> None:
    """Keep free nodes above the floor; friction slows nodes that lie on it."""
    for i in range(len(after)):
        if chain.mobility[i] == 0.0 or after[i, 2] > spec.floor:
            continue
        after[i, 2] = spec.floor
        east, north = after[i, 0] - chain.place[i, 0], after[i, 1] - chain.place[i, 1]
        moved = np.sqrt(east * east + north * north)
        kept = max(0.0, 1.0 - spec.friction * spec.gravity * step * step / max(moved, 1e-12))
        after[i, 0] = chain.place[i, 0] + kept * east
        after[i, 1] = chain.place[i, 1] + kept * north


@compiled
def _dot(a: Array, i: int, b: Array, j: int) -> float:
    """Return the product of row i of ``a`` and row j of ``b``."""
    return float(a[i, 0] * b[j, 0] + a[i, 1] * b[j, 1] + a[i, 2] * b[j, 2])
