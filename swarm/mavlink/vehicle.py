"""One vehicle as the ground station uses it, sans-IO: packets in, events and messages out.

A handler for each message changes the vehicle's state; :mod:`swarm.mavlink.autopilots` lists the
differences between autopilots, :mod:`swarm.mavlink.commands` tracks every command until it is done.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Final

import numpy as np
import numpy.typing as npt
from pymavlink.dialects.v20 import common

from swarm.errors import VehicleError, printable
from swarm.mavlink.autopilots import MANUAL_MODES, Autopilot, Mode, flying_autopilot
from swarm.mavlink.commands import STATE_TIMEOUT, Command, CommandQueue
from swarm.mavlink.fence import Fence
from swarm.mavlink.frames import Origin, to_local
from swarm.mavlink.packets import CURRENT_MODE, PARAM_VALUE, Message, Packet, message_name
from swarm.mavlink.parameters import Parameters
from swarm.mavlink.telemetry_table import (
    ATTITUDE_TIME,
    BOOT_TIME,
    DIRECT,
    DOUBTED,
    GLOBAL_TIME,
    LATE,
    STAMPED,
    ReportedMotion,
    Reports,
    TelemetryTable,
    Vector,
    count_packet,
    follows,
    take_position_time,
    take_time,
)

_CUSTOM = int(common.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED)
_KILL = 21196.0
_HEARTBEAT, _TEXT = int(common.MAVLINK_MSG_ID_HEARTBEAT), int(common.MAVLINK_MSG_ID_STATUSTEXT)
TAKEOFF_TIMEOUT = 15.0
"""Seconds from the acknowledgement of a take-off until it flies: motors spool up first."""
_ECHOES = frozenset({int(common.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED)})
"""Messages with the autopilot's own setpoints: sent once it is armed, as often as positions."""


ON_GROUND = int(common.MAV_LANDED_STATE_ON_GROUND)
IN_AIR = int(common.MAV_LANDED_STATE_IN_AIR)
TAKING_OFF = int(common.MAV_LANDED_STATE_TAKEOFF)


@dataclass
class TextChunks:
    """The chunks of a STATUSTEXT that have arrived, by their place in it, and when they began."""

    id: int
    severity: int
    since: float
    chunks: dict[int, bytes] = field(default_factory=dict)


@dataclass(frozen=True)
class VehicleEvent:
    """An event of a vehicle.

    ``kind`` is one of discovered, armed, disarmed, mode, landed, airborne, text, text warning, text
    error (by its severity), origin, rebooted, done, failed; ``subject`` is the name of the command
    or mode.
    """

    kind: str
    message: str
    subject: str = ""


@dataclass
class Vehicle(Reports, ReportedMotion):
    """The latest reported state of one vehicle, its command queue, its parameters and its fence.

    The vehicle is its autopilot: ``component`` is chosen by a HEARTBEAT of an autopilot.

    Times are the caller's ``now`` in seconds. Positions are NED in metres in the vehicle's own
    frame, angles in radians, accuracies and ``height_difference`` in metres, ``battery`` from 0
    to 1. NaN and None mean "not received".

    - ``telemetry``, ``row``: the table with the frequent values, and this vehicle's row in it.
    - ``asked_at``: when the first clock request was sent that has not been answered; infinite
      without any, or where the vehicle has never answered one.
    - ``position_healthy``, ``compass_healthy``: False if SYS_STATUS reports an unhealthy position
      estimate, or a compass that is used and unhealthy. ``compass_present``: False if it has none.
    - ``height_difference``: satellite altitude minus altitude of the local position, averaged;
      ``height_average`` holds when the average began, its latest sample, and its value.
    - ``origin_mismatches``: consecutive samples in which global and local position disagree.
    - ``order``: of the message that is being read (:mod:`swarm.mavlink.telemetry_table`).
    - ``other_clock``: boot times that do not follow the vehicle's: when its last position had come
      by then, when they began, the last of them in ms, and how many.
    - ``second_clock``: one request for the time was answered with two times.
    - ``text_chunks``, ``said_texts``: the text that is arriving, and the last one, by component.
    - ``unhandled``: number of packets by message number that no handler reads.
    """

    system: int
    autopilot: Autopilot | None = None
    telemetry: TelemetryTable = field(default_factory=lambda: TelemetryTable(1), repr=False)
    row: int = 0

    heartbeat_at: float = -math.inf
    custom_mode: int = -1
    system_status: int = 0
    landed_state: int = 0
    origin: Origin | None = None
    next_origin_request: float = -math.inf
    global_position: Origin | None = None
    voltage: float = math.nan
    ready: bool | None = None
    compass_present: bool = True
    satellites: int = -1
    gps_time: int = -1
    horizontal_accuracy: float = math.nan
    height_average: Vector = (math.nan, math.nan, math.nan)
    round_trip: float = math.nan
    latest_round_trip: float = math.nan
    clock_offset: float = math.nan
    latest_clock_offset: float = math.nan
    timesync_at: float = -math.inf
    timesync_sent: float = -math.inf
    second_clock: bool = False
    other_clock: tuple[float, float, float, int] = (math.nan, math.nan, -1.0, 0)
    unhandled: dict[int, int] = field(default_factory=dict)

    commands: CommandQueue = field(init=False)
    parameters: Parameters = field(default_factory=Parameters)
    fence: Fence = field(default_factory=Fence)
    texts: list[tuple[float, int, str]] = field(default_factory=list)
    text_chunks: dict[int, TextChunks] = field(default_factory=dict)
    said_texts: dict[int, TextChunks] = field(default_factory=dict)
    order: int = DIRECT
    origin_mismatches: int = 0
    _doubted: dict[str, object] = field(default_factory=dict)
    _events: list[VehicleEvent] = field(default_factory=list)
    _stopped_streams: set[int] = field(default_factory=set)

    def __post_init__(self) -> None:
        self.commands = CommandQueue(self.system, self.component)

    def report(self, kind: str, message: str, subject: str = "") -> None:
        """Add an event."""
        self._events.append(VehicleEvent(kind, message, subject))

    def take_events(self) -> list[VehicleEvent]:
        """Return the events since the last call."""
        events, self._events = self._events, []
        return events

    @property
    def values(self) -> npt.NDArray[np.float64]:
        """This vehicle's row (WIDTH,) of the table."""
        row: npt.NDArray[np.float64] = self.telemetry.values[self.row]
        return row

    def believes(self, name: str, value: object) -> bool:
        """Return whether a value in the message that is being read counts; it has no boot time.

        Its packet directly follows the one before; or it repeats what the message said before, and
        is not known to be late.
        """
        if self.order == LATE:
            return False
        repeated = name in self._doubted and self._doubted[name] == value
        self._doubted[name] = value
        return self.order == DIRECT or repeated

    def recent_warnings(self, now: float, within: float = 5.0) -> str:
        """Return the texts of severity WARNING or higher of the last seconds, joined."""
        texts = [
            text
            for time, severity, text in self.texts[-8:]
            if now - time <= within and severity <= common.MAV_SEVERITY_WARNING
        ]
        return "; ".join(dict.fromkeys(texts))

    @property
    def mode(self) -> str:
        """The name of the mode, "unknown" before the first heartbeat."""
        if self.autopilot is None or self.custom_mode < 0:
            return "unknown"
        return self.autopilot.mode_name(self.custom_mode)

    def in_mode(self, mode: Mode) -> bool:
        """Return whether the latest heartbeat showed this mode."""
        return self.autopilot is not None and self.custom_mode == self.autopilot.custom_mode(mode)

    @property
    def in_manual_mode(self) -> bool:
        """Whether a pilot's sticks fly the vehicle in its mode."""
        return self.mode in MANUAL_MODES

    @property
    def needs_takeoff_command(self) -> bool:
        """Whether the autopilot requires a take-off command before it accepts setpoints."""
        return self.autopilot is not None and self.autopilot.needs_takeoff_command

    @property
    def on_ground(self) -> bool:
        """Whether the vehicle reports that it has landed."""
        return self.landed_state == ON_GROUND

    @property
    def airborne(self) -> bool:
        """Whether the vehicle reports that it flies."""
        return self.landed_state in {IN_AIR, TAKING_OFF}

    def __copy__(self) -> "Vehicle":
        twin = object.__new__(type(self))
        twin.__dict__.update(self.__dict__)
        twin.telemetry, twin.row = self.telemetry.copy_row(self.row), 0
        return twin

    def receive(self, packet: Packet, now: float, link: int = 0) -> None:
        """Count and read a packet with this vehicle's system id, from a link by its number."""
        number, _, component, sequence, message = packet
        order = DOUBTED
        if component == self.component:
            fresh = False
            if number in STAMPED and message is not None:
                last = float(self.values[STAMPED[number]])
                fresh = follows(float(message.time_boot_ms), last)
            order = count_packet(self.telemetry.arrays, self.row, link, sequence, now, fresh)
        self.read(number, component, message, now, order)

    def read(
        self, number: int, component: int, message: Message | None, now: float, order: int
    ) -> None:
        """Read the message of a packet that has been counted.

        Of other components than the autopilot's, only texts are read.
        """
        if number == _HEARTBEAT and message is not None and component != self.component:
            self._choose(component, message)
        if self.text_chunks:
            end_texts(self, now)
        if component != self.component:
            if number == _TEXT and message is not None:
                read_text(self, message, now, component)
            return
        handler = HANDLERS.get(number)
        if handler is None or message is None:
            self.unhandled[number] = self.unhandled.get(number, 0) + 1
        else:
            self.order = order
            handler(self, message, now)

    def _choose(self, component: int, heartbeat: Message) -> None:
        """Take the component of a heartbeat for the vehicle, if it is its autopilot's.

        The first one stays, except for MAVLink's own id of autopilots while nothing is armed.
        """
        first = self.heartbeat_at == -math.inf
        preferred = component == common.MAV_COMP_ID_AUTOPILOT1 and not self.armed
        if (first or preferred) and flying_autopilot(component, heartbeat) is not None:
            self.component = self.commands.component = component

    def note_clock_request(self, now: float) -> None:
        """Note that a clock request was sent, which a vehicle that has answered any answers."""
        if math.isinf(self.asked_at) and math.isfinite(self.timesync_at):
            self.asked_at = now

    @property
    def busy(self) -> bool:
        """Whether there may be messages to send."""
        return self.commands.busy or self.parameters.busy or self.fence.busy

    def tick(self, now: float) -> list[Message]:
        """Return the messages to send now."""
        if not self.busy:
            return []
        messages, results = self.commands.tick(now)
        if self.parameters.busy and self.autopilot is not None:
            messages += self.parameters.tick(
                self.system, self.component, bytewise=self.autopilot.bytewise, now=now
            )
        if self.fence.busy:
            messages += self.fence.tick(self.system, self.component, now)
        for result in results:
            name = result.command.name
            if result.succeeded:
                self.report("done", f"{name}: done after {result.after:.2f} s", name)
            else:
                warnings = self.recent_warnings(now)
                text = f"{name}: {result.reason}" + (f" ({warnings})" if warnings else "")
                self.report("failed", text, name)
        return messages

    def set_mode(self, mode: Mode) -> None:
        """Command a mode; done when HEARTBEAT shows it."""
        if self.autopilot is None:
            raise VehicleError(f"system {self.system}: unknown autopilot, so no mode can be set")
        main, sub = self.autopilot.modes[mode]
        self._command(
            f"mode {mode}",
            common.MAV_CMD_DO_SET_MODE,
            _CUSTOM,
            main,
            sub,
            reached=lambda: self.in_mode(mode),
            retry_for=5.0,
        )

    def set_custom_mode(self, custom_mode: int) -> None:
        """Command a mode by its value in HEARTBEAT; done when HEARTBEAT shows it."""
        packed = self.autopilot is None or self.autopilot.name == "px4"
        main, sub = (custom_mode >> 16 & 0xFF, custom_mode >> 24) if packed else (custom_mode, 0)
        self._command(
            "mode before",
            common.MAV_CMD_DO_SET_MODE,
            _CUSTOM,
            main,
            sub,
            reached=lambda: self.custom_mode == custom_mode,
        )

    def arm(self) -> None:
        """Command arming, never by force; done when HEARTBEAT shows it."""
        self._command(
            "arm",
            common.MAV_CMD_COMPONENT_ARM_DISARM,
            1,
            reached=lambda: self.armed,
            retry_for=5.0,
        )

    def disarm(self) -> None:
        """Command disarming, which an autopilot accepts only on the ground."""
        self._command(
            "disarm", common.MAV_CMD_COMPONENT_ARM_DISARM, 0, reached=lambda: not self.armed
        )

    def kill(self) -> None:
        """Stop the motors at once, also in the air."""
        self.commands.clear()
        self._command(
            "kill", common.MAV_CMD_COMPONENT_ARM_DISARM, 0, _KILL, reached=lambda: not self.armed
        )

    def take_off(self, height: float) -> None:
        """Command a take-off to a height in metres above the present position.

        Done when the vehicle reports that it flies, if it sends EXTENDED_SYS_STATE: a command that
        is repeated after a lost acknowledgement is rejected in the air.
        """
        self._command(
            "takeoff",
            common.MAV_CMD_NAV_TAKEOFF,
            *(0, 0, 0, 0, 0, 0, height),
            reached=(lambda: self.airborne) if self.landed_state else None,
            state_timeout=TAKEOFF_TIMEOUT,
        )

    def grip(self, *, closed: bool) -> None:
        """Close or open the gripper."""
        action = common.GRIPPER_ACTION_GRAB if closed else common.GRIPPER_ACTION_RELEASE
        self._command("grab" if closed else "release", common.MAV_CMD_DO_GRIPPER, 1, action)

    def request_interval(self, message: int, rate: float) -> None:
        """Request a message at a rate in Hz."""
        self._set_interval(message, 1e6 / rate)

    def stop_unused_streams(self, since: float, now: float) -> None:
        """Stop messages that arrive more than three times a second and have no handler.

        ``since`` is the time of the first packet. The link is then free for what the flight needs.
        Messages that are sent only while armed are stopped in advance.
        """
        often = {message for message, n in self.unhandled.items() if n > 3.0 * (now - since)}
        for message in sorted((often | _ECHOES) - self._stopped_streams):
            self._stopped_streams.add(message)
            self._set_interval(message, -1.0)

    def restore_streams(self) -> None:
        """Restart what :meth:`stop_unused_streams` stopped, at the autopilot's default rates."""
        for message in self._stopped_streams:
            self._set_interval(message, 0.0)
        self._stopped_streams.clear()

    def _set_interval(self, message: int, microseconds: float) -> None:
        name = message_name(message)
        command = common.MAV_CMD_SET_MESSAGE_INTERVAL
        self._command(f"interval of {name}", command, message, microseconds)

    def request_message(self, message: int, reached: Callable[[], bool] | None = None) -> None:
        """Request a message once."""
        name = message_name(message)
        self._command(name, common.MAV_CMD_REQUEST_MESSAGE, message, reached=reached)

    def _command(
        self,
        name: str,
        number: int,
        *parameters: float,
        reached: Callable[[], bool] | None = None,
        state_timeout: float = STATE_TIMEOUT,
        retry_for: float = 0.0,
    ) -> None:
        if self.commands.contains(name):
            return
        seven = (*parameters, *[0.0] * (7 - len(parameters)))
        self.commands.add(Command(name, int(number), seven, reached, state_timeout, retry_for))


_ARMED = int(common.MAV_MODE_FLAG_SAFETY_ARMED)
_PREARM = int(common.MAV_SYS_STATUS_PREARM_CHECK)
_POSITION_SENSORS = int(
    common.MAV_SYS_STATUS_AHRS | common.MAV_SYS_STATUS_SENSOR_XY_POSITION_CONTROL
)
_COMPASS = int(common.MAV_SYS_STATUS_SENSOR_3D_MAG)
_ORIGIN_MOVED = 0.05
_MAX_POSITION_AGE = 0.3
_MAX_VERTICAL_SPEED = 1.0
"""m/s: below it, a receiver's height is at most 0.2 m behind: receivers are up to 0.2 s late; PX4
assumes 0.11 s (EKF2_GPS_DELAY). The least drift that counts is 0.3 m."""
_HEIGHT_DRIFT = 0.2
"""m/s: a receiver with an accuracy of one metre is averaged over five seconds."""
_MAX_MISMATCH = 1.0
_MISMATCH_SAMPLES = 3
_REBOOT_TIME = 0.5
"""Seconds for which no other clock than the new one must be received after a reboot."""
_CLOCK_TOLERANCE = 2.0
"""Seconds by which packets and clocks may be late: two clocks differ by more."""
_TEXT_LENGTH = 50
_TEXT_TIME = 1.0
"""Seconds within which all chunks of a text arrive: they are sent one after the other."""
_LOST_CHUNKS = "[…]".encode()


def _heartbeat(vehicle: Vehicle, message: Message, now: float) -> None:
    kind = flying_autopilot(vehicle.component, message)
    if kind is None:
        return
    vehicle.autopilot = vehicle.autopilot or kind
    first = vehicle.heartbeat_at == -math.inf
    vehicle.heartbeat_at = vehicle.received_at = now
    armed = bool(message.base_mode & _ARMED)
    if first:
        vehicle.report("discovered", f"discovered: {vehicle.autopilot.name}")
    if not vehicle.believes("heartbeat", (armed, message.custom_mode)):
        return
    vehicle.system_status = message.system_status
    _set_mode(vehicle, message.custom_mode, now)
    if armed != vehicle.armed:
        vehicle.armed = armed
        vehicle.report("armed" if armed else "disarmed", "armed" if armed else "disarmed")


def _current_mode(vehicle: Vehicle, message: Message, now: float) -> None:
    if vehicle.believes("mode", message.custom_mode):
        _set_mode(vehicle, message.custom_mode, now)


def _set_mode(vehicle: Vehicle, custom_mode: int, now: float) -> None:
    vehicle.mode_at = now
    if custom_mode != vehicle.custom_mode:
        vehicle.custom_mode = custom_mode
        vehicle.report("mode", f"mode {vehicle.mode}", vehicle.mode)


def _local_position(vehicle: Vehicle, message: Message, now: float) -> None:
    row, boot_ms = vehicle.values, float(message.time_boot_ms)
    if not take_time(row, BOOT_TIME, boot_ms):
        if not _rebooted(vehicle, boot_ms, now):
            return
        row[[BOOT_TIME, ATTITUDE_TIME, GLOBAL_TIME]] = -1.0
        take_time(row, BOOT_TIME, boot_ms)
        vehicle.report("rebooted", "rebooted: its clock went back")
    take_position_time(row, boot_ms, now)
    vehicle.position = (message.x, message.y, message.z)
    vehicle.velocity = (message.vx, message.vy, message.vz)


def _rebooted(vehicle: Vehicle, boot_ms: float, now: float) -> bool:
    """Return whether positions of another clock show that the vehicle has started anew.

    Late ones do not: positions of the known clock arrive between them, or they tell a longer time
    since boot than has passed since the last of those.
    """
    position_at, since, last, count = vehicle.other_clock
    if position_at != vehicle.position_at or not follows(boot_ms, last):
        since, count = now, 0
    vehicle.other_clock = vehicle.position_at, since, boot_ms, count + 1
    longest = now - vehicle.position_at + _CLOCK_TOLERANCE
    return count >= 2 and now - since >= _REBOOT_TIME and boot_ms * 1e-3 <= longest


def _global_position(vehicle: Vehicle, message: Message, now: float) -> None:
    if not take_time(vehicle.values, GLOBAL_TIME, float(message.time_boot_ms)):
        return
    position = Origin(message.lat * 1e-7, message.lon * 1e-7, message.alt * 1e-3)
    vehicle.global_position = position
    _compare_positions(vehicle, position, now)


def _gps(vehicle: Vehicle, message: Message, now: float) -> None:
    if vehicle.order != DIRECT and message.time_usec <= vehicle.gps_time:
        return
    vehicle.gps_time = message.time_usec
    vehicle.fix_type, vehicle.satellites = message.fix_type, message.satellites_visible
    vehicle.horizontal_accuracy = message.h_acc * 1e-3 if message.h_acc else math.nan
    vehicle.vertical_accuracy = message.v_acc * 1e-3 if message.v_acc else math.nan
    if vehicle.origin is None or message.fix_type < 3:
        return
    age, sinking = now - vehicle.position_at, vehicle.velocity[2]
    if age < _MAX_POSITION_AGE and abs(sinking) < _MAX_VERTICAL_SPEED:
        height = vehicle.origin.altitude - vehicle.position[2] - age * sinking
        _average_height(vehicle, message.alt * 1e-3 - height, now)


def _average_height(vehicle: Vehicle, difference: float, now: float) -> None:
    """Average the satellite height, for longer if its stated accuracy is lower.

    The altitude of a poor receiver, and of PX4's simulated one, jumps by half a metre.
    """
    accuracy = vehicle.vertical_accuracy
    window = 0.0 if math.isnan(accuracy) else accuracy / _HEIGHT_DRIFT
    since, at, mean = vehicle.height_average
    if math.isnan(mean):
        since, mean = now, difference
    else:
        step = max(now - at, 1e-3)
        mean += (difference - mean) * step / (min(window, at - since) + step)
    vehicle.height_average = since, now, mean
    vehicle.height_difference = mean if now - since >= window else math.nan


def _compare_positions(vehicle: Vehicle, position: Origin, now: float) -> None:
    """Compare the global with the local position: both must refer to the same origin.

    A reset of the estimator moves one against the other. A single sample may be out of step.
    """
    age = now - vehicle.position_at
    if vehicle.origin is None or vehicle.autopilot is None or not age < _MAX_POSITION_AGE:
        return
    expected = to_local(vehicle.autopilot.name, vehicle.origin, position)
    local, velocity = vehicle.position, vehicle.velocity
    error = [expected[k] - local[k] - age * velocity[k] for k in (0, 1)]
    distance = math.hypot(*error)
    mismatch = distance > _MAX_MISMATCH
    vehicle.origin_mismatches = vehicle.origin_mismatches + 1 if mismatch else 0
    if vehicle.origin_mismatches == _MISMATCH_SAMPLES:
        vehicle.report("origin", f"its local and global positions are {distance:.1f} m apart")


def _attitude(vehicle: Vehicle, message: Message, _now: float) -> None:
    if take_time(vehicle.values, ATTITUDE_TIME, float(message.time_boot_ms)):
        vehicle.attitude = (message.roll, message.pitch, message.yaw)


def _global_origin(vehicle: Vehicle, message: Message, _now: float) -> None:
    # messages with different sequence numbers are never equal
    if not vehicle.believes("origin", (message.latitude, message.longitude, message.altitude)):
        return
    origin = Origin(message.latitude * 1e-7, message.longitude * 1e-7, message.altitude * 1e-3)
    if vehicle.origin is not None and _distance(origin, vehicle.origin) > _ORIGIN_MOVED:
        moved = _distance(origin, vehicle.origin)
        vehicle.report("origin", f"its estimator's origin moved by {moved:.2f} m")
    vehicle.origin = origin


def _extended_state(vehicle: Vehicle, message: Message, _now: float) -> None:
    if not vehicle.believes("landed", message.landed_state):
        return
    before, vehicle.landed_state = vehicle.landed_state, message.landed_state
    if before != vehicle.landed_state and vehicle.landed_state == ON_GROUND:
        vehicle.report("landed", "on the ground")
    elif before != vehicle.landed_state and vehicle.landed_state == IN_AIR:
        vehicle.report("airborne", "in the air")


def _system_status(vehicle: Vehicle, message: Message, _now: float) -> None:
    seen = _PREARM | _POSITION_SENSORS | _COMPASS
    health = message.onboard_control_sensors_health & seen
    if not vehicle.believes("health", health):
        return
    vehicle.battery = (
        message.battery_remaining / 100.0 if message.battery_remaining >= 0 else math.nan
    )
    vehicle.voltage = message.voltage_battery / 1000.0
    enabled = message.onboard_control_sensors_enabled & _POSITION_SENSORS
    vehicle.position_healthy = not enabled & ~message.onboard_control_sensors_health
    vehicle.compass_present = bool(message.onboard_control_sensors_present & _COMPASS)
    vehicle.compass_healthy = not message.onboard_control_sensors_enabled & ~health & _COMPASS
    autopilot = vehicle.autopilot
    health_only = autopilot is not None and not autopilot.lists_prearm_as_present
    if health_only or message.onboard_control_sensors_present & _PREARM:
        vehicle.ready = bool(message.onboard_control_sensors_health & _PREARM)


def _status_text(vehicle: Vehicle, message: Message, now: float) -> None:
    read_text(vehicle, message, now, vehicle.component)


def read_text(vehicle: Vehicle, message: Message, now: float, component: int) -> None:
    """Read a STATUSTEXT of a component with the vehicle's system id.

    Chunks are joined as bytes, since a character may have several. A chunk with less than 50 bytes
    is the last. Id 0 stands for a text of one chunk; but PX4 counts its ids from 0, so a full chunk
    of that id may have a successor as well.
    """
    raw, place = message.text.split(b"\0", 1)[0], message.chunk_seq
    said = vehicle.said_texts.get(component)
    if said is not None and message.id == said.id != 0 and said.chunks.get(place) == raw:
        return
    text = vehicle.text_chunks.get(component)
    if text is not None and (text.id != message.id or text.chunks.get(place, raw) != raw):
        _end_text(vehicle, component, now)
        text = None
    if text is None:
        text = vehicle.text_chunks[component] = TextChunks(message.id, message.severity, now)
    text.chunks[place] = raw
    last = max(text.chunks)
    if len(text.chunks) == last + 1 and len(text.chunks[last]) < _TEXT_LENGTH:
        _end_text(vehicle, component, now)


def end_texts(vehicle: Vehicle, now: float) -> None:
    """Report the texts whose further chunks have not arrived in time."""
    late = [k for k, text in vehicle.text_chunks.items() if now - text.since > _TEXT_TIME]
    for component in late:
        _end_text(vehicle, component, now)


def _end_text(vehicle: Vehicle, component: int, now: float) -> None:
    """Report a text with the chunks that have arrived, and a mark in the place of lost ones."""
    ended = vehicle.said_texts[component] = vehicle.text_chunks.pop(component)
    joined, following = b"", 0
    for place, raw in sorted(ended.chunks.items()):
        joined += (_LOST_CHUNKS if place > following else b"") + raw
        following = place + 1
    if ended.id and len(ended.chunks[following - 1]) >= _TEXT_LENGTH:
        joined += _LOST_CHUNKS
    text = printable(joined.decode("utf-8", "replace")).strip()
    if not text:
        return
    if component == vehicle.component:
        vehicle.texts = [*vehicle.texts[-31:], (now, ended.severity, text)]
    else:
        text = f"component {component}: {text}"
    vehicle.report(_text_kind(ended.severity), text)


def _text_kind(severity: int) -> str:
    if severity <= common.MAV_SEVERITY_ERROR:
        return "text error"
    return "text warning" if severity == common.MAV_SEVERITY_WARNING else "text"


def _command_ack(vehicle: Vehicle, message: Message, now: float) -> None:
    if vehicle.order != LATE:
        vehicle.commands.acknowledge(message, now)


def _timesync(vehicle: Vehicle, message: Message, now: float) -> None:
    if message.tc1 == 0 or message.ts1 <= 0:
        return
    sent = message.ts1 * 1e-9
    if not 0.0 <= now - sent < 10.0 or sent < vehicle.timesync_sent:
        return
    round_trip, offset = now - sent, message.tc1 * 1e-9 - (sent + now) / 2.0
    if sent == vehicle.timesync_sent:
        apart = abs(offset - vehicle.latest_clock_offset)
        vehicle.second_clock |= apart > _CLOCK_TOLERANCE + round_trip / 2.0
        return
    vehicle.timesync_at, vehicle.timesync_sent, vehicle.asked_at = now, sent, math.inf
    vehicle.latest_round_trip, vehicle.latest_clock_offset = round_trip, offset
    if not vehicle.round_trip <= round_trip:
        vehicle.clock_offset = vehicle.latest_clock_offset
        vehicle.round_trip = round_trip


def _distance(first: Origin, second: Origin) -> float:
    """Return the approximate distance in metres between two places that are close together."""
    north = math.radians(first.latitude - second.latitude) * 6_371_000.0
    east = math.radians(first.longitude - second.longitude) * 6_371_000.0
    east *= math.cos(math.radians(first.latitude))
    return math.hypot(north, east, first.altitude - second.altitude)


def _parameter(vehicle: Vehicle, message: Message, now: float) -> None:
    if vehicle.autopilot is not None:
        bytewise = vehicle.autopilot.bytewise
        vehicle.parameters.receive(message, bytewise=bytewise, now=now)


def _to_fence(
    process: Callable[[Fence, Message], None],
) -> Callable[[Vehicle, Message, float], None]:
    return lambda vehicle, message, _: process(vehicle.fence, message)


HANDLERS: Final[Mapping[int, Callable[[Vehicle, Message, float], None]]] = {
    int(common.MAVLINK_MSG_ID_HEARTBEAT): _heartbeat,
    CURRENT_MODE: _current_mode,
    int(common.MAVLINK_MSG_ID_LOCAL_POSITION_NED): _local_position,
    int(common.MAVLINK_MSG_ID_GLOBAL_POSITION_INT): _global_position,
    int(common.MAVLINK_MSG_ID_GPS_RAW_INT): _gps,
    int(common.MAVLINK_MSG_ID_ATTITUDE): _attitude,
    int(common.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN): _global_origin,
    int(common.MAVLINK_MSG_ID_EXTENDED_SYS_STATE): _extended_state,
    int(common.MAVLINK_MSG_ID_SYS_STATUS): _system_status,
    int(common.MAVLINK_MSG_ID_STATUSTEXT): _status_text,
    int(common.MAVLINK_MSG_ID_COMMAND_ACK): _command_ack,
    int(common.MAVLINK_MSG_ID_TIMESYNC): _timesync,
    PARAM_VALUE: _parameter,
    int(common.MAVLINK_MSG_ID_MISSION_COUNT): _to_fence(Fence.counted),
    int(common.MAVLINK_MSG_ID_MISSION_REQUEST): _to_fence(Fence.requested),
    int(common.MAVLINK_MSG_ID_MISSION_REQUEST_INT): lambda v, message, _: v.fence.requested(
        message
    ),
    int(common.MAVLINK_MSG_ID_MISSION_ITEM_INT): _to_fence(Fence.item),
    int(common.MAVLINK_MSG_ID_MISSION_ACK): _to_fence(Fence.acknowledged),
}

HANDLED_MESSAGES: Final = frozenset(HANDLERS)
"""Numbers of the messages that a vehicle's state is made of."""
