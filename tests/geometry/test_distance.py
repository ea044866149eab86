"""Closest distances against constrained least squares and against brute force."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as nps
from scipy.optimize import lsq_linear

from swarm.geometry.distance import (
    norms,
    point_segment,
    polyline_polyline,
    segment_segment,
    strand_strand,
)

# Whole numbers make parallel, touching, crossing and degenerate segments common.
segments = nps.arrays(np.float64, (2, 3), elements=st.integers(-3, 3).map(float))


def least_squares(first: np.ndarray, second: np.ndarray) -> float:
    """Distance of two segments as a bounded least-squares problem."""
    matrix = np.column_stack([first[1] - first[0], second[0] - second[1]])
    offset = second[0] - first[0]
    best = min(np.linalg.norm(offset - matrix @ corner) for corner in np.ndindex(2, 2))
    found = lsq_linear(matrix, offset, bounds=(0.0, 1.0), method="bvls", tol=1e-15)
    return float(min(best, np.linalg.norm(matrix @ found.x - offset)))


@given(segments, segments)
def test_segments_against_least_squares(first: np.ndarray, second: np.ndarray) -> None:
    closest = segment_segment(first, second)
    assert float(closest.distance) == pytest.approx(least_squares(first, second), abs=1e-9)
    at_first = first[0] + closest.first * (first[1] - first[0])
    at_second = second[0] + closest.second * (second[1] - second[0])
    assert np.linalg.norm(at_first - at_second) == pytest.approx(float(closest.distance))
    assert 0.0 <= closest.first <= 1.0
    assert 0.0 <= closest.second <= 1.0


@given(segments, segments)
def test_the_order_of_segments_does_not_matter(first: np.ndarray, second: np.ndarray) -> None:
    there, back = segment_segment(first, second), segment_segment(second[::-1], first)
    assert float(there.distance) == pytest.approx(float(back.distance), abs=1e-12)


def test_nearly_parallel_segments() -> None:
    angles = 10.0 ** np.arange(-1.0, -17.0, -1.0)
    first = np.broadcast_to([[0.0, 0.0, 0.0], [4.0, 0.0, 0.0]], (16, 2, 3))
    second = np.zeros((16, 2, 3))
    second[:, 0] = [1.0, 0.0, 1.0]
    second[:, 1] = np.column_stack([np.full(16, 3.0), 0 * angles, 1.0 - angles])
    np.testing.assert_allclose(segment_segment(first, second).distance, 1.0 - angles, atol=1e-8)


@given(segments, nps.arrays(np.float64, 3, elements=st.integers(-3, 3).map(float)))
def test_a_point_is_a_segment_without_length(segment: np.ndarray, point: np.ndarray) -> None:
    as_segment = segment_segment(np.stack([point, point]), segment)
    as_point = point_segment(point, segment)
    assert float(as_point.distance) == pytest.approx(float(as_segment.distance), abs=1e-12)


def walks(rng: np.random.Generator, *shape: int) -> np.ndarray:
    return np.cumsum(rng.normal(scale=0.3, size=shape), axis=-2) + rng.normal(
        size=(*shape[:-2], 1, 3)
    )


def brute(first: np.ndarray, second: np.ndarray) -> float:
    return min(
        float(segment_segment(first[i : i + 2], second[j : j + 2]).distance)
        for i in range(len(first) - 1)
        for j in range(len(second) - 1)
    )


def test_polylines_against_all_pairs() -> None:
    rng = np.random.default_rng(5)
    first, second = walks(rng, 4, 5, 9, 3), walks(rng, 5, 7, 3)
    closest = polyline_polyline(first, second)
    assert closest.distance.shape == (4, 5)
    for i, j in np.ndindex(4, 5):
        assert closest.distance[i, j] == pytest.approx(brute(first[i, j], second[j]), rel=1e-13)
        points = [
            line[int(place)]
            + (place % 1.0) * (line[min(int(place) + 1, len(line) - 1)] - line[int(place)])
            for line, place in (
                (first[i, j], closest.first[i, j]),
                (second[j], closest.second[i, j]),
            )
        ]
        assert np.linalg.norm(points[0] - points[1]) == pytest.approx(closest.distance[i, j])


@pytest.mark.parametrize("sizes", [(65, 50), (17, 18), (40, 9), (66, 64)])
def test_long_polylines_against_all_pairs(sizes: tuple[int, int]) -> None:
    rng = np.random.default_rng(8)
    for _ in range(20):
        first, second = (0.2 * walks(rng, size, 3) for size in sizes)
        second += 3.0 * rng.normal(size=3)
        closest = polyline_polyline(first, second)
        assert closest.distance == pytest.approx(brute(first, second), rel=1e-13)
        on_first, on_second = (
            np.array([np.interp(place, np.arange(len(line)), line[:, x]) for x in range(3)])
            for line, place in ((first, closest.first), (second, closest.second))
        )
        assert np.linalg.norm(on_first - on_second) == pytest.approx(closest.distance, rel=1e-9)


@pytest.mark.parametrize("at", [0, 3, 8, 30, 63, 64])
def test_a_nan_anywhere_in_a_long_polyline_is_not_a_large_distance(at: int) -> None:
    lines = walks(np.random.default_rng(9), 2, 65, 3)
    lines[1] += 40.0
    lines[1, at, 2] = np.nan
    assert np.isnan(polyline_polyline(lines[0], lines[1]).distance)


def test_chosen_strands_have_the_distance_of_their_polylines() -> None:
    rng = np.random.default_rng(6)
    strands = walks(rng, 11, 4, 8, 3)
    pairs = np.array([[0, 1], [0, 3], [2, 3]])
    chosen = strand_strand(strands, pairs)
    copied = polyline_polyline(strands[:, pairs[:, 0]], strands[:, pairs[:, 1]])
    np.testing.assert_array_equal(chosen.distance, copied.distance)
    np.testing.assert_array_equal(chosen.first, copied.first)
    np.testing.assert_array_equal(chosen.second, copied.second)


def test_a_nan_is_not_a_large_distance() -> None:
    lines = walks(np.random.default_rng(7), 2, 5, 3)
    lines[1, 2, 0] = np.nan
    assert np.isnan(polyline_polyline(lines[0], lines[1]).distance)


def test_pairs_of_strands_are_their_polylines() -> None:
    rng = np.random.default_rng(7)
    strands = walks(rng, 2, 3, 5, 8, 3)
    pairs = np.array([[4, 0], [1, 2]])
    closest = strand_strand(strands, pairs)
    assert closest.distance.shape == (2, 3, 2)
    for k, (i, j) in enumerate(pairs):
        expected = polyline_polyline(strands[..., i, :, :], strands[..., j, :, :])
        np.testing.assert_array_equal(closest.distance[..., k], expected.distance)


def test_touching_polylines_have_distance_0() -> None:
    first = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]])
    second = np.array([[1.5, 1, 0], [1.5, -1, 0], [0, -1, 0]])
    closest = polyline_polyline(first, second)
    assert closest.distance == 0.0
    assert closest.first == pytest.approx(1.5)
    assert closest.second == pytest.approx(0.5)


@pytest.mark.parametrize("dimensions", [2, 3])
def test_lengths_of_vectors_are_numpys_to_the_last_bit(dimensions: int) -> None:
    vectors = np.random.default_rng(3).normal(size=(500, 4, dimensions))
    np.testing.assert_array_equal(norms(vectors), np.linalg.norm(vectors, axis=-1))
