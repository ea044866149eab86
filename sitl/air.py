"""The air that vehicles and cable are in: gusts, and what rotors push down."""

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from sitl import motion

if TYPE_CHECKING:
    from sitl.dynamics import Bodies

Array = NDArray[np.float64]

AIR_DENSITY = 1.2
WASH_FACTOR = 3.0
"""Felt downwash over its drag on the body: rotors lose thrust in falling air, as in a climb."""
_GUST_LENGTH = 30.0


def jets(lift: Array, radius: Array, below: Array, distance: Array) -> Array:
    """Downward air speed under every vehicle: (m, n) for m places and n vehicles.

    ``lift`` (n,) in newtons, ``radius`` (n,) of the vehicles; ``below`` (m, n) is how far a place
    is below a vehicle, ``distance`` (m, n) the level distance squared.

    Momentum theory gives the far-wake speed ``2 √(T / 2ρA)``; further down the jet is a turbulent
    round one: Gaussian in radius, widening by a tenth of its length and slowing accordingly (Pope,
    "Turbulent Flows", 5.1; Jain et al., ICRA 2019, for multirotors).
    """
    jet = 2 * np.sqrt(lift / (2 * AIR_DENSITY * np.pi)) / radius
    width = 0.7 * radius + 0.1 * np.maximum(below, 0.0)
    speed = jet * (0.7 * radius / width) * np.exp(-distance / (2 * width**2))
    felt: Array = speed * ((below > 0.1) & (below < 10.0))
    return felt


def blow(b: "Bodies", interval: float) -> None:
    """Advance gusts and downwash by ``interval`` seconds.

    Dryden's first-order longitudinal filter on every axis (MIL-F-8785C, low altitude), upright with
    half the intensity. Four fifths of a gust are common to the whole team, whose vehicles are close
    together.
    """
    if b.gust_intensity > 0:
        fresh = b.rng.standard_normal((b.count + 1, 3))
        speed = math.hypot(*b.steady_wind[0].tolist())
        keep = math.exp(-interval * max(1.0, speed) / _GUST_LENGTH)
        motion.gusts(b.gust, fresh, keep, b.gust_intensity)
        motion.winds(b.steady_wind, b.gust, b.wind)
    _downwash(b)


def _downwash(b: "Bodies") -> None:
    """Air pushed down on vehicles below others, as a vertical wind in their drag."""
    b.wash[:, 2] = -WASH_FACTOR * motion.downwash(b.now, b.mass, b.radius, AIR_DENSITY, b.apart)


def wash_at(b: "Bodies", places: Array) -> Array:
    """Downward air speed at places in the world (m, 3) from every vehicle: (m, n)."""
    across = places[:, None, :2] - b.position[None, :, :2]
    distance = np.einsum("ijk,ijk->ij", across, across)
    below = b.position[None, :, 2] - places[:, None, 2]
    return jets(_carried(b), b.radius, below, distance)


def _carried(b: "Bodies") -> Array:
    """Newtons by which each vehicle's rotors push air down (n,)."""
    lift: Array = np.maximum(b.thrust[:, 2], 0.0) * b.mass
    return lift
