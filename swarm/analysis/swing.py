"""How far the budget's models of sway and of a stop let strands move, in whatever direction.

The budget takes of this what lies along the line between two strands, at its tightest moments. A
rope is compared with all of it, at the same moment and segment. Both models know no swing that is
left over from before: a strand leans with the acceleration that its ends have now, and swings after
one stop from rest.
"""

import math
from typing import Final

import numpy as np
import numpy.typing as npt

from swarm.certification.budget import DIRECTIONS, felt
from swarm.geometry.catenary import hang

Floats = npt.NDArray[np.float64]

_TAUT: Final = 0.9995
_FRACTIONS: Final = np.linspace(0.0, 1.0, 33)


def swings(places: Floats, acceleration: Floats, lengths: Floats, braking: float) -> Floats:
    """Return by how much each of m strands may move at the most, metres (m,).

    ``places`` and ``acceleration`` (m + 1, 3) are of the grip points, m and m/s²; ``lengths`` (m,)
    of the strands; ``braking`` in m/s² is the reserve with which everybody may stop.
    """
    start, end = places[:-1], places[1:]
    reach = np.maximum(lengths, np.linalg.norm(end - start, axis=1) / _TAUT)

    def moved(by: Floats) -> Floats:
        leaning = hang(start, end, reach, down=felt(by)).points(_FRACTIONS)
        farthest: Floats = np.linalg.norm(leaning - still, axis=-1).max(axis=-1)
        return farthest

    still = hang(start, end, reach).points(_FRACTIONS)
    sway = moved(0.5 * (acceleration[:-1] + acceleration[1:]))
    headings = 2.0 * math.pi * np.arange(DIRECTIONS) / DIRECTIONS
    level = braking * np.stack([np.cos(headings), np.sin(headings), 0.0 * headings], axis=1)
    stop: Floats = np.max([moved(np.tile(by, (len(lengths), 1))) for by in level], axis=0)
    return sway + stop
