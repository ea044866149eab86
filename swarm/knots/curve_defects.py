"""Defects of a curve in space for which it has no knot: too few points, or strands that meet."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from swarm.knots.curve import REPEATED, Points, overlapping_segments
from swarm.knots.gauss import KnotError

LARGEST_EXTENT: Final = 1e100
SMALLEST_EXTENT: Final = 1e-100
"""Extents of a curve between which products neither overflow nor underflow."""


@dataclass(frozen=True)
class CurveDefect:
    """A defect of a curve, with its points, counted from 0."""

    points: tuple[int, ...]
    message: str

    def error(self) -> KnotError:
        """Return the error for a curve that is an array."""
        numbers = " and ".join(str(index + 1) for index in self.points)
        where = f" (point{'s' * (len(self.points) > 1)} {numbers})" if numbers else ""
        return KnotError(self.message + where)


def find_defect(points: Points, *, closed: bool) -> CurveDefect | None:
    """Return why a curve (n, 3) of finite points has no knot, or None where it has one.

    Consecutive points in the same place count once. Strands meet where their distance is at most
    ``REPEATED`` × the curve's extent, the limit of floating point. Whether an open curve meets its
    closure is not checked.
    """
    with np.errstate(over="ignore"):
        extent = float(np.max(np.ptp(points, axis=0)))
    if extent > LARGEST_EXTENT or (0.0 < extent < SMALLEST_EXTENT):
        size = f"{SMALLEST_EXTENT:g} to {LARGEST_EXTENT:g}"
        return CurveDefect((), f"expected a curve of {size} in size, got {extent:g}")
    kept = _kept(points, REPEATED * extent, closed)
    if len(kept) < 3:
        return CurveDefect((), f"expected at least 3 different points, got {len(kept)}")
    # Scaled to 0…1, so that no product overflows or underflows.
    curve = (points[kept] - points[kept].min(axis=0)) / extent
    return _backward_step(curve, kept, closed) or _meeting_segments(curve, kept, closed)


def _kept(points: Points, same: float, closed: bool) -> NDArray[np.int64]:
    """Return the indices of the points that differ from the point before."""
    steps = np.max(np.abs(np.diff(points, axis=0)), axis=1)
    kept = np.flatnonzero(np.concatenate([[True], steps > same])[: len(points)])
    if closed and len(kept) > 1 and np.max(np.abs(points[kept[-1]] - points[kept[0]])) <= same:
        kept = kept[:-1]
    return kept


def _backward_step(curve: Points, kept: NDArray[np.int64], closed: bool) -> CurveDefect | None:
    """Return the first point after which a curve runs back along its last segment."""
    come = curve - np.roll(curve, 1, axis=0)
    go = np.roll(curve, -1, axis=0) - curve
    aside = np.linalg.norm(np.cross(come, go), axis=1)
    sizes = np.linalg.norm(come, axis=1) * np.linalg.norm(go, axis=1)
    back = (aside <= REPEATED * sizes) & (np.sum(come * go, axis=1) < 0.0)
    if not closed:
        back[[0, -1]] = False
    at = np.flatnonzero(back)
    if not len(at):
        return None
    return CurveDefect((int(kept[at[0]]),), "the curve goes back along itself from here")


def _meeting_segments(curve: Points, kept: NDArray[np.int64], closed: bool) -> CurveDefect | None:
    """Return the first two segments that meet and are not neighbours."""
    start, end = curve, np.roll(curve, -1, axis=0)
    pairs = overlapping_segments(curve, closed=closed, margin=REPEATED)
    first, second = pairs.T
    gap = _distances(start[first], end[first], start[second], end[second])
    at = np.flatnonzero(gap <= REPEATED)
    if not len(at):
        return None
    one, two = sorted(int(kept[index]) for index in pairs[at[0]])
    return CurveDefect((one, two), "the segments of the curve that begin here meet")


def _distances(a: Points, b: Points, c: Points, d: Points) -> NDArray[np.float64]:
    """Return distances (n,) between segments a–b and c–d, each (n, 3), none of length 0.

    After Ericson, Real-Time Collision Detection, 2005, 5.1.9.
    """
    one, two, between = b - a, d - c, a - c
    own, other, shared = _dot(one, one), _dot(two, two), _dot(one, two)
    on_one, on_two = _dot(one, between), _dot(two, between)
    area = own * other - shared**2
    with np.errstate(divide="ignore", invalid="ignore"):
        s = np.where(area > 0.0, (shared * on_two - on_one * other) / area, 0.0)
    s = np.clip(s, 0.0, 1.0)  # where they are parallel, any s is valid
    t = np.clip((shared * s + on_two) / other, 0.0, 1.0)
    s = np.clip((shared * t - on_one) / own, 0.0, 1.0)
    apart = between + s[:, None] * one - t[:, None] * two
    return np.sqrt(_dot(apart, apart))


def _dot(a: Points, b: Points) -> NDArray[np.float64]:
    product: NDArray[np.float64] = np.sum(a * b, axis=1)
    return product
