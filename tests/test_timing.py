"""Timed paths: within the limits, C², and nearly optimal."""

import numpy as np
import numpy.typing as npt
import pytest
from scipy.interpolate import CubicSpline

from swarm.geometry.motion import leg
from swarm.planning.timing import slow_to_limits, time_path
from tests.geometry.test_motion import jumps

Floats = npt.NDArray[np.float64]


def winding(seed: int) -> tuple[Floats, Floats, Floats, Floats]:
    """A random path of three points that begins and ends with vanishing derivatives."""
    rng = np.random.default_rng(seed)
    knots = np.cumsum(rng.uniform(-1.0, 2.0, (8, 9)), axis=0)
    spline = CubicSpline(np.linspace(0.0, 1.0, 8), knots.reshape(8, 3, 3), axis=0)
    parameter = np.linspace(0.0, 40.0, 801)
    u = parameter / 40.0
    ease = u**3 * (10 - 15 * u + 6 * u**2)
    rate = 30 * u**2 * (1 - u) ** 2 / 40.0
    bend = 60 * u * (1 - u) * (1 - 2 * u) / 1600.0
    first, second = spline(ease, 1), spline(ease, 2)
    return (
        parameter,
        spline(ease),
        first * rate[:, None, None],
        second * (rate**2)[:, None, None] + first * bend[:, None, None],
    )


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize(("speed", "thrust"), [(2.0, 1.0), (0.5, 3.0), (5.0, 0.3)])
def test_a_timed_path_keeps_limits_and_the_path(seed: int, speed: float, thrust: float) -> None:
    path = winding(seed)
    motion = time_path(*path, max_speed=speed, max_acceleration=thrust)
    times = np.linspace(0.0, motion.times[-1], 20_000)
    position, velocity, acceleration = motion.at(times)
    fastest = np.linalg.norm(velocity, axis=2).max()
    hardest = np.linalg.norm(acceleration, axis=2).max()
    assert fastest <= speed * 1.002
    assert hardest <= thrust * 1.01
    assert max(fastest / speed, hardest / thrust) > 0.5, "needlessly slow"
    assert jumps(motion).max() < 1e-6
    for states in motion.at(motion.times[[0, -1]])[1:]:
        assert np.abs(states).max() < 1e-6
    for vehicle in range(3):
        off = [
            np.linalg.norm(path[1][:, vehicle] - place, axis=1).min()
            for place in position[::400, vehicle]
        ]
        assert max(off) < 0.15


def test_time_is_stretched_only_where_necessary() -> None:
    motion = leg(np.zeros((1, 3)), np.ones((1, 3)), 1.0, 1.0)
    assert slow_to_limits(motion, 1.0, 1.0) is motion
    slower = slow_to_limits(motion, 0.25, 1.0)
    _, velocity, _ = slower.at(np.linspace(0.0, slower.times[-1], 1000))
    assert np.linalg.norm(velocity, axis=2).max() <= 0.25
    np.testing.assert_allclose(slower.at(slower.times[-1])[0], 1.0)


@pytest.mark.parametrize(("speed", "thrust"), [(2.0, 1.0), (1.0, 2.0), (4.0, 0.6)])
def test_a_straight_path_takes_little_longer_than_the_minimum(speed: float, thrust: float) -> None:
    parameter = np.linspace(0.0, 60.0, 481)
    from_end = np.minimum(parameter, 60.0 - parameter)
    # Units of the parameter are half a metre long, but for the first and the last two.
    share = np.minimum(from_end / 2.0, 1.0)
    gone = 0.5 * np.where(share < 1.0, 2.0 * share**3 - share**4, from_end - 1.0)
    along = np.where(parameter < 30.0, gone, 29.0 - gone)
    rate = 0.5 * (3.0 * share**2 - 2.0 * share**3)
    bend = 1.5 * (share - share**2) * np.sign(30.0 - parameter)
    way = np.array([0.6, 0.0, 0.8])
    path = (values[:, None, None] * way for values in (along, rate, bend))
    motion = time_path(parameter, *path, max_speed=speed, max_acceleration=thrust)
    # At full thrust to full speed and back, or to half way where that is less.
    top = min(speed, np.sqrt(29.0 * thrust))
    least = 29.0 / top + top / thrust
    assert least <= motion.times[-1] <= 1.07 * least
