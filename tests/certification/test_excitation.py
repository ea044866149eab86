"""Swing that tracking errors excite, against lumped masses whose ends move at random."""

import math

import numpy as np
import pytest

from swarm.certification.excitation import (
    STEP,
    density,
    largest_deviation,
    modal_variances,
    modes,
    speeds_across,
    variances_along,
)
from swarm.geometry.catenary import Catenaries, length_for_sag, solve_catenaries
from swarm.geometry.lumped_mass import cable_model
from tests.geometry.swinging import swing

LATERAL, UP = np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0])
SPAN = 2.5
MODEL = cable_model(0.012, 0.006)


def hanging(sag: float, span: float = SPAN) -> Catenaries:
    length = np.array([float(length_for_sag(span, sag))])
    return solve_catenaries(np.array([[0.0, 0.0, 9.0]]), np.array([[span, 0.0, 9.0]]), length)


def noise(rng: np.random.Generator, count: int, step: float, tracking: float) -> np.ndarray:
    """Signals (count, 6) with the assumed spectral density, by their Fourier coefficients."""
    frequency = np.fft.rfftfreq(count, step)
    one_sided = density(np.maximum(frequency, 1e-3), tracking)
    one_sided[frequency > 3.0] = 0.0  # vehicles do not move faster
    phases = rng.normal(size=(2, 6, len(frequency)))
    coefficients = np.sqrt(one_sided * count / (4.0 * step)) * (phases[0] + 1j * phases[1])
    return np.fft.irfft(coefficients, count).T


def swung(sag: float, fraction: float) -> np.ndarray:
    """Movements (k, 3) of a point of a strand beyond those of its catenary, long after the start."""
    rng, step, count = np.random.default_rng(5), 0.02, 30_000
    strand = hanging(sag)
    ends = np.stack([strand.start[0], strand.end[0]]) + noise(rng, count, step, 0.1).reshape(
        count, 2, 3
    )
    joints = swing(ends, strand.length, type(MODEL)(24, step, MODEL.normal_drag), every=5)[:, 0]
    still = solve_catenaries(ends[::5, 0], ends[::5, 1], np.repeat(strand.length, count // 5))
    return (joints[:, round(24 * fraction)] - still.points(np.array([fraction]))[:, 0])[3000:]


@pytest.mark.parametrize(("sag", "fraction"), [(0.5, 0.5), (1.0, 0.3), (1.6, 0.5)])
def test_lumped_masses_swing_about_as_far(sag: float, fraction: float) -> None:
    moved, strand = swung(sag, fraction), hanging(sag)
    for normal in (LATERAL, UP):
        at = fraction, normal
        found = variances_along(modes(strand), at, 0.1, MODEL.normal_drag, np.zeros(0))
        assert found.moving == 0.0
        measured = (moved @ normal).std()
        assert 0.8 * measured < math.sqrt(found.held) < 1.7 * measured


def test_no_point_swings_farther_in_any_direction_than_the_largest_deviation() -> None:
    strand, rng = modes(hanging(0.8)), np.random.default_rng(4)
    speeds = np.full(20, 0.4)
    moving, held = modal_variances(strand, 0.1, MODEL.normal_drag, speeds)
    normals = rng.normal(size=(300, 3))
    found = [
        variances_along(
            strand, (float(rng.random()), normal / np.linalg.norm(normal)), 0.1,
            MODEL.normal_drag, speeds,
        )
        for normal in normals
    ]  # fmt: skip
    for modal, most in (
        (moving, max(one.moving for one in found)), (held, max(one.held for one in found))
    ):  # fmt: skip
        assert 0.95 * largest_deviation(strand, modal) < math.sqrt(most)
        assert math.sqrt(most) <= largest_deviation(strand, modal)


def test_a_strand_that_moves_along_its_chord_has_no_speed_across() -> None:
    places = np.tile([[0.0, 0.0, 9.0], [3.0, 4.0, 9.0]], (2, 1, 1))
    velocities = np.array([[[0.6, 0.8, 0.0]] * 2, [[-0.8, 0.6, 0.0], [0.0, 0.0, 0.0]]])
    assert speeds_across(places, velocities) == pytest.approx([0.0, 0.5])


def test_frequencies_of_shallow_strands_are_irvines() -> None:
    # 1:40; inextensible: the elastic parameter is infinite, the first symmetric one at 2.86 π
    strand = hanging(SPAN / 40.0)
    own = modes(strand, links=80).frequencies * 2.0 * math.pi
    string = math.sqrt(9.80665 * float(strand.parameter[0])) / SPAN
    assert own[:5] / string == pytest.approx(
        [math.pi, 2.0 * math.pi, 2.0 * math.pi, 2.86 * math.pi, 3.0 * math.pi], rel=0.02
    )


def test_few_links_are_enough_for_the_lowest_modes() -> None:
    for sag in (0.5, 1.5):
        coarse, fine = (modes(hanging(sag), links).frequencies[:3] for links in (12, 48))
        assert coarse == pytest.approx(fine, rel=0.015)


def test_it_grows_to_what_air_damps() -> None:
    at = 0.5, LATERAL
    found = modes(hanging(1.0))
    grown = [
        variances_along(found, at, 0.1, MODEL.normal_drag, np.zeros(count)).moving
        for count in (4, 40, 4000)
    ]
    held = variances_along(found, at, 0.1, MODEL.normal_drag, np.zeros(0)).held
    assert grown[0] < grown[1] < grown[2] == pytest.approx(held, rel=0.02)
    moving = np.full(round(200.0 / STEP), 1.0)
    assert variances_along(found, at, 0.1, MODEL.normal_drag, moving).moving < 0.5 * held


def test_it_counts_along_the_direction_that_matters() -> None:
    found = modes(hanging(0.8))
    none = np.zeros(0)
    ends = variances_along(found, (0.0, LATERAL), 0.1, MODEL.normal_drag, none)
    exact = variances_along(found, (0.5, LATERAL), 0.0, MODEL.normal_drag, none)
    assert (ends.held, exact.held) == (0.0, 0.0)
    aside, up = (
        variances_along(found, (0.5, normal), 0.1, MODEL.normal_drag, none).held
        for normal in (LATERAL, UP)
    )
    assert up < 0.5 * aside


def test_densities_grow_with_the_square_of_the_tracking_error() -> None:
    half, two = np.array(0.5), np.array(2.0)
    assert density(half, 0.2) == pytest.approx(4.0 * density(half, 0.1))
    assert density(two, 0.1) < 0.05 * density(half, 0.1)
