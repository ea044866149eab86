"""Frequent telemetry of the whole team in one table: positions, attitudes, packet counts.

Nine in ten packets of a flight are of this kind. A compiled loop reads them for all vehicles at
once. :mod:`swarm.mavlink.message_handlers` does the same for single messages, and for all others.
"""

import math
from typing import Protocol

import numpy as np
import numpy.typing as npt

from swarm.jit import allocates, compiled, inner
from swarm.signatures import Bytes3, Floats2, Ints1, Ints2, Shorts2

Floats = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]
Bits = npt.NDArray[np.uint8]
Vector = tuple[float, float, float]

RECEIVED_AT, POSITION_AT, POSITION, VELOCITY, ATTITUDE = 0, 1, 2, 5, 8
BOOT_TIME, PACKETS, LOST_PACKETS, COMPONENT = 11, 12, 13, 14
MODE_AT, BATTERY, POSITION_HEALTHY, FIX_TYPE, HEIGHT_DIFFERENCE = 15, 16, 17, 18, 19
VERTICAL_ACCURACY, GRIPPED, ARMED = 20, 21, 22
WIDTH = 23
"""Columns: times, position and velocity in NED, attitude, boot time in ms, counts, component; then
what changes rarely, but is observed at every tick."""

REBOOT_STEP = 2000.0
"""Milliseconds by which the boot time must go back to count as a reboot."""
_LOCAL_POSITION_NED, _ATTITUDE = 32, 30
_COMPARED = (24, 33)
"""GPS_RAW_INT and GLOBAL_POSITION_INT are compared with the position that was sent before them."""
_MAGIC, _HEADER, _MIN_PACKET, _PAYLOAD = 0xFD, 10, 12, 28
_OVERTAKEN = 128
"""A sequence number that is farther ahead than this belongs to a packet that was overtaken."""


TableArrays = tuple[Floats2, Shorts2, Bytes3]
"""The arrays of a :class:`TelemetryTable`, for compiled functions."""


class TelemetryTable:
    """Frequent telemetry of n vehicles: ``values`` (n, WIDTH), and the packets that are missing.

    ``sequences`` (n, 256) are the latest sequence numbers of each component, -1 before the first.
    ``missing`` (n, 256, 32) has one bit for each sequence number that has not arrived.
    """

    def __init__(self, vehicles: int) -> None:
        self.values = np.full((vehicles, WIDTH), np.nan)
        self.values[:, RECEIVED_AT] = self.values[:, POSITION_AT] = -math.inf
        self.values[:, BOOT_TIME], self.values[:, COMPONENT] = -1.0, 1.0
        self.values[:, PACKETS] = self.values[:, LOST_PACKETS] = 0.0
        self.values[:, MODE_AT], self.values[:, FIX_TYPE] = -math.inf, -1.0
        self.values[:, POSITION_HEALTHY] = 1.0
        self.values[:, GRIPPED] = self.values[:, ARMED] = 0.0
        self.sequences = np.full((vehicles, 256), -1, np.int16)
        self.missing = np.zeros((vehicles, 256, 32), np.uint8)

    @property
    def arrays(self) -> TableArrays:
        """Values, sequence numbers and missing packets."""
        return self.values, self.sequences, self.missing

    def copy_row(self, row: int) -> "TelemetryTable":
        """Return a table with a copy of one vehicle's row."""
        single = TelemetryTable(0)
        single.values = self.values[row : row + 1].copy()
        single.sequences = self.sequences[row : row + 1].copy()
        single.missing = self.missing[row : row + 1].copy()
        return single


class _HasRow(Protocol):
    telemetry: TelemetryTable
    row: int


class FloatField:
    """An attribute that is one number of a row."""

    def __init__(self, column: int) -> None:
        self._column = column

    def __get__(self, vehicle: _HasRow, owner: type) -> float:
        return float(vehicle.telemetry.values[vehicle.row, self._column])

    def __set__(self, vehicle: _HasRow, value: float) -> None:
        vehicle.telemetry.values[vehicle.row, self._column] = value


class IntegerField(FloatField):
    """An attribute that is one whole number of a row."""

    def __get__(self, vehicle: _HasRow, owner: type) -> int:
        return int(super().__get__(vehicle, owner))


class FlagField(FloatField):
    """An attribute that is true or false in a row."""

    def __get__(self, vehicle: _HasRow, owner: type) -> bool:
        return bool(super().__get__(vehicle, owner))


class VectorField:
    """An attribute that is three neighbouring numbers of a row."""

    def __init__(self, first: int) -> None:
        self._columns = slice(first, first + 3)

    def __get__(self, vehicle: _HasRow, owner: type) -> Vector:
        first, second, third = vehicle.telemetry.values[vehicle.row, self._columns].tolist()
        return first, second, third

    def __set__(self, vehicle: _HasRow, value: Vector) -> None:
        vehicle.telemetry.values[vehicle.row, self._columns] = value


@compiled
def count_packet(table: TableArrays, k: int, component: int, sequence: int, now: float) -> None:
    """Count a packet of vehicle ``k``, and the packets before it that have not arrived.

    A packet that arrives late is not lost. Only packets of the autopilot's component set
    RECEIVED_AT: a camera on board does not show that the autopilot is alive.
    """
    values, sequences, missing = table
    if component == values[k, COMPONENT]:
        values[k, RECEIVED_AT] = now
    values[k, PACKETS] += 1.0
    last, missed = int(sequences[k, component]), missing[k, component]
    gap = (sequence - last) & 0xFF if last >= 0 else 1
    bit = 1 << (sequence & 7)
    if 0 < gap < _OVERTAKEN:
        sequences[k, component] = sequence
        missed[sequence >> 3] &= 0xFF ^ bit
        values[k, LOST_PACKETS] += gap - 1
        for back in range(1, gap):
            before = (sequence - back) & 0xFF
            missed[before >> 3] |= 1 << (before & 7)
    elif missed[sequence >> 3] & bit:
        missed[sequence >> 3] &= 0xFF ^ bit
        values[k, LOST_PACKETS] -= 1.0


@compiled
@allocates
def read_datagrams(
    data: bytes, origins: Ints2, extras: Ints1, now: float, table: TableArrays, rows: Ints2
) -> int:
    """Read datagrams into the table; return the number of packets that are left for the handlers.

    ``data`` are m datagrams, one after the other. ``origins`` (m, 3) are their lengths, the rows of
    the vehicles that sent them, and their system ids. ``extras`` are CRC_EXTRA by message number,
    negative if there is no such message. Every packet that is not read here is described, in its
    order, in a row of ``rows`` (k, 5), which must have a row for every possible packet: datagram,
    message number, component, start and end of the payload. These packets have been counted.
    If ``data`` holds anything but whole unsigned MAVLink 2 packets of known messages from their
    vehicles, nothing is read and the result is negative.
    """
    values = table[0]
    in_order = np.zeros(len(values), np.bool_)
    start = 0
    for m in range(len(origins)):
        end = start + origins[m, 0]
        valid, compared = _validate(data, start, end, origins[m, 2], extras)
        if not valid:
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
            count_packet(table, k, int(data[at + 6]), int(data[at + 4]), now)
            tabular = number == _ATTITUDE or (number == _LOCAL_POSITION_NED and not in_order[k])
            if not tabular or not _read_packet(data, at, close, single, now, values[k]):
                in_order[k] |= number == _LOCAL_POSITION_NED
                rows[used, 0], rows[used, 1], rows[used, 2] = m, number, data[at + 6]
                rows[used, 3], rows[used, 4] = at + _HEADER, close
                used += 1
            at = close + 2
    return used


def packet_rows(data: bytes) -> Indices:
    """Return an uninitialized array with a row for every packet that the data can hold."""
    return np.empty((len(data) // _MIN_PACKET + 1, 5), np.int64)


@inner
def _validate(data: bytes, start: int, end: int, system: int, extras: Indices) -> tuple[bool, bool]:
    """Return whether a datagram holds only valid unsigned packets of a vehicle, and whether it
    holds a packet that is compared with positions."""
    compared = False
    while start < end:
        close = start + _HEADER + int(data[start + 1]) if start + _MIN_PACKET <= end else end
        if close + 2 > end:
            return False, False
        number = data[start + 7] | data[start + 8] << 8 | data[start + 9] << 16
        plain = data[start] == _MAGIC and not data[start + 2] and data[start + 5] == system
        if not plain or number >= len(extras) or extras[number] < 0:
            return False, False
        checksum = 0xFFFF
        for k in range(start + 1, close):
            checksum = crc_accumulate(checksum, data[k])
        if crc_accumulate(checksum, extras[number]) != data[close] | data[close + 1] << 8:
            return False, False
        compared = compared or number in _COMPARED
        start = close + 2
    return True, compared


@inner
@allocates
def _read_packet(
    data: bytes, at: int, close: int, single: npt.NDArray[np.float32], now: float, row: Floats
) -> bool:
    """Read a position or an attitude into a vehicle's row; False if it shows a reboot, which is an
    event."""
    raw = single.view(np.uint8)
    for k in range(_PAYLOAD):
        raw[k] = data[at + _HEADER + k] if at + _HEADER + k < close else 0
    if data[at + 7] == _ATTITUDE:
        for k in range(3):
            row[ATTITUDE + k] = single[1 + k]
        return True
    boot = 0.0
    for k in range(4):
        boot += float(raw[k]) * 256.0**k
    if boot < row[BOOT_TIME] - REBOOT_STEP:
        return False
    row[BOOT_TIME], row[POSITION_AT] = boot, now
    for k in range(6):
        row[POSITION + k] = single[1 + k]
    return True


@inner
def crc_accumulate(checksum: int, byte: int) -> int:
    """Return the X25 checksum with one more byte."""
    change = (byte ^ checksum) & 0xFF
    change = (change ^ change << 4) & 0xFF
    return checksum >> 8 ^ change << 8 ^ change << 3 ^ change >> 4
