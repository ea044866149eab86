"""How much nearer swinging strands come to each other than their catenaries are.

Both strands of a pair swing in the same motion: strands that swing together keep their distance.
"""

from dataclasses import dataclass, fields
from functools import cache, partial
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from swarm.certification.compared_pairs import all_pairs
from swarm.geometry.catenary import solve_catenaries
from swarm.geometry.distance import norms, polyline_polyline
from swarm.geometry.linear_response import linear_response
from swarm.geometry.sensitivity import BOTH_ENDS, FAR_END, NEAR_END
from swarm.jit import compiled
from swarm.planning import Plan
from swarm.signatures import Floats1, Floats2, Floats3, Floats4, Floats5, Ints1, Ints2, contiguous

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.intp]

WITHIN = 1.0
"""Metres between surfaces beyond which pairs are left out: tracking, swing, tolerances and the
required distance together take 0.6 m in the default missions."""

PIECES = 64
"""Pieces of a strand for its closest point: 5 cm of a strand of 3 m."""


@dataclass(frozen=True, eq=False)
class ClosePairs:
    """Closest points of pairs of strands at moments, all (r,) or (r, 2) or (r, 3).

    ``bins`` are the numbers of the intervals in the middle of which they were found, ascending;
    ``fractions`` those of the length; ``normal`` points from the second to the first strand,
    ``available`` is the distance between surfaces in metres, and ``left`` what tracking errors
    leave of it beyond the required one, to first order.
    """

    bins: Ints
    times: Floats
    pairs: Ints
    fractions: Floats
    normal: Floats
    available: Floats
    left: Floats

    def taken(self, where: Ints) -> "ClosePairs":
        """Return some of the pairs, in the same order."""
        return ClosePairs(*(getattr(self, each.name)[where] for each in fields(self)))


@dataclass(frozen=True, eq=False)
class PairSwing:
    """How much nearer the strands of ``close`` pairs come as both swing, (r,) metres.

    In the planned motion from ``start`` on, and after changes of the clock's rate.
    """

    start: float
    close: ClosePairs
    approach: Floats


def close_pairs(plan: Plan, times: Floats, exempt: float) -> ClosePairs:
    """Return all pairs that are nearer than WITHIN at mission times (k,); ``exempt`` in metres."""
    lengths = plan.layout.lengths
    place = plan.motion.at(times)[0]
    strands = solve_catenaries(place[:, :-1], place[:, 1:], lengths)
    points = strands.points(np.linspace(0.0, 1.0, PIECES + 1))
    none = np.empty((0, 5), dtype=np.intp), np.empty((0, 3)), np.empty(0)
    found: list[tuple[Floats | Ints, ...]] = [none]
    box = cache(partial(_box, points))
    for (i, j), parts in zip(*all_pairs(lengths, exempt), strict=True):
        first = np.ceil(parts[:, 0] * PIECES).astype(np.intp)
        last = np.floor(parts[:, 1] * PIECES).astype(np.intp) + 1
        a, b = points[:, i, first[0] : last[0]], points[:, j, first[1] : last[1]]
        gap = _gap(box(i, first[0], last[0]), box(j, first[1], last[1]))
        near = np.flatnonzero(gap < WITHIN + plan.mission.cable.diameter)
        closest = polyline_polyline(a[near], b[near])
        here = np.rint(closest.first).astype(np.intp) + first[0]
        there = np.rint(closest.second).astype(np.intp) + first[1]
        apart = points[near, i, here] - points[near, j, there]
        size = norms(apart)
        kept = (size < WITHIN + plan.mission.cable.diameter) & (size > 1e-9)
        rows = np.column_stack([near, np.full(len(near), i), np.full(len(near), j), here, there])
        found.append((rows[kept], apart[kept] / size[kept, None], size[kept]))
    rows, normal, size = (np.concatenate(parts) for parts in zip(*found, strict=True))
    order = np.argsort(rows[:, 0], kind="stable")
    rows, normal, size = rows[order], normal[order], size[order]
    pairs, fractions = rows[:, 1:3], rows[:, 3:] / PIECES
    available = size - plan.mission.cable.diameter
    tracking = _tracking(plan, place[rows[:, 0]], pairs, fractions, normal)
    left = available - tracking - plan.mission.clearance.cable
    return ClosePairs(rows[:, 0], times[rows[:, 0]], pairs, fractions, normal, available, left)


def _tracking(plan: Plan, place: Floats, pairs: Ints, fractions: Floats, normal: Floats) -> Floats:
    """Return the largest approach (r,) of pairs by tracking errors of the team, at ``place``
    (r, n, 3)."""
    rows = np.arange(len(pairs))
    neighbours = pairs[:, 1] == pairs[:, 0] + 1
    total = np.zeros(len(rows))
    for side, alone in enumerate((NEAR_END, FAR_END)):
        segment, fraction = pairs[:, side], fractions[:, side]
        ends, lengths = (place[rows, segment], place[rows, segment + 1]), plan.layout.lengths
        found = linear_response(
            solve_catenaries(*ends, lengths[segment]), fraction,
            np.where(neighbours, alone, BOTH_ENDS), normal, (fraction, fraction),
            np.zeros(len(rows)),
        )  # fmt: skip
        moved = np.where(found.known, found.at_point, 1.0)
        total += np.where(neighbours, 2.0, 1.0) * moved
    return plan.mission.vehicles.tracking * total


def _box(points: Floats, strand: int, first: int, last: int) -> tuple[Floats, Floats]:
    """Return the lowest and highest coordinates (k, 3) of a part of a strand."""
    part = points[:, strand, first:last]
    return part.min(axis=1), part.max(axis=1)


def _gap(a: tuple[Floats, Floats], b: tuple[Floats, Floats]) -> Floats:
    """Return a lower bound (k,) of the distance of polylines: that of the boxes around them."""
    apart = np.maximum(a[0] - b[1], b[0] - a[1])
    return norms(np.maximum(apart, 0.0))


def collect_distances(bins: Ints, strays: Floats, most: Floats) -> None:
    """Raise ``most`` (k, n − 1, links + 1) to the sizes of strays of joints in these intervals.

    ``strays`` (m, n − 1, links + 1, 3) at moments in the intervals ``bins`` (m,); a stray that is
    not a number has no bound.
    """
    _raise_distances(bins, contiguous(strays), most)


@compiled
def _raise_distances(bins: Ints1, strays: Floats4, most: Floats3) -> None:
    for m in range(len(bins)):
        for i in range(strays.shape[1]):
            for j in range(strays.shape[2]):
                x, y, z = strays[m, i, j, 0], strays[m, i, j, 1], strays[m, i, j, 2]
                square, known = x * x + y * y + z * z, most[bins[m], i, j]
                # few are larger, and only these need a root; NaN fails both comparisons
                if not square <= known * known:
                    most[bins[m], i, j] = np.sqrt(square) if square >= 0.0 else np.inf


def collect_approaches(close: ClosePairs, bins: Ints, strays: Floats, most: Floats) -> None:
    """Raise ``most`` (r,) to how much nearer strands come by strays at their closest points.

    ``strays`` (m, n − 1, links + 1, 3) at moments in the intervals ``bins`` (m,). Moments in the
    interval before and after count, too: a change of the rate that begins between two simulated
    ones passes through each mission time at most half an interval from where one of them does.
    """
    links = strays.shape[2] - 1
    joints = np.rint(close.fractions * links).astype(np.intp)
    first = np.searchsorted(close.bins, bins - 1, side="left")
    last = np.searchsorted(close.bins, bins + 1, side="right")
    which = _Rows(first, last, close.pairs, joints)
    _raise_approaches(which, close.normal, contiguous(strays), most)


class _Rows(NamedTuple):
    """Close pairs (r, 2) and their nearest joints; moment m has those from first to last (m,)."""

    first: Ints1
    last: Ints1
    pairs: Ints2
    joints: Ints2


@compiled
def _raise_approaches(which: _Rows, normal: Floats2, strays: Floats4, most: Floats1) -> None:
    for m in range(len(which.first)):
        for row in range(which.first[m], which.last[m]):
            one, other = strays[m, which.pairs[row, 0]], strays[m, which.pairs[row, 1]]
            i, j = which.joints[row]
            nearer = (other[j, 0] - one[i, 0]) * normal[row, 0]
            nearer += (other[j, 1] - one[i, 1]) * normal[row, 1]
            nearer += (other[j, 2] - one[i, 2]) * normal[row, 2]
            most[row] = max(most[row], np.inf if np.isnan(nearer) else nearer)


def collect_settling(close: ClosePairs, bins: Ints, strays: Floats, most: Floats) -> None:
    """Raise ``most`` (r,) to the sum of both strands' amplitudes in the rest after each stop.

    Strands of unequal periods that begin to swing together swing against each other later, with no
    more than the amplitudes that air has left. ``strays`` (c, m, n − 1, links + 1, 3) are those of
    the last moments of stops that end in the intervals ``bins`` (c,), over half a period at least.
    """
    joints = np.rint(close.fractions * (strays.shape[3] - 1)).astype(np.intp)
    first, last = np.searchsorted(close.bins, [bins - 1, bins + 2])
    which = _Rows(first, last, close.pairs, joints)
    _raise_amplitudes(which, close.normal, contiguous(strays), most)


@compiled
def _raise_amplitudes(which: _Rows, normal: Floats2, strays: Floats5, most: Floats1) -> None:
    for c in range(len(which.first)):
        for row in range(which.first[c], which.last[c]):
            reached = 0.0
            for side in range(2):
                segment, joint = which.pairs[row, side], which.joints[row, side]
                largest = 0.0
                for m in range(strays.shape[1]):
                    aside = strays[c, m, segment, joint, 0] * normal[row, 0]
                    aside += strays[c, m, segment, joint, 1] * normal[row, 1]
                    aside += strays[c, m, segment, joint, 2] * normal[row, 2]
                    largest = max(largest, np.inf if np.isnan(aside) else abs(aside))
                reached += largest
            most[row] = max(most[row], reached)
