"""Commands that every autopilot executes, beside its own commands for flight."""

import math
from collections.abc import Callable

import numpy as np
from pymavlink.dialects.v20 import common as dialect

from sitl.autopilots import telemetry
from sitl.autopilots.streams import default_streams, send_message
from sitl.protocol import wire
from sitl.protocol.gripper import GripperRequest
from sitl.protocol.links import ACCEPTED, DENIED, FAILED, IN_PROGRESS, UNSUPPORTED, Command
from sitl.protocol.vehicle import Vehicle

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
