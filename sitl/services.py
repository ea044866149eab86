"""What every autopilot answers, whatever it flies: the handlers of `Vehicle.handle`.

Commands, message rates, logs, file transfer, time, positions, signing; missions are in
`sitl.missions`, parameters in `sitl.parameter_protocol`.
"""

import math
from collections.abc import Callable, Iterable
from heapq import heappop, heapreplace
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import common as dialect

from sitl import ardupilot_tables, missions, parameter_protocol, px4_tables, telemetry, wire
from sitl.vehicle import (
    ACCEPTED,
    DENIED,
    FAILED,
    HANDLERS,
    IN_PROGRESS,
    UNSUPPORTED,
    Command,
    Link,
    Vehicle,
    addressed,
    scaled_degrees,
)

NAMES = {number: name for name, number in wire.NUMBERS.items()}
_SAYING = {
    name: (say, wire.LAYOUTS[name].number, wire.LAYOUTS[name].seed)
    for name, say in telemetry.MESSAGES.items()
}
_LARGEST_RATE = 200.0
_SLOWEST = 2000.0
_LARGEST_ID = 65535
_FARTHEST = 1e5
_ABOVE_SEA, _ABOVE_HOME = (0, 5), (3, 6)


def emit(v: Vehicle, name: str, link: Link) -> bool:
    """Send one telemetry message now; False if there is nothing to send."""
    say, number, seed = _SAYING[name]
    body = say(v)
    if body is None:
        return False
    sender, ticks = link.sender, 0
    if sender.signer:
        ticks = wire.signing_ticks(v.around.unix_time + v.now + v.unix_offset)
    link.outgoing.append(sender.frame(number, body, seed, ticks))
    return True


def tell(v: Vehicle, *names: str) -> None:
    """Send telemetry messages now on all links, beside their streams."""
    for link in v.links:
        for name in names:
            emit(v, name, link)


def emit_due(links: Iterable[tuple[Vehicle, Link]], now: float) -> None:
    """Send what the streams of these links have due, and set their next time.

    A sixth of a rehearsal's time is spent here.
    """
    limit, saying = now + 1e-6, _SAYING
    for v, link in links:
        due = link.due
        if not due or due[0][0] > limit:
            continue
        v.now = max(v.now, now)
        intervals, outgoing, sender = link.intervals, link.outgoing, link.sender
        frame, ticks = sender.frame, 0
        if sender.signer:
            ticks = wire.signing_ticks(v.around.unix_time + v.now + v.unix_offset)
        while due:
            time, name = due[0]
            if time > limit:
                break
            interval = intervals.get(name)
            if interval is None:
                heappop(due)
                continue
            following = time + interval
            heapreplace(due, (following if following > now - interval else now, name))
            say, number, seed = saying[name]
            body = say(v)
            if body is not None:
                outgoing.append(frame(number, body, seed, ticks))


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
    number, asker = message.command, (message.get_srcSystem(), message.get_srcComponent())
    command = Command(number, p, *xy, link, *asker)
    own = COMMANDS.get(number)
    try:
        result = own(v, command) if own else v.personality.command(command)
    except (ValueError, OverflowError):
        result = DENIED
    if result is None:
        result = UNSUPPORTED
    if result != _NO_ANSWER:
        v.acknowledge(number, result, link, *asker)
        if number == dialect.MAV_CMD_DO_SET_MODE and v.spec.autopilot == "px4":
            v.acknowledge(number, result, link, *asker)


_NO_ANSWER = -1
_NOT_PX4 = frozenset({"EKF_STATUS_REPORT", "HEARTBEAT"})
"""Messages whose rate cannot be set: PX4's heartbeats come once a second."""
_NOT_ARDUPILOT = frozenset(
    {"COMPONENT_METADATA", "CURRENT_EVENT_SEQUENCE", "CURRENT_MODE", "LINK_NODE_STATUS", "PING",
     "TIMESYNC", "TIME_ESTIMATE_TO_TARGET"}
)  # fmt: skip
_INJECT_FAILURE = 420


def _request_message(v: Vehicle, command: Command) -> int:
    """PX4 denies what it has nothing to say of, and answers after it has said the rest.

    ArduPilot answers first, and takes the request where it then says nothing.
    """
    name = str(NAMES.get(int(command.p[0])))
    known = name in telemetry.MESSAGES
    if v.spec.autopilot == "px4":
        if name == "GPS_GLOBAL_ORIGIN":
            v.origin_told_at = v.now
        return ACCEPTED if known and emit(v, name, command.link) else DENIED
    if not known or name in _NOT_ARDUPILOT:
        return FAILED
    v.acknowledge(command.number, ACCEPTED, command.link, command.system, command.component)
    emit(v, name, command.link)
    return _NO_ANSWER


def _set_interval(v: Vehicle, command: Command) -> int:
    name = NAMES.get(int(command.p[0]))
    px4 = v.spec.autopilot == "px4"
    foreign = name in (_NOT_PX4 if px4 else _NOT_ARDUPILOT)
    if foreign or name not in telemetry.MESSAGES or not math.isfinite(command.p[1]):
        return FAILED if px4 else DENIED
    if command.p[1] < 0:
        command.link.stream(name, None, v.now)
    elif command.p[1] == 0:
        rate = default_streams(v, command.link).get(name)
        command.link.stream(name, 1.0 / rate if rate else None, v.now)
    else:
        command.link.stream(
            name, min(max(command.p[1] * 1e-6, 1.0 / _LARGEST_RATE), _SLOWEST), v.now
        )
    return ACCEPTED


def _get_interval(v: Vehicle, command: Command) -> int:
    number = int(command.p[0])
    if not 0 <= number <= _LARGEST_ID:
        return DENIED
    interval = command.link.intervals.get(NAMES.get(number, ""))
    microseconds = round(interval * 1e6) if interval else -1
    v.send("MESSAGE_INTERVAL", command.link, message_id=number, interval_us=microseconds)
    return ACCEPTED


def _capabilities(v: Vehicle, command: Command) -> int:
    emit(v, "AUTOPILOT_VERSION", command.link)
    return ACCEPTED


def _gripper(v: Vehicle, command: Command) -> int:
    enabled = "PD_GRIPPER_EN" if v.spec.autopilot == "px4" else "GRIP_ENABLE"
    if v.spec.gripper != "mavlink" or not v.parameters[enabled]:
        return UNSUPPORTED
    if command.p[1] not in (0.0, 1.0):
        return DENIED
    delay = float(v.rng.uniform(0.4, 0.7))
    v.start_gripper(command.p[1] == 1.0, command.link, command.system, command.component, delay)
    return IN_PROGRESS if v.spec.autopilot == "px4" else _NO_ANSWER


def _home(v: Vehicle, command: Command) -> int:
    return ACCEPTED if emit(v, "HOME_POSITION", command.link) else DENIED


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
        x, y = v.around.geodesy.metres(command.p[4], command.p[5])
        z = command.p[6] - v.around.geodesy.altitude
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
        return DENIED
    v.later.append((v.now + 0.2, v.reboot))
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


def default_streams(v: Vehicle, link: Link) -> dict[str, float]:
    """Rates (Hz) that this autopilot sends on this kind of link without being asked."""
    table = px4_tables.STREAMS if v.spec.autopilot == "px4" else ardupilot_tables.STREAMS
    return table[link.kind]


def _set_mode(v: Vehicle, message: Any, link: Link) -> None:
    if message.target_system == v.system:
        result = v.personality.set_mode(message.base_mode, message.custom_mode)
        v.acknowledge(
            dialect.MAVLINK_MSG_ID_SET_MODE,
            result,
            link,
            message.get_srcSystem(),
            message.get_srcComponent(),
        )


# Logs, files, time, position from outside, signing.


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
    """PX4 moves its origin when told to; ArduPilot keeps one that it has."""
    if message.target_system not in {0, v.system} or v.spec.autopilot == "ardupilot":
        return
    if abs(message.latitude) > 900_000_000 or abs(message.longitude) > 1_800_000_000:
        return
    x, y = v.around.geodesy.metres(message.latitude * 1e-7, message.longitude * 1e-7)
    z = message.altitude * 1e-3 - v.around.geodesy.altitude
    if max(abs(x), abs(y), abs(z)) < _FARTHEST:
        v.move_origin([x, y, z])
        emit(v, "GPS_GLOBAL_ORIGIN", link)


def _vision(v: Vehicle, message: Any, _: Link) -> None:
    """Indoors the estimator follows what motion capture says (local NED of the shared frame).

    Once it has, it misses it when it stops (`Emulator`); before, it knows its place by itself.
    """
    place = (message.x, message.y, message.z)
    if not v.around.indoor or not all(map(math.isfinite, place)):
        return
    told = np.array(v.to_world(*place))
    correction = told - v.bodies.position[v.index]
    if float(np.linalg.norm(correction)) < 5.0:
        v.bodies.bias[v.index] = correction
        v.bodies.touch()
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
    """A setpoint in degrees, above the sea or above home, becomes a local one."""
    m = message
    if not addressed(v, m) or m.coordinate_frame not in {*_ABOVE_SEA, *_ABOVE_HOME}:
        return
    if not v.global_valid or v.home is None:
        return
    x, y = v.around.geodesy.metres(m.lat_int * 1e-7, m.lon_int * 1e-7)
    above_sea = m.coordinate_frame in _ABOVE_SEA
    z = m.alt + (-v.around.geodesy.altitude if above_sea else float(v.home[2]))
    local = v.to_local(np.array([x, y, z]))
    if not m.type_mask & 7 and max(map(abs, local[:2])) > _FARTHEST:
        return
    v.personality.setpoint(
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


HANDLERS.update(missions.HANDLERS)
HANDLERS.update(parameter_protocol.HANDLERS)
HANDLERS.update(
    {
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
)
