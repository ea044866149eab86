"""The bridge from a motion capture system to the vehicles: VISION_POSITION_ESTIMATE.

Poses are ENU, of bodies FLU; messages are NED and FRD, in the one frame of the laboratory (fleet
files: ``frame: shared``). Each has the time of its capture, from which autopilots correct jitter.
A bridge within the ground station ends with it, and then the vehicles have no position; the one of
:mod:`swarm.ground.mocap_bridge` goes on. Laboratories' systems are read by
:mod:`swarm.ground.mocap_child`.
"""

import importlib.util
import json
import math
import socket
from collections import deque
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any
from urllib.parse import urlsplit

from pymavlink.dialects.v20 import common

from swarm.errors import VehicleError, reason
from swarm.flight.bodies import UNSEEN, Body, Pose
from swarm.flight.router import Outgoing, Route, Team
from swarm.ground.child_process import ChildError, RestartedProcess
from swarm.mavlink.frames import Origin
from swarm.mavlink.packets import Encoder
from swarm.mission.fleet import Fleet

_LARGEST_DATAGRAM = 65_536
_ORIGIN_INTERVAL = 1.0
"""Seconds between attempts to set a vehicle's origin."""
_ORIGIN_WAIT = 30.0
"""Seconds for which poses wait for the origin: autopilots take it seconds after their start."""
ANYWHERE = Origin(47.397742, 8.545594, 488.0)
"""Origin on the earth without one in the fleet file: ArduPilot arms with one only, and takes 0, 0
for none. Nothing depends on the place: heading comes from motion capture too."""
_UNKNOWN = math.nan
_RATE_WINDOW = 2.0
"""Seconds over which poses are counted."""
_STEP, _STEPPED = 0.1, 0.3
"""Seconds by which a pose may come earlier or later than the least delayed one without a question
about the clock, and seconds for which all poses must do so together for a clock that was set."""
_LATEST, _MINUTE = 5.0, 60.0
"""Seconds by which no pose comes after newer ones: beyond, the capture's clock has begun anew.
Seconds after which the least delay is looked for again: quartz clocks part by 6 ms in that time at
most."""
_FARTHEST = 1e5
"""Metres beyond which a number is no position in a laboratory."""
_UNIT = 0.05
"""Difference of a quaternion's norm from 1 beyond which it is no attitude: some systems give a lost
body zeros; numbers rounded to two digits differ by less."""
CONNECT_TIMEOUT = 10.0
"""Seconds within which a laboratory's system must answer, which may be starting."""
_MODULE = "swarm.ground.mocap_child"
LABORATORY = (
    "vicon", "optitrack", "optitrack_closed_source", "qualisys", "nokov", "vrpn", "motionanalysis",
    "freemotion", "mock",
)  # fmt: skip
"""Systems that libmotioncapture reads, some of them only where it was built for them."""


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
        poses: dict[int, Pose] = {}
        while True:
            try:
                data = self._socket.recv(_LARGEST_DATAGRAM)
            except (BlockingIOError, ConnectionError):
                return poses.values()
            poses |= {pose.system: pose for pose in parse_frame(data)}

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
    return poses


def is_possible(pose: Pose) -> bool:
    """Return whether a pose can be that of a body in a laboratory, and be sent."""
    return (
        math.isfinite(pose.time)
        and all(abs(x) < _FARTHEST for x in pose.position)
        and abs(math.hypot(*pose.attitude) - 1.0) <= _UNIT
    )


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


def origin_of(fleet: Fleet) -> Origin:
    """Return the origin that vehicles of a fleet get."""
    place = fleet.origin
    return Origin(place.latitude, place.longitude, place.altitude or 0.0) if place else ANYWHERE


@dataclass
class _Seen:
    """When a body was first seen, its newest pose, when that last differed; times of the latest."""

    began: float
    pose: Pose
    changed: float
    times: "deque[float]" = field(default_factory=deque)

    def body(self, now: float) -> Body:
        """Return what has come of the body by ``now``."""
        latest = self.times[-1]
        # copied at once: another thread may add poses
        recent = [time for time in self.times.copy() if now - time <= _RATE_WINDOW]
        rate = (len(recent) - 1) / (latest - recent[0]) if len(recent) > 1 else 0.0
        return Body(self.pose, rate, now - latest, latest - self.changed)


@dataclass
class MocapBridge:
    """Sends each new pose to its vehicle, and an ``origin`` to vehicles that need one to arm.

    Poses that no body can have are left out, as if the body had not been seen.

    Poses are stamped in the time of ``now``, that in which a ground station sends TIMESYNC: PX4
    takes poses for what they say by that clock, and rejects those from the future. ``_behind`` is
    that time less the capture's, least over the poses of a minute or two: of the pose that was
    delayed least. Clocks part in hours, and the capture's may be set, or begin anew: then all poses
    come early, or late although the capture's own time went back. ``_aside`` is 1 while poses are
    late, -1 while they are early, since ``_since`` and by ``_least`` or more.
    With a ``sender``, system and component, packets have sequence numbers of their own.
    """

    capture: Capture
    team: Team
    origin: Origin = ANYWHERE
    sender: tuple[int, int] | None = None
    _next_origin: float = 0.0
    _seen: dict[int, _Seen] = field(default_factory=dict)
    _behind: float = math.inf
    _coming: float = math.inf
    _minute: float = 0.0
    _aside: int = 0
    _since: float = 0.0
    _least: float = math.inf
    _went_back: bool = False
    _missed: tuple[int, ...] = ()
    _encoders: dict[tuple[Any, ...], Encoder] = field(default_factory=dict)

    def packets(self, now: float) -> Iterator[Outgoing]:
        """Yield the packets that are due at ``now``."""
        for pose in filter(is_possible, self.capture.latest()):
            captured = self._captured(pose, now)
            self._note(pose, now)
            if not self._waits_for_origin(pose.system, now):
                yield from self.to_vehicle(pose.system, estimate(pose, captured))
        if now < self._next_origin:
            return
        self._next_origin = now + _ORIGIN_INTERVAL
        for system in self.team.vehicles:
            if self._lacks_origin(system):
                yield from self.to_vehicle(system, origin_message(system, self.origin))

    def _lacks_origin(self, system: int) -> bool:
        vehicle = self.team.vehicles.get(system)
        kind = vehicle.autopilot if vehicle is not None else None
        return kind is not None and kind.needs_origin and self.team.vehicles[system].origin is None

    def _waits_for_origin(self, system: int, now: float) -> bool:
        """Return whether a vehicle on the ground gets no poses yet.

        ArduCopter 4.6.2 that gets its origin while it follows poses is wrong in height from then on
        by its height at that moment.
        """
        began = self._seen[system].began
        on_ground = self._lacks_origin(system) and not self.team.vehicles[system].armed
        return on_ground and now - began < _ORIGIN_WAIT

    def _captured(self, pose: Pose, now: float) -> float:
        """Return when a pose was captured, in the time of ``now``.

        A single pose that is early or late moves no clock: the first was captured now at the
        latest, the second long ago. Poses that are late in their order were delayed.
        """
        behind = now - pose.time
        late = behind - self._behind
        before = self._seen.get(pose.system)
        went_back = before is not None and pose.time < before.pose.time
        if math.isinf(self._behind) or (went_back and late > _LATEST):
            self._set_clock(behind, now)
        elif self._stepped(behind, late, now, went_back=went_back):
            self._set_clock(self._least, now)
        elif self._aside >= 0:
            if now - self._minute > _MINUTE:
                self._behind, self._coming, self._minute = self._coming, behind, now
            self._behind, self._coming = min(self._behind, behind), min(self._coming, behind)
        return min(now, pose.time + self._behind)

    def _set_clock(self, behind: float, now: float) -> None:
        self._behind = self._coming = behind
        self._minute, self._aside = now, 0

    def _stepped(self, behind: float, late: float, now: float, *, went_back: bool) -> bool:
        """Return whether poses have come so early or late for long enough: a clock was set."""
        aside = 0 if abs(late) <= _STEP else 1 if late > 0.0 else -1
        if aside != self._aside:
            self._aside, self._since, self._least, self._went_back = aside, now, behind, False
        self._least = min(self._least, behind)
        self._went_back |= went_back
        return now - self._since >= _STEPPED and (aside < 0 or (aside > 0 and self._went_back))

    def _note(self, pose: Pose, now: float) -> None:
        seen = self._seen.setdefault(pose.system, _Seen(now, pose, now))
        if (pose.position, pose.attitude) != (seen.pose.position, seen.pose.attitude):
            seen.changed = now
        seen.pose = pose
        seen.times.append(now)
        while now - seen.times[0] > _RATE_WINDOW:
            seen.times.popleft()

    def bodies(self, now: float) -> Mapping[int, Body]:
        """Return what has come of each body, by the system id of its vehicle."""
        return {system: seen.body(now) for system, seen in list(self._seen.items())}

    def unseen(self, now: float) -> tuple[int, ...]:
        """Return the vehicles that have had poses, but none for UNSEEN seconds."""
        return tuple(
            sorted(
                system
                for system, seen in self._seen.items()
                if system in self.team.vehicles and now - seen.times[-1] > UNSEEN
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

    def to_vehicle(self, system: int, message: Any) -> Iterator[Outgoing]:
        """Yield the packet with a message for a vehicle, if it has been received."""
        route = self.team.way_to(system) if system in self.team.vehicles else None
        if route is not None:
            yield self.on_route(route, message)

    def on_route(self, route: Route, message: Any) -> Outgoing:
        """Return the packet with a message on a route."""
        encoder = route.encoder
        if self.sender is not None:
            way = route.link, route.address
            encoder = self._encoders.setdefault(way, Encoder(*self.sender))
        data = self.team.sealed(route.link, encoder.encode(message))
        return Outgoing(route.link, route.address, data)


def estimate(pose: Pose, at: float) -> Any:
    """Return a pose as VISION_POSITION_ESTIMATE of flight time ``at``: NED, FRD, radians."""
    east, north, up = pose.position
    norm = math.hypot(*pose.attitude)
    w, x, y, z = (value / norm for value in pose.attitude)
    roll = math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    pitch = -math.asin(min(1.0, max(-1.0, 2.0 * (w * y - z * x))))
    yaw = 0.5 * math.pi - math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    yaw = math.remainder(yaw, 2.0 * math.pi)
    unknown = [_UNKNOWN] * 21
    return common.MAVLink_vision_position_estimate_message(
        max(0, round(at * 1e6)), north, east, -up, roll, pitch, yaw, unknown, 0
    )


def origin_message(system: int, origin: Origin) -> Any:
    """Return SET_GPS_GLOBAL_ORIGIN for a vehicle."""
    return common.MAVLink_set_gps_global_origin_message(
        system, round(origin.latitude * 1e7), round(origin.longitude * 1e7),
        round(origin.altitude * 1e3), 0,
    )  # fmt: skip
