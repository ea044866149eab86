"""State of one emulated vehicle: links, clock, local origin, parameters, mission and battery.

No input or output: handlers of messages change the state, frames wait in `Link.outgoing`.

`Autopilot` is the interface of all that differs between PX4 and ArduPilot.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, Protocol

import numpy as np
from pymavlink.dialects.v20 import common as dialect

from sitl.physics.dynamics import Bodies
from sitl.physics.geodesy import Geodesy
from sitl.protocol import wire
from sitl.protocol.fences import Area
from sitl.protocol.gripper import Gripper
from sitl.protocol.links import ACCEPTED, FAILED, Command, Link
from sitl.protocol.parameters import Parameters
from sitl.world import VehicleSpec, World


class MissionProgress:
    """The current mission item, its goal (world ENU) and timers; ``first`` is the start item."""

    def __init__(self, first: int) -> None:
        self.first = first
        self.restart()

    def restart(self) -> None:
        """Return to the first item."""
        self.seq = self.first
        self.goal: Any = None
        self.wait_until: float | None = None
        self.jumps: dict[int, int] = {}

    def jump_to(self, seq: int, count: int) -> bool:
        """Continue with another item of ``count``; return False if it does not exist."""
        if not 0 <= seq < count:
            return False
        self.seq = max(seq, self.first)
        self.goal = self.wait_until = None
        return True

    def advance(self) -> None:
        """Continue with the next item."""
        self.seq += 1
        self.goal = self.wait_until = None


class Autopilot(Protocol):
    """Modes, commands, setpoints and failsafes of one vehicle."""

    landing: bool
    pilot: bool
    """A pilot controls the vehicle."""
    has_origin: bool
    """The estimator has a global origin."""

    @property
    def streams(self) -> Mapping[str, Mapping[str, float]]:
        """Default rates of messages in Hz, by kind of link and name."""
        ...

    def handle_command(self, command: Command) -> int | None:
        """Execute a command; return its MAV_RESULT, None for an unknown command."""

    def handle_setpoint(self, setpoint: wire.Setpoint) -> None:
        """Accept or ignore a setpoint of position, velocity and acceleration."""

    @property
    def follows_setpoints(self) -> bool:
        """Whether the vehicle follows setpoints of all axes: another one changes only the goal."""
        ...

    def note_setpoint(self, data: bytes, now: float) -> None:
        """Record a setpoint packet whose goal is already set, while `follows_setpoints`."""

    def set_mode(self, base: int, custom: int) -> int:
        """Execute the legacy message SET_MODE; return the MAV_RESULT."""
        ...

    def update(self) -> float:
        """Check timers and conditions; return the time of the next check if no event occurs."""
        ...

    def custom_mode(self) -> int:
        """Return HEARTBEAT.custom_mode."""
        ...

    def base_mode(self) -> int:
        """Return HEARTBEAT.base_mode."""
        ...

    def ready_to_arm(self) -> bool:
        """Return the pre-arm bit: arming would succeed."""
        ...

    @property
    def failsafe_active(self) -> bool:
        """Whether HEARTBEAT reports an active failsafe."""
        ...

    @property
    def taking_off(self) -> bool:
        """Whether EXTENDED_SYS_STATE reports a take-off."""
        ...

    @property
    def logging(self) -> bool:
        """Whether the autopilot writes its log."""
        ...

    def parameter_changed(self, name: str) -> None:
        """Apply a parameter that PARAM_SET changed."""

    def restart(self) -> None:
        """Boot."""

    def pilot_override(self) -> None:
        """Select a manual mode, as a pilot's sticks or switch do."""

    def leave_offboard(self) -> None:
        """Leave the mode that follows setpoints."""

    def arm(self, force: bool) -> int:
        """Arm if the checks pass; return the MAV_RESULT."""
        ...

    def disarm(self, reason: str) -> None:
        """Stop the motors immediately."""


_TEXT_LENGTH = 50
_BOOT_SILENCE = 3.0


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
        self.cells = 4 if spec.autopilot == "px4" else 3
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
            closed=spec.autopilot == "px4",
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
        self.mission_progress = MissionProgress(first=0)
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
        """Send COMMAND_ACK."""
        self.send(
            "COMMAND_ACK",
            link,
            command=command,
            result=result,
            target_system=system,
            target_component=component,
        )

    def finish_gripper(self) -> None:
        """Complete the gripper movements that are due, and acknowledge them."""
        number = dialect.MAV_CMD_DO_GRIPPER
        for request, done in self.gripper.finish(self.now):
            if request.link is not None:
                result = ACCEPTED if done else FAILED
                self.acknowledge(number, result, request.link, request.system, request.component)

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
