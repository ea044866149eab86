"""The convention for the chirality of a knot: which mirror image is right-handed.

A chiral knot is right-handed where the lowest and the highest power of its Jones polynomial have a
positive sum (right-handed trefoil: t + t³ − t⁴, sum 5), left-handed where it is negative. Where the
sum is 0, the first power at which V(t) and V(1/t) differ, counted outward from 0, decides: the
right-handed knot has the larger coefficient at the positive power. Where V(t) = V(1/t), the diagram
in the table is right-handed by definition.
"""

from collections.abc import Mapping

AMPHICHIRAL = frozenset(
    [
        "4_1",
        "6_3",
        "8_3",
        "8_9",
        "8_12",
        "8_17",
        "8_18",
        "10_17",
        "10_33",
        "10_37",
        "10_43",
        "10_45",
        "10_79",
        "10_81",
        "10_88",
        "10_99",
        "10_109",
        "10_115",
        "10_118",
        "10_123",
    ]
)
"""The prime knots to ten crossings that equal their mirror images."""


def chirality_sign(jones: Mapping[int, int]) -> int:
    """Return 1 for right, −1 for left, 0 where both mirror images have this Jones polynomial."""
    span = min(jones) + max(jones)
    if span:
        return 1 if span > 0 else -1
    for power in range(1, max(jones) + 1):
        difference = jones.get(power, 0) - jones.get(-power, 0)
        if difference:
            return 1 if difference > 0 else -1
    return 0


def is_right_handed(jones: Mapping[int, int]) -> bool:
    """Return whether the Jones polynomial determines a right-handed knot."""
    return chirality_sign(jones) > 0
