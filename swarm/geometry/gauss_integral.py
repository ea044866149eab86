"""The Gauss integral of two curves: how much they cross, seen from all sides; compiled."""

import numpy as np
import numpy.typing as npt

from swarm.jit import inner

Floats = npt.NDArray[np.float64]
Vector = tuple[float, float, float]

_NO_AREA = 1e-12
"""Square metres of a triangle below which an edge sees the other end on: its integral is 0."""


@inner
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


@inner
def _edge_integral(a: Floats, b: Floats, c: Floats, d: Floats) -> float:
    """Return the integral of edges ab and cd: the area of directions in which they cross."""
    ac = (c[0] - a[0], c[1] - a[1], c[2] - a[2])
    ad = (d[0] - a[0], d[1] - a[1], d[2] - a[2])
    bc = (c[0] - b[0], c[1] - b[1], c[2] - b[2])
    bd = (d[0] - b[0], d[1] - b[1], d[2] - b[2])
    n1, n2, n3, n4 = _cross(ac, ad), _cross(ad, bd), _cross(bd, bc), _cross(bc, ac)
    s1, s2, s3, s4 = _dot(n1, n1), _dot(n2, n2), _dot(n3, n3), _dot(n4, n4)
    if min(s1, s2, s3, s4) < _NO_AREA * _NO_AREA:
        return 0.0
    area = _arc(_dot(n1, n2), s1 * s2) + _arc(_dot(n2, n3), s2 * s3)
    area += _arc(_dot(n3, n4), s3 * s4) + _arc(_dot(n4, n1), s4 * s1)
    along = (b[0] - a[0], b[1] - a[1], b[2] - a[2])
    other = (d[0] - c[0], d[1] - c[1], d[2] - c[2])
    return float(area * np.sign(_dot(_cross(other, along), ac)))


@inner
def _cross(u: Vector, v: Vector) -> Vector:
    """Return the cross product."""
    return (u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0])


@inner
def _dot(u: Vector, v: Vector) -> float:
    """Return the inner product."""
    return u[0] * v[0] + u[1] * v[1] + u[2] * v[2]


@inner
def _arc(product: float, squares: float) -> float:
    """Return the arc sine of an inner product over the root of the product of squared sizes."""
    return float(np.arcsin(min(max(product / np.sqrt(squares), -1.0), 1.0)))
