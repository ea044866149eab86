"""Broad phase of the collision check: whether a rotor can touch the cable.

It is cheap and conservative: it may report a contact that does not exist, but misses none.
"""

import math

import numpy as np
from numpy.typing import NDArray

from swarm.jit import compiled
from swarm.signatures import Columns2, Floats1, Floats2

Array = NDArray[np.float64]

_ROTOR_HEIGHT = 0.2
_DRIFT = 0.5
"""Metres by which a grip may have moved since the spans were solved."""


@compiled
def spans_reachable(
    start: Floats2,
    stop: Floats2,
    length: Floats1,
    sideways: float,
    centre: Columns2,
    radius: Floats1,
) -> bool:
    """Return whether a disc at a centre (n, 3) can touch a span from start to stop (m, 3).

    A span of at most ``length`` (m,) hangs below its higher end. In plan it departs from its chord
    by at most the drift of its length in a steady wind: ``sideways`` is the level part of the
    direction of its weight.
    """
    for j in range(len(start)):
        top = max(start[j, 2], stop[j, 2]) + _ROTOR_HEIGHT
        east, north = stop[j, 0] - start[j, 0], stop[j, 1] - start[j, 1]
        rise = stop[j, 2] - start[j, 2]
        squared = max(east * east + north * north, 1e-8)
        for i in range(len(centre)):
            if centre[i, 2] >= top:
                continue
            away_east, away_north = centre[i, 0] - start[j, 0], centre[i, 1] - start[j, 1]
            share = (away_east * east + away_north * north) / squared
            share = min(max(share, 0.0), 1.0)
            away_east -= share * east
            away_north -= share * north
            beside = radius[i] + sideways * length[j]
            if away_east * away_east + away_north * away_north >= beside * beside:
                continue
            # highest point of the chord, and so of the span, above the disc
            height = start[j, 2] + share * rise + beside * abs(rise) / math.sqrt(squared)
            if centre[i, 2] < height + _ROTOR_HEIGHT:
                return True
    return False


def end_reachable(grip: Array, length: float, floor: float, centre: Array, radius: Array) -> bool:
    """Return whether a disc at any of the centres (n, 3) can touch a loose end.

    The end hangs vertically below its grip (3,); a part near the floor may lie anywhere.
    """
    below = centre[:, 2] < grip[2] + _ROTOR_HEIGHT
    if float(grip[2]) - length >= floor + _DRIFT:
        away = np.hypot(centre[:, 0] - grip[0], centre[:, 1] - grip[1])
        below &= away < radius + _DRIFT
    return bool(np.count_nonzero(below))
