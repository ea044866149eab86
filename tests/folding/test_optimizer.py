"""Relaxation of teams that miss margins."""

import numpy as np
import numpy.typing as npt
from scipy.interpolate import BSpline
from scipy.sparse import csr_array, eye_array
from scipy.spatial.distance import cdist

from swarm.folding.crossing_constraints import crossing_signs
from swarm.folding.margins import Margins
from swarm.folding.optimizer import ElasticBand, relax
from swarm.folding.penalty import TeamGeometry, no_extra_margins
from swarm.geometry.catenary import solve_catenaries

MARGINS = Margins(0.2, 1.0, 1.5, 0.3, tracking=0.05, radius=0.25, grip_offset=0.6, exempt=1.0)


TEAM = TeamGeometry(np.array([4.4, 9.0, 6.6]), MARGINS)


def band(positions: npt.NDArray[np.float64], weights: csr_array) -> ElasticBand:
    """The elastic band of the team, with the signs of its own motion."""
    signs = crossing_signs(TEAM.outlines(positions), 2)
    extra = no_extra_margins(len(positions))
    stages = (len(positions) - 1) // (weights.shape[1] - 1)
    return ElasticBand(TEAM, positions[::stages], positions, signs, extra, weights)


def led_over(height: float) -> npt.NDArray[np.float64]:
    """A strand at rest, and the one after the next led across over it and back: (81, 4, 3)."""
    offset = 3.0 - 3.5 * np.sin(np.linspace(0.0, np.pi, 81)) ** 2
    positions = np.zeros((81, 4, 3))
    positions[:, 0, 0], positions[:, 1, 0] = -2.0, 2.0
    positions[:, 2:, 0] = offset[:, None] + 1.0
    positions[:, 2, 1], positions[:, 3, 1] = 3.0, -3.0
    positions[:, 2:, 2] = height
    return positions


def least_distance(positions: npt.NDArray[np.float64]) -> float:
    """Smallest distance of the first strand and the last, by dense points on both."""
    fine = np.linspace(0.0, 1.0, 120)
    one = solve_catenaries(positions[:, 0], positions[:, 1], TEAM.lengths[0]).points(fine)
    other = solve_catenaries(positions[:, 2], positions[:, 3], TEAM.lengths[2]).points(fine)
    return min(float(cdist(a, b).min()) for a, b in zip(one, other, strict=True))


def test_a_strand_led_too_low_over_another_is_raised() -> None:
    positions = led_over(1.5)
    weights = csr_array(eye_array(81))
    before = TEAM.penalty(positions, crossing_signs(TEAM.outlines(positions), 0)).missed
    found = relax(band(positions, weights), np.zeros((81, 4, 3)))
    assert before.max() > 1.0
    assert found.missed.max() < 0.07
    moved = positions + found.offsets
    needed = MARGINS.cable + 2.0 * MARGINS.tracking
    assert least_distance(positions) < needed + 0.01 < least_distance(moved)
    assert np.all(found.offsets[[0, 1, -2, -1]] == 0.0)


def test_a_team_that_keeps_all_margins_does_not_move() -> None:
    found = relax(band(led_over(2.5), csr_array(eye_array(81))), np.zeros((81, 4, 3)))
    assert np.all(found.offsets == 0.0)
    assert found.missed.max() < 0.05


def test_moments_between_stages_count() -> None:
    positions = led_over(1.5)
    weights = csr_array(BSpline.design_matrix(np.linspace(0.0, 80.0, 161), KNOTS, 1))
    dense = np.asarray(weights @ positions.reshape(81, -1)).reshape(-1, 4, 3)
    found = relax(band(dense, weights), np.zeros((81, 4, 3)))
    assert found.missed.max() < 0.07


KNOTS = np.arange(81 + 2.0) - 1.0
