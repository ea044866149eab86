"""Coarse distances of strands and bodies, by boxes, before exact ones are computed; compiled."""

import numpy as np
import numpy.typing as npt

from swarm.certification.bodies import Body
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
def body_box_distance(
    grips: Floats, lengths: Floats, pair: tuple[int, int], moved: tuple[float, float], body: Body
) -> float:
    """Return the distance of the axis-aligned boxes around a strand and a vehicle's body, metres.

    ``pair`` are the vehicle and the segment; the strand's ends and the vehicle move by up to
    ``moved``.
    """
    k, i = pair
    square, (of_ends, of_body) = 0.0, moved
    for axis in range(3):
        low = min(grips[i, axis], grips[i + 1, axis]) - of_ends
        high = max(grips[i, axis], grips[i + 1, axis]) + of_ends
        aside, above = (body.radius, body.radius) if axis < 2 else (0.0, body.grip_offset)
        if axis == 2:
            low -= max_drop_below_ends(grips[i], grips[i + 1], lengths[i], of_ends)
        beside = low - grips[k, axis] - above, grips[k, axis] - aside - high
        gap = max(beside[0] - of_body, beside[1] - of_body, 0.0)
        square += gap * gap
    return float(np.sqrt(square))
