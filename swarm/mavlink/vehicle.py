"""The ground station's side of one vehicle, sans-IO: messages in, events and messages out.

What a message changes is a table (``_HANDLERS``); what an autopilot does differently is a table
(:mod:`swarm.mavlink.autopilots`); every command is followed by :mod:`swarm.mavlink.commands`.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import ClassVar

from pymavlink.dialects.v20 import common

from swarm.errors import VehicleError
from swarm.mavlink.autopilots import AUTOPILOTS, BY_HAND, Autopilot, Mode
from swarm.mavlink.commands import Command, CommandQueue
from swarm.mavlink.frames import Origin, to_local
from swarm.mavlink.packets import Message, Packet

Triple = tuple[float, float, float]

ON_GROUND = int(common.MAV_LANDED_STATE_ON_GROUND)
IN_AIR = int(common.MAV_LANDED_STATE_IN_AIR)
_ARMED = int(common.MAV_MODE_FLAG_SAFETY_ARMED)
_CUSTOM = int(common.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED)
_PREARM = int(common.MAV_SYS_STATUS_PREARM_CHECK)
_LOCATING = int(common.MAV_SYS_STATUS_AHRS | common.MAV_SYS_STATUS_SENSOR_XY_POSITION_CONTROL)
_KILL = 21196.0
_ORIGIN_MOVED = 0.05
_IN_STEP = 0.3
_LEVEL = 0.3
"""m/s up or down below which heights that are not reported at the same time can be compared."""
_FRAMES_APART = 1.0
_SAMPLES_APART = 3
_TEXT_LENGTH = 50
_ECHOES = frozenset({int(common.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED)})
"""What autopilots say of their own goals once they are armed, at the rate of positions."""
_OVERTAKEN = 128
"""A sequence number that is farther ahead than this is a packet that was overtaken."""


@dataclass(frozen=True)
class VehicleEvent:
    """Something that happened to a vehicle.

    ``kind`` is one of heard, armed, disarmed, mode, landed, airborne, text, origin, rebooted, done,
    failed; ``subject`` is the command's or mode's name.
    """

    kind: str
    message: str
    subject: str = ""


@dataclass
class Vehicle:
    """What is known of one vehicle, and what has been asked of it.

    Times are the caller's ``now`` in seconds; positions are NED metres in the vehicle's own frame,
    yaw radians. NaN and None mean "never heard".
    """

    system: int
    component: int = 1
    autopilot: Autopilot | None = None

    heard_at: float = -math.inf
    heartbeat_at: float = -math.inf
    armed: bool = False
    custom_mode: int = -1
    system_status: int = 0
    landed_state: int = 0
    position: Triple = (math.nan, math.nan, math.nan)
    velocity: Triple = (math.nan, math.nan, math.nan)
    position_at: float = -math.inf
    attitude: Triple = (math.nan, math.nan, math.nan)
    origin: Origin | None = None
    place: Origin | None = None
    relative_altitude: float = math.nan
    battery: float = math.nan
    voltage: float = math.nan
    ready: bool | None = None
    located: bool = True
    fix: int = -1
    satellites: int = -1
    level_accuracy: float = math.nan
    upright_accuracy: float = math.nan
    height_gap: float = math.nan
    boot_ms: int = -1
    round_trip: float = math.nan
    latest_round_trip: float = math.nan
    clock_offset: float = math.nan
    answered_at: float = -math.inf
    lost_packets: int = 0
    packets: int = 0
    gripped: bool = False
    unused: dict[int, int] = field(default_factory=dict)

    commands: CommandQueue = field(init=False)
    texts: list[tuple[float, int, str]] = field(default_factory=list)
    _events: list[VehicleEvent] = field(default_factory=list)
    _sequences: dict[int, int] = field(default_factory=dict)
    _missing: set[tuple[int, int]] = field(default_factory=set)
    _chunks: dict[int, list[str]] = field(default_factory=dict)
    _quietened: set[int] = field(default_factory=set)
    _from: int = 1
    _out_of_step: int = 0

    def __post_init__(self) -> None:
        self.commands = CommandQueue(self.system, self.component)

    # What comes in

    def receive(self, packet: Packet, now: float) -> None:
        """Take a packet that this vehicle sent."""
        number, _, component, sequence, message = packet
        self.heard_at = now
        self.packets += 1
        if self._sequences.get(component) == (sequence - 1) & 0xFF:
            self._sequences[component] = sequence
            if self._missing:
                self._missing.discard((component, sequence))
        else:
            self._out_of_order(component, sequence)
        handler = self._HANDLERS.get(number)
        if handler is None or message is None:
            self.unused[number] = self.unused.get(number, 0) + 1
        else:
            self._from = component
            handler(self, message, now)

    def _out_of_order(self, component: int, sequence: int) -> None:
        """Count the packets before this one that have not come; one that comes late is not lost."""
        gap = (sequence - self._sequences.get(component, sequence - 1)) & 0xFF
        if 0 < gap < _OVERTAKEN:
            self._sequences[component] = sequence
            self.lost_packets += gap - 1
            self._missing.discard((component, sequence))
            self._missing |= {(component, sequence - back & 0xFF) for back in range(1, gap)}
        elif (component, sequence) in self._missing:
            self._missing.remove((component, sequence))
            self.lost_packets -= 1

    def take_events(self) -> list[VehicleEvent]:
        """Return the events since the last call."""
        events, self._events = self._events, []
        return events

    def tick(self, now: float) -> list[Message]:
        """Return the messages to send now."""
        if not self.commands:
            return []
        sending, outcomes = self.commands.tick(now)
        for outcome in outcomes:
            name = outcome.command.name
            if outcome.succeeded:
                self._say("done", f"{name}: done after {outcome.after:.2f} s", name)
            else:
                said = self.recent_words(now)
                self._say(
                    "failed", f"{name}: {outcome.reason}" + (f" ({said})" if said else ""), name
                )
        return sending

    def recent_words(self, now: float, within: float = 5.0) -> str:
        """Return what the vehicle said lately about what is wrong, for explanations."""
        words = [
            text
            for time, severity, text in self.texts[-8:]
            if now - time <= within and severity <= common.MAV_SEVERITY_WARNING
        ]
        return "; ".join(dict.fromkeys(words))

    @property
    def mode(self) -> str:
        """The mode in a word."""
        if self.autopilot is None or self.custom_mode < 0:
            return "unknown"
        return self.autopilot.mode_name(self.custom_mode)

    @property
    def flown_by_hand(self) -> bool:
        """Whether the mode is one in which a pilot's sticks fly."""
        return self.mode in BY_HAND

    @property
    def takes_off(self) -> bool:
        """Whether it must be told to take off before it can be streamed to."""
        return self.autopilot is not None and self.autopilot.takes_off

    def in_mode(self, mode: Mode) -> bool:
        """Whether the last heartbeat showed this mode."""
        return self.autopilot is not None and self.custom_mode == self.autopilot.custom_mode(mode)

    @property
    def on_ground(self) -> bool:
        """Whether the vehicle says that it has landed."""
        return self.landed_state == ON_GROUND

    @property
    def airborne(self) -> bool:
        """Whether the vehicle says that it flies."""
        return self.landed_state == IN_AIR

    # What goes out

    def set_mode(self, mode: Mode) -> None:
        """Ask for a mode; done when HEARTBEAT shows it."""
        if self.autopilot is None:
            raise VehicleError(f"system {self.system}: unknown autopilot, so no mode can be set")
        main, sub = self.autopilot.modes[mode]
        self._ask(
            f"mode {mode}",
            common.MAV_CMD_DO_SET_MODE,
            _CUSTOM,
            main,
            sub,
            reached=lambda: self.in_mode(mode),
            retry_for=5.0,
        )

    def set_custom_mode(self, custom_mode: int) -> None:
        """Ask for the mode that a HEARTBEAT once showed; done when it shows it again."""
        packed = self.autopilot is None or self.autopilot.name == "px4"
        main, sub = (custom_mode >> 16 & 0xFF, custom_mode >> 24) if packed else (custom_mode, 0)
        self._ask(
            "mode before",
            common.MAV_CMD_DO_SET_MODE,
            _CUSTOM,
            main,
            sub,
            reached=lambda: self.custom_mode == custom_mode,
        )

    def arm(self) -> None:
        """Ask to arm, never by force; done when HEARTBEAT shows it."""
        self._ask(
            "arm",
            common.MAV_CMD_COMPONENT_ARM_DISARM,
            1,
            reached=lambda: self.armed,
            retry_for=5.0,
        )

    def disarm(self) -> None:
        """Ask to disarm, which an autopilot only does on the ground."""
        self._ask("disarm", common.MAV_CMD_COMPONENT_ARM_DISARM, 0, reached=lambda: not self.armed)

    def kill(self) -> None:
        """Stop the motors at once, wherever the vehicle is."""
        self.commands.drop_all()
        self._ask(
            "kill", common.MAV_CMD_COMPONENT_ARM_DISARM, 0, _KILL, reached=lambda: not self.armed
        )

    def take_off(self, height: float) -> None:
        """Ask an autopilot that needs it to take off; height in metres above where it stands."""
        self._ask("takeoff", common.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, height)

    def grip(self, *, closed: bool) -> None:
        """Close or open the gripper."""
        action = common.GRIPPER_ACTION_GRAB if closed else common.GRIPPER_ACTION_RELEASE
        self._ask("grab" if closed else "release", common.MAV_CMD_DO_GRIPPER, 1, action)

    def request_interval(self, message: int, rate: float) -> None:
        """Ask for a message at a rate in Hz."""
        self._interval(message, 1e6 / rate)

    def quieten(self, since: float, now: float) -> None:
        """Stop what comes more than three times a second and nobody reads.

        ``since`` is when the vehicle was first heard. It leaves the link to what the flight needs.
        What only comes once a vehicle is armed is stopped beforehand.
        """
        often = {message for message, n in self.unused.items() if n > 3.0 * (now - since)}
        for message in sorted((often | _ECHOES) - self._quietened):
            self._quietened.add(message)
            self._interval(message, -1.0)

    def restore_streams(self) -> None:
        """Give back what :meth:`quieten` stopped, at the autopilot's own rates."""
        for message in self._quietened:
            self._interval(message, 0.0)
        self._quietened.clear()

    def _interval(self, message: int, microseconds: float) -> None:
        name = common.mavlink_map[message].msgname
        command = common.MAV_CMD_SET_MESSAGE_INTERVAL
        self._ask(f"interval of {name}", command, message, microseconds)

    def request_message(self, message: int, reached: Callable[[], bool] | None = None) -> None:
        """Ask for one message."""
        name = common.mavlink_map[message].msgname
        self._ask(name, common.MAV_CMD_REQUEST_MESSAGE, message, reached=reached)

    def _ask(
        self,
        name: str,
        number: int,
        *parameters: float,
        reached: Callable[[], bool] | None = None,
        retry_for: float = 0.0,
    ) -> None:
        if self.commands.has(name):
            return
        seven = (*parameters, *[0.0] * (7 - len(parameters)))
        self.commands.put(Command(name, int(number), seven, reached, retry_for=retry_for))

    # Handlers

    def _say(self, kind: str, message: str, subject: str = "") -> None:
        self._events.append(VehicleEvent(kind, message, subject))

    def _heartbeat(self, message: Message, now: float) -> None:
        if message.autopilot == common.MAV_AUTOPILOT_INVALID:
            return
        if self.autopilot is None:
            self.autopilot = AUTOPILOTS.get(message.autopilot)
        first = self.heartbeat_at == -math.inf
        self.heartbeat_at = now
        self.component = self.commands.component = self._from
        armed = bool(message.base_mode & _ARMED)
        changed = message.custom_mode != self.custom_mode
        self.custom_mode = message.custom_mode
        self.system_status = message.system_status
        if first:
            self._say("heard", f"heard: {self.autopilot.name if self.autopilot else 'unknown'}")
        if changed:
            self._say("mode", f"mode {self.mode}", self.mode)
        if armed != self.armed:
            self.armed = armed
            self._say("armed" if armed else "disarmed", "armed" if armed else "disarmed")

    def _local_position(self, message: Message, now: float) -> None:
        self.position = (message.x, message.y, message.z)
        self.velocity = (message.vx, message.vy, message.vz)
        self.position_at = now
        self._boot_time(message.time_boot_ms)

    def _boot_time(self, boot_ms: int) -> None:
        if boot_ms < self.boot_ms - 2000:
            self._say("rebooted", "rebooted: its clock went back")
        self.boot_ms = boot_ms

    def _global_position(self, message: Message, now: float) -> None:
        self.place = Origin(message.lat * 1e-7, message.lon * 1e-7, message.alt * 1e-3)
        self.relative_altitude = message.relative_alt * 1e-3
        self._compare(self.place, now)

    def _gps(self, message: Message, now: float) -> None:
        self.fix, self.satellites = message.fix_type, message.satellites_visible
        self.level_accuracy = message.h_acc * 1e-3 if message.h_acc else math.nan
        self.upright_accuracy = message.v_acc * 1e-3 if message.v_acc else math.nan
        age = now - self.position_at
        level = abs(self.velocity[2]) < _LEVEL
        if self.origin is not None and message.fix_type >= 3 and age < _IN_STEP and level:
            self.height_gap = message.alt * 1e-3 - (self.origin.altitude - self.position[2])

    def _compare(self, place: Origin, now: float) -> None:
        """Compare the place on earth with the local position: both must mean the same origin.

        A frame that is reset moves one against the other; a single sample may be out of step.
        """
        age = now - self.position_at
        if self.origin is None or self.autopilot is None or not age < _IN_STEP:
            return
        local = to_local(self.autopilot.name, self.origin, place)
        off = [local[k] - self.position[k] - age * self.velocity[k] for k in (0, 1)]
        apart = math.hypot(*off)
        self._out_of_step = self._out_of_step + 1 if apart > _FRAMES_APART else 0
        if self._out_of_step == _SAMPLES_APART:
            self._say("origin", f"its local and global positions are {apart:.1f} m apart")

    def _attitude(self, message: Message, _now: float) -> None:
        self.attitude = (message.roll, message.pitch, message.yaw)

    def _global_origin(self, message: Message, _now: float) -> None:
        origin = Origin(message.latitude * 1e-7, message.longitude * 1e-7, message.altitude * 1e-3)
        if self.origin is not None and _distance(origin, self.origin) > _ORIGIN_MOVED:
            moved = _distance(origin, self.origin)
            self._say("origin", f"its estimator's origin moved by {moved:.2f} m")
        self.origin = origin

    def _extended_state(self, message: Message, _now: float) -> None:
        was, self.landed_state = self.landed_state, message.landed_state
        if was != self.landed_state and self.landed_state == ON_GROUND:
            self._say("landed", "on the ground")
        elif was != self.landed_state and self.landed_state == IN_AIR:
            self._say("airborne", "in the air")

    def _system_status(self, message: Message, _now: float) -> None:
        self.battery = (
            message.battery_remaining / 100.0 if message.battery_remaining >= 0 else math.nan
        )
        self.voltage = message.voltage_battery / 1000.0
        asked = message.onboard_control_sensors_enabled & _LOCATING
        self.located = not asked & ~message.onboard_control_sensors_health
        if message.onboard_control_sensors_present & _PREARM:
            self.ready = bool(message.onboard_control_sensors_health & _PREARM)

    def _status_text(self, message: Message, now: float) -> None:
        text = message.text.split(b"\0", 1)[0].decode("utf-8", "replace")
        if message.id:
            key = self._from << 16 | message.id
            parts = self._chunks.setdefault(key, [])
            parts.append(text)
            if len(text) >= _TEXT_LENGTH and len(parts) < 16:
                return
            text = "".join(self._chunks.pop(key))
        text = text.strip()
        if not text:
            return
        self.texts = [*self.texts[-31:], (now, message.severity, text)]
        self._say("text", text)

    def _acknowledged(self, message: Message, now: float) -> None:
        self.commands.acknowledge(message, now)

    def _timesync(self, message: Message, now: float) -> None:
        if message.tc1 == 0 or message.ts1 <= 0:
            return
        sent = message.ts1 * 1e-9
        if not 0.0 <= now - sent < 10.0:
            return
        round_trip = self.latest_round_trip = now - sent
        self.answered_at = now
        if not self.round_trip <= round_trip:
            self.clock_offset = message.tc1 * 1e-9 - (sent + now) / 2.0
            self.round_trip = round_trip

    _HANDLERS: ClassVar[Mapping[int, Callable[["Vehicle", Message, float], None]]] = {
        int(common.MAVLINK_MSG_ID_HEARTBEAT): _heartbeat,
        int(common.MAVLINK_MSG_ID_LOCAL_POSITION_NED): _local_position,
        int(common.MAVLINK_MSG_ID_GLOBAL_POSITION_INT): _global_position,
        int(common.MAVLINK_MSG_ID_GPS_RAW_INT): _gps,
        int(common.MAVLINK_MSG_ID_ATTITUDE): _attitude,
        int(common.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN): _global_origin,
        int(common.MAVLINK_MSG_ID_EXTENDED_SYS_STATE): _extended_state,
        int(common.MAVLINK_MSG_ID_SYS_STATUS): _system_status,
        int(common.MAVLINK_MSG_ID_STATUSTEXT): _status_text,
        int(common.MAVLINK_MSG_ID_COMMAND_ACK): _acknowledged,
        int(common.MAVLINK_MSG_ID_TIMESYNC): _timesync,
    }


READ: frozenset[int] = frozenset(Vehicle._HANDLERS)
"""Numbers of the messages that a vehicle's state is made of."""


def _distance(one: Origin, other: Origin) -> float:
    """Return metres between two near places, roughly."""
    north = math.radians(one.latitude - other.latitude) * 6_371_000.0
    east = math.radians(one.longitude - other.longitude) * 6_371_000.0
    east *= math.cos(math.radians(one.latitude))
    return math.hypot(north, east, one.altitude - other.altitude)
