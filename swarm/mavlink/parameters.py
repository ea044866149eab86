"""The parameter protocol with one vehicle, sans-IO: all are fetched once, single ones are set.

What is lost on the way is asked for again; whatever does not come ends after a bounded time. PX4
sends whole numbers as the four bytes of an integer in the field of the float, ArduPilot as a float:
values are kept as bits until the type is known, since a float may not carry every integer's bits.
"""

import math
import struct
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple

from pymavlink.dialects.v20 import common

from swarm.mavlink.packets import Message

QUIET = 0.5
"""Seconds without a new parameter after which those that are missing are asked for one by one."""
PATIENCE = 5.0
"""Seconds without a new parameter after which fetching is given up."""
SET_AGAIN = 0.7
"""Seconds without the read-back after which a parameter is set again."""
ATTEMPTS = 6
_AT_ONCE = 5
"""Parameters of one vehicle that are being set at a time."""
_ASKED_AT_ONCE = 40
"""Missing parameters that are asked for at a time: a slow link must not be flooded."""
_NO_INDEX = 0xFFFF
_HASH = "_HASH_CHECK"
"""PX4 sends a checksum of all parameters as if it were one."""
_FLOAT = int(common.MAV_PARAM_TYPE_REAL32)
_SIGNED: Final = {
    int(common.MAV_PARAM_TYPE_UINT8): "<B3x",
    int(common.MAV_PARAM_TYPE_INT8): "<b3x",
    int(common.MAV_PARAM_TYPE_UINT16): "<H2x",
    int(common.MAV_PARAM_TYPE_INT16): "<h2x",
    int(common.MAV_PARAM_TYPE_UINT32): "<I",
    int(common.MAV_PARAM_TYPE_INT32): "<i",
}
"""How the types of whole numbers lie in the four bytes, where they are sent as bytes."""


class ParamSet(common.MAVLink_param_set_message):  # type: ignore[misc]
    """PARAM_SET whose value is given as its bits."""

    def __init__(self, target: tuple[int, int], name: str, bits: int, kind: int) -> None:
        super().__init__(*target, name.encode("ascii"), 0.0, kind)
        self._body = struct.pack("<IBB16sB", bits, *target, name.encode("ascii"), kind)

    def pack(self, mav: Any, force_mavlink1: bool = False) -> bytes:
        """Return the packet, as the library packs it."""
        return bytes(self._pack(mav, self.crc_extra, self._body, force_mavlink1))


class Refusal(NamedTuple):
    """A parameter that could not be set, and the value that the vehicle gave last, if any."""

    name: str
    wanted: float
    said: float | None


@dataclass
class _Setting:
    value: float
    attempts: int = 0
    next_send: float = -math.inf
    said: float | None = None


def value_of(bits: int, kind: int, *, bytewise: bool) -> float:
    """Return the number that a PARAM_VALUE's bits mean for a parameter of a MAVLink type."""
    raw = struct.pack("<I", bits)
    layout = _SIGNED.get(kind) if bytewise else None
    (value,) = struct.unpack(layout or "<f", raw)
    return float(value)


def bits_of(value: float, kind: int, *, bytewise: bool) -> int:
    """Return a number as the bits of a PARAM_SET; ValueError where its type cannot hold it."""
    try:
        if kind in _SIGNED and value != round(value):
            raise ValueError(f"{value:g} is not a whole number")
        layout = _SIGNED.get(kind) if bytewise else None
        raw = struct.pack(layout, round(value)) if layout else struct.pack("<f", value)
    except (struct.error, OverflowError):
        raise ValueError(f"{value:g} does not fit its type") from None
    (bits,) = struct.unpack("<I", raw)
    return int(bits)


@dataclass
class Parameters:
    """All parameters of one vehicle, as far as they have come.

    :meth:`fetch` and :meth:`put` only say what is wanted, and may be called from another thread;
    everything else happens in :meth:`receive` and :meth:`tick`. ``count`` is how many the vehicle
    says that it has, 0 before it has said so. ``problem`` says why fetching was given up.
    """

    values: dict[str, float] = field(default_factory=dict)
    count: int = 0
    problem: str = ""
    refused: list[Refusal] = field(default_factory=list)
    _kinds: dict[str, int] = field(default_factory=dict)
    _names: dict[int, str] = field(default_factory=dict)
    _fetching: bool = False
    _came_at: float | None = None
    _ask_at: float = -math.inf
    _setting: dict[str, _Setting] = field(default_factory=dict)

    @property
    def busy(self) -> bool:
        """Whether anything is being fetched or set."""
        return self._fetching or bool(self._setting)

    @property
    def have(self) -> int:
        """How many parameters have come."""
        return len(self._names)

    @property
    def to_set(self) -> int:
        """How many parameters are still to be set and read back."""
        return len(self._setting)

    def fetch(self) -> None:
        """Ask for all parameters; done when no longer :attr:`busy`."""
        self._names, self._came_at, self._ask_at, self.problem = {}, None, -math.inf, ""
        self.count = 0
        self._fetching = True

    def put(self, values: Mapping[str, float]) -> None:
        """Set parameters whose types are known, each until it is read back as it was set.

        Done when no longer :attr:`busy`; those that could not be set are then in ``refused``.
        """
        self.refused = []
        self._setting = {name: _Setting(float(value)) for name, value in values.items()}

    def receive(self, message: Message, *, bytewise: bool, now: float) -> None:
        """Take a PARAM_VALUE."""
        name = message.param_id.split(b"\0", 1)[0].decode("ascii", "replace")
        if name == _HASH:
            return
        value = value_of(message.bits, message.param_type, bytewise=bytewise)
        self.values[name], self._kinds[name] = value, message.param_type
        if self._fetching and message.param_index != _NO_INDEX:
            self._listed(message, name, now)
        setting = self._setting.get(name)
        if setting is not None and setting.attempts:
            setting.said = value
            if _same(value, setting.value):
                self._setting.pop(name, None)

    def _listed(self, message: Message, name: str, now: float) -> None:
        if message.param_index not in self._names:
            self._came_at = now
        self._names[message.param_index] = name
        self.count = message.param_count
        if self.have >= self.count and all(index in self._names for index in range(self.count)):
            known = set(self._names.values())
            self.values = {name: value for name, value in self.values.items() if name in known}
            self._fetching = False

    def tick(self, system: int, component: int, *, bytewise: bool, now: float) -> list[Message]:
        """Return what to send to a vehicle now."""
        messages: list[Message] = []
        if self._fetching:
            messages += self._fetch(system, component, now)
        for name, setting in list(self._setting.items())[:_AT_ONCE]:
            if now >= setting.next_send:
                messages += self._set(name, setting, (system, component), now, bytewise)
        return messages

    def _fetch(self, system: int, component: int, now: float) -> list[Any]:
        if self._came_at is None:
            self._came_at = now
        quiet = now - self._came_at
        if quiet > PATIENCE:
            self._fetching = False
            of = f"{self.have} of {self.count}" if self.count else "none"
            self.problem = f"{of} of its parameters came, and nothing more for {PATIENCE:g} s"
            return []
        if now < self._ask_at or (self.have and quiet < QUIET):
            return []
        self._ask_at = now + QUIET
        if not self.have:
            self._ask_at = now + 2.0 * QUIET
            return [common.MAVLink_param_request_list_message(system, component)]
        missing = [index for index in range(self.count) if index not in self._names]
        return [
            common.MAVLink_param_request_read_message(system, component, b"", index)
            for index in missing[:_ASKED_AT_ONCE]
        ]

    def _set(
        self, name: str, setting: _Setting, target: tuple[int, int], now: float, bytewise: bool
    ) -> list[ParamSet]:
        if setting.attempts >= ATTEMPTS:
            self.refused.append(Refusal(name, setting.value, setting.said))
            self._setting.pop(name, None)
            return []
        kind = self._kinds.get(name, _FLOAT)
        try:
            bits = bits_of(setting.value, kind, bytewise=bytewise)
        except ValueError:
            self.refused.append(Refusal(name, setting.value, self.values.get(name)))
            self._setting.pop(name, None)
            return []
        setting.attempts += 1
        setting.next_send = now + SET_AGAIN
        return [ParamSet(target, name, bits, kind)]


def _same(said: float, wanted: float) -> bool:
    """Whether a value is what was set, as a float of four bytes tells."""
    return said == wanted or struct.pack("<f", said) == struct.pack("<f", wanted)
