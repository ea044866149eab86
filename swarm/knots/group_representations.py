"""Distinguishing knots with equal polynomials by representations of their groups.

All homomorphisms of the knot group to SL(2, p) are counted that map a fixed meridian m to a fixed
matrix M. The longitude ℓ of m commutes with m, so its image is a + bM. The number of occurrences of
each pair (a, b) is an invariant of the knot. It does not depend on orientation. The mirror image
has (a + b·tr M, −b) instead, so the invariant detects chirality.
"""

import itertools
from collections import Counter
from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from swarm.knots.alexander import crossing_arcs
from swarm.knots.connected_sums import Factor
from swarm.knots.diagram import Diagram
from swarm.knots.gauss import SignedGauss
from swarm.knots.table import prime_knot

Matrices = NDArray[np.int64]
Signature = tuple[tuple[tuple[int, int], int], ...]
"""Sorted ((a, b), number of occurrences)."""

REPRESENTATIONS = ((5, 2), (7, 2), (5, 0), (7, 0), (11, 2), (7, 3), (13, 2), (11, 0), (11, 3))
"""(prime, trace of M), in order of use: fast and distinguishing ones first."""


def matching_candidates(
    diagram: Diagram, candidates: Sequence[tuple[Factor, ...]]
) -> list[tuple[Factor, ...]]:
    """Return the candidates (sums of table knots) that the representations do not exclude."""
    left = list(candidates)
    for modulus, trace in REPRESENTATIONS:
        if len(left) < 2:
            break
        own = longitude_counts(diagram, modulus, trace)
        left = [one for one in left if _of_sum(one, modulus, trace) == own]
    return left


@lru_cache(maxsize=4096)
def _of_sum(factors: tuple[Factor, ...], modulus: int, trace: int) -> Signature:
    return longitude_counts(sum_diagram(factors), modulus, trace)


def sum_diagram(factors: Sequence[Factor]) -> Diagram:
    """Return the connected sum of the table's diagrams of the factors."""
    passes: list[tuple[int, bool, int]] = []
    for name, hand in factors:
        code = prime_knot(name).diagram.code
        base = len(passes) // 2
        passes += [(base + k, over, -sign if hand < 0 else sign) for k, over, sign in code.passes]
    return Diagram(SignedGauss.of(passes, closed=True))


def longitude_counts(diagram: Diagram, modulus: int, trace: int) -> Signature:
    """Return how often each longitude occurs among the representations in SL(2, modulus)."""
    crossings = crossing_arcs(diagram.code)
    fixed = np.array([[0, -1], [1, trace]], dtype=np.int64) % modulus
    if not crossings:
        return (((1, 0), 1),)
    seeds, steps = _generators(tuple(crossings))
    images = _seeded(seeds, _conjugates(modulus, trace), fixed)
    for arc, source, over, forward in steps:
        images[arc] = _conjugated(images[source], images[over], forward, modulus)
    fits = np.ones(len(images[0]), dtype=bool)
    for over, into, out, sign in crossings:
        expected = _conjugated(images[into], images[over], sign > 0, modulus)
        fits &= np.all(images[out] == expected, axis=(1, 2))
    kept = {arc: image[fits] for arc, image in images.items()}
    longitude = np.broadcast_to(np.eye(2, dtype=np.int64), kept[0].shape)
    for over, _, _, sign in crossings:
        step = kept[over] if sign > 0 else _inverse(kept[over], modulus)
        longitude = longitude @ step % modulus
    unwind = fixed if diagram.writhe < 0 else _inverse(fixed[None], modulus)[0]
    for _ in range(abs(diagram.writhe)):
        longitude = longitude @ unwind % modulus
    # a + bM = [[a, −b], [b, a + b·trace]]
    found = Counter(zip(longitude[:, 0, 0].tolist(), longitude[:, 1, 0].tolist(), strict=True))
    return tuple(sorted(found.items()))


def _inverse(matrices: Matrices, modulus: int) -> Matrices:
    result = np.empty_like(matrices)
    result[:, 0, 0], result[:, 1, 1] = matrices[:, 1, 1], matrices[:, 0, 0]
    result[:, 0, 1], result[:, 1, 0] = -matrices[:, 0, 1], -matrices[:, 1, 0]
    return result % modulus


def _conjugated(image: Matrices, over: Matrices, forward: bool, modulus: int) -> Matrices:
    """Return the image of an arc after passing under another: o⁻¹ u o, or o u o⁻¹ backwards."""
    inverse = _inverse(over, modulus)
    left, right = (inverse, over) if forward else (over, inverse)
    return (left @ image % modulus) @ right % modulus


@lru_cache(maxsize=32)
def _conjugates(modulus: int, trace: int) -> Matrices:
    """Return all matrices (k, 2, 2) conjugate to [[0, −1], [1, trace]]."""
    values = np.arange(modulus)
    a, b, c, d = (part.ravel() for part in np.meshgrid(values, values, values, values))
    special = (a * d - b * c) % modulus == 1
    group = np.stack([a, b, c, d], axis=1)[special].reshape(-1, 2, 2)
    fixed = np.array([[[0, -1], [1, trace]]], dtype=np.int64) % modulus
    images = _conjugated(np.broadcast_to(fixed, group.shape), group, True, modulus)
    return np.unique(images.reshape(-1, 4), axis=0).reshape(-1, 2, 2)


def _seeded(seeds: Sequence[int], conjugates: Matrices, fixed: Matrices) -> dict[int, Matrices]:
    """Return every choice of images of the seeds; the image of arc 0 is the fixed matrix."""
    others = [arc for arc in seeds if arc]
    count = len(conjugates)
    total = count ** len(others)
    chosen = np.indices((count,) * len(others)).reshape(len(others), total)
    images = {0: np.broadcast_to(fixed, (total, 2, 2))}
    for arc, choice in zip(others, chosen, strict=True):
        images[arc] = conjugates[choice]
    return images


@lru_cache(maxsize=256)
def _generators(
    crossings: tuple[tuple[int, int, int, int], ...],
) -> tuple[tuple[int, ...], tuple[tuple[int, int, int, bool], ...]]:
    """Return few arcs, including arc 0, that determine all others, and the steps to the others."""
    count = len(crossings)
    others = range(1, count)
    for size in range(count):
        for extra in itertools.combinations(others, size):
            steps = _steps(crossings, {0, *extra})
            if len(steps) + size + 1 == count:
                return (0, *extra), tuple(steps)
    raise AssertionError("all arcs together determine all arcs")


def _steps(
    crossings: Sequence[tuple[int, int, int, int]], known: set[int]
) -> list[tuple[int, int, int, bool]]:
    """Return steps (arc, from arc, over arc, forward), each from arcs with known images."""
    steps: list[tuple[int, int, int, bool]] = []
    before = -1
    while len(steps) != before:
        before = len(steps)
        for over, into, out, sign in crossings:
            if over not in known:
                continue
            if into in known and out not in known:
                steps.append((out, into, over, sign > 0))
                known.add(out)
            elif out in known and into not in known:
                steps.append((into, out, over, sign < 0))
                known.add(into)
    return steps
