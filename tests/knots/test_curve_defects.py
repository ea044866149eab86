"""Curves without a knot, against exact arithmetic."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from swarm.knots.catalog import lookup_knot
from swarm.knots.curve import find_defect
from swarm.knots.gauss import KnotError
from swarm.knots.invariants import identify_curve
from tests.knots.curves import hung

Point = tuple[int, int, int]


def meets_exactly(points: list[Point], *, closed: bool) -> bool:
    """Whether a curve of different points after each other has two places in common."""
    ends = list(zip(points, points[1:] + points[:1], strict=True))
    segments = ends if closed else ends[:-1]
    count = len(segments)
    for i in range(count):
        for j in range(i + 1, count):
            shared = common(*segments[i], *segments[j])
            follows = j == i + 1 or (closed and (i, j) == (0, count - 1))
            if shared > 1 or (shared == 1 and not follows):
                return True
    return False


def common(a: Point, b: Point, c: Point, d: Point) -> int:
    """How many points two segments have in common: none, one, or more than one (2)."""
    one, two, to = (
        np.array(v, dtype=object) for v in (np.subtract(b, a), np.subtract(d, c), np.subtract(c, a))
    )
    normal = np.cross(one, two)
    if any(normal):
        if to @ normal:
            return 0
        size = normal @ normal
        s, t = (
            Fraction(np.cross(to, two) @ normal, size),
            Fraction(np.cross(to, one) @ normal, size),
        )
        return int(0 <= s <= 1 and 0 <= t <= 1)
    if any(np.cross(one, to)):
        return 0
    at = sorted([Fraction(to @ one, one @ one), Fraction((to + two) @ one, one @ one)])
    low, high = max(Fraction(0), at[0]), min(Fraction(1), at[1])
    return 0 if low > high else 1 if low == high else 2


@given(
    st.lists(st.tuples(*[st.integers(0, 3)] * 3), min_size=3, max_size=7),
    st.booleans(),
    st.sampled_from([1.0, 1e-90, 1e90, 0.3]),
)
def test_curves_on_a_lattice_meet_where_they_do_exactly(points, closed, scale):
    different = [p for p, before in zip(points, [None, *points], strict=False) if p != before]
    if closed and different[0] == different[-1]:
        different = different[:-1]
    found = find_defect(np.array(points, dtype=float) * scale, closed=closed)
    assert (found is not None) == (len(different) < 3 or meets_exactly(different, closed=closed))
    if found and len(different) >= 3:
        assert all(0 <= index < len(points) for index in found.points)


@pytest.mark.parametrize("name", ["3_1", "8_18", "10_132"])
def test_knots_have_no_defect(name):
    assert find_defect(hung(lookup_knot(name).opening), closed=False) is None


@pytest.mark.parametrize(
    ("points", "message"),
    [
        ([[0, 0, 0], [1, 2, 3]], "expected at least 3 different points, got 2"),
        ([[0, 0, 0]] * 5, "expected at least 3 different points, got 1"),
        (
            [[0, 0, 0], [1, 0, 0], [0.5, 0, 0]],
            "the curve goes back along itself from here (point 2)",
        ),
    ],
)
def test_a_curve_without_a_knot_is_refused(points, message):
    with pytest.raises(KnotError) as caught:
        identify_curve(np.array(points, dtype=float))
    assert str(caught.value) == message
