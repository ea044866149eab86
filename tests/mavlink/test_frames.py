"""Frames: distances on the autopilots' own spheres, round trips, and agreement between vehicles."""

import math

import numpy as np
import pymap3d
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from swarm.mavlink.frames import Frames, Origin, gps_frames, shared_frames, to_local, to_mission

latitudes = st.floats(-70, 70)
longitudes = st.floats(-179.99, 179.99)
metres = st.floats(-60, 60)


def to_vehicles(frames: Frames, states: np.ndarray) -> np.ndarray:
    """Positions, velocities and accelerations (n, 3, 3), mission ENU, in the vehicles' NED."""
    turned = np.einsum("nij,nkj->nki", frames.rotation, states)
    turned[:, 0] += frames.translation
    return turned


def haversine(one: Origin, other: Origin, radius: float) -> float:
    a, b = math.radians(one.latitude), math.radians(other.latitude)
    east = math.radians(other.longitude - one.longitude)
    h = math.sin((b - a) / 2) ** 2 + math.cos(a) * math.cos(b) * math.sin(east / 2) ** 2
    return 2 * radius * math.asin(math.sqrt(h))


@given(latitudes, longitudes, metres, metres)
def test_px4_distances_are_great_circles_on_its_sphere(latitude, longitude, north, east):
    origin = Origin(latitude, longitude, 100.0)
    place = Origin(latitude + north * 9e-6, longitude + east * 9e-6, 93.0)
    local = to_local("px4", origin, place)
    assert math.hypot(*local[:2]) == pytest.approx(haversine(origin, place, 6_371_000.0), abs=1e-6)
    assert local[2] == pytest.approx(7.0)


def test_longitudes_wrap():
    north, east, _ = to_local("px4", Origin(10, 179.9999, 0), Origin(10, -179.9999, 0))
    assert north == pytest.approx(0.0, abs=1e-3)
    assert east == pytest.approx(0.0002 * math.pi / 180 * 6_371_000 * math.cos(math.radians(10)))


@pytest.mark.parametrize("projection", ["px4", "ardupilot"])
@given(latitudes, longitudes, st.floats(-3.2, 3.2), st.data())
@settings(max_examples=60, deadline=None)
def test_points_are_at_their_place_on_the_earth(projection, latitude, longitude, heading, data):
    """The autopilot's place of our setpoint is the place of the mission point on WGS 84."""
    mission = Origin(latitude, longitude, 400.0)
    east, north, up, e, n, u = (data.draw(metres) for _ in range(6))
    at = pymap3d.enu2geodetic(east, north, 0.0, latitude, longitude, 400.0)
    origin = Origin(float(at[0]), float(at[1]), 400.0 + up)
    frames = gps_frames(mission, heading, [origin], [projection])
    point = np.array([[e, n, u]])
    asked = to_vehicles(frames, np.stack([point] * 3, axis=1))[0][0]
    turned = np.array(
        [
            math.cos(heading) * e - math.sin(heading) * n,
            math.sin(heading) * e + math.cos(heading) * n,
        ]
    )
    place = pymap3d.enu2geodetic(*turned, 0.0, latitude, longitude, 400.0)
    meant = to_local(projection, origin, Origin(float(place[0]), float(place[1]), 400.0 + u))
    assert asked == pytest.approx(meant, abs=2e-3)
    assert to_mission(mission, heading, Origin(float(place[0]), float(place[1]), 400.0 + u)) == (
        pytest.approx([e, n, u], abs=2e-3)
    )


@given(st.data())
@settings(max_examples=50)
def test_the_inverse_returns_the_points(data):
    n = 4
    numbers = st.lists(metres, min_size=3 * n, max_size=3 * n)
    position, velocity = (np.array(data.draw(numbers)).reshape(n, 3) for _ in range(2))
    origins = [Origin(47.4 + 1e-5 * k, 8.5 - 2e-5 * k, 400.0 + 3 * k) for k in range(n)]
    frames = gps_frames(Origin(47.4, 8.5, 410.0), 0.7, origins, ["px4", "ardupilot"] * 2)
    frames = frames.shifted(np.array([[0.1, 0.2, 3.0]] * n))
    local = to_vehicles(frames, np.stack([position, velocity, velocity], axis=1))
    turn, offset = frames.inverse
    back = np.einsum("nij,nj->ni", turn, local[:, 0]) + offset
    assert back == pytest.approx(position, abs=1e-9)
    assert np.einsum("nij,nj->ni", turn, local[:, 1]) == pytest.approx(velocity, abs=1e-9)
    assert frames.points_to_mission(local[:, 0]) == pytest.approx(position, abs=1e-9)


def test_a_shift_moves_reported_positions():
    frames = shared_frames(2)
    ned = np.array([[1.0, 2.0, -3.0], [0.0, 0.0, 0.0]])
    before = frames.points_to_mission(ned)
    by = np.array([[0.5, -0.25, 1.0], [0.0, 0.0, 2.0]])
    assert frames.shifted(by).points_to_mission(ned) == pytest.approx(before + by)


def test_shared_frames_are_rotated_enu():
    states = np.full((1, 3, 3), [1.0, 0.0, 2.0])
    assert to_vehicles(shared_frames(1), states)[0][0] == pytest.approx([0, 1, -2])
    turned = to_vehicles(shared_frames(1, math.pi / 2), states)[0][0]
    assert turned == pytest.approx([1, 0, -2])
