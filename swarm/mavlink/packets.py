"""Decoding of received bytes to messages, and encoding of messages to bytes.

Layouts and checksums are pymavlink's. :mod:`swarm.mavlink.telemetry_table` reads the frequent
messages for the whole team at once, :mod:`swarm.mavlink.setpoints` packs setpoints.
"""

from collections import namedtuple
from collections.abc import Callable, Container, Iterable
from dataclasses import dataclass
from functools import partial
from struct import Struct
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from pymavlink.dialects.v20 import common

from swarm.mavlink.signing import SIGNATURE_LENGTH, Signing

Floats = npt.NDArray[np.float64]
Bytes = npt.NDArray[np.uint8]
Message = Any
"""A pymavlink message; the library is not typed."""

GROUND_SYSTEM = 255
GROUND_COMPONENT = int(common.MAV_COMP_ID_MISSIONPLANNER)

_MAGIC_1, _MAGIC_2 = 0xFE, 0xFD
_SIGNED = 0x01
_HEADER = Struct("<xBxxBBBHB").unpack_from
"""Length, sequence, system, component, and the message number in two parts."""


class Encoder:
    """Encodes the messages of one route, which has its own sequence numbers."""

    def __init__(self, system: int = GROUND_SYSTEM, component: int = GROUND_COMPONENT) -> None:
        self._mav = common.MAVLink(None, srcSystem=system, srcComponent=component)
        self._source = system, component
        self._sequence = 0

    @property
    def sequence(self) -> int:
        """The sequence number of the next packet."""
        return self._sequence

    def encode(self, message: Message) -> bytes:
        """Return the message as a packet, byte for byte pymavlink's."""
        sequence = self.next_sequence()
        layout = _LAYOUTS.get(message.get_msgId())
        if layout is None or not layout.numeric:
            self._mav.seq = sequence
            return bytes(message.pack(self._mav))
        body = layout.pack(message).rstrip(b"\0") or b"\0"
        number = layout.number.to_bytes(3, "little")
        inner = bytes((len(body), 0, 0, sequence, *self._source)) + number + body
        return b"\xfd" + inner + _checksum(inner + layout.extra).to_bytes(2, "little")

    def next_sequence(self) -> int:
        """Return the next sequence number, for a packet that is encoded elsewhere, and advance."""
        number = self._sequence
        self._sequence = (number + 1) & 0xFF
        return number


class Packet(NamedTuple):
    """A received packet: message number, sender, sequence number, content.

    ``message`` has pymavlink's field names; it is None if the decoder does not unpack it.
    """

    number: int
    system: int
    component: int
    sequence: int
    message: Message | None


@dataclass
class Decoder:
    """Decodes the bytes of one route to packets.

    Datagrams hold whole packets: an incomplete packet at the end is dropped and counted. On a
    ``stream`` (serial, TCP) it is kept for the next call. Packets with a wrong checksum or an
    unknown message are counted, and never end the flight. Only messages whose number is in
    ``unpacked`` are unpacked; None unpacks all. With ``include_unknown``, packets of unknown
    messages in datagrams are returned without content: their checksums cannot be verified.
    """

    stream: bool = False
    unpacked: Container[int] | None = None
    include_unknown: bool = False
    damaged: int = 0
    unknown: int = 0
    _rest: bytes = b""

    def feed(self, data: bytes, signing: Signing | None = None) -> list[Packet]:
        """Return the packets that these bytes complete, in order.

        With ``signing``, only packets that are signed with its key and not replayed.
        """
        if self._rest:
            data = self._rest + data
            self._rest = b""
        packets: list[Packet] = []
        end = len(data)
        start = 0
        while start < end:
            length = packet_length(data, start)
            if length == 0:
                self.damaged += 1
                start = _next_start(data, start + 1)
            elif length < 0 or start + length > end:
                if self.stream:
                    self._rest = data[start:]
                else:
                    self.damaged += 1
                break
            else:
                start = self._append(data, start, length, packets, signing)
        return packets

    def _append(
        self,
        data: bytes,
        start: int,
        length: int,
        packets: list[Packet],
        signing: Signing | None,
    ) -> int:
        """Append the packet at ``start``; return the offset of the next one."""
        version_2 = data[start] == _MAGIC_2
        if version_2:
            size, sequence, system, component, low, high = _HEADER(data, start)
            number, header = low | high << 16, 10
        else:
            _, size, sequence, system, component, number = data[start : start + 6]
            header = 6
        layout = _LAYOUTS.get(number)
        if layout is None:
            self.unknown += 1
            packet = data[start : start + length]
            if version_2 and self._includes_unknown(packet, signing):
                packets.append(Packet(number, system, component, sequence, None))
            return start + length
        close = start + header + size
        checksum = _checksum(data[start + 1 : close] + layout.extra)
        if checksum != data[close] | data[close + 1] << 8:
            self.damaged += 1
            return _next_start(data, start + 1)
        if signing is not None and signing.verify(data[start : start + length]) != "genuine":
            return start + length
        message = None
        if self.unpacked is None or number in self.unpacked:
            message = layout.unpack(data[start + header : close])
        packets.append(_make_packet((number, system, component, sequence, message)))
        return start + length

    def _includes_unknown(self, packet: bytes, signing: Signing | None) -> bool:
        """Return whether a packet of an unknown message is returned, so that it is counted."""
        if not self.include_unknown or self.stream:
            return False
        return signing is None or signing.verify(packet) == "genuine"


_make_packet: Callable[[tuple[Any, ...]], Packet] = partial(tuple.__new__, Packet)
_named: Any = namedtuple
"""Named tuples whose field names come from pymavlink at run time."""


class _Layout:
    """The layout of one message in a payload."""

    def __init__(self, kind: Any) -> None:
        self.number = int(kind.id)
        self.extra = bytes([kind.crc_extra])
        self._unpack, self._size = kind.unpacker.unpack, kind.unpacker.size
        fields = _named(kind.msgname, kind.ordered_fieldnames)
        self._make: Callable[[Iterable[Any]], Message] = partial(tuple.__new__, fields)
        self._arrays = [
            length if length > 1 and not declared.startswith("char") else 0
            for length, declared in zip(
                kind.lengths, (kind.fieldtypes[k] for k in _declared(kind)), strict=True
            )
        ]
        self._flat = not any(self._arrays)
        self.numeric = self._flat and not any(name.startswith("char") for name in kind.fieldtypes)
        self._names, self._pack = tuple(kind.ordered_fieldnames), kind.unpacker.pack

    def pack(self, message: Message) -> bytes:
        """Return the payload of a message that has only numeric fields."""
        return bytes(self._pack(*[getattr(message, name) for name in self._names]))

    def unpack(self, payload: bytes) -> Message:
        """Return the message; truncated bytes at the end are zero."""
        size = self._size
        if len(payload) != size:
            payload = payload[:size].ljust(size, b"\0")
        values = self._unpack(payload)
        if self._flat:
            return self._make(values)
        items: list[Any] = []
        start = 0
        for length in self._arrays:
            items.append(list(values[start : start + length]) if length else values[start])
            start += length or 1
        return self._make(items)


def _declared(kind: Any) -> list[int]:
    """Return the indices in the declaration of the fields, in the order of the payload."""
    return [kind.fieldnames.index(name) for name in kind.ordered_fieldnames]


CURRENT_MODE = 436
"""PX4's message with its mode: in MAVLink's definitions since 2024, not yet in pymavlink's."""


class _CurrentMode:
    id, crc_extra, msgname = CURRENT_MODE, 193, "CURRENT_MODE"
    unpacker = Struct("<IIB")
    ordered_fieldnames = ("custom_mode", "intended_custom_mode", "standard_mode")
    fieldnames, lengths = ordered_fieldnames, (1, 1, 1)
    fieldtypes = ("uint32_t", "uint32_t", "uint8_t")


PARAM_VALUE = int(common.MAVLINK_MSG_ID_PARAM_VALUE)


class _ParamValueLayout(_Layout):
    """PARAM_VALUE with its value also as ``bits``: a float cannot hold every integer's bits."""

    def __init__(self, kind: Any) -> None:
        super().__init__(kind)
        fields = _named(kind.msgname, (*kind.ordered_fieldnames, "bits"))
        self._make = partial(tuple.__new__, fields)

    def unpack(self, payload: bytes) -> Message:
        """Return the message; truncated bytes at the end are zero."""
        payload = payload[: self._size].ljust(self._size, b"\0")
        return self._make((*self._unpack(payload), int.from_bytes(payload[:4], "little")))


class _ChecksumOnly:
    """A message that is newer than pymavlink and needed for its checksum only."""

    unpacker = Struct("<")
    ordered_fieldnames: tuple[str, ...] = ()
    fieldnames, lengths, fieldtypes = ordered_fieldnames, (), ()

    def __init__(self, number: int, crc_extra: int, msgname: str) -> None:
        self.id, self.crc_extra, self.msgname = number, crc_extra, msgname


_NEWER = (
    _CurrentMode,
    _ChecksumOnly(8, 117, "LINK_NODE_STATUS"),
    _ChecksumOnly(380, 232, "TIME_ESTIMATE_TO_TARGET"),
    _ChecksumOnly(397, 182, "COMPONENT_METADATA"),
    _ChecksumOnly(410, 160, "EVENT"),
    _ChecksumOnly(411, 106, "CURRENT_EVENT_SEQUENCE"),
)
"""Messages of PX4 that pymavlink does not define."""
_NEWER_NAMES = {kind.id: kind.msgname for kind in _NEWER}
_LAYOUTS = {int(kind.id): _Layout(kind) for kind in (*common.mavlink_map.values(), *_NEWER)}
_LAYOUTS[PARAM_VALUE] = _ParamValueLayout(common.mavlink_map[PARAM_VALUE])
CRC_EXTRAS = np.full(max(_LAYOUTS) + 1, -1, np.int64)
"""CRC_EXTRA by message number; negative if there is no such message."""
CRC_EXTRAS[list(_LAYOUTS)] = [layout.extra[0] for layout in _LAYOUTS.values()]


def unpack(number: int, payload: bytes) -> Message:
    """Return the message with this number in a payload."""
    return _LAYOUTS[number].unpack(payload)


def message_name(number: int) -> str:
    """Return the name of a message, "message NUMBER" if it is unknown."""
    kind = common.mavlink_map.get(number)
    if kind is None:
        return _NEWER_NAMES.get(number, f"message {number}")
    return str(kind.msgname)


def enum_words(enum: str, prefix: str) -> dict[int, str]:
    """Return the values of a MAVLink enum in words, without the prefix of their names."""
    return {
        int(value): entry.name.removeprefix(prefix).replace("_", " ").lower()
        for value, entry in common.enums[enum].items()
        if not entry.name.endswith("ENUM_END")
    }


def _slow_checksum(data: bytes) -> int:
    return int(common.x25crc(data).crc)


_checksum: Callable[[bytes], int] = getattr(common, "mcrf4xx", None) or _slow_checksum
"""The X25 checksum, from fastcrc if pymavlink has found it."""


def split_packets(data: bytes) -> tuple[list[bytes], bytes]:
    """Return the consecutive packets in these bytes, and the incomplete rest."""
    packets: list[bytes] = []
    start, end = 0, len(data)
    while start < end:
        length = packet_length(data, start)
        if length < 0 or start + length > end:
            return packets, data[start:]
        if length:
            packets.append(data[start : start + length])
            start += length
        else:
            start = _next_start(data, start + 1)
    return packets, b""


def sender(packet: bytes) -> tuple[int, int]:
    """Return system and component id in a packet."""
    at = 5 if packet[0] == _MAGIC_2 else 3
    return packet[at], packet[at + 1]


def packet_length(data: bytes, start: int) -> int:
    """Return the length of the packet at ``start``: 0 if there is none, negative if cut off."""
    if len(data) - start < 3:
        return -1 if data[start] in {_MAGIC_1, _MAGIC_2} else 0
    if data[start] == _MAGIC_2:
        if data[start + 2] & ~_SIGNED:
            return 0
        return 12 + data[start + 1] + (SIGNATURE_LENGTH if data[start + 2] & _SIGNED else 0)
    return 8 + data[start + 1] if data[start] == _MAGIC_1 else 0


def _next_start(data: bytes, start: int) -> int:
    offsets = [data.find(_MAGIC_1, start), data.find(_MAGIC_2, start)]
    return min((offset for offset in offsets if offset >= 0), default=len(data))
