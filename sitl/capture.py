"""Motion capture of an emulated laboratory: the vehicles' true poses, late and noisy, by UDP.

One JSON datagram for each frame, every step of the world: ``{"time": seconds, "bodies": {"1": [x,
y, z, qw, qx, qy, qz]}}``: system ids; world ENU, body FLU.
"""

import json
import socket
from collections import deque

import numpy as np

from sitl.emulator import Emulator


class MotionCapture:
    """Frames of a world, late and noisy as it says; `send` is called after each of its steps."""

    def __init__(self, emulator: Emulator, target: tuple[str, int]) -> None:
        self._emulator, self._target = emulator, target
        self._delay, self._noise = emulator.world.capture.delay, emulator.world.capture.noise
        self._rng = np.random.default_rng([emulator.world.seed, len(emulator.vehicles)])
        self._waiting: deque[tuple[float, bytes]] = deque()
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)

    def send(self) -> None:
        """Capture a frame, and send those that are due."""
        now = self._emulator.time
        self._waiting.append((now + self._delay, self.frame()))
        while self._waiting and self._waiting[0][0] <= now + 1e-9:
            _, data = self._waiting.popleft()
            try:
                self._socket.sendto(data, self._target)
            except (BlockingIOError, ConnectionError):
                continue

    def frame(self) -> bytes:
        """Return the present frame."""
        b, outside = self._emulator.bodies, self._emulator.outside
        position = b.position + self._noise * self._rng.standard_normal((b.count, 3))
        attitude = np.zeros((b.count, 4))
        attitude[:, 0], attitude[:, 3] = np.cos(0.5 * b.yaw), np.sin(0.5 * b.yaw)
        if outside is not None:
            attitude[outside.rows] = outside.state[:, 6:10]
        rows = np.hstack([position, attitude]).round(6).tolist()
        ids = (str(vehicle.system) for vehicle in self._emulator.vehicles)
        frame = {"time": self._emulator.time, "bodies": dict(zip(ids, rows, strict=True))}
        return json.dumps(frame).encode("ascii")

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()
