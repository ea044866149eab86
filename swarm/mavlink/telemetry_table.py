"""What vehicles say most often, in columns: positions, attitudes, and that they are heard at all.

Nine in ten packets of a flight are such. A compiled loop reads them for the whole team at once;
:mod:`swarm.mavlink.message_handlers` has the same for those that come singly, and all others.
"""

import math
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from swarm.jit import compiled

if TYPE_CHECKING:
    from swarm.mavlink.vehicle import Vehicle

Floats = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]
Sequences = npt.NDArray[np.int16]
Bits = npt.NDArray[np.uint8]
Triple = tuple[float, float, float]

HEARD_AT, POSITION_AT, PLACE, SPEED, ANGLES = 0, 1, 2, 5, 8
BOOT, PACKETS, LOST, COMPONENT = 11, 12, 13, 14
WIDTH = 15
"""Columns: times, position and velocity in NED, attitude, boot time in ms, counts, component."""

REBOOTED = 2000.0
"""Milliseconds by which a vehicle's clock must go back to be one that began anew."""
LOCAL_POSITION, ATTITUDE = 32, 30
_COMPARED = (24, 33)
"""GPS_RAW_INT and GLOBAL_POSITION_INT are compared with the position as it was said before them."""
_MAGIC, _HEADER, _SHORTEST, _SAID = 0xFD, 10, 12, 28
_OVERTAKEN = 128
"""A sequence number that is farther ahead than this is a packet that was overtaken."""


class Columns:
    """What is known of n vehicles: ``table`` (n, WIDTH), and whose packets are missing.

    ``sequences`` (n, 256) are the last sequence numbers of each of their components, -1 before the
    first; ``missing`` (n, 256, 32) has a bit for each number that has not come.
    """

    def __init__(self, vehicles: int) -> None:
        self.table = np.full((vehicles, WIDTH), np.nan)
        self.table[:, HEARD_AT] = self.table[:, POSITION_AT] = -math.inf
        self.table[:, BOOT], self.table[:, COMPONENT] = -1.0, 1.0
        self.table[:, PACKETS] = self.table[:, LOST] = 0.0
        self.sequences = np.full((vehicles, 256), -1, np.int16)
        self.missing = np.zeros((vehicles, 256, 32), np.uint8)

    def copied(self, row: int) -> "Columns":
        """Return a copy of what is known of one vehicle alone."""
        alone = Columns(0)
        alone.table = self.table[row : row + 1].copy()
        alone.sequences = self.sequences[row : row + 1].copy()
        alone.missing = self.missing[row : row + 1].copy()
        return alone


class Number:
    """A number of a vehicle's that is kept in a column."""

    def __init__(self, column: int) -> None:
        self._column = column

    def __get__(self, vehicle: "Vehicle", owner: type) -> float:
        return float(vehicle.columns.table[vehicle.row, self._column])

    def __set__(self, vehicle: "Vehicle", value: float) -> None:
        vehicle.columns.table[vehicle.row, self._column] = value


class Whole(Number):
    """A whole number of a vehicle's that is kept in a column."""

    def __get__(self, vehicle: "Vehicle", owner: type) -> int:
        return int(super().__get__(vehicle, owner))


class Three:
    """Three numbers of a vehicle's that are kept in columns."""

    def __init__(self, first: int) -> None:
        self._columns = slice(first, first + 3)

    def __get__(self, vehicle: "Vehicle", owner: type) -> Triple:
        first, second, third = vehicle.columns.table[vehicle.row, self._columns].tolist()
        return first, second, third

    def __set__(self, vehicle: "Vehicle", value: Triple) -> None:
        vehicle.columns.table[vehicle.row, self._columns] = value


@compiled
def count(
    table: Floats, sequences: Sequences, missing: Bits, k: int, component: int, sequence: int,
    now: float,
) -> None:  # fmt: skip
    """Count a packet of vehicle ``k``, and those before it that have not come.

    One that comes late is not lost. A camera aboard is not heard for the autopilot.
    """
    if component == table[k, COMPONENT]:
        table[k, HEARD_AT] = now
    table[k, PACKETS] += 1.0
    last, missed = int(sequences[k, component]), missing[k, component]
    gap = (sequence - last) & 0xFF if last >= 0 else 1
    bit = 1 << (sequence & 7)
    if 0 < gap < _OVERTAKEN:
        sequences[k, component] = sequence
        missed[sequence >> 3] &= 0xFF ^ bit
        table[k, LOST] += gap - 1
        for back in range(1, gap):
            before = (sequence - back) & 0xFF
            missed[before >> 3] |= 1 << (before & 7)
    elif missed[sequence >> 3] & bit:
        missed[sequence >> 3] &= 0xFF ^ bit
        table[k, LOST] -= 1.0


@compiled
def take(
    data: bytes, origins: Indices, extras: Indices, now: float, table: Floats,
    sequences: Sequences, missing: Bits, rows: Indices,
) -> int:  # fmt: skip
    """Take what datagrams say into the columns; tell how much else is in them.

    ``data`` are m datagrams one after the other; ``origins`` (m, 3) are their lengths, the rows of
    the vehicles that speak in them, and their systems. ``extras`` are the extra bytes of the
    checksums by message number, negative where there is no such message. All packets that are not
    read here, in their order, go to as many of ``rows`` (as many as there may be packets, 5):
    datagram, message number, component, start and end of the payload. They have been counted.
    Where there is anything but whole MAVLink 2 packets of known messages of their vehicles, without
    signatures, nothing is taken, and what is returned is negative.
    """
    in_order = np.zeros(len(table), np.bool_)
    start = 0
    for m in range(len(origins)):
        end = start + origins[m, 0]
        good, compared = _look(data, start, end, origins[m, 2], extras)
        if not good:
            return -1
        in_order[origins[m, 1]] |= compared
        start = end
    single = np.empty(7, np.float32)
    used = at = 0
    for m in range(len(origins)):
        end, k = at + origins[m, 0], origins[m, 1]
        while at < end:
            close = at + _HEADER + int(data[at + 1])
            number = data[at + 7] | data[at + 8] << 8
            count(table, sequences, missing, k, int(data[at + 6]), int(data[at + 4]), now)
            told = number == ATTITUDE or (number == LOCAL_POSITION and not in_order[k])
            if not told or not _take(data, at, close, single, now, table[k]):
                in_order[k] |= number == LOCAL_POSITION
                rows[used, 0], rows[used, 1], rows[used, 2] = m, number, data[at + 6]
                rows[used, 3], rows[used, 4] = at + _HEADER, close
                used += 1
            at = close + 2
    return used


def room_for(data: bytes) -> Indices:
    """Return rows for as many packets as data can hold."""
    return np.empty((len(data) // _SHORTEST + 1, 5), np.int64)


@compiled
def _look(data: bytes, start: int, end: int, system: int, extras: Indices) -> tuple[bool, bool]:
    """Whether a datagram holds good plain packets of a vehicle and nothing else; whether any of
    them is compared with positions."""
    compared = False
    while start < end:
        close = start + _HEADER + int(data[start + 1]) if start + _SHORTEST <= end else end
        if close + 2 > end:
            return False, False
        number = data[start + 7] | data[start + 8] << 8 | data[start + 9] << 16
        plain = data[start] == _MAGIC and not data[start + 2] and data[start + 5] == system
        if not plain or number >= len(extras) or extras[number] < 0:
            return False, False
        checksum = 0xFFFF
        for k in range(start + 1, close):
            checksum = more(checksum, data[k])
        if more(checksum, extras[number]) != data[close] | data[close + 1] << 8:
            return False, False
        compared = compared or number in _COMPARED
        start = close + 2
    return True, compared


@compiled
def _take(
    data: bytes, at: int, close: int, single: npt.NDArray[np.float32], now: float, row: Floats
) -> bool:
    """Take a position or an attitude into a vehicle's row; not one after which its clock began
    anew, which is an event."""
    raw = single.view(np.uint8)
    for k in range(_SAID):
        raw[k] = data[at + _HEADER + k] if at + _HEADER + k < close else 0
    if data[at + 7] == ATTITUDE:
        for k in range(3):
            row[ANGLES + k] = single[1 + k]
        return True
    boot = 0.0
    for k in range(4):
        boot += float(raw[k]) * 256.0**k
    if boot < row[BOOT] - REBOOTED:
        return False
    row[BOOT], row[POSITION_AT] = boot, now
    for k in range(6):
        row[PLACE + k] = single[1 + k]
    return True


@compiled
def more(checksum: int, byte: int) -> int:
    """The X25 checksum with one more byte."""
    change = (byte ^ checksum) & 0xFF
    change = (change ^ change << 4) & 0xFF
    return checksum >> 8 ^ change << 8 ^ change << 3 ^ change >> 4
