"""Coarse distances of strands, by boxes and by points, before exact ones are computed; compiled."""

import numpy as np
import numpy.typing as npt

from swarm.geometry.catenary_kernel import max_drop_below_ends
from swarm.jit import inner

Floats = npt.NDArray[np.float64]


@inner
def box_distance(
    grips: Floats,
    lengths: Floats,
    pair: tuple[int, int],
    moved: tuple[float, float],
    enough: float,
) -> float:
    """Return the distance of the axis-aligned boxes that contain two strands, metres.

    ``grips`` (n, 3) and ``lengths`` (n − 1,) are the cable's, ``pair`` the segments; the ends of
    each move by up to ``moved``. From ``enough`` on, the result is only a lower bound.
    """
    i, j = pair
    square = 0.0
    for axis in range(3):
        low = min(grips[i, axis], grips[i + 1, axis]) - moved[0]
        high = max(grips[i, axis], grips[i + 1, axis]) + moved[0]
        other_low = min(grips[j, axis], grips[j + 1, axis]) - moved[1]
        other_high = max(grips[j, axis], grips[j + 1, axis]) + moved[1]
        if axis == 2:
            if square >= enough * enough:
                return enough
            low -= max_drop_below_ends(grips[i], grips[i + 1], lengths[i], moved[0])
            other_low -= max_drop_below_ends(grips[j], grips[j + 1], lengths[j], moved[1])
        gap = max(low - other_high, other_low - high, 0.0)
        square += gap * gap
    return float(np.sqrt(square))


@inner
def squared_point_distance(first: Floats, second: Floats) -> float:
    """Return the square of the smallest distance between the points (k, 3) of two strands."""
    least = np.inf
    for i in range(len(first)):
        x, y, z = first[i, 0], first[i, 1], first[i, 2]
        for j in range(len(second)):
            square = (second[j, 0] - x) ** 2 + (second[j, 1] - y) ** 2 + (second[j, 2] - z) ** 2
            least = min(least, square)
    return float(least)
