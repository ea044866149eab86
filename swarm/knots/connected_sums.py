"""Names of knots and of connected sums, with the chirality of every summand."""

from collections.abc import Iterable

Factor = tuple[str, int]
"""Name of a prime knot and its chirality: 1 right, −1 left, 0 where it equals its mirror image."""

CHIRALITIES = {1: "right", -1: "left", 0: "none"}


def table_order(name: str) -> tuple[int, int]:
    """Return the sort key of a table name such as 10_132."""
    crossings, number = name.split("_")
    return int(crossings), int(number)


def mirror_factors(factors: Iterable[Factor]) -> tuple[Factor, ...]:
    """Return the mirror image of a sum."""
    return canonical_factors((name, -sign) for name, sign in factors)


def canonical_factors(factors: Iterable[Factor]) -> tuple[Factor, ...]:
    """Return the prime factors of a sum in the order of the table, right-handed ones first."""
    return tuple(sorted(factors, key=lambda factor: (table_order(factor[0]), -factor[1])))


def name_of_sum(factors: Iterable[Factor]) -> tuple[str, str]:
    """Return name and chirality of a sum, such as ("3_1#m3_1", "none") or ("3_1#5_2", "left").

    Of a chiral sum and its mirror image, the right-handed one has the larger chirality (1 > −1) at
    the first summand that differs. The name marks its left-handed summands with m.
    """
    own = canonical_factors(factors)
    other = mirror_factors(own)
    right = max(own, other, key=lambda sums: [sign for _, sign in sums])
    chirality = "none" if own == other else CHIRALITIES[1 if own == right else -1]
    name = "#".join(f"m{name}" if sign < 0 else name for name, sign in right)
    return name or "0_1", chirality
