"""The sockets and serial ports of a fleet's links: opened once, never waited for when sending."""

import errno
import fcntl
import os
import selectors
import socket
import struct
import termios
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

import serial

from swarm.errors import VehicleError
from swarm.flight.router import Outgoing

_LARGEST_DATAGRAM = 65_536
_RECEIVE_BUFFER = 1 << 21
_MOST_AT_ONCE = 512
"""Datagrams taken before the clock is looked at again: a flood must not hold the flight up."""
_CONNECT_TIMEOUT = 5.0
_MOST_UNSENT = 4096
"""Bytes that may wait in a connection's buffer: what waits longer would arrive stale."""
_LONGEST_UNSENT = 0.1
"""Seconds of a serial port's time that may wait in its buffer."""

Arrived = tuple[str, Any, bytes]


class Port(Protocol):
    """One open link; ``dropped`` counts what was not sent because it did not fit."""

    name: str
    dropped: int

    def fileno(self) -> int:
        """Return what can be waited for."""

    def send(self, outgoing: Outgoing) -> None:
        """Send at once or not at all: what cannot be sent now is counted and forgotten."""

    def receive(self) -> Iterator[Arrived]:
        """Yield what has arrived, up to a bound: link, address, bytes."""

    def close(self) -> None:
        """Close it."""


@dataclass
class Datagrams:
    """A UDP socket. ``address`` is None where datagrams come from many."""

    name: str
    socket: socket.socket
    address: Any = None
    dropped: int = 0

    def fileno(self) -> int:
        """Return the socket's descriptor."""
        return self.socket.fileno()

    def send(self, outgoing: Outgoing) -> None:
        """Send at once or not at all: what cannot be sent now is counted and forgotten."""
        try:
            address: Any = self.address or outgoing.address
            self.socket.sendto(outgoing.data, address)
        except OSError:
            self.dropped += 1

    def receive(self) -> Iterator[Arrived]:
        """Yield what has arrived, up to a bound: link, address, bytes."""
        for _ in range(_MOST_AT_ONCE):
            try:
                data, address = self.socket.recvfrom(_LARGEST_DATAGRAM)
            except BlockingIOError:
                return
            except OSError:
                # a port that nobody listens to answers with an error; it is silence, not an end
                continue
            yield self.name, None if self.address else address, data

    def close(self) -> None:
        """Close the socket."""
        self.socket.close()


@dataclass
class Stream:
    """A TCP connection or a serial port: bytes one after the other, no datagrams.

    A packet goes out whole or not at all: what is left of one is sent before the next, and while
    more than ``most_unsent`` bytes wait in the buffer the next ones are dropped.
    """

    name: str
    device: Any
    most_unsent: int
    dropped: int = 0
    _rest: bytes = b""

    def fileno(self) -> int:
        """Return the device's descriptor."""
        return int(self.device.fileno())

    def send(self, outgoing: Outgoing) -> None:
        """Send at once or not at all: what cannot be sent now is counted and forgotten."""
        try:
            self.flush()
            if self._rest or self._unsent() > self.most_unsent:
                self.dropped += 1
            else:
                self._rest = self._written(outgoing.data)
                if self._rest == outgoing.data:
                    self._rest = b""
                    self.dropped += 1
        except OSError:
            self._rest = b""
            self.dropped += 1

    def flush(self) -> None:
        """Send what is left of a packet, as far as that goes now."""
        self._rest = self._written(self._rest)

    def _written(self, data: bytes) -> bytes:
        """Write what can be written now; return what is left."""
        if not data:
            return b""
        try:
            return data[os.write(self.fileno(), data) :]
        except BlockingIOError:
            return data

    def _unsent(self) -> int:
        (waiting,) = struct.unpack("i", fcntl.ioctl(self.fileno(), termios.TIOCOUTQ, bytes(4)))
        return int(waiting)

    def receive(self) -> Iterator[Arrived]:
        """Yield what has arrived; nothing where the other end is gone."""
        try:
            data = os.read(self.fileno(), _LARGEST_DATAGRAM)
        except OSError:
            return
        if data:
            yield self.name, None, data

    def close(self) -> None:
        """Close the connection."""
        self.device.close()


@dataclass
class Links:
    """The open links of a fleet."""

    ports: Mapping[str, Port]
    # select() waits for microseconds; epoll and poll for whole milliseconds, rounded up, which is
    # more than a setpoint may be late
    _selector: selectors.BaseSelector = field(default_factory=selectors.SelectSelector)

    def __post_init__(self) -> None:
        for one in self.ports.values():
            self._selector.register(one.fileno(), selectors.EVENT_READ, one)

    def port(self, name: str) -> int:
        """Return the local port of a UDP link."""
        one = self.ports[name]
        if not isinstance(one, Datagrams):
            raise VehicleError(f"link {name} has no UDP port")
        return int(one.socket.getsockname()[1])

    def wait(self, timeout: float) -> Iterator[Arrived]:
        """Wait at most so many seconds for something to arrive, and yield all that has."""
        for key, _ in self._selector.select(max(0.0, timeout)):
            silent = True
            for arrived in key.data.receive():
                silent = False
                yield arrived
            if silent and isinstance(key.data, Stream):
                # readable and nothing to read: the other end is gone, and would be so for ever
                self._selector.unregister(key.fileobj)

    def send(self, outgoing: Iterable[Outgoing]) -> None:
        """Send what the conductor wants sent."""
        for one in outgoing:
            self.ports[one.link].send(one)

    def dropped(self) -> dict[str, int]:
        """Return how many packets did not fit, by link."""
        return {name: one.dropped for name, one in self.ports.items()}

    def close(self) -> None:
        """Close everything."""
        self._selector.close()
        for one in self.ports.values():
            one.close()


def open_links(urls: Mapping[str, str]) -> Links:
    """Open links by URL; raises :class:`VehicleError` that names each that cannot be opened."""
    opened: dict[str, Port] = {}
    problems: list[str] = []
    for name, url in urls.items():
        try:
            opened[name] = _open(name, url)
        except OSError as error:
            reason = _reason(error)
            problems.append(f"link {name} ({url}) cannot be opened: {reason}")
    if problems:
        for one in opened.values():
            one.close()
        raise VehicleError("\n".join(problems))
    return Links(opened)


def _reason(error: OSError) -> str:
    known = os.strerror(error.errno) if error.errno else error.strerror
    return (known or str(error)).lower()


def _open(name: str, url: str) -> Port:
    kind, _, rest = url.partition("://")
    host, _, port = rest.rpartition(":")
    if kind == "serial":
        return _serial(name, host, int(port))
    address = (host.strip("[]"), int(port))
    family, _, _, _, found = socket.getaddrinfo(*address, type=socket.SOCK_DGRAM)[0]
    if kind == "tcp":
        stream = socket.create_connection(address, timeout=_CONNECT_TIMEOUT)
        stream.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        stream.setblocking(False)
        return Stream(name, stream, _MOST_UNSENT)
    datagrams = socket.socket(family, socket.SOCK_DGRAM)
    try:
        datagrams.setblocking(False)
        datagrams.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BUFFER)
        if kind == "udpin":
            datagrams.bind(found)
            return Datagrams(name, datagrams)
        datagrams.bind(("", 0))
        return Datagrams(name, datagrams, address=found)
    except OSError:
        datagrams.close()
        raise


def _serial(name: str, device: str, baud: int) -> Stream:
    """Open a serial port for us alone, 8N1, without flow control."""
    try:
        port = serial.Serial(device, baud, timeout=0, write_timeout=0, exclusive=True)
    except ValueError as error:
        raise OSError(errno.EINVAL, str(error)) from None
    os.set_blocking(port.fileno(), False)
    port.reset_input_buffer()
    return Stream(name, port, max(256, int(_LONGEST_UNSENT * baud / 10)))
