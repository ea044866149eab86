"""Motions: C², within limits, and through given states."""

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from swarm.geometry.motion import (
    LEAST_STEP,
    Motion,
    at_rest,
    concatenate,
    leg,
    reverse,
    staggered_leg,
    through_states,
)

Floats = npt.NDArray[np.float64]


def jumps(motion: Motion) -> Floats:
    """Largest jump of position, velocity and acceleration at the breakpoints."""
    late = (motion.times[1:-1] - motion.times[:-2])[:, None] ** np.arange(6)
    ends = []
    for order in range(3):
        factor = np.ones(6)
        for k in range(order):
            factor *= np.maximum(np.arange(6.0) - k, 0.0)
        shifted = np.zeros_like(late)
        shifted[:, order:] = late[:, : 6 - order]
        before = np.einsum("kc,c,kcnx->knx", shifted, factor, motion.coefficients[:-1])
        after = motion.coefficients[1:, order] * factor[order]
        ends.append(np.abs(before - after).max(initial=0.0))
    return np.array(ends)


def test_through_states_meets_its_states() -> None:
    rng = np.random.default_rng(1)
    times = np.cumsum(rng.uniform(0.2, 2.0, 8))
    states = rng.normal(size=(3, 8, 4, 3))
    motion = through_states(times, *states)
    for found, wanted in zip(motion.at(times), states, strict=True):
        np.testing.assert_allclose(found, wanted, atol=1e-9)
    assert jumps(motion).max() < 1e-9


def test_velocity_and_acceleration_are_derivatives() -> None:
    rng = np.random.default_rng(2)
    motion = through_states(np.array([0.0, 1.0, 2.5]), *rng.normal(size=(3, 3, 2, 3)))
    times, h = np.linspace(0.1, 2.4, 50), 1e-5
    (ahead, _, _), (behind, _, _) = motion.at(times + h), motion.at(times - h)
    here, velocity, acceleration = motion.at(times)
    np.testing.assert_allclose((ahead - behind) / (2 * h), velocity, atol=1e-6)
    np.testing.assert_allclose((ahead - 2 * here + behind) / h**2, acceleration, atol=1e-3)


def test_a_motion_rests_outside_its_time() -> None:
    motion = through_states(np.array([0.0, 1.0]), *np.ones((3, 2, 1, 3)))
    position, velocity, acceleration = motion.at([-1.0, 3.0])
    np.testing.assert_allclose(position, 1.0)
    assert not velocity.any()
    assert not acceleration.any()


def test_concatenated_motions_follow_each_other() -> None:
    a, b = np.zeros((2, 3)), np.ones((2, 3))
    motion = concatenate(leg(a, b, 1.0, 1.0), at_rest(b, 2.0), leg(b, a, 1.0, 1.0))
    assert np.all(np.diff(motion.times) > 0.0)
    assert jumps(motion).max() < 1e-9
    np.testing.assert_allclose(motion.at(motion.times[-1])[0], a, atol=1e-12)
    again = concatenate(motion, motion)
    assert again.times[-1] == pytest.approx(2 * motion.times[-1])


@settings(max_examples=50, deadline=None)
@given(
    distance=st.floats(0.0, 100.0),
    speed=st.floats(0.1, 10.0),
    limit=st.floats(0.1, 10.0),
    delay=st.floats(0.0, 5.0),
)
def test_legs_keep_limits(distance: float, speed: float, limit: float, delay: float) -> None:
    start = np.zeros((2, 3))
    end = np.array([[distance, 0.0, 0.0], [0.0, 0.0, 0.5 * distance]])
    motion = staggered_leg(start, end, np.array([0.0, delay]), speed, limit)
    times = np.linspace(0.0, motion.times[-1], 2001)
    position, velocity, acceleration = motion.at(times)
    assert np.linalg.norm(velocity, axis=2).max() <= speed * (1 + 1e-9)
    assert np.linalg.norm(acceleration, axis=2).max() <= limit * (1 + 1e-9)
    np.testing.assert_allclose(position[0], start, atol=1e-9)
    np.testing.assert_allclose(position[-1], end, atol=1e-9)
    assert np.abs(velocity[times < delay - 1e-6, 1]).max(initial=0.0) < 1e-6
    # No shorter than at the limits throughout, and no longer than one quintic.
    quintic = max(1.0, 1.875 * distance / speed, np.sqrt(10.0 / np.sqrt(3.0) * distance / limit))
    assert distance / speed <= motion.times[-1] - delay <= 1.001 * quintic + 1e-6


@given(st.floats(0.0, 3e-4), st.sampled_from([1, 2, 3]))
def test_a_staggered_leg_has_no_pieces_that_a_file_refuses(after: float, corner: int) -> None:
    start, end = np.zeros((2, 3)), np.array([[20.0, 0.0, 0.0], [0.0, 20.0, 0.0]])
    alone = leg(start, end, 2.0, 1.0)
    motion = staggered_leg(start, end, np.array([0.0, alone.times[corner] + after]), 2.0, 1.0)
    assert np.diff(motion.times).min() >= LEAST_STEP
    for vehicle, begins in enumerate((0.0, alone.times[corner] + after)):
        times = np.linspace(0.0, motion.times[-1], 501)
        for found, expected in zip(motion.at(times), alone.at(times - begins), strict=True):
            np.testing.assert_allclose(found[:, vehicle], expected[:, vehicle], atol=1e-3)
    np.testing.assert_allclose(motion.at(motion.times[-1])[0], end, atol=1e-9)


def test_a_long_leg_keeps_its_largest_speed() -> None:
    motion = leg(np.zeros((1, 3)), np.array([[20.0, 0.0, 0.0]]), 2.0, 1.0)
    speed = motion.at(np.linspace(0.0, motion.times[-1], 2001))[1][:, 0, 0]
    assert motion.times[-1] < 20.0 / 2.0 + 3.1  # 3.08·speed/acceleration to start and stop
    assert np.count_nonzero(speed > 1.99) > 900


def test_a_reversed_motion_has_the_same_path_and_speed() -> None:
    rng = np.random.default_rng(5)
    times = np.array([2.0, 2.7, 4.1, 4.4])
    motion = through_states(times, *rng.normal(size=(3, 4, 2, 3)))
    back = reverse(motion)
    times_inside = np.linspace(2.01, 4.39, 97)
    for sign, there, again in zip(
        (1, -1, 1), motion.at(times_inside), back.at(6.4 - times_inside), strict=True
    ):
        np.testing.assert_allclose(sign * again, there, atol=1e-9)
