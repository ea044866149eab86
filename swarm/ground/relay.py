"""Packets of the vehicles for other programs: MAVSDK, and another ground station.

MAVSDK reaches each autopilot through a loopback UDP endpoint, closed in flight. Packets are
forwarded in both directions, except MAVSDK's heartbeats: with them, vehicles would not detect the
loss of this ground station. Another ground station, such as QGroundControl, gets a copy: its socket
is never read, so that nothing it sends reaches a vehicle. Sending never blocks, and a program that
does not listen costs nothing.
"""

import re
import socket
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

from swarm.errors import VehicleError, reason
from swarm.flight.router import Address, Outgoing, Team
from swarm.mavlink.packets import Decoder, sender, split_packets

_HEARTBEAT = 0
_LARGEST_DATAGRAM = 65_536


@dataclass
class _Endpoint:
    ours: socket.socket
    port: int


@dataclass
class Relay:
    """The endpoints of a team's vehicles; MAVSDK listens on ``ports``."""

    team: Team
    closed: bool = False
    _endpoints: dict[int, _Endpoint] = field(default_factory=dict)
    _decoder: Decoder = field(default_factory=lambda: Decoder(unpacked=()))

    def __post_init__(self) -> None:
        for system in self.team.vehicles:
            ours = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            ours.bind(("127.0.0.1", 0))
            ours.setblocking(False)
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as theirs:
                theirs.bind(("127.0.0.1", 0))
                port = int(theirs.getsockname()[1])
            self._endpoints[system] = _Endpoint(ours, port)

    @property
    def ports(self) -> Mapping[int, int]:
        """Loopback ports by system id."""
        return {system: endpoint.port for system, endpoint in self._endpoints.items()}

    def from_vehicles(self, link: str, address: Address | None, data: bytes) -> None:
        """Forward each packet of an autopilot that can be trusted to the vehicle's endpoint.

        MAVSDK would take the battery of a camera for the vehicle's.
        """
        if self.closed:
            return
        for packet in split_packets(data)[0]:
            system, component = sender(packet)
            endpoint = self._endpoints.get(system)
            if endpoint is None or component != self.team.vehicles[system].component:
                continue
            if self.team.trusts(link, address, packet):
                try:
                    endpoint.ours.sendto(packet, ("127.0.0.1", endpoint.port))
                except OSError:
                    continue

    def to_vehicles(self) -> Iterator[Outgoing]:
        """Yield the packets that MAVSDK sends to vehicles."""
        for system, endpoint in self._endpoints.items():
            for datagram in _datagrams(endpoint.ours):
                route = self.team.way_to(system)
                if self.closed or route is None:
                    continue
                for packet in split_packets(datagram)[0]:
                    (decoded,) = self._decoder.feed(packet) or (None,)
                    if decoded is not None and packet[0] == 0xFD and decoded.number != _HEARTBEAT:
                        data = self.team.sealed(route.link, packet)
                        yield Outgoing(route.link, route.address, data)

    def close(self) -> None:
        """Close the endpoints."""
        self.closed = True
        for endpoint in self._endpoints.values():
            endpoint.ours.close()


def _datagrams(ours: socket.socket) -> Iterator[bytes]:
    while True:
        try:
            data, _ = ours.recvfrom(_LARGEST_DATAGRAM)
        except BlockingIOError:
            return
        except OSError:
            continue
        yield data


_URL = re.compile(r"udp://(?P<host>[^/:\s]+|\[[0-9a-fA-F:]+\]):(?P<port>\d{1,5})")


def parse_forward(url: str) -> tuple[str, int]:
    """Return host and port of udp://HOST:PORT; raises ValueError for another text."""
    match = _URL.fullmatch(url)
    if match is None or not 0 < int(match["port"]) < 65536:
        raise ValueError(f"expected udp://HOST:PORT, got {url!r}")
    return match["host"].strip("[]"), int(match["port"])


@dataclass
class Forward:
    """Sends the packets of a team's vehicles to one UDP address, from one port.

    ``unsent`` counts packets that could not be sent at once.
    """

    team: Team
    socket: socket.socket
    unsent: int = 0

    def from_vehicles(self, link: str, address: Address | None, data: bytes) -> None:
        """Send on each packet that comes from a vehicle of the team, unchanged."""
        for packet in split_packets(data)[0]:
            if self.team.trusts(link, address, packet):
                try:
                    self.socket.send(packet)
                except OSError:
                    self.unsent += 1

    def close(self) -> None:
        """Close the socket."""
        self.socket.close()


def open_forward(url: str, team: Team) -> Forward:
    """Open the socket to udp://HOST:PORT.

    Raises :class:`swarm.errors.VehicleError` where that is impossible.
    """
    try:
        family, kind, _, _, target = socket.getaddrinfo(
            *parse_forward(url), type=socket.SOCK_DGRAM
        )[0]
        opened = socket.socket(family, kind)
        opened.setblocking(False)
        opened.connect(target)
    except (OSError, UnicodeError) as error:  # the latter for no name of a host
        raise VehicleError(f"--forward {url} cannot be opened: {reason(error)}") from None
    return Forward(team, opened)
