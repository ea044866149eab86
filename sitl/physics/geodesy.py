"""Degrees and metres near the world's origin, exactly and as autopilots convert them."""

import math
from dataclasses import dataclass

GRAVITY = 9.80665
"""m/s²; the emulated world's is the standard one everywhere."""


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
        """Make the local linearisation (good to millimetres within a few hundred metres)."""
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
        """Latitude, longitude, altitude of a point given in world ENU."""
        return self.latitude + y / self.north, self.longitude + x / self.east, self.altitude + z

    def scale(self, autopilot: str) -> tuple[float, float]:
        """Local metres east and north that an autopilot makes of one true metre.

        PX4 projects on a sphere of 6 371 000 m (``lib/geo``), ArduPilot takes 111 318.845 m for a
        degree of latitude (``Location``'s scaling factor).
        """
        degree = math.radians(1) * 6_371_000.0 if autopilot == "px4" else 111_318.845
        shrink = math.cos(math.radians(self.latitude))
        return degree * shrink / self.east, degree / self.north

    def metres(self, latitude: float, longitude: float) -> tuple[float, float]:
        """World ENU x, y of a geodetic place."""
        return (longitude - self.longitude) * self.east, (latitude - self.latitude) * self.north
