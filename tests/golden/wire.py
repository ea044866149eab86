"""Packets on the wire, decoded by pymavlink: nothing here trusts the code that made them."""

import struct
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from pymavlink.dialects.v20 import common

from swarm.simulation.loop import Emulator

SETPOINT = int(common.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED)
CURRENT_MODE = 436
"""PX4's message of its mode; the library has no definition of it yet."""
_HEADER, _CHECKSUM = 10, 2


class Datagram(NamedTuple):
    """Bytes between the ground station and one vehicle at a time; ``up`` is towards the vehicle."""

    time: float
    up: bool
    system: int
    data: bytes


class Tapped(Emulator):
    """The emulator, keeping what crosses the ground station's end of each link in ``wire``."""

    def __init__(self, *arguments: Any, **named: Any) -> None:
        super().__init__(*arguments, **named)
        self.wire: list[Datagram] = []

    def receive(self, sysid: int, data: bytes, now: float) -> None:
        self.wire.append(Datagram(now, True, sysid, data))
        super().receive(sysid, data, now)

    def receive_all(self, sent: Iterable[tuple[int, bytes]], now: float) -> None:
        sent = list(sent)
        self.wire += [Datagram(now, True, sysid, data) for sysid, data in sent]
        super().receive_all(sent, now)

    def step(self, now: float) -> list[tuple[int, bytes]]:
        arrived = super().step(now)
        self.wire += [Datagram(now, False, system, data) for system, data in arrived]
        return arrived


@dataclass
class Reader:
    """Takes MAVLink 2 datagrams apart; only messages of the ``wanted`` numbers, or all (None)."""

    wanted: frozenset[int] | None = None
    _mav: Any = field(default_factory=lambda: common.MAVLink(None))

    def messages(self, data: bytes) -> Iterator[Any]:
        """Yield the messages of a datagram; CURRENT_MODE as a :class:`CurrentMode`."""
        start = 0
        while start < len(data):
            length, number = data[start + 1], int.from_bytes(data[start + 7 : start + 10], "little")
            end = start + _HEADER + length + _CHECKSUM
            if self.wanted is None or number in self.wanted:
                packet = data[start:end]
                if number == CURRENT_MODE:
                    yield CurrentMode.of(packet)
                else:
                    yield self._mav.decode(bytearray(packet))
            start = end


class CurrentMode(NamedTuple):
    """CURRENT_MODE, of which the mode's number is of interest."""

    custom_mode: int

    @classmethod
    def of(cls, packet: bytes) -> "CurrentMode":
        """Read a packet; zeros at its end may have been cut off."""
        payload = packet[_HEADER:-_CHECKSUM].ljust(9, b"\0")
        return cls(struct.unpack("<IIB", payload)[0])

    def get_type(self) -> str:
        """As pymavlink's messages."""
        return "CURRENT_MODE"


def is_setpoint(data: bytes) -> bool:
    """Whether a datagram is one setpoint packet."""
    return int.from_bytes(data[7:10], "little") == SETPOINT


def numbers_of(words: str) -> list[int]:
    """Return the numbers that :func:`listed` put into words."""
    runs = [part.split("–") for part in words.split(", ")]
    return [k for run in runs for k in range(int(run[0]), int(run[-1]) + 1)]


def listed(numbers: list[int]) -> str:
    """Return numbers in words, runs as ranges: ``1–3, 7``."""
    runs: list[list[int]] = []
    for number in sorted(set(numbers)):
        if runs and number == runs[-1][-1] + 1:
            runs[-1].append(number)
        else:
            runs.append([number])
    return ", ".join(f"{run[0]}–{run[-1]}" if len(run) > 1 else str(run[0]) for run in runs)
