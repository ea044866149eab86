"""The process that reads a source of corrections: a caster, a serial port, UDP or a recording.

It passes on whole RTCM 3 messages whose checksum is right; :mod:`swarm.ground.corrections` is the
other side.
"""

import base64
import http.client
import socket
import ssl
import sys
import time
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, NoReturn
from urllib.parse import unquote, urlsplit

import serial
from pynmeagps import GET, NMEAMessage
from pyrtcm import RTCMReader, calc_crc24q

from swarm.errors import VehicleError, reason
from swarm.ground.child_process import die_with_parent

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
        pipe.send(("problem", words))
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
