"""Identification of the knot of a diagram or of a curve in space.

The result is exact, not only likely. A diagram is first simplified and split into its visible
summands. A part with at most ten crossings can only be a knot of the table or a sum of such knots,
so the invariants have to distinguish only those, with chirality. A part with more crossings can be
any knot: it is ``unknown``, and the table's knots with the same invariants are candidates.
"""

import itertools
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np

from swarm.knots.alexander import alexander_polynomial
from swarm.knots.chirality import chirality_sign
from swarm.knots.connected_sums import (
    CHIRALITIES,
    Factor,
    canonical_factors,
    name_of_sum,
    table_order,
)
from swarm.knots.curve import Points, curve_gauss, validated_curve
from swarm.knots.curve_defects import find_defect
from swarm.knots.diagram import Diagram
from swarm.knots.gauss import KnotError, SignedGauss
from swarm.knots.grid_drawing import grid_of_diagram
from swarm.knots.grid_search import minimise_grid, random_grids
from swarm.knots.group_representations import matching_candidates
from swarm.knots.jones import Polynomial, jones_polynomial
from swarm.knots.simplify import simplified
from swarm.knots.table import Laurent, knot_table, prime_knot

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
    wrong = find_defect(points, closed=closed)
    if wrong:
        raise wrong.error()
    return identify_diagram(curve_diagram(curve, closed=closed))


def identify_diagram(diagram: Diagram) -> Identification:
    """Return the knot of a diagram. Deterministic."""
    parts = minimal_summands(diagram)
    invariants = _report(parts)
    if invariants["jones"] is None:
        crossings = sum(part.crossings for part in parts)
        return Identification("unknown", "none", crossings, (), invariants)
    found = [_candidates(part) for part in parts]
    sums = {
        canonical_factors(itertools.chain.from_iterable(choice))
        for choice in itertools.product(*found)
    }
    listed = sorted(sums, key=lambda one: [(*table_order(name), -hand) for name, hand in one])
    if all(part.crossings <= MAX_TABLE_CROSSINGS for part in parts) and len(listed) == 1:
        name, chirality = name_of_sum(listed[0])
        crossings = sum(prime_knot(name).crossings for name, _ in listed[0])
        return Identification(name, chirality, crossings, (_marked(listed[0]),), invariants)
    crossings = sum(part.crossings for part in parts)
    candidates = tuple(_marked(one) for one in listed)
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
    most = max((one.crossings for one in best), default=0)
    if most <= MAX_TABLE_CROSSINGS or most > MAX_SEARCHED_CROSSINGS or _is_minimal(best):
        return best
    grid = minimise_grid(grid_of_diagram(part), moves=_MOVES)
    for other in itertools.islice(random_grids(grid), _VIEWS):
        view = summands(simplified(Diagram(other.code)))
        if sum(one.crossings for one in view) < sum(one.crossings for one in best):
            best = view
        if all(one.crossings <= MAX_TABLE_CROSSINGS for one in best) or _is_minimal(best):
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
    small = [one for one in primes if prime_knot(one[0][0]).crossings <= MAX_TABLE_CROSSINGS - 3]
    found = {
        canonical_factors(itertools.chain.from_iterable(choice))
        for count in (2, 3)
        for choice in itertools.combinations_with_replacement(small, count)
        if sum(prime_knot(one[0][0]).crossings for one in choice) <= MAX_TABLE_CROSSINGS
    }
    return sorted(found)


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


def _times(one: Polynomial, two: Polynomial) -> dict[int, int]:
    result: dict[int, int] = {}
    for (p, a), (q, b) in itertools.product(one.items(), two.items()):
        result[p + q] = result.get(p + q, 0) + a * b
    return {power: c for power, c in result.items() if c}
