"""Vectors of three numbers as tuples, for compiled code: no arrays, and no memory for them."""

import math

from swarm.jit import inner

Vector = tuple[float, float, float]


@inner
def difference(one: Vector, other: Vector) -> Vector:
    """Return one vector less the other."""
    return one[0] - other[0], one[1] - other[1], one[2] - other[2]


@inner
def size(vector: Vector) -> float:
    """Return the length of a vector."""
    return math.sqrt(vector[0] * vector[0] + vector[1] * vector[1] + vector[2] * vector[2])


@inner
def dot(one: Vector, other: Vector) -> float:
    """Return the product of two vectors; summed as by ``numpy.einsum``, to the last bit."""
    return one[0] * other[0] + one[2] * other[2] + one[1] * other[1]


@inner
def cross(one: Vector, other: Vector) -> Vector:
    """Return the vector product of two vectors."""
    return (
        one[1] * other[2] - one[2] * other[1],
        one[2] * other[0] - one[0] * other[2],
        one[0] * other[1] - one[1] * other[0],
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
