"""Compiled computations of a tick, compared with the same on arrays."""

import numpy as np
import pytest

from swarm.flight import estimation
from swarm.flight.estimation import Measured
from swarm.mavlink.telemetry_table import (
    ATTITUDE,
    POSITION,
    POSITION_AT,
    RECEIVED_AT,
    VELOCITY,
    WIDTH,
)

RNG = np.random.default_rng(5)
LIFT = np.array([0.0, 0.0, 0.6])


def some(*shape: int) -> np.ndarray:
    return RNG.normal(size=shape)


def test_reports_are_carried_on_to_this_moment_for_a_bounded_time():
    reported, velocity, setpoint, told = (some(4, 3) for _ in range(4))
    age = np.array([0.0, 0.3, 2.0, np.inf])
    streaming = np.array([True, False, True, True])
    turn, offset, rows, now = some(4, 3, 3), some(4, 3), np.array([2, 0, 3, 1]), 7.0
    said = np.full((4, WIDTH), np.nan)
    said[rows, POSITION_AT] = now - age
    said[rows, POSITION : POSITION + 3] = np.linalg.solve(turn, (reported - offset)[..., None])[
        ..., 0
    ]
    said[rows, VELOCITY : VELOCITY + 3] = np.linalg.solve(turn, velocity[..., None])[..., 0]
    found = Measured.of(4)
    estimation.measure(
        said, rows, (turn, offset, LIFT), (setpoint, told, streaming), (now, 0.5, 2.0, 0.05), found
    )
    carried = np.array([0.0, 0.3, 0.5, 0.5])[:, None]
    assert found.reported == pytest.approx(reported, abs=1e-9)
    assert found.velocity == pytest.approx(velocity, abs=1e-9)
    assert found.position == pytest.approx(reported - LIFT + velocity * carried, abs=1e-9)
    assert found.at == pytest.approx(now - age)
    led = np.linalg.norm(found.position - setpoint - 0.05 * told, axis=1)
    error = np.where(streaming & (age <= 2.0), led, np.nan)
    assert found.error == pytest.approx(error, nan_ok=True)


def test_setpoints_aim_ahead_of_centres_and_are_relieved_of_what_pulls():
    position, velocity, acceleration, pull, change = (some(3, 3) for _ in range(5))
    turn, move = some(3, 3, 3), some(3, 3)
    states = np.empty((3, 3, 3))
    moving, frames = (position, velocity, acceleration), (turn, move, LIFT)
    mobility = np.array([1.0 / 1.6, 0.0, 1.0])
    estimation.setpoints_ned(moving, 0.025, mobility, (pull, change, 0.3), frames, states)
    ahead = position + 0.025 * velocity + 0.5 * 0.025**2 * acceleration + LIFT
    relieved = acceleration - mobility[:, None] * (pull + 0.3 * change)
    enu = np.stack([ahead, velocity, relieved], axis=1)
    expected = np.einsum("nij,nkj->nki", turn, enu)
    expected[:, 0] += move
    assert states == pytest.approx(expected, abs=1e-12)


LIMITS = 0.5, 1.0, 0.4, 0.25, 1.0


@pytest.mark.parametrize(
    ("change", "told", "calm"),
    [
        ({}, True, True),
        ({"at": [5.0, 5.0], "last_at": [5.0, 5.0]}, False, True),
        ({"last_at": [4.9, -np.inf]}, True, False),
        ({"last_at": [4.9, 4.4]}, True, False),
        ({"last_at": [4.9, 4.4], "boot": [90.0, 80.0], "last_boot": [89.9, 79.8]}, True, True),
        ({"boot": [90.0, 80.0], "last_boot": [89.9, 79.2]}, True, False),
        ({"boot": [90.0, 80.0], "last_boot": [89.9, 85.0]}, True, True),
        ({"velocity": [[0.0, 0.0, -0.5], [0.0, 0.0, 0.0]]}, True, False),
        ({"told": [[0.0, 0.0, -0.4], [0.0, 0.0, 0.0]],
          "velocity": [[0.0, 0.0, -0.5], [0.0, 0.0, 0.0]]}, True, True),
        ({"streaming": [False, True],
          "velocity": [[0.0, 0.0, -1.3], [0.0, 0.0, 0.0]]}, True, True),
        ({"reported": [[0.0, 0.0, 0.0], [0.0, 0.3, 0.0]]}, True, False),
        ({"reported": [[0.0, 0.0, 0.0], [0.0, 0.3, 0.0]],
          "velocity": [[0.0, 0.0, 0.0], [0.0, 6.0, 0.0]]}, True, True),
        ({"last": np.full((2, 3), np.nan)}, True, False),
        ({"angles": [[0.0, 0.0, 3.0], [0.0, -1.1, 0.0]]}, True, False),
    ],
)  # fmt: skip
def test_sinking_jumping_and_turning_over_is_not_motion_as_commanded(change, told, calm):
    have = {"at": [5.0, 5.0], "last_at": [4.9, 4.9], "streaming": [True, True],
            "boot": [np.nan, np.nan], "last_boot": [np.nan, np.nan]} | change  # fmt: skip

    def of(name):
        return np.array(have.get(name, np.zeros((2, 3))))

    said, step = np.full((2, WIDTH), np.nan), np.zeros(2)
    said[:, RECEIVED_AT], said[:, ATTITUDE : ATTITUDE + 3] = [5.0, 4.8], of("angles")
    places = np.array([of("reported"), of("velocity"), np.zeros((2, 3))])
    before = np.array([of("last"), of("before"), np.zeros((2, 3))])
    now = Measured(places, np.array([of("at"), np.zeros(2), of("boot")]))
    last = Measured(before, np.array([of("last_at"), np.zeros(2), of("last_boot")]))
    found = estimation.new_reports(
        said, np.arange(2), (now, last), (of("told"), of("streaming")), LIMITS, step
    )
    assert found == (told, calm)
    assert (step > 0).any() == told


def test_the_time_between_reports_is_none_where_there_was_no_report():
    before, at = Measured.of(4), Measured.of(4)
    before.numbers[0] = [-np.inf, 1.0, -np.inf, 2.0]
    at.numbers[0] = [-np.inf, 1.5, 2.0, 2.0]
    said, step = np.full((4, WIDTH), np.nan), np.ones(4)
    none = np.zeros((4, 3))
    streaming = np.ones(4, bool)
    estimation.new_reports(said, np.arange(4), (at, before), (none, streaming), LIMITS, step)
    assert step.tolist() == [0.0, 0.5, np.inf, 0.0]


def test_only_new_reports_are_noted():
    now, last = Measured.of(2), Measured.of(2)
    now.places[:], now.numbers[0] = 1.0, 5.0
    last.places[:], last.numbers[0] = 0.0, [4.9, 5.0]
    estimation.keep_reports(now, last, np.array([0.1, 0.0]))
    assert last.reported.tolist() == [[1.0] * 3, [0.0] * 3]
    assert last.velocity.tolist() == [[1.0] * 3, [0.0] * 3]
    assert last.at.tolist() == [5.0, 5.0]


def test_the_time_between_reports_is_that_of_the_vehicle_s_clock():
    before, at = Measured.of(3), Measured.of(3)
    before.numbers[0], at.numbers[0] = [1.0, 1.0, 1.0], [2.2, 2.2, 1.0]
    before.numbers[2], at.numbers[2] = [50.0, np.nan, 50.0], [50.3, 70.0, 50.0]
    said, step = np.full((3, WIDTH), np.nan), np.ones(3)
    estimation.new_reports(
        said, np.arange(3), (at, before), (np.zeros((3, 3)), np.ones(3, bool)), LIMITS, step
    )
    assert step == pytest.approx([0.3, 1.2, 0.0])
