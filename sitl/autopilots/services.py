"""What an autopilot does besides flying: what is due, and handlers of ground stations' messages.

Heartbeats, commands that every autopilot executes, parameters, streams, logs, file transfer, time,
external positions, signing; missions are in `sitl.autopilots.missions`.
"""

import math
import zlib
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
from pydantic import ValidationError
from pymavlink.dialects.v20 import common as dialect

from sitl.autopilots import missions, telemetry
from sitl.autopilots.ardupilot import DATA_STREAMS
from sitl.autopilots.telemetry import default_streams, send_message
from sitl.protocol import wire
from sitl.protocol.parameters import REAL32
from sitl.protocol.vehicle import INFO, GripperRequest, Vehicle, addressed, scaled_degrees
from sitl.protocol.wire import ACCEPTED, DENIED, FAILED, IN_PROGRESS, UNSUPPORTED, Command, Link
from sitl.world import WorldError

_LARGEST_RATE = 200.0
_LONGEST_INTERVAL = 2000.0
_LARGEST_ID = 65535
_FARTHEST = 1e5
_INJECT_FAILURE = 420
_NAMES = {number: name for name, number in wire.NUMBERS.items()}
NO_ACK = -1
"""Result of a command that gets no COMMAND_ACK now."""
_NOT_PX4 = frozenset({"EKF_STATUS_REPORT", "HEARTBEAT"})
"""Messages without a settable rate: PX4's heartbeats have a period of one second."""
_NOT_ARDUPILOT = frozenset(
    {"COMPONENT_METADATA", "CURRENT_EVENT_SEQUENCE", "CURRENT_MODE", "LINK_NODE_STATUS", "PING",
     "TIMESYNC", "TIME_ESTIMATE_TO_TARGET"}
)  # fmt: skip


def _request_message(v: Vehicle, command: Command) -> int:
    """Send one message.

    PX4 denies messages that it cannot send now, and acknowledges after the message. ArduPilot
    acknowledges first, also where it then sends no message.
    """
    name = str(_NAMES.get(int(command.p[0])))
    known = name in telemetry.MESSAGES
    if v.is_px4:
        if name == "GPS_GLOBAL_ORIGIN":
            v.origin_announced_at = v.now
        return ACCEPTED if known and send_message(v, name, command.link) else DENIED
    if not known or name in _NOT_ARDUPILOT:
        return FAILED
    v.acknowledge(command, ACCEPTED)
    send_message(v, name, command.link)
    return NO_ACK


def _set_interval(v: Vehicle, command: Command) -> int:
    name = _NAMES.get(int(command.p[0]))
    unsupported = name in (_NOT_PX4 if v.is_px4 else _NOT_ARDUPILOT)
    if unsupported or name not in telemetry.MESSAGES or not math.isfinite(command.p[1]):
        return FAILED if v.is_px4 else DENIED
    if command.p[1] < 0:
        command.link.stream(name, None, v.now)
    elif command.p[1] == 0:
        rate = default_streams(v, command.link).get(name)
        command.link.stream(name, 1.0 / rate if rate else None, v.now)
    else:
        command.link.stream(
            name, min(max(command.p[1] * 1e-6, 1.0 / _LARGEST_RATE), _LONGEST_INTERVAL), v.now
        )
    return ACCEPTED


def _get_interval(v: Vehicle, command: Command) -> int:
    number = int(command.p[0])
    if not 0 <= number <= _LARGEST_ID:
        return DENIED
    interval = command.link.intervals.get(_NAMES.get(number, ""))
    microseconds = round(interval * 1e6) if interval else -1
    v.send("MESSAGE_INTERVAL", command.link, message_id=number, interval_us=microseconds)
    return ACCEPTED


def _capabilities(v: Vehicle, command: Command) -> int:
    send_message(v, "AUTOPILOT_VERSION", command.link)
    return ACCEPTED


def _gripper(v: Vehicle, command: Command) -> int:
    enabled = "PD_GRIPPER_EN" if v.is_px4 else "GRIP_ENABLE"
    if v.spec.gripper != "mavlink" or not v.parameters[enabled]:
        return UNSUPPORTED
    if command.p[1] not in (0.0, 1.0):
        return DENIED
    delay = float(v.rng.uniform(0.4, 0.7))
    v.gripper.start(GripperRequest(v.now + delay, command.p[1] == 1.0, command))
    return IN_PROGRESS if v.is_px4 else NO_ACK


def _home(v: Vehicle, command: Command) -> int:
    return ACCEPTED if send_message(v, "HOME_POSITION", command.link) else DENIED


def _set_home(v: Vehicle, command: Command) -> int:
    if not v.global_valid:
        return DENIED
    place = np.array(v.estimated())
    if command.p[0] != 1.0:
        if not (
            math.isfinite(command.p[4])
            and math.isfinite(command.p[5])
            and math.isfinite(command.p[6])
        ):
            return DENIED
        x, y = v.environment.geodesy.metres(command.p[4], command.p[5])
        z = command.p[6] - v.environment.geodesy.altitude
        if max(abs(x), abs(y), abs(z)) > _FARTHEST:
            return DENIED
        place = np.array([x, y, z])
    v.home, v.home_set_at = place, v.clock()
    return ACCEPTED


def _inject(v: Vehicle, command: Command) -> int:
    if v.is_px4 and not v.parameters["SYS_FAILURE_EN"]:
        return DENIED
    numbers = [int(number) for number in command.p[:3]]
    known = v.inject is not None and v.inject(numbers[0], numbers[1], numbers[2])
    return ACCEPTED if known else UNSUPPORTED


def _set_speed(v: Vehicle, command: Command) -> int:
    v.set_speed(command.p[1])
    return ACCEPTED


def _reboot(v: Vehicle, command: Command) -> int:
    if command.p[0] not in (1.0, 3.0):
        return ACCEPTED if command.p[0] == 0.0 else DENIED
    if v.armed:
        return DENIED if v.is_px4 else FAILED
    v.timers.append((v.now + 0.2, v.reboot))
    return ACCEPTED


COMMANDS: dict[int, Callable[[Vehicle, Command], int]] = {
    dialect.MAV_CMD_REQUEST_MESSAGE: _request_message,
    dialect.MAV_CMD_SET_MESSAGE_INTERVAL: _set_interval,
    dialect.MAV_CMD_GET_MESSAGE_INTERVAL: _get_interval,
    dialect.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES: _capabilities,
    dialect.MAV_CMD_DO_GRIPPER: _gripper,
    dialect.MAV_CMD_GET_HOME_POSITION: _home,
    dialect.MAV_CMD_DO_SET_HOME: _set_home,
    dialect.MAV_CMD_DO_CHANGE_SPEED: _set_speed,
    _INJECT_FAILURE: _inject,
    dialect.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN: _reboot,
}


_ABOVE_SEA, _ABOVE_HOME = (0, 5), (3, 6)


def update(v: Vehicle, now: float) -> None:
    """Execute what is due on a vehicle: timers, gripper, queued parameters and its autopilot."""
    v.now = max(v.now, now)
    if v.timers:
        due = [entry for entry in v.timers if entry[0] <= now]
        v.timers = [entry for entry in v.timers if entry[0] > now]
        for _, action in due:
            action()
    if v.frozen:
        return
    if v.gripper.pending:
        v.finish_gripper()
    if v.parameter_queue:
        _send_queued(v)
    next_check = v.autopilot.update()
    if not (v.timers or v.gripper.pending or v.parameter_queue):
        v.next_check_at = next_check


def handle(v: Vehicle, message: Any, link: Link) -> None:
    """Handle one message from a ground station."""
    if v.frozen:
        return
    if type(message) is wire.Setpoint:
        if message.target_system in (0, v.system) and message.target_component < 2:
            v.autopilot.handle_setpoint(message)
        return
    v.next_check_at = -math.inf
    name = message.get_type()
    handler = _HANDLERS.get(name)
    if handler is None and name in _ADDRESSED and addressed(v, message):
        handler = _ADDRESSED[name]
    if handler is not None:
        handler(v, message, link)


def _heartbeat(v: Vehicle, message: Any, _: Link) -> None:
    if message.type == dialect.MAV_TYPE_GCS:
        v.last_heartbeat[message.get_srcSystem()] = v.now


def _command_long(v: Vehicle, message: Any, link: Link) -> None:
    p = [getattr(message, f"param{k}") for k in range(1, 8)]
    _command(v, message, p, (scaled_degrees(p[4]), scaled_degrees(p[5])), link)


def _command_int(v: Vehicle, message: Any, link: Link) -> None:
    x, y = message.x, message.y
    p = [getattr(message, f"param{k}") for k in range(1, 5)]
    _command(v, message, [*p, x * 1e-7, y * 1e-7, message.z], (x, y), link)


def _command(v: Vehicle, message: Any, p: list[float], xy: tuple[int, int], link: Link) -> None:
    number = message.command
    command = Command(number, p, *xy, link, message.get_srcSystem(), message.get_srcComponent())
    common = COMMANDS.get(number)
    try:
        result = common(v, command) if common else v.autopilot.handle_command(command)
    except (ValueError, OverflowError):
        result = DENIED
    if result is None:
        result = UNSUPPORTED
    if result != NO_ACK:
        v.acknowledge(command, result)
        if number == dialect.MAV_CMD_DO_SET_MODE and v.is_px4:
            v.acknowledge(command, result)


def _set_mode(v: Vehicle, message: Any, link: Link) -> None:
    if message.target_system == v.system:
        result = v.autopilot.set_mode(message.base_mode, message.custom_mode)
        v.answer("COMMAND_ACK", message, link, command=message.get_msgId(), result=result)


def _log_list(v: Vehicle, _: Any, link: Link) -> None:
    v.send("LOG_ENTRY", link)


_FTP_NAK, _FTP_FAIL = 129, 1


def _file_transfer(v: Vehicle, message: Any, link: Link) -> None:
    request = list(message.payload)
    answer = [0] * 251
    sequence = (request[0] | request[1] << 8) + 1
    answer[0], answer[1] = sequence & 0xFF, sequence >> 8 & 0xFF
    answer[3], answer[4], answer[5], answer[12] = _FTP_NAK, 1, request[3], _FTP_FAIL
    v.answer("FILE_TRANSFER_PROTOCOL", message, link, payload=answer)


def _timesync(v: Vehicle, message: Any, link: Link) -> None:
    if message.tc1 == 0:
        v.send("TIMESYNC", link, tc1=round(v.clock() * 1e9), ts1=message.ts1)


def _ping(v: Vehicle, message: Any, link: Link) -> None:
    if message.target_system == 0:
        v.answer("PING", message, link, time_usec=message.time_usec, seq=message.seq)


def _set_origin(v: Vehicle, message: Any, link: Link) -> None:
    """Set the origin of PX4's estimator; ArduPilot keeps an origin that it already has."""
    if message.target_system not in {0, v.system} or not v.is_px4:
        return
    if abs(message.latitude) > 900_000_000 or abs(message.longitude) > 1_800_000_000:
        return
    x, y = v.environment.geodesy.metres(message.latitude * 1e-7, message.longitude * 1e-7)
    z = message.altitude * 1e-3 - v.environment.geodesy.altitude
    if max(abs(x), abs(y), abs(z)) < _FARTHEST:
        v.move_origin([x, y, z])
        send_message(v, "GPS_GLOBAL_ORIGIN", link)


def _vision(v: Vehicle, message: Any, _: Link) -> None:
    """Correct the indoor position with motion capture (local NED of the common frame).

    After the first message, a gap ends the local position (`Emulator`); before it, the estimate is
    valid without motion capture.
    """
    place = (message.x, message.y, message.z)
    if not v.environment.indoor or not all(map(math.isfinite, place)):
        return
    measured = np.array(v.to_world(*place))
    correction = measured - v.bodies.position[v.index]
    if float(np.linalg.norm(correction)) < 5.0:
        v.bodies.bias[v.index] = correction
        v.bodies.refresh()
        v.vision_at = v.now
        if v.vision_lost:
            v.vision_lost, v.local_valid = False, True


def _data_stream(v: Vehicle, message: Any, link: Link) -> None:
    if v.is_px4:
        return
    for name in DATA_STREAMS.get(message.req_stream_id, ()):
        rate = min(message.req_message_rate, 50)
        on = message.start_stop == 1 and rate > 0
        link.stream(name, 1.0 / rate if on else None, v.now)


def _global_setpoint(v: Vehicle, message: Any, _: Link) -> None:
    """Convert a setpoint in degrees, above the sea or above home, to a local one."""
    m = message
    if m.coordinate_frame not in {*_ABOVE_SEA, *_ABOVE_HOME}:
        return
    if not v.global_valid or v.home is None:
        return
    x, y = v.environment.geodesy.metres(m.lat_int * 1e-7, m.lon_int * 1e-7)
    above_sea = m.coordinate_frame in _ABOVE_SEA
    z = m.alt + (-v.environment.geodesy.altitude if above_sea else float(v.home[2]))
    local = v.to_local(np.array([x, y, z]))
    if not m.type_mask & 7 and max(map(abs, local[:2])) > _FARTHEST:
        return
    v.autopilot.handle_setpoint(
        wire.Setpoint(
            m.get_srcSystem(), m.get_srcComponent(), m.target_system, m.target_component,
            dialect.MAV_FRAME_LOCAL_NED, m.type_mask,
            (*local, m.vx, m.vy, m.vz, m.afx, m.afy, m.afz), m.yaw, m.yaw_rate,
        )
    )  # fmt: skip


def _setup_signing(v: Vehicle, message: Any, link: Link) -> None:
    if message.target_system != v.system:
        return
    key = bytes(message.secret_key)
    if any(key):
        link.receiver.set_key(key)
        link.sender.signer = wire.Signer(key, 0, int(message.initial_timestamp))
    else:
        link.receiver.set_key(None)
        link.sender.signer = None


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


PARAMETERS_PER_UPDATE = 20
"""PARAM_VALUE messages per update of the autopilot, 25 times a second."""
_BANNER = "ArduCopter V4.6.2 (1a132e4b)"


_HASH, _UINT32 = "_HASH_CHECK", 5
_NO_INDEX = 65535


def _send_parameter(v: Vehicle, link: Link, name: str, *, by_name: bool = True) -> None:
    """Send PARAM_VALUE; ArduPilot omits the index after a request ``by_name`` or a change."""
    p = v.parameters
    index = _NO_INDEX if by_name and not v.is_px4 else p.indices[name]
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


def _param_list(v: Vehicle, _: Any, link: Link) -> None:
    if v.is_px4:
        _send_hash(v, link)
    else:
        for text in (_BANNER, f"emulated {v.system:03}", "Frame: QUAD/PLUS"):
            v.text(INFO, text)
    v.parameter_queue = [entry for entry in v.parameter_queue if entry[0] is not link]
    v.parameter_queue += [(link, k) for k in range(len(v.parameters.names))]


def _send_queued(v: Vehicle) -> None:
    """Send the next parameters of the requested lists."""
    for link, index in v.parameter_queue[:PARAMETERS_PER_UPDATE]:
        _send_parameter(v, link, v.parameters.names[index], by_name=False)
    del v.parameter_queue[:PARAMETERS_PER_UPDATE]


def _name(text: Any) -> str:
    raw = text.encode("utf-8", "replace") if isinstance(text, str) else bytes(text)
    return raw.split(b"\0")[0].decode("ascii", "replace")


def _param_read(v: Vehicle, message: Any, link: Link) -> None:
    p = v.parameters
    if message.param_index >= 0:
        if message.param_index < len(p.names):
            _send_parameter(v, link, p.names[message.param_index], by_name=False)
        return
    name = _name(message.param_id)
    if name in p.values:
        _send_parameter(v, link, name)
    elif name == _HASH and v.is_px4:
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
    name = _name(message.param_id)
    p = v.parameters
    if name not in p.values:
        return
    body = bytes(message.get_msgbuf())[10:]
    value = p.decode(name, body[:4].ljust(4, b"\0"), message.param_type)
    if value is not None:
        set_parameter(v, name, value)
    for target in v.links:
        _send_parameter(v, target, name)


_HANDLERS: dict[str, Callable[[Vehicle, Any, Link], None]] = {
    "HEARTBEAT": _heartbeat,
    "SET_MODE": _set_mode,
    "TIMESYNC": _timesync,
    "PING": _ping,
    "SET_GPS_GLOBAL_ORIGIN": _set_origin,
    "VISION_POSITION_ESTIMATE": _vision,
    "ODOMETRY": _vision,
    "SETUP_SIGNING": _setup_signing,
}
_ADDRESSED: dict[str, Callable[[Vehicle, Any, Link], None]] = {
    **missions.HANDLERS,
    "PARAM_REQUEST_LIST": _param_list,
    "PARAM_REQUEST_READ": _param_read,
    "PARAM_SET": _param_set,
    "COMMAND_LONG": _command_long,
    "COMMAND_INT": _command_int,
    "LOG_REQUEST_LIST": _log_list,
    "FILE_TRANSFER_PROTOCOL": _file_transfer,
    "REQUEST_DATA_STREAM": _data_stream,
    "SET_POSITION_TARGET_GLOBAL_INT": _global_setpoint,
}
"""Handlers of messages with a target: only those for this vehicle's autopilot."""
