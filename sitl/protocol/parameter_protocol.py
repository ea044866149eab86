"""The parameter protocol: list, read, set; SIM_* parameters inject faults."""

import zlib
from collections.abc import Callable
from typing import Any

from pydantic import ValidationError

from sitl.protocol import wire
from sitl.protocol.links import Link
from sitl.protocol.vehicle import Vehicle, addressed

PARAMETERS_PER_UPDATE = 20
"""PARAM_VALUE messages per update of the autopilot, 25 times a second."""
_INFO = 6
_BANNER = ("ArduCopter V4.6.2 (1a132e4b)",)


_HASH, _UINT32 = "_HASH_CHECK", 5
_NO_INDEX = 65535


def send_parameter(v: Vehicle, link: Link, name: str) -> None:
    """Send PARAM_VALUE of a parameter, with its index."""
    p = v.parameters
    _send(v, link, name, p.encode(name), p.kinds[name], p.indices[name])


def _send_changed(v: Vehicle, link: Link, name: str) -> None:
    """Send PARAM_VALUE after a request by name or a change: ArduPilot omits the index."""
    p = v.parameters
    index = p.indices[name] if v.spec.autopilot == "px4" else _NO_INDEX
    _send(v, link, name, p.encode(name), p.kinds[name], index)


def _send_hash(v: Vehicle, link: Link) -> None:
    """Send PX4's checksum of all parameters; clients compare it with their cached list."""
    p = v.parameters
    contents = b"".join(name.encode() + p.encode(name) for name in p.names)
    value = zlib.crc32(contents).to_bytes(4, "little")
    _send(v, link, _HASH, value, _UINT32, _NO_INDEX)


def _send(v: Vehicle, link: Link, name: str, value: bytes, kind: int, index: int) -> None:
    body = (
        value
        + len(v.parameters.names).to_bytes(2, "little")
        + index.to_bytes(2, "little")
        + name.encode().ljust(16, b"\0")
        + bytes([kind])
    )
    layout = wire.LAYOUTS["PARAM_VALUE"]
    ticks = v.signing_ticks()
    link.outgoing.append(link.sender.frame(layout.number, body, layout.seed, ticks))


def _param_list(v: Vehicle, message: Any, link: Link) -> None:
    if addressed(v, message):
        if v.spec.autopilot == "px4":
            _send_hash(v, link)
        else:
            for text in (*_BANNER, f"emulated {v.system:03}", "Frame: QUAD/PLUS"):
                v.text(_INFO, text)
        v.parameter_queue = [entry for entry in v.parameter_queue if entry[0] is not link]
        v.parameter_queue += [(link, k) for k in range(len(v.parameters.names))]


def send_queued(v: Vehicle) -> None:
    """Send the next parameters of the requested lists."""
    for link, index in v.parameter_queue[:PARAMETERS_PER_UPDATE]:
        send_parameter(v, link, v.parameters.names[index])
    del v.parameter_queue[:PARAMETERS_PER_UPDATE]


def _name(text: Any) -> str:
    raw = text.encode("utf-8", "replace") if isinstance(text, str) else bytes(text)
    return raw.split(b"\0")[0].decode("ascii", "replace")


def _param_read(v: Vehicle, message: Any, link: Link) -> None:
    if not addressed(v, message):
        return
    p = v.parameters
    if message.param_index >= 0:
        if message.param_index < len(p.names):
            send_parameter(v, link, p.names[message.param_index])
        return
    name = _name(message.param_id)
    if name in p.values:
        _send_changed(v, link, name)
    elif name == _HASH and v.spec.autopilot == "px4":
        _send_hash(v, link)


def set_parameter(v: Vehicle, name: str, value: float) -> None:
    """Set a parameter that the vehicle has; its autopilot and injected faults follow.

    A value that describes no possible fault is not taken.
    """
    before, v.parameters.values[name] = v.parameters.values[name], value
    v.autopilot.parameter_changed(name)
    if name.startswith("SIM_") and v.on_sim_parameter is not None:
        try:
            v.on_sim_parameter(name, v.parameters.values)
        except ValidationError:
            v.parameters.values[name] = before
            v.on_sim_parameter(name, v.parameters.values)


def _param_set(v: Vehicle, message: Any, _: Link) -> None:
    if not addressed(v, message):
        return
    name = _name(message.param_id)
    p = v.parameters
    if name not in p.values:
        return
    body = bytes(message.get_msgbuf())[10:]
    value = p.decode(name, body[:4].ljust(4, b"\0"), message.param_type)
    if value is not None:
        set_parameter(v, name, value)
    for target in v.links:
        _send_changed(v, target, name)


HANDLERS: dict[str, Callable[[Vehicle, Any, Link], None]] = {
    "PARAM_REQUEST_LIST": _param_list,
    "PARAM_REQUEST_READ": _param_read,
    "PARAM_SET": _param_set,
}
