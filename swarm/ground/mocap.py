"""The bridge from a motion capture system to the vehicles: VISION_POSITION_ESTIMATE.

Poses are ENU, of bodies FLU; messages are NED and FRD, in the one frame of the laboratory (fleet
files: ``frame: shared``). Each has the time of its capture, from which autopilots correct jitter.
The bridge ends with the ground station, and then the vehicles have no position. Laboratories'
systems are read by :mod:`swarm.ground.mocap_child`.
"""

import importlib.util
import json
import math
import socket
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any, NamedTuple
from urllib.parse import urlsplit

from pymavlink.dialects.v20 import common

from swarm.errors import VehicleError, reason
from swarm.flight.router import Outgoing, Team
from swarm.ground.child_process import ChildError, RestartedProcess
from swarm.mavlink.frames import Origin

_LARGEST_DATAGRAM = 65_536
_ORIGIN_INTERVAL = 1.0
"""Seconds between attempts to set a vehicle's origin."""
ANYWHERE = Origin(47.397742, 8.545594, 488.0)
"""Origin on the earth without one in the fleet file: ArduPilot arms with one only, and takes 0, 0
for none. Nothing depends on the place: heading comes from motion capture too."""
_UNKNOWN = math.nan
UNSEEN = 0.5
"""Seconds without a pose that are reported: ten ticks at the lowest rate, 20 Hz."""
CONNECT_TIMEOUT = 10.0
"""Seconds within which a laboratory's system must answer, which may be starting."""
_MODULE = "swarm.ground.mocap_child"
LABORATORY = (
    "vicon", "optitrack", "optitrack_closed_source", "qualisys", "nokov", "vrpn", "motionanalysis",
    "freemotion", "mock",
)  # fmt: skip
"""Systems that libmotioncapture reads, some of them only where it was built for them."""


class Pose(NamedTuple):
    """One body: seconds on the capture's clock, metres (ENU), quaternion w, x, y, z."""

    system: int
    time: float
    position: tuple[float, float, float]
    attitude: tuple[float, float, float, float]


class DatagramCapture:
    """Poses as JSON datagrams, one frame each, as the emulator sends them.

    ``{"time": seconds, "bodies": {"1": [x, y, z, qw, qx, qy, qz]}}`` with system ids.
    """

    def __init__(self, host: str, port: int) -> None:
        """Listen; raises :class:`VehicleError`. Port 0 takes a free one."""
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        try:
            self._socket.bind((host, port))
        except (OSError, UnicodeError) as error:  # the latter for no name of a host
            self._socket.close()
            raise VehicleError(
                f"motion capture: cannot listen on {host}:{port}: {reason(error)}"
            ) from None

    @property
    def port(self) -> int:
        """The port on which frames are received."""
        return int(self._socket.getsockname()[1])

    def latest(self) -> Iterable[Pose]:
        """Return the newest poses; datagrams that are not frames are left out."""
        found: dict[int, Pose] = {}
        while True:
            try:
                data = self._socket.recv(_LARGEST_DATAGRAM)
            except (BlockingIOError, ConnectionError):
                return found.values()
            found |= {pose.system: pose for pose in parse_frame(data)}

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


def parse_frame(data: bytes) -> list[Pose]:
    """Return the poses of a JSON frame; nothing for other bytes."""
    try:
        frame = json.loads(data)
        moment = float(frame["time"])
        poses = []
        for system, values in frame["bodies"].items():
            x, y, z, qw, qx, qy, qz = map(float, values)
            poses.append(Pose(int(system), moment, (x, y, z), (qw, qx, qy, qz)))
    except (ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError):
        return []
    return [one for one in poses if all(map(math.isfinite, (moment, *one.position, *one.attitude)))]


class LaboratoryCapture:
    """A laboratory's system through libmotioncapture, in a process that is restarted if it ends.

    A rigid body belongs to the vehicle whose system id ends its name: ``quad3`` to system 3.
    """

    def __init__(self, kind: str, host: str, timeout: float = CONNECT_TIMEOUT) -> None:
        """Connect; raises :class:`VehicleError` without the library or the system."""
        if importlib.util.find_spec("motioncapture") is None:
            raise VehicleError(
                "motion capture needs a library: pip install 'swarm-ground-station[mocap]'"
            )
        self._child = RestartedProcess(_MODULE, (kind, host))
        try:
            message = next(self._child.receive(timeout), None)
        except ChildError as error:
            message = "failed", str(error)
        if message is None or message[0] == "failed":
            self.close()
            reason = message[1] if message else f"no answer within {timeout:g} s"
            raise VehicleError(f"motion capture: {kind} at {host}: {reason}")

    @property
    def port(self) -> int | None:
        """None: the library has its own."""
        return None

    def latest(self) -> Iterable[Pose]:
        """Return the newest poses."""
        poses: dict[int, Pose] = {}
        with suppress(ChildError):
            for message in self._child.arrived():
                if message[0] == "frame":
                    poses |= {body[0]: Pose(*body) for body in message[1]}
        return poses.values()

    def close(self) -> None:
        """End the process."""
        self._child.close()


Capture = DatagramCapture | LaboratoryCapture
"""A motion capture system; ``port`` is the UDP port of its frames, None if it is not ours."""


def parse_url(url: str) -> tuple[str, str, int]:
    """Return kind, host and port (0: none) of a ``--mocap``; raises `ValueError`."""
    parts = urlsplit(url)
    known = parts.scheme in ("udp", *LABORATORY) and bool(parts.hostname)
    if not known or (parts.scheme == "udp") != bool(parts.port):
        kinds = ", ".join(LABORATORY)
        raise ValueError(f"expected udp://HOST:PORT or KIND://HOST with one of {kinds}, got {url}")
    return parts.scheme, parts.hostname or "", parts.port or 0


def open_capture(url: str) -> Capture:
    """Return the capture of a ``--mocap``; raises :class:`VehicleError`."""
    kind, host, port = parse_url(url)
    return DatagramCapture(host, port) if kind == "udp" else LaboratoryCapture(kind, host)


@dataclass
class MocapBridge:
    """Sends each new pose to its vehicle, and an ``origin`` to vehicles that need one to arm.

    Poses are stamped in flight time, in which the ground station answers TIMESYNC: PX4 takes poses
    for what they say by that clock, and rejects those from the future. ``_behind`` is the flight
    time less the capture's, least over all poses: of the pose that was delayed least.
    """

    capture: Capture
    team: Team
    origin: Origin = ANYWHERE
    _next_origin: float = 0.0
    _seen: dict[int, float] = field(default_factory=dict)
    _behind: float = math.inf
    _missed: tuple[int, ...] = ()

    def packets(self, now: float) -> Iterator[Outgoing]:
        """Yield the packets that are due at ``now``."""
        for pose in self.capture.latest():
            self._seen[pose.system] = now
            self._behind = min(self._behind, now - pose.time)
            yield from self._packet(pose.system, estimate(pose, pose.time + self._behind))
        if now < self._next_origin:
            return
        self._next_origin = now + _ORIGIN_INTERVAL
        for system, vehicle in self.team.vehicles.items():
            kind = vehicle.autopilot
            if kind is not None and kind.needs_origin and vehicle.origin is None:
                yield from self._packet(system, origin_message(system, self.origin))

    def unseen(self, now: float) -> tuple[int, ...]:
        """Return the vehicles that have had poses, but none for UNSEEN seconds."""
        return tuple(
            sorted(
                system
                for system, seen in self._seen.items()
                if system in self.team.vehicles and now - seen > UNSEEN
            )
        )

    def change(self, now: float) -> tuple[str, str] | None:
        """Return an event when poses of vehicles are missing, and when all have poses again."""
        unseen = self.unseen(now)
        if unseen == self._missed:
            return None
        self._missed = unseen
        names = ", ".join(map(str, unseen))
        text = f"no pose of system {names} for {UNSEEN:g} s" if unseen else "has all poses again"
        return "motion capture", text

    def _packet(self, system: int, message: Any) -> Iterator[Outgoing]:
        route = self.team.way_to(system) if system in self.team.vehicles else None
        if route is not None:
            data = self.team.sealed(route.link, route.encoder.encode(message))
            yield Outgoing(route.link, route.address, data)


def estimate(pose: Pose, at: float) -> Any:
    """Return a pose as VISION_POSITION_ESTIMATE of flight time ``at``: NED, FRD, radians."""
    (east, north, up), (w, x, y, z) = pose.position, pose.attitude
    roll = math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    pitch = -math.asin(min(1.0, max(-1.0, 2.0 * (w * y - z * x))))
    yaw = 0.5 * math.pi - math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    yaw = math.remainder(yaw, 2.0 * math.pi)
    unknown = [_UNKNOWN] * 21
    return common.MAVLink_vision_position_estimate_message(
        round(at * 1e6), north, east, -up, roll, pitch, yaw, unknown, 0
    )


def origin_message(system: int, origin: Origin) -> Any:
    """Return SET_GPS_GLOBAL_ORIGIN for a vehicle."""
    return common.MAVLink_set_gps_global_origin_message(
        system, round(origin.latitude * 1e7), round(origin.longitude * 1e7),
        round(origin.altitude * 1e3), 0,
    )  # fmt: skip
