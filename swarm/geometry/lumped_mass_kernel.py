"""Steps of strands of lumped masses on inextensible links, many strands side by side.

Verlet's method steps the masses under gravity and drag; the links keep their length by the
constraint forces of SHAKE (Ryckaert et al. 1977), which for a chain are one tridiagonal system,
solved exactly instead of link by link.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from swarm.geometry.catenary import STANDARD_GRAVITY
from swarm.jit import allocates, compiled, inner
from swarm.signatures import Floats1, Floats4, Floats5, Floats6, Ints1

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.intp]
Given = tuple[Floats, Floats, Ints]
Chosen = tuple[Ints, Ints]
Memory = tuple[Floats, Floats, Floats]

_ITERATIONS = 8
"""Newton steps for the link lengths; one is enough at the accelerations of a fold."""

_TOLERANCE = 1e-8
"""Relative error of a squared link length at which the iteration ends: a nanometre of a link of
0.2 m. One step of the iteration leaves 1e-12 nearly always, and 1e-10 would take a second one for
one strand of sixteen, and so for all."""

TOGETHER = 8
"""Strands that are stepped side by side: a vector of the widest processors. With 16, many strands
take 5 % less, but the few of a planned motion twice as long; with 32, their rows leave the fastest
caches, and each strand takes 1.4 times as long."""

_AFTER, _NOW, _LINK, _NEXT = 0, 3, 6, 9
"""Places in a row, three numbers each: the joint after the step and before it; the link that begins
there, before the step and after it."""

_ERROR, _INVERSE, _UPPER, _WORST, _SHARE, _SQUARE, _FORCE = 12, 13, 14, 15, 16, 17, 18
"""The next places: the error of the link's squared length, then the correction; the inverse of the
diagonal of the system, and its upper one; the largest error of the links from here on; the share of
corrections that counts; the squared length; the sum of corrections, which is the link's force. That
of the step before is a guess that makes one correction enough."""

_FIELDS = 19
"""Places in a row: in one array of fixed sizes the compiler knows that they do not overlap."""


class Drag(NamedTuple):
    """Drag coefficients over mass, 1/m, and the wind's components, m/s."""

    normal: float
    tangential: float
    east: float
    north: float
    up: float


class Steps(NamedTuple):
    """Step in seconds, and the number of steps between samples."""

    step: float
    every: int


@compiled
@allocates
def swing_each(
    given: tuple[Floats5, Floats4, Ints1], lengths: Floats1, steps: Steps, drag: Drag,
    found: Floats6,
) -> None:  # fmt: skip
    """Write the states of s strands in c motions to ``found`` (c, …, 1 or 2, s, joints, 3), after
    the first ones.

    ``given`` are the first states (c, 2, s, joints, 3), the positions (c, n, k, 3) of the grip
    points, and the numbers (s,) of those at which strands begin; ``lengths`` (s,) those of the
    links. With 1, only the last part of each state is written, the joints at that time.
    """
    count, total = len(found), len(found) * len(lengths)
    motion, strand = np.empty(TOGETHER, np.int64), np.empty(TOGETHER, np.int64)
    rows, most = np.zeros((found.shape[4], _FIELDS, TOGETHER)), np.empty(TOGETHER)
    memory = rows, most, np.empty((2, 3, TOGETHER))
    for first in range(0, total, TOGETHER):
        # next to each other: motions of the same strand, which need about as many iterations
        for w in range(TOGETHER):
            which = min(first + w, total - 1)
            strand[w], motion[w] = which // count, which % count
        rows[:] = 0.0
        _swing_together(given, lengths, steps, drag, (motion, strand), memory, found)


@inner
def _swing_together(
    given: Given, lengths: Floats, steps: Steps, drag: Drag, chosen: Chosen, memory: Memory,
    found: Floats,
) -> None:  # fmt: skip
    """Write the states of the strands ``chosen`` by the numbers of their motions and their own.

    ``memory`` are rows of zeros, errors, and the places (2, 3, …) of both ends.
    """
    begun, ends, segments = given
    motion, strand = chosen
    rows, most, places = memory
    last = found.shape[4] - 1
    for w in range(TOGETHER):
        square = lengths[strand[w]] ** 2
        most[w] = _TOLERANCE * square
        for i in range(last + 1):
            rows[i, _SQUARE, w] = square
            for x in range(3):
                rows[i, _NOW + x, w] = begun[motion[w], 0, strand[w], i, x]
                rows[i, _AFTER + x, w] = begun[motion[w], 1, strand[w], i, x]
    for k in range(1, ends.shape[2]):
        for w in range(TOGETHER):
            grips = ends[motion[w]]
            for x in range(3):
                places[0, x, w] = grips[segments[strand[w]], k, x]
                places[1, x, w] = grips[segments[strand[w]] + 1, k, x]
        _step_freely(rows, places, drag, steps.step)
        _restore_links(rows, most)
        if k % steps.every == 0:
            _write_states(rows, chosen, k // steps.every, found)


@inner
def _write_states(rows: Floats, chosen: Chosen, sample: int, found: Floats) -> None:
    """Write the states of strands to a sample, joint by joint as they are in memory."""
    if _other_sizes(rows):
        return
    (motion, strand), last = chosen, found.shape[2] - 1
    for i in range(len(rows)):
        for w in range(TOGETHER):
            for x in range(3):
                if last > 0:
                    found[motion[w], sample, 0, strand[w], i, x] = rows[i, _NOW + x, w]
                found[motion[w], sample, last, strand[w], i, x] = rows[i, _AFTER + x, w]


@inner
def _step_freely(rows: Floats, places: Floats, drag: Drag, step: float) -> None:
    """Let the joints after the last step be those before this one, and write those after it.

    Inner joints move under gravity, drag and the links' forces in the last step, the others to
    their ``places`` (2, 3, …). Links and the errors of their squared lengths are written, too.
    """
    if _other_sizes(rows):
        return
    last = len(rows) - 1
    for w in range(TOGETHER):
        for x in range(3):
            now = rows[0, _AFTER + x, w]
            rows[0, _LINK + x, w] = rows[1, _AFTER + x, w] - now
            rows[0, _NOW + x, w] = now
            rows[0, _AFTER + x, w] = places[0, x, w]
    fall = step * step * STANDARD_GRAVITY
    ahead, aside, above = step * drag.east, step * drag.north, step * drag.up
    for i in range(1, last):
        for w in range(TOGETHER):
            x, y, z = rows[i, _AFTER, w], rows[i, _AFTER + 1, w], rows[i, _AFTER + 2, w]
            lx = rows[i + 1, _AFTER, w] - x
            ly = rows[i + 1, _AFTER + 1, w] - y
            lz = rows[i + 1, _AFTER + 2, w] - z
            mx, my, mz = x - rows[i, _NOW, w], y - rows[i, _NOW + 1, w], z - rows[i, _NOW + 2, w]
            tx = lx + rows[i - 1, _LINK, w]
            ty = ly + rows[i - 1, _LINK + 1, w]
            tz = lz + rows[i - 1, _LINK + 2, w]
            # the drag over the square of the step, of movements in a step instead of speeds
            vx, vy, vz = mx - ahead, my - aside, mz - above
            size = tx * tx + ty * ty + tz * tz
            along = (vx * tx + vy * ty + vz * tz) / size
            vx, vy, vz = vx - along * tx, vy - along * ty, vz - along * tz
            across = drag.normal * np.sqrt(vx * vx + vy * vy + vz * vz)
            along *= drag.tangential * abs(along) * np.sqrt(size)
            rows[i, _LINK, w], rows[i, _LINK + 1, w], rows[i, _LINK + 2, w] = lx, ly, lz
            rows[i, _NOW, w], rows[i, _NOW + 1, w], rows[i, _NOW + 2, w] = x, y, z
            there, here = rows[i, _FORCE, w], rows[i - 1, _FORCE, w]
            mx += there * lx - here * rows[i - 1, _LINK, w]
            my += there * ly - here * rows[i - 1, _LINK + 1, w]
            mz += there * lz - here * rows[i - 1, _LINK + 2, w]
            rows[i, _AFTER, w] = x = x + mx - across * vx - along * tx
            rows[i, _AFTER + 1, w] = y = y + my - across * vy - along * ty
            rows[i, _AFTER + 2, w] = z = z + mz - across * vz - along * tz - fall
            # as _measure_link, while the joint is in registers: else 1.7 times as long
            x -= rows[i - 1, _AFTER, w]
            y -= rows[i - 1, _AFTER + 1, w]
            z -= rows[i - 1, _AFTER + 2, w]
            rows[i - 1, _NEXT, w], rows[i - 1, _NEXT + 1, w], rows[i - 1, _NEXT + 2, w] = x, y, z
            rows[i - 1, _ERROR, w] = x * x + y * y + z * z - rows[i - 1, _SQUARE, w]
    for w in range(TOGETHER):
        for x in range(3):
            rows[last, _NOW + x, w] = rows[last, _AFTER + x, w]
            rows[last, _AFTER + x, w] = places[1, x, w]
    _measure_link(rows, last - 1)


@inner
def _measure_link(rows: Floats, j: int) -> None:
    """Write a link after the step, and the error of its squared length."""
    if _other_sizes(rows):
        return
    for w in range(TOGETHER):
        x = rows[j + 1, _AFTER, w] - rows[j, _AFTER, w]
        y = rows[j + 1, _AFTER + 1, w] - rows[j, _AFTER + 1, w]
        z = rows[j + 1, _AFTER + 2, w] - rows[j, _AFTER + 2, w]
        rows[j, _NEXT, w], rows[j, _NEXT + 1, w], rows[j, _NEXT + 2, w] = x, y, z
        rows[j, _ERROR, w] = x * x + y * y + z * z - rows[j, _SQUARE, w]


@inner
def _restore_links(rows: Floats, most: Floats) -> None:
    """Move the inner joints along the links before the step until all links have their length.

    A strand whose squared lengths are right to ``most`` is not moved further, so that it does not
    depend on the others.
    """
    if _other_sizes(rows):
        return
    last = len(rows) - 1
    for w in range(TOGETHER):
        rows[last, _SHARE, w] = 0.5
    for _ in range(_ITERATIONS):
        _eliminate(rows)
        _move_joints(rows)
        still_open = 0.0
        for w in range(TOGETHER):
            share = 0.0 if rows[0, _WORST, w] <= most[w] else 0.5
            rows[last, _SHARE, w] = share
            still_open += share
        if still_open == 0.0:
            return
    for i in range(1, last):
        for x in range(3):
            for w in range(TOGETHER):
                if rows[last, _SHARE, w] > 0.0:
                    rows[i, _AFTER + x, w] = np.nan


@inner
def _eliminate(rows: Floats) -> None:
    """Write the tridiagonal system for the errors, without its lower diagonal (Thomas)."""
    if _other_sizes(rows):
        return
    last = len(rows) - 2
    for w in range(TOGETHER):
        rows[0, _INVERSE, w] = 1.0 / _product(rows, 0, 0, w)
    for j in range(last):
        free = 2.0 if j + 1 < last else 1.0
        for w in range(TOGETHER):
            factor = -_product(rows, j + 1, j, w) * rows[j, _INVERSE, w]
            upper = -_product(rows, j, j + 1, w)
            diagonal = free * _product(rows, j + 1, j + 1, w) - factor * upper
            rows[j, _UPPER, w] = upper
            rows[j + 1, _INVERSE, w] = 1.0 / diagonal
            rows[j + 1, _ERROR, w] -= factor * rows[j, _ERROR, w]


@inner
def _move_joints(rows: Floats) -> None:
    """Solve the system, move the inner joints by a share of it, and measure the links.

    The share, of the last row, is half: corrections are of squared lengths.
    """
    if _other_sizes(rows):
        return
    last = len(rows) - 2
    for w in range(TOGETHER):
        there = rows[last, _ERROR, w] * rows[last, _INVERSE, w]
        rows[last, _ERROR, w] = there
        rows[last, _FORCE, w] += rows[last + 1, _SHARE, w] * there
        rows[last + 1, _WORST, w] = 0.0
    for j in range(last - 1, -1, -1):
        for w in range(TOGETHER):
            there = rows[j + 1, _ERROR, w]
            here = (rows[j, _ERROR, w] - rows[j, _UPPER, w] * there) * rows[j, _INVERSE, w]
            rows[j, _ERROR, w] = here
            share = rows[j + 2, _SHARE, w]
            rows[j + 1, _SHARE, w] = share
            there, here = share * there, share * here
            rows[j, _FORCE, w] += here
            x, y, z = rows[j + 1, _AFTER, w], rows[j + 1, _AFTER + 1, w], rows[j + 1, _AFTER + 2, w]
            x += there * rows[j + 1, _LINK, w] - here * rows[j, _LINK, w]
            y += there * rows[j + 1, _LINK + 1, w] - here * rows[j, _LINK + 1, w]
            z += there * rows[j + 1, _LINK + 2, w] - here * rows[j, _LINK + 2, w]
            rows[j + 1, _AFTER, w], rows[j + 1, _AFTER + 1, w], rows[j + 1, _AFTER + 2, w] = x, y, z
            # as _measure_link, while the joint is in registers
            x = rows[j + 2, _AFTER, w] - x
            y = rows[j + 2, _AFTER + 1, w] - y
            z = rows[j + 2, _AFTER + 2, w] - z
            rows[j + 1, _NEXT, w], rows[j + 1, _NEXT + 1, w], rows[j + 1, _NEXT + 2, w] = x, y, z
            error = x * x + y * y + z * z - rows[j + 1, _SQUARE, w]
            rows[j + 1, _ERROR, w] = error
            rows[j + 1, _WORST, w] = max(rows[j + 2, _WORST, w], abs(error))
    _measure_link(rows, 0)
    for w in range(TOGETHER):
        rows[0, _WORST, w] = max(rows[1, _WORST, w], abs(rows[0, _ERROR, w]))


@inner
def _product(rows: Floats, i: int, j: int, w: int) -> float:
    """Return the scalar product of the links i after the step and j before it, of strand w."""
    return float(
        rows[i, _NEXT, w] * rows[j, _LINK, w]
        + rows[i, _NEXT + 1, w] * rows[j, _LINK + 1, w]
        + rows[i, _NEXT + 2, w] * rows[j, _LINK + 2, w]
    )


@inner
def _other_sizes(rows: Floats) -> bool:
    """Return False: a branch by it tells the compiler the sizes, which it needs for vectors."""
    return bool(rows.shape[1] != _FIELDS or rows.shape[2] != TOGETHER)
