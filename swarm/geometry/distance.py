"""Closest distances between strands: the one distance model of planner, certificate and flight.

All functions are batched over leading dimensions and exact for straight pieces; a polyline that
stands for a catenary is off by no more than the catenary bows out from its pieces.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from swarm.jit import compiled

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Closest:
    """Where two things are closest: the distance (…,), and where on each of the two (…,).

    On a segment the place is a fraction from 0 to 1; on a polyline it is the index of the piece
    plus the fraction along it.
    """

    distance: Floats
    first: Floats
    second: Floats


def segment_segment(first: ArrayLike, second: ArrayLike) -> Closest:
    """Closest points of two straight segments (…, 2, 3); zero length is allowed.

    The unclamped optimum of one parameter, then each parameter clamped and optimised in turn
    (Ericson, *Real-Time Collision Detection*, 5.1.9).
    """
    a, b = np.asarray(first, dtype=np.float64), np.asarray(second, dtype=np.float64)
    return _segment_segment(
        a[..., 0, :], a[..., 1, :] - a[..., 0, :], b[..., 0, :], b[..., 1, :] - b[..., 0, :]
    )


def point_segment(point: ArrayLike, segment: ArrayLike) -> Closest:
    """Closest point of straight segments (…, 2, 3) to points (…, 3); ``first`` is always 0."""
    point, segment = np.asarray(point, dtype=np.float64), np.asarray(segment, dtype=np.float64)
    start = segment[..., 0, :]
    along = segment[..., 1, :] - start
    apart = point - start
    fraction = np.clip(_ratio(_dot(along, apart), _dot(along, along)), 0.0, 1.0)
    distance = np.linalg.norm(apart - fraction[..., None] * along, axis=-1)
    return Closest(distance, np.zeros_like(distance), fraction)


def polyline_polyline(first: ArrayLike, second: ArrayLike) -> Closest:
    """Closest points of two polylines (…, m, 3) and (…, k, 3), over all pairs of their pieces.

    Not a number where a point is none.
    """
    first, second = np.asarray(first, dtype=np.float64), np.asarray(second, dtype=np.float64)
    shape = np.broadcast_shapes(first.shape[:-2], second.shape[:-2])
    a = np.broadcast_to(first, shape + first.shape[-2:]).reshape(-1, *first.shape[-2:])
    b = np.broadcast_to(second, shape + second.shape[-2:]).reshape(-1, *second.shape[-2:])
    found = np.empty((3, len(a)))
    _polylines(_plain(a), _plain(b), found)
    distance, at_first, at_second = found.reshape(3, *shape)
    return Closest(distance, at_first, at_second)


def strand_strand(strands: ArrayLike, pairs: ArrayLike) -> Closest:
    """Closest points of chosen pairs (p, 2) among polylines (…, s, k, 3): (…, p).

    The same as :func:`polyline_polyline` of the strands picked by ``pairs``, without ever copying
    them.
    """
    strands, pairs = np.asarray(strands, dtype=np.float64), np.asarray(pairs, dtype=np.intp)
    flat = strands.reshape(-1, *strands.shape[-3:])
    found = np.empty((3, len(flat), len(pairs)))
    _chosen(_plain(flat), pairs.reshape(-1, 2), found)
    distance, at_first, at_second = found.reshape(3, *strands.shape[:-3], len(pairs))
    return Closest(distance, at_first, at_second)


def _plain(array: Floats) -> Floats:
    """The array itself, or a copy where it is not contiguous and writable as compiled for."""
    return np.require(array, requirements=["C", "W"])


def _segment_segment(a: Floats, u: Floats, b: Floats, w: Floats) -> Closest:
    apart = a - b
    uu, ww, uw = _dot(u, u), _dot(w, w), _dot(u, w)
    ua, wa = _dot(u, apart), _dot(w, apart)
    s = np.clip(_ratio(uw * wa - ua * ww, uu * ww - uw * uw), 0.0, 1.0)
    t = np.clip(_ratio(uw * s + wa, ww), 0.0, 1.0)
    s = np.clip(_ratio(uw * t - ua, uu), 0.0, 1.0)
    distance = np.linalg.norm(apart + s[..., None] * u - t[..., None] * w, axis=-1)
    return Closest(distance, s, t)


@compiled
def _polylines(first: Floats, second: Floats, found: Floats) -> None:
    """Fill ``found`` (3, q) with distances and places of polylines (q, m, 3) and (q, k, 3)."""
    for q in range(len(first)):
        found[0, q], found[1, q], found[2, q] = polyline_distance(first[q], second[q], np.inf)


@compiled
def _chosen(strands: Floats, pairs: NDArray[np.intp], found: Floats) -> None:
    for q in range(len(strands)):
        for p in range(len(pairs)):
            pair = polyline_distance(strands[q, pairs[p, 0]], strands[q, pairs[p, 1]], np.inf)
            found[0, q, p], found[1, q, p], found[2, q, p] = pair


@compiled
def polyline_distance(first: Floats, second: Floats, limit: float) -> tuple[float, float, float]:
    """Distance of two polylines (m, 3) and (k, 3), and where on each they are closest.

    Where they are not nearer than ``limit``, that is returned as their distance. Pieces whose
    enclosing spheres are farther apart than that, or than what was found already, are left out.
    """
    sizes = np.empty(len(second) - 1)
    for j in range(len(sizes)):
        sizes[j] = _size(second, j)
    return polyline_distance_sized(first, second, sizes, limit)


@compiled
def polyline_distance_sized(
    first: Floats, second: Floats, sizes: Floats, limit: float
) -> tuple[float, float, float]:
    """As :func:`polyline_distance`, where the sizes (k − 1,) of the second's pieces are known."""
    best, here, there = limit, 0.0, 0.0
    for i in range(len(first) - 1):
        own = _size(first, i)
        x, y = first[i, 0] + first[i + 1, 0], first[i, 1] + first[i + 1, 1]
        z = first[i, 2] + first[i + 1, 2]
        for j in range(len(second) - 1):
            # The spheres are half as large as the pieces; a hair's breadth more, for rounding.
            # Compared is twice of what middles are apart, and of what is reached.
            reach = 2.0 * best + own + sizes[j]
            square = (x - second[j, 0] - second[j + 1, 0]) ** 2
            square += (y - second[j, 1] - second[j + 1, 1]) ** 2
            square += (z - second[j, 2] - second[j + 1, 2]) ** 2
            if square * (1.0 - 1e-12) > reach * reach:
                continue
            square, s, t = _pieces(first, i, second, j)
            if np.isnan(square):
                return np.nan, 0.0, 0.0
            if square < best * best:
                best, here, there = float(np.sqrt(square)), i + s, j + t
    return best, here, there


@compiled
def _size(points: Floats, i: int) -> float:
    """Length of a piece of a polyline."""
    x, y = points[i + 1, 0] - points[i, 0], points[i + 1, 1] - points[i, 1]
    z = points[i + 1, 2] - points[i, 2]
    return float(np.sqrt(x * x + y * y + z * z))


@compiled
def _pieces(first: Floats, i: int, second: Floats, j: int) -> tuple[float, float, float]:
    """As :func:`_segment_segment` for two pieces: squared distance, and fractions along both."""
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


@compiled
def _part(above: float, below: float) -> float:
    """Quotient clamped to 0…1, and 0 where the divisor is not positive."""
    if not below > 0.0:
        return 0.0
    return min(max(above / below, 0.0), 1.0)


def _ratio(above: Floats, below: Floats) -> Floats:
    """Quotient, and 0 where the divisor is not positive (parallel or of no length)."""
    return np.where(below > 0.0, above / np.where(below > 0.0, below, 1.0), 0.0)


def _dot(a: Floats, b: Floats) -> Floats:
    product: Floats = np.einsum("...i,...i->...", a, b)
    return product
