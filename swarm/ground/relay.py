"""A loopback UDP endpoint for each vehicle, through which MAVSDK reaches its autopilot. Closed in
flight.

Packets are forwarded in both directions, except MAVSDK's heartbeats: with them, vehicles would
not detect the loss of this ground station.
"""

import socket
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

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
