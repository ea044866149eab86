"""Frequent telemetry of the whole team in one table: positions, attitudes, packet counts.

Nine in ten packets of a flight are of this kind. A compiled loop reads them for all vehicles at
once. :mod:`swarm.mavlink.vehicle` does the same for single messages, and for all others.
"""

import math
from collections.abc import Callable
from typing import Any, Final, Generic, Protocol, TypeVar, overload

import numpy as np
import numpy.typing as npt

from swarm.jit import allocates, compiled, inner
from swarm.signatures import Bytes3, Floats1, Floats2, Ints1, Ints2, Shorts2

Floats = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]
Bits = npt.NDArray[np.uint8]
Flags = npt.NDArray[np.bool_]
Vector = tuple[float, float, float]

_CLOCK_RANGE, _LONGEST_STEP = 2.0**32, 86.4e6
"""Milliseconds: a boot time begins again at zero after 49.7 days; a step of a day is no step of
one clock, between packets of a flight."""
_OUTDATED = 500.0
"""Milliseconds by which a packet is later than its neighbours where a buffer or a second path held
it back; packets that overtake each other are closer."""
DIRECT, DOUBTED, LATE = 2, 1, 0
"""The order of a packet. Its number directly follows, and the last boot time was a new one; or
packets are missing since that, or have overtaken it; or its number has already arrived, or the last
boot time was an outdated one."""
_RESTART = 1.0
"""Seconds without packets after which any number may follow: the sender may have restarted."""
_PUNCTUAL, _DRIFT, _LONGEST_DELAY = 0.06, 0.1, 0.5
"""Seconds by which positions may be read late before that counts: a tick, and a radio's jitter.
Seconds per second by which clocks of simulators part. Seconds of a delay that may end again; a
longer one is the link's."""
_LOCAL_POSITION_NED, _ATTITUDE, _GLOBAL_POSITION_INT = 32, 30, 33
One = TypeVar("One")
All = TypeVar("All")


class OneVehicle(Protocol):
    """A vehicle whose reports are the row ``row`` of a table."""

    telemetry: "TelemetryTable"
    row: int


class WholeTeam(Protocol):
    """The reports of n vehicles at one moment: ``values`` (n, WIDTH)."""

    @property
    def values(self) -> Floats:
        """The vehicles' rows of a table."""

    @property
    def row(self) -> None:
        """None: of all."""


class Field(Generic[One, All]):
    """A reported number, declared once: its columns, and an attribute of a vehicle and of a team.

    ``unknown`` stands in its ``width`` columns, of which ``column`` is the first, before the first
    report. ``of_one`` and ``of_all`` turn what stands there, of one vehicle and of n (n, width),
    into the attribute.
    """

    def __init__(
        self,
        of_one: Callable[[Floats], One],
        of_all: Callable[[Floats], All],
        unknown: float = math.nan,
        width: int = 1,
    ) -> None:
        self.column = len(_UNKNOWN)
        self.columns = self.column if width == 1 else slice(self.column, self.column + width)
        self._of_one, self._of_all = of_one, of_all
        _UNKNOWN.extend([unknown] * width)

    @overload
    def __get__(self, reports: None, owner: type) -> "Field[One, All]": ...
    @overload
    def __get__(self, reports: OneVehicle, owner: type) -> One: ...
    @overload
    def __get__(self, reports: WholeTeam, owner: type) -> All: ...
    def __get__(self, reports: Any, owner: type) -> "One | All | Field[One, All]":
        if reports is None:
            return self
        row = reports.row
        if row is None:
            return self._of_all(reports.values[:, self.columns])
        return self._of_one(reports.telemetry.values[row, self.columns])

    def __set__(self, vehicle: OneVehicle, value: One) -> None:
        vehicle.telemetry.values[vehicle.row, self.columns] = value


_UNKNOWN: list[float] = []
"""What stands in the columns before the first report."""


def _same(values: Floats) -> Floats:
    return values


def _vector(values: Floats) -> Vector:
    first, second, third = values.tolist()
    return first, second, third


def _number(unknown: float = math.nan) -> Field[float, Floats]:
    return Field(float, _same, unknown)


def _whole(unknown: float) -> Field[int, Floats]:
    return Field(int, _same, unknown)


def _flag(unknown: float) -> Field[bool, Flags]:
    return Field(bool, lambda values: values > 0.0, unknown)


class Reports:
    """What vehicles report, but for their motion: one line for each number.

    Times are the caller's, in seconds; ``boot_ms``, ``attitude_ms`` and ``global_ms`` those of the
    vehicle's clock in the latest position, attitude and global position. ``fastest`` is the
    smallest difference of both clocks, ``flow`` the order of packets.
    """

    received_at = _number(-math.inf)
    position_at = _number(-math.inf)
    attitude = Field(_vector, _same, width=3)
    boot_ms = _whole(-1.0)
    packets = _whole(0.0)
    lost_packets = _whole(0.0)
    component = _whole(1.0)
    mode_at = _number(-math.inf)
    battery = _number()
    position_healthy = _flag(1.0)
    compass_healthy = _flag(1.0)
    fix_type = _whole(-1.0)
    height_difference = _number()
    vertical_accuracy = _number()
    gripped = _flag(0.0)
    armed = _flag(0.0)
    attitude_ms = _number(-1.0)
    global_ms = _number(-1.0)
    fastest = _number(math.inf)
    flow = _number(DIRECT)
    asked_at = _number(math.inf)


class ReportedMotion:
    """The latest local position and velocity, in the vehicle's own NED; those of a team are in
    mission ENU, at the same moment."""

    position = Field(_vector, _same, width=3)
    velocity = Field(_vector, _same, width=3)


RECEIVED_AT: Final = Reports.received_at.column
POSITION_AT: Final = Reports.position_at.column
POSITION: Final = ReportedMotion.position.column
VELOCITY: Final = ReportedMotion.velocity.column
ATTITUDE: Final = Reports.attitude.column
BOOT_TIME: Final = Reports.boot_ms.column
ATTITUDE_TIME: Final = Reports.attitude_ms.column
GLOBAL_TIME: Final = Reports.global_ms.column
ASKED_AT: Final = Reports.asked_at.column
_PACKETS: Final = Reports.packets.column
_LOST_PACKETS: Final = Reports.lost_packets.column
_COMPONENT: Final = Reports.component.column
_FASTEST: Final = Reports.fastest.column
_FLOW: Final = Reports.flow.column
WIDTH: Final = len(_UNKNOWN)
"""Columns for compiled code."""

STAMPED = {
    _LOCAL_POSITION_NED: BOOT_TIME, _ATTITUDE: ATTITUDE_TIME, _GLOBAL_POSITION_INT: GLOBAL_TIME
}  # fmt: skip
"""Messages with a boot time, and the column of their last one."""
_COMPARED = (24, 33)
"""GPS_RAW_INT and GLOBAL_POSITION_INT are compared with the position that was sent before them."""
_MAGIC, _HEADER, _MIN_PACKET, _PAYLOAD = 0xFD, 10, 12, 28
_OVERTAKEN, _FAR = 128, 20
"""A sequence number that is farther ahead than this belongs to a packet that was overtaken; packets
overtake fewer others than this."""


TableArrays = tuple[Floats2, Shorts2, Bytes3, Floats2]
"""The arrays of a :class:`TelemetryTable`, for compiled functions."""


class TelemetryTable:
    """Frequent telemetry of n vehicles: ``values`` (n, WIDTH), and the packets that are missing.

    Packets are those of the autopilots. ``sequences`` (n, links) are the latest sequence numbers on
    each link, -1 before the first, which came at ``arrived`` (n, links). ``missing`` (n, links, 32)
    has one bit for each sequence number that has not arrived.
    """

    def __init__(self, vehicles: int, links: int = 1) -> None:
        self.values = np.tile(_UNKNOWN, (vehicles, 1))
        self.sequences = np.full((vehicles, links), -1, np.int16)
        self.missing = np.zeros((vehicles, links, 32), np.uint8)
        self.arrived = np.full((vehicles, links), -math.inf)

    @property
    def arrays(self) -> TableArrays:
        """Values, sequence numbers, missing packets, and arrivals."""
        return self.values, self.sequences, self.missing, self.arrived

    def copy_row(self, row: int) -> "TelemetryTable":
        """Return a table with a copy of one vehicle's row."""
        single = TelemetryTable(0)
        single.values = self.values[row : row + 1].copy()
        single.sequences = self.sequences[row : row + 1].copy()
        single.missing = self.missing[row : row + 1].copy()
        single.arrived = self.arrived[row : row + 1].copy()
        return single


@compiled
def count_packet(
    table: TableArrays, k: int, link: int, sequence: int, now: float, fresh: bool
) -> int:
    """Count a packet of vehicle ``k``'s autopilot, and the packets before it that have not arrived
    on this link; return its order (DIRECT, DOUBTED, LATE).

    ``fresh`` is whether its boot time is a new one: then it is of now, and where the latest number
    is far ahead of its own, that was a late packet's. A packet that arrives late is not lost, and
    does not set RECEIVED_AT. A number that is the latest one again counts as following: senders
    without sequence numbers send zeros.
    """
    values, sequences, missing, arrived = table
    values[k, _PACKETS] += 1.0
    last, missed = int(sequences[k, link]), missing[k, link]
    if fresh:
        values[k, RECEIVED_AT], values[k, _FLOW] = now, DIRECT
        while last >= 0 and _OVERTAKEN <= (sequence - last) & 0xFF < 256 - _FAR:
            last = _withdrawn(values[k], missed, last, sequence)
    restarted = last < 0 or now - arrived[k, link] > _RESTART
    gap, bit = (sequence - last) & 0xFF, 1 << (sequence & 7)
    if restarted and (last < 0 or gap >= _OVERTAKEN):
        gap = 1
        for byte in range(len(missed)):
            missed[byte] = 0
    if gap < _OVERTAKEN:
        arrived[k, link] = now
        sequences[k, link] = sequence
        missed[sequence >> 3] &= 0xFF ^ bit
        values[k, _LOST_PACKETS] += max(gap - 1, 0)
        for back in range(1, gap):
            before = (sequence - back) & 0xFF
            missed[before >> 3] |= 1 << (before & 7)
        if restarted:
            values[k, _FLOW] = DIRECT
        elif gap > 1 and not fresh:
            values[k, _FLOW] = min(values[k, _FLOW], DOUBTED)
        if values[k, _FLOW] != LATE:
            values[k, RECEIVED_AT] = now
        return int(values[k, _FLOW])
    if not missed[sequence >> 3] & bit:
        return LATE
    missed[sequence >> 3] &= 0xFF ^ bit
    values[k, _LOST_PACKETS] -= 1.0
    return int(min(values[k, _FLOW], DOUBTED))


@inner
def _withdrawn(row: Floats, missed: Bits, last: int, sequence: int) -> int:
    """Return the number before ``sequence`` as the latest, and no longer miss what follows it."""
    while last != (sequence - 1) & 0xFF:
        bit = 1 << (last & 7)
        if missed[last >> 3] & bit:
            missed[last >> 3] &= 0xFF ^ bit
            row[_LOST_PACKETS] -= 1.0
        last = (last - 1) & 0xFF
    return last


@compiled
def follows(boot_ms: float, last: float) -> bool:
    """Return whether a boot time in ms is later than the last one (-1: none) of the same clock.

    A clock that stands at zero counts nothing, so everything follows.
    """
    step = (boot_ms - last) % _CLOCK_RANGE
    return last < 0.0 or 0.0 < step < _LONGEST_STEP or boot_ms == last == 0.0


@compiled
def take_time(row: Floats1, column: int, boot_ms: float) -> bool:
    """Take the boot time of a message of one kind, if it follows the last; return whether it does.

    An outdated one tells that the packets around it are late, too.
    """
    last = row[column]
    if follows(boot_ms, last):
        row[column] = boot_ms
        return True
    if boot_ms != last and (last - boot_ms) % _CLOCK_RANGE > _OUTDATED:
        row[_FLOW] = LATE
    return False


@compiled
def take_position_time(row: Floats1, boot_ms: float, now: float) -> None:
    """Set POSITION_AT of a position that is read now, and has taken its boot time.

    A position that was delayed stands at the time of its measurement. The smallest difference
    between the time of reading and the boot time shows the clocks' difference.
    """
    apart = now - 1e-3 * boot_ms
    before = row[POSITION_AT]
    row[_FASTEST] = min(apart, row[_FASTEST] + _DRIFT * (now - before))
    late = apart - row[_FASTEST]
    if late > _LONGEST_DELAY:
        row[_FASTEST], late = apart, 0.0
    row[POSITION_AT] = now if late < _PUNCTUAL else max(now - late, before + 1e-3)


@compiled
@allocates
def read_datagrams(
    data: bytes, origins: Ints2, extras: Ints1, heard: tuple[int, float], table: TableArrays,
    rows: Ints2,
) -> int:  # fmt: skip
    """Read datagrams into the table; return the number of packets that are left for the handlers.

    ``data`` are m datagrams, one after the other. ``origins`` (m, 3) are their lengths, the rows of
    the vehicles that sent them, and their system ids. ``extras`` are CRC_EXTRA by message number,
    negative if there is no such message; ``heard`` are the number of the link, and the time. Every
    packet that is not read here is described, in its order, in a row of ``rows`` (k, 6), which must
    have a row for every possible packet: datagram, message number, component, start and end of the
    payload, order. These packets have been counted, if they are of an autopilot.
    If ``data`` holds anything but whole unsigned MAVLink 2 packets of known messages from their
    vehicles, nothing is read and the result is negative.
    """
    values, (link, now) = table[0], heard
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
            own, order, boot = data[at + 6] == values[k, _COMPONENT], DOUBTED, 0.0
            tabular = own and (
                number == _ATTITUDE or (number == _LOCAL_POSITION_NED and not in_order[k])
            )
            if own:
                column, fresh = _time_column(number), False
                if column >= 0:
                    boot = _boot_time(data, at + _HEADER, close)
                    fresh = follows(boot, values[k, column])
                order = count_packet(table, k, link, int(data[at + 4]), now, fresh)
            if not tabular or not _read_packet(data, at, close, single, (boot, now), values[k]):
                in_order[k] |= number == _LOCAL_POSITION_NED
                rows[used, 0], rows[used, 1], rows[used, 2] = m, number, data[at + 6]
                rows[used, 3], rows[used, 4], rows[used, 5] = at + _HEADER, close, order
                used += 1
            at = close + 2
    return used


def packet_rows(data: bytes) -> Indices:
    """Return an uninitialized array with a row for every packet that the data can hold."""
    return np.empty((len(data) // _MIN_PACKET + 1, 6), np.int64)


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
def _time_column(number: int) -> int:
    """Return the column of a message's boot time, negative without one: as in `STAMPED`."""
    if number == _LOCAL_POSITION_NED:
        return BOOT_TIME
    if number == _ATTITUDE:
        return ATTITUDE_TIME
    return GLOBAL_TIME if number == _GLOBAL_POSITION_INT else -1


@inner
def _boot_time(data: bytes, start: int, close: int) -> float:
    """Return the first four bytes of a payload, of which zeros at the end may be cut off."""
    boot = 0.0
    for k in range(min(4, close - start)):
        boot += float(data[start + k]) * 256.0**k
    return boot


@inner
@allocates
def _read_packet(
    data: bytes, at: int, close: int, single: npt.NDArray[np.float32],
    times: tuple[float, float], row: Floats,
) -> bool:  # fmt: skip
    """Read a position or an attitude into a vehicle's row; an attitude that is older than the last
    is dropped. False for a position of another time: it may show a reboot, which is an event.

    ``times`` are its boot time in ms and the time now in seconds."""
    boot, now = times
    raw = single.view(np.uint8)
    for k in range(_PAYLOAD):
        raw[k] = data[at + _HEADER + k] if at + _HEADER + k < close else 0
    if data[at + 7] == _ATTITUDE:
        if take_time(row, ATTITUDE_TIME, boot):
            for k in range(3):
                row[ATTITUDE + k] = single[1 + k]
        return True
    if not take_time(row, BOOT_TIME, boot):
        return False
    take_position_time(row, boot, now)
    for k in range(6):
        row[POSITION + k] = single[1 + k]
    return True


@inner
def crc_accumulate(checksum: int, byte: int) -> int:
    """Return the X25 checksum with one more byte."""
    change = (byte ^ checksum) & 0xFF
    change = (change ^ change << 4) & 0xFF
    return checksum >> 8 ^ change << 8 ^ change << 3 ^ change >> 4
