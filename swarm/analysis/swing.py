"""Bounds on the movement of strands by sway and by a stop, in any direction.

Same models as in the budget. The budget counts the movement along the line between two strands, at
its tightest moments; a simulated rope is compared with the whole movement, at the same moment and
segment. Neither model includes residual swing: a strand leans with the present acceleration of its
ends, and swings after one stop from rest.
"""

import math
from typing import Final

import numpy as np
import numpy.typing as npt

from swarm.certification.budget import DIRECTIONS, NEARLY_STRAIGHT, effective_gravity
from swarm.geometry.catenary import solve_catenaries

Floats = npt.NDArray[np.float64]

_FRACTIONS: Final = np.linspace(0.0, 1.0, 33)
"""Points of a strand whose movement is compared: 10 cm apart on a strand of 3 m."""


def largest_swings(
    positions: Floats, acceleration: Floats, lengths: Floats, braking: float
) -> Floats:
    """Return the largest movement (m,) of each of m strands, metres.

    ``positions`` and ``acceleration`` (m + 1, 3) are of the grip points, m and m/s²; ``lengths``
    (m,) of the strands; ``braking`` in m/s² is the braking reserve of all vehicles.
    """
    start, end = positions[:-1], positions[1:]
    drawn = np.maximum(lengths, np.linalg.norm(end - start, axis=1) / NEARLY_STRAIGHT)

    def movement(by: Floats) -> Floats:
        leaning = solve_catenaries(start, end, drawn, down=effective_gravity(by)).points(_FRACTIONS)
        farthest: Floats = np.linalg.norm(leaning - still, axis=-1).max(axis=-1)
        return farthest

    still = solve_catenaries(start, end, drawn).points(_FRACTIONS)
    sway = movement(0.5 * (acceleration[:-1] + acceleration[1:]))
    headings = 2.0 * math.pi * np.arange(DIRECTIONS) / DIRECTIONS
    level = braking * np.stack([np.cos(headings), np.sin(headings), 0.0 * headings], axis=1)
    stop: Floats = np.max([movement(np.tile(by, (len(lengths), 1))) for by in level], axis=0)
    return sway + stop
