"""Collisions of vehicles with each other, and of rotors with the cable."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from sitl.physics.dynamics import Bodies
from sitl.physics.motion import POSITION
from swarm.jit import allocates, compiled
from swarm.signatures import Bools1, Floats1, Floats2, Floats3

_HEIGHT = 0.25
"""Height difference in metres below which two vehicles can touch."""
_DISC = 0.06
"""Half the height of a rotor disc, metres."""
_BREAKING_SPEED = 1.0
_REPEAT_TIME = 1.0
"""Seconds without contact after which the same pair counts again."""


class Contacts:
    """Detects contacts at 10 Hz and records them; hard ones stop the motors."""

    def __init__(self, bodies: Bodies) -> None:
        self.bodies = bodies
        self.contacts: list[dict[str, Any]] = []
        self.strikes: list[dict[str, Any]] = []
        self._reach = (bodies.radius[:, None] + bodies.radius[None, :]) ** 2
        self._last: dict[tuple[str, int, int], float] = {}

    def detect(self, now: float, ids: list[int], cable: NDArray[np.float64] | None) -> None:
        """Record the contacts at ``now``; ``ids`` are system ids, ``cable`` (m, 3) its samples."""
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
            if not (flying[i] or flying[j]) or not self._is_new(now, "vehicles", i, j):
                continue
            speed = float(np.linalg.norm(b.velocity[i] - b.velocity[j]))
            self.contacts.append(
                {"time": now, "kind": "vehicles", "vehicles": [ids[i], ids[j]], "speed": speed}
            )
            if speed > _BREAKING_SPEED:
                b.health[[i, j]] = 0.0
                b.crashed[[i, j]] = True
                b.refresh()
            middle = 0.5 * (b.velocity[i] + b.velocity[j])
            b.velocity[i] = middle
            b.velocity[j] = middle

    def _cable(self, now: float, ids: list[int], cable: NDArray[np.float64]) -> None:
        """Record strikes: a rotor disc is flat, at the centre; cable samples are 0.1 m apart."""
        b = self.bodies
        spinning = b.armed & (b.lift_time > 0)
        if not spinning.any():
            return
        first = _touched(cable, b.state, b.radius, spinning)
        for i in np.flatnonzero(first >= 0).tolist():
            if self._is_new(now, "strike", i, i):
                self.strikes.append(
                    {"time": now, "vehicle": ids[i], "place": cable[first[i]].tolist()}
                )

    def _is_new(self, now: float, kind: str, i: int, j: int) -> bool:
        before = self._last.get((kind, i, j), -np.inf)
        self._last[(kind, i, j)] = now
        return now - before > _REPEAT_TIME


@compiled
@allocates
def _touched(
    cable: Floats2, state: Floats3, radius: Floats1,
    spinning: Bools1,
) -> NDArray[np.int64]:  # fmt: skip
    """Return the first cable sample (m, 3) in each spinning rotor disc (n,), -1 without one."""
    first = np.full(len(state), -1)
    for i in range(len(state)):
        if not spinning[i]:
            continue
        east, north, up = state[i, 0, POSITION], state[i, 1, POSITION], state[i, 2, POSITION]
        for m in range(len(cable)):
            if abs(cable[m, 2] - up) < _DISC:
                across = (cable[m, 0] - east) ** 2 + (cable[m, 1] - north) ** 2
                if across < radius[i] ** 2:
                    first[i] = m
                    break
    return first
