"""Sensitivity tables against finite displacements of an independent catenary."""

import numpy as np
import pytest

from swarm.geometry.sensitivity import (
    BOTH_ENDS,
    FAR_END,
    LARGEST_RATIO,
    NEAR_END,
    finest_piece,
    sensitivity_tables,
)
from tests.certification.oracle import catenary


@pytest.mark.parametrize("ends", [BOTH_ENDS, FAR_END, NEAR_END])
@pytest.mark.parametrize("seed", range(4))
def test_no_finite_displacement_moves_a_strand_farther_than_the_bound(ends, seed):
    rng = np.random.default_rng([seed, ends])
    count = 600
    ratio = rng.choice(
        [rng.uniform(0.05, 0.9, count), 1.0 - 10.0 ** rng.uniform(-2.5, -0.7, count)]
    )
    elevation = rng.uniform(-1.5, 1.5, count)
    end = ratio[:, None] * np.stack(
        [np.cos(elevation), np.zeros(count), np.sin(elevation)], axis=-1
    )
    size = np.minimum(10.0 ** rng.uniform(-3.0, -0.8, count), 0.45 * (LARGEST_RATIO - ratio))
    # Random directions, and the worst known: both ends along the chord, away from each other.
    along = end / ratio[:, None]
    random = rng.normal(size=(2, count, 3))
    random /= np.linalg.norm(random, axis=-1, keepdims=True)
    outward = rng.uniform(size=count)[:, None] < 0.5
    at_start = np.where(outward, -along, random[0]) * (ends != FAR_END)
    at_end = np.where(outward, along, random[1]) * (ends != NEAR_END)
    fractions = np.linspace(0.0, 1.0, 60)
    before = _by_arc(np.zeros((count, 3)), end, fractions)
    after = _by_arc(size[:, None] * at_start, end + size[:, None] * at_end, fractions)
    moved = after - before

    growth = size * (2.0 if ends == BOTH_ENDS else 1.0)
    steepest = np.minimum(np.abs(elevation) + np.arcsin(np.minimum(growth / ratio, 1.0)), np.pi / 2)
    pieces = 64 + np.minimum((64 * fractions).astype(int), 63)
    for column, piece in enumerate(pieces):
        horizontal, vertical = sensitivity_tables().largest(
            ratio, growth, np.sin(steepest), np.full(count, ends), np.full(count, piece)
        )
        across = np.hypot(moved[:, column, 0], moved[:, column, 1])
        assert np.all(across <= size * horizontal + 4e-5)
        assert np.all(np.abs(moved[:, column, 2]) <= size * vertical + 4e-5)


def _by_arc(start, end, fractions):
    """Points at fractions of the arc length 1, from the oracle's points at equal spans."""
    fine = catenary(start, end, 1.0, 2000)
    arc = np.cumsum(np.linalg.norm(np.diff(fine, axis=1), axis=-1), axis=1)
    arc = np.concatenate([np.zeros((len(arc), 1)), arc], axis=1)
    arc /= arc[:, -1:]
    return np.stack(
        [
            [np.interp(fractions, arc[row], fine[row, :, axis]) for axis in range(3)]
            for row in range(len(fine))
        ]
    ).transpose(0, 2, 1)


def test_the_bound_is_sharp_for_a_level_strand_pulled_at_both_ends():
    ratio, size, middle = 0.95, 1e-4, 64 + 32
    moved = catenary([-size, 0, 0], [ratio + size, 0, 0], 1.0, 2001)[1000]
    moved -= catenary([0, 0, 0], [ratio, 0, 0], 1.0, 2001)[1000]
    one = np.ones(1)
    _, vertical = sensitivity_tables().largest(
        ratio * one, 2 * size * one, 0 * one, np.array([BOTH_ENDS]), np.array([middle])
    )
    assert abs(moved[2]) <= size * vertical[0] <= 1.12 * abs(moved[2])


@pytest.mark.parametrize("piece", [1, 2, 3, 7, 15, 64, 100, 127, 118 * 16 + 15, 2**20 - 1])
def test_the_finest_piece_of_a_point_is_in_its_own_piece(piece):
    level = piece.bit_length() - 1
    begin = piece / 2**level - 1.0
    end = begin + 0.5**level
    for fraction in np.linspace(begin, end, 9):
        finest = finest_piece(piece, fraction)
        assert 64 <= finest < 128
        assert finest / 64 - 1.0 <= fraction <= (finest + 1) / 64 - 1.0
        # It is a part of the piece, or contains it.
        assert finest / 64 - 1.0 < end
        assert (finest + 1) / 64 - 1.0 > begin
