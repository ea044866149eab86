"""What is reckoned every tick by compiled loops, against the same with arrays."""

import numpy as np
import pytest

from swarm.flight import reckoning

RNG = np.random.default_rng(5)
LIFT = np.array([0.0, 0.0, 0.6])


def some(*shape: int) -> np.ndarray:
    return RNG.normal(size=shape)


def test_reports_are_carried_on_to_this_moment_for_a_bounded_time():
    reported, velocity, setpoint, told = (some(4, 3) for _ in range(4))
    age = np.array([0.0, 0.3, 2.0, np.inf])
    streaming = np.array([True, False, True, True])
    found, error = reckoning.measured(
        reported, velocity, age, LIFT, setpoint, told, streaming, (0.5, 2.0, 0.05)
    )
    carried = np.array([0.0, 0.3, 0.5, 0.5])[:, None]
    assert found == pytest.approx(reported - LIFT + velocity * carried, abs=1e-12)
    led = np.linalg.norm(found - setpoint - 0.05 * told, axis=1)
    assert error == pytest.approx(np.where(streaming & (age <= 2.0), led, np.nan), nan_ok=True)


def test_setpoints_aim_ahead_of_centres_and_are_relieved_of_what_pulls():
    position, velocity, acceleration, relief = (some(3, 3) for _ in range(4))
    states = reckoning.aimed(position, velocity, acceleration, 0.025, LIFT, relief)
    ahead = position + 0.025 * velocity + 0.5 * 0.025**2 * acceleration + LIFT
    expected = np.stack([ahead, velocity, acceleration - relief], axis=1)
    assert states == pytest.approx(expected, abs=1e-12)


LIMITS = 0.5, 1.0, 0.4, 0.25


@pytest.mark.parametrize(
    ("change", "as_told"),
    [
        ({}, True),
        ({"step": np.array([0.1, np.inf])}, False),
        ({"step": np.array([0.1, np.nan])}, False),
        ({"velocity": np.array([[0.0, 0.0, -0.5], [0.0, 0.0, 0.0]])}, False),
        ({"told": np.array([[0.0, 0.0, -0.4], [0.0, 0.0, 0.0]]),
          "velocity": np.array([[0.0, 0.0, -0.5], [0.0, 0.0, 0.0]])}, True),
        ({"streaming": np.array([False, True]),
          "velocity": np.array([[0.0, 0.0, -1.3], [0.0, 0.0, 0.0]])}, True),
        ({"reported": np.array([[0.0, 0.0, 0.0], [0.0, 0.3, 0.0]])}, False),
        ({"reported": np.array([[0.0, 0.0, 0.0], [0.0, 0.3, 0.0]]),
          "velocity": np.array([[0.0, 0.0, 0.0], [0.0, 3.0, 0.0]])}, True),
        ({"last": np.full((2, 3), np.nan)}, False),
    ],
)  # fmt: skip
def test_who_sinks_or_jumps_does_not_move_as_told(change, as_told):
    calm = {
        "step": np.array([0.1, 0.1]),
        "told": np.zeros((2, 3)),
        "streaming": np.array([True, True]),
        "before": np.zeros((2, 3)),
        "velocity": np.zeros((2, 3)),
        "last": np.zeros((2, 3)),
        "reported": np.zeros((2, 3)),
    }
    assert reckoning.moves_as_told(*{**calm, **change}.values(), LIMITS) == as_told
