"""The connection to one ArduPilot process: its JSON interface on a UDP socket of loopback.

Motor outputs come in, sensor values go out.

Source: ArduPilot, ``libraries/SITL/examples/JSON/readme.md``: the autopilot sends a binary packet
of servo outputs, and advances its time by that of the answer. Here NED and FRD; inside ENU and FLU.
"""

import math
import socket
import struct
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sitl.physics.rigid_bodies import MOTORS

Array = NDArray[np.float64]

PORT, PORT_STEP = 9002, 10
"""UDP port of the first instance's physics, and the distance to the next one's."""

_SIXTEEN, _THIRTY_TWO = struct.Struct("<HHI16H"), struct.Struct("<HHI32H")
_MAGIC = {18458: _SIXTEEN, 29569: _THIRTY_TWO}
_HALF = math.sqrt(0.5)
_FORMAT = (
    '\n{"timestamp":%.6f,"imu":{"gyro":[%.6g,%.6g,%.6g],"accel_body":[%.6g,%.6g,%.6g]},'
    '"position":[%.5f,%.5f,%.5f],"quaternion":[%.8f,%.8f,%.8f,%.8f],'
    '"velocity":[%.5f,%.5f,%.5f],"no_time_sync":1}\n'
)


class Servos(NamedTuple):
    """Servo outputs: frame number since boot, steps per second, pulse widths in microseconds."""

    frame: int
    rate: int
    pulses: tuple[int, ...]


def parse(data: bytes) -> Servos | None:
    """Return the servo outputs in a packet; None if it is not one."""
    if len(data) < _SIXTEEN.size:
        return None
    layout = _MAGIC.get(int.from_bytes(data[:2], "little"))
    if layout is None or len(data) != layout.size:
        return None
    _, rate, frame, *pulses = layout.unpack(data)
    return Servos(frame, rate, tuple(pulses))


def answer(time: float, state: Array, measured: Array, scale: tuple[float, float]) -> bytes:
    """Return the sensor values of one vehicle at ``time`` (seconds since the physics began).

    ``state`` is a row of `sitl.physics.rigid_bodies` (ENU, FLU), ``measured`` (3,) its specific
    force.
    ``scale`` are ArduPilot's metres per true metre, east and north (`Geodesy.scale`): it turns
    positions into degrees with its own metre (``SIM_Aircraft.cpp``), and a receiver measures true
    degrees. Velocities are true, as a receiver's.
    """
    s = state.tolist()
    ahead, left, up = measured.tolist()
    w, x, y, z = s[6:10]
    text = _FORMAT % (
        time, s[10], -s[11], -s[12], ahead, -left, -up,
        scale[1] * s[1], scale[0] * s[0], -s[2],
        _HALF * (w + z), _HALF * (x + y), _HALF * (x - y), _HALF * (w - z),
        s[4], s[3], -s[5],
    )  # fmt: skip
    return text.encode("ascii")


_IDLE, _SPAN = 1000.0, 1000.0
"""Pulse width without thrust, and from there to full thrust, microseconds."""
_CLOSED, _OPEN = 1700, 1300
"""Pulse widths of the gripper's output above which it closes, and below which it opens."""
_GRIPPER = 8
"""Index of the gripper's output: SERVO9."""
_LARGEST = 256


class ArduPilotPort:
    """One autopilot's connection and its latest outputs; a `sitl.firmware.team.Port`."""

    def __init__(self, row: int, port: int, scale: tuple[float, float]) -> None:
        """Bind the UDP ``port`` of loopback; raises `OSError` if it is taken.

        ``scale``: as of `answer`.
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
        servos = parse(data)
        if servos is None:
            return
        self._pulses = servos.pulses
        self.fresh, self.silent = True, False
        self.command = (np.array(servos.pulses[:MOTORS]) - _IDLE) / _SPAN

    def answer(self, at: float, state: Array, measured: Array) -> None:
        """Answer the latest outputs with the vehicle's state at ``at``, seconds."""
        if self.fresh and self._peer is not None:
            packet = answer(at, state, measured, self._scale)
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
