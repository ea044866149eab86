"""One emulated vehicle: links, clock, local origin, goals, gripper, battery, and its autopilot.

No input or output: handlers of messages change the state, frames wait in `Link.outgoing`.

`Autopilot` has what PX4 and ArduPilot share, and names what differs between them.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, ClassVar

import numpy as np

from sitl.physics.dynamics import Bodies
from sitl.physics.geodesy import Geodesy
from sitl.protocol import wire
from sitl.protocol.missions import Area
from sitl.protocol.parameters import Parameters
from sitl.protocol.wire import ACCEPTED, FAILED, Command, Link
from sitl.world import VehicleSpec, World

INFO, WARNING, CRITICAL, EMERGENCY = 6, 4, 2, 0
"""MAV_SEVERITY."""
_NO_YAW = 1024
"""Bit of a setpoint's type mask."""
_TEXT_LENGTH = 50
_BOOT_SILENCE = 3.0
SLOW_INTERVAL = 0.4
"""Seconds between an autopilot's slow checks."""
_BRAKING = 3.0
"""Deceleration with which a vehicle comes to hold, m/s²."""


@dataclass(frozen=True)
class GripperRequest:
    """A movement of the gripper: its end time, and the command that gets the result, if any."""

    at: float
    grab: bool
    command: Command | None = None


@dataclass
class Gripper:
    """State of one gripper.

    ``installed``: the vehicle has a gripper that obeys MAVLink. ``grab`` and ``release`` attach the
    cable and detach it; each returns whether it did. ``stuck`` is "open", "shut" or None.
    ``closed``: the jaws are closed on nothing, as PX4 closes them when it starts.
    """

    installed: bool
    grab: Callable[[], bool]
    release: Callable[[], bool]
    gripped: bool = False
    closed: bool = False
    stuck: str | None = None
    pending: list[GripperRequest] = field(default_factory=list)

    def start(self, request: GripperRequest) -> None:
        """Start a movement; a repeated request ends when the first one would have ended."""
        ends = [earlier.at for earlier in self.pending if earlier.grab == request.grab]
        self.pending = [replace(request, at=min(ends, default=request.at))]

    def finish(self, now: float) -> list[tuple[GripperRequest, bool]]:
        """Complete the movements that are due; return each with its success."""
        due = [request for request in self.pending if request.at <= now]
        if not due:
            return []
        self.pending = [request for request in self.pending if request.at > now]
        return [(request, self.move(request.grab)) for request in due]

    def move(self, grab: bool) -> bool:
        """Open or close the jaws now; return whether the jaw switch confirms the request."""
        if not self.installed:
            return False
        if grab:
            if self.stuck == "open" or self.gripped:
                return self.gripped
            if self.closed:
                # a servo has no feedback: closed jaws count as a grip
                return True
            self.gripped = self.grab()
            return self.gripped
        if self.stuck == "shut":
            return False
        if self.gripped:
            self.release()
        self.gripped = self.closed = False
        return True


@dataclass
class Environment:
    """Objects that all vehicles share: bodies, geodesy, the cable, the event log, the clock.

    ``grab`` and ``release`` take a vehicle's index and return whether they changed the cable;
    ``unix_time`` is the vehicles' clock at the emulator's time zero.
    """

    bodies: Bodies
    geodesy: Geodesy
    grab: Callable[[int], bool]
    release: Callable[[int], bool]
    event: Callable[..., None]
    unix_time: float
    indoor: bool


Commands = Mapping[int, Callable[[Any, Command], int]]


class Autopilot(ABC):
    """Modes, commands, setpoints and failsafes of one vehicle.

    ``streams`` are default rates of messages in Hz, by kind of link and name; ``commands`` are
    methods by MAV_CMD; the gains follow parameters that begin with ``gain_parameters``.
    ``landing``: a landing is commanded; ``pilot``: a pilot controls the vehicle; ``has_origin``:
    the estimator has a global origin; ``goal`` and ``stage`` are of the active mode; ``slow_at`` is
    the time of the next slow checks.
    """

    streams: ClassVar[Mapping[str, Mapping[str, float]]]
    commands: ClassVar[Commands]
    gain_parameters: ClassVar[tuple[str, ...]]

    def __init__(
        self,
        vehicle: "Vehicle",
        parameters: dict[str, float | int],
        kinds: dict[str, int] | None = None,
    ) -> None:
        self.v = vehicle
        self.has_origin = True
        self.reset()
        vehicle.parameters.load(parameters, kinds)
        self.apply_gains()

    def reset(self) -> None:
        """Set the state after a boot."""
        self.failsafe = self.landing = self.pilot = self.has_flown = False
        self.goal: Any = None
        self.stage = ""
        self.battery_level = 0
        self.gcs_connected = self.radio_known = False
        self.radio_lost_at: float | None = None
        self.slow_at = -math.inf

    @abstractmethod
    def restart(self) -> None:
        """Boot."""

    @abstractmethod
    def apply_gains(self) -> None:
        """Copy the controller parameters into the bodies."""

    def parameter_changed(self, name: str) -> None:
        """Apply a parameter that PARAM_SET changed."""
        if name.startswith(self.gain_parameters):
            self.apply_gains()

    @property
    def follows_setpoints(self) -> bool:
        """Whether the vehicle follows setpoints of all axes: another one changes only the goal."""
        return False

    def note_setpoint(self, data: bytes, now: float) -> None:
        """Record a setpoint packet whose goal is already set, while `follows_setpoints`."""
        raise NotImplementedError

    @abstractmethod
    def handle_setpoint(self, setpoint: wire.Setpoint) -> None:
        """Accept or ignore SET_POSITION_TARGET_LOCAL_NED."""

    def handle_command(self, command: Command) -> int | None:
        """Execute a command; return its MAV_RESULT, None for an unknown command."""
        handler = self.commands.get(command.number)
        return None if handler is None else handler(self, command)

    @abstractmethod
    def set_mode(self, base: int, custom: int) -> int:
        """Execute the legacy message SET_MODE; return the MAV_RESULT."""

    @abstractmethod
    def update(self) -> float:
        """Check timers and conditions; return the time of the next check if no event occurs."""

    @abstractmethod
    def custom_mode(self) -> int:
        """Return HEARTBEAT.custom_mode."""

    def standard_mode(self) -> int:
        """Return MAV_STANDARD_MODE, 0 without one."""
        return 0

    @abstractmethod
    def base_mode(self) -> int:
        """Return HEARTBEAT.base_mode: MAV_MODE_FLAG bits."""

    @abstractmethod
    def ready_to_arm(self) -> bool:
        """Return the pre-arm bit: arming would succeed."""

    @property
    @abstractmethod
    def failsafe_active(self) -> bool:
        """Whether HEARTBEAT reports an active failsafe."""

    @property
    @abstractmethod
    def taking_off(self) -> bool:
        """Whether EXTENDED_SYS_STATE reports a take-off."""

    @property
    def logging(self) -> bool:
        """Whether the autopilot writes its log."""
        return self.v.armed

    @property
    @abstractmethod
    def target_mask(self) -> int | None:
        """Type mask of POSITION_TARGET_LOCAL_NED; None without an active controller."""

    @abstractmethod
    def pilot_override(self) -> None:
        """Select a manual mode, as a pilot's sticks or switch do."""

    @abstractmethod
    def leave_offboard(self) -> None:
        """Leave the mode that follows setpoints, without a reason that the ground station gets."""

    def arm(self, force: bool) -> int:
        """Arm if the checks pass, or without them by ``force``; return the MAV_RESULT."""
        v = self.v
        if v.armed:
            return ACCEPTED
        refused = None if force else self.refuse_arming()
        if refused is not None:
            return refused
        v.bodies.armed[v.index] = v.bodies.landed[v.index] = True
        self.has_flown = False
        self.after_arming()
        return ACCEPTED

    @abstractmethod
    def refuse_arming(self) -> int | None:
        """Return the MAV_RESULT of a refusal, after its text; None where the checks pass."""

    @abstractmethod
    def after_arming(self) -> None:
        """Report that the motors are armed, and set the state."""

    def disarm(self, reason: str) -> None:
        """Stop the motors, on the ground or in flight."""
        v = self.v
        if v.armed:
            v.bodies.armed[v.index] = False
            v.bodies.landed[v.index] = True
            v.bodies.goal_moves[v.index] = 0.0
            v.idle()
            self.after_disarming(reason)

    @abstractmethod
    def after_disarming(self, reason: str) -> None:
        """Report that the motors are disarmed, and set the state."""

    def radio_lost_for(self, seconds: float) -> bool:
        """Return whether a connected radio has just been lost for this time, once."""
        v = self.v
        if v.radio_connected:
            self.radio_known, self.radio_lost_at = True, None
        elif self.radio_known:
            if self.radio_lost_at is None:
                self.radio_lost_at = v.now
            if v.now - self.radio_lost_at >= seconds:
                self.radio_known = False
                return True
        return False

    def fly_home(self, height: float) -> bool:
        """Climb to a height (world up), then fly to home; return whether the vehicle is there."""
        v = self.v
        here, home = v.estimated(), np.array(v.home)
        if self.stage == "":
            self.stage, self.goal = "climb", np.array([here[0], here[1], height])
            v.go(self.goal)
        elif self.stage == "climb" and here[2] > self.goal[2] - 0.5:
            self.stage, self.goal = "home", np.array([home[0], home[1], self.goal[2]])
            v.go(self.goal)
        elif self.stage == "home":
            return float(np.hypot(*(home - here)[:2])) < 0.5
        return False

    def begin_landing(self, rate: float) -> None:
        """Land at the end of a mode, descending with ``rate`` (m/s)."""
        self.stage, self.landing = "land", True
        self.v.descend(rate, steer=True)


class Vehicle:
    """State of one vehicle."""

    def __init__(
        self,
        index: int,
        spec: VehicleSpec,
        world: World,
        environment: Environment,
        rng: np.random.Generator,
    ) -> None:
        self.index = index
        self.spec = spec
        self.system = spec.id
        self.is_px4 = spec.autopilot == "px4"
        self.rng = rng
        self.environment = environment
        self.bodies = environment.bodies
        self.now = 0.0
        self.links: list[Link] = []
        self.origin = np.array(self.bodies.position[index])
        self.booted_at = -30.0
        self.clock_rate = 1.0
        self.unix_offset = 0.0
        if world.biases == "default":
            offset = rng.uniform(-1.0, 1.0, 3) * (30.0, 30.0, 3.0)
            self.origin = self.origin + (offset if world.local_origin == "anywhere" else 0.0)
            self.booted_at = -float(rng.uniform(30.0, 90.0))
            self.unix_offset = float(rng.normal(0.0, 0.05))
            self.bodies.bias[index] = rng.normal(0.0, 1.0, 3) * (0.012, 0.012, 0.015)
            self.bodies.noise_scale[index] = 1.0
            self.bodies.refresh()
        if world.indoor:
            self.origin = np.zeros(3)
        self._set_frame(world)
        self.home: np.ndarray[Any, Any] | None = None
        self.home_set_at = 0.0
        self.barometer = 0.0
        self.gps_noise = spec.gps_noise
        self.charge = 1.0
        self.cells = 4 if self.is_px4 else 3
        self.voltage = 4.1 * self.cells
        self.current = 0.0
        self.local_valid = True
        self.global_valid = not world.indoor
        self.frozen = False
        self.reported_mode = (-1, -math.inf)
        self.next_check_at = -math.inf
        self.vision_at = -math.inf
        self.vision_lost = False
        self.gripper = Gripper(
            spec.gripper == "mavlink",
            partial(environment.grab, index),
            partial(environment.release, index),
            closed=self.is_px4,
        )
        self.on_sim_parameter: Callable[[str, Mapping[str, float]], None] | None = None
        self.inject: Callable[[int, int, int], bool] | None = None
        self._clear_mailbox()
        self.radio_lost = False
        self.fence: tuple[Area, ...] = ()
        self.refuse_arming: str | None = None
        self.timers: list[tuple[float, Callable[[], None]]] = []
        self.autopilot: Autopilot

    def _set_frame(self, world: World) -> None:
        """Set origin and scale of the estimator's local frame."""
        self.scale = (1.0, 1.0)
        if world.projection == "autopilot" and not world.indoor:
            self.scale = self.environment.geodesy.scale(self.spec.autopilot)
        self.bodies.frames[self.index, 3:] = self.scale
        self.move_origin(self.origin)

    def _clear_mailbox(self) -> None:
        self.last_heartbeat: dict[int, float] = {}
        self.mission: dict[int, list[dict[str, Any]]] = {0: [], 1: [], 2: []}
        self.upload: dict[str, Any] = {}
        self.parameters = Parameters()
        self.parameter_queue: list[tuple[Link, int]] = []
        self.text_id = 0
        self.muted = False

    @property
    def armed(self) -> bool:
        """Whether the motors are armed."""
        return bool(self.bodies.armed[self.index])

    @property
    def landed(self) -> bool:
        """Whether the land detector reports the vehicle on the ground."""
        return bool(self.bodies.landed[self.index])

    @property
    def radio_connected(self) -> bool:
        """Whether the vehicle receives a pilot's transmitter."""
        return self.spec.radio and not self.radio_lost

    def clock(self) -> float:
        """Return seconds since boot by this vehicle's own clock."""
        return (self.now - self.booted_at) * self.clock_rate

    def estimated(self) -> Any:
        """Return the estimated position of the centre (3,), world ENU."""
        i = self.index
        b = self.bodies
        return b.position[i] + b.bias[i] + b.noise[i]

    def set_home_here(self) -> None:
        """Set home to the estimated position."""
        self.home = np.array(self.estimated())
        self.home_set_at = self.clock()

    def move_origin(self, origin: Any) -> None:
        """Set the estimator's local origin (world ENU)."""
        self.origin = np.array(origin, dtype=float)
        self.origin_announced_at = self.now
        self.origin_xyz: tuple[float, float, float] = tuple(self.origin.tolist())
        self.bodies.frames[self.index, :3] = self.origin
        self.bodies.refresh()

    def to_local(self, place: Any) -> tuple[float, float, float]:
        """Return a point of world ENU in this estimator's local NED."""
        x, y, z = (place - self.origin).tolist()
        return y * self.scale[1], x * self.scale[0], -z

    def to_world(self, n: float, e: float, d: float) -> tuple[float, float, float]:
        """Return a point of this estimator's local NED in world ENU."""
        x, y, z = self.origin_xyz
        return x + e / self.scale[0], y + n / self.scale[1], z - d

    def limit_speeds(self, speed: float, climb: float, descend: float) -> None:
        """Set the speed limits of the position controller (m/s)."""
        b, i = self.bodies, self.index
        b.speed_limit[i] = min(speed, self.spec.max_speed)
        b.climb_limit[i] = climb
        b.descend_limit[i] = descend
        b.refresh()

    def set_speed(self, speed: float) -> None:
        """Set the horizontal speed limit (m/s), as MAV_CMD_DO_CHANGE_SPEED does."""
        if math.isfinite(speed) and speed > 0:
            self.bodies.speed_limit[self.index] = min(speed, self.spec.max_speed)
            self.bodies.refresh()

    def set_gains(self, *gains: tuple[float, float]) -> None:
        """Set the controller's gains of position, velocity and integral, clipped to stable values.

        Each is (horizontal, vertical).
        """
        b, i = self.bodies, self.index
        arrays = (b.position_gain, 5.0), (b.velocity_gain, 15.0), (b.integral_gain, 10.0)
        for (array, most), (horizontal, vertical) in zip(arrays, gains, strict=True):
            array[i] = np.clip((horizontal, horizontal, vertical), 0.0, most)
        b.refresh()

    def face(self, mask: int, yaw: float) -> None:
        """Set the goal's yaw (NED, radians) of a setpoint, unless its type mask excludes it."""
        if not mask & _NO_YAW and math.isfinite(yaw):
            self.bodies.goal_yaw[self.index] = math.pi / 2 - yaw

    def hold(self) -> None:
        """Brake, then hold position."""
        velocity = self.bodies.velocity[self.index]
        speed = float(np.linalg.norm(velocity))
        self.go(self.estimated() + velocity * max(0.3, speed / (2 * _BRAKING)))

    def go(self, place: Any) -> None:
        """Fly to a position of the centre (estimated, world ENU) within the limits, and hold it."""
        self.bodies.set_goal(self.index, (*place, *[0.0] * 6))

    def descend(self, rate: float, *, steer: bool) -> None:
        """Descend at ``rate`` (m/s) above the goal; without ``steer`` level, drifting with wind."""
        b, i = self.bodies, self.index
        goal = (*b.goal_position[i], 0.0, 0.0, -rate, 0.0, 0.0, 0.0)
        if steer:
            b.set_goal(i, goal, (1.0, 1.0, 0.0))
        else:
            b.set_goal(i, goal, (0.0, 0.0, 0.0), (0.0, 0.0, 1.0))

    def idle(self) -> None:
        """Stand on the ground without lift."""
        self.go(self.estimated())
        self.bodies.may_lift[self.index] = False

    def home_height(self) -> float:
        """Return the height of home (world up), of the origin before there is a home."""
        return float(self.home[2] if self.home is not None else self.origin[2])

    def add_link(self, kind: str) -> Link:
        """Open another connection to this vehicle."""
        link = Link(self.index, kind, wire.Sender(self.system))
        self.links.append(link)
        return link

    def send(self, name: str, link: Link | None = None, **fields: Any) -> None:
        """Send a message on one link, or on all."""
        ticks = self.signing_ticks()
        for target in (link,) if link is not None else self.links:
            target.outgoing.append(target.sender.pack(name, ticks, **fields))

    def signing_ticks(self) -> int:
        """Return the present timestamp of MAVLink signing."""
        return wire.signing_ticks(self.environment.unix_time + self.now + self.unix_offset)

    def text(self, severity: int, text: str) -> None:
        """Send STATUSTEXT, in chunks of 50 characters.

        PX4 gives every text an id; ArduPilot gives one only to texts of several chunks. A vehicle
        that is ``muted`` sends none: PX4 without its ground station (``STATUSTEXT.hpp``).
        """
        if self.muted:
            return
        data = text.encode()
        if len(data) <= _TEXT_LENGTH and not self.is_px4:
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

    def answer(self, name: str, message: Any, link: Link, **fields: Any) -> None:
        """Send a message on a link to the sender of a received one."""
        fields["target_system"] = message.get_srcSystem()
        fields["target_component"] = message.get_srcComponent()
        self.send(name, link, **fields)

    def acknowledge(self, command: Command, result: int) -> None:
        """Send COMMAND_ACK to the sender of a command."""
        self.send(
            "COMMAND_ACK",
            command.link,
            command=command.number,
            result=result,
            target_system=command.system,
            target_component=command.component,
        )

    def finish_gripper(self) -> None:
        """Complete the gripper movements that are due, and acknowledge them."""
        for request, done in self.gripper.finish(self.now):
            if request.command is not None:
                self.acknowledge(request.command, ACCEPTED if done else FAILED)

    def reboot(self) -> None:
        """Restart the autopilot: it sends nothing for a while and loses its volatile state."""
        b, i = self.bodies, self.index
        b.armed[i] = False
        b.landed[i] = True
        self.booted_at = self.now
        self.gripper.pending.clear()
        self.parameter_queue.clear()
        self.last_heartbeat.clear()
        self.home = None
        self.environment.event("rebooted", self.system)
        self.autopilot.restart()
        self.frozen = True
        self.timers.append((self.now + _BOOT_SILENCE, self._unfreeze))

    def _unfreeze(self) -> None:
        self.frozen = False


def addressed(v: Vehicle, message: Any) -> bool:
    """Return whether a message addresses this vehicle's autopilot (0 is a broadcast)."""
    return message.target_system in {0, v.system} and message.target_component in {0, 1}


def scaled_degrees(degrees: float) -> int:
    """Return degrees in MAVLink's unit of 1e-7 degrees; INT32_MAX ("not given") if unusable."""
    if not math.isfinite(degrees) or abs(degrees) > 214.0:
        return 2**31 - 1
    return round(degrees * 1e7)
