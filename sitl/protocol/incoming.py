"""Delivery of received bytes to vehicles; setpoints of vehicles that already follow go in batches.

Nearly all received bytes are such setpoints. Other packets, and setpoints without all axes or in
another frame, go through `sitl.protocol.wire` and the autopilot.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sitl.physics import motion
from sitl.physics.dynamics import Bodies
from sitl.protocol import wire
from sitl.protocol.vehicle import Vehicle
from sitl.protocol.wire import Link
from swarm.jit import allocates, compiled, inner
from swarm.signatures import Floats1, Floats2, Floats3, Ints1

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

LENGTH = wire.SETPOINT_LENGTH
"""Bytes of a complete setpoint packet without signature."""

_VALUES, _MASK, _TARGET, _SUM = 14, 58, 60, 63
_HEAD = (0xFD, 53, 0)
_SEED = 143
_LOCAL_NED = 1
_INCOMPLETE = 0x1FF | 512
"""Mask bits of ignored axes, and of force."""
_NO_YAW = 1024


Received = tuple[Vehicle, Link, bytes]
"""Bytes for a vehicle on one of its links."""


class Incoming:
    """Delivers bytes to vehicles; ``handle`` takes each message that is not set in a batch."""

    def __init__(
        self,
        bodies: Bodies,
        systems: Sequence[int],
        handle: Callable[[Vehicle, Any, Link], None],
    ) -> None:
        self._bodies = bodies
        self._systems = np.array(systems)
        self._handle = handle

    def deliver(self, received: Iterable[Received], now: float) -> None:
        """Deliver bytes at emulated time ``now``, in the order of their arrival."""
        batch: list[Received] = []
        for packet in received:
            vehicle, link, data = packet
            vehicle.now = max(vehicle.now, now)
            if (
                len(data) == LENGTH
                and vehicle.autopilot.follows_setpoints
                and link.receiver.plain
                and not vehicle.frozen
            ):
                batch.append(packet)
            else:
                if batch:
                    self._set_goals(batch)
                    batch = []
                self._parse(packet)
        if batch:
            self._set_goals(batch)

    def _set_goals(self, batch: list[Received]) -> None:
        """Set the goals of a batch of setpoints; a packet that does not qualify is parsed."""
        b = self._bodies
        while batch:
            packets = b"".join([data for _, _, data in batch])
            indices = bytes([vehicle.index for vehicle, _, _ in batch])
            done = _set_goals(packets, indices, self._systems, b.state, b.frames, b.goal_yaw)
            for vehicle, _, data in batch if done == len(batch) else batch[:done]:
                vehicle.autopilot.note_setpoint(data, vehicle.now)
            if done == len(batch):
                return
            self._parse(batch[done])
            batch = batch[done + 1 :]

    def _parse(self, packet: Received) -> None:
        vehicle, link, data = packet
        for message in link.receiver.feed(data):
            self._handle(vehicle, message, link)


@compiled
@allocates
def _set_goals(
    packets: bytes, indices: bytes, systems: Ints1, now: Floats3, frames: Floats2, goal_yaw: Floats1
) -> int:
    """Write the goals of m setpoint packets into ``now``; return how many were written.

    Each packet has LENGTH bytes, ``indices`` are the vehicles of the packets; the first packet that
    does not qualify ends the loop. ``systems`` (n,) are system ids, ``frames`` (n, 5) origins and
    scales of local frames.
    """
    single = np.empty(10, np.float32)
    raw = single.view(np.uint8)
    for m in range(len(indices)):
        at, i = LENGTH * m, indices[m]
        if not (_is_setpoint(packets, at) and _addresses(packets, at, systems[i])):
            return m
        for k in range(40):
            raw[k] = packets[at + _VALUES + k]
        for k in range(9):
            if not math.isfinite(single[k]):
                return m
        for k in range(3):
            # NED to ENU: the second axis is east
            axis, sign = (1 - k, 1.0) if k < 2 else (2, -1.0)
            step = float(single[axis]) / frames[i, 3 + k] if k < 2 else float(single[axis])
            now[i, k, motion.GOAL_POSITION] = frames[i, k] + sign * step
            now[i, k, motion.GOAL_VELOCITY] = sign * single[3 + axis]
            now[i, k, motion.GOAL_ACCELERATION] = sign * single[6 + axis]
        mask = packets[at + _MASK] | packets[at + _MASK + 1] << 8
        if not mask & _NO_YAW and math.isfinite(single[9]):
            goal_yaw[i] = 0.5 * math.pi - single[9]
    return len(indices)


@inner
def _is_setpoint(data: bytes, at: int) -> bool:
    """Return whether the bytes are a SET_POSITION_TARGET_LOCAL_NED with a correct checksum."""
    number = data[at + 7] | data[at + 8] << 8 | data[at + 9] << 16
    if number != wire.SETPOINT_LOCAL:
        return False
    for k in range(3):
        if data[at + k] != _HEAD[k]:
            return False
    checksum = 0xFFFF
    for k in range(1, _SUM):
        checksum = _extended(checksum, data[at + k])
    checksum = _extended(checksum, _SEED)
    return bool(checksum == data[at + _SUM] | data[at + _SUM + 1] << 8)


@inner
def _addresses(data: bytes, at: int, system: int) -> bool:
    """Return whether the setpoint is for this autopilot, with all axes, in LOCAL_NED."""
    target, component = data[at + _TARGET], data[at + _TARGET + 1]
    mask = data[at + _MASK] | data[at + _MASK + 1] << 8
    addressed = (target in (0, system)) and component < 2
    return bool(addressed and data[at + _TARGET + 2] == _LOCAL_NED and not mask & _INCOMPLETE)


@inner
def _extended(checksum: int, byte: int) -> int:
    """Return the X25 checksum extended by one byte."""
    change = (byte ^ checksum) & 0xFF
    change = (change ^ change << 4) & 0xFF
    return checksum >> 8 ^ change << 8 ^ change << 3 ^ change >> 4
