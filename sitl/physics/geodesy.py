"""Conversion of degrees and metres near the world's origin, exactly and as autopilots do."""

import math
from dataclasses import dataclass

GRAVITY = 9.80665
"""Standard gravity, m/s²."""


@dataclass(frozen=True)
class Geodesy:
    """World ENU metres ⇄ degrees near the world's origin (WGS-84 radii of curvature there)."""

    latitude: float
    longitude: float
    altitude: float
    north: float
    east: float

    @classmethod
    def at(cls, latitude: float, longitude: float, altitude: float) -> "Geodesy":
        """Return the linearisation at a point; its error is millimetres within a few 100 m."""
        a, e2 = 6378137.0, 6.69437999014e-3
        s = math.sin(math.radians(latitude))
        w = math.sqrt(1 - e2 * s * s)
        meridian = a * (1 - e2) / w**3 + altitude
        prime = a / w + altitude
        return cls(
            latitude,
            longitude,
            altitude,
            math.radians(1) * meridian,
            math.radians(1) * prime * math.cos(math.radians(latitude)),
        )

    def degrees(self, x: float, y: float, z: float) -> tuple[float, float, float]:
        """Return latitude, longitude and altitude of a point of world ENU."""
        return self.latitude + y / self.north, self.longitude + x / self.east, self.altitude + z

    def scale(self, autopilot: str) -> tuple[float, float]:
        """Return an autopilot's local metres per true metre, east and north.

        PX4 projects on a sphere of 6 371 000 m (``lib/geo``), ArduPilot on one of 6 378 100 m
        (``AP_Math/definitions.h``).
        """
        degree = math.radians(1) * (6_371_000.0 if autopilot == "px4" else 6_378_100.0)
        shrink = math.cos(math.radians(self.latitude))
        return degree * shrink / self.east, degree / self.north

    def metres(self, latitude: float, longitude: float) -> tuple[float, float]:
        """Return x and y in world ENU of a latitude and longitude in degrees."""
        return (longitude - self.longitude) * self.east, (latitude - self.latitude) * self.north
