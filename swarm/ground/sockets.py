"""The sockets of a fleet's links: opened once, never waited for when sending."""

import selectors
import socket
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from swarm.errors import VehicleError
from swarm.flight.team import Outgoing

_LARGEST_DATAGRAM = 65_536
_RECEIVE_BUFFER = 1 << 21
_MOST_AT_ONCE = 512
"""Datagrams taken before the clock is looked at again: a flood must not hold the flight up."""
_CONNECT_TIMEOUT = 5.0


@dataclass
class Socket:
    """One link's socket. ``address`` is None where datagrams come from many."""

    name: str
    socket: socket.socket
    address: Any = None
    stream: bool = False
    dropped: int = 0

    def send(self, outgoing: Outgoing) -> None:
        """Send at once or not at all: what cannot be sent now is counted and forgotten."""
        try:
            if self.stream:
                sent = self.socket.send(outgoing.data)
                self.dropped += sent < len(outgoing.data)
            else:
                address: Any = self.address or outgoing.address
                self.socket.sendto(outgoing.data, address)
        except OSError:
            self.dropped += 1

    def receive(self) -> Iterator[tuple[str, Any, bytes]]:
        """Yield what has arrived, up to a bound: link, address, bytes."""
        for _ in range(_MOST_AT_ONCE):
            try:
                data, address = self.socket.recvfrom(_LARGEST_DATAGRAM)
            except BlockingIOError:
                return
            except OSError:
                # a port that nobody listens to answers with an error; it is silence, not an end
                continue
            if self.stream and not data:
                return
            yield self.name, None if self.address or self.stream else address, data


@dataclass
class Links:
    """The open links of a fleet."""

    sockets: Mapping[str, Socket]
    _selector: selectors.BaseSelector = field(default_factory=selectors.DefaultSelector)

    def __post_init__(self) -> None:
        for one in self.sockets.values():
            self._selector.register(one.socket, selectors.EVENT_READ, one)

    def port(self, name: str) -> int:
        """Return the local port of a link."""
        return int(self.sockets[name].socket.getsockname()[1])

    def wait(self, timeout: float) -> Iterator[tuple[str, Any, bytes]]:
        """Wait at most so many seconds for something to arrive, and yield all that has."""
        for key, _ in self._selector.select(max(0.0, timeout)):
            yield from key.data.receive()

    def send(self, outgoing: Iterable[Outgoing]) -> None:
        """Send what the conductor wants sent."""
        for one in outgoing:
            self.sockets[one.link].send(one)

    def close(self) -> None:
        """Close everything."""
        self._selector.close()
        for one in self.sockets.values():
            one.socket.close()


def open_links(urls: Mapping[str, str]) -> Links:
    """Open links by URL; raises :class:`VehicleError` that names each that cannot be opened."""
    opened: dict[str, Socket] = {}
    problems: list[str] = []
    for name, url in urls.items():
        try:
            opened[name] = _open(name, url)
        except OSError as error:
            reason = error.strerror or str(error)
            problems.append(f"link {name} ({url}) cannot be opened: {reason.lower()}")
    if problems:
        for one in opened.values():
            one.socket.close()
        raise VehicleError("\n".join(problems))
    return Links(opened)


def _open(name: str, url: str) -> Socket:
    kind, _, rest = url.partition("://")
    if kind == "serial":
        raise OSError(0, "serial ports are not ready yet; put a MAVLink router before it")
    host, _, port = rest.rpartition(":")
    address = (host.strip("[]"), int(port))
    family, _, _, _, found = socket.getaddrinfo(*address, type=socket.SOCK_DGRAM)[0]
    if kind == "tcp":
        stream = socket.create_connection(address, timeout=_CONNECT_TIMEOUT)
        stream.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        stream.setblocking(False)
        return Socket(name, stream, stream=True)
    datagrams = socket.socket(family, socket.SOCK_DGRAM)
    try:
        datagrams.setblocking(False)
        datagrams.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BUFFER)
        if kind == "udpin":
            datagrams.bind(found)
            return Socket(name, datagrams)
        datagrams.bind(("", 0))
        return Socket(name, datagrams, address=found)
    except OSError:
        datagrams.close()
        raise
