"""Linear response and its remainder against finite displacements."""

import numpy as np
import pytest

from swarm.geometry.catenary import Catenary, solve_catenaries
from swarm.geometry.sensitivity import (
    BOTH_ENDS,
    FAR_END,
    LARGEST_RATIO,
    NEAR_END,
    beyond_interpolation,
    first_order,
    linear_response,
    point_response,
)


@pytest.mark.parametrize(("shallowest", "steepest"), [(0.0, 1.4), (1.0, 1.53)])
@pytest.mark.parametrize("ends", [BOTH_ENDS, FAR_END, NEAR_END])
def test_no_finite_displacement_moves_a_point_farther_than_the_bound(ends, shallowest, steepest):
    """Random strands, ends, directions and sizes; outward pulls and swings about the chord too."""
    rng = np.random.default_rng(ends)
    sharpest = 0.0
    for _ in range(30):
        count = 3000
        ratio = np.where(
            rng.uniform(size=count) < 0.5,
            rng.uniform(0.05, 0.9, count),
            1.0 - 10.0 ** rng.uniform(-2.5, -0.7, count),
        )
        elevation = rng.uniform(shallowest, steepest, count) * rng.choice([-1.0, 1.0], count)
        chord = np.stack([np.cos(elevation), np.zeros(count), np.sin(elevation)], axis=-1)
        size = np.minimum(10.0 ** rng.uniform(-4.0, -0.8, count), 0.45 * (LARGEST_RATIO - ratio))
        at_start, at_end = _directions(rng, chord)
        at_start, at_end = at_start * (ends != FAR_END), at_end * (ends != NEAR_END)
        growth = size * (2.0 if ends == BOTH_ENDS else 1.0)
        normal = rng.normal(size=(count, 3)) * np.where(
            rng.uniform(size=count)[:, None] < 0.3, [0.1, 0.1, 1.0], 1.0
        )
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)

        end = ratio[:, None] * chord
        before = solve_catenaries(np.zeros(3), end, 1.0)
        after = solve_catenaries(size[:, None] * at_start, end + size[:, None] * at_end, 1.0)
        at = rng.uniform(size=count)
        piece = (
            np.clip(at - rng.uniform(0.0, 0.1, count), 0.0, 1.0),
            np.clip(at + rng.uniform(0.0, 0.1, count), 0.0, 1.0),
        )
        response = linear_response(before, at, np.full(count, ends), normal, piece, growth)
        bound = response.movement(size, growth)

        def moved(fraction, before=before, after=after, normal=normal):
            step = after.points_at(fraction) - before.points_at(fraction)
            return np.abs(np.einsum("bi,bi->b", step, normal))

        assert np.all(moved(at) <= bound + 1e-12)
        assert np.isfinite(bound).mean() > (0.8 if shallowest == 0.0 else 0.5)
        sharpest = max(sharpest, float(np.max(moved(at) / bound)))
    assert sharpest > 0.95


def test_within_a_piece_the_response_is_close_to_its_interpolation():
    """Random strands and pieces; responses by differences of catenaries."""
    rng, count, step, sharpest = np.random.default_rng(5), 1500, 1e-4, 0.0
    ratio = rng.uniform(0.1, 0.97, count)
    elevation = rng.uniform(-1.3, 1.3, count)
    end = ratio[:, None] * np.stack([np.cos(elevation), 0.0 * ratio, np.sin(elevation)], axis=-1)
    strands = solve_catenaries(np.zeros(3), end, 1.0)
    begin, width = rng.uniform(size=count), 2.0 ** -rng.uniform(1.0, 6.0, count)
    stop = np.minimum(begin + width, 1.0)

    def responses(fraction):
        columns = [
            solve_catenaries(np.zeros(3), end + along, 1.0).points_at(fraction)
            - solve_catenaries(np.zeros(3), end - along, 1.0).points_at(fraction)
            for along in step * np.eye(3)
        ]
        return np.stack(columns, axis=-1) / (2.0 * step)

    share = rng.uniform(size=count)
    between = (1.0 - share)[:, None, None] * responses(begin) + share[:, None, None] * responses(
        stop
    )
    beyond = responses(begin + share * (stop - begin)) - between
    measured = np.linalg.norm(beyond, ord=2, axis=(1, 2))
    for k in range(count):
        figures = (strands.length, strands.parameter, strands.slope, strands.span, strands.rise)
        strand = Catenary(*(float(figure[k]) for figure in figures))
        piece = float(begin[k]), float(stop[k])
        point = point_response(strand, (0.6, 0.8), 0.5)
        _, per_arc = first_order(strand, point, piece, BOTH_ENDS)
        bound = beyond_interpolation(strand, per_arc, piece)
        assert measured[k] <= bound + 1e-6
        sharpest = max(sharpest, float(measured[k]) / bound if measured[k] > 1e-4 else 0.0)
    assert sharpest > 0.5


def _directions(rng, chord):
    """Unit vectors for both ends: random, outward along the chord, or opposite to each other."""
    count = len(chord)
    one, other = rng.normal(size=(2, count, 3))
    one /= np.linalg.norm(one, axis=1, keepdims=True)
    other /= np.linalg.norm(other, axis=1, keepdims=True)
    mode = rng.integers(0, 3, count)[:, None]
    return np.select([mode == 0, mode == 1], [one, -chord], -other), np.select(
        [mode == 1], [chord], other
    )
