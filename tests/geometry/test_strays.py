"""Strays of joints from catenaries, against points of the catenaries themselves."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from swarm.geometry.catenary import solve_catenaries
from swarm.geometry.lumped_mass import Held, strays_of, subtract_catenaries


def team(seed: int, moments: int, links: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Grip points (m, 4, 3), lengths (3,) from taut to slack, and joints (m, 3, links + 1, 3)."""
    rng = np.random.default_rng(seed)
    ends = rng.uniform(-4.0, 4.0, (moments, 4, 3))
    chords = np.linalg.norm(np.diff(ends, axis=1), axis=2).max(axis=0)
    lengths = chords * (1.0 + 10.0 ** rng.uniform(-6.0, 1.0, 3))
    return ends, lengths, rng.normal(size=(moments, 3, links + 1, 3))


@settings(max_examples=40)
@given(seed=st.integers(0, 10**6), moments=st.integers(1, 40), links=st.integers(1, 60))
def test_strays_lead_from_points_of_the_catenaries(seed: int, moments: int, links: int) -> None:
    ends, lengths, joints = team(seed, moments, links)
    still = solve_catenaries(ends[:, :-1], ends[:, 1:], lengths)
    expected = joints - still.points(np.linspace(0.0, 1.0, links + 1))
    found = strays_of(joints, ends, np.arange(3), lengths)
    assert (np.abs(found - expected).max(axis=(0, 2, 3)) <= 1e-11 * lengths).all()
    some = strays_of(joints[:, 1:], ends, np.array([1, 2]), lengths[1:])
    assert np.array_equal(some, found[:, 1:])


def test_strays_of_few_links_are_interpolated_in_rows_of_more() -> None:
    ends, lengths, joints = team(3, 5, 4)
    found = np.full((5, 3, 13, 3), np.nan)
    held = Held(np.array([2, 0]), lengths[[2, 0]], np.array([1, 2]))
    subtract_catenaries(ends, held, joints[:, :2].copy(), np.arange(2 * len(ends)), found)
    own = strays_of(joints[:, :2].copy(), ends, np.array([2, 0]), lengths[[2, 0]])
    assert np.isnan(found[:, 0]).all()
    places = np.linspace(0.0, 4.0, 13)
    for axis in range(3):
        for moment, row in np.ndindex(5, 2):
            between = np.interp(places, np.arange(5.0), own[moment, row, :, axis])
            assert found[moment, 1 + row, :, axis] == pytest.approx(between, abs=1e-12)


def test_a_joint_that_is_not_a_number_has_no_stray() -> None:
    ends, lengths, joints = team(4, 2, 6)
    joints[1, 2, 3] = np.nan
    found = strays_of(joints, ends, np.arange(3), lengths)
    assert np.isnan(found[1, 2, 3]).all()
    assert np.isnan(found).sum() == 3
