"""Curves in space: from text files, their defects, and the signed Gauss code of their plan view.

The plan view is seen from above (from +z). The flight certificate depends on the exact comparison
of its code with the code of a diagram. Therefore no rounding is silent: where floating point cannot
determine on which side of a strand a point lies, the plan is shifted several ways, by less than any
physical length, and the code is valid only if all results agree.
"""

import re
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from swarm.errors import InputError, Problem, shown
from swarm.knots.gauss import KnotError, SignedGauss, same_code
from swarm.tables import Table

Points = NDArray[np.float64]

NUDGE = 1e-9
"""Largest shift of a point in a degenerate plan view, as a share of the curve's extent."""

REPEATED = 1e-12
"""Consecutive points closer than this share of the curve's extent are one point."""

_SHIFTS = 2
_TIE = 1e-11
"""The order of crossings closer than this share of a segment is undetermined."""

_AT_ONCE = 2_000_000
"""Pairs of segments per batch: bounds the memory for a long curve."""

_ROUNDING = 4e-16
"""Shewchuk's bound for the orientation test, 3.33e-16, rounded up."""

LARGEST_EXTENT = 1e100
SMALLEST_EXTENT = 1e-100
"""Extents of a curve between which products neither overflow nor underflow."""

_INDEX = re.compile(r"[0-9]{1,9}")


@dataclass(frozen=True)
class _View:
    """The plan view of a curve: its corners in plan, and the heights of its segments' ends.

    Corners are (n, 2), the heights (n,): segment k runs from corner k to k + 1 and from ``start``
    to ``end``. Vertical segments are omitted, so ``end`` of one and ``start`` of the next may
    differ.
    ``tilt`` is the lean of the view, plan length per height.
    """

    corners: Points
    start: Points
    end: Points
    closed: bool
    tilt: tuple[float, float]
    extent: float


def curve_gauss(
    points: Points, *, closed: bool = False, tilt: tuple[float, float] = (0.0, 0.0)
) -> SignedGauss:
    """Return the signed Gauss code of a curve's plan view, seen from above.

    ``points`` is (n, 3); consecutive points are joined by straight lines, and the last to the first
    if ``closed``. With a ``tilt`` the view leans: plan = (x, y) + tilt · z. Degenerate views (a
    vertex on another strand, repeated points, vertical segments) are read as the view of any curve
    within ``NUDGE`` × extent of it.

    Raises KnotError where those differ (strands on top of each other over a length, a strand that
    only touches another, three strands through one point), and where two strands meet in space.
    """
    curve = validated_curve(points, closed=closed)
    view = _view(curve, closed, tilt)
    if len(view.corners) < 3:
        return SignedGauss((), closed)
    pairs = overlapping_segments(view.corners, closed=closed, margin=2 * NUDGE * view.extent)
    code = _code(view, pairs)
    if code is not None:
        return code
    rng = np.random.default_rng(1)
    reach = NUDGE * view.extent
    shifts = [rng.uniform(-reach, reach, view.corners.shape) for _ in range(_SHIFTS)]
    codes = [
        _code(replace(view, corners=view.corners + way * shift), pairs)
        for shift in shifts
        for way in (1.0, -1.0)
    ]
    first = codes[0]
    if first is None or any(c is None or not same_code(first, c) for c in codes):
        raise KnotError(
            "the plan view is degenerate: strands lie on top of each other, touch without "
            "crossing, or three of them cross at one point"
        )
    return first


def _view(curve: Points, closed: bool, tilt: tuple[float, float]) -> _View:
    plan = curve[:, :2] + np.array(tilt) * curve[:, 2:]
    extent = float(np.max(np.ptp(np.hstack([plan, curve]), axis=0)))
    moved = np.max(np.abs(plan - np.roll(plan, 1, axis=0)), axis=1) > REPEATED * extent
    if closed and moved.any():
        # Start at a corner, not inside a vertical line.
        first = int(np.argmax(moved))
        plan, curve = np.roll(plan, -first, axis=0), np.roll(curve, -first, axis=0)
        moved = np.roll(moved, -first)
    moved[0] = True
    begins = np.flatnonzero(moved)
    lasts = np.append(begins[1:], len(plan)) - 1
    heights = curve[:, 2]
    return _View(plan[begins], heights[lasts], np.roll(heights[begins], -1), closed, tilt, extent)


def validated_curve(points: Points, *, closed: bool) -> Points:
    """Return the curve without repeated points. Raises KnotError for an invalid shape or value."""
    curve: Points = np.asarray(points, dtype=np.float64)
    if curve.ndim != 2 or curve.shape[1] != 3:
        raise KnotError(f"a curve is an (n, 3) array, got shape {curve.shape}")
    if len(curve) < 2:
        raise KnotError(f"a curve needs at least 2 points, got {len(curve)}")
    if not np.all(np.isfinite(curve)):
        row = int(np.flatnonzero(~np.isfinite(curve).all(axis=1))[0])
        raise KnotError(f"point {row + 1} of the curve is not finite")
    with np.errstate(over="ignore"):
        return curve[_distinct(curve, REPEATED * float(np.max(np.ptp(curve, axis=0))), closed)]


def _distinct(points: Points, same: float, closed: bool) -> NDArray[np.int64]:
    """Return the indices of the points that are farther than ``same`` from the point before."""
    steps = np.max(np.abs(np.diff(points, axis=0)), axis=1)
    indices = np.flatnonzero(np.concatenate([[True], steps > same])[: len(points)])
    ends = points[indices[[0, -1]]]
    if closed and len(indices) > 1 and np.max(np.abs(ends[1] - ends[0])) <= same:
        return indices[:-1]
    return indices


def overlapping_segments(corners: Points, *, closed: bool, margin: float) -> NDArray[np.int64]:
    """Return pairs (k, 2) of non-neighbouring segments of corners (n, d) whose boxes overlap.

    Each box is larger than its segment by ``margin`` on every side.
    """
    start = corners
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
    first_block, second_block = np.nonzero(np.triu(meets))
    offset = np.arange(block)
    pairs = [np.zeros((0, 2), dtype=np.int64)]
    step = max(1, _AT_ONCE // block**2)
    for begin in range(0, len(first_block), step):
        blocks = slice(begin, begin + step)
        first = first_block[blocks, None, None] * block + offset[None, :, None]
        second = second_block[blocks, None, None] * block + offset[None, None, :]
        first, second = (part.ravel() for part in np.broadcast_arrays(first, second))
        valid = (first + 1 < second) & (second < count)
        if closed:
            valid &= ~((first == 0) & (second == count - 1))
        first, second = first[valid], second[valid]
        overlap = np.all((low[first] <= high[second]) & (low[second] <= high[first]), axis=1)
        pairs.append(np.stack([first[overlap], second[overlap]], axis=1))
    return np.concatenate(pairs)


def _sides(a: Points, b: Points, c: Points) -> tuple[Points, NDArray[np.bool_]]:
    """Return twice the signed area of each plan triangle, and whether its sign is certain."""
    left = (a[:, 0] - c[:, 0]) * (b[:, 1] - c[:, 1])
    right = (a[:, 1] - c[:, 1]) * (b[:, 0] - c[:, 0])
    area = left - right
    return area, np.abs(area) > _ROUNDING * (np.abs(left) + np.abs(right))


def _code(view: _View, pairs: NDArray[np.int64]) -> SignedGauss | None:
    """Return the code, or None where floating point cannot determine it."""
    after = np.roll(view.corners, -1, axis=0)
    a, b = view.corners[pairs[:, 0]], after[pairs[:, 0]]
    c, d = view.corners[pairs[:, 1]], after[pairs[:, 1]]
    (abc, sure_c), (abd, sure_d) = _sides(a, b, c), _sides(a, b, d)
    (cda, sure_a), (cdb, sure_b) = _sides(c, d, a), _sides(c, d, b)
    apart = (sure_c & sure_d & (abc * abd > 0)) | (sure_a & sure_b & (cda * cdb > 0))
    if not np.all(apart | (sure_a & sure_b & sure_c & sure_d)):
        return None
    cross = ~apart
    first, second = pairs[cross].T
    along_first = cda[cross] / (cda[cross] - cdb[cross])
    along_second = abc[cross] / (abc[cross] - abd[cross])
    height = (1 - along_first) * view.start[first] + along_first * view.end[first]
    gap = height - ((1 - along_second) * view.start[second] + along_second * view.end[second])
    meeting = np.flatnonzero(np.abs(gap) <= NUDGE * view.extent)
    if len(meeting):
        at = meeting[0]
        plan = a[cross][at] + along_first[at] * (b[cross][at] - a[cross][at])
        x, y = plan - np.array(view.tilt) * height[at]
        raise KnotError(f"two strands meet in space at ({x:.6g}, {y:.6g}, {height[at]:.6g})")
    # The first strand's direction × the second's points up where d lies to its left.
    turn = np.where(abd[cross] > 0, 1, -1)
    sign = np.where(gap > 0, turn, -turn)
    number = np.arange(1, len(first) + 1)
    segment = np.concatenate([first, second])
    along = np.concatenate([along_first, along_second])
    order = np.lexsort((along, segment))
    if np.any((np.diff(segment[order]) == 0) & (np.diff(along[order]) < _TIE)):
        return None
    label = np.concatenate([number, number])[order]
    over = np.concatenate([gap > 0, gap < 0])[order]
    signs = np.concatenate([sign, sign])[order]
    return SignedGauss.of(
        zip(label.tolist(), over.tolist(), signs.tolist(), strict=True), closed=view.closed
    )


class CurveDefect(KnotError):  # noqa: N818 - names the state of the curve
    """A curve has no knot: it has too few points, or its strands meet.

    ``points`` are the indices of the points at which, and ``message`` says why.
    """

    def __init__(self, points: tuple[int, ...], message: str) -> None:
        self.points, self.message = points, message
        numbers = " and ".join(str(index + 1) for index in points)
        where = f" (point{'s' * (len(points) > 1)} {numbers})" if numbers else ""
        super().__init__(message + where)


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
    distinct = _distinct(points, REPEATED * extent, closed)
    if len(distinct) < 3:
        return CurveDefect((), f"expected at least 3 different points, got {len(distinct)}")
    # Scaled to 0…1, so that no product overflows or underflows.
    curve = (points[distinct] - points[distinct].min(axis=0)) / extent
    return _backward_step(curve, distinct, closed) or _meeting_segments(curve, distinct, closed)


def _backward_step(curve: Points, distinct: NDArray[np.int64], closed: bool) -> CurveDefect | None:
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
    return CurveDefect((int(distinct[at[0]]),), "the curve goes back along itself from here")


def _meeting_segments(
    curve: Points, distinct: NDArray[np.int64], closed: bool
) -> CurveDefect | None:
    """Return the first two segments that meet and are not neighbours."""
    start, end = curve, np.roll(curve, -1, axis=0)
    pairs = overlapping_segments(curve, closed=closed, margin=REPEATED)
    first, second = pairs.T
    gap = _distances(start[first], end[first], start[second], end[second])
    at = np.flatnonzero(gap <= REPEATED)
    if not len(at):
        return None
    earlier, later = sorted(int(distinct[index]) for index in pairs[at[0]])
    return CurveDefect((earlier, later), "the segments of the curve that begin here meet")


def _distances(a: Points, b: Points, c: Points, d: Points) -> NDArray[np.float64]:
    """Return distances (n,) between segments a–b and c–d, each (n, 3), none of length 0.

    After Ericson, Real-Time Collision Detection, 2005, 5.1.9.
    """
    first, second, between = b - a, d - c, a - c
    own, other, shared = _dot(first, first), _dot(second, second), _dot(first, second)
    on_first, on_second = _dot(first, between), _dot(second, between)
    area = own * other - shared**2
    with np.errstate(divide="ignore", invalid="ignore"):
        s = np.where(area > 0.0, (shared * on_second - on_first * other) / area, 0.0)
    s = np.clip(s, 0.0, 1.0)  # where they are parallel, any s is valid
    t = np.clip((shared * s + on_second) / other, 0.0, 1.0)
    s = np.clip((shared * t - on_first) / own, 0.0, 1.0)
    apart = between + s[:, None] * first - t[:, None] * second
    return np.sqrt(_dot(apart, apart))


def _dot(a: Points, b: Points) -> NDArray[np.float64]:
    product: NDArray[np.float64] = np.sum(a * b, axis=1)
    return product


def parse_curve(text: str, source: str) -> tuple[Points, list[int]]:
    """Return points (n, 3) and their line numbers.

    A row has three numbers, or an index that counts by one before them, or a heading names the
    columns x, y and z. Commas, semicolons, tabs or spaces separate; lines that begin with # are
    comments. Raises :class:`InputError` with each wrong line (at most MOST_PROBLEMS).
    """
    table = Table(text, source, spaces=True)
    indexed, start = not table.heading and table.columns == 4, 1
    if table.heading:
        columns = table.find({"x": "m", "y": "m", "z": "m"})
    elif table.columns in {0, 3, 4}:
        columns = (1, 2, 3) if indexed else (0, 1, 2)
    else:
        message = "expected three numbers, an index and three numbers, or a heading with x, y and "
        message += f"z, got {table.columns} entries"
        if table.columns == 1:
            message += "; the .xyz of a molecule has no curve"
        raise InputError([Problem(f"{source}: line {table.heading_line}", message)])
    rows: list[list[float]] = []
    lines: list[int] = []
    for line, cells in table:
        rows.append([table.number(line, cells, column) for column in columns])
        lines.append(line)
        if indexed:
            start = start if len(rows) > 1 else int(cells[0]) if _INDEX.fullmatch(cells[0]) else 1
            if cells[0] != str(start + len(rows) - 1):
                message = (
                    f"expected the index {start + len(rows) - 1}, since there are four columns "
                )
                message += f"without a heading, got {shown(cells[0])}"
                raise InputError([*table.problems, Problem(table.place(line, 0), message)])
    if len(rows) < 3 and not table.problems:
        table.add(Problem(source, f"expected at least 3 points, got {len(rows)}"))
    table.finish()
    return np.array(rows), lines
