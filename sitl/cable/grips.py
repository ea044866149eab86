"""Grips on a cable: (arc length, holder) in order along it."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sitl.physics.dynamics import Bodies

Array = NDArray[np.float64]
Grip = tuple[float, int]

REACH = 0.15
"""Distance in metres within which a gripper catches the cable."""
SPACING = 0.1
"""Distance in metres of samples along the cable, and the smallest one of two grips."""


class FreeMotion(NamedTuple):
    """Motion of n holders without the cable: ``acceleration`` (n, 3), m/s², ENU.

    ``mobility`` (n,) is the inverse of their masses, 0 for those that no cable moves.
    """

    acceleration: Array
    mobility: Array


def holders(bodies: Bodies, anchors: Sequence[Array]) -> tuple[Array, Array]:
    """Return positions and velocities (n, 3) of all holders of cable: vehicles, then anchors.

    An anchor (3,) holds the cable at a point that does not move.
    """
    grips = bodies.grip_points()
    if not anchors:
        return grips, bodies.velocity
    pinned = np.array(anchors)
    return np.vstack([grips, pinned]), np.vstack([bodies.velocity, np.zeros_like(pinned)])


def free_motion(bodies: Bodies, anchors: int) -> FreeMotion:
    """Return the motion of all holders without cable; anchors resist it by friction alone."""
    free = FreeMotion(*bodies.free_motion())
    if not anchors:
        return free
    return FreeMotion(
        np.vstack([free.acceleration, np.zeros((anchors, 3))]),
        np.append(free.mobility, np.zeros(anchors)),
    )


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


def caught(grips: Sequence[Grip], samples: Array, shape: Array, point: Array) -> float | None:
    """Return the arc length at which a gripper at ``point`` (3,) catches the cable, None if none.

    ``shape`` (m, 3) are the positions of ``samples`` (m,). Cable beside another grip is not caught.
    """
    gaps = np.linalg.norm(shape - point, axis=1)
    taken = [arc for arc, _ in grips]
    for arc in taken:
        gaps[np.abs(samples - arc) < 0.5 * SPACING] = np.inf
    nearest = int(np.argmin(gaps))
    if gaps[nearest] > REACH + SPACING:
        return None
    best, best_arc = np.inf, 0.0
    for first in (nearest - 1, nearest):
        if 0 <= first < len(samples) - 1:
            start, end = shape[first], shape[first + 1]
            step = end - start
            share = float(np.dot(point - start, step) / max(np.dot(step, step), 1e-12))
            share = min(1.0, max(0.0, share))
            gap = float(np.linalg.norm(start + share * step - point))
            if gap < best:
                best = gap
                best_arc = float(samples[first] + share * (samples[first + 1] - samples[first]))
    if best > REACH or any(abs(best_arc - arc) < 1e-3 for arc in taken):
        return None
    return best_arc
