"""Wind on vehicles and cable: gusts, and the downwash of rotors."""

import math

import numpy as np
from numpy.typing import NDArray

from sitl.physics.motion import AIR_DENSITY

Array = NDArray[np.float64]

WASH_FACTOR = 3.0
"""Effect of downwash, relative to its drag: rotors lose thrust in descending air, as in a climb."""
_GUST_LENGTH = 30.0
"""Scale length of gusts, metres."""


def jets(lift: Array, radius: Array, below: Array, distance: Array) -> Array:
    """Return the downward air speed (m, n) at m places under n vehicles.

    ``lift`` (n,) in newtons, ``radius`` (n,) of the vehicles; ``below`` (m, n) are the heights of
    the vehicles above the places, ``distance`` (m, n) the horizontal distances squared.

    Momentum theory gives the far-wake speed ``2 √(T / 2ρA)``; further down the wake is a turbulent
    round jet: Gaussian in radius, its width grows by a tenth of its length and its speed falls
    accordingly (Pope, "Turbulent Flows", 5.1; Jain et al., ICRA 2019, for multirotors).
    """
    jet = 2 * np.sqrt(lift / (2 * AIR_DENSITY * np.pi)) / radius
    width = 0.7 * radius + 0.1 * np.maximum(below, 0.0)
    speed = jet * (0.7 * radius / width) * np.exp(-distance / (2 * width**2))
    downwash: Array = speed * ((below > 0.1) & (below < 10.0))
    return downwash


def gust_persistence(steady: Array, interval: float) -> float:
    """Return the share of a gust that persists after ``interval`` seconds in a steady wind (3,).

    Dryden's first-order longitudinal filter on every axis (MIL-F-8785C, low altitude), vertical
    with half the intensity. Four fifths of a gust are common to the whole team, whose vehicles are
    close together.
    """
    return math.exp(-interval * max(1.0, math.hypot(*steady.tolist())) / _GUST_LENGTH)


def downwash_at(places: Array, position: Array, lift: Array, radius: Array) -> Array:
    """Return the downward air speed (m, n) at places (m, 3) under each of n vehicles.

    ``position`` (n, 3) and ``radius`` (n,) are the vehicles', ``lift`` (n,) is their upward thrust
    in newtons.
    """
    across = places[:, None, :2] - position[None, :, :2]
    distance = np.einsum("ijk,ijk->ij", across, across)
    below = position[None, :, 2] - places[:, None, 2]
    return jets(lift, radius, below, distance)
