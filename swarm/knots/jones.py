"""The Jones polynomial of a diagram, from Kauffman's bracket contracted crossing by crossing."""

from collections.abc import Mapping

from swarm.knots.diagram import Diagram

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
    for one, two in state:
        other[one], other[two] = two, one
    loops = 0
    for one, two in arcs:
        if one == two or other.get(one) == two:
            loops += 1
            other.pop(one, None)
            other.pop(two, None)
            continue
        start, end = other.pop(one, one), other.pop(two, two)
        other[start], other[end] = end, start
    return tuple(sorted((one, two) for one, two in other.items() if one < two)), loops
