"""The emulator in real time, or faster: UDP and TCP sockets on loopback, one loop.

The ports are those of the real simulators, or all vehicles send to one target address.
"""

import contextlib
import gc
import json
import math
import mmap
import os
import select
import signal
import socket
import struct
import sys
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TextIO

import numpy as np

from sitl.autopilots import telemetry
from sitl.emulator import Emulator, Truth
from sitl.physics.dynamics import STEP
from sitl.protocol.vehicle import Vehicle
from sitl.protocol.wire import Link

OFFBOARD, OFFBOARD_LOCAL, GROUND, GROUND_LOCAL, TCP = 14540, 14580, 14550, 18570, 5760
"""Ports of PX4's and ArduPilot's simulators."""
_LARGEST_DATAGRAM = 65535
_LARGEST_LAG = 0.25
"""Delay in seconds beyond which emulated time falls behind real time."""
_LARGEST_LAG_FOLLOWED = 0.05
"""The same where a ground station follows emulated time: faster than real time, packets wait."""
_TRUTH_INTERVAL = 0.1
_BUFFER = 1 << 20
_CLOCK = struct.Struct("<dd")
_TIME = struct.Struct("<d")
_PATIENCE = 2.0
"""Seconds of real time for which the world waits for a ground station that follows it: one that is
killed does not come back, and its vehicles' failsafes are to be seen."""


class MotionCapture:
    """The vehicles' true poses in an emulated laboratory, late and noisy as the world says, by UDP.

    Faults of the kind ``capture`` change what is seen of a vehicle. One JSON datagram for each
    frame, every step of the world: ``{"time": seconds, "bodies": {"1": [x, y, z, qw, qx, qy,
    qz]}}``: system ids; world ENU, body FLU.
    """

    def __init__(self, emulator: Emulator, target: tuple[str, int]) -> None:
        self._emulator, self._target = emulator, target
        self._delay, self._noise = emulator.world.capture.delay, emulator.world.capture.noise
        self._rng = np.random.default_rng([emulator.world.seed, len(emulator.vehicles)])
        self._waiting: deque[tuple[float, bytes]] = deque()
        self._frozen: dict[int, list[float]] = {}
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)

    def send(self) -> None:
        """Capture a frame, and send those that are due."""
        now = self._emulator.time
        self._waiting.append((now + self._delay, self.frame()))
        while self._waiting and self._waiting[0][0] <= now + 1e-9:
            _, data = self._waiting.popleft()
            try:
                self._socket.sendto(data, self._target)
            except (BlockingIOError, ConnectionError):
                continue

    def frame(self) -> bytes:
        """Return the present frame."""
        b, outside = self._emulator.bodies, self._emulator.outside
        position = b.position + self._noise * self._rng.standard_normal((b.count, 3))
        attitude = np.array([_attitude(vehicle) for vehicle in self._emulator.vehicles])
        if outside is not None:
            attitude[outside.rows] = outside.state[:, 6:10]
        rows = np.hstack([position, attitude]).round(6).tolist()
        ids = [vehicle.system for vehicle in self._emulator.vehicles]
        seen = self._as_seen(dict(zip(ids, rows, strict=True)))
        frame = {"time": self._emulator.time, "bodies": {str(k): row for k, row in seen.items()}}
        return json.dumps(frame).encode("ascii")

    def _as_seen(self, bodies: dict[int, list[float]]) -> dict[int, list[float]]:
        """Return the poses [x, y, z, qw, qx, qy, qz] of bodies with the errors of the system."""
        active = self._emulator.injector.active
        faults = [(fault, system) for fault, system in active if fault.kind == "capture"]
        frozen = {system for fault, system in faults if fault.error == "frozen"}
        self._frozen = {system: self._frozen.get(system, bodies[system]) for system in frozen}
        for fault, system in faults:
            x, y, z, qw, qx, qy, qz = bodies.get(system, [0.0] * 7)
            if fault.error == "lost":
                bodies.pop(system, None)
            elif fault.error == "frozen":
                bodies[system] = self._frozen[system]
            elif fault.error == "mirrored":
                bodies[system] = [-x, y, z, qw, qx, -qy, -qz]
            elif fault.error == "flipping" and self._emulator.time % 1.0 < 0.5:
                bodies[system] = [x, y, z, -qz, qy, -qx, qw]
            elif fault.error == "turned":
                w, v = math.sqrt(0.5), math.sqrt(0.5)
                turned = [w * qw - v * qz, w * qx + v * qy, w * qy - v * qx, w * qz + v * qw]
                bodies[system] = [x, y, z, *turned]
            elif fault.error == "swapped" and {system, fault.body} <= set(bodies):
                other = int(fault.body or 0)
                bodies[system], bodies[other] = bodies[other], bodies[system]
        return bodies

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


def _attitude(vehicle: Vehicle) -> tuple[float, float, float, float]:
    """Return the quaternion (w, x, y, z) of a vehicle's attitude: world ENU, body FLU."""
    roll, pitch, yaw = telemetry.attitude(vehicle)
    return telemetry.quaternion(roll, -pitch, 0.5 * math.pi - yaw)


@dataclass
class Endpoint:
    """The socket of one link of one vehicle."""

    socket: socket.socket
    vehicle: Vehicle
    link: Link
    peer: tuple[str, int] | None
    stream: bool = False


class Server:
    """Connects an `Emulator` to sockets and the wall clock.

    ``advance`` takes the world to a time; ``clock`` gets the world's time after every step, as a
    little-endian double. The ground station that follows it may write a second one behind it: the
    time up to which the world may go on. ``capture`` sends the vehicles' poses.
    """

    def __init__(self, emulator: Emulator, host: str, speed: float) -> None:
        self.emulator = emulator
        self.advance = emulator.advance
        self.clock: mmap.mmap | None = None
        self._allowed, self._allowed_at = 0.0, 0.0
        self.capture: MotionCapture | None = None
        self.host = host
        self.speed = speed
        self.endpoints: dict[int, Endpoint] = {}
        self.listeners: dict[int, tuple[socket.socket, Vehicle]] = {}
        self.by_link: dict[int, Endpoint] = {}
        self.poll = select.poll()
        self.stopped = False
        self.description: list[dict[str, Any]] = []

    def describe(self, vehicle: Vehicle) -> dict[str, Any]:
        """Add a vehicle to the description of the connections; return its entry."""
        entry: dict[str, Any] = {"id": vehicle.system, "autopilot": vehicle.spec.autopilot}
        if not vehicle.links:
            entry["firmware"] = True
        self.description.append(entry)
        return entry

    def udp(
        self, vehicle: Vehicle, link: Link, peer: tuple[str, int] | None, local: int = 0
    ) -> int:
        """Open a UDP socket for a link that sends to ``peer``; return the local port."""
        sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        sock.setblocking(False)
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER)
        _bind(sock, self.host, local)
        self._add(Endpoint(sock, vehicle, link, peer))
        return int(sock.getsockname()[1])

    def listen(self, vehicle: Vehicle, port: int) -> None:
        """Accept TCP connections to a vehicle."""
        sock = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        _bind(sock, self.host, port)
        sock.listen(4)
        sock.setblocking(False)
        self.listeners[sock.fileno()] = (sock, vehicle)
        self.poll.register(sock, select.POLLIN)

    def _add(self, endpoint: Endpoint) -> None:
        descriptor = endpoint.socket.fileno()
        self.endpoints[descriptor] = endpoint
        self.by_link[id(endpoint.link)] = endpoint
        self.poll.register(descriptor, select.POLLIN)

    def _accept(self, descriptor: int) -> None:
        listener, vehicle = self.listeners[descriptor]
        with contextlib.suppress(OSError):
            sock, _ = listener.accept()
            sock.setblocking(False)
            sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            link = self.emulator.open_link(vehicle, "gcs")
            self._add(Endpoint(sock, vehicle, link, None, stream=True))

    def _drop(self, endpoint: Endpoint) -> None:
        descriptor = endpoint.socket.fileno()
        self.poll.unregister(descriptor)
        del self.endpoints[descriptor]
        del self.by_link[id(endpoint.link)]
        endpoint.socket.close()
        self.emulator.close_link(endpoint.vehicle, endpoint.link)

    def _receive(self, descriptor: int, now: float) -> None:
        endpoint = self.endpoints.get(descriptor)
        if endpoint is None:
            self._accept(descriptor)
            return
        while True:
            try:
                if endpoint.stream:
                    data = endpoint.socket.recv(_LARGEST_DATAGRAM)
                    if not data:
                        self._drop(endpoint)
                        return
                else:
                    data, endpoint.peer = endpoint.socket.recvfrom(_LARGEST_DATAGRAM)
            except BlockingIOError:
                return
            except ConnectionError:
                if endpoint.stream:
                    self._drop(endpoint)
                    return
                continue
            self.emulator.deliver(endpoint.vehicle, endpoint.link, data, now)

    def _answer(self, ready: Sequence[tuple[int, int]], now: float) -> None:
        """Receive what has arrived on descriptors, and send the answers at once."""
        for descriptor, _ in ready:
            self._receive(descriptor, now)
            if descriptor in self.endpoints:
                self._send_answer(self.endpoints[descriptor])

    def _flush(self) -> None:
        """Send all waiting frames."""
        for _, link, data in self.emulator.collect():
            endpoint = self.by_link.get(id(link))
            if endpoint is not None:
                self._send(endpoint, data)

    def _send_answer(self, endpoint: Endpoint) -> None:
        """Send the answer of a vehicle immediately, unless a fault may delay it."""
        link = endpoint.link
        if link.outgoing and not self.emulator.injector.link_faults and not endpoint.vehicle.frozen:
            self._send(endpoint, b"".join(link.outgoing))
            link.outgoing.clear()

    def _send(self, endpoint: Endpoint, data: bytes) -> None:
        try:
            if endpoint.stream:
                endpoint.socket.send(data)
            elif endpoint.peer is not None:
                endpoint.socket.sendto(data, endpoint.peer)
        except BlockingIOError:
            return
        except OSError:
            if endpoint.stream:
                self._drop(endpoint)

    def run(self, on_truth: Callable[[Truth], None] | None, parent: int | None) -> None:
        """Run until `stop`, or until the parent process has changed."""
        emulator = self.emulator
        start = time.monotonic() - emulator.time / self.speed
        next_truth = 0.0
        largest_lag = _LARGEST_LAG if self.clock is None else _LARGEST_LAG_FOLLOWED
        gc.collect()
        gc.freeze()
        while not self.stopped:
            due = start + (emulator.time + STEP) / self.speed
            wait = due - time.monotonic()
            if wait > 0:
                ready = self.poll.poll(wait * 1000.0)
                if ready:
                    # not beyond the next step, however long this process was held up here
                    elapsed = (time.monotonic() - start) * self.speed
                    now = min(max(emulator.time, elapsed), emulator.time + STEP)
                    self._answer(ready, now)
                    continue
            elif wait < -largest_lag:
                start -= wait
            else:
                for descriptor, _ in self.poll.poll(0):
                    self._receive(descriptor, emulator.time)
            if self._waits():
                held = time.monotonic()
                self._answer(self.poll.poll(1), emulator.time)
                start += time.monotonic() - held
                continue
            self.advance(emulator.time + STEP)
            if self.clock is not None:
                _TIME.pack_into(self.clock, 0, emulator.time)
            if self.capture is not None:
                self.capture.send()
            self._flush()
            if on_truth is not None and emulator.time >= next_truth:
                on_truth(emulator.truth())
                next_truth = emulator.time + _TRUTH_INTERVAL - 1e-6
            if parent is not None and os.getppid() != parent:
                return

    def _waits(self) -> bool:
        """Return whether the ground station that follows this world's time is late."""
        if self.clock is None:
            return False
        _, allowed = _CLOCK.unpack_from(self.clock)
        moment = time.monotonic()
        if allowed != self._allowed:
            self._allowed, self._allowed_at = allowed, moment
        late = 0.0 < allowed <= self.emulator.time
        return late and moment - self._allowed_at < _PATIENCE

    def stop(self, *_: Any) -> None:
        """End `run` at its next step; a signal handler."""
        self.stopped = True

    def close(self) -> None:
        """Close every socket."""
        if self.capture is not None:
            self.capture.close()
        for endpoint in self.endpoints.values():
            endpoint.socket.close()
        for listener, _ in self.listeners.values():
            listener.close()


def _bind(sock: socket.socket, host: str, port: int) -> None:
    """Bind a socket; raises `OSError` that names the port where another program uses it."""
    try:
        sock.bind((host, port))
    except OSError as error:
        sock.close()
        raise OSError(error.errno, f"port {port}: {error.strerror}") from None


def open_clock(path: Path) -> mmap.mmap:
    """Return the memory of a new file for `Server.clock`; raises `OSError`."""
    with path.open("w+b") as file:
        file.truncate(_CLOCK.size)
        return mmap.mmap(file.fileno(), _CLOCK.size)


def to_target(emulator: Emulator, target: tuple[str, int], host: str, speed: float) -> Server:
    """Return a server that sends from one ephemeral UDP port per vehicle to one address."""
    server = Server(emulator, host, speed)
    for vehicle in emulator.vehicles:
        entry = server.describe(vehicle)
        if vehicle.links:
            entry["udp_local"] = server.udp(vehicle, vehicle.links[0], target)
        entry["udp_to"] = f"{target[0]}:{target[1]}"
    return server


def to_default_ports(emulator: Emulator, host: str, speed: float, port_step: int | None) -> Server:
    """Return a server on the ports of the real simulators.

    PX4 number i (from 0) sends to UDP 14540 + i, from the tenth on to 14549, or to
    14540 + i·step; all send to 14550 too. ArduPilot sends to 14550 and listens on TCP 5760 + 10 i.
    Raises `OSError` where another program uses one of the ports.
    """
    server = Server(emulator, host, speed)
    try:
        _open_default_ports(server, host, port_step)
    except OSError:
        server.close()
        raise
    return server


def _open_default_ports(server: Server, host: str, port_step: int | None) -> None:
    for i, vehicle in enumerate(server.emulator.vehicles):
        entry = server.describe(vehicle)
        if vehicle.links and vehicle.is_px4:
            offset = min(i, 9) if port_step is None else i * port_step
            server.udp(vehicle, vehicle.links[0], (host, OFFBOARD + offset), OFFBOARD_LOCAL + i)
            entry["udp_to"] = f"{host}:{OFFBOARD + offset}"
            ground = server.emulator.open_link(vehicle, "gcs")
            server.udp(vehicle, ground, (host, GROUND), GROUND_LOCAL + i)
        elif vehicle.links:
            server.udp(vehicle, vehicle.links[0], (host, GROUND))
            server.listen(vehicle, TCP + 10 * i)
            entry["tcp"] = f"{host}:{TCP + 10 * i}"
        entry["udp_ground"] = f"{host}:{GROUND}"


def truth_line(truth: Truth) -> str:
    """Return ground truth as one JSON line (NaN as null).

    Cable is rounded to 0.1 mm: it is most of the line.
    """
    data: dict[str, Any] = {}
    for name, value in vars(truth).items():
        if name in {"contacts", "strikes", "events"}:
            data[name] = len(value)
        elif name == "cable":
            data[name] = value.round(4).tolist()
        elif hasattr(value, "tolist"):
            data[name] = value.tolist()
        else:
            data[name] = value
    data["grip_arc"] = [None if math.isnan(arc) else arc for arc in data["grip_arc"]]
    return json.dumps(data)


def truth_writer(file: TextIO) -> Callable[[Truth], None]:
    """Return a function that writes truth as JSON lines, each event and contact once."""
    seen = {"events": 0, "contacts": 0, "strikes": 0}

    def write(truth: Truth) -> None:
        for kind in seen:
            items = getattr(truth, kind)
            for item in items[seen[kind] :]:
                file.write(json.dumps({"record": kind, **item}) + "\n")
            seen[kind] = len(items)
        file.write(truth_line(truth) + "\n")
        file.flush()

    return write


_PHRASES = {
    "udp_local": "on UDP port {}",
    "tcp": "listens on TCP {}",
    "udp_to": "offboard client on UDP {}",
    "udp_ground": "ground station on UDP {}",
}


def connect_help(server: Server) -> str:
    """Return instructions for connecting the usual clients to ``server``."""
    lines = [
        f"{entry['id']:>4}  {entry['autopilot']:<9}  "
        + ", ".join(phrase.format(entry[key]) for key, phrase in _PHRASES.items() if entry.get(key))
        for entry in server.description
    ]
    first = server.description[0]
    tcp = [entry["tcp"] for entry in server.description if entry.get("tcp")]
    ground = first.get("udp_ground") or first["udp_to"]
    if "udp_to" in first or not tcp:
        address = first.get("udp_to", ground)
        which = "all vehicles" if address == ground else f"vehicle {first['id']}"
        mavsdk = f"udpin://{address} ({which})"
    else:
        mavsdk = f"tcpout://{tcp[0]}"
    port = int(ground.rpartition(":")[2])
    lines += [
        "",
        f"MAVSDK          {mavsdk}",
        f"MAVProxy        mavproxy.py --master={f'tcp:{tcp[0]}' if tcp else f'udpin:{ground}'}",
        "QGroundControl  finds all vehicles automatically (UDP 14550)"
        if port == GROUND
        else f"QGroundControl  needs a UDP link on port {port} (Application Settings, Comm Links)",
    ]
    return "\n".join(lines)


def serve(server: Server, truth: Path | None, *, as_json: bool, parent: int | None) -> None:
    """Run a server until a signal, or the end of the process ``parent``, ends it."""
    signal.signal(signal.SIGINT, server.stop)
    signal.signal(signal.SIGTERM, server.stop)
    with contextlib.ExitStack() as stack:
        stack.callback(server.close)
        writer = None
        if truth is not None:
            writer = truth_writer(stack.enter_context(truth.open("w")))
        if as_json:
            ready = {"ready": True, "speed": server.speed, "vehicles": server.description}
            line = json.dumps(ready)
        else:
            line = f"{len(server.description)} emulated vehicles\n{connect_help(server)}"
        sys.stdout.write(line + "\n")
        sys.stdout.flush()
        server.run(writer, parent)
