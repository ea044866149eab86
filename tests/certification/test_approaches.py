"""Largest strays in intervals of time."""

import numpy as np
import pytest

from swarm.certification.swing_tube import collect_distances


def test_the_largest_size_of_each_interval_counts() -> None:
    rng = np.random.default_rng(2)
    strays, bins = rng.normal(size=(50, 3, 5, 3)), rng.integers(0, 4, 50)
    most = np.full((4, 3, 5), 0.4)
    collect_distances(bins, strays, most)
    sizes = np.linalg.norm(strays, axis=-1)
    for k in range(4):
        assert most[k] == pytest.approx(np.maximum(sizes[bins == k].max(axis=0), 0.4), rel=1e-15)


def test_a_stray_that_is_not_a_number_has_no_bound() -> None:
    strays = np.ones((3, 1, 2, 3))
    strays[1, 0, 1, 2] = np.nan
    most = np.zeros((2, 1, 2))
    collect_distances(np.array([0, 0, 0]), strays, most)
    assert most[0, 0].tolist() == [pytest.approx(np.sqrt(3.0)), np.inf]
    assert (most[1] == 0.0).all()
