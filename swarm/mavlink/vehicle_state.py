"""The state of one vehicle as its messages report it, and the events that they cause."""

import math
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
from pymavlink.dialects.v20 import common

from swarm.mavlink.autopilots import MANUAL_MODES, Autopilot, Mode
from swarm.mavlink.commands import CommandQueue
from swarm.mavlink.frames import Origin
from swarm.mavlink.parameters import Parameters
from swarm.mavlink.telemetry_table import (
    ARMED,
    ASKED_AT,
    ATTITUDE,
    BATTERY,
    BOOT_TIME,
    COMPONENT,
    DIRECT,
    FIX_TYPE,
    GRIPPED,
    HEIGHT_DIFFERENCE,
    LATE,
    LOST_PACKETS,
    MODE_AT,
    PACKETS,
    POSITION,
    POSITION_AT,
    POSITION_HEALTHY,
    RECEIVED_AT,
    VELOCITY,
    VERTICAL_ACCURACY,
    FlagField,
    FloatField,
    IntegerField,
    TelemetryTable,
    Vector,
    VectorField,
)

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
class VehicleState:
    """The latest reported state of one vehicle, its command queue and its parameters.

    The vehicle is its autopilot: ``component`` is chosen by a HEARTBEAT of an autopilot.

    Times are the caller's ``now`` in seconds. Positions are NED in metres in the vehicle's own
    frame, angles in radians, accuracies and ``height_difference`` in metres, ``battery`` from 0
    to 1. NaN and None mean "not received".

    - ``telemetry``, ``row``: the table with the frequent values, and this vehicle's row in it.
    - ``asked_at``: when the first clock request was sent that has not been answered; infinite
      without any, or where the vehicle has never answered one.
    - ``position_healthy``: False if SYS_STATUS reports an unhealthy position estimate.
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
    texts: list[tuple[float, int, str]] = field(default_factory=list)
    text_chunks: dict[int, TextChunks] = field(default_factory=dict)
    said_texts: dict[int, TextChunks] = field(default_factory=dict)
    order: int = DIRECT
    origin_mismatches: int = 0
    _doubted: dict[str, object] = field(default_factory=dict)
    _events: list[VehicleEvent] = field(default_factory=list)
    _stopped_streams: set[int] = field(default_factory=set)

    asked_at = FloatField(ASKED_AT)
    received_at = FloatField(RECEIVED_AT)
    position_at = FloatField(POSITION_AT)
    position = VectorField(POSITION)
    velocity = VectorField(VELOCITY)
    attitude = VectorField(ATTITUDE)
    boot_ms = IntegerField(BOOT_TIME)
    packets = IntegerField(PACKETS)
    lost_packets = IntegerField(LOST_PACKETS)
    component = IntegerField(COMPONENT)
    mode_at = FloatField(MODE_AT)
    battery = FloatField(BATTERY)
    position_healthy = FlagField(POSITION_HEALTHY)
    fix_type = IntegerField(FIX_TYPE)
    height_difference = FloatField(HEIGHT_DIFFERENCE)
    vertical_accuracy = FloatField(VERTICAL_ACCURACY)
    gripped = FlagField(GRIPPED)
    armed = FlagField(ARMED)

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
