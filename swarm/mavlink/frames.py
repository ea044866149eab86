"""Transformations between mission ENU and the local NED frame of each vehicle.

The origin of an autopilot's local frame is the place where its estimator started. The autopilot
projects latitude and longitude to metres by its own formula, and flies setpoints in this frame:

- PX4: azimuthal equidistant on a sphere of 6 371 000 m (its ``MapProjection``);
- ArduPilot: degrees times a constant, longitudes scaled by the cosine of the latitude
  (its ``Location``, sphere of 6 378 100 m).

On WGS 84 their metre differs from a metre by up to 0.6 %, which is centimetres over the extent of a
team. So pymap3d transforms mission points to geodetic coordinates, and the autopilot's formula
transforms these to its frame. Over the extent of a mission the result is affine to well below a
millimetre: one matrix per vehicle.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
import numpy.typing as npt
import pymap3d

Floats = npt.NDArray[np.float64]
AutopilotName = Literal["px4", "ardupilot"]

_HALF_SPAN = 50.0
"""Half the distance in metres over which the affine map is measured."""

_NED_OF_ENU = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


@dataclass(frozen=True)
class Origin:
    """A place on the earth: degrees, and metres above mean sea level."""

    latitude: float
    longitude: float
    altitude: float


@dataclass(frozen=True)
class Frames:
    """The affine maps from mission ENU to the NED of n vehicles.

    ``rotation`` (n, 3, 3) and ``translation`` (n, 3): NED = rotation · ENU + translation.
    """

    rotation: Floats
    translation: Floats

    def select(self, order: Sequence[int]) -> "Frames":
        """Return the frames of the vehicles with these indices, in this order."""
        return Frames(self.rotation[order], self.translation[order])

    def points_to_mission(self, points: Floats) -> Floats:
        """Return points (n, 3), each given in its vehicle's NED, in mission ENU."""
        rotated: Floats = np.matmul(self._inverse, (points - self.translation)[:, :, None])
        return rotated[:, :, 0]

    @cached_property
    def inverse(self) -> tuple[Floats, Floats]:
        """The inverse maps: matrices (n, 3, 3) and offsets (n, 3), ENU = matrix · NED + offset."""
        return self._inverse, self.points_to_mission(np.zeros_like(self.translation))

    @cached_property
    def _inverse(self) -> Floats:
        return np.ascontiguousarray(np.linalg.inv(self.rotation).astype(np.float64))

    def shifted(self, by: Floats) -> "Frames":
        """Return the frames after a shift of the mission points by (n, 3), ENU metres."""
        offset = np.matmul(self.rotation, by[:, :, None])[:, :, 0]
        return replace(self, translation=self.translation - offset)


def shared_frames(vehicles: int, heading: float = 0.0) -> Frames:
    """Return the frames of vehicles that share the mission's origin, as with motion capture.

    ``heading`` is the angle in radians by which the mission's x axis is turned from east towards
    north.
    """
    rotation = _NED_OF_ENU @ _axes(heading)
    return Frames(np.tile(rotation, (vehicles, 1, 1)), np.zeros((vehicles, 3)))


def gps_frames(
    mission: Origin,
    heading: float,
    origins: Sequence[Origin],
    autopilots: Sequence[AutopilotName],
) -> Frames:
    """Return the frames of vehicles whose local frames have the given origins.

    ``mission`` is the mission's (0, 0, 0), ``heading`` the angle in radians by which its x axis is
    turned from east towards north.
    """
    axes = _HALF_SPAN * np.eye(3)
    samples = np.concatenate([np.zeros((1, 3)), axes, -axes]) @ _axes(heading).T
    latitude, longitude, altitude = pymap3d.enu2geodetic(
        *samples.T, mission.latitude, mission.longitude, mission.altitude
    )
    rotation, translation = [], []
    for origin, autopilot in zip(origins, autopilots, strict=True):
        horizontal = [
            _project(autopilot, origin, *place)
            for place in zip(latitude.tolist(), longitude.tolist(), strict=True)
        ]
        local = np.column_stack([horizontal, origin.altitude - altitude])
        rotation.append((local[1:4] - local[4:7]).T / (2.0 * _HALF_SPAN))
        translation.append(local[0])
    return Frames(np.array(rotation), np.array(translation))


def to_local(autopilot: AutopilotName, origin: Origin, place: Origin) -> tuple[float, float, float]:
    """Return the local NED position, in metres, of a place for an autopilot with this origin."""
    north, east = _project(autopilot, origin, place.latitude, place.longitude)
    return north, east, origin.altitude - place.altitude


def to_mission(mission: Origin, heading: float, place: Origin) -> Floats:
    """Return a place on the earth in mission ENU (3,); the height is the difference of altitude."""
    east, north, _ = pymap3d.geodetic2enu(
        place.latitude,
        place.longitude,
        mission.altitude,
        mission.latitude,
        mission.longitude,
        mission.altitude,
    )
    point: Floats = _axes(heading).T @ np.array([float(east), float(north), 0.0])
    point[2] = place.altitude - mission.altitude
    return point


def from_mission(mission: Origin, heading: float, point: Floats) -> Origin:
    """Return the place on the earth of a mission point (3,), ENU metres."""
    east, north, up = _axes(heading) @ point
    latitude, longitude, _ = pymap3d.enu2geodetic(
        east, north, 0.0, mission.latitude, mission.longitude, mission.altitude
    )
    return Origin(float(latitude), float(longitude), mission.altitude + float(up))


def _axes(heading: float) -> Floats:
    """Return the rotation from mission axes to east, north, up."""
    cosine, sine = np.cos(heading), np.sin(heading)
    return np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])


def _project(
    autopilot: AutopilotName, origin: Origin, latitude: float, longitude: float
) -> tuple[float, float]:
    """Return north and east in metres as the autopilot computes them."""
    north_angle = math.radians(latitude - origin.latitude)
    east_angle = math.radians((longitude - origin.longitude + 180.0) % 360.0 - 180.0)
    if autopilot == "ardupilot":
        middle = math.radians((latitude + origin.latitude) / 2.0)
        return 6_378_100.0 * north_angle, 6_378_100.0 * east_angle * math.cos(middle)
    at, start = math.radians(latitude), math.radians(origin.latitude)
    cosine = math.sin(start) * math.sin(at) + math.cos(start) * math.cos(at) * math.cos(east_angle)
    angle = math.acos(min(max(cosine, -1.0), 1.0))
    scale = angle / math.sin(angle) if angle > 1e-9 else 1.0
    # cos(start)·sin(at) − sin(start)·cos(at)·cos(east), without cancellation
    curved = math.sin(start) * math.cos(at) * 2.0 * math.sin(east_angle / 2.0) ** 2
    north, east = math.sin(north_angle) + curved, math.cos(at) * math.sin(east_angle)
    return 6_371_000.0 * scale * north, 6_371_000.0 * scale * east
