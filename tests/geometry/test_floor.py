"""Strands on the floor against quadrature, the weight off the floor, and the limit of free strands."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad

from swarm.geometry.catenary import FloorStrands, OverStretched, rest_on_floor, solve_catenaries

CASES = [(1.0, 1.0, 5.0), (1.0, 0.3, 4.6), (0.05, 0.02, 4.001), (0.0, 1.0, 4.2), (2.0, 1.0, 6.5)]


@pytest.mark.parametrize(("low", "high", "length"), CASES)
def test_equilibrium_and_closure_by_quadrature(low: float, high: float, length: float) -> None:
    """From the touching points up, the tangent is (1, s/a); the pieces must add up."""
    strand = rest_on_floor([0.0, 0.0, low + 7.0], [0.0, 4.0, high + 7.0], length, 7.0)
    assert strand.touching
    a = float(strand.parameter)
    reach = 0.0
    for lifted, height in ((strand.lifted_start, low), (strand.lifted_end, high)):
        across, _ = quad(lambda s: 1 / np.hypot(1, s / a), 0, lifted, epsabs=1e-13)
        up, _ = quad(lambda s: s / a / np.hypot(1, s / a), 0, lifted, epsabs=1e-13)
        assert up == pytest.approx(height, abs=1e-11)
        reach += across
    assert reach + float(strand.lying) == pytest.approx(4.0, abs=1e-10)
    assert float(strand.lifted_start + strand.lifted_end + strand.lying) == pytest.approx(length)


def test_loose_cable_hangs_straight_down() -> None:
    strand = rest_on_floor([0.0, 0.0, 1.0], [4.0, 0.0, 0.5], 7.0)
    assert strand.parameter == 0.0
    assert strand.lying == pytest.approx(5.5)
    points = strand.points([0.0, 1.0 / 14.0, 1.0 / 7.0, 6.5 / 7.0, 1.0])
    expected = [[0, 0, 1], [0, 0, 0.5], [0, 0, 0], [4, 0, 0], [4, 0, 0.5]]
    np.testing.assert_allclose(points, expected, atol=1e-12)
    np.testing.assert_allclose(strand.end_forces(0.1, gravity=10.0), [[0, 0, -1.0], [0, 0, -0.5]])


def test_strands_above_the_floor_are_catenaries() -> None:
    free = solve_catenaries([0.0, 0.0, 3.0], [4.0, 0.0, 3.5], 5.0)
    strand = rest_on_floor(free.start, free.end, 5.0, 1.0)
    fractions = np.linspace(0.0, 1.0, 9)
    assert not strand.touching
    np.testing.assert_array_equal(strand.points(fractions), free.points(fractions))
    np.testing.assert_array_equal(strand.end_forces(0.1), free.end_forces(0.1))
    assert strand.lying == 0.0


def test_lifting_off_is_continuous() -> None:
    free = solve_catenaries([0.0, 0.0, 0.0], [4.0, 0.0, 0.7], 5.0)
    touch = float(free.lowest()[2])
    fractions = np.linspace(0.0, 1.0, 33)
    resting = rest_on_floor(free.start, free.end, 5.0, touch + 1e-9)
    assert resting.touching
    np.testing.assert_allclose(resting.points(fractions), free.points(fractions), atol=1e-4)
    np.testing.assert_allclose(resting.end_forces(1.0), free.end_forces(1.0), rtol=1e-4, atol=1e-9)


def test_batches_mix_free_and_resting_strands() -> None:
    starts = np.array([[0.0, 0, 0.5], [0, 0, 5.0], [0, 0, 0.2]])
    ends = starts + np.array([3.0, 1.0, 0.0])
    strands = rest_on_floor(starts, ends, [3.4, 3.4, 9.0])
    np.testing.assert_array_equal(strands.touching, [True, False, True])
    fractions = np.linspace(0.0, 1.0, 6)
    for i in range(3):
        alone = rest_on_floor(starts[i], ends[i], [3.4, 3.4, 9.0][i])
        np.testing.assert_allclose(
            strands.points(fractions)[i], alone.points(fractions), atol=1e-12
        )


def test_impossible_strands_are_refused() -> None:
    with pytest.raises(ValueError, match="below the floor"):
        rest_on_floor([0.0, 0.0, 0.5], [1.0, 0.0, 2.0], 3.0, 1.0)
    with pytest.raises(OverStretched):
        rest_on_floor([0.0, 0.0, 1.0], [4.0, 0.0, 1.0], 3.0)


heights = st.floats(0.0, 3.0)


@st.composite
def strands(draw: st.DrawFn) -> FloorStrands:
    start = np.array([0.0, 0.0, draw(heights)])
    end = np.array([draw(st.floats(-5.0, 5.0)), draw(st.floats(-5.0, 5.0)), draw(heights)])
    slack = 10.0 ** draw(st.floats(-4.0, 0.5))
    return rest_on_floor(start, end, (np.linalg.norm(end - start) + 0.01) * (1.0 + slack))


@given(strands())
def test_shape_is_above_the_floor_and_of_its_length(strand: FloorStrands) -> None:
    points = strand.points(np.linspace(0.0, 1.0, 3001))
    assert points[:, 2].min() >= -1e-9
    np.testing.assert_allclose(points[0], strand.free.start, atol=1e-9)
    np.testing.assert_allclose(points[-1], strand.free.end, atol=1e-9)
    arcs = np.linalg.norm(np.diff(points, axis=0), axis=1)
    length = float(strand.free.length)
    assert np.all(arcs <= length / 3000 * (1.0 + 1e-9))
    if strand.parameter > 0.0 or not strand.touching:  # no cable lies loose
        assert arcs.sum() == pytest.approx(length, rel=3e-3)


@given(strands(), st.floats(0.01, 1.0))
def test_forces_carry_the_weight_off_the_floor(strand: FloorStrands, mass: float) -> None:
    at_start, at_end = strand.end_forces(mass, 10.0)
    lifted = float(strand.free.length - strand.lying)
    largest = np.linalg.norm(at_start) + np.linalg.norm(at_end)
    np.testing.assert_allclose(
        at_start + at_end, [0.0, 0.0, -10.0 * mass * lifted], atol=1e-8 * (largest + 1.0)
    )
    # the tension is that of the level part, and the weight of the cable below: a·cosh θ = a + height
    heights = np.array([strand.free.start[2], strand.free.end[2]])
    sizes = 10.0 * mass * (strand.parameter + heights)
    if not strand.touching:
        sizes = np.array(strand.free.tension(mass, 10.0)[1:])
    found = np.linalg.norm([at_start, at_end], axis=1)
    np.testing.assert_allclose(found, sizes, rtol=1e-6, atol=1e-9)
