"""What both models of the cable share: its samples, and the grips (arc length, holder) along it."""

from abc import ABC, abstractmethod
from typing import NamedTuple

import numpy as np

from sitl.physics.dynamics import Array
from sitl.world import CableSpec

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


class Cable(ABC):
    """Grips, breaks and samples of a cable: what both models of it share.

    ``grips`` are (arc length, holder) in order, ``shape`` (m, 3) the samples at ``arc`` (m,),
    ``breaks`` arc lengths. The polyline of the initial shape is ``initial`` (k, 3) at ``along``.
    """

    shape: Array

    def __init__(self, spec: CableSpec, floor: float) -> None:
        self.spec = spec
        self.floor = floor
        self.initial = np.array(spec.points, dtype=float)
        steps = np.linalg.norm(np.diff(self.initial, axis=0), axis=1)
        self.along = np.concatenate([[0.0], np.cumsum(steps)])
        self.length = float(self.along[-1])
        self.arc = np.linspace(0.0, self.length, max(2, int(np.ceil(self.length / SPACING)) + 1))
        self.grips: list[Grip] = []
        self.breaks: list[float] = []

    @abstractmethod
    def _rebuild(self) -> None:
        """Follow a grip, a release or a break."""

    def grab(self, vehicle: int, grip_point: Array) -> float | None:
        """Close a gripper; return the arc length that it holds, None if no cable is in reach."""
        arc = self._caught(grip_point)
        if arc is not None:
            self.attach(vehicle, arc, grip_point)
        return arc

    def attach(self, vehicle: int, arc: float, grip_point: Array | None = None) -> None:
        """Attach the cable to a holder at an arc length.

        With inertia, it is then drawn to the ``grip_point`` (3,) from where it lies; None: it is
        there already.
        """
        del grip_point
        self.grips = sorted([*self.grips, (arc, vehicle)])
        self._rebuild()

    def release(self, vehicle: int) -> bool:
        """Detach the cable from a holder; return whether it was attached. Free cable falls."""
        others = [grip for grip in self.grips if grip[1] != vehicle]
        if len(others) == len(self.grips):
            return False
        self.grips = others
        self._rebuild()
        return True

    def slide(self, vehicle: int, distance: float) -> None:
        """Move a grip along the cable by ``distance`` metres.

        It stays SPACING from its neighbours, from breaks and from the cable's ends.
        """
        grips = self.grips
        at = [holder for _, holder in grips].index(vehicle)
        arc, marks = grips[at][0], [0.0, *self.breaks, self.length]
        bounds = [*marks, *(other for other, _ in grips)]
        low = max((b + SPACING for b in bounds if b < arc), default=min(marks))
        high = min((b - SPACING for b in bounds if b > arc), default=max(marks))
        moved = min(max(arc + distance, min(low, arc)), max(high, arc))
        self.grips = [*grips[:at], (moved, vehicle), *grips[at + 1 :]]
        self._rebuild()

    def nearest_free(self, arc: float) -> float:
        """Return the sample nearest to an arc length that is at least SPACING from all grips."""
        held = np.array([grip for grip, _ in self.grips])
        free = np.abs(self.arc[:, None] - held[None, :]) >= SPACING - 1e-9
        open_to = self.arc[free.all(axis=1)]
        return float(open_to[np.argmin(np.abs(open_to - arc))])

    def position_at(self, arc: float) -> Array:
        """Return the position (3,) of the cable at an arc length."""
        return np.array([np.interp(arc, self.arc, self.shape[:, i]) for i in range(3)])

    def _caught(self, point: Array) -> float | None:
        """Return the arc length at which a gripper at ``point`` (3,) catches the cable, or None.

        Cable beside another grip is not caught.
        """
        samples, shape = self.arc, self.shape
        gaps = np.linalg.norm(shape - point, axis=1)
        taken = [arc for arc, _ in self.grips]
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
