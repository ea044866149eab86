"""Chains of catenaries from corner to corner, and their crossings in plan view.

Corners are (n, 3), ENU, z up; segment i joins corners i and i + 1. Plan view is from above; a
crossing is a pair (over, under) of segments. Gravity is vertical: this is the statics of a layout
at rest in still air.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from swarm.errors import Refused
from swarm.geometry.catenary import length_for_sag, sag_for_drop, solve_catenaries

Floats = NDArray[np.float64]
Pairs = NDArray[np.intp]

_PARALLEL = 1e-12
"""Sine of the angle below which two segments count as parallel: rounding of the cross product."""

_ON_LINE = 1e-9
"""Distance from a line, over the segments' size, below which parallel segments count as on it."""

_SETTLED = 1e-12
"""Relative change of a sag below which the iteration of sags has converged."""


@dataclass(frozen=True, eq=False)
class PlanCrossings:
    """Crossings in plan view: indices (c, 2) of segments, and fractions (c, 2) of their spans."""

    segments: Pairs
    fractions: Floats


def segment_lengths(corners: ArrayLike, sags: ArrayLike) -> Floats:
    """Return the lengths ℓ_i (…, n − 1) of cable segments with the given sags below their chords.

    Paper section III-C, with the length of a catenary instead of its misprint. ``corners`` are
    (…, n, 3), ``sags`` (…, n − 1), metres. Neighbouring corners must differ in plan view.
    """
    steps = np.diff(_floats(corners), axis=-2)
    return length_for_sag(np.hypot(steps[..., 0], steps[..., 1]), sags, steps[..., 2])


def polyline(corners: ArrayLike, lengths: ArrayLike, points_per_segment: int) -> Floats:
    """Return the whole chain as points (…, (n − 1)·points_per_segment + 1, 3).

    Each segment has ``points_per_segment`` pieces of equal arc length; corners are exact and occur
    once. ``corners`` are (…, n, 3), ``lengths`` (…, n − 1).
    """
    corners = _floats(corners)
    strands = solve_catenaries(corners[..., :-1, :], corners[..., 1:, :], lengths)
    points = strands.points(np.arange(points_per_segment) / points_per_segment)
    merged = points.reshape(*points.shape[:-3], points.shape[-3] * points_per_segment, 3)
    last = np.broadcast_to(corners[..., -1:, :], (*merged.shape[:-2], 1, 3))
    return np.concatenate([merged, last], axis=-2)


def plan_crossings(corners: ArrayLike) -> PlanCrossings:
    """Return every pair of segments that cross in plan view, by index in ascending order.

    ``corners`` are (n, 2) or (n, 3). Segments that share a corner do not cross; segments that touch
    do. Raises :class:`Refused` where two segments on one line overlap, which has no crossing.
    """
    corners = _floats(corners)
    first, second = np.triu_indices(len(corners) - 1, 2)
    at_first, at_second, parallel = _meet(corners, first, second)
    overlap = parallel & _overlapping(corners, first, second)
    if np.any(overlap):
        pairs = zip(first[overlap].tolist(), second[overlap].tolist(), strict=True)
        shown = ", ".join(f"{i} and {j}" for i, j in pairs)
        raise Refused(f"segments overlap on one line in plan view: {shown}")
    inside = (at_first >= 0.0) & (at_first <= 1.0) & (at_second >= 0.0) & (at_second <= 1.0)
    inside &= ~parallel
    return PlanCrossings(
        np.stack([first, second], axis=1)[inside],
        np.stack([at_first, at_second], axis=1)[inside],
    )


def crossing_fractions(corners: ArrayLike, crossings: ArrayLike) -> Floats:
    """Return fractions (…, c, 2) of their spans at which crossing segments meet in plan view.

    Raises :class:`ValueError` where a pair does not cross.
    """
    corners, crossings = _floats(corners), _pairs(crossings)
    over, under, parallel = _meet(corners, crossings[:, 0], crossings[:, 1])
    fractions = np.stack([over, under], axis=-1)
    bad = parallel | np.any((fractions < 0.0) | (fractions > 1.0), axis=-1)
    if np.any(bad):
        which = crossings[np.argwhere(bad)[:, -1]].tolist()
        raise ValueError(f"these pairs of segments do not cross in plan view: {which}")
    return fractions


def crossing_gaps(corners: ArrayLike, lengths: ArrayLike, crossings: ArrayLike) -> Floats:
    """Return the height (…, c) of the over strand above the under strand at each crossing; metres.

    Exact. The crossing condition of the paper is that all are positive. ``corners`` are (…, n, 3),
    ``lengths`` (…, n − 1), ``crossings`` (c, 2) pairs (over, under) of segments, which must cross.
    """
    corners, lengths, crossings = _floats(corners), _floats(lengths), _pairs(crossings)
    fractions = crossing_fractions(corners, crossings)
    strands = solve_catenaries(
        corners[..., crossings, :], corners[..., crossings + 1, :], lengths[..., crossings]
    )
    heights = strands.at_span(fractions)[..., 2]
    gaps: Floats = heights[..., 0] - heights[..., 1]
    return gaps


def minimum_sags(
    corners: ArrayLike,
    crossings: ArrayLike,
    clearance: float,
    *,
    minimum_sag: ArrayLike,
    one_each: bool = False,
) -> Floats:
    """Return the sags (n − 1,) of the shortest cable with ``clearance`` at every crossing; metres.

    ``clearance`` is the height of the over above the under strand at their crossing in plan view,
    ``minimum_sag`` one number or one per segment. With ``one_each`` every segment has its own sag;
    otherwise there are two sags, one for segments that pass over (or cross no other) and one for
    segments that pass under. A deeper strand can only make strands below it deeper, so the least
    fixed point is the shortest cable.

    Raises :class:`Refused` where strands pass over each other in a circle, for which no sags exist,
    or where a segment passes both over and under and there are only two sags.
    """
    corners, crossings = _floats(corners), _pairs(crossings)
    count = len(corners) - 1
    over, under = crossings[:, 0], crossings[:, 1]
    both = np.intersect1d(over, under)
    if not one_each and len(both):
        raise Refused(
            "two sags are not enough for segments that pass over and under: "
            + ", ".join(map(str, both.tolist()))
        )
    below = np.isin(np.arange(count), under)
    sags = np.broadcast_to(_floats(minimum_sag), (count,)).copy()
    for _ in range(count + 1):
        needed = _needed_sags(corners, crossings, sags, clearance)
        deeper = sags.copy()
        np.maximum.at(deeper, under, needed)
        if not one_each and len(under):
            deeper[below] = deeper[below].max()
        if np.all(deeper <= sags * (1.0 + _SETTLED)):
            return sags
        sags = deeper
    raise Refused(
        "these strands pass over each other in a circle, for which no sags exist: segments "
        + ", ".join(map(str, _circle(over, under)))
    )


def _needed_sags(corners: Floats, crossings: Pairs, sags: Floats, clearance: float) -> Floats:
    """Return the sag (c,) that the under strand of each crossing needs below its over strand."""
    if not len(crossings):
        return np.zeros(0)
    over, under = crossings[:, 0], crossings[:, 1]
    fractions = crossing_fractions(corners, crossings)
    lengths = segment_lengths(corners, sags)
    strands = solve_catenaries(corners[over], corners[over + 1], lengths[over])
    ceiling = strands.at_span(fractions[:, 0])[:, 2] - clearance
    step = corners[under + 1] - corners[under]
    drop = corners[under, 2] + fractions[:, 1] * step[:, 2] - ceiling
    span = np.hypot(step[:, 0], step[:, 1])
    inner = (fractions[:, 1] > 0.0) & (fractions[:, 1] < 1.0)
    if np.any(~inner & (drop > 0.0)):
        raise Refused("a strand crosses over the corner of another, where a sag does not lower it")
    lower = inner & (drop > 0.0)
    needed = np.zeros(len(crossings))
    needed[lower] = sag_for_drop(span[lower], drop[lower], fractions[lower, 1], step[lower, 2])
    return needed


def _circle(over: Pairs, under: Pairs) -> list[int]:
    """Return the segments in circles of "passes over": the rest after all sinks are removed."""
    segments = set(over.tolist()) & set(under.tolist())
    pairs = list(zip(over.tolist(), under.tolist(), strict=True))
    while True:
        kept = {
            i
            for i in segments
            if any(a == i and b in segments for a, b in pairs)
            and any(b == i and a in segments for a, b in pairs)
        }
        if kept == segments:
            return sorted(segments)
        segments = kept


def _meet(corners: Floats, first: Pairs, second: Pairs) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """Return fractions at which lines of segments meet in plan view, and which are parallel."""
    p, q = corners[..., first, :2], corners[..., second, :2]
    u, w = corners[..., first + 1, :2] - p, corners[..., second + 1, :2] - q
    area = _cross(u, w)
    size = np.linalg.norm(u, axis=-1) * np.linalg.norm(w, axis=-1)
    parallel = np.abs(area) <= _PARALLEL * size
    area = np.where(parallel, 1.0, area)
    return _cross(q - p, w) / area, _cross(q - p, u) / area, parallel


def _overlapping(corners: Floats, first: Pairs, second: Pairs) -> NDArray[np.bool_]:
    """Return which parallel segments are on one line and share a part of it."""
    p, q = corners[first, :2], corners[second, :2]
    u, w = corners[first + 1, :2] - p, corners[second + 1, :2] - q
    size = np.linalg.norm(u, axis=-1)
    on_line: NDArray[np.bool_] = np.abs(_cross(u, q - p)) <= _ON_LINE * size * (
        size + np.linalg.norm(w, axis=-1)
    )
    begin = np.einsum("ij,ij->i", q - p, u) / size**2
    end = np.einsum("ij,ij->i", q + w - p, u) / size**2
    shares = (np.maximum(begin, end) > 0.0) & (np.minimum(begin, end) < 1.0)
    on_line &= shares
    return on_line


def _cross(a: Floats, b: Floats) -> Floats:
    product: Floats = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return product


def _floats(value: ArrayLike) -> Floats:
    return np.asarray(value, dtype=np.float64)


def _pairs(crossings: ArrayLike | Sequence[tuple[int, int]]) -> Pairs:
    return np.asarray(crossings, dtype=np.intp).reshape(-1, 2)
