"""What the sensors of a vehicle measure: noise, magnetic field, air pressure, satellite receiver.

ArduPilot has models of these in itself; PX4 gets values from its simulator. World ENU, body FLU.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from pygeomag import GeoMag

from sitl.physics.dynamics import Array
from sitl.physics.geodesy import Geodesy

INERTIAL_NOISE = np.array([0.03, 0.03, 0.03, 0.003, 0.003, 0.003])
"""Standard deviation of one sample: m/s² and rad/s. 0.002 m/s²/√Hz and 0.0002 rad/s/√Hz, as of
usual inertial sensors, over 100 Hz of bandwidth are 0.02 and 0.002; the rest is vibration."""
MAGNETIC_NOISE = 0.002
"""Standard deviation of a magnetometer's axis, gauss; usual sensors have 0.001 to 0.004."""
PRESSURE_NOISE = 0.01
"""Standard deviation of the pressure, hPa: 0.08 m of height, as a usual barometer."""
_MODEL, _YEAR = "wmm/WMM_2025.COF", 2026.5
"""The World Magnetic Model that is valid until 2030, and a year within it."""


class Fix(NamedTuple):
    """One fix of a receiver: degrees, metres above sea level, m/s ENU, stated errors in metres.

    ``kind`` is MAVLink's type of fix.
    """

    latitude: float
    longitude: float
    altitude: float
    velocity: tuple[float, float, float]
    level_error: float
    height_error: float
    kind: int


@dataclass(frozen=True)
class Receiver:
    """The quality of a receiver: standard deviations of a fix (m, m, m/s), and its type of fix."""

    level: float
    height: float
    speed: float
    kind: int
    interval: float


@dataclass(frozen=True)
class SensorFaults:
    """What is wrong with sensors.

    ``receiver``: it has a fix; ``offset``: its positions are wrong by that (m, ENU); ``barometer``:
    it is wrong by that height, metres.
    """

    receiver: bool = True
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)
    barometer: float = 0.0


NO_FIX = 1
"""MAVLink's type of fix of a receiver that has none."""
RTK = Receiver(level=0.008, height=0.012, speed=0.03, kind=6, interval=0.1)
"""A receiver with fixed carrier phases beside its base: 8 mm + 1 ppm and 12 mm by data sheets."""


def magnetic_field(latitude: float, longitude: float, altitude: float) -> Array:
    """Return the Earth's magnetic field (3,) in gauss, ENU, at a place in degrees and metres."""
    field = GeoMag(coefficients_file=_MODEL).calculate(
        glat=latitude, glon=longitude, alt=altitude / 1000.0, time=_YEAR
    )
    return 1e-5 * np.array([field.y, field.x, -field.z])


def air(altitude: float) -> tuple[float, float]:
    """Return pressure (hPa) and temperature (°C) of the standard atmosphere below 11 km."""
    kelvin = 288.15 - 0.0065 * altitude
    return 1013.25 * (kelvin / 288.15) ** 5.25588, kelvin - 273.15


def pressure_altitude(pressure: float) -> float:
    """Return the altitude at which the standard atmosphere has a pressure in hPa."""
    return (1.0 - math.pow(pressure / 1013.25, 1.0 / 5.25588)) * 288.15 / 0.0065


def fix(quality: Receiver, geodesy: Geodesy, position: Array, velocity: Array, noise: Array) -> Fix:
    """Return the fix of a receiver at ``position`` (3,), for six standard normal values."""
    level, height = quality.level, quality.height
    x, y, z = (position + np.array([level, level, height]) * noise[:3]).tolist()
    east, north, up = (velocity + quality.speed * noise[3:]).tolist()
    latitude, longitude, altitude = geodesy.degrees(x, y, z)
    return Fix(latitude, longitude, altitude, (east, north, up), level, height, quality.kind)
