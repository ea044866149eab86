"""The sockets and serial ports of a fleet's links. Sending never blocks."""

import errno
import fcntl
import os
import selectors
import socket
import struct
import termios
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import serial

from swarm.errors import VehicleError, reason
from swarm.flight.router import Outgoing

_LARGEST_DATAGRAM = 65_536
_RECEIVE_BUFFER = 1 << 21
_MAX_DATAGRAMS = 512
"""Datagrams that are read before the clock is checked: a flood must not delay the flight."""
_CONNECT_TIMEOUT = 5.0
_MAX_UNSENT = 4096
"""Bytes that may wait in the buffer of a connection; with more, setpoints would arrive stale."""
_MAX_UNSENT_TIME = 0.1
"""Seconds of transmission that may wait in the buffer of a serial port."""

Received = tuple[str, Any, bytes]


@dataclass
class Datagrams:
    """A UDP socket; ``address`` is that of the only peer, or None.

    ``dropped`` counts packets that were not sent because the buffer was full.
    """

    name: str
    socket: socket.socket
    address: Any = None
    dropped: int = 0

    def fileno(self) -> int:
        """Return the socket's descriptor."""
        return self.socket.fileno()

    def send(self, outgoing: Outgoing) -> None:
        """Send without blocking; a packet that cannot be sent now is dropped and counted."""
        try:
            address: Any = self.address or outgoing.address
            self.socket.sendto(outgoing.data, address)
        except OSError:
            self.dropped += 1

    def receive(self) -> Iterator[Received]:
        """Yield link, address and bytes of received data, up to a bound."""
        for _ in range(_MAX_DATAGRAMS):
            try:
                data, address = self.socket.recvfrom(_LARGEST_DATAGRAM)
            except BlockingIOError:
                return
            except OSError:
                # an unused port answers with an error: treat it as silence, not as the end
                continue
            yield self.name, None if self.address else address, data

    def close(self) -> None:
        """Close the socket."""
        self.socket.close()

    def described(self) -> dict[str, Any]:
        """Return what another process needs beside the descriptor, see :func:`borrowed_links`."""
        return {"name": self.name, "address": self.address}


@dataclass
class Stream:
    """A TCP connection or a serial port: a stream of bytes without datagrams.

    A packet is sent whole or not at all: the rest of a packet is sent before the next one. While
    more than ``max_unsent`` bytes wait in the buffer, packets are dropped.
    """

    name: str
    device: Any
    max_unsent: int
    dropped: int = 0
    _rest: bytes = b""

    def fileno(self) -> int:
        """Return the device's descriptor."""
        return int(self.device.fileno())

    def send(self, outgoing: Outgoing) -> None:
        """Send without blocking; a packet that cannot be sent now is dropped and counted."""
        try:
            self.flush()
            if self._rest or self._unsent() > self.max_unsent:
                self.dropped += 1
            else:
                self._rest = self._write(outgoing.data)
                if self._rest == outgoing.data:
                    self._rest = b""
                    self.dropped += 1
        except OSError:
            self._rest = b""
            self.dropped += 1

    def flush(self) -> None:
        """Send as much of the rest of a packet as fits now."""
        self._rest = self._write(self._rest)

    def _write(self, data: bytes) -> bytes:
        """Write without blocking; return the bytes that did not fit."""
        if not data:
            return b""
        try:
            return data[os.write(self.fileno(), data) :]
        except BlockingIOError:
            return data

    def _unsent(self) -> int:
        (waiting,) = struct.unpack("i", fcntl.ioctl(self.fileno(), termios.TIOCOUTQ, bytes(4)))
        return int(waiting)

    def receive(self) -> Iterator[Received]:
        """Yield received data; none if the connection is closed."""
        try:
            data = os.read(self.fileno(), _LARGEST_DATAGRAM)
        except OSError:
            return
        if data:
            yield self.name, None, data

    def close(self) -> None:
        """Close the connection."""
        self.device.close()

    def described(self) -> dict[str, Any]:
        """Return what another process needs beside the descriptor, see :func:`borrowed_links`."""
        return {"name": self.name, "max_unsent": self.max_unsent}


Port = Datagrams | Stream


@dataclass
class Links:
    """The open links of a fleet."""

    ports: Mapping[str, Port]
    # select() has a resolution of microseconds; epoll and poll round up to whole milliseconds,
    # which is more than a setpoint may be late
    _selector: selectors.BaseSelector = field(default_factory=selectors.SelectSelector)

    def __post_init__(self) -> None:
        for port in self.ports.values():
            self._selector.register(port.fileno(), selectors.EVENT_READ, port)

    def port(self, name: str) -> int:
        """Return the local port of a UDP link."""
        port = self.ports[name]
        if not isinstance(port, Datagrams):
            raise VehicleError(f"link {name} has no UDP port")
        return int(port.socket.getsockname()[1])

    def wait(self, timeout: float) -> Iterator[Received]:
        """Wait at most ``timeout`` seconds for data, and yield all received data."""
        for key, _ in self._selector.select(max(0.0, timeout)):
            empty = True
            for received in key.data.receive():
                empty = False
                yield received
            if empty and isinstance(key.data, Stream):
                # readable but empty: the connection is closed, and would stay readable
                self._selector.unregister(key.fileobj)

    def send(self, outgoing: Iterable[Outgoing]) -> None:
        """Send packets, each on its link."""
        for packet in outgoing:
            self.ports[packet.link].send(packet)

    def dropped(self) -> dict[str, int]:
        """Return the number of dropped packets by link."""
        return {name: port.dropped for name, port in self.ports.items()}

    def close(self) -> None:
        """Close all links."""
        self._selector.close()
        for port in self.ports.values():
            port.close()


def open_links(urls: Mapping[str, str]) -> Links:
    """Open links by URL; raises :class:`VehicleError` with every link that cannot be opened."""
    opened: dict[str, Port] = {}
    problems: list[str] = []
    for name, url in urls.items():
        try:
            opened[name] = _open(name, url)
        except (OSError, UnicodeError) as error:  # the latter for no name of a host
            problems.append(f"link {name} ({url}) cannot be opened: {reason(error)}")
    if problems:
        for port in opened.values():
            port.close()
        raise VehicleError("\n".join(problems))
    return Links(opened)


def borrowed_links(described: Iterable[Mapping[str, Any]], descriptors: Iterable[int]) -> Links:
    """Return links that another process has opened and described; each has a descriptor here.

    Only one process may receive on them; both may send.
    """
    ports: dict[str, Port] = {}
    for words, descriptor in zip(described, descriptors, strict=True):
        name = words["name"]
        if "max_unsent" in words:
            device = os.fdopen(descriptor, "r+b", buffering=0)
            ports[name] = Stream(name, device, words["max_unsent"])
        else:
            address = words["address"]
            datagrams = socket.socket(fileno=descriptor)
            ports[name] = Datagrams(name, datagrams, tuple(address) if address else None)
    return Links(ports)


def _open(name: str, url: str) -> Port:
    kind, _, rest = url.partition("://")
    host, _, port = rest.rpartition(":")
    if kind == "serial":
        return _serial(name, host, int(port))
    address = (host.strip("[]"), int(port))
    family, _, _, _, resolved = socket.getaddrinfo(*address, type=socket.SOCK_DGRAM)[0]
    if kind == "tcp":
        stream = socket.create_connection(address, timeout=_CONNECT_TIMEOUT)
        stream.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        stream.setblocking(False)
        return Stream(name, stream, _MAX_UNSENT)
    datagrams = socket.socket(family, socket.SOCK_DGRAM)
    try:
        datagrams.setblocking(False)
        datagrams.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BUFFER)
        if kind == "udpin":
            datagrams.bind(resolved)
            return Datagrams(name, datagrams)
        datagrams.bind(("", 0))
        return Datagrams(name, datagrams, address=resolved)
    except OSError:
        datagrams.close()
        raise


def _serial(name: str, device: str, baud: int) -> Stream:
    """Open a serial port exclusively, 8N1, without flow control."""
    try:
        port = serial.Serial(device, baud, timeout=0, write_timeout=0, exclusive=True)
    except ValueError as error:
        raise OSError(errno.EINVAL, str(error)) from None
    os.set_blocking(port.fileno(), False)
    port.reset_input_buffer()
    return Stream(name, port, max(256, int(_MAX_UNSENT_TIME * baud / 10)))
