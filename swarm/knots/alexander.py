"""The Alexander polynomial of a diagram."""

import numpy as np
from numpy.typing import NDArray

from swarm.knots.diagram import Diagram
from swarm.knots.gauss import SignedGauss

MODULUS = 2**31 - 1
"""The prime p of all arithmetic."""


def alexander_polynomial(diagram: Diagram) -> dict[int, int]:
    """Return the Alexander polynomial {power: coefficient}, symmetric, with value 1 at t = 1.

    It is a minor of the Alexander matrix (Alexander 1928), evaluated and interpolated modulo the
    prime 2³¹ − 1. The coefficients are at most the determinant of the knot, which is far smaller
    for every diagram of a cable.
    """
    count = diagram.crossings
    if count < 3:
        return {0: 1}
    points = np.arange(2, count + 2, dtype=np.int64)
    values = _determinants(_matrices(diagram.code, points))
    coefficients = _interpolated(points.tolist(), values.tolist())
    while coefficients and coefficients[-1] == 0:
        coefficients.pop()
    low = next(k for k, c in enumerate(coefficients) if c)
    spread = coefficients[low:]
    signed = [c - MODULUS if c > MODULUS // 2 else c for c in spread]
    unit = sum(signed)
    return {k - len(signed) // 2: unit * c for k, c in enumerate(signed) if c}


def crossing_arcs(code: SignedGauss) -> list[tuple[int, int, int, int]]:
    """Return for each crossing: over arc, incoming and outgoing under arc, sign.

    Arcs run from one under pass to the next; arc 0 ends at the first under pass.
    """
    count = code.crossings
    over_arc: dict[int, int] = {}
    under: dict[int, tuple[int, int, int]] = {}
    arc = 0
    for label, over, sign in code.passes:
        if over:
            over_arc[label] = arc
        else:
            under[label] = (arc, (arc + 1) % count, sign)
            arc = (arc + 1) % count
    return [(over_arc[label], *under[label]) for label in under]


def _matrices(code: SignedGauss, points: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return minors of the Alexander matrix at each point, (points, n − 1, n − 1), modulo p."""
    count = code.crossings
    matrix = np.zeros((len(points), count, count), dtype=np.int64)
    for row, (over, into, out, sign) in enumerate(crossing_arcs(code)):
        before, after = (into, out) if sign > 0 else (out, into)
        matrix[:, row, over] += 1 - points
        matrix[:, row, before] += points
        matrix[:, row, after] -= 1
    return matrix[:, 1:, 1:] % MODULUS


def _determinants(matrices: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return determinants modulo p, by elimination of all matrices at once."""
    work = matrices.copy()
    batch, size, _ = work.shape
    result = np.ones(batch, dtype=np.int64)
    every = np.arange(batch)
    for k in range(size):
        pivot_row = k + np.argmax(work[:, k:, k] != 0, axis=1)
        result = np.where(pivot_row != k, -result, result) % MODULUS
        swapped = work[every, pivot_row].copy()
        work[every, pivot_row] = work[:, k]
        work[:, k] = swapped
        pivot = work[:, k, k]
        result = result * pivot % MODULUS
        factor = work[:, k + 1 :, k] * _inverses(pivot)[:, None] % MODULUS
        work[:, k + 1 :] = (
            work[:, k + 1 :] - factor[:, :, None] * work[:, k, None, :] % MODULUS
        ) % MODULUS
    return result


def _inverses(values: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return inverses modulo p; 0 for 0, whose determinant is 0 anyway."""
    return np.array([pow(v, -1, MODULUS) if v else 0 for v in values.tolist()], dtype=np.int64)


def _interpolated(points: list[int], values: list[int]) -> list[int]:
    """Return the coefficients, lowest first, of the polynomial through all points, modulo p."""
    table = list(values)
    count = len(points)
    for order in range(1, count):
        for k in range(count - 1, order - 1, -1):
            step = pow(points[k] - points[k - order], -1, MODULUS)
            table[k] = (table[k] - table[k - 1]) * step % MODULUS
    coefficients = [0] * count
    for k in range(count - 1, -1, -1):
        for power in range(count - 1, 0, -1):
            coefficients[power] = (
                coefficients[power - 1] - points[k] * coefficients[power]
            ) % MODULUS
        coefficients[0] = (table[k] - points[k] * coefficients[0]) % MODULUS
    return coefficients
