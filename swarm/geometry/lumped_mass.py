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
from swarm.signatures import Floats1, Floats4, Floats5

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

_TOGETHER = 4
"""Strands that are stepped side by side: while one waits for a division, others go on. Four take
0.7 of the time of single ones; eight take no less for the 8 to 22 strands of a team."""


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
    joined = np.stack([ends[:, :-1], ends[:, 1:]], axis=1)
    return _swing_all(state, joined, lengths / model.links, model, every)


def swing_on_each(
    states: Floats, ends: Floats, lengths: Floats, model: SwingModel, every: int = 1
) -> Floats:
    """Return the states of the same strands that continue from c states, each in its own motion.

    ``states`` (c, 2, n − 1, links + 1, 3) and ``ends`` (c, k, n, 3) as for :func:`swing_on`.
    Returns (c, ceil(k / every), 2, n − 1, links + 1, 3).
    """
    count, strands = len(states), len(lengths)
    # next to each other: continuations of the same strand, which need about as many iterations
    joined = np.stack([ends[:, :, :-1], ends[:, :, 1:]], axis=2).transpose(1, 2, 3, 0, 4)
    joined = joined.reshape(*joined.shape[:2], strands * count, 3)
    state = states.transpose(1, 2, 0, 3, 4).reshape(2, strands * count, *states.shape[3:])
    found = _swing_all(state, joined, np.repeat(lengths / model.links, count), model, every)
    found = found.reshape(*found.shape[:2], strands, count, *found.shape[3:])
    return found.transpose(3, 0, 1, 2, 4, 5)


def _swing_all(state: Floats, ends: Floats, links: Floats, model: SwingModel, every: int) -> Floats:
    """Return the states (…, 2, m, links + 1, 3) of m strands, a few at a time.

    ``ends`` (k, 2, m, 3) are the two ends of each, ``links`` (m,) the lengths of their links.
    """
    samples = (len(ends) + every - 1) // every
    found = np.empty((samples, *state.shape))
    drag = Drag(model.normal_drag, model.tangential_drag, *model.wind)
    steps = _Steps(model.step, every)
    for first in range(0, len(links), _TOGETHER):
        chosen = np.arange(first, min(first + _TOGETHER, len(links)))
        filled = np.resize(chosen, _TOGETHER)
        moved = np.ascontiguousarray(ends[:, :, filled].transpose(0, 1, 3, 2))
        states = np.empty((samples, 2, *state.shape[2:], _TOGETHER))
        states[0] = state[:, filled].transpose(0, 2, 3, 1)
        _swing_together(moved, links[filled], steps, drag, states)
        last = first + len(chosen)
        found[:, :, first:last] = states[..., : len(chosen)].transpose(0, 1, 4, 2, 3)
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
    distance: Floats = still.distances(fractions, joints).max(axis=-1)
    return np.where((chords > lengths) | np.isnan(distance), np.inf, distance)


class Drag(NamedTuple):
    """Drag coefficients over mass, 1/m, and the wind's components, m/s."""

    normal: float
    tangential: float
    east: float
    north: float
    up: float


class _Steps(NamedTuple):
    """Step in seconds, and the number of steps between samples."""

    step: float
    every: int


class _Workspace(NamedTuple):
    """Memory for w strands of l links.

    ``system`` (3, l, w) the diagonal, the upper diagonal and the right side of the links' errors,
    ``links`` (l, 3, w) the links after a step, ``worst`` and ``open`` (w,) the largest error, and
    whether it is above the tolerance.
    """

    system: Floats
    links: Floats
    worst: Floats
    open: Floats


@compiled
def _swing_together(
    ends: Floats4, lengths: Floats1, steps: _Steps, drag: Drag, found: Floats5
) -> None:
    """Write the states (2, links + 1, 3, w) of w strands to ``found``, from its first.

    ``ends`` (k, 2, 3, w) are the positions of their grip points, ``lengths`` (w,) those of their
    links.
    """
    last = found.shape[2] - 1
    joints = np.empty((3, last + 1, 3, _TOGETHER))
    links = np.empty((last, 3, _TOGETHER))
    memory = _Workspace(
        np.empty((3, last, _TOGETHER)), np.empty((last, 3, _TOGETHER)), np.empty(_TOGETHER),
        np.empty(_TOGETHER),
    )  # fmt: skip
    before, now, after = 0, 1, 2
    _copy(found[0, 0], joints[before])
    _copy(found[0, 1], joints[now])
    for k in range(1, len(ends)):
        _step_freely(joints[before], joints[now], joints[after], drag, steps.step)
        for x in range(3):
            for w in range(_TOGETHER):
                joints[after, 0, x, w] = ends[k, 0, x, w]
                joints[after, last, x, w] = ends[k, 1, x, w]
        for j in range(last):
            for x in range(3):
                for w in range(_TOGETHER):
                    links[j, x, w] = joints[now, j + 1, x, w] - joints[now, j, x, w]
        _restore_links(links, joints[after], lengths, memory)
        before, now, after = now, after, before
        if k % steps.every == 0:
            _copy(joints[before], found[k // steps.every, 0])
            _copy(joints[now], found[k // steps.every, 1])


@compiled
def _copy(joints: Floats, found: Floats) -> None:
    """Write joints (links + 1, 3, w) to ``found``."""
    for i in range(len(joints)):
        for x in range(3):
            for w in range(_TOGETHER):
                found[i, x, w] = joints[i, x, w]


@compiled
def _step_freely(before: Floats, now: Floats, after: Floats, drag: Drag, step: float) -> None:
    """Write the inner joints one step later, under gravity and drag and without constraints."""
    fall = step * step * STANDARD_GRAVITY
    for i in range(1, len(now) - 1):
        for w in range(_TOGETHER):
            tx = now[i + 1, 0, w] - now[i - 1, 0, w]
            ty = now[i + 1, 1, w] - now[i - 1, 1, w]
            tz = now[i + 1, 2, w] - now[i - 1, 2, w]
            vx = (now[i, 0, w] - before[i, 0, w]) / step - drag.east
            vy = (now[i, 1, w] - before[i, 1, w]) / step - drag.north
            vz = (now[i, 2, w] - before[i, 2, w]) / step - drag.up
            size = tx * tx + ty * ty + tz * tz
            along = (vx * tx + vy * ty + vz * tz) / size
            vx, vy, vz = vx - along * tx, vy - along * ty, vz - along * tz
            across = drag.normal * np.sqrt(vx * vx + vy * vy + vz * vz)
            along *= drag.tangential * abs(along) * np.sqrt(size)
            px, py, pz = (
                -across * vx - along * tx,
                -across * vy - along * ty,
                -across * vz - along * tz,
            )
            after[i, 0, w] = 2.0 * now[i, 0, w] - before[i, 0, w] + step * step * px
            after[i, 1, w] = 2.0 * now[i, 1, w] - before[i, 1, w] + step * step * py
            after[i, 2, w] = 2.0 * now[i, 2, w] - before[i, 2, w] + step * step * pz - fall


@compiled
def _restore_links(now: Floats, after: Floats, lengths: Floats, memory: _Workspace) -> None:
    """Move the inner joints along the links ``now`` (l, 3, w) until all have their length.

    A strand whose links have it is not moved further, so that it does not depend on the others.
    """
    error, open_, count = memory.system[2], memory.open, len(now)
    for _ in range(_ITERATIONS):
        _measure_links(after, lengths, memory)
        still_open = 0.0
        for w in range(_TOGETHER):
            most = _TOLERANCE * lengths[w] * lengths[w]
            open_[w] = 0.0 if memory.worst[w] <= most else 1.0
            still_open += open_[w]
        if still_open == 0.0:
            return
        _solve_links(now, memory)
        for i in range(1, count):
            for x in range(3):
                for w in range(_TOGETHER):
                    moved = after[i, x, w] - error[i - 1, w] * now[i - 1, x, w]
                    moved = moved + error[i, w] * now[i, x, w]
                    after[i, x, w] = moved if open_[w] > 0.0 else after[i, x, w]
    for i in range(1, count):
        for x in range(3):
            for w in range(_TOGETHER):
                if open_[w] > 0.0:
                    after[i, x, w] = np.nan


@compiled
def _measure_links(after: Floats, lengths: Floats, memory: _Workspace) -> None:
    """Write the links, the errors of their squared lengths, and the ``worst`` of each strand."""
    error, links, worst = memory.system[2], memory.links, memory.worst
    for w in range(_TOGETHER):
        worst[w] = 0.0
    for j in range(len(links)):
        for w in range(_TOGETHER):
            x = after[j + 1, 0, w] - after[j, 0, w]
            y = after[j + 1, 1, w] - after[j, 1, w]
            z = after[j + 1, 2, w] - after[j, 2, w]
            links[j, 0, w], links[j, 1, w], links[j, 2, w] = x, y, z
            error[j, w] = x * x + y * y + z * z - lengths[w] * lengths[w]
            worst[w] = max(worst[w], abs(error[j, w]))


@compiled
def _solve_links(now: Floats, memory: _Workspace) -> None:
    """Replace the errors by the solution of their tridiagonal system (Thomas), in each strand.

    The system is eliminated while it is written; its lower diagonal is not kept.
    """
    diagonal, upper, error = memory.system
    after, last = memory.links, len(now) - 1
    for w in range(_TOGETHER):
        diagonal[0, w] = 2.0 * _product(after, 0, now, 0, w)
    for j in range(1, last + 1):
        free = 2.0 if j < last else 1.0
        for w in range(_TOGETHER):
            lower = -2.0 * _product(after, j, now, j - 1, w)
            upper[j - 1, w] = -2.0 * _product(after, j - 1, now, j, w)
            factor = lower / diagonal[j - 1, w]
            diagonal[j, w] = 2.0 * free * _product(after, j, now, j, w) - factor * upper[j - 1, w]
            error[j, w] -= factor * error[j - 1, w]
    for w in range(_TOGETHER):
        error[last, w] /= diagonal[last, w]
    for j in range(last - 1, -1, -1):
        for w in range(_TOGETHER):
            error[j, w] = (error[j, w] - upper[j, w] * error[j + 1, w]) / diagonal[j, w]


@compiled
def _product(one: Floats, i: int, other: Floats, j: int, w: int) -> float:
    """Return the scalar product of two links (l, 3, w) of strand w."""
    return float(
        one[i, 0, w] * other[j, 0, w]
        + one[i, 1, w] * other[j, 1, w]
        + one[i, 2, w] * other[j, 2, w]
    )


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
