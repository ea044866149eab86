"""Messages of PX4's simulator link: sensor values in, motor outputs out. No sockets.

Source: PX4 user guide, "Simulation", and MAVLink's HIL messages. The simulator listens on TCP, PX4
connects; the time of each HIL_SENSOR is PX4's time from then on, and each HIL_ACTUATOR_CONTROLS
carries the time of the sensor values that it answers. Here NED and FRD; inside ENU and FLU.
"""

import math
import struct
from typing import NamedTuple

import numpy as np
from fastcrc import crc16
from numpy.typing import NDArray

from sitl.firmware.sensors import Fix
from sitl.protocol import wire

Array = NDArray[np.float64]

PORT = 4560
"""TCP port of instance 0's simulator; instance i connects to the i-th after it."""

_IMU, _SLOW = 0b111111, 0b1101111000000
"""Bits of HIL_SENSOR's updated fields: accelerometer and gyroscope; magnetometer and barometer."""
_SENSOR = wire.template(
    "HIL_SENSOR",
    "time_usec xacc yacc zacc xgyro ygyro zgyro xmag ymag zmag abs_pressure pressure_alt "
    "temperature fields_updated",
)
_GPS = wire.template(
    "HIL_GPS",
    "time_usec lat lon alt eph epv vel vn ve vd cog fix_type",
    satellites_visible=16,  # as an open sky gives
)
_CONTROLS = wire.LAYOUTS["HIL_ACTUATOR_CONTROLS"]
_HEAD, _CHECKSUM = 10, 2
_ARMED = 128


class Outputs(NamedTuple):
    """Outputs of the autopilot: microseconds of the sensor values they answer, and 16 values.

    Motors are between 0 and 1, other outputs between -1 and 1; all are 0 unless ``armed``.
    """

    time: int
    controls: tuple[float, ...]
    armed: bool


def sensor(
    sender: wire.Sender, microseconds: int, inertial: Array, slow: tuple[float, ...] | None
) -> bytes:
    """Return HIL_SENSOR.

    ``inertial`` (6,) are specific force (m/s²) and rates (rad/s) in FLU. ``slow`` is what has a
    new value less often: the magnetic field (gauss, FLU), pressure (hPa), the altitude (m) and the
    temperature (°C) that belong to it.
    """
    x, y, z, p, q, r = inertial.tolist()
    ahead, left, up, pressure, altitude, temperature = slow or (0.0,) * 6
    body = _SENSOR(
        microseconds, x, -y, -z, p, -q, -r, ahead, -left, -up, pressure, altitude, temperature,
        _IMU if slow is None else _IMU | _SLOW,
    )  # fmt: skip
    return sender.frame(wire.NUMBERS["HIL_SENSOR"], body, wire.LAYOUTS["HIL_SENSOR"].seed)


def receiver(sender: wire.Sender, microseconds: int, fix: Fix) -> bytes:
    """Return HIL_GPS: the fix of a satellite receiver."""
    east, north, up = fix.velocity
    level = math.hypot(east, north)
    course = math.degrees(math.atan2(east, north)) % 360.0
    body = _GPS(
        microseconds, round(fix.latitude * 1e7), round(fix.longitude * 1e7),
        round(fix.altitude * 1e3), round(100.0 * fix.level_error), round(100.0 * fix.height_error),
        round(100.0 * level), round(100.0 * north), round(100.0 * east), round(-100.0 * up),
        round(100.0 * course) % 36000, fix.kind,
    )  # fmt: skip
    return sender.frame(wire.NUMBERS["HIL_GPS"], body, wire.LAYOUTS["HIL_GPS"].seed)


class Stream:
    """The bytes of PX4's end of the link, which come in pieces of any size."""

    def __init__(self) -> None:
        self._buffer = b""

    def feed(self, data: bytes) -> Outputs | None:
        """Return the latest outputs that ``data`` completes; None without any."""
        buffer = self._buffer + data
        latest = None
        start = 0
        while True:
            start = buffer.find(wire.MAGIC, start)
            if start < 0:
                self._buffer = b""
                return latest
            if len(buffer) < start + _HEAD:
                break
            end = start + _HEAD + buffer[start + 1] + _CHECKSUM
            if len(buffer) < end:
                break
            if int.from_bytes(buffer[start + 7 : start + 10], "little") != _CONTROLS.number:
                start = end
                continue
            found = _outputs(buffer[start:end])
            latest = found or latest
            start = end if found else start + 1
        self._buffer = buffer[start:]
        return latest


def _outputs(frame: bytes) -> Outputs | None:
    """Return the outputs in a frame of HIL_ACTUATOR_CONTROLS; None if its checksum is wrong."""
    if crc16.mcrf4xx(frame[1:-2] + _CONTROLS.seed) != int.from_bytes(frame[-2:], "little"):
        return None
    layout: struct.Struct = _CONTROLS.struct
    time, _, *controls, mode = layout.unpack(
        frame[_HEAD:-2][: layout.size].ljust(layout.size, b"\0")
    )
    return Outputs(time, tuple(controls), bool(mode & _ARMED))
