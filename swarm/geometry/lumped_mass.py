"""The swinging cable: strands as lumped masses on inextensible links, their ends moved as given.

Each strand is cut into equal links with a mass at each inner joint (the lumped-mass model of
mooring lines; Walton and Polachek 1960). Verlet's method steps the masses under gravity and drag;
the links keep their length by the constraint forces of SHAKE (Ryckaert et al. 1977), which for a
chain are one tridiagonal system, solved exactly instead of link by link. Strands do not touch each
other, the floor or the vehicles, and do not act on the vehicles.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from swarm.geometry.catenary import STANDARD_GRAVITY, solve_catenaries
from swarm.jit import compiled
from swarm.signatures import Columns4, Floats3

Floats = npt.NDArray[np.float64]

AIR_DENSITY = 1.225
"""kg/m³ at sea level, 15 °C (ISO 2533)."""

NORMAL_DRAG = 1.1
"""Drag coefficient of a cylinder across the flow, at the Reynolds numbers of a cable (Hoerner 1965,
p. 3-9)."""

TANGENTIAL_DRAG = 0.02
"""Friction coefficient of a cable along the flow: assumed, of the order of rough surfaces'. Without
it, joints move by up to 3 mm in the fold of the default overhand, 5 mm in the figure-eight's."""

LINKS, STEP = 24, 0.01
"""Links of a strand and seconds: half the step changes the stray of the default missions' strands
by less than a centimetre."""

_ITERATIONS = 8
"""Newton steps for the link lengths; two or three are enough at the accelerations of a fold."""

_TOLERANCE = 1e-10
"""Relative error of a squared link length at which the iteration ends."""


@dataclass(frozen=True)
class SwingModel:
    """Discretization and air of the lumped-mass model.

    ``links`` per strand; ``step`` of the integration in seconds; ``normal_drag`` and
    ``tangential_drag`` are ½ρ·C·d / μ in 1/m, the deceleration of the cable over the square of its
    speed across and along itself (d: diameter, μ: mass per length); ``wind`` in m/s, ENU.
    """

    links: int
    step: float
    normal_drag: float
    tangential_drag: float = 0.0
    wind: tuple[float, float, float] = (0.0, 0.0, 0.0)


def cable_model(mass_per_length: float, diameter: float) -> SwingModel:
    """Return the model of a cable of kg/m and a diameter in metres, in still air."""
    pressure = 0.5 * AIR_DENSITY * diameter / mass_per_length
    return SwingModel(LINKS, STEP, pressure * NORMAL_DRAG, pressure * math.pi * TANGENTIAL_DRAG)


def swing(ends: Floats, lengths: Floats, model: SwingModel, every: int = 1) -> Floats:
    """Return the joints of swinging strands whose ends move as given.

    ``ends`` (k, n, 3) are the positions of n grip points, ENU metres, ``model.step`` seconds apart;
    ``lengths`` (n − 1,) belong to the strands between them. All strands begin at rest as
    catenaries. Returns (ceil(k / every), n − 1, links + 1, 3): each ``every``-th step.

    Raises :class:`swarm.geometry.catenary.OverStretched` where the first chord is longer than its
    strand; later, a strand that is pulled taut ends as NaN.
    """
    return swing_on(at_rest(ends[0], lengths, model), ends, lengths, model, every)[:, 1]


def at_rest(ends: Floats, lengths: Floats, model: SwingModel) -> Floats:
    """Return the state (2, n − 1, links + 1, 3) of strands that hang still between ends (n, 3).

    A state holds the joints one step ago, and now. Raises
    :class:`swarm.geometry.catenary.OverStretched` where a chord is longer than its strand.
    """
    fractions = np.linspace(0.0, 1.0, model.links + 1)
    joints = solve_catenaries(ends[:-1], ends[1:], lengths).points(fractions)
    return np.stack([joints, joints])


def swing_on(
    state: Floats, ends: Floats, lengths: Floats, model: SwingModel, every: int = 1
) -> Floats:
    """Return the states of strands that continue from a state, as :func:`swing` from rest.

    ``ends`` (k, n, 3) begin at the state's time. Returns (ceil(k / every), 2, n − 1, links + 1, 3),
    the given state first.
    """
    samples = (len(ends) + every - 1) // every
    found = np.empty((samples, *state.shape))
    found[0] = state
    drag = Drag(model.normal_drag, model.tangential_drag, *model.wind)
    for strand in range(len(lengths)):
        moved = np.ascontiguousarray(ends[:, strand : strand + 2])
        steps = _Steps(lengths[strand] / model.links, model.step, every)
        _swing_strand(moved, steps, drag, found[:, :, strand])
    return found


def stray(joints: Floats, ends: Floats, lengths: Floats) -> Floats:
    """Return the largest distance of strands from their catenaries, in metres.

    ``joints`` (k, n − 1, links + 1, 3) of the strands, ``ends`` (k, n, 3) of the grip points at the
    same times; compared at equal arc length. Returns (k, n − 1), infinite for strands that are
    shorter than their chord at the time or were so before.
    """
    fractions = np.linspace(0.0, 1.0, joints.shape[2])
    chords = np.linalg.norm(np.diff(ends, axis=1), axis=2)
    still = solve_catenaries(ends[:, :-1], ends[:, 1:], np.maximum(lengths, chords))
    distance: Floats = np.linalg.norm(joints - still.points(fractions), axis=-1).max(axis=-1)
    return np.where((chords > lengths) | np.isnan(distance), np.inf, distance)


class Drag(NamedTuple):
    """Drag coefficients over mass, 1/m, and the wind's components, m/s."""

    normal: float
    tangential: float
    east: float
    north: float
    up: float


class _Steps(NamedTuple):
    """Length of a link in metres, step in seconds, and the number of steps between samples."""

    link: float
    step: float
    every: int


@compiled
def _swing_strand(ends: Floats3, steps: _Steps, drag: Drag, found: Columns4) -> None:
    """Write the states (2, links + 1, 3) of one strand to ``found``, from its first."""
    before, now = found[0, 0].copy(), found[0, 1].copy()
    after = now.copy()
    system = np.empty((4, len(now) - 1))
    for k in range(1, len(ends)):
        _step_freely(before, now, after, drag, steps.step)
        after[0], after[-1] = ends[k, 0], ends[k, 1]
        _restore_links(now, after, steps.link, system)
        before, now, after = now, after, before
        if k % steps.every == 0:
            found[k // steps.every, 0] = before
            found[k // steps.every, 1] = now


@compiled
def _step_freely(before: Floats, now: Floats, after: Floats, drag: Drag, step: float) -> None:
    """Write the inner joints one step later, under gravity and drag and without constraints."""
    wind = np.array([drag.east, drag.north, drag.up])
    velocity, tangent = np.empty(3), np.empty(3)
    for i in range(1, len(now) - 1):
        size = along = 0.0
        for x in range(3):
            tangent[x] = now[i + 1, x] - now[i - 1, x]
            velocity[x] = (now[i, x] - before[i, x]) / step - wind[x]
            size += tangent[x] ** 2
            along += velocity[x] * tangent[x]
        along /= size
        across = 0.0
        for x in range(3):
            velocity[x] -= along * tangent[x]
            across += velocity[x] ** 2
        across = drag.normal * np.sqrt(across)
        along *= drag.tangential * abs(along) * np.sqrt(size)
        for x in range(3):
            push = -across * velocity[x] - along * tangent[x]
            after[i, x] = 2.0 * now[i, x] - before[i, x] + step * step * push
        after[i, 2] -= step * step * STANDARD_GRAVITY


@compiled
def _restore_links(now: Floats, after: Floats, link: float, system: Floats) -> None:
    """Move the inner joints along the links of ``now`` until all links have their length."""
    lower, diagonal, upper, error = system
    links = len(now) - 1
    for _ in range(_ITERATIONS):
        worst = 0.0
        for j in range(links):
            error[j] = _dot(after, j, after, j) - link * link
            worst = max(worst, abs(error[j]))
            free = (1.0 if j > 0 else 0.0) + (1.0 if j < links - 1 else 0.0)
            diagonal[j] = 2.0 * free * _dot(after, j, now, j)
            lower[j] = -2.0 * _dot(after, j, now, j - 1) if j > 0 else 0.0
            upper[j] = -2.0 * _dot(after, j, now, j + 1) if j < links - 1 else 0.0
        if worst <= _TOLERANCE * link * link:
            return
        solve_tridiagonal(lower, diagonal, upper, error)
        for i in range(1, links):
            for x in range(3):
                after[i, x] -= error[i - 1] * (now[i, x] - now[i - 1, x])
                after[i, x] += error[i] * (now[i + 1, x] - now[i, x])
    after[1:-1] = np.nan


@compiled
def _dot(a: Floats, i: int, b: Floats, j: int) -> float:
    """Return the product of link i of ``a`` and link j of ``b``."""
    total = 0.0
    for x in range(3):
        total += (a[i + 1, x] - a[i, x]) * (b[j + 1, x] - b[j, x])
    return total


@compiled
def solve_tridiagonal(lower: Floats, diagonal: Floats, upper: Floats, right: Floats) -> None:
    """Solve a tridiagonal system in place (Thomas); ``right`` becomes the solution."""
    n = len(right)
    for j in range(1, n):
        factor = lower[j] / diagonal[j - 1]
        diagonal[j] -= factor * upper[j - 1]
        right[j] -= factor * right[j - 1]
    right[n - 1] /= diagonal[n - 1]
    for j in range(n - 2, -1, -1):
        right[j] = (right[j] - upper[j] * right[j + 1]) / diagonal[j]
