"""Swing that tracking errors excite, against lumped masses whose ends move at random."""

import math

import numpy as np
import pytest

from swarm.certification.excitation import density, deviation, lateral_frequency, variance_along
from swarm.geometry.catenary import length_for_sag
from swarm.geometry.lumped_mass import cable_model, swing

LATERAL, UP = np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0])
CHORD = np.array([2.5, 0.0, 0.0])


def noise(rng: np.random.Generator, count: int, step: float, tracking: float) -> np.ndarray:
    """A signal (count,) with the assumed spectral density, by its Fourier coefficients."""
    frequency = np.fft.rfftfreq(count, step)
    one_sided = np.array([density(max(f, 1e-3), tracking) for f in frequency])
    one_sided[frequency > 3.0] = 0.0  # vehicles do not move faster
    phases = rng.normal(size=(2, len(frequency)))
    coefficients = np.sqrt(one_sided * count / (4.0 * step)) * (phases[0] + 1j * phases[1])
    return np.fft.irfft(coefficients, count)


@pytest.mark.parametrize("sag", [0.5, 1.0, 1.6])
def test_lumped_masses_swing_about_as_far(sag: float) -> None:
    rng, step, count = np.random.default_rng(5), 0.02, 30_000
    model = cable_model(0.012, 0.006)
    length = np.array([float(length_for_sag(2.5, sag))])
    ends = np.zeros((count, 2, 3))
    ends[:, 1, 0], ends[:, :, 2] = 2.5, 9.0
    for end in range(2):
        ends[:, end, 1] = noise(rng, count, step, 0.1)
    joints = swing(ends, length, type(model)(24, step, model.normal_drag), every=5)[3000:, 0]
    aside = joints[:, 12, 1] - ends[::5][3000:, :, 1].mean(axis=1)
    estimate = deviation(lateral_frequency(sag), 0.1)
    assert 0.6 * estimate < aside.std() < 1.35 * estimate


def test_it_counts_along_the_direction_that_matters() -> None:
    middle = math.sqrt(variance_along(LATERAL, CHORD, 0.8, 0.5, 0.1))
    assert middle == pytest.approx(deviation(lateral_frequency(0.8), 0.1))
    assert variance_along(UP, CHORD, 0.8, 0.5, 0.1) == pytest.approx(0.0, abs=1e-12)
    assert variance_along(LATERAL, CHORD, 0.8, 0.0, 0.1) == pytest.approx(0.0, abs=1e-12)
    assert variance_along(LATERAL, CHORD, 0.8, 0.5, 0.0) == 0.0


def test_densities_grow_with_the_square_of_the_tracking_error() -> None:
    assert density(0.5, 0.2) == pytest.approx(4.0 * density(0.5, 0.1))
    assert density(2.0, 0.1) < 0.05 * density(0.5, 0.1)
