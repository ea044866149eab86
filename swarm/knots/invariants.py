"""Which knot is this? From a diagram or from a curve in space.

The answer is sound, not only likely: a diagram is first made as small as it will go and split into
its visible summands. A part with at most ten crossings can only be a knot of the table (or a sum
of such), so the invariants need to tell only those apart, with chirality. A part that keeps more
crossings might be any knot, so it stays ``unknown``, with the table's knots that share its
invariants as candidates.
"""

import itertools
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

from swarm.knots.alexander import alexander
from swarm.knots.curve import Points
from swarm.knots.diagram import Diagram
from swarm.knots.gauss import SignedGauss
from swarm.knots.groups import separated
from swarm.knots.jones import Polynomial, jones
from swarm.knots.shorten import curve_diagram
from swarm.knots.simplify import simplified
from swarm.knots.sums import Factor, canonical, mirrored, named, order
from swarm.knots.table import Laurent, prime, table

MOST_CROSSINGS = 10
"""Every knot with a diagram of this many crossings is in the table, or a sum of its knots."""

Sum = tuple[Factor, ...]


@dataclass(frozen=True)
class Identification:
    """What a knot was found to be.

    ``name`` is KnotInfo's name ("3_1", "0_1", sums as "3_1#m3_1") or "unknown". ``chirality`` is
    "left", "right", or "none" for a knot that is its own mirror image, and for the unknot; it is
    "none" too while the knot is unknown. ``crossings`` is an upper bound of the crossing number.
    ``candidates`` are the knots that agree with everything computed, with a leading m where the
    left-handed one is meant; one if the knot is known. ``invariants`` holds "jones" and "alexander"
    as {power: coefficient}, and "determinant".
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
        """Name and chirality in words."""
        if self.known:
            return (
                self.name if self.chirality == "none" else f"{self.name}, {self.chirality}-handed"
            )
        if self.candidates:
            return f"unknown, perhaps {' or '.join(self.candidates)}"
        return "unknown"


def identify_curve(points: Points, *, closed: bool = False) -> Identification:
    """Name the knot of a curve (n, 3) in space; an open one is closed straight up, above itself.

    Degenerate curves (collinear, axis-parallel, repeated points) are looked at from a direction in
    which they are not. Raises KnotError where the curve meets itself, or is not a curve at all.
    """
    return identify_diagram(curve_diagram(points, closed=closed))


def identify_diagram(diagram: Diagram) -> Identification:
    """Name the knot of a diagram."""
    small = simplified(diagram, kicks=20)
    parts = summands(small)
    found = [_candidates(part) for part in parts]
    invariants = _report(small)
    sums = {
        canonical(itertools.chain.from_iterable(choice)) for choice in itertools.product(*found)
    }
    listed = sorted(sums, key=lambda one: [(*order(name), -hand) for name, hand in one])
    certain = all(part.crossings <= MOST_CROSSINGS for part in parts)
    if certain and len(listed) == 1:
        name, chirality = named(listed[0])
        crossings = sum(prime(name).crossings for name, _ in listed[0])
        return Identification(name, chirality, crossings, (_marked(listed[0]),), invariants)
    candidates = tuple(_marked(one) for one in listed)
    return Identification("unknown", "none", small.crossings, candidates, invariants)


def _marked(factors: Sum) -> str:
    return "#".join(f"m{name}" if hand < 0 else name for name, hand in factors) or "0_1"


def _report(diagram: Diagram) -> dict[str, Any]:
    polynomial = alexander(diagram)
    determinant = abs(sum(c * (-1) ** power for power, c in polynomial.items()))
    return {"jones": jones(diagram), "alexander": polynomial, "determinant": determinant}


def summands(diagram: Diagram) -> tuple[Diagram, ...]:
    """The parts of a diagram that hang together by two strands only, each closed by itself."""
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
    """All sums of table knots that share a part's invariants and fit into its crossings."""
    key = (_key(jones(part)), _key(alexander(part)))
    fitting = [
        sums
        for sums in _index().get(key, [])
        if sum(prime(name).crossings for name, _ in sums) <= part.crossings
    ]
    return separated(part, fitting) if len(fitting) > 1 else fitting


def _key(polynomial: Polynomial) -> Laurent:
    return tuple(sorted(polynomial.items()))


@lru_cache(maxsize=1)
def _index() -> dict[tuple[Laurent, Laurent], list[Sum]]:
    """Jones and Alexander polynomials → knots, for every knot with at most ten crossings."""
    primes: list[Sum] = [
        ((name, hand),)
        for name, knot in table().items()
        for hand in ((1, -1) if knot.chiral else (0,))
    ]
    index: dict[tuple[Laurent, Laurent], list[Sum]] = {}
    for sums in [(), *primes, *_composites(primes)]:
        index.setdefault(polynomials(sums), []).append(sums)
    return index


def _composites(primes: list[Sum]) -> list[Sum]:
    """All sums of two or three knots that have at most ten crossings together."""
    small = [one for one in primes if prime(one[0][0]).crossings <= MOST_CROSSINGS - 3]
    found = {
        canonical(itertools.chain.from_iterable(choice))
        for count in (2, 3)
        for choice in itertools.combinations_with_replacement(small, count)
        if sum(prime(one[0][0]).crossings for one in choice) <= MOST_CROSSINGS
    }
    return sorted(found)


def polynomials(factors: Sum) -> tuple[Laurent, Laurent]:
    """Jones and Alexander polynomials of a sum: products of its summands'."""
    of_jones: dict[int, int] = {0: 1}
    of_alexander: dict[int, int] = {0: 1}
    for name, hand in factors:
        knot = prime(name)
        turn = -1 if hand < 0 else 1
        of_jones = _times(of_jones, {turn * power: c for power, c in knot.jones})
        of_alexander = _times(of_alexander, dict(knot.alexander))
    return _key(of_jones), _key(of_alexander)


def _times(one: dict[int, int], two: dict[int, int]) -> dict[int, int]:
    result: dict[int, int] = {}
    for (p, a), (q, b) in itertools.product(one.items(), two.items()):
        result[p + q] = result.get(p + q, 0) + a * b
    return {power: c for power, c in result.items() if c}


__all__ = [
    "Identification",
    "identify_curve",
    "identify_diagram",
    "mirrored",
    "polynomials",
    "summands",
]
