"""ArduPilot's JSON simulator interface: motor outputs in, sensor values out. No sockets.

Source: ArduPilot, ``libraries/SITL/examples/JSON/readme.md``: the autopilot sends a binary packet
of servo outputs, and advances its time by that of the answer. Here NED and FRD; inside ENU and FLU.
"""

import math
import struct
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

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

    ``state`` is a row of `sitl.physics.rigid` (ENU, FLU), ``measured`` (3,) its specific force.
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
