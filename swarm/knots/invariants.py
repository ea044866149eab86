"""Invariants of knots, and the identification of the knot of a diagram or of a curve in space.

The result is exact, not only likely. A diagram is first simplified and split into its visible
summands. A part with at most ten crossings can only be a knot of the table or a sum of such knots,
so the invariants have to distinguish only those, with chirality. A part with more crossings can be
any knot: it is ``unknown``, and the table's knots with the same invariants are candidates.

First come the invariants: the polynomials of Alexander and Jones, and representations of the knot
group for knots with equal polynomials.
"""

import itertools
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from swarm.knots.curve import Points, curve_gauss, find_defect, validated_curve
from swarm.knots.diagram import Diagram, simplified
from swarm.knots.gauss import KnotError, SignedGauss
from swarm.knots.grid_search import grid_of_diagram, minimise_grid, random_grids
from swarm.knots.names import CHIRALITIES, Factor, canonical_factors, name_of_sum, table_order
from swarm.knots.table import Laurent, knot_table, prime_knot

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


Polynomial = Mapping[int, int]
"""Coefficient of each power of one variable, without zeros."""

_State = tuple[tuple[int, int], ...]


def jones_polynomial(diagram: Diagram) -> dict[int, int]:
    """Return the Jones polynomial V(t) as {power: coefficient}; right-handed trefoil: t + t³ − t⁴.

    Kauffman 1987, "State models and the Jones polynomial", with t = A⁻⁴. Time grows with the
    diagram's width (the crossings are added to a growing disc), not with 2^crossings.
    """
    count = diagram.crossings
    if count == 0:
        return {0: 1}
    bits = 2 * count + 8
    total = _bracket(diagram.pd(), bits)
    result: dict[int, int] = {}
    half = 1 << (bits - 1)
    power = 0
    while total:
        digit = (total + half) % (1 << bits) - half
        total = (total - digit) >> bits
        if digit:
            # The sum was scaled by a^2 per crossing, a = A², and by A for each crossing.
            of_a = 2 * (power - 2 * count) - count - 3 * diagram.writhe
            result[-of_a // 4] = -digit if diagram.writhe % 2 else digit
        power += 1
    return dict(sorted(result.items()))


def chirality_sign(jones: Polynomial) -> int:
    """Return 1 for right, −1 for left, 0 where both mirror images have this Jones polynomial.

    A chiral knot is right-handed where the lowest and the highest power of its Jones polynomial
    have a positive sum (right-handed trefoil: t + t³ − t⁴, sum 5), left-handed where it is
    negative. Where the sum is 0, the first power at which V(t) and V(1/t) differ, counted outward
    from 0, decides: the right-handed knot has the larger coefficient at the positive power. Where
    V(t) = V(1/t), the diagram in the table is right-handed by definition.
    """
    span = min(jones) + max(jones)
    if span:
        return 1 if span > 0 else -1
    for power in range(1, max(jones) + 1):
        difference = jones.get(power, 0) - jones.get(-power, 0)
        if difference:
            return 1 if difference > 0 else -1
    return 0


def _bracket(pd: tuple[tuple[int, int, int, int], ...], bits: int) -> int:
    """Return Kauffman's bracket of the diagram, cut open at one edge, as one packed integer.

    Coefficients of a = A² are digits in base 2^bits; each crossing contributes a factor A·a² so
    that no power is negative.
    """
    rows = [list(row) for row in pd]
    cut = next(row for row in rows if 1 in row)
    cut[cut.index(1)] = 0
    states: dict[_State, int] = {(): 1}
    frontier: set[int] = set()
    while rows:
        row = max(rows, key=lambda r: sum(edge in frontier for edge in r))
        rows.remove(row)
        i, j, k, l = row  # noqa: E741 - KnotTheory's names for the edges of X[i,j,k,l]
        frontier ^= {edge for edge in row if row.count(edge) == 1}
        following: dict[_State, int] = {}
        for state, value in states.items():
            for power, arcs in ((3, ((i, j), (k, l))), (2, ((i, l), (j, k)))):
                joined, loops = _joined(state, arcs)
                term = value << (power - loops) * bits
                for _ in range(loops):
                    term = -(term + (term << 2 * bits))
                following[joined] = following.get(joined, 0) + term
        states = following
    return next(iter(states.values()))


def _joined(state: _State, arcs: tuple[tuple[int, int], ...]) -> tuple[_State, int]:
    """Return the matching of loose ends after arcs were added, and the number of closed loops."""
    other: dict[int, int] = {}
    for tail, head in state:
        other[tail], other[head] = head, tail
    loops = 0
    for tail, head in arcs:
        if tail == head or other.get(tail) == head:
            loops += 1
            other.pop(tail, None)
            other.pop(head, None)
            continue
        start, end = other.pop(tail, tail), other.pop(head, head)
        other[start], other[end] = end, start
    return tuple(sorted((tail, head) for tail, head in other.items() if tail < head)), loops


Matrices = NDArray[np.int64]
Signature = tuple[tuple[tuple[int, int], int], ...]
"""Sorted ((a, b), number of occurrences)."""

REPRESENTATIONS = ((5, 2), (7, 2), (5, 0), (7, 0), (11, 2), (7, 3), (13, 2), (11, 0), (11, 3))
"""(prime, trace of M), in order of use: fast and distinguishing ones first."""


def matching_candidates(
    diagram: Diagram, candidates: Sequence[tuple[Factor, ...]]
) -> list[tuple[Factor, ...]]:
    """Return the candidates (sums of table knots) that the representations do not exclude."""
    remaining = list(candidates)
    for modulus, trace in REPRESENTATIONS:
        if len(remaining) < 2:
            break
        own = longitude_counts(diagram, modulus, trace)
        remaining = [factors for factors in remaining if _of_sum(factors, modulus, trace) == own]
    return remaining


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
    """Return how often each longitude occurs among the representations in SL(2, modulus).

    All homomorphisms of the knot group to SL(2, p) are counted that map a fixed meridian m to a
    fixed matrix M. The longitude ℓ of m commutes with m, so its image is a + bM. The number of
    occurrences of each pair (a, b) is an invariant of the knot. It does not depend on orientation.
    The mirror image has (a + b·tr M, −b) instead, so the invariant detects chirality.
    """
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
    counts = Counter(zip(longitude[:, 0, 0].tolist(), longitude[:, 1, 0].tolist(), strict=True))
    return tuple(sorted(counts.items()))


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


_TILTS = ((0.0137, 0.0071), (-0.0523, 0.0911), (0.313, -0.177), (-1.37, -0.853), (7.1, 3.3))
"""Leans of the directions of view from straight above; none is aligned with a grid."""


def curve_diagram(points: Points, *, closed: bool = False) -> Diagram:
    """Return a diagram of a curve's knot; an open curve is closed far above itself.

    Raises KnotError where the curve meets itself.
    """
    curve = validated_curve(points, closed=closed)
    if len(curve) < 3:
        return Diagram(SignedGauss((), closed=True))
    if not closed:
        curve = close_upward(curve)
    reason: KnotError | None = None
    for tilt in _TILTS:
        try:
            return Diagram(curve_gauss(curve, closed=True, tilt=tilt))
        except KnotError as error:
            reason = error
    how = "" if closed else ", closed straight up from its ends,"
    raise KnotError(f"the curve{how} is degenerate from every side: {reason}")


def close_upward(curve: Points) -> Points:
    """Return an open curve with both ends extended straight up and joined far above it."""
    top = float(np.max(curve[:, 2]) + np.max(np.ptp(curve, axis=0)) + 1.0)
    up = np.array([[0.0, 0.0, 1.0]])
    ends = curve[[-1, 0]] + up * (top - curve[[-1, 0], 2:])
    return np.concatenate([curve, ends])


MAX_TABLE_CROSSINGS = 10
"""Every knot with a diagram of at most so many crossings is in the table, or a sum of its knots."""

MAX_SEARCHED_CROSSINGS = 64
"""Parts with more crossings are not simplified further and have no polynomials."""

_KICKS = 60
"""Reroutings of equal length in the simplification of a part with more than ten crossings."""

_MOST_KICKED = 300
"""Most crossings of a part for these: 227 take 13 s, and a part stays that large afterwards."""

_MOVES, _VIEWS = 50_000, 60
"""Moves of the grid search for such a part, and grid diagrams of it that are simplified."""

Sum = tuple[Factor, ...]


@dataclass(frozen=True)
class Identification:
    """The result of the identification of a knot.

    ``name`` is KnotInfo's name ("3_1", "0_1", sums as "3_1#m3_1") or "unknown". ``chirality`` is
    "left", "right", or "none" for the unknot and a knot that equals its mirror image; for an
    unknown knot it follows from the Jones polynomial, and is "none" where that is symmetric.
    ``crossings`` is an upper bound of the crossing number.
    ``candidates`` are the knots that agree with all invariants, with a leading m for a left-handed
    knot; one if the knot is known. ``invariants`` holds "jones" and "alexander" as {power:
    coefficient}, and "determinant"; None where a part has more than ``MAX_SEARCHED_CROSSINGS``.
    """

    name: str
    chirality: str
    crossings: int
    candidates: tuple[str, ...]
    invariants: dict[str, Any] = field(default_factory=dict)

    @property
    def known(self) -> bool:
        """Whether the knot has a name."""
        return self.name != "unknown"

    def __str__(self) -> str:
        """Return name and chirality in words."""
        hand = "" if self.chirality == "none" else f", {self.chirality}-handed"
        perhaps = "" if self.known else " or ".join(self.candidates)
        return f"{self.name}{hand}" + (f", perhaps {perhaps}" if perhaps else "")


def identify_curve(points: Points, *, closed: bool = False) -> Identification:
    """Return the knot of a curve (n, 3) in space; an open curve is closed far above itself.

    Degenerate views (collinear, axis-parallel, repeated points) are replaced by views from another
    direction. Raises KnotError where the curve meets itself, has fewer than 3 different points, or
    is not an (n, 3) array of finite numbers.
    """
    curve = validated_curve(points, closed=closed)
    defect = find_defect(points, closed=closed)
    if defect:
        raise defect
    return identify_diagram(curve_diagram(curve, closed=closed))


def identify_diagram(diagram: Diagram) -> Identification:
    """Return the knot of a diagram. Deterministic."""
    parts = minimal_summands(diagram)
    invariants = _report(parts)
    if invariants["jones"] is None:
        crossings = sum(part.crossings for part in parts)
        return Identification("unknown", "none", crossings, (), invariants)
    choices = [_candidates(part) for part in parts]
    sums = {
        canonical_factors(itertools.chain.from_iterable(choice))
        for choice in itertools.product(*choices)
    }
    listed = sorted(sums, key=lambda knot: [(*table_order(name), -hand) for name, hand in knot])
    if all(part.crossings <= MAX_TABLE_CROSSINGS for part in parts) and len(listed) == 1:
        name, chirality = name_of_sum(listed[0])
        crossings = sum(prime_knot(name).crossings for name, _ in listed[0])
        return Identification(name, chirality, crossings, (_marked(listed[0]),), invariants)
    crossings = sum(part.crossings for part in parts)
    candidates = tuple(_marked(knot) for knot in listed)
    chirality = CHIRALITIES[chirality_sign(invariants["jones"])]
    return Identification("unknown", chirality, crossings, candidates, invariants)


def minimal_summands(diagram: Diagram) -> tuple[Diagram, ...]:
    """Return the visible summands of a diagram, each simplified.

    A part with more than ten crossings is also drawn as random grid diagrams, whose diagrams may be
    smaller.
    """
    parts = summands(simplified(diagram))
    result: list[Diagram] = []
    for part in parts:
        if part.crossings <= MAX_TABLE_CROSSINGS or part.crossings > _MOST_KICKED:
            result.append(part)
        else:
            result.extend(_smaller(part))
    return tuple(result)


def _smaller(part: Diagram) -> tuple[Diagram, ...]:
    """Return the summands of a part with more than ten crossings after a longer search."""
    best = summands(simplified(part, kicks=_KICKS))
    most = max((summand.crossings for summand in best), default=0)
    if most <= MAX_TABLE_CROSSINGS or most > MAX_SEARCHED_CROSSINGS or _is_minimal(best):
        return best
    grid = minimise_grid(grid_of_diagram(part), moves=_MOVES)
    for other in itertools.islice(random_grids(grid), _VIEWS):
        view = summands(simplified(Diagram(other.code)))
        if sum(summand.crossings for summand in view) < sum(summand.crossings for summand in best):
            best = view
        if all(summand.crossings <= MAX_TABLE_CROSSINGS for summand in best) or _is_minimal(best):
            break
    return best


def _is_minimal(parts: tuple[Diagram, ...]) -> bool:
    """Return whether the diagrams have the crossing numbers of their knots.

    Reduced alternating diagrams have (Kauffman, Murasugi, Thistlethwaite 1987).
    """
    return all(part.alternating for part in parts)


def _marked(factors: Sum) -> str:
    return "#".join(f"m{name}" if hand < 0 else name for name, hand in factors) or "0_1"


def _report(parts: tuple[Diagram, ...]) -> dict[str, Any]:
    if any(part.crossings > MAX_SEARCHED_CROSSINGS for part in parts):
        return {"jones": None, "alexander": None, "determinant": None}
    of_jones: dict[int, int] = {0: 1}
    of_alexander: dict[int, int] = {0: 1}
    for part in parts:
        of_jones, of_alexander = (
            _times(of_jones, jones_polynomial(part)),
            _times(of_alexander, alexander_polynomial(part)),
        )
    determinant = abs(sum(-c if power % 2 else c for power, c in of_alexander.items()))
    return {
        "jones": dict(sorted(of_jones.items())),
        "alexander": dict(sorted(of_alexander.items())),
        "determinant": determinant,
    }


def summands(diagram: Diagram) -> tuple[Diagram, ...]:
    """Return the parts of a diagram that only two strands connect, each closed by itself."""
    passes = list(diagram.code.passes)
    count = len(passes)
    for start in range(count):
        open_labels: set[int] = set()
        for length in range(1, count):
            open_labels ^= {passes[(start + length - 1) % count][0]}
            if not open_labels:
                turned = passes[start:] + passes[:start]
                inner, outer = (
                    Diagram(SignedGauss.of(part, closed=True))
                    for part in (turned[:length], turned[length:])
                )
                return summands(inner) + summands(outer)
    return (diagram,) if count else ()


def _candidates(part: Diagram) -> list[Sum]:
    """Return all sums of table knots with a part's invariants and at most its crossings."""
    key = (_key(jones_polynomial(part)), _key(alexander_polynomial(part)))
    fitting = [
        sums
        for sums in _index().get(key, [])
        if sum(prime_knot(name).crossings for name, _ in sums) <= part.crossings
    ]
    return matching_candidates(part, fitting) if len(fitting) > 1 else fitting


def _key(polynomial: Polynomial) -> Laurent:
    return tuple(sorted(polynomial.items()))


@lru_cache(maxsize=1)
def _index() -> dict[tuple[Laurent, Laurent], list[Sum]]:
    """Return Jones and Alexander polynomials → knots, for every knot to ten crossings."""
    primes: list[Sum] = [
        ((name, hand),)
        for name, knot in knot_table().items()
        for hand in ((1, -1) if knot.chiral else (0,))
    ]
    index: dict[tuple[Laurent, Laurent], list[Sum]] = {}
    for sums in [(), *primes, *_composites(primes)]:
        index.setdefault(polynomials(sums), []).append(sums)
    return index


def _composites(primes: list[Sum]) -> list[Sum]:
    """Return all sums of two or three knots with at most ten crossings in total."""
    small = [knot for knot in primes if prime_knot(knot[0][0]).crossings <= MAX_TABLE_CROSSINGS - 3]
    sums = {
        canonical_factors(itertools.chain.from_iterable(choice))
        for count in (2, 3)
        for choice in itertools.combinations_with_replacement(small, count)
        if sum(prime_knot(knot[0][0]).crossings for knot in choice) <= MAX_TABLE_CROSSINGS
    }
    return sorted(sums)


def polynomials(factors: Sum) -> tuple[Laurent, Laurent]:
    """Return the Jones and Alexander polynomials of a sum: products over its summands."""
    of_jones: dict[int, int] = {0: 1}
    of_alexander: dict[int, int] = {0: 1}
    for name, hand in factors:
        knot = prime_knot(name)
        turn = -1 if hand < 0 else 1
        of_jones = _times(of_jones, {turn * power: c for power, c in knot.jones})
        of_alexander = _times(of_alexander, dict(knot.alexander))
    return _key(of_jones), _key(of_alexander)


def _times(first: Polynomial, second: Polynomial) -> dict[int, int]:
    result: dict[int, int] = {}
    for (p, a), (q, b) in itertools.product(first.items(), second.items()):
        result[p + q] = result.get(p + q, 0) + a * b
    return {power: c for power, c in result.items() if c}
