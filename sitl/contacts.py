"""Collisions of vehicles with each other, and of rotors with the cable."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from sitl.dynamics import Bodies

_HEIGHT = 0.25
_DISC = 0.06
_BREAKING_SPEED = 1.0
_AGAIN = 1.0


class Contacts:
    """Looks for contacts at 10 Hz and keeps a list of them; hard ones stop the motors."""

    def __init__(self, bodies: Bodies) -> None:
        self.bodies = bodies
        self.contacts: list[dict[str, Any]] = []
        self.strikes: list[dict[str, Any]] = []
        self._reach = (bodies.radius[:, None] + bodies.radius[None, :]) ** 2
        self._last: dict[tuple[str, int, int], float] = {}

    def look(self, now: float, ids: list[int], cable: NDArray[np.float64] | None) -> None:
        """Record what touches now; ``ids`` are the vehicles' numbers, ``cable`` its samples."""
        if len(ids) > 1:
            self._vehicles(now, ids)
        if cable is not None:
            self._cable(now, ids, cable)

    def _vehicles(self, now: float, ids: list[int]) -> None:
        b = self.bodies
        near = b.apart < self._reach
        if np.count_nonzero(near) <= len(ids):
            return
        height = b.position[:, 2]
        near &= np.abs(height[:, None] - height[None, :]) < _HEIGHT
        flying = ~b.landed
        for i, j in np.argwhere(np.triu(near, 1)).tolist():
            if not (flying[i] or flying[j]) or not self._new(now, "vehicles", i, j):
                continue
            speed = float(np.linalg.norm(b.velocity[i] - b.velocity[j]))
            self.contacts.append(
                {"time": now, "kind": "vehicles", "vehicles": [ids[i], ids[j]], "speed": speed}
            )
            if speed > _BREAKING_SPEED:
                b.health[[i, j]] = 0.0
                b.crashed[[i, j]] = True
                b.touch()
            middle = 0.5 * (b.velocity[i] + b.velocity[j])
            b.velocity[i] = middle
            b.velocity[j] = middle

    def _cable(self, now: float, ids: list[int], cable: NDArray[np.float64]) -> None:
        """A rotor disc is flat, at the vehicle's centre; samples of the cable are 0.1 m apart."""
        b = self.bodies
        spinning = b.armed & (b.lifting > 0)
        if not spinning.any():
            return
        up = np.abs(cable[:, None, 2] - b.position[:, 2]) < _DISC
        up &= spinning
        sample, vehicle = np.nonzero(up)
        if not len(sample):
            return
        across = cable[sample, :2] - b.position[vehicle, :2]
        inside = np.vecdot(across, across) < b.radius[vehicle] ** 2
        struck = vehicle[inside]
        for i in np.unique(struck).tolist():
            if self._new(now, "strike", i, i):
                where = cable[sample[inside][np.argmax(struck == i)]]
                self.strikes.append(
                    {"time": now, "vehicle": ids[i], "place": [float(x) for x in where]}
                )

    def _new(self, now: float, kind: str, i: int, j: int) -> bool:
        before = self._last.get((kind, i, j), -np.inf)
        self._last[(kind, i, j)] = now
        return now - before > _AGAIN
