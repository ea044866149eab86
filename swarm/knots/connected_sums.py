"""Names of knots and their connected sums, with the hand of every summand."""

from collections.abc import Iterable

Factor = tuple[str, int]
"""A prime knot's name, and its hand: 1 right, −1 left, 0 where it is its own mirror image."""

CHIRALITIES = {1: "right", -1: "left", 0: "none"}


def table_order(name: str) -> tuple[int, int]:
    """Sort key of a table name such as 10_132."""
    crossings, number = name.split("_")
    return int(crossings), int(number)


def mirror_factors(factors: Iterable[Factor]) -> tuple[Factor, ...]:
    """The mirror image of a sum."""
    return canonical_factors((name, -hand) for name, hand in factors)


def canonical_factors(factors: Iterable[Factor]) -> tuple[Factor, ...]:
    """A sum's prime factors in the order of the table, right-handed ones first."""
    return tuple(sorted(factors, key=lambda factor: (table_order(factor[0]), -factor[1])))


def name_of_sum(factors: Iterable[Factor]) -> tuple[str, str]:
    """Name and chirality of a sum, such as ("3_1#m3_1", "none") or ("3_1#5_2", "left").

    Of a chiral sum and its mirror image, the right-handed one has the larger hand at the first
    summand where they differ; its left-handed summands are marked m.
    """
    own = canonical_factors(factors)
    other = mirror_factors(own)
    right = max(own, other, key=lambda sums: [hand for _, hand in sums])
    chirality = "none" if own == other else CHIRALITIES[1 if own == right else -1]
    name = "#".join(f"m{name}" if hand < 0 else name for name, hand in right)
    return name or "0_1", chirality
