"""Grips on a cable: (arc length, holder) in order along it."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Grip = tuple[float, int]

REACH = 0.15
"""Distance in metres within which a gripper catches the cable."""
SPACING = 0.1
"""Distance in metres of samples along the cable, and the smallest one of two grips."""


def slid(grips: Sequence[Grip], holder: int, distance: float, marks: Sequence[float]) -> list[Grip]:
    """Return the grips after one has moved along the cable by ``distance`` metres.

    It stays SPACING from its neighbours and from ``marks``: the cable's ends and breaks.
    """
    at = [other for _, other in grips].index(holder)
    arc = grips[at][0]
    bounds = [*marks, *(other for other, _ in grips)]
    low = max((b + SPACING for b in bounds if b < arc), default=min(marks))
    high = min((b - SPACING for b in bounds if b > arc), default=max(marks))
    moved = list(grips)
    moved[at] = (min(max(arc + distance, min(low, arc)), max(high, arc)), holder)
    return moved


def nearest_free(grips: Sequence[Grip], samples: Array, arc: float) -> float:
    """Return the sample (m,) nearest to an arc length that is at least SPACING from all grips."""
    held = np.array([grip for grip, _ in grips])
    free = np.abs(samples[:, None] - held[None, :]) >= SPACING - 1e-9
    open_to = samples[free.all(axis=1)]
    return float(open_to[np.argmin(np.abs(open_to - arc))])
