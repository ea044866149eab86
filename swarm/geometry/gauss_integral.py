"""The Gauss integral of two curves: how much they cross, seen from all sides; compiled."""

import numpy as np
import numpy.typing as npt

from swarm.jit import compiled

Floats = npt.NDArray[np.float64]

_NO_AREA = 1e-12
"""Square metres of a triangle below which an edge sees the other end on: its integral is 0."""


@compiled
def gauss_integral(one: Floats, other: Floats) -> float:
    """Return the Gauss integral of polylines (k, 3) and (m, 3), over 4π.

    It is the number of crossings of the two with their signs, averaged over all directions of view;
    for closed curves, the linking number. The sum over edges of Klenin and Langowski (2000), eq. 13
    to 16.
    """
    total = 0.0
    for i in range(len(one) - 1):
        for j in range(len(other) - 1):
            total += _edge_integral(one[i], one[i + 1], other[j], other[j + 1])
    return total / (4.0 * np.pi)


@compiled
def _edge_integral(a: Floats, b: Floats, c: Floats, d: Floats) -> float:
    """Return the integral of edges ab and cd: the area of directions in which they cross."""
    normals, sizes = np.empty((4, 3)), np.empty(4)
    _cross(a, c, a, d, normals[0])
    _cross(a, d, b, d, normals[1])
    _cross(b, d, b, c, normals[2])
    _cross(b, c, a, c, normals[3])
    for k in range(4):
        sizes[k] = np.sqrt(_dot(normals[k], normals[k]))
        if sizes[k] < _NO_AREA:
            return 0.0
    area = 0.0
    for k in range(4):
        after = (k + 1) % 4
        cosine = _dot(normals[k], normals[after]) / (sizes[k] * sizes[after])
        area += np.arcsin(min(max(cosine, -1.0), 1.0))
    turned = np.empty(3)
    _cross(c, d, a, b, turned)
    side = 0.0
    for x in range(3):
        side += turned[x] * (c[x] - a[x])
    return float(area * np.sign(side))


@compiled
def _cross(from_: Floats, to: Floats, start: Floats, end: Floats, found: Floats) -> None:
    """Write the cross product (3,) of the vectors from ``from_`` to ``to`` and start to end."""
    for x in range(3):
        y, z = (x + 1) % 3, (x + 2) % 3
        found[x] = (to[y] - from_[y]) * (end[z] - start[z])
        found[x] -= (to[z] - from_[z]) * (end[y] - start[y])


@compiled
def _dot(u: Floats, v: Floats) -> float:
    """Return the scalar product."""
    return float(u[0] * v[0] + u[1] * v[1] + u[2] * v[2])
