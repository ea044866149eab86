"""Mission ENU ⇄ each vehicle's own NED, through each vehicle's own origin.

An autopilot's local frame starts where its estimator started. It projects latitude and longitude
to metres with a formula of its own, which is the frame that setpoints are flown in:

- PX4: azimuthal equidistant on a sphere of 6 371 000 m (its ``MapProjection``);
- ArduPilot: degrees times a constant, longitudes scaled by the cosine of the latitude
  (its ``Location``, sphere of 6 378 137 m).

On WGS 84 a metre of theirs is up to 0.6 % off a metre, which over a team's extent is centimetres.
So mission points go to geodetic coordinates by pymap3d, and from there by the autopilot's formula.
Over a mission's extent this is affine to well below a millimetre: one matrix per vehicle.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
import numpy.typing as npt
import pymap3d

from swarm.jit import compiled

Floats = npt.NDArray[np.float64]
Projection = Literal["px4", "ardupilot"]

_REACH = 50.0
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

    def to_vehicles(self, states: Floats) -> Floats:
        """Return states (n, 3, 3), mission ENU, in the vehicles' NED.

        A vehicle's three rows are its position, velocity and acceleration.
        """
        return _to_vehicles(states, self.rotation, self.translation)

    def of(self, order: Sequence[int]) -> "Frames":
        """Return the frames of some of the vehicles, in another order."""
        return Frames(self.rotation[order], self.translation[order])

    def points_to_mission(self, points: Floats) -> Floats:
        """Return points (n, 3), each in its vehicle's NED, in mission ENU."""
        turned: Floats = np.matmul(self._inverse, (points - self.translation)[:, :, None])[:, :, 0]
        return turned

    @cached_property
    def back(self) -> tuple[Floats, Floats]:
        """The maps back: matrices (n, 3, 3) and (n, 3), ENU = matrix · NED + offset."""
        return self._inverse, self.points_to_mission(np.zeros_like(self.translation))

    @cached_property
    def _inverse(self) -> Floats:
        return np.ascontiguousarray(np.linalg.inv(self.rotation).astype(np.float64))

    def shifted(self, by: Floats) -> "Frames":
        """Return the frames after moving each vehicle's mission points by (n, 3) ENU metres."""
        turned = np.matmul(self.rotation, by[:, :, None])[:, :, 0]
        return replace(self, translation=self.translation - turned)


@compiled
def _to_vehicles(states: Floats, rotation: Floats, translation: Floats) -> Floats:
    """Turn states (n, 3, 3) by n rotations, and move the first row of each."""
    turned = np.empty(states.shape)
    for i in range(len(states)):
        for j in range(3):
            for k in range(3):
                turned[i, j, k] = (
                    rotation[i, k, 0] * states[i, j, 0]
                    + rotation[i, k, 1] * states[i, j, 1]
                    + rotation[i, k, 2] * states[i, j, 2]
                )
        for k in range(3):
            turned[i, 0, k] += translation[i, k]
    return turned


def shared_frames(vehicles: int, heading: float = 0.0) -> Frames:
    """Return the frames of vehicles that share the mission's origin, as with motion capture.

    ``heading`` turns the mission's x axis from east towards north, in radians.
    """
    rotation = _NED_OF_ENU @ _turn(heading)
    return Frames(np.tile(rotation, (vehicles, 1, 1)), np.zeros((vehicles, 3)))


def gps_frames(
    mission: Origin,
    heading: float,
    origins: Sequence[Origin],
    projections: Sequence[Projection],
) -> Frames:
    """Return the frames of vehicles whose local frames start at the given origins.

    ``mission`` is the mission's (0, 0, 0), ``heading`` the angle in radians by which its x axis is
    turned from east towards north.
    """
    axes = _REACH * np.eye(3)
    samples = np.concatenate([np.zeros((1, 3)), axes, -axes]) @ _turn(heading).T
    latitude, longitude, altitude = pymap3d.enu2geodetic(
        *samples.T, mission.latitude, mission.longitude, mission.altitude
    )
    rotation, translation = [], []
    for origin, projection in zip(origins, projections, strict=True):
        level = [
            _project(projection, origin, *place)
            for place in zip(latitude.tolist(), longitude.tolist(), strict=True)
        ]
        local = np.column_stack([level, origin.altitude - altitude])
        rotation.append((local[1:4] - local[4:7]).T / (2.0 * _REACH))
        translation.append(local[0])
    return Frames(np.array(rotation), np.array(translation))


def to_local(projection: Projection, origin: Origin, place: Origin) -> tuple[float, float, float]:
    """Return where an autopilot with this origin says that a place is: NED metres."""
    north, east = _project(projection, origin, place.latitude, place.longitude)
    return north, east, origin.altitude - place.altitude


def to_mission(mission: Origin, heading: float, place: Origin) -> Floats:
    """Return a place on the earth in mission ENU (3,), heights being differences of altitude."""
    east, north, _ = pymap3d.geodetic2enu(
        place.latitude,
        place.longitude,
        mission.altitude,
        mission.latitude,
        mission.longitude,
        mission.altitude,
    )
    level: Floats = _turn(heading).T @ np.array([float(east), float(north), 0.0])
    level[2] = place.altitude - mission.altitude
    return level


def from_mission(mission: Origin, heading: float, point: Floats) -> Origin:
    """Return the place on the earth of a mission point (3,), ENU metres."""
    east, north, up = _turn(heading) @ point
    latitude, longitude, _ = pymap3d.enu2geodetic(
        east, north, 0.0, mission.latitude, mission.longitude, mission.altitude
    )
    return Origin(float(latitude), float(longitude), mission.altitude + float(up))


def _turn(heading: float) -> Floats:
    """Return the rotation from mission axes to east, north, up."""
    cosine, sine = np.cos(heading), np.sin(heading)
    return np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])


def _project(
    projection: Projection, origin: Origin, latitude: float, longitude: float
) -> tuple[float, float]:
    """Return north and east in metres as the autopilot computes them."""
    north_angle = math.radians(latitude - origin.latitude)
    east_angle = math.radians((longitude - origin.longitude + 180.0) % 360.0 - 180.0)
    if projection == "ardupilot":
        middle = math.radians((latitude + origin.latitude) / 2.0)
        return 6_378_137.0 * north_angle, 6_378_137.0 * east_angle * math.cos(middle)
    at, start = math.radians(latitude), math.radians(origin.latitude)
    cosine = math.sin(start) * math.sin(at) + math.cos(start) * math.cos(at) * math.cos(east_angle)
    angle = math.acos(min(max(cosine, -1.0), 1.0))
    stretch = angle / math.sin(angle) if angle > 1e-9 else 1.0
    # cos(start)·sin(at) − sin(start)·cos(at)·cos(east), written without its cancellation
    curved = math.sin(start) * math.cos(at) * 2.0 * math.sin(east_angle / 2.0) ** 2
    north, east = math.sin(north_angle) + curved, math.cos(at) * math.sin(east_angle)
    return 6_371_000.0 * stretch * north, 6_371_000.0 * stretch * east
