"""The curve γ: through its corners, in its lanes, C², and sharp where a vehicle stops."""

import numpy as np
import numpy.typing as npt
import pytest

from swarm.folding.path import FoldPath, Guide

Floats = npt.NDArray[np.float64]

OVERHAND = [(1, 4), (3, 4), (3, 2), (5, 2), (5, 5), (2, 5), (2, 3), (4, 3), (4, 1)]


@pytest.fixture(params=[1.0, 3.5])
def path(request: pytest.FixtureRequest) -> FoldPath:
    corners = request.param * np.array([(*corner, 1.0) for corner in OVERHAND], dtype=float)
    lanes = request.param * np.array([-0.9, 0.9, -0.9, -0.3, 0.3, 0.9, -0.9, 0.9])
    guide = Guide(corners, lanes, 0.9 * request.param, 0.5 * request.param, 20.0)
    return FoldPath(guide, np.repeat(lanes[:, None], len(corners), axis=1))


def test_every_vehicle_stops_at_its_own_corner(path: FoldPath) -> None:
    for vehicle, stop in enumerate(path.stops):
        place, _, _ = path.at(vehicle, np.array([stop]))
        np.testing.assert_allclose(place[0], path.corners[vehicle], atol=1e-6)
    assert path.stops[0] == pytest.approx(0.0, abs=1e-6)
    assert np.all(np.diff(path.stops) > 0.0)


def test_paths_follow_the_lanes_of_edges(path: FoldPath) -> None:
    progress = np.linspace(0.0, path.stops[-1], 4000)
    place, _, _ = path.at(len(path.stops) - 1, progress)
    station = path.station(progress)
    corners = np.concatenate(
        [[0.0], np.cumsum(np.linalg.norm(np.diff(path.corners, axis=0), axis=1))]
    )
    middle = 0.5 * (corners[1:] + corners[:-1])
    height = np.interp(middle, station, place[:, 2]) - path.corners[0, 2]
    lanes = path.lanes[:, -1]
    np.testing.assert_allclose(height, lanes, atol=1e-3 * np.abs(lanes).max())
    tallest = np.abs(place[:, 2] - path.corners[0, 2]).max()
    assert tallest <= np.abs(path.lanes).max() * (1 + 1e-9)


def test_the_run_in_is_straight_and_level(path: FoldPath) -> None:
    progress = np.linspace(path.start, 0.0, 200)
    for vehicle in (0, 5):
        place, _, _ = path.at(vehicle, progress)
        np.testing.assert_allclose(place[:, 1:], place[:1, 1:].repeat(200, axis=0), atol=1e-9)
        np.testing.assert_allclose(place[:, 0] - path.corners[0, 0], progress, atol=1e-4)


def test_derivatives_by_progress(path: FoldPath) -> None:
    """Derivatives integrate to positions, and progress is nearly the arc length."""
    progress, step = np.linspace(path.start, path.stops[-1], 100_001, retstep=True)
    for vehicle in (4, 8):
        inside = progress <= path.stops[vehicle]
        place, along, curved = path.at(vehicle, progress[inside])
        carried = np.cumsum(0.5 * (along[1:] + along[:-1]), axis=0) * step
        np.testing.assert_allclose(carried, place[1:] - place[0], atol=1e-4 * np.ptp(place))
        turned = np.cumsum(0.5 * (curved[1:] + curved[:-1]), axis=0) * step
        np.testing.assert_allclose(turned, along[1:] - along[0], atol=1e-2)
        assert np.abs(np.diff(along, axis=0)).max() < 1.05 * step * np.abs(curved).max()
        speed = np.linalg.norm(along, axis=1)
        assert speed.min() > 0.4
        shared = path.station(progress[inside]) < path.stations[vehicle - 1]
        assert speed[shared].max() < 1.3
        assert speed.max() < 4.0


def test_a_vehicle_that_stops_at_a_corner_arrives_straight(path: FoldPath) -> None:
    stop = path.stops[4]
    near = stop - np.linspace(0.3, 0.0, 20)
    own, _, _ = path.at(4, near)
    passing, _, _ = path.at(5, near)
    heading = path.corners[4, :2] - path.corners[3, :2]
    across = np.array([-heading[1], heading[0]]) / np.linalg.norm(heading)
    assert np.abs((own[:, :2] - path.corners[4, :2]) @ across).max() < 1e-9
    assert np.linalg.norm(passing[-1, :2] - path.corners[4, :2]) > 0.05


def test_places_are_the_positions_to_the_last_bit(path: FoldPath) -> None:
    for vehicle, stop in enumerate(path.stops):
        progress = np.linspace(path.start, stop + 1.0, 500)
        assert np.array_equal(path.places(vehicle, progress), path.at(vehicle, progress)[0])
