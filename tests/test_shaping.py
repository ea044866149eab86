"""Input shaping: what a shaper does to one mode, and what shaped folds do to their cable."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from swarm.geometry.lumped_mass import Strands, SwingModel
from swarm.geometry.motion import Motion, leg
from swarm.planning.shaping import (
    PacedMotion,
    largest_stray,
    shape,
    shaper_for,
    zero_vibration,
)

AIR = SwingModel(links=16, step=0.01, normal_drag=0.067)


def carry(distance: float = 4.0) -> tuple[Motion, np.ndarray]:
    """Two vehicles carry a strand sideways; its length."""
    start = np.array([[0.0, 0.0, 6.0], [3.0, 0.0, 6.0]])
    return leg(start, start + np.array([0.0, distance, 0.0]), 2.0, 1.0), np.array([4.4])


def paced(motion: Motion, rate: float = 1.0) -> PacedMotion:
    at = np.linspace(motion.times[0], motion.times[-1], 200)
    return PacedMotion(motion, at, np.full(200, rate))


periods = st.lists(st.floats(0.5, 5.0), min_size=1, max_size=4)


@given(periods, st.floats(0.0, 0.2))
def test_a_cascade_silences_each_of_its_modes(chosen: list[float], damping: float) -> None:
    shaper = zero_vibration(tuple(chosen), damping)
    assert shaper.shares.sum() == pytest.approx(1.0)
    assert (shaper.shares > 0.0).all()
    assert shaper.delays[0] == 0.0
    for period in chosen:
        # ZV in the damped period: the transfer function at the mode's pole is zero
        pole = complex(-damping / math.sqrt(1.0 - damping**2), 1.0) * 2.0 * math.pi / period
        response = (shaper.shares * np.exp(-pole * shaper.delays)).sum()
        assert abs(response) < 1e-6 * abs(np.exp(-pole.real * shaper.delays)).max()


@given(st.floats(0.3, 1.0))
def test_a_shaped_motion_goes_from_rest_to_rest_and_is_no_faster(rate: float) -> None:
    motion, _ = carry()
    shaper = zero_vibration((1.9, 1.3))
    shaped = shape(paced(motion, rate), shaper)
    assert shaped.times[-1] == pytest.approx(motion.times[-1] / rate + 0.95 + 0.65)
    for time in (0.0, shaped.times[-1]):
        place, velocity, acceleration = shaped.at(time)
        assert place == pytest.approx(motion.at(math.inf if time else 0.0)[0])
        assert velocity == pytest.approx(0.0, abs=1e-9)
        assert acceleration == pytest.approx(0.0, abs=1e-6)
    dense = np.linspace(0.0, 20.0, 2000)
    for order in (1, 2):
        fastest, before = (np.abs(each.at(dense)[order]).max() for each in (shaped, motion))
        assert fastest <= before * rate**order * 1.01


def test_a_shaped_motion_is_the_weighted_sum_of_delayed_ones() -> None:
    motion, _ = carry()
    shaper = zero_vibration((2.0, 1.1))
    time = np.linspace(0.0, 9.0, 500)
    expected = sum(
        share * motion.at(time - delay)[0]
        for delay, share in zip(shaper.delays, shaper.shares, strict=True)
    )
    assert shape(paced(motion), shaper).at(time)[0] == pytest.approx(expected, abs=2e-4)


def test_shaping_halves_the_swing() -> None:
    motion, lengths = carry()
    sags, strands = np.array([1.4]), [Strands.whole_chain(lengths, AIR)]
    before = largest_stray(motion, strands)[1].max()
    assert before > 0.25, "carried as it is, the strand swings"
    shaped = shape(paced(motion), shaper_for(sags))
    assert largest_stray(shaped, strands)[1].max() < 0.5 * before
