"""Teams that give way where they miss margins."""

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


CREW = TeamGeometry(np.array([4.4, 9.0, 6.6]), MARGINS)


def band(places: npt.NDArray[np.float64], sampled: csr_array) -> ElasticBand:
    """The team on its way, to keep its margins and the sides on which its strands pass there."""
    sides = crossing_signs(CREW.hung(places), 2)
    return ElasticBand(CREW, places, sides, no_extra_margins(len(places)), sampled)


def led_over(height: float) -> npt.NDArray[np.float64]:
    """A held strand, and the second next led across over it and back, places (81, 4, 3)."""
    aside = 3.0 - 3.5 * np.sin(np.linspace(0.0, np.pi, 81)) ** 2
    places = np.zeros((81, 4, 3))
    places[:, 0, 0], places[:, 1, 0] = -2.0, 2.0
    places[:, 2:, 0] = aside[:, None] + 1.0
    places[:, 2, 1], places[:, 3, 1] = 3.0, -3.0
    places[:, 2:, 2] = height
    return places


def least_distance(places: npt.NDArray[np.float64]) -> float:
    """Smallest distance of the first strand and the last, by dense points on both."""
    fine = np.linspace(0.0, 1.0, 120)
    one = solve_catenaries(places[:, 0], places[:, 1], CREW.lengths[0]).points(fine)
    other = solve_catenaries(places[:, 2], places[:, 3], CREW.lengths[2]).points(fine)
    return min(float(cdist(a, b).min()) for a, b in zip(one, other, strict=True))


def test_a_strand_led_too_low_over_another_is_raised() -> None:
    places = led_over(1.5)
    sampled = csr_array(eye_array(81))
    before = CREW.strain(places, crossing_signs(CREW.hung(places), 0)).missed
    found = relax(band(places, sampled), np.zeros((81, 4, 3)))
    assert before.max() > 1.0
    assert found.missed.max() < 0.07
    moved = places + found.offsets
    needed = MARGINS.cable + 2.0 * MARGINS.tracking
    assert least_distance(places) < needed + 0.01 < least_distance(moved)
    assert np.all(found.offsets[[0, 1, -2, -1]] == 0.0)


def test_who_keeps_all_margins_stays() -> None:
    found = relax(band(led_over(2.5), csr_array(eye_array(81))), np.zeros((81, 4, 3)))
    assert np.all(found.offsets == 0.0)
    assert found.missed.max() < 0.05


def test_moments_between_stages_count() -> None:
    places = led_over(1.5)
    sampled = csr_array(BSpline.design_matrix(np.linspace(0.0, 80.0, 161), KNOTS, 1))
    dense = np.asarray(sampled @ places.reshape(81, -1)).reshape(-1, 4, 3)
    found = relax(band(dense, sampled), np.zeros((81, 4, 3)))
    assert found.missed.max() < 0.07


KNOTS = np.arange(81 + 2.0) - 1.0
