"""MAVLink 2 frames of one vehicle and its links: bytes in and out, no sockets and no clock.

Telemetry is packed by hand (about a microsecond per message), because an emulator of a hundred
vehicles spends most of its time here; field order, sizes and CRC seeds are pymavlink's. pymavlink
parses incoming bytes, except setpoints, which arrive fifty times a second, and frequent messages.
"""

import hashlib
import heapq
import struct
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Any, NamedTuple

from fastcrc import crc16
from pymavlink.dialects.v20 import common as dialect

MAGIC = 0xFD
SETPOINT_LOCAL = 84
_pack_head = struct.Struct("<6BHx").pack
_pack_checksum = struct.Struct("<H").pack
_WHOLE_SETPOINT = struct.Struct("<5xBB3x4x11fHBBB2x")
SETPOINT_LENGTH = _WHOLE_SETPOINT.size
_WHOLE, _NUMBER = b"\xfd\x35\0", bytes([SETPOINT_LOCAL, 0, 0])
_HEADER_LENGTH = 10
_TICKS_PER_SECOND = 100_000
_LARGEST_TICKS = 2**48 - 1
_crc: Callable[..., int] = crc16.mcrf4xx


@dataclass(frozen=True)
class MessageLayout:
    """Wire format of one message: number, packed structure, CRC seed, fields.

    ``blank`` are the values of an empty message in wire order; ``places`` are the index of each
    field in it, and the length of an array of numbers (otherwise 0).
    """

    number: int
    struct: struct.Struct
    seed: bytes
    blank: list[Any]
    places: dict[str, tuple[int, int]]


def _layouts() -> dict[str, MessageLayout]:
    layouts = {}
    for number, message in dialect.mavlink_map.items():
        kinds = dict(zip(message.fieldnames, message.fieldtypes, strict=True))
        blank: list[Any] = []
        places = {}
        names = message.ordered_fieldnames
        for name, length in zip(names, message.array_lengths, strict=True):
            text = kinds[name] == "char"
            places[name] = (len(blank), 0 if text else length)
            blank += [b""] if text else [0] * max(length, 1)
        seed = bytes([message.crc_extra])
        layouts[message.msgname] = MessageLayout(number, message.unpacker, seed, blank, places)
    layouts["EKF_STATUS_REPORT"] = _ekf_status_report()
    layouts |= {name: _newer_layout(*described) for name, described in _NEWER_MESSAGES.items()}
    return layouts


_NEWER_MESSAGES: dict[str, tuple[int, int, str, str]] = {
    "LINK_NODE_STATUS": (8, 117, "<QIIIIIHHHBB",
        "timestamp tx_rate rx_rate messages_sent messages_received messages_lost rx_parse_err "
        "tx_overflows rx_overflows tx_buf rx_buf"),
    "TIME_ESTIMATE_TO_TARGET": (380, 232, "<iiiii",
        "safe_return land mission_next_item mission_end commanded_action"),
    "COMPONENT_METADATA": (397, 182, "<II100s", "time_boot_ms file_crc uri"),
    "CURRENT_EVENT_SEQUENCE": (411, 106, "<HB", "sequence flags"),
    "CURRENT_MODE": (436, 193, "<IIB", "custom_mode intended_custom_mode standard_mode"),
}  # fmt: skip
"""Messages of PX4 in common.xml that the library lacks: number, CRC seed, structure, fields in
wire order."""


def _newer_layout(number: int, seed: int, packed: str, names: str) -> MessageLayout:
    places = {name: (place, 0) for place, name in enumerate(names.split())}
    blank: list[Any] = [b"" if name == "uri" else 0 for name in places]
    return MessageLayout(number, struct.Struct(packed), bytes([seed]), blank, places)


def _ekf_status_report() -> MessageLayout:
    """Return the layout of ArduPilot's message about its estimator (ardupilotmega.xml)."""
    variances = ("velocity", "pos_horiz", "pos_vert", "compass", "terrain_alt")
    names = (*(f"{name}_variance" for name in variances), "flags", "airspeed_variance")
    places = {name: (place, 0) for place, name in enumerate(names)}
    return MessageLayout(193, struct.Struct("<5fHf"), bytes([71]), [0] * len(names), places)


LAYOUTS: dict[str, MessageLayout] = _layouts()
NUMBERS: dict[str, int] = {name: layout.number for name, layout in LAYOUTS.items()}
_BY_NUMBER = {number: LAYOUTS[message.msgname] for number, message in dialect.mavlink_map.items()}


_FAST_MESSAGES = {
    NUMBERS[name]: (name, tuple(LAYOUTS[name].places)) for name in ("HEARTBEAT", "TIMESYNC")
}
"""Frequent messages of ground stations, read without pymavlink for speed."""


def payload(name: str, fields: dict[str, Any]) -> bytes:
    """Return the payload of a message with named fields; other fields are zero.

    Text is a ``str`` or ``bytes``; arrays are sequences, extended with zeros.
    """
    layout = LAYOUTS[name]
    values = layout.blank.copy()
    places = layout.places
    for key, value in fields.items():
        place, length = places[key]
        if length:
            values[place : place + min(len(value), length)] = value[:length]
        else:
            values[place] = value.encode("utf-8") if isinstance(value, str) else value
    return layout.struct.pack(*values)


def template(name: str, varying: str, **constant: Any) -> Callable[..., bytes]:
    """Return a function that packs a message's payload from the values of ``varying`` fields.

    ``varying`` are names separated by spaces; all other fields are ``constant`` or zero. Arrays are
    sequences, extended with zeros.
    """
    layout = LAYOUTS[name]
    blank = list(layout.struct.unpack(payload(name, constant)))
    places = [layout.places[each] for each in varying.split()]
    if varying.split() == list(layout.places) and not any(length for _, length in places):
        return layout.struct.pack

    def fill(*values: Any) -> bytes:
        filled = blank.copy()
        for (place, length), value in zip(places, values, strict=True):
            if length:
                filled[place : place + len(value)] = value
            else:
                filled[place] = value
        return layout.struct.pack(*filled)

    return fill


class Signer:
    """Signs outgoing frames with one key (MAVLink 2 message signing)."""

    def __init__(self, key: bytes, link: int, timestamp: int) -> None:
        self.key = key
        self.link = link
        self.timestamp = timestamp

    def sign(self, frame: bytes, now_ticks: int) -> bytes:
        """Return the 13 bytes that sign a frame; timestamps strictly increase.

        A timestamp has six bytes: as in MAVLink's library, more are cut off.
        """
        self.timestamp = max(self.timestamp + 1, now_ticks) & _LARGEST_TICKS
        tail = bytes([self.link]) + self.timestamp.to_bytes(6, "little")
        return tail + hashlib.sha256(self.key + frame + tail).digest()[:6]


class Sender:
    """Packs frames for one link of one vehicle: sequence numbers, checksum, signature."""

    def __init__(self, system: int, component: int = 1) -> None:
        self.system = system
        self.component = component
        self.sequence = 0
        self.signer: Signer | None = None

    def frame(self, number: int, body: bytes, seed: bytes, now_ticks: int = 0) -> bytes:
        """Return a MAVLink 2 frame with payload ``body``, without its trailing zeros.

        ``number`` is below 65536, as in all messages that vehicles send.
        """
        if not body[-1]:
            body = body.rstrip(b"\0") or b"\0"
        self.sequence = sequence = (self.sequence + 1) & 0xFF
        signer = self.signer
        if signer is None:
            inner = _pack_head(len(body), 0, 0, sequence, self.system, self.component, number)
            inner += body
            return b"\xfd%b%b" % (inner, _pack_checksum(_crc(inner + seed)))
        inner = _pack_head(len(body), 1, 0, sequence, self.system, self.component, number) + body
        out = b"\xfd" + inner + _pack_checksum(_crc(inner + seed))
        return out + signer.sign(out, now_ticks)

    def pack(self, name: str, now_ticks: int = 0, **fields: Any) -> bytes:
        """Return the frame of a message given by name and named fields."""
        layout = LAYOUTS[name]
        return self.frame(layout.number, payload(name, fields), layout.seed, now_ticks)


class Setpoint(NamedTuple):
    """SET_POSITION_TARGET_LOCAL_NED as received (NED, SI, radians).

    ``values`` are position, velocity and acceleration, nine numbers.
    """

    system: int
    component: int
    target_system: int
    target_component: int
    frame: int
    mask: int
    values: tuple[float, ...]
    yaw: float
    yaw_rate: float


_setpoint: Callable[[tuple[Any, ...]], Setpoint] = partial(tuple.__new__, Setpoint)


def setpoint_of(message: Any) -> Setpoint:
    """Return pymavlink's message as the tuple of the fast path."""
    m = message
    return Setpoint(
        m.get_srcSystem(),
        m.get_srcComponent(),
        m.target_system,
        m.target_component,
        m.coordinate_frame,
        m.type_mask,
        (m.x, m.y, m.z, m.vx, m.vy, m.vz, m.afx, m.afy, m.afz),
        m.yaw,
        m.yaw_rate,
    )


def setpoint_in(data: bytes) -> Setpoint | None:
    """Return the setpoint in ``data``, None unless that is exactly one complete packet."""
    if len(data) != SETPOINT_LENGTH or data[:3] != _WHOLE or data[7:10] != _NUMBER:
        return None
    if _crc(data[1:-2] + b"\x8f") != data[-2] | data[-1] << 8:
        return None
    v = _WHOLE_SETPOINT.unpack(data)
    return _setpoint((v[0], v[1], v[14], v[15], v[16], v[13], v[2:11], v[11], v[12]))


class FastMessage:
    """A message of numbers only, with the methods of pymavlink's messages that handlers use."""

    def __init__(self, name: str, number: int, data: bytes, values: dict[str, Any]) -> None:
        self._name, self._number, self._data = name, number, data
        self.__dict__.update(values)

    def __getattr__(self, name: str) -> Any:
        raise AttributeError(f"{self._name} has no field {name}")

    def get_type(self) -> str:
        """Return the message's name."""
        return self._name

    def get_msgId(self) -> int:  # noqa: N802 - pymavlink's name
        """Return the message's number."""
        return self._number

    def get_srcSystem(self) -> int:  # noqa: N802 - pymavlink's name
        """Return the sender's system id."""
        return self._data[5]

    def get_srcComponent(self) -> int:  # noqa: N802 - pymavlink's name
        """Return the sender's component id."""
        return self._data[6]


class Receiver:
    """Parses the bytes of one link; invalid bytes are dropped and counted, without exceptions.

    With a key, only signed frames with a new timestamp are accepted.
    """

    def __init__(self, key: bytes | None = None) -> None:
        self._parser = dialect.MAVLink(None, 0, 0)
        self._parser.robust_parsing = True
        self._pending = False
        self.bad = 0
        self.set_key(key)

    def set_key(self, key: bytes | None) -> None:
        """Require signatures with ``key`` from now on; None accepts unsigned frames."""
        self.key = key
        self._parser.signing.secret_key = key

    @property
    def plain(self) -> bool:
        """Whether the next bytes are unsigned and start a new frame."""
        return self.key is None and not self._pending

    def feed(self, data: bytes) -> list[Any]:
        """Return the messages (or `Setpoint` tuples) that ``data`` completes."""
        setpoint = setpoint_in(data) if self.plain else None
        if setpoint is not None:
            return [setpoint]
        try:
            messages = self._whole(data) or self._parser.parse_buffer(data) or []
        except (dialect.MAVError, struct.error, ValueError, IndexError, UnicodeDecodeError):
            self._reset()
            return []
        self._pending = self._parser.buf_len() > 0
        valid = [message for message in messages if message.get_type() != "BAD_DATA"]
        self.bad += len(messages) - len(valid)
        return [
            setpoint_of(message) if message.get_msgId() == SETPOINT_LOCAL else message
            for message in valid
        ]

    def _whole(self, data: bytes) -> list[Any]:
        """Return the message in ``data``, if that is exactly one valid unsigned packet.

        The result equals that of the parser's state machine.
        """
        if (
            not self.plain
            or len(data) <= _HEADER_LENGTH
            or data[0] != MAGIC
            or data[2]
            or len(data) != data[1] + _HEADER_LENGTH + 2
        ):
            return []
        layout = _BY_NUMBER.get(int.from_bytes(data[7:10], "little"))
        if layout is None or _crc(data[1:-2] + layout.seed) != data[-2] | data[-1] << 8:
            return []
        fast = _FAST_MESSAGES.get(layout.number)
        if fast is None:
            return [self._parser.decode(bytearray(data))]
        name, names = fast
        body = data[_HEADER_LENGTH:-2][: layout.struct.size].ljust(layout.struct.size, b"\0")
        values = dict(zip(names, layout.struct.unpack(body), strict=True))
        return [FastMessage(name, layout.number, data, values)]

    def _reset(self) -> None:
        self.bad += 1
        self._parser = dialect.MAVLink(None, 0, 0)
        self._parser.robust_parsing = True
        self._parser.signing.secret_key = self.key
        self._pending = False


def signing_ticks(unix_seconds: float) -> int:
    """Return a MAVLink signing timestamp: 10 µs ticks since 2015-01-01."""
    return int((unix_seconds - 1_420_070_400.0) * _TICKS_PER_SECOND)


ACCEPTED, TEMPORARILY_REJECTED, DENIED, UNSUPPORTED, FAILED, IN_PROGRESS = range(6)
"""MAV_RESULT."""


@dataclass
class Link:
    """A connection: telemetry streams, parser, sender and the frames that wait to be sent.

    ``intervals`` are seconds between two messages of a name, ``due`` is a heap of (time, name).
    """

    vehicle: int
    kind: str
    sender: Sender
    receiver: Receiver = field(default_factory=Receiver)
    intervals: dict[str, float] = field(default_factory=dict)
    due: list[tuple[float, str]] = field(default_factory=list)
    outgoing: list[bytes] = field(default_factory=list)

    def stream(self, name: str, interval: float | None, now: float) -> None:
        """Send a message every ``interval`` seconds; None ends the stream."""
        if interval is None:
            self.intervals.pop(name, None)
            return
        fresh = name not in self.intervals
        faster = not fresh and interval < self.intervals[name]
        self.intervals[name] = interval
        if fresh or faster:
            self.due = [entry for entry in self.due if entry[1] != name]
            heapq.heapify(self.due)
            heapq.heappush(self.due, (now, name))


class Command(NamedTuple):
    """A received command: number, seven parameters, position in 1e-7 degrees, link and sender."""

    number: int
    p: list[float]
    x: int
    y: int
    link: Link
    system: int
    component: int
