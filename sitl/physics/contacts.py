"""Collisions of vehicles with each other, and of rotors with the cable."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from sitl.physics.dynamics import Bodies
from sitl.physics.motion import POSITION
from swarm.jit import compiled

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
        first = _touched(cable, b.now, b.radius, spinning)
        for i in np.flatnonzero(first >= 0).tolist():
            if self._new(now, "strike", i, i):
                self.strikes.append(
                    {"time": now, "vehicle": ids[i], "place": cable[first[i]].tolist()}
                )

    def _new(self, now: float, kind: str, i: int, j: int) -> bool:
        before = self._last.get((kind, i, j), -np.inf)
        self._last[(kind, i, j)] = now
        return now - before > _AGAIN


@compiled
def _touched(
    cable: NDArray[np.float64], now: NDArray[np.float64], radius: NDArray[np.float64],
    spinning: NDArray[np.bool_],
) -> NDArray[np.int64]:  # fmt: skip
    """The first of the cable's samples (m, 3) in each spinning rotor's disc (n,); -1: none is."""
    first = np.full(len(now), -1)
    for i in range(len(now)):
        if not spinning[i]:
            continue
        east, north, up = now[i, 0, POSITION], now[i, 1, POSITION], now[i, 2, POSITION]
        for m in range(len(cable)):
            if abs(cable[m, 2] - up) < _DISC:
                across = (cable[m, 0] - east) ** 2 + (cable[m, 1] - north) ** 2
                if across < radius[i] ** 2:
                    first[i] = m
                    break
    return first
