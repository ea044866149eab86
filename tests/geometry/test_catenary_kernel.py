"""Compiled functions of one strand against the batches."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from swarm.geometry import catenary
from swarm.geometry.catenary import solve_catenaries


def drawn(seed, slack):
    """Ends of a strand, and its length."""
    start, end = np.random.default_rng(seed).normal([0.0, 0.0, 5.0], 1.0, (2, 3))
    return start, end, float(np.linalg.norm(end - start)) * (1.0 + slack)


@settings(max_examples=100, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0.0001, 3.0))
def test_points_are_those_of_the_catenary(seed, slack):
    start, end, length = drawn(seed, slack)
    points = np.empty((21, 3))
    catenary.sample_strand(start, end, length, points)
    strand = solve_catenaries(start[None], end[None], np.array([length]))
    assert points == pytest.approx(strand.points(np.linspace(0.0, 1.0, 21))[0], abs=1e-6)


@settings(max_examples=100, deadline=None)
@given(
    st.tuples(*[st.floats(-10.0, 10.0)] * 3), st.one_of(st.floats(0.0, 20.0), st.floats(0.0, 1e-6))
)
def test_no_strand_is_lower_than_the_bound(across, slack):
    start, end = np.zeros(3), np.array(across)
    length = float(np.linalg.norm(end)) * (1.0 + 1e-9) + slack + 0.01
    lowest = solve_catenaries(start, end, length).points(np.linspace(0.0, 1.0, 21))[:, 2].min()
    assert (
        lowest >= min(0.0, across[2]) - catenary.max_drop_below_ends(start, end, length, 0.0) - 1e-9
    )


@settings(max_examples=200, deadline=None)
@given(
    st.floats(-10.0, 10.0),
    st.floats(0.01, 10.0),
    st.floats(0.0, 12.0),
    st.floats(-math.pi, math.pi),
    st.floats(-1.0, 1.0),
)
def test_no_chord_leaves_the_range_of_elevations(rise, span, reach, ahead, upright):
    level = reach * math.sqrt(1.0 - upright**2)
    moved = np.array([span + level * math.cos(ahead), level * math.sin(ahead)])
    after = rise + reach * upright
    steep = abs(after) / max(math.hypot(*moved, after), 1e-12)
    assert steep <= catenary.max_elevation_sine(rise, span, reach) + 1e-9
    assert steep >= catenary.min_elevation_sine(rise, span, reach) - 1e-9


@settings(max_examples=100, deadline=None)
@given(st.floats(0.0, 1.3), st.floats(1.0, 10.0), st.floats(0.0, 0.2))
def test_the_largest_elevation_is_reached(elevation, chord, turned):
    """An end moves at right angles to its final chord: by the chord times the sine of the turn."""
    rise, span = chord * math.sin(elevation), chord * math.cos(elevation)
    steep = catenary.max_elevation_sine(rise, span, chord * math.sin(turned))
    assert steep == pytest.approx(math.sin(elevation + turned), abs=1e-9)


@settings(max_examples=100, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0.001, 12.0))
def test_a_polygon_is_close_to_its_strand_in_narrow_loops_too(seed, slack):
    start, end, length = drawn(seed, slack)
    outline = np.empty((7, 3))
    catenary.strand_polygon(start, end, length, outline)
    strand = solve_catenaries(start, end, length)
    level = outline[:, :2] - start[:2]
    np.testing.assert_allclose(level, np.linspace(0, 1, 7)[:, None] * level[-1], atol=1e-9)
    np.testing.assert_allclose(outline[[0, -1]], [start, end], atol=1e-9)

    share = np.linspace(0.0, 1.0, 601)
    above = np.interp(share, np.linspace(0, 1, 7), outline[:, 2]) - strand.at_span(share)[:, 2]
    across = above / np.hypot(1.0, np.gradient(strand.at_span(share)[:, 2], strand.span / 600.0))
    assert np.abs(across).max() < 0.009 * length
    assert across.max() >= 0.0 >= across.min()
