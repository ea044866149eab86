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
    _cross(c - a, d - a, normals[0])
    _cross(d - a, d - b, normals[1])
    _cross(d - b, c - b, normals[2])
    _cross(c - b, c - a, normals[3])
    for k in range(4):
        sizes[k] = np.sqrt((normals[k] ** 2).sum())
        if sizes[k] < _NO_AREA:
            return 0.0
    area = 0.0
    for k in range(4):
        after = (k + 1) % 4
        cosine = (normals[k] * normals[after]).sum() / (sizes[k] * sizes[after])
        area += np.arcsin(min(max(cosine, -1.0), 1.0))
    turned = np.empty(3)
    _cross(d - c, b - a, turned)
    return float(area * np.sign((turned * (c - a)).sum()))


@compiled
def _cross(u: Floats, v: Floats, found: Floats) -> None:
    """Write the cross product (3,)."""
    found[0] = u[1] * v[2] - u[2] * v[1]
    found[1] = u[2] * v[0] - u[0] * v[2]
    found[2] = u[0] * v[1] - u[1] * v[0]
