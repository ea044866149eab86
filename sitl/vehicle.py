"""One emulated vehicle's MAVLink side: its links, clock, origin, parameters, gripper and battery.

Sans-IO: messages come in through `Vehicle.handle`, frames go out through `Link.outgoing`. What an
autopilot does with a command or a setpoint is its personality's (`sitl.px4`, `sitl.ardupilot`).
"""

import heapq
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np
from pymavlink.dialects.v20 import common as dialect

from sitl import wire
from sitl.dynamics import Bodies
from sitl.fences import Area
from sitl.geodesy import Geodesy
from sitl.parameters import Parameters
from sitl.world import VehicleSpec, World

if TYPE_CHECKING:
    from sitl.route import Route

ACCEPTED, TEMPORARILY_REJECTED, DENIED, UNSUPPORTED, FAILED, IN_PROGRESS = range(6)
_TEXT_LENGTH = 50
_BOOT_SILENCE = 3.0


@dataclass
class Link:
    """One connection of one vehicle: its streams, parser, sequence and what waits to be sent."""

    vehicle: int
    kind: str
    sender: wire.Sender
    receiver: wire.Receiver = field(default_factory=wire.Receiver)
    intervals: dict[str, float] = field(default_factory=dict)
    due: list[tuple[float, str]] = field(default_factory=list)
    outgoing: list[bytes] = field(default_factory=list)

    def stream(self, name: str, interval: float | None, now: float) -> None:
        """Send a message every ``interval`` seconds, or never again (None)."""
        if interval is None:
            self.intervals.pop(name, None)
            return
        fresh = name not in self.intervals
        faster = not fresh and interval < self.intervals[name]
        self.intervals[name] = interval
        if fresh or faster:
            self.due = [entry for entry in self.due if entry[1] != name]
            heapq.heapify(self.due)
            heapq.heappush(self.due, (now, name))


class Command(NamedTuple):
    """A command as received: number, seven parameters, x and y also as 1e-7 degrees, asker."""

    number: int
    p: list[float]
    x: int
    y: int
    link: Link
    system: int
    component: int


class Personality(Protocol):
    """What differs between autopilots: modes, commands, setpoints, failsafes."""

    def command(self, command: Command) -> int | None:
        """Carry out a command; return its MAV_RESULT, None if it is not known here."""

    def setpoint(self, setpoint: wire.Setpoint) -> None:
        """Take a setpoint of position, velocity and acceleration."""

    @property
    def follows(self) -> bool:
        """Whether setpoints of all axes are followed, and another one is nothing new."""
        ...

    def followed(self, data: bytes, now: float) -> None:
        """Note a setpoint that has been taken already, while `follows`."""

    def set_mode(self, base: int, custom: int) -> int:
        """Legacy SET_MODE; return the MAV_RESULT."""
        ...

    def tick(self) -> float:
        """Look at timers and conditions; return when to look again if nothing happens till then."""
        ...

    def custom_mode(self) -> int:
        """HEARTBEAT.custom_mode."""
        ...

    def base_mode(self) -> int:
        """HEARTBEAT.base_mode."""
        ...

    def ready(self) -> bool:
        """Whether arming would be allowed: the pre-arm bit."""
        ...

    @property
    def critical(self) -> bool:
        """Whether HEARTBEAT says that a failsafe is active."""
        ...

    @property
    def taking_off(self) -> bool:
        """Whether EXTENDED_SYS_STATE says that a take-off is under way."""
        ...

    landing: bool

    @property
    def logging(self) -> bool:
        """Whether it writes its log."""
        ...

    def parameter_changed(self, name: str) -> None:
        """React to PARAM_SET."""

    def restart(self) -> None:
        """Boot."""

    pilot: bool
    route: "Route"
    has_origin: bool

    def pilot_takes_over(self) -> None:
        """A pilot's sticks or switch select a manual mode."""

    def leave(self) -> None:
        """Leave the mode that follows setpoints."""

    def arm(self, force: bool) -> int:
        """Arm, if nothing speaks against it; return the MAV_RESULT."""
        ...

    def disarm(self, text: str) -> None:
        """Stop the motors at once."""


@dataclass
class Request:
    """A gripper movement under way: when it ends and who asked."""

    at: float
    grab: bool
    link: Link | None
    system: int
    component: int


@dataclass
class Surroundings:
    """What a vehicle shares with the others: the bodies, the place, the hook to the cable."""

    bodies: Bodies
    geodesy: Geodesy
    grab: Callable[[int], bool]
    release: Callable[[int], bool]
    event: Callable[..., None]
    unix_time: float
    indoor: bool


class Vehicle:
    """State and mailbox of one vehicle."""

    def __init__(
        self,
        index: int,
        spec: VehicleSpec,
        world: World,
        surroundings: Surroundings,
        rng: np.random.Generator,
    ) -> None:
        self.index = index
        self.spec = spec
        self.system = spec.id
        self.rng = rng
        self.around = surroundings
        self.bodies = surroundings.bodies
        self.now = 0.0
        self.links: list[Link] = []
        self.origin = np.array(self.bodies.position[index])
        self.booted_at = -30.0
        self.clock_rate = 1.0
        self.unix_offset = 0.0
        if world.biases == "default":
            begun = rng.uniform(-1.0, 1.0, 3) * (30.0, 30.0, 3.0)
            self.origin = self.origin + (begun if world.local_origin == "anywhere" else 0.0)
            self.booted_at = -float(rng.uniform(30.0, 90.0))
            self.unix_offset = float(rng.normal(0.0, 0.05))
            self.bodies.bias[index] = rng.normal(0.0, 1.0, 3) * (0.012, 0.012, 0.015)
            self.bodies.noise_scale[index] = 1.0
            self.bodies.touch()
        if world.indoor:
            self.origin = np.zeros(3)
        self._settle(world)
        self.home: np.ndarray[Any, Any] | None = None
        self.home_set_at = 0.0
        self.barometer = 0.0
        self.gps_noise = spec.gps_noise
        self.charge = 1.0
        self.cells = 4 if spec.autopilot == "px4" else 3
        self.voltage = 4.1 * self.cells
        self.current = 0.0
        self.local_valid = True
        self.global_valid = not world.indoor
        self.frozen = False
        self.mode_told = (-1, -math.inf)
        self.origin_told_at = -math.inf
        self.awake_at = -math.inf
        self.vision_at = -math.inf
        self.vision_lost = False
        self.pending: list[Request] = []
        self.gripped = False
        self.simulation_changed: Callable[[str, Mapping[str, float]], None] | None = None
        self.inject: Callable[[int, int, int], bool] | None = None
        self.stuck: str | None = None
        self._open_mailbox()
        self.radio_lost = False
        self.fence: tuple[Area, ...] = ()
        self.refuse_arming: str | None = None
        self.later: list[tuple[float, Callable[[], None]]] = []
        self.personality: Personality

    def _settle(self, world: World) -> None:
        """Give the estimator the frame that it says positions in."""
        self.scale = (1.0, 1.0)
        if world.projection == "autopilot" and not world.indoor:
            self.scale = self.around.geodesy.scale(self.spec.autopilot)
        self.bodies.frames[self.index, 3:] = self.scale
        self.move_origin(self.origin)

    def _open_mailbox(self) -> None:
        self.last_heartbeat: dict[int, float] = {}
        self.mission: dict[int, list[dict[str, Any]]] = {0: [], 1: [], 2: []}
        self.upload: dict[str, Any] = {}
        self.parameters = Parameters()
        self.parameter_queue: list[tuple[Link, int]] = []
        self.text_id = 0
        self.tell: Callable[..., None] = _tell_nothing

    # Frequently used views of the batch.

    @property
    def armed(self) -> bool:
        """Whether the motors are armed."""
        return bool(self.bodies.armed[self.index])

    @property
    def landed(self) -> bool:
        """Whether the autopilot believes that it stands on the ground."""
        return bool(self.bodies.landed[self.index])

    @property
    def radio_heard(self) -> bool:
        """Whether a pilot's transmitter is on and received."""
        return self.spec.radio and not self.radio_lost

    def clock(self) -> float:
        """Seconds since this vehicle's boot, by its own clock."""
        return (self.now - self.booted_at) * self.clock_rate

    def estimated(self) -> Any:
        """Estimated world ENU position of the centre (3,)."""
        i = self.index
        b = self.bodies
        return b.position[i] + b.bias[i] + b.noise[i]

    def home_is_here(self) -> None:
        """Take the place where it is for its home."""
        self.home = np.array(self.estimated())
        self.home_set_at = self.clock()

    def move_origin(self, origin: Any) -> None:
        """Give the estimator another local origin (world ENU)."""
        self.origin = np.array(origin, dtype=float)
        self.origin_told_at = self.now
        self.place: tuple[float, float, float] = tuple(self.origin.tolist())
        self.bodies.frames[self.index, :3] = self.origin
        self.bodies.touch()

    def to_local(self, place: Any) -> tuple[float, float, float]:
        """World ENU → this estimator's local NED."""
        x, y, z = (place - self.origin).tolist()
        return y * self.scale[1], x * self.scale[0], -z

    def to_world(self, n: float, e: float, d: float) -> tuple[float, float, float]:
        """This estimator's local NED → world ENU."""
        x, y, z = self.place
        return x + e / self.scale[0], y + n / self.scale[1], z - d

    def add_link(self, kind: str) -> Link:
        """Open one more connection to this vehicle."""
        link = Link(self.index, kind, wire.Sender(self.system))
        self.links.append(link)
        return link

    def send(self, name: str, link: Link | None = None, **fields: Any) -> None:
        """Send a message on one link, or on all."""
        ticks = wire.signing_ticks(self.around.unix_time + self.now + self.unix_offset)
        for target in (link,) if link is not None else self.links:
            target.outgoing.append(target.sender.pack(name, ticks, **fields))

    def text(self, severity: int, text: str) -> None:
        """Say something in STATUSTEXT, in chunks of 50 characters where it is longer.

        PX4 gives every text a number; others give one to texts of several chunks only.
        """
        data = text.encode()
        px4 = self.spec.autopilot == "px4"
        if len(data) <= _TEXT_LENGTH and not px4:
            self.send("STATUSTEXT", severity=severity, text=data)
            return
        self.text_id = self.text_id % 65535 + 1
        for chunk, start in enumerate(range(0, len(data), _TEXT_LENGTH)):
            self.send(
                "STATUSTEXT",
                severity=severity,
                text=data[start : start + _TEXT_LENGTH],
                id=self.text_id,
                chunk_seq=chunk,
            )

    def acknowledge(
        self, command: int, result: int, link: Link, system: int, component: int
    ) -> None:
        """Answer a command."""
        self.send(
            "COMMAND_ACK",
            link,
            command=command,
            result=result,
            target_system=system,
            target_component=component,
        )

    def start_gripper(
        self, grab: bool, link: Link | None, system: int, component: int, delay: float
    ) -> None:
        """Begin to open or close the gripper; its end is in `finish_gripper`.

        Asked again while it moves, it goes on moving: the answer comes when it would have.
        """
        ends = [request.at for request in self.pending if request.grab == grab]
        at = min(ends, default=self.now + delay)
        self.pending = [Request(at, grab, link, system, component)]

    def finish_gripper(self) -> None:
        """Complete gripper movements that are due, and answer them."""
        due = [request for request in self.pending if request.at <= self.now]
        if not due:
            return
        self.pending = [request for request in self.pending if request.at > self.now]
        for request in due:
            done = self.move_gripper(request.grab)
            if request.link is not None:
                result = ACCEPTED if done else FAILED
                self.acknowledge(
                    dialect.MAV_CMD_DO_GRIPPER,
                    result,
                    request.link,
                    request.system,
                    request.component,
                )

    def move_gripper(self, grab: bool) -> bool:
        """Open or close the jaws now; tell whether the jaw switch says what was asked for."""
        if self.spec.gripper != "mavlink":
            return False
        if grab:
            if self.stuck == "open" or self.gripped:
                return self.gripped
            self.gripped = self.around.grab(self.index)
            return self.gripped
        if self.stuck == "shut":
            return False
        if self.gripped:
            self.around.release(self.index)
        self.gripped = False
        return True

    def reboot(self) -> None:
        """Start the autopilot anew: silent for a while, and what it kept in memory is gone."""
        b, i = self.bodies, self.index
        b.armed[i] = False
        b.landed[i] = True
        self.booted_at = self.now
        self.pending.clear()
        self.parameter_queue.clear()
        self.last_heartbeat.clear()
        self.home = None
        self.around.event("rebooted", self.system)
        self.personality.restart()
        self.frozen = True
        self.later.append((self.now + _BOOT_SILENCE, self._speak))

    def _speak(self) -> None:
        self.frozen = False

    def handle(self, message: Any, link: Link) -> None:
        """Take one message from a ground station."""
        if self.frozen:
            return
        if type(message) is wire.Setpoint:
            if message.target_system in (0, self.system) and message.target_component < 2:
                self.personality.setpoint(message)
            return
        self.awake_at = -math.inf
        handler = HANDLERS.get(message.get_type())
        if handler is not None:
            handler(self, message, link)


def _tell_nothing(*names: str) -> None:
    """Before the emulator has given a vehicle its telemetry, there is nothing to tell."""


HANDLERS: dict[str, Callable[[Vehicle, Any, Link], None]] = {}


def addressed(v: Vehicle, message: Any) -> bool:
    """Whether a message is meant for this vehicle's autopilot (0 is everybody)."""
    return message.target_system in {0, v.system} and message.target_component in {0, 1}


def scaled_degrees(degrees: float) -> int:
    """Degrees as MAVLink's 1e-7 degrees; what is none becomes the "not given" number."""
    if not math.isfinite(degrees) or abs(degrees) > 214.0:
        return 2**31 - 1
    return round(degrees * 1e7)
