"""What comes in for all vehicles; setpoints that are followed already are taken in one go.

They are nearly everything that arrives. What is not a whole, good setpoint of all axes in the
vehicle's own frame is left to `sitl.wire` and the vehicle's personality.
"""

import math
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from sitl import motion, wire
from sitl.dynamics import Bodies
from sitl.vehicle import Link, Vehicle
from swarm.jit import compiled

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

LENGTH = wire.SETPOINT_LENGTH
"""Bytes of a setpoint's packet without signature, nothing cut off."""

_PAYLOAD, _VALUES, _YAW, _MASK, _TARGET, _SUM = 10, 14, 50, 58, 60, 63
_HEAD = (0xFD, 53, 0)
_SEED = 143
_LOCAL_NED = 1
_NEITHER = 0x1FF | 512
"""Mask of axes that are left out, and of force."""
_NO_YAW = 1024


Heard = tuple[Vehicle, Link, bytes]
"""Bytes that have come for a vehicle on one of its links."""


class Incoming:
    """Hands bytes to vehicles; setpoints that are followed anyway all at once."""

    def __init__(self, bodies: Bodies, systems: Sequence[int]) -> None:
        self._bodies = bodies
        self._systems = np.array(systems)

    def hear(self, heard: Iterable[Heard], now: float) -> None:
        """Hand bytes to vehicles at emulated time ``now``, in the order in which they came."""
        waiting: list[Heard] = []
        for one in heard:
            vehicle, link, data = one
            vehicle.now = max(vehicle.now, now)
            if (
                len(data) == LENGTH
                and vehicle.personality.follows
                and link.receiver.plain
                and not vehicle.frozen
            ):
                waiting.append(one)
            else:
                if waiting:
                    self._take(waiting)
                    waiting = []
                _hand_over(one)
        if waiting:
            self._take(waiting)

    def _take(self, waiting: list[Heard]) -> None:
        """Take the setpoints that wait; what only looks like one as everything else."""
        b = self._bodies
        while waiting:
            packets = b"".join([data for _, _, data in waiting])
            who = bytes([vehicle.index for vehicle, _, _ in waiting])
            taken = _take(packets, who, self._systems, b.now, b.frames, b.goal_yaw)
            for vehicle, _, data in waiting if taken == len(waiting) else waiting[:taken]:
                vehicle.personality.followed(data, vehicle.now)
            if taken == len(waiting):
                return
            _hand_over(waiting[taken])
            waiting = waiting[taken + 1 :]


def _hand_over(one: Heard) -> None:
    vehicle, link, data = one
    for message in link.receiver.feed(data):
        vehicle.handle(message, link)


@compiled
def _take(
    packets: bytes, who: bytes, systems: Indices, now: Array, frames: Array, goal_yaw: Array
) -> int:
    """Take m setpoints, of LENGTH bytes each, for the vehicles ``who`` into ``now``; how many.

    The first one that is not taken ends it. ``systems`` (n,) are the vehicles' numbers, ``frames``
    (n, 5) origin and scale of their frames.
    """
    single = np.empty(10, np.float32)
    raw = single.view(np.uint8)
    for m in range(len(who)):
        at, i = LENGTH * m, who[m]
        if not (_is_setpoint(packets, at) and _is_meant_for(packets, at, systems[i])):
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
            now[i, k, motion.PLACE] = frames[i, k] + sign * step
            now[i, k, motion.SPEED] = sign * single[3 + axis]
            now[i, k, motion.ACCELERATION] = sign * single[6 + axis]
        mask = packets[at + _MASK] | packets[at + _MASK + 1] << 8
        if not mask & _NO_YAW and math.isfinite(single[9]):
            goal_yaw[i] = 0.5 * math.pi - single[9]
    return len(who)


@compiled
def _is_setpoint(data: bytes, at: int) -> bool:
    """Whether there is a SET_POSITION_TARGET_LOCAL_NED with a good checksum."""
    number = data[at + 7] | data[at + 8] << 8 | data[at + 9] << 16
    if number != wire.SETPOINT_LOCAL:
        return False
    for k in range(3):
        if data[at + k] != _HEAD[k]:
            return False
    checksum = 0xFFFF
    for k in range(1, _SUM):
        checksum = _more(checksum, data[at + k])
    checksum = _more(checksum, _SEED)
    return bool(checksum == data[at + _SUM] | data[at + _SUM + 1] << 8)


@compiled
def _is_meant_for(data: bytes, at: int, system: int) -> bool:
    """Whether it is for this vehicle's autopilot, with all axes, in its own frame."""
    target, component = data[at + _TARGET], data[at + _TARGET + 1]
    mask = data[at + _MASK] | data[at + _MASK + 1] << 8
    addressed = (target in (0, system)) and component < 2
    return bool(addressed and data[at + _TARGET + 2] == _LOCAL_NED and not mask & _NEITHER)


@compiled
def _more(checksum: int, byte: int) -> int:
    """The X25 checksum with one more byte."""
    change = (byte ^ checksum) & 0xFF
    change = (change ^ change << 4) & 0xFF
    return checksum >> 8 ^ change << 8 ^ change << 3 ^ change >> 4
