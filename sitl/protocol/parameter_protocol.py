"""The parameter protocol: list, read, set; parameters that a world gives; SIM_* parameters.

SIM_* parameters inject faults (`sitl.faults.injector`); both autopilots have all of them.
ArduPilot's names keep ArduPilot's meanings; the other names exist in this emulator only.
"""

import zlib
from collections.abc import Callable, Iterable
from typing import Any

from pydantic import ValidationError

from sitl.protocol import wire
from sitl.protocol.links import Link
from sitl.protocol.parameters import REAL32
from sitl.protocol.vehicle import Vehicle, addressed
from sitl.world import WorldError


def start_with_given(vehicles: Iterable[Vehicle]) -> None:
    """Set the parameters of the world's vehicles, but those of real firmware, which reads them.

    Raises `WorldError` with every parameter that the emulated autopilot does not have, and every
    value with a fraction for an integer parameter.
    """
    errors: list[str] = []
    for vehicle in vehicles:
        for name, value in ({} if vehicle.frozen else vehicle.spec.parameters).items():
            place = f"vehicle {vehicle.system}: parameters.{name}"
            if name not in vehicle.parameters.values:
                kind = vehicle.spec.autopilot
                errors.append(
                    f"{place}: expected a parameter of the emulated {kind}, got an unknown one"
                )
            elif vehicle.parameters.kinds[name] == REAL32:
                set_parameter(vehicle, name, value)
            elif value == round(value):
                set_parameter(vehicle, name, round(value))
            else:
                errors.append(f"{place}: expected an integer, got {value:g}")
    if errors:
        raise WorldError("\n".join(errors))


OF_ARDUPILOT: dict[str, float | int] = {
    "SIM_BARO_DRIFT": 0.0, "SIM_BATT_VOLTAGE": 0.0, "SIM_ENGINE_FAIL": 0, "SIM_ENGINE_MUL": 1.0,
    "SIM_GPS1_ENABLE": 1, "SIM_GPS1_GLTCH_X": 0.0, "SIM_GPS1_GLTCH_Y": 0.0,
    "SIM_GPS1_GLTCH_Z": 0.0, "SIM_RC_FAIL": 0, "SIM_UART_LOSS": 0.0, "SIM_WIND_DIR": 180.0,
    "SIM_WIND_SPD": 0.0, "SIM_WIND_TURB": 0.0,
}  # fmt: skip
OWN: dict[str, float | int] = {
    "SIM_ARM_REFUSE": 0, "SIM_CLOCK_MUL": 1.0, "SIM_DISARM": 0, "SIM_FREEZE": 0.0,
    "SIM_GRIP_FAIL": 0, "SIM_LANDED": 0, "SIM_LEAVE": 0, "SIM_LINK_BANDW": 0.0,
    "SIM_LINK_BURST": 0.0, "SIM_LINK_DELAY": 0.0, "SIM_LINK_DIR": 0, "SIM_LINK_DUP": 0.0,
    "SIM_LINK_JITTER": 0.0, "SIM_LINK_LOSS": 0.0, "SIM_LINK_REORD": 0.0, "SIM_ORIGIN_E": 0.0,
    "SIM_ORIGIN_N": 0.0, "SIM_PILOT": 0, "SIM_POS_LOSS": 0, "SIM_REBOOT": 0, "SIM_SNAG_ARC": -1.0,
    "SIM_SNAG_HOLD": 0.0,
}  # fmt: skip
SIM_PARAMETERS = OF_ARDUPILOT | OWN


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
