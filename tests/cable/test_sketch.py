"""The quick points of strands are those of the exact catenaries, and boxes contain them."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from swarm.cable.catenary import hang
from swarm.cable.sketch import boxes, sketch

FRACTIONS = np.linspace(0.0, 1.0, 21)
offset = st.floats(-10.0, 10.0)
slack = st.one_of(st.floats(0.0, 20.0), st.floats(0.0, 1e-6))


@given(offset, offset, offset, slack)
def test_a_sketch_is_within_a_micrometre_of_the_catenary(x, y, z, more):
    start, end = np.array([[1.0, -2.0, 5.0]]), np.array([[1.0 + x, -2.0 + y, 5.0 + z]])
    length = np.linalg.norm(end - start, axis=1) * (1.0 + 1e-9) + more + 0.01
    exact = hang(start, end, length).points(FRACTIONS)
    np.testing.assert_allclose(sketch(start, end, length, 20), exact, rtol=0, atol=1e-6)


@given(offset, offset, offset, slack)
def test_a_box_contains_its_strand(x, y, z, more):
    start, end = np.array([[0.0, 0.0, 0.0]]), np.array([[x, y, z]])
    length = np.linalg.norm(end, axis=1) * (1.0 + 1e-9) + more + 0.01
    low, high = boxes(start, end, length)
    points = hang(start, end, length).points(FRACTIONS)
    assert (points >= low[:, None] - 1e-9).all()
    assert (points <= high[:, None] + 1e-9).all()


def test_strands_of_many_moments_are_sketched_at_once():
    rng = np.random.default_rng(5)
    grips = rng.uniform(-1.0, 1.0, (4, 6, 3)) + 3.0 * np.arange(6)[None, :, None] * [1.0, 0.0, 0.0]
    length = np.linspace(6.0, 9.0, 5)
    several = sketch(grips[:, :-1], grips[:, 1:], length, 20)
    exact = hang(grips[:, :-1], grips[:, 1:], length).points(FRACTIONS)
    np.testing.assert_allclose(several, exact, rtol=0, atol=1e-6)
