"""Knots as open polygons with few straight edges, in space.

A polygon keeps its knot while a vertex moves if no other edge pierces the two triangles that its
own edges sweep; a vertex can be left out if no edge pierces the triangle that it spans with its
neighbours. Random moves of this kind reduce a polygon to few edges, and then shape it. The ends go
on straight up, as :func:`swarm.knots.invariants.close_upward` closes them.
"""

import numpy as np
import numpy.typing as npt

from swarm.jit import compiled, inner
from swarm.knots.grid import OpenGrid
from swarm.signatures import Floats2

Points = npt.NDArray[np.float64]

_FAR = 1e3
"""Height at which the two ends end, in cells: far above all others."""

_NO_VOLUME = 1e-30
"""Volume of an edge with a triangle, cells cubed, below which they are parallel: edges of 1e-9
cells have larger ones."""

_TOUCHING = 1e-9
"""Share of an edge or triangle by which it counts as longer: a touch is a crossing."""

_REMOVALS, _STRAIGHTENINGS = 0.3, 0.35
"""Shares of the steps that try to leave a vertex out, and of the others that move a vertex toward
its neighbours."""

_FLAT = 0.6
"""Largest height over the largest extent in plan view."""

_JITTER = 0.03
"""Standard deviation in cells of the first displacement: a grid has parallel edges."""

_STEPS, _CHUNK = 600_000, 10_000
"""Steps of the reduction; knots to eight crossings take a tenth of it. Random numbers are drawn for
a chunk of steps at a time."""

_SHAPING, _HEAT = 60_000, 2.0
"""Steps of the shaping, and its first temperature in units of the cost."""

_STRANDS, _VERTICES = 0.12, 0.2
"""Distances of strands (in space, and of vertices in plan view), and of two vertices in plan view,
in mean edges, at which they cost 1."""

_EVEN, _SHORT = 0.5, 0.1
"""Costs of an edge that is longer or shorter by a mean edge, and of one of a mean length."""

_LEAST_SQUARE = 1e-9
"""Least squared distance, cells squared, so that no cost is infinite."""

_DIRECTIONS = 16
"""Directions in which an end is led outward in plan view."""


def reduced_polygon(opened: OpenGrid, vertices: int, rng: np.random.Generator) -> Points | None:
    """Return an open polygon (m, 3) of a knot with at most so many vertices; None if not found.

    Its ends are outside in plan view, so that they are closed without a crossing, and its edges are
    of similar length and far from each other. The unit is a cell of the grid. Another ``rng`` gives
    another polygon.
    """
    size = 0.75 * opened.grid.size
    rows = _with_ends(_vertices(opened, rng))
    count = len(rows) - 2
    for _ in range(_STEPS // _CHUNK):
        count = _reduce(rows, count, vertices, *_drawn(_CHUNK, rng), size)
        if count - 2 <= vertices:
            rows = np.concatenate([rows[:count], rows[-2:]])
            best = rows.copy()
            _shape(rows, best, *_drawn(_SHAPING, rng), size)
            return np.ascontiguousarray(best[1 : count - 1])
    return None


def fewest_edges(crossings: int) -> int:
    """Return the least number of straight edges in plan view of a knot with so many crossings.

    Both ends are outside in plan view. k edges have at most (k − 1)(k − 2)/2 crossings, because
    neighbours do not cross, and closing the curve outside adds none.
    """
    edges = 1
    while (edges - 1) * (edges - 2) // 2 < crossings:
        edges += 1
    return edges


def _vertices(opened: OpenGrid, rng: np.random.Generator) -> Points:
    """Return the polygon (m, 3) of a grid diagram, with its columns above its rows."""
    corners = np.array(opened.corners, dtype=np.float64)
    level = np.where(np.diff(corners[:, 0]) == 0.0, 1.0, -1.0)
    levels = np.concatenate([level[:1], level, level[-1:]])
    points = [
        [*corner, height]
        for k, corner in enumerate(corners)
        for height in sorted({levels[k], levels[k + 1]}, key=lambda z: z != levels[k])
    ]
    polygon = np.array(points) - [*corners.mean(axis=0), 0.0]
    displaced: Points = polygon + rng.normal(scale=_JITTER, size=polygon.shape)
    return displaced


def _with_ends(polygon: Points) -> Points:
    """Return the rows that the moves below take: a polygon with its far ends, and two places.

    The last two rows are the place to which a vertex is to move, and the same far above.
    """
    up = np.array([0.0, 0.0, _FAR])
    places = np.zeros((2, 3))
    return np.concatenate([polygon[:1] + up, polygon, polygon[-1:] + up, places])


def _drawn(steps: int, rng: np.random.Generator) -> tuple[Points, Points]:
    """Return uniform (steps, 5) and normal (steps, 3) random numbers."""
    return rng.random((steps, 5)), rng.normal(size=(steps, 3))


@compiled
def _reduce(
    p: Floats2, count: int, vertices: int, uniform: Floats2, normal: Floats2, size: float
) -> int:
    """Reduce a polygon of ``count`` rows in place until it has so many vertices or steps end.

    Returns how many rows it has then.
    """
    place = len(p) - 2
    for step in range(len(uniform)):
        if count - 2 <= vertices:
            break
        i = 1 + int((count - 2) * uniform[step, 0])
        if uniform[step, 1] < _REMOVALS:
            count -= _leave_out(p, count, i)
            continue
        share, part = uniform[step, 3], uniform[step, 4]
        if uniform[step, 2] < _STRAIGHTENINGS and 1 < i < count - 2:
            for x in range(3):
                middle = share * p[i - 1, x] + (1.0 - share) * p[i + 1, x]
                p[place, x] = p[i, x] + part * (middle - p[i, x])
        else:
            distance = size * 10.0 ** (-2.0 * share)
            for x in range(3):
                p[place, x] = p[i, x] + distance * normal[step, x]
        wide = max(abs(p[place, 0]), abs(p[place, 1]), abs(p[place, 2]) / _FLAT)
        if wide <= size and _can_move(p, count, i):
            _move_inside(p, count, i)
    return count


@compiled
def _shape(p: Floats2, best: Floats2, uniform: Floats2, normal: Floats2, size: float) -> None:
    """Write the polygon of least cost that simulated annealing finds to ``best``."""
    steps, count, place = len(uniform), len(p) - 2, len(p) - 2
    cost = least = _cost(p, count)
    for step in range(steps):
        heat = _HEAT * (1.0 - step / steps)
        i = 1 + int((count - 2) * uniform[step, 0])
        distance = size * 10.0 ** (-2.5 * uniform[step, 1])
        for x in range(3):
            p[place, x] = p[i, x] + distance * normal[step, x]
        _swap(p, i, place)
        changed = _cost(p, count)
        _swap(p, i, place)
        rise = changed - cost
        if rise > 0.0 and uniform[step, 2] > np.exp(-rise / max(heat, 1e-9)):
            continue
        if _can_move(p, count, i) and _move_inside(p, count, i):
            cost = changed
            if cost < least:
                least = cost
                for k in range(count):
                    _copy(best, k, p, k)


@inner
def _copy(to: Points, i: int, p: Points, j: int) -> None:
    """Copy row j of p to row i."""
    for x in range(3):
        to[i, x] = p[j, x]


@inner
def _swap(p: Points, i: int, j: int) -> None:
    """Exchange two rows."""
    for x in range(3):
        p[i, x], p[j, x] = p[j, x], p[i, x]


@inner
def _raise_ends(p: Points, count: int) -> None:
    """Put the far ends straight above the first and the last vertex."""
    _copy(p, 0, p, 1)
    _copy(p, count - 1, p, count - 2)
    p[0, 2] += _FAR
    p[count - 1, 2] += _FAR


@inner
def _move_inside(p: Points, count: int, i: int) -> bool:
    """Move vertex i to the place unless that encloses an end in plan view; return whether it
    moved."""
    place = len(p) - 2
    _swap(p, i, place)
    if not _ends_are_outside(p, count):
        _swap(p, i, place)
        return False
    _raise_ends(p, count)
    return True


@inner
def _leave_out(p: Points, count: int, i: int) -> int:
    """Leave vertex i out unless that changes the knot or encloses an end; return how many left."""
    if not _can_leave_out(p, count, i):
        return 0
    place = len(p) - 2
    _copy(p, place, p, i)
    for k in range(i, count - 1):
        _copy(p, k, p, k + 1)
    _raise_ends(p, count - 1)
    if _ends_are_outside(p, count - 1):
        return 1
    for k in range(count - 1, i, -1):
        _copy(p, k, p, k - 1)
    _copy(p, i, p, place)
    _raise_ends(p, count)
    return 0


@inner
def _can_move(p: Points, count: int, i: int) -> bool:
    """Return whether vertex i can move straight to the place without passing through an edge."""
    place = len(p) - 2
    if 1 < i < count - 2:
        return _is_clear(p, count, (i - 1, i, place), i - 2, i + 1) and _is_clear(
            p, count, (i, place, i + 1), i - 1, i + 2
        )
    beside, end = (2, 0) if i == 1 else (count - 3, count - 1)
    first, last = (0, 3) if i == 1 else (count - 4, count - 1)
    own = (0, 2) if i == 1 else (count - 3, count - 1)
    far = _far_above(p, place)
    return (
        _is_clear(p, count, (i, place, beside), first, last)
        and _is_clear(p, count, (i, place, far), own[0], own[1])
        and _is_clear(p, count, (i, far, end), own[0], own[1])
    )


@inner
def _far_above(p: Points, i: int) -> int:
    """Return the last row, and write the place far above row i to it."""
    far = len(p) - 1
    _copy(p, far, p, i)
    p[far, 2] += _FAR
    return far


@inner
def _can_leave_out(p: Points, count: int, i: int) -> bool:
    """Return whether vertex i can be left out without passing through an edge."""
    if 1 < i < count - 2:
        return _is_clear(p, count, (i - 1, i, i + 1), i - 2, i + 2)
    beside, end = (2, 0) if i == 1 else (count - 3, count - 1)
    first = 0 if i == 1 else count - 4
    far = _far_above(p, beside)
    return _is_clear(p, count, (i, end, far), first, first + 3) and _is_clear(
        p, count, (i, far, beside), first, first + 3
    )


@inner
def _is_clear(p: Points, count: int, triangle: tuple[int, int, int], first: int, last: int) -> bool:
    """Return whether no edge but ``first`` … ``last`` − 1 pierces the triangle of three rows."""
    for j in range(count - 1):
        other = j < first or j >= last
        if other and _pierces(p, j, triangle):
            return False
    return True


@inner
def _pierces(p: Points, j: int, triangle: tuple[int, int, int]) -> bool:
    """Return whether edge j meets the triangle of three rows (Möller and Trumbore 1997)."""
    o, q, r = triangle
    a0, a1, a2 = p[j + 1, 0] - p[j, 0], p[j + 1, 1] - p[j, 1], p[j + 1, 2] - p[j, 2]
    v0, v1, v2 = p[r, 0] - p[o, 0], p[r, 1] - p[o, 1], p[r, 2] - p[o, 2]
    u0, u1, u2 = p[q, 0] - p[o, 0], p[q, 1] - p[o, 1], p[q, 2] - p[o, 2]
    h0, h1, h2 = a1 * v2 - a2 * v1, a2 * v0 - a0 * v2, a0 * v1 - a1 * v0
    volume = u0 * h0 + u1 * h1 + u2 * h2
    if abs(volume) < _NO_VOLUME:
        return False
    s0, s1, s2 = p[j, 0] - p[o, 0], p[j, 1] - p[o, 1], p[j, 2] - p[o, 2]
    first = (s0 * h0 + s1 * h1 + s2 * h2) / volume
    if not -_TOUCHING <= first <= 1.0 + _TOUCHING:
        return False
    g0, g1, g2 = s1 * u2 - s2 * u1, s2 * u0 - s0 * u2, s0 * u1 - s1 * u0
    second = (a0 * g0 + a1 * g1 + a2 * g2) / volume
    if second < -_TOUCHING or first + second > 1.0 + _TOUCHING:
        return False
    place = (v0 * g0 + v1 * g1 + v2 * g2) / volume
    return bool(-_TOUCHING <= place <= 1.0 + _TOUCHING)


@inner
def _cost(p: Points, rows: int) -> float:
    """Return how uneven and how close to itself a polygon with the far ends is; scale-free."""
    count = rows - 2
    mean = 0.0
    for i in range(1, count):
        x, y, z = p[i + 1, 0] - p[i, 0], p[i + 1, 1] - p[i, 1], p[i + 1, 2] - p[i, 2]
        mean += np.sqrt(x * x + y * y + 4.0 * z * z) / count
    strands, vertices = (_STRANDS * mean) ** 2, (_VERTICES * mean) ** 2
    cost = 0.0
    for i in range(1, count + 1):
        for j in range(1, count):
            if i < j - 1 and i < count:
                cost += strands / _square_distance(p, i, i + 1, j, 3)
            if j not in (i - 1, i):
                cost += strands / _square_distance(p, i, i, j, 2)
        for j in range(i + 1, count + 1):
            x, y = p[i, 0] - p[j, 0], p[i, 1] - p[j, 1]
            cost += vertices / max(x * x + y * y, _LEAST_SQUARE)
    for i in range(1, count):
        size = np.sqrt((p[i + 1, 0] - p[i, 0]) ** 2 + (p[i + 1, 1] - p[i, 1]) ** 2)
        cost += _EVEN * (size / mean - 1.0) ** 2 + _SHORT * (mean / max(size, 1e-6)) ** 2
    return float(cost)


@inner
def _square_distance(p: Points, i: int, j: int, k: int, axes: int) -> float:
    """Return the squared distance of the segment of rows i and j from edge k in the first axes."""
    uu = uv = vv = uw = vw = ww = 0.0
    for x in range(axes):
        u, v, w = p[j, x] - p[i, x], p[k + 1, x] - p[k, x], p[i, x] - p[k, x]
        uu, uv, vv = uu + u * u, uv + u * v, vv + v * v
        uw, vw, ww = uw + u * w, vw + v * w, ww + w * w
    area, least = uu * vv - uv * uv, np.inf
    for case in range(5):
        if case == 0:
            s = (uv * vw - vv * uw) / area if area > 1e-12 else -1.0
            t = (uu * vw - uv * uw) / area if area > 1e-12 else -1.0
            if not (0.0 <= s <= 1.0 and 0.0 <= t <= 1.0):
                continue
        elif case < 3:
            s = case - 1.0
            t = min(max((vw + s * uv) / max(vv, 1e-12), 0.0), 1.0)
        else:
            t = case - 3.0
            s = min(max((t * uv - uw) / max(uu, 1e-12), 0.0), 1.0)
        square = ww + s * s * uu + t * t * vv + 2.0 * (s * uw - t * vw - s * t * uv)
        least = min(least, square)
    return float(max(least, _LEAST_SQUARE))


@inner
def _ends_are_outside(p: Points, count: int) -> bool:
    """Return whether a straight way outward from each end crosses no edge in plan view."""
    return _is_outside(p, count, 1) and _is_outside(p, count, count - 2)


@inner
def _is_outside(p: Points, count: int, end: int) -> bool:
    """Return whether one of some straight ways outward from an end crosses no edge."""
    for k in range(_DIRECTIONS):
        angle = 2.0 * np.pi * (k + 0.3) / _DIRECTIONS
        x, y, crossed = np.cos(angle), np.sin(angle), False
        for j in range(1, count - 2):
            if end in (j, j + 1):
                continue
            a0, a1 = p[j, 0] - p[end, 0], p[j, 1] - p[end, 1]
            b0, b1 = p[j + 1, 0] - p[end, 0], p[j + 1, 1] - p[end, 1]
            beside, other = x * a1 - y * a0, x * b1 - y * b0
            if beside * other < 0.0:
                share = beside / (beside - other)
                ahead = (1.0 - share) * (x * a0 + y * a1) + share * (x * b0 + y * b1)
                crossed = crossed or ahead > 0.0
        if not crossed:
            return True
    return False
