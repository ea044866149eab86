"""Whether a rotor could touch the cable at all, before its samples are worked out.

Bounds that may warn in vain and never keep silent.
"""

import numpy as np
from numpy.typing import NDArray

from sitl.spans import Hung

Array = NDArray[np.float64]

_ROTOR_HEIGHT = 0.2
_DRIFT = 0.5
"""Metres by which a grip may have moved since the spans were solved."""


def of_spans(hung: Hung, sideways: float, centre: Array, radius: Array) -> bool:
    """Whether a disc at any of the centres (n, 3) could touch a span.

    A span hangs below its higher end, and in plan beside its chord by no more than a steady wind
    blows a piece of its length aside: ``sideways`` is the level part of its weight's direction.
    """
    top = np.maximum(hung.start[:, 2], hung.stop[:, 2]) + _ROTOR_HEIGHT
    near = centre[:, 2, None] < top
    if not np.count_nonzero(near):
        return False
    east, north, rise = (hung.stop - hung.start).T
    squared = np.maximum(east * east + north * north, 1e-8)
    level = np.sqrt(squared)
    away_east = centre[:, 0, None] - hung.start[:, 0]
    away_north = centre[:, 1, None] - hung.start[:, 1]
    share = (away_east * east + away_north * north) / squared
    share = np.minimum(np.maximum(share, 0.0), 1.0)
    away_east -= share * east
    away_north -= share * north
    beside = radius[:, None]
    if sideways > 0.0:
        beside = beside + sideways * np.maximum(hung.length_used, hung.chord)
    near &= away_east * away_east + away_north * away_north < beside * beside
    if not np.count_nonzero(near):
        return False
    # above a disc the chord, and so the span, is nowhere higher than this
    chord_height = hung.start[:, 2] + share * rise
    chord_height += beside * (np.abs(rise) / level)
    near &= centre[:, 2, None] < chord_height + _ROTOR_HEIGHT
    return bool(np.count_nonzero(near))


def of_end(grip: Array, length: float, floor: float, centre: Array, radius: Array) -> bool:
    """Whether a disc at any of the centres (n, 3) could touch a loose end.

    It hangs straight below its grip (3,); what comes near the floor may lie anywhere.
    """
    below = centre[:, 2] < grip[2] + _ROTOR_HEIGHT
    if float(grip[2]) - length >= floor + _DRIFT:
        away = np.hypot(centre[:, 0] - grip[0], centre[:, 1] - grip[1])
        below &= away < radius + _DRIFT
    return bool(np.count_nonzero(below))
