"""Closest distances between strands: the one distance model of planner, certificate and flight.

All functions are batched over leading dimensions and exact for straight pieces; a polyline that
stands for a catenary is off by no more than the catenary bows out from its pieces.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]

_PAIRS_AT_ONCE = 400_000
"""Pairs of pieces compared in one go: some ten arrays of this size, about 50 MB."""


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

    Works through the batch in portions of bounded memory. Pairs of pieces whose enclosing spheres
    are farther apart than some pair of midpoints cannot be closest and are left out.
    """
    first, second = np.asarray(first, dtype=np.float64), np.asarray(second, dtype=np.float64)
    shape = np.broadcast_shapes(first.shape[:-2], second.shape[:-2])
    a = np.broadcast_to(first, shape + first.shape[-2:]).reshape(-1, *first.shape[-2:])
    b = np.broadcast_to(second, shape + second.shape[-2:]).reshape(-1, *second.shape[-2:])
    distance, at_first, at_second = (np.empty(len(a)) for _ in range(3))
    for part in _portions(len(a), (a.shape[1] - 1) * (b.shape[1] - 1)):
        found = _polylines(a[part], b[part])
        distance[part], at_first[part], at_second[part] = found.distance, found.first, found.second
    return Closest(distance.reshape(shape), at_first.reshape(shape), at_second.reshape(shape))


def strand_strand(strands: ArrayLike, pairs: ArrayLike) -> Closest:
    """Closest points of chosen pairs (p, 2) among polylines (…, s, k, 3): (…, p).

    The same as :func:`polyline_polyline` of the strands picked by ``pairs``, without ever copying
    them all.
    """
    strands, pairs = np.asarray(strands, dtype=np.float64), np.asarray(pairs, dtype=np.intp)
    shape = strands.shape[:-3]
    flat = strands.reshape(-1, *strands.shape[-3:])
    count = len(pairs)
    distance, at_first, at_second = (np.empty((len(flat), count)) for _ in range(3))
    for part in _portions(len(flat), count * (strands.shape[-2] - 1) ** 2):
        found = polyline_polyline(flat[part][:, pairs[:, 0]], flat[part][:, pairs[:, 1]])
        distance[part], at_first[part], at_second[part] = found.distance, found.first, found.second
    shape = (*shape, count)
    return Closest(distance.reshape(shape), at_first.reshape(shape), at_second.reshape(shape))


def _segment_segment(a: Floats, u: Floats, b: Floats, w: Floats) -> Closest:
    apart = a - b
    uu, ww, uw = _dot(u, u), _dot(w, w), _dot(u, w)
    ua, wa = _dot(u, apart), _dot(w, apart)
    s = np.clip(_ratio(uw * wa - ua * ww, uu * ww - uw * uw), 0.0, 1.0)
    t = np.clip(_ratio(uw * s + wa, ww), 0.0, 1.0)
    s = np.clip(_ratio(uw * t - ua, uu), 0.0, 1.0)
    distance = np.linalg.norm(apart + s[..., None] * u - t[..., None] * w, axis=-1)
    return Closest(distance, s, t)


def _polylines(a: Floats, b: Floats) -> Closest:
    u, w = np.diff(a, axis=1), np.diff(b, axis=1)
    middle_a, middle_b = a[:, :-1] + 0.5 * u, b[:, :-1] + 0.5 * w
    reach_a, reach_b = (0.5 * np.linalg.norm(piece, axis=-1) for piece in (u, w))
    apart = np.zeros((len(a), u.shape[1], w.shape[1]))
    for axis in range(3):
        apart += (middle_a[:, :, None, axis] - middle_b[:, None, :, axis]) ** 2
    np.sqrt(apart, out=apart)
    # Rounding must not lose the pair that is closest, hence the hair's breadth.
    limit = apart.min(axis=(1, 2)) * (1.0 + 1e-12)
    apart -= reach_a[:, :, None]
    apart -= reach_b[:, None, :]
    batch, i, j = np.nonzero(apart <= limit[:, None, None])

    found = _segment_segment(a[batch, i], u[batch, i], b[batch, j], w[batch, j])
    begins = np.searchsorted(batch, np.arange(len(a)))
    distance = np.minimum.reduceat(found.distance, begins)
    hits = np.flatnonzero(found.distance == distance[batch])
    best = hits[np.searchsorted(batch[hits], np.arange(len(a)))]
    return Closest(distance, i[best] + found.first[best], j[best] + found.second[best])


def _portions(count: int, size: int) -> Iterator[slice]:
    step = max(1, _PAIRS_AT_ONCE // max(1, size))
    for begin in range(0, count, step):
        yield slice(begin, begin + step)


def _ratio(above: Floats, below: Floats) -> Floats:
    """Quotient, and 0 where the divisor is not positive (parallel or of no length)."""
    return np.where(below > 0.0, above / np.where(below > 0.0, below, 1.0), 0.0)


def _dot(a: Floats, b: Floats) -> Floats:
    product: Floats = np.einsum("...i,...i->...", a, b)
    return product
