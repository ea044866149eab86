"""The connection to one ArduPilot process: its JSON interface on a UDP socket of loopback."""

import socket

import numpy as np
from numpy.typing import NDArray

from sitl.firmware import ardupilot_json
from sitl.physics.rigid import MOTORS

Array = NDArray[np.float64]

_IDLE, _SPAN = 1000.0, 1000.0
"""Pulse width without thrust, and from there to full thrust, microseconds."""
_CLOSED, _OPEN = 1700, 1300
"""Pulse widths of the gripper's output above which it closes, and below which it opens."""
_GRIPPER = 8
"""Index of the gripper's output: SERVO9."""
_LARGEST = 256


class ArduPilotPort:
    """One autopilot's connection and its latest outputs; a `sitl.firmware.exchange.Port`."""

    def __init__(self, row: int, port: int, scale: tuple[float, float]) -> None:
        """Bind the UDP ``port`` of loopback; raises `OSError` if it is taken.

        ``scale``: as of `ardupilot_json.answer`.
        """
        self.row, self._scale = row, scale
        self.fresh, self.silent, self.ended = False, True, False
        self.command = np.zeros(MOTORS)
        self._pulses: tuple[int, ...] = (0,) * 16
        self._peer: tuple[str, int] | None = None
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._socket.bind(("127.0.0.1", port))

    def fileno(self) -> int:
        """Return the descriptor to wait at."""
        return self._socket.fileno()

    def receive(self) -> None:
        """Take one packet of outputs."""
        try:
            data, self._peer = self._socket.recvfrom(_LARGEST)
        except (BlockingIOError, ConnectionError):
            return
        servos = ardupilot_json.parse(data)
        if servos is None:
            return
        self._pulses = servos.pulses
        self.fresh, self.silent = True, False
        self.command = (np.array(servos.pulses[:MOTORS]) - _IDLE) / _SPAN

    def answer(self, at: float, state: Array, measured: Array) -> None:
        """Answer the latest outputs with the vehicle's state at ``at``, seconds."""
        if self.fresh and self._peer is not None:
            packet = ardupilot_json.answer(at, state, measured, self._scale)
            self._socket.sendto(packet, self._peer)
            self.fresh = False

    def end(self) -> None:
        """Note that the process has ended: motors stop, and the gripper stays as it is."""
        self.ended = self.silent = True
        self.command = np.zeros(MOTORS)
        self._pulses = (0,) * 16

    def grip(self) -> bool | None:
        """Return whether the gripper's output closes it; None between closed and open."""
        pulse = self._pulses[_GRIPPER]
        if pulse > _CLOSED:
            return True
        return False if 0 < pulse < _OPEN else None

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()
