"""What an autopilot does besides flying: what is due, and handlers of ground stations' messages.

Heartbeats, commands, streams, logs, file transfer, time, external positions, signing; missions are
in `sitl.protocol.missions`, parameters in `sitl.protocol.parameter_protocol`.
"""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import common as dialect

from sitl.autopilots.ardupilot import tables as ardupilot_tables
from sitl.autopilots.commands import COMMANDS, NO_ACK
from sitl.autopilots.streams import send_message
from sitl.protocol import missions, parameter_protocol, wire
from sitl.protocol.links import DENIED, UNSUPPORTED, Command, Link
from sitl.protocol.vehicle import Vehicle, addressed, scaled_degrees

_FARTHEST = 1e5
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
        parameter_protocol.send_queued(v)
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
    handler = _HANDLERS.get(message.get_type())
    if handler is not None:
        handler(v, message, link)


def _heartbeat(v: Vehicle, message: Any, _: Link) -> None:
    if message.type == dialect.MAV_TYPE_GCS:
        v.last_heartbeat[message.get_srcSystem()] = v.now


def _command_long(v: Vehicle, message: Any, link: Link) -> None:
    if addressed(v, message):
        p = [getattr(message, f"param{k}") for k in range(1, 8)]
        _command(v, message, p, (scaled_degrees(p[4]), scaled_degrees(p[5])), link)


def _command_int(v: Vehicle, message: Any, link: Link) -> None:
    if addressed(v, message):
        x, y = message.x, message.y
        p = [getattr(message, f"param{k}") for k in range(1, 5)]
        _command(v, message, [*p, x * 1e-7, y * 1e-7, message.z], (x, y), link)


def _command(v: Vehicle, message: Any, p: list[float], xy: tuple[int, int], link: Link) -> None:
    number, sender = message.command, (message.get_srcSystem(), message.get_srcComponent())
    command = Command(number, p, *xy, link, *sender)
    common = COMMANDS.get(number)
    try:
        result = common(v, command) if common else v.autopilot.handle_command(command)
    except (ValueError, OverflowError):
        result = DENIED
    if result is None:
        result = UNSUPPORTED
    if result != NO_ACK:
        v.acknowledge(number, result, link, *sender)
        if number == dialect.MAV_CMD_DO_SET_MODE and v.spec.autopilot == "px4":
            v.acknowledge(number, result, link, *sender)


def _set_mode(v: Vehicle, message: Any, link: Link) -> None:
    if message.target_system == v.system:
        result = v.autopilot.set_mode(message.base_mode, message.custom_mode)
        v.acknowledge(
            dialect.MAVLINK_MSG_ID_SET_MODE,
            result,
            link,
            message.get_srcSystem(),
            message.get_srcComponent(),
        )


def _log_list(v: Vehicle, message: Any, link: Link) -> None:
    if addressed(v, message):
        v.send("LOG_ENTRY", link)


_FTP_NAK, _FTP_FAIL = 129, 1


def _file_transfer(v: Vehicle, message: Any, link: Link) -> None:
    if not addressed(v, message):
        return
    request = list(message.payload)
    answer = [0] * 251
    sequence = (request[0] | request[1] << 8) + 1
    answer[0], answer[1] = sequence & 0xFF, sequence >> 8 & 0xFF
    answer[3], answer[4], answer[5], answer[12] = _FTP_NAK, 1, request[3], _FTP_FAIL
    v.send(
        "FILE_TRANSFER_PROTOCOL",
        link,
        target_system=message.get_srcSystem(),
        target_component=message.get_srcComponent(),
        payload=answer,
    )


def _timesync(v: Vehicle, message: Any, link: Link) -> None:
    if message.tc1 == 0:
        v.send("TIMESYNC", link, tc1=round(v.clock() * 1e9), ts1=message.ts1)


def _ping(v: Vehicle, message: Any, link: Link) -> None:
    if message.target_system == 0:
        v.send(
            "PING",
            link,
            time_usec=message.time_usec,
            seq=message.seq,
            target_system=message.get_srcSystem(),
            target_component=message.get_srcComponent(),
        )


def _set_origin(v: Vehicle, message: Any, link: Link) -> None:
    """Set the origin of PX4's estimator; ArduPilot keeps an origin that it already has."""
    if message.target_system not in {0, v.system} or v.spec.autopilot == "ardupilot":
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
    if not addressed(v, message) or v.spec.autopilot != "ardupilot":
        return
    for name in ardupilot_tables.DATA_STREAMS.get(message.req_stream_id, ()):
        rate = min(message.req_message_rate, 50)
        on = message.start_stop == 1 and rate > 0
        link.stream(name, 1.0 / rate if on else None, v.now)


def _global_setpoint(v: Vehicle, message: Any, _: Link) -> None:
    """Convert a setpoint in degrees, above the sea or above home, to a local one."""
    m = message
    if not addressed(v, m) or m.coordinate_frame not in {*_ABOVE_SEA, *_ABOVE_HOME}:
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


_HANDLERS: dict[str, Callable[[Vehicle, Any, Link], None]] = {
    **missions.HANDLERS,
    **parameter_protocol.HANDLERS,
    "HEARTBEAT": _heartbeat,
    "COMMAND_LONG": _command_long,
    "COMMAND_INT": _command_int,
    "SET_MODE": _set_mode,
    "LOG_REQUEST_LIST": _log_list,
    "FILE_TRANSFER_PROTOCOL": _file_transfer,
    "TIMESYNC": _timesync,
    "PING": _ping,
    "SET_GPS_GLOBAL_ORIGIN": _set_origin,
    "VISION_POSITION_ESTIMATE": _vision,
    "ODOMETRY": _vision,
    "REQUEST_DATA_STREAM": _data_stream,
    "SETUP_SIGNING": _setup_signing,
    "SET_POSITION_TARGET_GLOBAL_INT": _global_setpoint,
}
