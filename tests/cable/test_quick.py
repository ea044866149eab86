"""Strands one at a time, compiled, against the same in batches."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from swarm.cable import quick
from swarm.cable.catenary import hang


@settings(max_examples=100, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0.0001, 3.0))
def test_points_are_those_of_the_catenary(seed, slack):
    rng = np.random.default_rng(seed)
    start, end = rng.normal([0.0, 0.0, 5.0], 1.0, (2, 3))
    length = float(np.linalg.norm(end - start)) * (1.0 + slack)
    points = np.empty((21, 3))
    quick.sketch(start, end, length, points)
    strand = hang(start[None], end[None], np.array([length]))
    assert points == pytest.approx(strand.points(np.linspace(0.0, 1.0, 21))[0], abs=1e-6)
