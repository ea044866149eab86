"""The swinging cable: strands as lumped masses on inextensible links, their ends moved as given.

Each strand is cut into equal links with a mass at each inner joint (the lumped-mass model of
mooring lines; Walton and Polachek 1960). Verlet's method steps the masses under gravity and drag,
many strands side by side; the links keep their length by the constraint forces of SHAKE (Ryckaert
et al. 1977), which for a chain are one tridiagonal system, solved exactly instead of link by link.
Strands do not touch each other, the floor or the vehicles, and do not act on the vehicles.

A strand begins as a chain that hangs at rest. Joints at equal distances along a catenary are not at
rest: they are nearer to each other than links are long, by a fifth where the catenary turns over
within a link's length. A *stray* is the vector from the catenary between a strand's ends to one of
its joints.
"""

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from swarm.geometry.catenary import (
    STANDARD_GRAVITY,
    Arcs,
    Offsets,
    Vectors,
    offsets_memory,
    solve_catenaries,
    solve_catenary,
    vectors_of,
    write_offsets,
)
from swarm.geometry.distance import norms
from swarm.jit import allocates, compiled, inner
from swarm.signatures import Floats1, Floats2, Floats3, Floats4, Floats5, Floats6, Ints1, contiguous

Floats = npt.NDArray[np.float64]

_NEWTON_STEPS = 60
"""Most Newton steps: four or five close the strands of plans."""

_CLOSED = 1e-12
"""Distance from the last joint to the end, over the length, at which the chain is closed."""


def hung_strands(starts: Floats, ends: Floats, lengths: Floats, links: int) -> Floats:
    """Return the joints (s, links + 1, 3) of strands at rest between grip points (s, 3) each.

    Where a strand's span is less than a link there may be no chain at rest: its joints are on the
    catenary. Raises :class:`.OverStretched` where a chord is longer than its
    strand.
    """
    starts, ends = (np.ascontiguousarray(grips, dtype=np.float64) for grips in (starts, ends))
    joints = solve_catenaries(starts, ends, lengths).points(np.linspace(0.0, 1.0, links + 1))
    hung = np.empty(joints.shape[1:])
    for k, length in enumerate(lengths.tolist()):
        if hang_links(starts[k], ends[k], length, hung):
            joints[k] = hung
    return joints


@compiled
def hang_links(start: Floats1, end: Floats1, length: float, joints: Floats2) -> bool:
    """Write the joints (k + 1, 3) of k equal links at rest between two points, metres.

    A link between joints of equal mass points along its tension (H, V + i): H is the horizontal
    tension and V the vertical one of the first link, over the weight of a joint. They minimize the
    complementary energy Σ l·|(H, V + i)| − H·span − V·rise, which is convex; its gradient is the
    gap to the end. Return whether the chain could be closed: with a span of a link's length or
    more it can; a narrower one may hang with a link under pressure.
    """
    links = len(joints) - 1
    link = length / links
    strand = solve_catenary(start, end, length)
    chain = (link, strand.span, strand.rise)
    across = strand.parameter / link
    up = across * strand.slope + 0.5
    gap, slopes = _gap(across, up, links, chain)
    size = math.hypot(gap[0], gap[1])
    for _ in range(_NEWTON_STEPS):
        if size <= _CLOSED * length:
            break
        scale = slopes[0] * slopes[2] - slopes[1] * slopes[1]
        if not scale > 0.0:
            break
        step = (
            (slopes[1] * gap[1] - slopes[2] * gap[0]) / scale,
            (slopes[1] * gap[0] - slopes[0] * gap[1]) / scale,
        )
        share = 1.0
        while share > 1e-6:
            level = max(across + share * step[0], 0.1 * across)
            moved, bent = _gap(level, up + share * step[1], links, chain)
            if math.hypot(moved[0], moved[1]) < size:
                break
            share *= 0.5
        if not math.hypot(moved[0], moved[1]) < size:
            break
        across, up, gap, slopes = level, up + share * step[1], moved, bent
        size = math.hypot(gap[0], gap[1])
    along = height = 0.0
    for i in range(links + 1):
        for axis in range(2):
            joints[i, axis] = start[axis] + along / strand.span * (end[axis] - start[axis])
        joints[i, 2] = start[2] + height
        tension = math.hypot(across, up + i)
        along, height = along + link * across / tension, height + link * (up + i) / tension
    for axis in range(3):
        joints[links, axis] = end[axis]
    return size <= 1e3 * _CLOSED * length


@inner
def _gap(
    across: float, up: float, links: int, chain: tuple[float, float, float]
) -> tuple[tuple[float, float], tuple[float, float, float]]:
    """Return how far the last joint is beyond the end, level and up, and the derivatives of that
    by the tensions of the first link: level by level, level by up, up by up."""
    link, span, rise = chain
    x, z, xx, xz, zz = -span, -rise, 0.0, 0.0, 0.0
    for i in range(links):
        size = math.hypot(across, up + i)
        cosine, sine = across / size, (up + i) / size
        x, z = x + link * cosine, z + link * sine
        xx += link * sine * sine / size
        xz -= link * cosine * sine / size
        zz += link * cosine * cosine / size
    return (x, z), (xx, xz, zz)


Ints = npt.NDArray[np.intp]


class Held(NamedTuple):
    """Strands (s,): the grip points at which they begin, lengths, and rows of a result."""

    segments: Ints1
    lengths: Floats1
    rows: Ints1


def strays_of(joints: Floats, ends: Floats, segments: Ints, lengths: Floats) -> Floats:
    """Return the strays (k, s, links + 1, 3) of joints, compared at equal arc length; metres.

    ``joints`` (k, s, links + 1, 3) are those of strands that begin at the grip points ``segments``
    (s,) of ``ends`` (k, n, 3), ENU, with lengths (s,). A chord beyond its length counts as it.
    """
    whole = Held(
        segments, contiguous(np.asarray(lengths, dtype=np.float64)), np.arange(len(segments))
    )
    strays = np.empty(joints.shape)
    every = np.arange(joints.shape[0] * joints.shape[1])
    subtract_catenaries(contiguous(ends), whole, contiguous(joints), every, strays)
    return strays


class _Memory(NamedTuple):
    """Working memory: the fractions (k,) of joints, strands together, and strays (k, 3) of one."""

    fractions: Floats1
    arcs: Arcs
    vectors: Vectors
    offsets: Offsets
    strays: Floats2


def subtract_catenaries(
    ends: Floats, held: Held, joints: Floats, wanted: Ints, strays: Floats
) -> None:
    """Write the strays of joints (m, s, links + 1, 3) to rows of ``strays`` (m, r, joints, 3).

    That has as many joints in each row, or a multiple of the links; strays are interpolated within
    links there. ``ends`` (m, n, 3) are the grip points. Only those of strands and moments whose
    numbers, moment · s + strand, are ``wanted`` are written.
    """
    count = joints.shape[2]
    offsets = offsets_memory(count)
    together = len(offsets.angles) // (count + 1)
    memory = _Memory(
        np.linspace(0.0, 1.0, count), Arcs(*np.empty((3, together))),
        Vectors(*np.empty((3, together, 3))), offsets, np.empty((count, 3)),
    )  # fmt: skip
    _write_strays(ends, held, joints, wanted, memory, strays)


@compiled
def _write_strays(
    ends: Floats3, held: Held, joints: Floats4, wanted: Ints1, memory: _Memory, strays: Floats4
) -> None:
    """Write the strays, many strands together."""
    fractions, arcs, vectors, offsets, own = memory
    count, together, row = len(held.segments), len(arcs.length), len(fractions) + 1
    for begin in range(0, len(wanted), together):
        some = min(together, len(wanted) - begin)
        for q in range(some):
            _solve(ends, held, wanted[begin + q], arcs, vectors, q)
        write_offsets(fractions, arcs, (0, some), offsets)
        for q in range(some):
            moment, strand = divmod(wanted[begin + q], count)
            here = slice(q * row + 1, (q + 1) * row)
            moved = offsets.angles[here], offsets.heights[here]
            there = strays[moment, held.rows[strand]]
            if len(there) == len(own):
                _subtract(joints[moment, strand], vectors, q, moved, there)
            else:
                _subtract(joints[moment, strand], vectors, q, moved, own)
                _spread(own, there)


@inner
def _solve(ends: Floats, held: Held, number: int, arcs: Arcs, vectors: Vectors, q: int) -> None:
    """Write the catenary of a strand at a moment, by the number of both, to place q."""
    moment, strand = divmod(number, len(held.segments))
    first = held.segments[strand]
    start, end, length = ends[moment, first], ends[moment, first + 1], held.lengths[strand]
    solved = solve_catenary(start, end, length)
    arcs.length[q], arcs.parameter[q], arcs.slope[q] = length, solved.parameter, solved.slope
    along = solved.parameter / solved.span
    for axis in range(3):
        vectors.start[q, axis] = start[axis]
        vectors.per_angle[q, axis] = along * (end[axis] - start[axis]) if axis < 2 else 0.0
        vectors.per_height[q, axis] = length if axis == 2 else 0.0


@inner
def _subtract(
    joints: Floats, vectors: Vectors, q: int, offsets: tuple[Floats, Floats], strays: Floats
) -> None:
    """Write joints (k, 3) less the points of a strand with these angles and heights (k,)."""
    (start, by_angle, by_height), (angles, heights) = vectors_of(vectors, q), offsets
    for k in range(len(joints)):
        angle, height = angles[k], heights[k]
        strays[k, 0] = joints[k, 0] - (start[0] + (angle * by_angle[0] + height * by_height[0]))
        strays[k, 1] = joints[k, 1] - (start[1] + (angle * by_angle[1] + height * by_height[1]))
        strays[k, 2] = joints[k, 2] - (start[2] + (angle * by_angle[2] + height * by_height[2]))


@inner
def _spread(own: Floats, places: Floats) -> None:
    """Write vectors (k, 3) to as many or more places, interpolated between them."""
    last = len(own) - 1
    parts = (len(places) - 1) // last
    for i in range(last + 1):
        for axis in range(3):
            places[parts * i, axis] = own[i, axis]
    for part in range(1, parts):
        share = part / parts
        for i in range(last):
            for axis in range(3):
                step = own[i + 1, axis] - own[i, axis]
                places[parts * i + part, axis] = own[i, axis] + share * step


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


class Runs(NamedTuple):
    """Strands (r,) in motions (r,), and how many of the ``samples`` (r,) of each are wanted."""

    motion: Ints1
    strand: Ints1
    samples: Ints1


@compiled
@allocates
def swing_each(
    given: tuple[Floats5, Floats4, Ints1], lengths: Floats1, steps: Steps, drag: Drag, runs: Runs,
    states: Floats6,
) -> None:  # fmt: skip
    """Write the states of s strands in c motions to ``states`` (c, …, 1 or 2, s, joints, 3), after
    the first ones: those of ``runs``, of which those next to each other run together.

    ``given`` are the first states (c, 2, s, joints, 3), the positions (c, n, k, 3) of the grip
    points, and the numbers (s,) of those at which strands begin; ``lengths`` (s,) those of the
    links. With 1, only the last part of each state is written, the joints at that time.
    """
    motion, strand = np.empty(TOGETHER, np.int64), np.empty(TOGETHER, np.int64)
    rows, most = np.zeros((states.shape[4], _FIELDS, TOGETHER)), np.empty(TOGETHER)
    memory = rows, most, np.empty((2, 3, TOGETHER))
    for first in range(0, len(runs.motion), TOGETHER):
        samples = 0
        for w in range(TOGETHER):
            run = min(first + w, len(runs.motion) - 1)
            motion[w], strand[w] = runs.motion[run], runs.strand[run]
            samples = max(samples, runs.samples[run])
        rows[:] = 0.0
        _swing_together(given, lengths, steps, drag, (motion, strand), samples, memory, states)


@inner
def _swing_together(
    given: Given, lengths: Floats, steps: Steps, drag: Drag, chosen: Chosen, samples: int,
    memory: Memory, states: Floats,
) -> None:  # fmt: skip
    """Write the states of the strands ``chosen`` by the numbers of their motions and their own.

    They end with the last of the ``samples``, of which the first is given. ``memory`` are rows of
    zeros, errors, and the places (2, 3, …) of both ends.
    """
    begun, ends, segments = given
    motion, strand = chosen
    rows, most, places = memory
    last = states.shape[4] - 1
    for w in range(TOGETHER):
        square = lengths[strand[w]] ** 2
        most[w] = _TOLERANCE * square
        for i in range(last + 1):
            rows[i, _SQUARE, w] = square
            for x in range(3):
                rows[i, _NOW + x, w] = begun[motion[w], 0, strand[w], i, x]
                rows[i, _AFTER + x, w] = begun[motion[w], 1, strand[w], i, x]
    for k in range(1, (samples - 1) * steps.every + 1):
        for w in range(TOGETHER):
            grips = ends[motion[w]]
            for x in range(3):
                places[0, x, w] = grips[segments[strand[w]], k, x]
                places[1, x, w] = grips[segments[strand[w]] + 1, k, x]
        _step_freely(rows, places, drag, steps.step)
        _restore_links(rows, most)
        if k % steps.every == 0:
            _write_states(rows, chosen, k // steps.every, states)


@inner
def _write_states(rows: Floats, chosen: Chosen, sample: int, states: Floats) -> None:
    """Write the states of strands to a sample, joint by joint as they are in memory."""
    if _other_sizes(rows):
        return
    (motion, strand), last = chosen, states.shape[2] - 1
    for i in range(len(rows)):
        for w in range(TOGETHER):
            for x in range(3):
                if last > 0:
                    states[motion[w], sample, 0, strand[w], i, x] = rows[i, _NOW + x, w]
                states[motion[w], sample, last, strand[w], i, x] = rows[i, _AFTER + x, w]


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


@dataclass(frozen=True, eq=False)
class Strands:
    """Strands (s,) of a chain of grip points with one model.

    ``segments`` (s,) are the numbers of the grip points at which they begin, ``lengths`` in metres.
    """

    segments: Ints
    lengths: Floats
    model: SwingModel

    @classmethod
    def whole_chain(cls, lengths: Floats, model: SwingModel) -> "Strands":
        """Return all strands of a chain, of lengths (n − 1,)."""
        return cls(np.arange(len(lengths)), lengths, model)

    def taken(self, where: Ints) -> "Strands":
        """Return some of the strands."""
        return Strands(self.segments[where], self.lengths[where], self.model)

    def refined(self) -> "Strands":
        """Return the strands with twice the links, and half the step."""
        links, step = 2 * self.model.links, 0.5 * self.model.step
        return replace(self, model=replace(self.model, links=links, step=step))

    def at_rest(self, ends: Floats) -> Floats:
        """Return the state (2, s, links + 1, 3) of strands that hang still at grip points (n, 3).

        A state holds the joints one step ago, and now. Raises
        :class:`.OverStretched` where a chord is longer than its strand.
        """
        begin = self.segments
        joints = hung_strands(ends[begin], ends[begin + 1], self.lengths, self.model.links)
        return np.stack([joints, joints])

    def swing_on(self, state: Floats, ends: Floats, every: int = 1) -> Floats:
        """Return the states of strands that continue from a state: each ``every``-th step.

        ``ends`` (k, n, 3) are the grip points, ENU metres, ``model.step`` seconds apart, beginning
        at the state's time. Returns (ceil(k / every), 2, s, links + 1, 3), the given state first. A
        strand that is pulled taut ends as NaN.
        """
        states: Floats = self._swing(state[None], ends[None], every, 2)[0]
        return states

    def swing_on_each(
        self, states: Floats, ends: Floats, every: int = 1, samples: Ints | None = None
    ) -> Floats:
        """Return the joints of the strands from c states, each in its own motion.

        ``states`` (c, 2, s, links + 1, 3) and ``ends`` (c, k, n, 3) as for :meth:`swing_on`.
        Returns (c, ceil(k / every), s, links + 1, 3); with ``samples`` (c, s), only as many of each
        strand are written.
        """
        joints: Floats = self._swing(states, ends, every, 1, samples)[:, :, 0]
        return joints

    def strays(self, joints: Floats, ends: Floats) -> Floats:
        """Return the largest distances (k, s) of the strands from their catenaries, in metres.

        ``joints`` (k, s, links + 1, 3), ``ends`` (k, n, 3) of the grip points at the same times;
        compared at equal arc length. Infinite for strands that are shorter than their chord at the
        time, or were so before.
        """
        segments, lengths = self.segments, self.lengths
        chords = np.linalg.norm(ends[:, segments + 1] - ends[:, segments], axis=2)
        distance: Floats = norms(strays_of(joints, ends, segments, lengths)).max(axis=-1)
        return np.where((chords > lengths) | np.isnan(distance), np.inf, distance)

    def _swing(
        self, states: Floats, ends: Floats, every: int, parts: int, samples: Ints | None = None
    ) -> Floats:
        """Return the last ``parts`` of the states (c, ceil(k / every), …, s, links + 1, 3)."""
        model = self.model
        most = (ends.shape[1] + every - 1) // every
        history = np.empty((len(states), most, parts, *states.shape[2:]))
        history[:, 0] = states[:, 2 - parts :]
        drag = Drag(model.normal_drag, model.tangential_drag, *model.wind)
        # those of one grip point next to each other: others would fill the caches
        grips = np.ascontiguousarray(ends.swapaxes(1, 2))
        given = np.ascontiguousarray(states), grips, self.segments
        if samples is None:
            samples = np.full((len(states), len(self.segments)), most)
        # next to each other: runs of a strand, which need about as many iterations, by their length
        strand, motion = np.nonzero(samples.T > 1)
        order = np.lexsort((samples[motion, strand], strand))
        motion, strand = motion[order], strand[order]
        runs = Runs(motion, strand, samples[motion, strand])
        swing_each(given, self.lengths / model.links, Steps(model.step, every), drag, runs, history)
        return history
