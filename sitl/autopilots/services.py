"""What an autopilot does besides flying: what is due, and handlers of ground stations' messages.

Heartbeats, commands, streams, logs, file transfer, time, external positions, signing; missions are
in `sitl.protocol.missions`, parameters in `sitl.protocol.parameter_protocol`.

Commands that every autopilot executes, beside its own commands for flight.
"""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import common as dialect

from sitl.autopilots import telemetry
from sitl.autopilots.ardupilot import DATA_STREAMS
from sitl.autopilots.streams import default_streams, send_message
from sitl.protocol import missions, parameter_protocol, wire
from sitl.protocol.gripper import GripperRequest
from sitl.protocol.links import ACCEPTED, DENIED, FAILED, IN_PROGRESS, UNSUPPORTED, Command, Link
from sitl.protocol.vehicle import Vehicle, addressed, scaled_degrees

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
    if v.spec.autopilot == "px4":
        if name == "GPS_GLOBAL_ORIGIN":
            v.origin_announced_at = v.now
        return ACCEPTED if known and send_message(v, name, command.link) else DENIED
    if not known or name in _NOT_ARDUPILOT:
        return FAILED
    v.acknowledge(command.number, ACCEPTED, command.link, command.system, command.component)
    send_message(v, name, command.link)
    return NO_ACK


def _set_interval(v: Vehicle, command: Command) -> int:
    name = _NAMES.get(int(command.p[0]))
    px4 = v.spec.autopilot == "px4"
    unsupported = name in (_NOT_PX4 if px4 else _NOT_ARDUPILOT)
    if unsupported or name not in telemetry.MESSAGES or not math.isfinite(command.p[1]):
        return FAILED if px4 else DENIED
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
    enabled = "PD_GRIPPER_EN" if v.spec.autopilot == "px4" else "GRIP_ENABLE"
    if v.spec.gripper != "mavlink" or not v.parameters[enabled]:
        return UNSUPPORTED
    if command.p[1] not in (0.0, 1.0):
        return DENIED
    delay = float(v.rng.uniform(0.4, 0.7))
    sender = command.link, command.system, command.component
    v.gripper.start(GripperRequest(v.now + delay, command.p[1] == 1.0, *sender))
    return IN_PROGRESS if v.spec.autopilot == "px4" else NO_ACK


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
    if v.spec.autopilot == "px4" and not v.parameters["SYS_FAILURE_EN"]:
        return DENIED
    numbers = [int(number) for number in command.p[:3]]
    known = v.inject is not None and v.inject(numbers[0], numbers[1], numbers[2])
    return ACCEPTED if known else UNSUPPORTED


def _reboot(v: Vehicle, command: Command) -> int:
    if command.p[0] not in (1.0, 3.0):
        return ACCEPTED if command.p[0] == 0.0 else DENIED
    if v.armed:
        return DENIED if v.spec.autopilot == "px4" else FAILED
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
    for name in DATA_STREAMS.get(message.req_stream_id, ()):
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
