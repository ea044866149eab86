"""Corrections of satellite positions (RTCM 3), from a base station to every vehicle's receiver.

A process of its own reads the source, so that a caster that answers slowly delays no setpoint. It
passes on whole messages whose checksum is right; the flight sends each of them once to every remote
address of the team's links, as GPS_RTCM_DATA, since the message names no vehicle.
"""

import base64
import http.client
import socket
import ssl
import sys
import time
from collections import deque
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, NoReturn
from urllib.parse import unquote, urlsplit

import serial
from pymavlink.dialects.v20 import common
from pynmeagps import GET, NMEAMessage
from pyrtcm import RTCMReader, calc_crc24q

from swarm.certification.findings import Finding
from swarm.errors import VehicleError, reason
from swarm.flight.router import Outgoing, Route, Team
from swarm.ground.child_process import ChildError, ChildProcess, die_with_parent
from swarm.mission.fleet import Fleet

FRAGMENT = 180
"""Bytes of one GPS_RTCM_DATA (MAVLink, common.xml)."""
_MOST_FRAGMENTS = 4
"""The number of a fragment has two bits (MAVLink, common.xml)."""
SILENCE = 5.0
"""Seconds without corrections that are reported: five epochs of a base that sends every second."""
_CONNECT_TIMEOUT = 10.0
"""Seconds in which a caster answers a request, over mobile networks too."""
_SILENT_SOURCE = 30.0
"""Seconds without a byte after which a connection is opened again."""
_RETRY = 2.0
"""Seconds between attempts: casters ban clients that ask many times a second."""
_POSITION_INTERVAL = 10.0
"""Seconds between reports of our position to a caster of virtual base stations."""
_EPOCH = 1.0
"""Seconds between the epochs of a recording, which begin with a type that was there before."""
_DEFAULT_BAUD = 115_200
_PORTS = {"ntrip": 2101, "ntrips": 443}
_EXPECTED = (
    "expected ntrip://[USER:PASSWORD@]HOST[:PORT]/MOUNTPOINT (ntrips: with TLS), "
    "serial://DEVICE[:BAUD], udp://HOST:PORT or file:PATH"
)


def parse_source(url: str) -> str:
    """Return the address of a source of corrections; raises `ValueError` for another text."""
    parts = urlsplit(url)
    try:
        port = parts.port if parts.scheme in ("udp", *_PORTS) else None
    except ValueError:
        port = 0
    fits = {
        "ntrip": bool(parts.hostname) and port != 0 and len(parts.path) > 1,
        "ntrips": bool(parts.hostname) and port != 0 and len(parts.path) > 1,
        "udp": bool(parts.hostname) and bool(port),
        "serial": len(url) > len("serial://"),
        "file": bool(parts.path),
    }
    if not fits.get(parts.scheme, False):
        raise ValueError(f"{_EXPECTED}, got {without_password(url)}")
    return url


def without_password(url: str) -> str:
    """Return an address without the name and the password in it, for messages and records."""
    scheme, separator, rest = url.partition("://")
    return scheme + separator + rest.rpartition("@")[2] if separator else url


def correction_messages(frame: bytes, sequence: int) -> list[Any]:
    """Return an RTCM message as GPS_RTCM_DATA messages, none where it is longer than 720 bytes.

    A receiver knows the last of fewer than four fragments by its length below 180 bytes, so that a
    message of 360 or 540 bytes ends with an empty fragment. ``sequence`` counts the messages that
    are sent in fragments.
    """
    if len(frame) > _MOST_FRAGMENTS * FRAGMENT:
        return []
    pieces = [frame[at : at + FRAGMENT] for at in range(0, len(frame), FRAGMENT)]
    fragmented = len(pieces) > 1
    if fragmented and len(pieces[-1]) == FRAGMENT and len(pieces) < _MOST_FRAGMENTS:
        pieces.append(b"")
    return [
        common.MAVLink_gps_rtcm_data_message(
            1 | number << 1 | (sequence & 0x1F) << 3 if fragmented else 0,
            len(piece),
            piece.ljust(FRAGMENT, b"\0"),
        )
        for number, piece in enumerate(pieces)
    ]


@dataclass(frozen=True)
class Received:
    """What has come from the source: message types, bit/s over the last seconds, and its age.

    ``age`` seconds since the newest message, None before the first. ``problem``: why there is none.
    ``too_long`` counts messages that GPS_RTCM_DATA cannot carry.
    """

    types: tuple[int, ...]
    rate: float
    age: float | None
    too_long: int
    problem: str = ""

    def words(self) -> str:
        """Return the state in words."""
        if self.age is None:
            return f"none received{f': {self.problem}' if self.problem else ''}"
        kinds = ", ".join(map(str, self.types))
        text = f"RTCM {kinds}, {self.rate / 1000.0:.1f} kbit/s, the newest {self.age:.1f} s old"
        if self.too_long:
            text += f"; {self.too_long} longer than {_MOST_FRAGMENTS * FRAGMENT} bytes: not sent"
        return text + (f"; {self.problem}" if self.problem else "")


class CorrectionSource:
    """The process that reads a source; it is started again if it ends."""

    def __init__(self, url: str, position: tuple[float, float, float] | None) -> None:
        """Start; ``position`` (degrees, degrees, metres) is reported to a caster."""
        self._given = url, position
        self.problem = ""
        self._start()

    def _start(self) -> None:
        self._child = ChildProcess("swarm.ground.corrections")
        self._child.send(self._given)

    def frames(self) -> Iterator[bytes]:
        """Yield the RTCM messages that have arrived."""
        try:
            while (message := next(self._child.receive(0.0), None)) is not None:
                kind, content = message
                self.problem = "" if kind == "frame" else content
                if kind == "frame":
                    yield content
        except ChildError as error:
            self.problem = str(error)
            self._child.close()
            self._start()

    def close(self) -> None:
        """End the process."""
        self._child.close()


@dataclass
class Corrections:
    """Sends the messages of a source to the vehicles, and reports when there are none."""

    source: CorrectionSource
    team: Team
    _sequence: int = 0
    _too_long: int = 0
    _types: dict[int, float] = field(default_factory=dict)
    _sizes: "deque[tuple[float, int]]" = field(default_factory=deque)
    _newest: float | None = None
    _silent: bool | None = None

    def packets(self, now: float) -> Iterator[Outgoing]:
        """Yield the packets that are due at ``now``."""
        for frame in self.source.frames():
            self._newest = now
            self._types[frame[3] << 4 | frame[4] >> 4] = now
            self._sizes.append((now, 8 * len(frame)))
            messages = correction_messages(frame, self._sequence)
            self._too_long += not messages
            self._sequence += len(messages) > 1
            for route in self._routes():
                for message in messages:
                    data = self.team.sealed(route.link, route.encoder.encode(message))
                    yield Outgoing(route.link, route.address, data)
        while self._sizes and now - self._sizes[0][0] > SILENCE:
            self._sizes.popleft()

    def _routes(self) -> Iterable[Route]:
        """Return the routes to all vehicles, each address of a link once."""
        routes = (self.team.way_to(system) for system in self.team.vehicles)
        return {(r.link, r.address): r for r in routes if r is not None}.values()

    def received(self, now: float) -> Received:
        """Return what has come from the source."""
        newest = self._newest
        types = sorted(kind for kind, at in self._types.items() if now - at <= 6.0 * SILENCE)
        rate = sum(size for _, size in self._sizes) / SILENCE
        age = None if newest is None else now - newest
        return Received(tuple(types), rate, age, self._too_long, self.source.problem)

    def finding(self, now: float) -> Finding:
        """Return what has come from the source as a finding of the ground check."""
        state = self.received(now)
        silent = state.age is None or state.age > SILENCE
        return Finding("error" if silent else "info", "corrections", state.words())

    def change(self, now: float) -> tuple[str, str] | None:
        """Return an event, kind and words, when corrections begin, stay away or come again."""
        state = self.received(now)
        silent = now > SILENCE if state.age is None else state.age > SILENCE
        if silent == self._silent or (self._silent is None and state.age is None and not silent):
            return None
        first, self._silent = self._silent is None, silent
        if not silent:
            return "corrections", state.words() if first else "received again: " + state.words()
        away = f"none for {SILENCE:g} s" if state.age is not None else state.words()
        return "corrections", f"{away}: receivers lose RTK fixed after a time of their own"

    def close(self) -> None:
        """End the process of the source."""
        self.source.close()


@contextmanager
def open_corrections(url: str | None, fleet: Fleet, team: Team) -> Iterator[Corrections | None]:
    """Open a source of corrections for a team, if there is one; its process ends with the block.

    Casters that compute a base station near the caller get the origin of the fleet file.
    """
    if url is None:
        yield None
        return
    place = fleet.origin
    position = (place.latitude, place.longitude, place.altitude or 0.0) if place else None
    corrections = Corrections(CorrectionSource(url, position), team)
    try:
        yield corrections
    finally:
        corrections.close()


# The process that reads the source


def read_source(url: str, position: tuple[float, float, float] | None, pipe: Connection) -> None:
    """Send ("frame", bytes) for each RTCM message, and ("problem", words) where none can come."""
    recorded = url.startswith("file:")
    while True:
        epoch: set[bytes] = set()
        try:
            for raw, _ in RTCMReader(_open(url, position), quitonerror=0, parsed=0):
                if calc_crc24q(raw):
                    continue
                if recorded and raw[3:5] in epoch:
                    time.sleep(_EPOCH)
                    epoch.clear()
                epoch.add(raw[3:5])
                pipe.send(("frame", bytes(raw)))
            words = "the source has ended"
        except (OSError, VehicleError, http.client.HTTPException) as error:
            words = reason(error) if isinstance(error, OSError) else str(error)
        pipe.send(("problem", f"{without_password(url)}: {words}"))
        if recorded:
            pipe.poll(None)  # old corrections are not sent again; wait for the end
            raise EOFError
        time.sleep(_RETRY)


def _open(url: str, position: tuple[float, float, float] | None) -> Any:
    """Return a source as a file or a socket."""
    parts = urlsplit(url)
    if parts.scheme == "file":
        return Path(unquote(parts.path)).open("rb")
    if parts.scheme == "serial":
        device, _, baud = url.removeprefix("serial://").partition(":")
        return serial.Serial(device, int(baud or _DEFAULT_BAUD), timeout=_SILENT_SOURCE)
    host = parts.hostname or ""
    if parts.scheme == "udp":
        address = socket.getaddrinfo(host, parts.port, type=socket.SOCK_DGRAM)[0]
        datagrams = socket.socket(*address[:2])
        datagrams.bind(address[4])
        return datagrams
    caster = socket.create_connection((host, parts.port or _PORTS[parts.scheme]), _CONNECT_TIMEOUT)
    if parts.scheme == "ntrips":
        caster = ssl.create_default_context().wrap_socket(caster, server_hostname=host)
    return _Caster(caster, url, position)


class _Caster:
    """The stream of an NTRIP caster, of version 1 (``ICY 200 OK``) or 2 (HTTP/1.1), as a file."""

    def __init__(
        self, connection: socket.socket, url: str, position: tuple[float, float, float] | None
    ) -> None:
        parts = urlsplit(url)
        self._socket, self._position, self._reported = connection, position, time.monotonic()
        lines = [
            f"GET {parts.path} HTTP/1.1",
            f"Host: {parts.hostname}:{parts.port or _PORTS[parts.scheme]}",
            "Ntrip-Version: Ntrip/2.0",
            "User-Agent: NTRIP swarm-ground-station",
            "Connection: close",
        ]
        if parts.username is not None:
            secret = f"{unquote(parts.username)}:{unquote(parts.password or '')}"
            lines.append(f"Authorization: Basic {base64.b64encode(secret.encode()).decode()}")
        if position is not None:
            lines.append(f"Ntrip-GGA: {_gga(position).decode().strip()}")
        connection.sendall(("\r\n".join(lines) + "\r\n\r\n").encode())
        plain = not isinstance(connection, ssl.SSLSocket)
        if plain and connection.recv(4, socket.MSG_PEEK | socket.MSG_WAITALL) != b"HTTP":
            self._stream: Any = connection.makefile("rb")
            status = self._stream.readline().decode("ascii", "replace").strip()
            if status.startswith("SOURCETABLE"):
                raise VehicleError(f"the caster has no mountpoint {parts.path[1:]}")
            if not status.startswith("ICY 200"):
                raise VehicleError(f"the caster answered: {status}")
            while self._stream.readline().strip():
                pass
        else:
            self._stream = http.client.HTTPResponse(connection)
            self._stream.begin()
            if self._stream.status != http.client.OK:
                words = f"{self._stream.status} {self._stream.reason}"
                raise VehicleError(f"the caster answered: {words}")
            if "sourcetable" in (self._stream.getheader("Content-Type") or ""):
                raise VehicleError(f"the caster has no mountpoint {parts.path[1:]}")
        connection.settimeout(_SILENT_SOURCE)
        if position is not None:
            connection.sendall(_gga(position))

    def read(self, size: int) -> bytes:
        """Return so many bytes, fewer at the end of the stream."""
        if self._position is not None and time.monotonic() - self._reported > _POSITION_INTERVAL:
            self._reported = time.monotonic()
            self._socket.sendall(_gga(self._position))
        return bytes(self._stream.read(size))

    def readline(self) -> bytes:
        """Return a line, which the reader takes for NMEA."""
        return bytes(self._stream.readline())


def _gga(position: tuple[float, float, float]) -> bytes:
    """Return a position as an NMEA sentence: degrees, degrees, metres."""
    latitude, longitude, altitude = position
    message = NMEAMessage(
        "GP", "GGA", GET, lat=latitude, lon=longitude, quality=1, numSV=12, HDOP=1.0, alt=altitude
    )
    return bytes(message.serialize())


def main() -> NoReturn:
    """Read the source in the first message until the other side is gone."""
    die_with_parent()
    with Connection(int(sys.argv[1])) as pipe:
        try:
            url, position = pipe.recv()
            read_source(url, position, pipe)
        except (BrokenPipeError, EOFError):
            pass
    sys.exit(0)


if __name__ == "__main__":
    main()
