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
from swarm.geometry.hanging_links import hung_strands
from swarm.jit import compiled
from swarm.signatures import Floats1, Floats4, Floats5, Floats6

Floats = npt.NDArray[np.float64]
Chosen = tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]

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

TOGETHER = 16
"""Strands that are stepped side by side: two vectors of the widest processors. Their rows, 0.06 MB,
stay in the fastest caches: with 32, each strand takes 1.4 times as long."""

_BEFORE, _AFTER, _NOW, _LINK, _NEXT = 0, 0, 3, 6, 9
"""Places in a row, three numbers each: the joint one step ago, which that after the step replaces;
the joint now; the link that begins there, now and after the step."""

_ERROR, _DIAGONAL, _UPPER, _WORST, _OPEN, _SQUARE = 12, 13, 14, 15, 16, 17
"""The next places: the error of the link's squared length, then the correction; two diagonals of
the system; the largest error so far; whether it is above the tolerance; the squared length."""

_FIELDS = 18
"""Places in a row: in one array of fixed sizes the compiler knows that they do not overlap."""


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
    state = at_rest(ends[0], lengths, model)
    found: Floats = _swing_all(state[None], ends[None], lengths, model, every, 1)[0, :, 0]
    return found


def at_rest(ends: Floats, lengths: Floats, model: SwingModel) -> Floats:
    """Return the state (2, n − 1, links + 1, 3) of strands that hang still between ends (n, 3).

    A state holds the joints one step ago, and now. Raises
    :class:`swarm.geometry.catenary.OverStretched` where a chord is longer than its strand.
    """
    joints = hung_strands(ends, lengths, model.links)
    return np.stack([joints, joints])


def swing_on(
    state: Floats, ends: Floats, lengths: Floats, model: SwingModel, every: int = 1
) -> Floats:
    """Return the states of strands that continue from a state, as :func:`swing` from rest.

    ``ends`` (k, n, 3) begin at the state's time. Returns (ceil(k / every), 2, n − 1, links + 1, 3),
    the given state first.
    """
    found: Floats = _swing_all(state[None], ends[None], lengths, model, every, 2)[0]
    return found


def swing_on_each(
    states: Floats, ends: Floats, lengths: Floats, model: SwingModel, every: int = 1
) -> Floats:
    """Return the joints of the same strands that continue from c states, each in its own motion.

    ``states`` (c, 2, n − 1, links + 1, 3) and ``ends`` (c, k, n, 3) as for :func:`swing_on`.
    Returns (c, ceil(k / every), n − 1, links + 1, 3).
    """
    found: Floats = _swing_all(states, ends, lengths, model, every, 1)[:, :, 0]
    return found


def _swing_all(
    states: Floats, ends: Floats, lengths: Floats, model: SwingModel, every: int, parts: int
) -> Floats:
    """Return the last ``parts`` of the states (c, ceil(k / every), …, n − 1, links + 1, 3)."""
    samples = (ends.shape[1] + every - 1) // every
    found = np.empty((len(states), samples, parts, *states.shape[2:]))
    found[:, 0] = states[:, 2 - parts :]
    drag = Drag(model.normal_drag, model.tangential_drag, *model.wind)
    given = np.ascontiguousarray(states), np.ascontiguousarray(ends)
    _swing_each(given, lengths / model.links, _Steps(model.step, every), drag, found)
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


@compiled
def _swing_each(
    given: tuple[Floats5, Floats4], lengths: Floats1, steps: _Steps, drag: Drag, found: Floats6
) -> None:
    """Write the states of the strands of c motions to ``found`` (c, …, 1 or 2, n − 1, joints, 3),
    after the first ones.

    ``given`` are the first states (c, 2, n − 1, joints, 3) and the positions (c, k, n, 3) of the
    grip points, ``lengths`` (n − 1,) those of the links. With 1, only the last part of each state
    is written, the joints at that time.
    """
    count, total = len(found), len(found) * len(lengths)
    motion, strand = np.empty(TOGETHER, np.int64), np.empty(TOGETHER, np.int64)
    for first in range(0, total, TOGETHER):
        # next to each other: motions of the same strand, which need about as many iterations
        for w in range(TOGETHER):
            which = min(first + w, total - 1)
            strand[w], motion[w] = which // count, which % count
        _swing_together(given, lengths, steps, drag, (motion, strand), found)


@compiled
def _swing_together(
    given: tuple[Floats, Floats], lengths: Floats, steps: _Steps, drag: Drag, chosen: Chosen,
    found: Floats,
) -> None:  # fmt: skip
    """Write the states of the strands ``chosen`` by the numbers of their motions and their own."""
    begun, ends = given
    motion, strand = chosen
    last = found.shape[4] - 1
    rows, own = np.zeros((last + 1, _FIELDS, TOGETHER)), np.empty(TOGETHER)
    for w in range(TOGETHER):
        own[w] = lengths[strand[w]]
        for i in range(last + 1):
            rows[i, _SQUARE, w] = own[w] * own[w]
            for x in range(3):
                rows[i, _NOW + x, w] = begun[motion[w], 0, strand[w], i, x]
                rows[i, _AFTER + x, w] = begun[motion[w], 1, strand[w], i, x]
    _advance(rows)
    for k in range(1, ends.shape[1]):
        _step_freely(rows, drag, steps.step)
        for w in range(TOGETHER):
            place = ends[motion[w], k]
            for x in range(3):
                rows[0, _AFTER + x, w] = place[strand[w], x]
                rows[last, _AFTER + x, w] = place[strand[w] + 1, x]
        _restore_links(rows, own)
        _advance(rows)
        if k % steps.every == 0:
            for w in range(TOGETHER):
                sample = found[motion[w], k // steps.every]
                for i in range(last + 1):
                    for x in range(3):
                        sample[0, strand[w], i, x] = rows[i, _BEFORE + x, w]
                        sample[len(sample) - 1, strand[w], i, x] = rows[i, _NOW + x, w]


@compiled
def _advance(rows: Floats) -> None:
    """Let the joints after the step be those now, and those now the ones before; write the links.

    The joints after the step were written over those before.
    """
    if _other_sizes(rows):
        return
    last = len(rows) - 1
    for i in range(last):
        for w in range(TOGETHER):
            for x in range(3):
                after = rows[i, _AFTER + x, w]
                rows[i, _LINK + x, w] = rows[i + 1, _AFTER + x, w] - after
                rows[i, _BEFORE + x, w] = rows[i, _NOW + x, w]
                rows[i, _NOW + x, w] = after
    for x in range(3):
        for w in range(TOGETHER):
            after = rows[last, _AFTER + x, w]
            rows[last, _BEFORE + x, w] = rows[last, _NOW + x, w]
            rows[last, _NOW + x, w] = after


@compiled
def _step_freely(rows: Floats, drag: Drag, step: float) -> None:
    """Write the inner joints one step later, under gravity and drag and without constraints."""
    if _other_sizes(rows):
        return
    fall = step * step * STANDARD_GRAVITY
    for i in range(1, len(rows) - 1):
        for w in range(TOGETHER):
            tx = rows[i + 1, _NOW, w] - rows[i - 1, _NOW, w]
            ty = rows[i + 1, _NOW + 1, w] - rows[i - 1, _NOW + 1, w]
            tz = rows[i + 1, _NOW + 2, w] - rows[i - 1, _NOW + 2, w]
            ox, x = rows[i, _BEFORE, w], rows[i, _NOW, w]
            oy, y = rows[i, _BEFORE + 1, w], rows[i, _NOW + 1, w]
            oz, z = rows[i, _BEFORE + 2, w], rows[i, _NOW + 2, w]
            vx = (x - ox) / step - drag.east
            vy = (y - oy) / step - drag.north
            vz = (z - oz) / step - drag.up
            size = tx * tx + ty * ty + tz * tz
            along = (vx * tx + vy * ty + vz * tz) / size
            vx, vy, vz = vx - along * tx, vy - along * ty, vz - along * tz
            across = drag.normal * np.sqrt(vx * vx + vy * vy + vz * vz)
            along *= drag.tangential * abs(along) * np.sqrt(size)
            px, py = -across * vx - along * tx, -across * vy - along * ty
            pz = -across * vz - along * tz
            rows[i, _AFTER, w] = 2.0 * x - ox + step * step * px
            rows[i, _AFTER + 1, w] = 2.0 * y - oy + step * step * py
            rows[i, _AFTER + 2, w] = 2.0 * z - oz + step * step * pz - fall


@compiled
def _restore_links(rows: Floats, lengths: Floats) -> None:
    """Move the inner joints along the links of this moment until all links have their length.

    A strand whose links have it is not moved further, so that it does not depend on the others.
    """
    if _other_sizes(rows):
        return
    last = len(rows) - 1
    for _ in range(_ITERATIONS):
        _measure_links(rows)
        still_open = 0.0
        for w in range(TOGETHER):
            most = _TOLERANCE * lengths[w] * lengths[w]
            open_ = 0.0 if rows[last - 1, _WORST, w] <= most else 1.0
            rows[0, _OPEN, w] = open_
            still_open += open_
        if still_open == 0.0:
            return
        _eliminate(rows)
        _move_joints(rows)
    for i in range(1, last):
        for x in range(3):
            for w in range(TOGETHER):
                if rows[0, _OPEN, w] > 0.0:
                    rows[i, _AFTER + x, w] = np.nan


@compiled
def _measure_links(rows: Floats) -> None:
    """Write the links, the errors of their squared lengths, and the largest error so far."""
    if _other_sizes(rows):
        return
    for w in range(TOGETHER):
        rows[0, _WORST, w] = 0.0
    for j in range(len(rows) - 1):
        for w in range(TOGETHER):
            x = rows[j + 1, _AFTER, w] - rows[j, _AFTER, w]
            y = rows[j + 1, _AFTER + 1, w] - rows[j, _AFTER + 1, w]
            z = rows[j + 1, _AFTER + 2, w] - rows[j, _AFTER + 2, w]
            rows[j, _NEXT, w], rows[j, _NEXT + 1, w], rows[j, _NEXT + 2, w] = x, y, z
            error = x * x + y * y + z * z - rows[j, _SQUARE, w]
            rows[j, _ERROR, w] = error
            rows[j + 1, _WORST, w] = max(rows[j, _WORST, w], abs(error))


@compiled
def _eliminate(rows: Floats) -> None:
    """Write the tridiagonal system for the errors, without its lower diagonal (Thomas)."""
    if _other_sizes(rows):
        return
    last = len(rows) - 2
    for w in range(TOGETHER):
        rows[0, _DIAGONAL, w] = 2.0 * _product(rows, 0, 0, w)
    for j in range(1, last + 1):
        free = 2.0 if j < last else 1.0
        for w in range(TOGETHER):
            lower = -2.0 * _product(rows, j, j - 1, w)
            upper = -2.0 * _product(rows, j - 1, j, w)
            factor = lower / rows[j - 1, _DIAGONAL, w]
            rows[j - 1, _UPPER, w] = upper
            rows[j, _DIAGONAL, w] = 2.0 * free * _product(rows, j, j, w) - factor * upper
            rows[j, _ERROR, w] -= factor * rows[j - 1, _ERROR, w]
            rows[j, _OPEN, w] = rows[j - 1, _OPEN, w]


@compiled
def _move_joints(rows: Floats) -> None:
    """Solve the system, and move the inner joints of strands that are not right yet by it."""
    if _other_sizes(rows):
        return
    last = len(rows) - 2
    for w in range(TOGETHER):
        rows[last, _ERROR, w] /= rows[last, _DIAGONAL, w]
    for j in range(last - 1, -1, -1):
        for w in range(TOGETHER):
            there = rows[j + 1, _ERROR, w]
            here = (rows[j, _ERROR, w] - rows[j, _UPPER, w] * there) / rows[j, _DIAGONAL, w]
            rows[j, _ERROR, w] = here
            for x in range(3):
                before = rows[j + 1, _AFTER + x, w]
                moved = before - here * rows[j, _LINK + x, w]
                moved = moved + there * rows[j + 1, _LINK + x, w]
                rows[j + 1, _AFTER + x, w] = moved if rows[j + 1, _OPEN, w] > 0.0 else before


@compiled
def _product(rows: Floats, i: int, j: int, w: int) -> float:
    """Return the scalar product of the links i after the step and j before it, of strand w."""
    return float(
        rows[i, _NEXT, w] * rows[j, _LINK, w]
        + rows[i, _NEXT + 1, w] * rows[j, _LINK + 1, w]
        + rows[i, _NEXT + 2, w] * rows[j, _LINK + 2, w]
    )


@compiled
def _other_sizes(rows: Floats) -> bool:
    """Return False: a branch by it tells the compiler the sizes, which it needs for vectors."""
    return bool(rows.shape[1] != _FIELDS or rows.shape[2] != TOGETHER)


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
