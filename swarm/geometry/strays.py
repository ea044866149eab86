"""Strays: vectors from the catenaries between grip points to the joints of swinging strands."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from swarm.geometry.catenary_kernel import LEAST_HALF_ANGLE, solve_catenary
from swarm.geometry.catenary_points import (
    Arcs,
    Offsets,
    Vectors,
    offsets_memory,
    vectors_of,
    write_offsets,
)
from swarm.jit import compiled, inner
from swarm.signatures import Floats1, Floats2, Floats3, Floats4, Ints1, contiguous

Floats = npt.NDArray[np.float64]
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
    found = np.empty(joints.shape)
    subtract_catenaries(contiguous(ends), whole, contiguous(joints), found)
    return found


class _Memory(NamedTuple):
    """Working memory: the fractions (k,) of joints, strands together, and strays (k, 3) of one."""

    fractions: Floats1
    arcs: Arcs
    vectors: Vectors
    offsets: Offsets
    strays: Floats2


def subtract_catenaries(ends: Floats, held: Held, joints: Floats, found: Floats) -> None:
    """Write the strays of joints (m, s, links + 1, 3) to rows of ``found`` (m, r, joints, 3).

    That has as many joints in each row, or a multiple of the links; strays are interpolated within
    links there. ``ends`` (m, n, 3) are the grip points.
    """
    count = joints.shape[2]
    offsets = offsets_memory(count)
    together = len(offsets.angles) // (count + 1)
    memory = _Memory(
        np.linspace(0.0, 1.0, count), Arcs(*np.empty((3, together))),
        Vectors(*np.empty((3, together, 3))), offsets, np.empty((count, 3)),
    )  # fmt: skip
    _write_strays(ends, held, joints, memory, found)


@compiled
def _write_strays(
    ends: Floats3, held: Held, joints: Floats4, memory: _Memory, found: Floats4
) -> None:
    """Write the strays, many strands together."""
    fractions, arcs, vectors, offsets, own = memory
    count, together, row = len(held.segments), len(arcs.length), len(fractions) + 1
    for begin in range(0, len(ends) * count, together):
        some = min(together, len(ends) * count - begin)
        for q in range(some):
            _solve(ends, held, begin + q, arcs, vectors, q)
        write_offsets(fractions, arcs, (0, some), offsets)
        for q in range(some):
            moment, strand = divmod(begin + q, count)
            here = slice(q * row + 1, (q + 1) * row)
            moved = offsets.angles[here], offsets.heights[here]
            there = found[moment, held.rows[strand]]
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
    solved = solve_catenary(start, end, length, LEAST_HALF_ANGLE)
    arcs.length[q], arcs.parameter[q], arcs.slope[q] = length, solved.parameter, solved.slope
    along = solved.parameter / solved.span
    for axis in range(3):
        vectors.start[q, axis] = start[axis]
        vectors.per_angle[q, axis] = along * (end[axis] - start[axis]) if axis < 2 else 0.0
        vectors.per_height[q, axis] = length if axis == 2 else 0.0


@inner
def _subtract(
    joints: Floats, vectors: Vectors, q: int, offsets: tuple[Floats, Floats], found: Floats
) -> None:
    """Write joints (k, 3) less the points of a strand with these angles and heights (k,)."""
    (start, by_angle, by_height), (angles, heights) = vectors_of(vectors, q), offsets
    for k in range(len(joints)):
        angle, height = angles[k], heights[k]
        found[k, 0] = joints[k, 0] - (start[0] + (angle * by_angle[0] + height * by_height[0]))
        found[k, 1] = joints[k, 1] - (start[1] + (angle * by_angle[1] + height * by_height[1]))
        found[k, 2] = joints[k, 2] - (start[2] + (angle * by_angle[2] + height * by_height[2]))


@inner
def _spread(own: Floats, found: Floats) -> None:
    """Write vectors (k, 3) to as many or more places, interpolated between them."""
    last = len(own) - 1
    parts = (len(found) - 1) // last
    for i in range(last + 1):
        for axis in range(3):
            found[parts * i, axis] = own[i, axis]
    for part in range(1, parts):
        share = part / parts
        for i in range(last):
            for axis in range(3):
                step = own[i + 1, axis] - own[i, axis]
                found[parts * i + part, axis] = own[i, axis] + share * step
