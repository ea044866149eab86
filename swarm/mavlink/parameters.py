"""The parameter protocol of one vehicle, sans-IO: all are fetched once, single ones are set.

Parameters that are lost on the link are requested again, for a bounded time. PX4 sends integers as
the four bytes of an integer in the field of the float, ArduPilot as a float. Values are kept as
bits until the type is known, since a float cannot hold the bits of every integer.
"""

import math
import struct
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple

from pymavlink.dialects.v20 import common

from swarm.errors import printable
from swarm.mavlink.packets import Message

REQUEST_AFTER = 0.5
"""Seconds without a new parameter after which the missing ones are requested one by one."""
FETCH_TIMEOUT = 5.0
"""Seconds without a new parameter after which fetching fails."""
SET_AGAIN_AFTER = 0.7
"""Seconds without the read-back after which a parameter is set again."""
ATTEMPTS = 6
_MAX_SETTING = 5
"""Parameters of one vehicle that are set at the same time."""
_MAX_REQUESTS = 40
"""Missing parameters that are requested at the same time: a slow link must not be flooded."""
_NO_INDEX = 0xFFFF
_HASH = "_HASH_CHECK"
"""PX4 sends a checksum of all parameters in the form of a parameter."""
_FLOAT = int(common.MAV_PARAM_TYPE_REAL32)
_INTEGERS: Final = {
    int(common.MAV_PARAM_TYPE_UINT8): "<B3x",
    int(common.MAV_PARAM_TYPE_INT8): "<b3x",
    int(common.MAV_PARAM_TYPE_UINT16): "<H2x",
    int(common.MAV_PARAM_TYPE_INT16): "<h2x",
    int(common.MAV_PARAM_TYPE_UINT32): "<I",
    int(common.MAV_PARAM_TYPE_INT32): "<i",
}
"""Layouts of integers in the four bytes, for autopilots that send them as bytes."""


class ParamSet(common.MAVLink_param_set_message):  # type: ignore[misc]
    """PARAM_SET with the value given as bits."""

    def __init__(self, target: tuple[int, int], name: str, bits: int, kind: int) -> None:
        super().__init__(*target, name.encode("ascii"), 0.0, kind)
        self._body = struct.pack("<IBB16sB", bits, *target, name.encode("ascii"), kind)

    def pack(self, mav: Any, force_mavlink1: bool = False) -> bytes:
        """Return the packet; pymavlink calls this method."""
        return bytes(self._pack(mav, self.crc_extra, self._body, force_mavlink1))


class FailedSetting(NamedTuple):
    """A parameter that was not set, and the value that the vehicle reported last, if any."""

    name: str
    requested: float
    reported: float | None


@dataclass
class _Setting:
    value: float
    attempts: int = 0
    next_send: float = -math.inf
    reported: float | None = None


def decode_value(bits: int, kind: int, *, bytewise: bool) -> float:
    """Return the value of a PARAM_VALUE from its bits and its MAV_PARAM_TYPE."""
    raw = struct.pack("<I", bits)
    layout = _INTEGERS.get(kind) if bytewise else None
    (value,) = struct.unpack(layout or "<f", raw)
    return float(value)


def encode_value(value: float, kind: int, *, bytewise: bool) -> int:
    """Return a value as the bits of a PARAM_SET.

    Raises :class:`ValueError` if the type cannot hold the value.
    """
    try:
        if kind in _INTEGERS and value != round(value):
            raise ValueError(f"{value:g} is not a whole number")
        layout = _INTEGERS.get(kind) if bytewise else None
        raw = struct.pack(layout, round(value)) if layout else struct.pack("<f", value)
    except (struct.error, OverflowError):
        raise ValueError(f"{value:g} does not fit its type") from None
    (bits,) = struct.unpack("<I", raw)
    return int(bits)


@dataclass
class Parameters:
    """The parameters of one vehicle that have been received.

    :meth:`fetch` and :meth:`set` only store a request, and may be called from another thread;
    all protocol work is done in :meth:`receive` and :meth:`tick`. ``total`` is the number of
    parameters that the vehicle reports, 0 before the first. ``problem`` is the reason why fetching
    failed, empty otherwise. ``failed`` are the parameters that could not be set.
    """

    values: dict[str, float] = field(default_factory=dict)
    total: int = 0
    problem: str = ""
    failed: list[FailedSetting] = field(default_factory=list)
    _kinds: dict[str, int] = field(default_factory=dict)
    _names: dict[int, str] = field(default_factory=dict)
    _fetching: bool = False
    _received_at: float | None = None
    _next_request: float = -math.inf
    _setting: dict[str, _Setting] = field(default_factory=dict)

    @property
    def busy(self) -> bool:
        """Whether parameters are being fetched or set."""
        return self._fetching or bool(self._setting)

    @property
    def received(self) -> int:
        """The number of parameters that have been received."""
        return len(self._names)

    @property
    def pending(self) -> int:
        """The number of parameters that are not yet set and read back."""
        return len(self._setting)

    def fetch(self) -> None:
        """Request all parameters; done when no longer :attr:`busy`."""
        self._names, self._received_at, self._next_request, self.problem = {}, None, -math.inf, ""
        self.total = 0
        self._fetching = True

    def set(self, values: Mapping[str, float]) -> None:
        """Set parameters of known type, each until it is read back with the same value.

        Done when no longer :attr:`busy`; ``failed`` then lists those that could not be set.
        """
        self.failed = []
        self._setting = {name: _Setting(float(value)) for name, value in values.items()}

    def receive(self, message: Message, *, bytewise: bool, now: float) -> None:
        """Process a PARAM_VALUE."""
        name = printable(message.param_id.split(b"\0", 1)[0].decode("ascii", "replace"))
        if name == _HASH:
            return
        value = decode_value(message.bits, message.param_type, bytewise=bytewise)
        self.values[name], self._kinds[name] = value, message.param_type
        if self._fetching and message.param_index != _NO_INDEX:
            self._add_fetched(message, name, now)
        setting = self._setting.get(name)
        if setting is not None and setting.attempts:
            setting.reported = value
            if _same(value, setting.value):
                self._setting.pop(name, None)

    def _add_fetched(self, message: Message, name: str, now: float) -> None:
        index = message.param_index
        known = self._names.get(index)
        if index >= message.param_count or (known is None and name in self._names.values()):
            return
        if known is None:
            self._received_at = now
            self._names[index] = name
        self.total = max(self.total, message.param_count)
        if self.received == self.total:
            names = set(self._names.values())
            self.values = {name: value for name, value in self.values.items() if name in names}
            self._fetching = False

    def tick(self, system: int, component: int, *, bytewise: bool, now: float) -> list[Message]:
        """Return the messages to send to the vehicle now."""
        messages: list[Message] = []
        if self._fetching:
            messages += self._fetch(system, component, now)
        for name, setting in list(self._setting.items())[:_MAX_SETTING]:
            if now >= setting.next_send:
                messages += self._set(name, setting, (system, component), now, bytewise)
        return messages

    def _fetch(self, system: int, component: int, now: float) -> list[Any]:
        if self._received_at is None:
            self._received_at = now
        quiet = now - self._received_at
        if quiet > FETCH_TIMEOUT:
            self._fetching = False
            number = f"{self.received} of {self.total}" if self.total else "none"
            self.problem = f"{number} of its parameters received, then none for {FETCH_TIMEOUT:g} s"
            return []
        if now < self._next_request or (self.received and quiet < REQUEST_AFTER):
            return []
        self._next_request = now + REQUEST_AFTER
        if not self.received:
            self._next_request = now + 2.0 * REQUEST_AFTER
            return [common.MAVLink_param_request_list_message(system, component)]
        missing = [index for index in range(self.total) if index not in self._names]
        return [
            common.MAVLink_param_request_read_message(system, component, b"", index)
            for index in missing[:_MAX_REQUESTS]
        ]

    def _set(
        self, name: str, setting: _Setting, target: tuple[int, int], now: float, bytewise: bool
    ) -> list[ParamSet]:
        if setting.attempts >= ATTEMPTS:
            self.failed.append(FailedSetting(name, setting.value, setting.reported))
            self._setting.pop(name, None)
            return []
        kind = self._kinds.get(name, _FLOAT)
        try:
            bits = encode_value(setting.value, kind, bytewise=bytewise)
        except ValueError:
            self.failed.append(FailedSetting(name, setting.value, self.values.get(name)))
            self._setting.pop(name, None)
            return []
        setting.attempts += 1
        setting.next_send = now + SET_AGAIN_AFTER
        return [ParamSet(target, name, bits, kind)]


def _same(reported: float, requested: float) -> bool:
    """Return whether two values are equal, exactly or as floats of four bytes."""
    return reported == requested or struct.pack("<f", reported) == struct.pack("<f", requested)
