"""Knots as open polygons with few straight edges, in space.

A polygon keeps its knot while a vertex moves if no other edge pierces the two triangles that its
own edges sweep; a vertex can be left out if no edge pierces the triangle that it spans with its
neighbours. Random moves of this kind reduce a polygon to few edges, and then shape it. The ends go
on straight up, as :func:`swarm.knots.curve_diagram.close_upward` closes them.
"""

import numpy as np
import numpy.typing as npt

from swarm.jit import compiled
from swarm.knots.grid import OpenGrid

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

_STEPS = 600_000
"""Steps of the reduction; knots to eight crossings take a tenth of it."""

_SHAPING, _HEAT = 60_000, 2.0
"""Steps of the shaping, and its first temperature in units of the cost."""

_STRANDS, _VERTICES = 0.12, 0.2
"""Distances of strands (in space, and of vertices in plan view), and of two vertices in plan view,
in mean edges, at which they cost 1."""

_EVEN, _SHORT = 0.5, 0.1
"""Costs of an edge that is longer or shorter by a mean edge, and of one of a mean length."""

_DIRECTIONS = 16
"""Directions in which an end is led outward in plan view."""


def reduced_polygon(opened: OpenGrid, vertices: int, rng: np.random.Generator) -> Points | None:
    """Return an open polygon (m, 3) of a knot with at most so many vertices; None if not found.

    Its ends are outside in plan view, so that they are closed without a crossing, and its edges are
    of similar length and far from each other. The unit is a cell of the grid. Another ``rng`` gives
    another polygon.
    """
    size = 0.75 * opened.grid.size
    reduced = _reduce(_with_ends(_vertices(opened, rng)), vertices, _STEPS, rng, size)
    if len(reduced) - 2 > vertices:
        return None
    return np.ascontiguousarray(_shape(reduced, _SHAPING, rng, size)[1:-1])


def fewest_edges(crossings: int) -> int:
    """Return the least number of straight edges in plan view of a knot with so many crossings.

    k edges have at most (k − 1)(k − 2)/2 crossings, because neighbours do not cross; ends that are
    outside in plan view are closed without another one.
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
    up = np.array([0.0, 0.0, _FAR])
    return np.concatenate([polygon[:1] + up, polygon, polygon[-1:] + up])


@compiled
def _reduce(
    polygon: Points, vertices: int, steps: int, rng: np.random.Generator, size: float
) -> Points:
    """Return a polygon with the far ends, reduced until it has so many vertices or steps end."""
    p, count = polygon.copy(), len(polygon)
    for _ in range(steps):
        if count - 2 <= vertices:
            break
        i = int(rng.integers(1, count - 1))
        if rng.random() < _REMOVALS:
            if _can_leave_out(p[:count], i):
                left = p[: count - 1].copy()
                left[i:] = p[i + 1 : count]
                _raise_ends(left)
                if _ends_are_outside(left):
                    count -= 1
                    p[:count] = left
            continue
        moved = np.empty(3)
        if rng.random() < _STRAIGHTENINGS and 1 < i < count - 2:
            share, part = rng.random(), rng.random()
            for x in range(3):
                middle = share * p[i - 1, x] + (1.0 - share) * p[i + 1, x]
                moved[x] = p[i, x] + part * (middle - p[i, x])
        else:
            _draw_near(p[i], size * 10.0 ** (-2.0 * rng.random()), rng, moved)
        inside = max(abs(moved[0]), abs(moved[1]), abs(moved[2]) / _FLAT) <= size
        if inside and _can_move(p[:count], i, moved):
            _move_inside(p[:count], i, moved)
    return p[:count].copy()


@compiled
def _shape(polygon: Points, steps: int, rng: np.random.Generator, size: float) -> Points:
    """Return the polygon of least cost that simulated annealing finds."""
    p = polygon.copy()
    cost, best, least = _cost(p), p.copy(), _cost(p)
    for step in range(steps):
        heat = _HEAT * (1.0 - step / steps)
        i = int(rng.integers(1, len(p) - 1))
        before, moved = p[i].copy(), np.empty(3)
        _draw_near(before, size * 10.0 ** (-2.5 * rng.random()), rng, moved)
        p[i] = moved
        changed = _cost(p)
        p[i] = before
        rise = changed - cost
        if rise > 0.0 and rng.random() > np.exp(-rise / max(heat, 1e-9)):
            continue
        if _can_move(p, i, moved) and _move_inside(p, i, moved):
            cost = changed
            if cost < least:
                best, least = p.copy(), cost
    return best


@compiled
def _draw_near(place: Points, distance: float, rng: np.random.Generator, found: Points) -> None:
    """Write a random place (3,) at about a distance."""
    for x in range(3):
        found[x] = place[x] + distance * rng.normal()


@compiled
def _raise_ends(p: Points) -> None:
    """Put the far ends straight above the first and the last vertex."""
    p[0] = p[1]
    p[-1] = p[-2]
    p[0, 2] += _FAR
    p[-1, 2] += _FAR


@compiled
def _move_inside(p: Points, i: int, moved: Points) -> bool:
    """Move vertex i unless that encloses an end in plan view; return whether it moved."""
    before = p[i].copy()
    p[i] = moved
    if not _ends_are_outside(p):
        p[i] = before
        return False
    _raise_ends(p)
    return True


@compiled
def _can_move(p: Points, i: int, moved: Points) -> bool:
    """Return whether vertex i can move straight to a place without passing through an edge."""
    far, count = moved.copy(), len(p)
    far[2] += _FAR
    if i == 1:
        return (
            _is_clear(p, (p[1], moved, p[2]), 0, 3)
            and _is_clear(p, (p[1], moved, far), 0, 2)
            and _is_clear(p, (p[1], far, p[0]), 0, 2)
        )
    if i == count - 2:
        return (
            _is_clear(p, (p[i], moved, p[i - 1]), count - 4, count - 1)
            and _is_clear(p, (p[i], moved, far), count - 3, count - 1)
            and _is_clear(p, (p[i], far, p[i + 1]), count - 3, count - 1)
        )
    return _is_clear(p, (p[i - 1], p[i], moved), i - 2, i + 1) and _is_clear(
        p, (p[i], moved, p[i + 1]), i - 1, i + 2
    )


@compiled
def _can_leave_out(p: Points, i: int) -> bool:
    """Return whether vertex i can be left out without passing through an edge."""
    count = len(p)
    if 1 < i < count - 2:
        return _is_clear(p, (p[i - 1], p[i], p[i + 1]), i - 2, i + 2)
    beside, end = (2, 0) if i == 1 else (count - 3, count - 1)
    first = 0 if i == 1 else count - 4
    far = p[beside].copy()
    far[2] += _FAR
    return _is_clear(p, (p[i], p[end], far), first, first + 3) and _is_clear(
        p, (p[i], far, p[beside]), first, first + 3
    )


@compiled
def _is_clear(p: Points, triangle: tuple[Points, Points, Points], first: int, last: int) -> bool:
    """Return whether no edge but ``first`` … ``last`` − 1 pierces a triangle."""
    for j in range(len(p) - 1):
        if not first <= j < last and _pierces(p[j], p[j + 1], triangle):
            return False
    return True


@compiled
def _pierces(a: Points, b: Points, triangle: tuple[Points, Points, Points]) -> bool:
    """Return whether edge ab meets a triangle (Möller and Trumbore 1997)."""
    p, q, r = triangle
    u, v, along, s = q - p, r - p, b - a, a - p
    h0 = along[1] * v[2] - along[2] * v[1]
    h1 = along[2] * v[0] - along[0] * v[2]
    h2 = along[0] * v[1] - along[1] * v[0]
    volume = u[0] * h0 + u[1] * h1 + u[2] * h2
    if abs(volume) < _NO_VOLUME:
        return False
    first = (s[0] * h0 + s[1] * h1 + s[2] * h2) / volume
    if not -_TOUCHING <= first <= 1.0 + _TOUCHING:
        return False
    g0 = s[1] * u[2] - s[2] * u[1]
    g1 = s[2] * u[0] - s[0] * u[2]
    g2 = s[0] * u[1] - s[1] * u[0]
    second = (along[0] * g0 + along[1] * g1 + along[2] * g2) / volume
    if second < -_TOUCHING or first + second > 1.0 + _TOUCHING:
        return False
    place = (v[0] * g0 + v[1] * g1 + v[2] * g2) / volume
    return bool(-_TOUCHING <= place <= 1.0 + _TOUCHING)


@compiled
def _cost(p: Points) -> float:
    """Return how uneven and how close to itself a polygon with the far ends is; scale-free."""
    count = len(p) - 2
    mean = 0.0
    for i in range(1, count):
        x, y, z = p[i + 1] - p[i]
        mean += np.sqrt(x * x + y * y + 4.0 * z * z) / count
    strands, vertices = (_STRANDS * mean) ** 2, (_VERTICES * mean) ** 2
    cost = 0.0
    for i in range(1, count + 1):
        for j in range(1, count):
            if i < j - 1 and i < count:
                cost += strands / _square_distance(p[i], p[i + 1], p[j], p[j + 1], 3)
            if j not in (i - 1, i):
                cost += strands / _square_distance(p[i], p[i], p[j], p[j + 1], 2)
        for j in range(i + 1, count + 1):
            cost += vertices / _square_distance(p[i], p[i], p[j], p[j], 2)
    for i in range(1, count):
        size = np.sqrt((p[i + 1, 0] - p[i, 0]) ** 2 + (p[i + 1, 1] - p[i, 1]) ** 2)
        cost += _EVEN * (size / mean - 1.0) ** 2 + _SHORT * (mean / max(size, 1e-6)) ** 2
    return float(cost)


@compiled
def _square_distance(a: Points, b: Points, c: Points, d: Points, axes: int) -> float:
    """Return the squared distance of segments ab and cd in the first axes; at least 1e-9."""
    uu = uv = vv = uw = vw = ww = 0.0
    for x in range(axes):
        u, v, w = b[x] - a[x], d[x] - c[x], a[x] - c[x]
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
    return float(max(least, 1e-9))


@compiled
def _ends_are_outside(p: Points) -> bool:
    """Return whether a straight way outward from each end crosses no edge in plan view."""
    return _is_outside(p, 1) and _is_outside(p, len(p) - 2)


@compiled
def _is_outside(p: Points, end: int) -> bool:
    """Return whether one of some straight ways outward from an end crosses no edge."""
    for k in range(_DIRECTIONS):
        angle = 2.0 * np.pi * (k + 0.3) / _DIRECTIONS
        x, y, crossed = np.cos(angle), np.sin(angle), False
        for j in range(1, len(p) - 2):
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
