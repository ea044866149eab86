"""The code of a curve's plan view against exact arithmetic, and degenerate views."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from swarm.knots.curve import curve_gauss
from swarm.knots.gauss import KnotError, same_code
from swarm.knots.grid import openings
from swarm.knots.table import knot_table
from tests.knots.curves import Points, exact_code, hung, random_polygon


@settings(deadline=None)
@given(seed=st.integers(0, 10**6), count=st.integers(3, 40), closed=st.booleans())
def test_codes_agree_with_exact_arithmetic(seed: int, count: int, closed: bool) -> None:
    points = random_polygon(seed, count)
    assert same_code(curve_gauss(points, closed=closed), exact_code(points, closed=closed))


@settings(deadline=None)
@given(seed=st.integers(0, 10**6), cuts=st.integers(1, 60))
def test_subdivision_and_repeated_points_change_nothing(seed: int, cuts: int) -> None:
    points = random_polygon(seed, 12)
    rng = np.random.default_rng(seed)
    segment, share = rng.integers(0, 11, cuts), rng.uniform(0, 1, cuts).round(1)
    cut = points[segment] + share[:, None] * (points[segment + 1] - points[segment])
    order = np.argsort(np.concatenate([np.arange(12.0), segment + share]), kind="stable")
    finer = np.concatenate([points, cut])[order]
    assert same_code(curve_gauss(finer), curve_gauss(points))


def test_reversal_and_mirror() -> None:
    points = random_polygon(5, 20)
    code = curve_gauss(points)
    assert code.crossings > 5
    assert same_code(curve_gauss(points[::-1]), code.reversed())
    assert same_code(curve_gauss(points * [-1, 1, 1]), code.mirrored())


@pytest.mark.parametrize("name", ["3_1", "4_1", "8_18", "10_123"])
def test_a_cable_hung_in_its_grid_has_the_grids_code(name: str) -> None:
    for opened in openings(knot_table()[name].grid, limit=6):
        code = opened.code
        assert code.crossings == len(opened.crossings)
        for samples in (2, 21, 24):
            # With an even number of cells and samples, vertices lie right on other strands.
            assert same_code(curve_gauss(hung(opened, samples=samples)), code)
        wrong = hung(opened, over=-0.5, under=0.5)
        assert not same_code(curve_gauss(wrong), code)


def cross(height: float, shift: float = 0.0) -> Points:
    """A strand along x, a detour, and a strand along y at x = 1 + shift."""
    return np.array(
        [
            [0, 0, 0],
            [1, 0, 0],
            [2, 0, 0],
            [2, 2, 0],
            [1 + shift, 2, height],
            [1 + shift, -1, height],
        ]
    )


def test_a_vertex_right_under_a_strand_is_one_crossing() -> None:
    code = curve_gauss(cross(1.0))
    assert code.text() == "1- 1+"
    assert same_code(code, curve_gauss(cross(1.0, 0.1)))


def test_strands_that_meet_in_space() -> None:
    with pytest.raises(KnotError, match=r"two strands meet in space at \(1\.1, .*0\)"):
        curve_gauss(cross(0.0, 0.1))


@pytest.mark.parametrize(
    "points",
    [
        # A strand on top of another for a while.
        [[0, 0, 0], [4, 0, 0], [4, 1, 0], [3, 0, 1], [1, 0, 1], [1, 1, 1]],
        # A corner that touches a strand and goes back.
        [[0, 0, 0], [4, 0, 0], [4, 2, 0], [3, 2, 1], [2, 0, 1], [1, 2, 1]],
        # A plumb segment through whose plan another strand goes, between its ends.
        [[0, 0, 0], [1, 0, 0], [1, 0, 2], [2, 0, 2], [2, 2, 1], [1, 1, 1], [1, -1, 1]],
    ],
)
def test_degenerate_views_are_refused(points: list[list[float]]) -> None:
    with pytest.raises(KnotError, match="degenerate"):
        curve_gauss(np.array(points, dtype=float))


def test_vertical_segments_away_from_strands_are_valid() -> None:
    plain = cross(1.0, 0.1)
    plumb = np.concatenate([plain[:3], [[2, 0, 0.25], [2, 0, 0.5]], plain[3:]])
    assert same_code(curve_gauss(plumb), curve_gauss(plain))


@pytest.mark.parametrize(
    ("points", "message"),
    [
        (np.zeros((4, 2)), "a curve is an (n, 3) array, got shape (4, 2)"),
        (np.zeros((1, 3)), "a curve needs at least 2 points, got 1"),
        (np.array([[0, 0, 0], [1, np.nan, 0]]), "point 2 of the curve is not finite"),
    ],
)
def test_invalid_arrays(points: Points, message: str) -> None:
    with pytest.raises(KnotError) as caught:
        curve_gauss(points)
    assert str(caught.value) == message


def test_short_curves_have_no_crossings() -> None:
    assert curve_gauss(np.array([[0.0, 0, 0], [1, 1, 1]])).passes == ()
    assert curve_gauss(np.zeros((5, 3))).passes == ()
    assert curve_gauss(np.zeros((5, 3)), closed=True).closed
