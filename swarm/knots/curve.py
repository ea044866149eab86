"""The signed Gauss code of a polygonal curve's plan view, seen from above (from +z).

The comparison of this code with a diagram's is exact, and the flight certificate rests on it, so
nothing is rounded silently: where floating point cannot tell on which side of a strand a point
lies, the plan is shifted by less than anything physical, several ways, and the code counts only if
all of them agree.
"""

import numpy as np
from numpy.typing import NDArray

from swarm.knots.gauss import KnotError, SignedGauss, same_code

Points = NDArray[np.float64]

NUDGE = 1e-9
"""Largest shift of a point in a degenerate plan view, as a share of the curve's extent."""

_SHIFTS = 4
_ROUNDING = 4e-16
"""Shewchuk's bound for the orientation test, 3.33e-16, rounded up."""


def curve_gauss(points: Points, *, closed: bool = False) -> SignedGauss:
    """Signed Gauss code of a curve's plan view, seen from above.

    ``points`` is (n, 3); consecutive points are joined by straight lines, and the last to the first
    if ``closed``. Degenerate views (a vertex on another strand, repeated points, plumb segments)
    are read as the view of any curve within ``NUDGE`` × extent of it.

    Raises KnotError where those differ (strands on top of each other over a length, a strand that
    only touches another, three strands through one point), and where two strands meet in space.
    """
    curve = checked(points, closed=closed)
    if len(curve) < 3:
        return SignedGauss((), closed)
    extent = float(np.max(np.ptp(curve, axis=0)))
    pairs = _candidates(curve, closed, 2 * NUDGE * extent)
    code = _code(curve, pairs, closed, extent)
    if code is not None:
        return code
    rng = np.random.default_rng(1)
    codes = []
    for _ in range(_SHIFTS // 2):
        shift = np.zeros_like(curve)
        shift[:, :2] = rng.uniform(-NUDGE * extent, NUDGE * extent, (len(curve), 2))
        codes += [_code(curve + way * shift, pairs, closed, extent) for way in (1.0, -1.0)]
    first = codes[0]
    if first is None or any(c is None or not same_code(first, c) for c in codes):
        raise KnotError(
            "the plan view is degenerate: strands lie on top of each other, touch without "
            "crossing, or three of them cross at one point"
        )
    return first


def checked(points: Points, *, closed: bool) -> Points:
    """The curve without repeated points. Raises KnotError for a wrong shape or numbers."""
    curve: Points = np.asarray(points, dtype=np.float64)
    if curve.ndim != 2 or curve.shape[1] != 3:
        raise KnotError(f"a curve is an (n, 3) array, got shape {curve.shape}")
    if len(curve) < 2:
        raise KnotError(f"a curve needs at least 2 points, got {len(curve)}")
    if not np.all(np.isfinite(curve)):
        row = int(np.flatnonzero(~np.isfinite(curve).all(axis=1))[0])
        raise KnotError(f"point {row + 1} of the curve is not finite")
    keep = np.concatenate([[True], np.any(np.diff(curve, axis=0) != 0, axis=1)])
    curve = curve[keep]
    if closed and len(curve) > 1 and np.array_equal(curve[0], curve[-1]):
        return curve[:-1]
    return curve


def _candidates(curve: Points, closed: bool, margin: float) -> NDArray[np.int64]:
    """Pairs (k, 2) of segments, not neighbours, whose plan boxes overlap."""
    start = curve[:, :2]
    end = np.roll(start, -1, axis=0)
    if not closed:
        start, end = start[:-1], end[:-1]
    count = len(start)
    low, high = np.minimum(start, end) - margin, np.maximum(start, end) + margin
    block = max(8, int(np.sqrt(count) / 3))
    edges = np.arange(0, count, block)
    block_low, block_high = np.minimum.reduceat(low, edges), np.maximum.reduceat(high, edges)
    meets = np.all(
        (block_low[:, None] <= block_high[None]) & (block_low[None] <= block_high[:, None]), axis=-1
    )
    one, two = np.nonzero(np.triu(meets))
    offset = np.arange(block)
    first = one[:, None, None] * block + offset[None, :, None]
    second = two[:, None, None] * block + offset[None, None, :]
    first, second = (part.ravel() for part in np.broadcast_arrays(first, second))
    valid = (first + 1 < second) & (second < count)
    if closed:
        valid &= ~((first == 0) & (second == count - 1))
    first, second = first[valid], second[valid]
    overlap = np.all((low[first] <= high[second]) & (low[second] <= high[first]), axis=1)
    return np.stack([first[overlap], second[overlap]], axis=1)


def _sides(a: Points, b: Points, c: Points) -> tuple[Points, NDArray[np.bool_]]:
    """Twice the signed area of each plan triangle, and whether its sign is certain."""
    left = (a[:, 0] - c[:, 0]) * (b[:, 1] - c[:, 1])
    right = (a[:, 1] - c[:, 1]) * (b[:, 0] - c[:, 0])
    area = left - right
    return area, np.abs(area) > _ROUNDING * (np.abs(left) + np.abs(right))


def _code(
    curve: Points, pairs: NDArray[np.int64], closed: bool, extent: float
) -> SignedGauss | None:
    """The code, or None where floating point cannot decide it."""
    after = np.roll(curve, -1, axis=0)
    a, b = curve[pairs[:, 0]], after[pairs[:, 0]]
    c, d = curve[pairs[:, 1]], after[pairs[:, 1]]
    (abc, sure_c), (abd, sure_d) = _sides(a, b, c), _sides(a, b, d)
    (cda, sure_a), (cdb, sure_b) = _sides(c, d, a), _sides(c, d, b)
    apart = (sure_c & sure_d & (abc * abd > 0)) | (sure_a & sure_b & (cda * cdb > 0))
    sure = sure_a & sure_b & sure_c & sure_d
    if not np.all(apart | sure):
        return None
    cross = ~apart
    first, second = pairs[cross].T
    along_first = cda[cross] / (cda[cross] - cdb[cross])
    along_second = abc[cross] / (abc[cross] - abd[cross])
    height_first = a[cross, 2] + along_first * (b[cross, 2] - a[cross, 2])
    height_second = c[cross, 2] + along_second * (d[cross, 2] - c[cross, 2])
    gap = height_first - height_second
    if np.any(np.abs(gap) <= NUDGE * extent):
        at = np.flatnonzero(np.abs(gap) <= NUDGE * extent)[0]
        place = a[cross][at] + along_first[at] * (b[cross][at] - a[cross][at])
        raise KnotError(
            f"two strands meet in space at ({place[0]:.6g}, {place[1]:.6g}, {place[2]:.6g})"
        )
    number = np.arange(len(first))
    # The first strand's direction × the second's points up where d lies to its left.
    turn = np.where(abd[cross] > 0, 1, -1)
    sign = np.where(gap > 0, turn, -turn)
    segment = np.concatenate([first, second])
    along = np.concatenate([along_first, along_second])
    order = np.lexsort((along, segment))
    if np.any((np.diff(segment[order]) == 0) & (np.diff(along[order]) < 1e-11)):
        return None
    label = np.concatenate([number, number])[order] + 1
    over = np.concatenate([gap > 0, gap < 0])[order]
    signs = np.concatenate([sign, sign])[order]
    return SignedGauss.of(
        zip(label.tolist(), over.tolist(), signs.tolist(), strict=True), closed=closed
    )
