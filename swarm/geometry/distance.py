"""Vectors, distances between segments, polylines and boxes, and how much two curves cross.

Functions on arrays are batched over leading dimensions and exact for straight pieces; the error of
a polyline in place of a catenary is at most the distance of the catenary from its chords. Compiled
functions take single vectors (tuples of three numbers: no arrays, and no memory for them),
segments, polylines and boxes.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from swarm.jit import compiled, inner
from swarm.signatures import Floats2, Floats3, Floats4, Ints2, contiguous

Floats = NDArray[np.float64]
Vector = tuple[float, float, float]


@inner
def difference(first: Vector, second: Vector) -> Vector:
    """Return one vector less the other."""
    return first[0] - second[0], first[1] - second[1], first[2] - second[2]


@inner
def size(vector: Vector) -> float:
    """Return the length of a vector."""
    return math.sqrt(vector[0] * vector[0] + vector[1] * vector[1] + vector[2] * vector[2])


@inner
def dot(first: Vector, second: Vector) -> float:
    """Return the product of two vectors; summed as by ``numpy.einsum``, to the last bit."""
    return first[0] * second[0] + first[2] * second[2] + first[1] * second[1]


@inner
def cross(first: Vector, second: Vector) -> Vector:
    """Return the vector product of two vectors."""
    return (
        first[1] * second[2] - first[2] * second[1],
        first[2] * second[0] - first[0] * second[2],
        first[0] * second[1] - first[1] * second[0],
    )


@inner
def times(share: float, vector: Vector) -> Vector:
    """Return a multiple of a vector."""
    return share * vector[0], share * vector[1], share * vector[2]


@inner
def moved(start: Vector, share: float, step: Vector) -> Vector:
    """Return the point that is a share of a step from a start."""
    return start[0] + share * step[0], start[1] + share * step[1], start[2] + share * step[2]


@inner
def unit(vector: Vector) -> Vector:
    """Return the unit vector; straight up for a vector of no length."""
    length = size(vector)
    if length > 1e-12:
        return vector[0] / length, vector[1] / length, vector[2] / length
    return 0.0, 0.0, 1.0


_RUN = 8
"""Pieces of a long polyline that are skipped together."""


@dataclass(frozen=True, eq=False)
class Closest:
    """Distances (…,), and the places on the first and on the second thing that are closest (…,).

    On a segment a place is a fraction from 0 to 1; on a polyline it is the index of the piece plus
    the fraction along it.
    """

    distance: Floats
    first: Floats
    second: Floats


def norms(vectors: Floats) -> Floats:
    """Return the lengths (…,) of vectors (…, d), d ≥ 2, to the last bit as ``numpy.linalg.norm``.

    Several times as fast for many short vectors: NumPy reduces a short last axis row by row.
    """
    squares = vectors * vectors
    total: Floats = squares[..., 0] + squares[..., 1]
    for k in range(2, vectors.shape[-1]):
        total += squares[..., k]
    return np.sqrt(total)


def segment_segment(first: ArrayLike, second: ArrayLike) -> Closest:
    """Return the closest points of straight segments (…, 2, 3); zero length is allowed."""
    first, second = np.asarray(first, dtype=np.float64), np.asarray(second, dtype=np.float64)
    return polyline_polyline(first, second)


def point_segment(point: ArrayLike, segment: ArrayLike) -> Closest:
    """Return the closest points of segments (…, 2, 3) to points (…, 3); ``first`` is always 0."""
    point = np.asarray(point, dtype=np.float64)
    return polyline_polyline(np.stack([point, point], axis=-2), segment)


def polyline_polyline(first: ArrayLike, second: ArrayLike) -> Closest:
    """Return the closest points of polylines (…, m, 3) and (…, k, 3).

    NaN where a coordinate is NaN.
    """
    first, second = np.asarray(first, dtype=np.float64), np.asarray(second, dtype=np.float64)
    shape = first.shape[:-2]
    if second.shape[:-2] != shape:
        shape = np.broadcast_shapes(shape, second.shape[:-2])
        first = np.broadcast_to(first, shape + first.shape[-2:])
        second = np.broadcast_to(second, shape + second.shape[-2:])
    a = first.reshape(-1, *first.shape[-2:])
    b = second.reshape(-1, *second.shape[-2:])
    spheres = np.empty((2, max(runs_of(each.shape[1]) for each in (a, b)), 4))
    gaps = np.empty((3, len(a)))
    _write_closest(contiguous(a), contiguous(b), spheres, gaps)
    distance, at_first, at_second = gaps.reshape(3, *shape)
    return Closest(distance, at_first, at_second)


def strand_strand(strands: ArrayLike, pairs: ArrayLike) -> Closest:
    """Return the closest points of chosen pairs (p, 2) among polylines (…, s, k, 3): (…, p).

    As :func:`polyline_polyline` of the strands chosen by ``pairs``, without copies of them.
    """
    strands, pairs = np.asarray(strands, dtype=np.float64), np.asarray(pairs, dtype=np.intp)
    flat = strands.reshape(-1, *strands.shape[-3:])
    gaps = np.empty((3, len(flat), len(pairs)))
    _write_chosen(contiguous(flat), pairs.reshape(-1, 2), gaps)
    distance, at_first, at_second = gaps.reshape(3, *strands.shape[:-3], len(pairs))
    return Closest(distance, at_first, at_second)


@compiled
def _write_closest(first: Floats3, second: Floats3, spheres: Floats3, gaps: Floats2) -> None:
    """Write distances and places (3, q) of polylines (q, m, 3) and (q, k, 3).

    ``spheres`` (2, runs, 4) is memory for both of a pair.
    """
    straight = first.shape[1] == second.shape[1] == 2
    short = min(first.shape[1], second.shape[1]) <= 2 * _RUN
    for q in range(len(first)):
        if straight:
            square, s, t = segment_distance(first[q], 0, second[q], 0)
            gaps[0, q] = np.sqrt(square)
            gaps[1, q], gaps[2, q] = (s, t) if square >= 0.0 else (0.0, 0.0)
        elif short:
            gaps[0, q], gaps[1, q], gaps[2, q] = polyline_distance(first[q], second[q], np.inf)
        else:
            distance, s, t = _distance_by_runs(first[q], second[q], spheres)
            gaps[0, q], gaps[1, q], gaps[2, q] = distance, s, t


@compiled
def _write_chosen(strands: Floats4, pairs: Ints2, gaps: Floats3) -> None:
    """Write distances and places (3, q, p) of pairs (p, 2) among strands (q, s, k, 3)."""
    for q in range(len(strands)):
        for p in range(len(pairs)):
            pair = polyline_distance(strands[q, pairs[p, 0]], strands[q, pairs[p, 1]], np.inf)
            gaps[0, q, p], gaps[1, q, p], gaps[2, q, p] = pair


@inner
def _distance_by_runs(first: Floats, second: Floats, spheres: Floats) -> tuple[float, float, float]:
    """As :func:`polyline_distance`, for polylines of many pieces: eight times as fast for 64 each.

    Runs of pieces are skipped whose enclosing spheres are farther apart than what is found already;
    the runs that are nearest come first.
    """
    runs, others = _write_spheres(first, spheres[0]), _write_spheres(second, spheres[1])
    nearest, first_run, first_other = np.inf, 0, 0
    for a in range(runs):
        for b in range(others):
            gap = _gap(spheres, a, b)
            if gap < nearest:
                nearest, first_run, first_other = gap, a, b
    best, here, there = np.inf, 0.0, 0.0
    for number in range(runs * others + 1):
        a, b = (first_run, first_other) if number == 0 else divmod(number - 1, others)
        if _gap(spheres, a, b) > best:
            continue
        i, j = a * _RUN, b * _RUN
        distance, s, t = polyline_distance(first[i : i + _RUN + 1], second[j : j + _RUN + 1], best)
        if np.isnan(distance):
            return np.nan, 0.0, 0.0
        if distance < best:
            best, here, there = distance, i + s, j + t
    return best, here, there


@inner
def _write_spheres(points: Floats, spheres: Floats) -> int:
    """Write middles and radii (q, 4) of spheres around runs of pieces of a polyline; return q.

    Infinite radii where a coordinate is NaN.
    """
    count = runs_of(len(points))
    for q in range(count):
        begin, end = q * _RUN, min((q + 1) * _RUN, len(points) - 1)
        largest = total = 0.0
        for axis in range(3):
            spheres[q, axis] = 0.5 * (points[begin, axis] + points[end, axis])
        for k in range(begin, end + 1):
            x, y = points[k, 0] - spheres[q, 0], points[k, 1] - spheres[q, 1]
            z = points[k, 2] - spheres[q, 2]
            square = x * x + y * y + z * z
            largest, total = max(largest, square), total + square
        spheres[q, 3] = np.inf if np.isnan(total) else np.sqrt(largest)
    return count


@compiled
def runs_of(points: int) -> int:
    """Return the number of runs of pieces of a polyline of so many points."""
    return (points - 2) // _RUN + 1


@inner
def _gap(spheres: Floats, a: int, b: int) -> float:
    """Return the distance of a first and a second sphere, with 1e-12 of it for rounding."""
    x, y = spheres[0, a, 0] - spheres[1, b, 0], spheres[0, a, 1] - spheres[1, b, 1]
    z = spheres[0, a, 2] - spheres[1, b, 2]
    middles = np.sqrt(x * x + y * y + z * z)
    return float(middles * (1.0 - 1e-12) - spheres[0, a, 3] - spheres[1, b, 3])


@inner
def polyline_distance(first: Floats, second: Floats, limit: float) -> tuple[float, float, float]:
    """Return the distance of polylines (m, 3) and (k, 3), and the closest places on each.

    The distance is ``limit`` where they are not closer. Pieces are skipped whose enclosing spheres
    are farther apart than ``limit`` or than the smallest distance so far.
    """
    best, here, there = limit, 0.0, 0.0
    for i in range(len(first) - 1):
        own = _piece_length(first, i)
        for j in range(len(second) - 1):
            reach = 2.0 * best + own + _piece_length(second, j)
            if _square_between(first, i, second, j) * (1.0 - 1e-12) > reach * reach:
                continue
            square, s, t = segment_distance(first, i, second, j)
            if np.isnan(square):
                return np.nan, 0.0, 0.0
            if square < best * best:
                best, here, there = float(np.sqrt(square)), i + s, j + t
    return best, here, there


@inner
def _square_between(first: Floats, i: int, second: Floats, j: int) -> float:
    """Return the square of twice the distance of the middles of two pieces.

    Both pieces are in spheres about these: compared with twice the sum of radii and best distance,
    with 1e-12 for rounding.
    """
    x = first[i, 0] + first[i + 1, 0] - second[j, 0] - second[j + 1, 0]
    y = first[i, 1] + first[i + 1, 1] - second[j, 1] - second[j + 1, 1]
    z = first[i, 2] + first[i + 1, 2] - second[j, 2] - second[j + 1, 2]
    return float(x * x + y * y + z * z)


@inner
def _piece_length(points: Floats, i: int) -> float:
    """Return the length of a piece of a polyline."""
    x, y = points[i + 1, 0] - points[i, 0], points[i + 1, 1] - points[i, 1]
    z = points[i + 1, 2] - points[i, 2]
    return float(np.sqrt(x * x + y * y + z * z))


@inner
def segment_distance(first: Floats, i: int, second: Floats, j: int) -> tuple[float, float, float]:
    """Return the squared distance of two pieces of polylines, and the closest fractions of both.

    The unclamped optimum of one parameter, then each parameter clamped and optimised in turn
    (Ericson, *Real-Time Collision Detection*, 5.1.9).
    """
    uu = ww = uw = ua = wa = 0.0
    for axis in range(3):
        u, w = first[i + 1, axis] - first[i, axis], second[j + 1, axis] - second[j, axis]
        apart = first[i, axis] - second[j, axis]
        uu, ww, uw = uu + u * u, ww + w * w, uw + u * w
        ua, wa = ua + u * apart, wa + w * apart
    s = _part(uw * wa - ua * ww, uu * ww - uw * uw)
    t = _part(uw * s + wa, ww)
    s = _part(uw * t - ua, uu)
    square = 0.0
    for axis in range(3):
        u, w = first[i + 1, axis] - first[i, axis], second[j + 1, axis] - second[j, axis]
        square += (first[i, axis] - second[j, axis] + s * u - t * w) ** 2
    return square, s, t


@inner
def _part(above: float, below: float) -> float:
    """Return a quotient clamped to 0…1, and 0 where the divisor is not positive."""
    if not below > 0.0:
        return 0.0
    return min(max(above / below, 0.0), 1.0)


@inner
def point_distance(first: Floats, second: Floats) -> float:
    """Return the distance of two points (3,)."""
    x, y, z = first[0] - second[0], first[1] - second[1], first[2] - second[2]
    return float(np.sqrt(x * x + y * y + z * z))


@compiled
def bounding_boxes(points: Floats3, boxes: Floats3) -> None:
    """Write the upright boxes (q, 2, 3) around polylines (q, k, 3): middles and half sizes."""
    for q in range(len(points)):
        for axis in range(3):
            low = high = points[q, 0, axis]
            for k in range(1, points.shape[1]):
                low, high = min(low, points[q, k, axis]), max(high, points[q, k, axis])
            boxes[q, 0, axis], boxes[q, 1, axis] = 0.5 * (low + high), 0.5 * (high - low)


@inner
def boxes_closer(first: Floats, i: int, second: Floats, j: int, limit: float) -> bool:
    """Return whether the gap of box ``i`` and box ``j`` is below ``limit`` along every axis.

    ``first`` and ``second`` are (q, 2, 3), as from :func:`bounding_boxes`.
    """
    for axis in range(3):
        gap = abs(first[i, 0, axis] - second[j, 0, axis]) - first[i, 1, axis] - second[j, 1, axis]
        if gap >= limit:
            return False
    return True


_NO_AREA = 1e-12
"""Square metres of a triangle below which an edge sees the other end on: its integral is 0."""


@inner
def gauss_integral(first: Floats, second: Floats) -> float:
    """Return the Gauss integral of polylines (k, 3) and (m, 3), over 4π.

    It is the number of crossings of the two with their signs, averaged over all directions of view;
    for closed curves, the linking number. The sum over edges of Klenin and Langowski (2000), eq. 13
    to 16.
    """
    total = 0.0
    for i in range(len(first) - 1):
        for j in range(len(second) - 1):
            total += _edge_integral(first[i], first[i + 1], second[j], second[j + 1])
    return total / (4.0 * np.pi)


@inner
def _edge_integral(a: Floats, b: Floats, c: Floats, d: Floats) -> float:
    """Return the integral of edges ab and cd: the area of directions in which they cross."""
    ac = (c[0] - a[0], c[1] - a[1], c[2] - a[2])
    ad = (d[0] - a[0], d[1] - a[1], d[2] - a[2])
    bc = (c[0] - b[0], c[1] - b[1], c[2] - b[2])
    bd = (d[0] - b[0], d[1] - b[1], d[2] - b[2])
    n1, n2, n3, n4 = cross(ac, ad), cross(ad, bd), cross(bd, bc), cross(bc, ac)
    s1, s2, s3, s4 = _product(n1, n1), _product(n2, n2), _product(n3, n3), _product(n4, n4)
    if min(s1, s2, s3, s4) < _NO_AREA * _NO_AREA:
        return 0.0
    area = _arc(_product(n1, n2), s1 * s2) + _arc(_product(n2, n3), s2 * s3)
    area += _arc(_product(n3, n4), s3 * s4) + _arc(_product(n4, n1), s4 * s1)
    along = (b[0] - a[0], b[1] - a[1], b[2] - a[2])
    other = (d[0] - c[0], d[1] - c[1], d[2] - c[2])
    return float(area * np.sign(_product(cross(other, along), ac)))


@inner
def _product(u: Vector, v: Vector) -> float:
    """As :func:`dot`, summed in the order of the axes."""
    return u[0] * v[0] + u[1] * v[1] + u[2] * v[2]


@inner
def _arc(product: float, squares: float) -> float:
    """Return the arc sine of an inner product over the root of the product of squared sizes."""
    return float(np.arcsin(min(max(product / np.sqrt(squares), -1.0), 1.0)))
