"""The ground station's side of one vehicle, sans-IO: messages in, events and messages out.

What a message changes is a table (:mod:`swarm.mavlink.message_handlers`); what an autopilot does
differently is a table (:mod:`swarm.mavlink.autopilots`); every command is followed by
:mod:`swarm.mavlink.commands`.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import ClassVar

from pymavlink.dialects.v20 import common

from swarm.errors import VehicleError
from swarm.mavlink.autopilots import BY_HAND, Autopilot, Mode
from swarm.mavlink.commands import STATE_PATIENCE, Command, CommandQueue
from swarm.mavlink.frames import Origin
from swarm.mavlink.message_handlers import HANDLERS, IN_AIR, ON_GROUND, TAKING_OFF
from swarm.mavlink.packets import Message, Packet, message_name
from swarm.mavlink.parameters import Parameters
from swarm.mavlink.telemetry_table import (
    ANGLES,
    BOOT,
    COMPONENT,
    HEARD_AT,
    LOST,
    PACKETS,
    PLACE,
    POSITION_AT,
    SPEED,
    Columns,
    Number,
    Three,
    Triple,
    Whole,
    count,
)

_CUSTOM = int(common.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED)
_KILL = 21196.0
TAKEOFF_PATIENCE = 15.0
"""Seconds from a take-off's acknowledgement until it flies: motors spool up first."""
_ECHOES = frozenset({int(common.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED)})
"""What autopilots say of their own goals once they are armed, at the rate of positions."""


@dataclass(frozen=True)
class VehicleEvent:
    """Something that happened to a vehicle.

    ``kind`` is one of heard, armed, disarmed, mode, landed, airborne, text, text warning, text
    error (by its severity), origin, rebooted, done, failed; ``subject`` is the command's or mode's
    name.
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
    autopilot: Autopilot | None = None
    columns: Columns = field(default_factory=lambda: Columns(1), repr=False)
    row: int = 0

    heartbeat_at: float = -math.inf
    mode_at: float = -math.inf
    armed: bool = False
    custom_mode: int = -1
    system_status: int = 0
    landed_state: int = 0
    origin: Origin | None = None
    ask_origin_at: float = -math.inf
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
    gaps: Triple = (math.nan, math.nan, math.nan)
    round_trip: float = math.nan
    latest_round_trip: float = math.nan
    clock_offset: float = math.nan
    latest_clock_offset: float = math.nan
    answered_at: float = -math.inf
    gripped: bool = False
    unused: dict[int, int] = field(default_factory=dict)

    commands: CommandQueue = field(init=False)
    parameters: Parameters = field(default_factory=Parameters)
    texts: list[tuple[float, int, str]] = field(default_factory=list)
    _events: list[VehicleEvent] = field(default_factory=list)
    chunks: dict[int, list[str]] = field(default_factory=dict)
    _quietened: set[int] = field(default_factory=set)
    speaks_as: int = 1
    out_of_step: int = 0
    set_back: int = 0

    heard_at = Number(HEARD_AT)
    position_at = Number(POSITION_AT)
    position = Three(PLACE)
    velocity = Three(SPEED)
    attitude = Three(ANGLES)
    boot_ms = Whole(BOOT)
    packets = Whole(PACKETS)
    lost_packets = Whole(LOST)
    component = Whole(COMPONENT)

    _HANDLERS: ClassVar[Mapping[int, Callable[["Vehicle", Message, float], None]]] = HANDLERS

    def __copy__(self) -> "Vehicle":
        twin = object.__new__(type(self))
        twin.__dict__.update(self.__dict__)
        twin.columns, twin.row = self.columns.copied(self.row), 0
        return twin

    def __post_init__(self) -> None:
        self.commands = CommandQueue(self.system, self.component)

    # What comes in

    def receive(self, packet: Packet, now: float) -> None:
        """Take a packet that this vehicle sent."""
        number, _, component, sequence, message = packet
        known = self.columns
        count(known.table, known.sequences, known.missing, self.row, component, sequence, now)
        self.read(number, component, message, now)

    def read(self, number: int, component: int, message: Message | None, now: float) -> None:
        """Take what a packet of this vehicle's says, which has been counted."""
        handler = self._HANDLERS.get(number)
        if handler is None or message is None:
            self.unused[number] = self.unused.get(number, 0) + 1
        else:
            self.speaks_as = component
            handler(self, message, now)

    def take_events(self) -> list[VehicleEvent]:
        """Return the events since the last call."""
        events, self._events = self._events, []
        return events

    @property
    def busy(self) -> bool:
        """Whether there may be anything to send."""
        return self.commands.busy or self.parameters.busy

    def tick(self, now: float) -> list[Message]:
        """Return the messages to send now."""
        if not self.busy:
            return []
        sending, outcomes = self.commands.tick(now)
        if self.parameters.busy and self.autopilot is not None:
            sending += self.parameters.tick(
                self.system, self.component, bytewise=self.autopilot.bytewise, now=now
            )
        for outcome in outcomes:
            name = outcome.command.name
            if outcome.succeeded:
                self.say("done", f"{name}: done after {outcome.after:.2f} s", name)
            else:
                said = self.recent_words(now)
                self.say(
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
        return self.landed_state in {IN_AIR, TAKING_OFF}

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
        """Ask an autopilot that needs it to take off; height in metres above where it stands.

        Done when it says that it flies, where it says such things: asked again because an
        acknowledgement was lost, one that flies refuses.
        """
        self._ask(
            "takeoff",
            common.MAV_CMD_NAV_TAKEOFF,
            *(0, 0, 0, 0, 0, 0, height),
            reached=(lambda: self.airborne) if self.landed_state else None,
            state_patience=TAKEOFF_PATIENCE,
        )

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
        name = message_name(message)
        command = common.MAV_CMD_SET_MESSAGE_INTERVAL
        self._ask(f"interval of {name}", command, message, microseconds)

    def request_message(self, message: int, reached: Callable[[], bool] | None = None) -> None:
        """Ask for one message."""
        name = message_name(message)
        self._ask(name, common.MAV_CMD_REQUEST_MESSAGE, message, reached=reached)

    def _ask(
        self,
        name: str,
        number: int,
        *parameters: float,
        reached: Callable[[], bool] | None = None,
        state_patience: float = STATE_PATIENCE,
        retry_for: float = 0.0,
    ) -> None:
        if self.commands.has(name):
            return
        seven = (*parameters, *[0.0] * (7 - len(parameters)))
        self.commands.put(Command(name, int(number), seven, reached, state_patience, retry_for))

    def say(self, kind: str, message: str, subject: str = "") -> None:
        """Report an event."""
        self._events.append(VehicleEvent(kind, message, subject))
