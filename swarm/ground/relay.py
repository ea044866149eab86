"""One loopback UDP endpoint per vehicle, for the library that audits them.

What a vehicle sends is passed on; what the library sends goes to the vehicle, except heartbeats,
which would tell vehicles that a ground station is there when ours is not. Closed in flight.
"""

import socket
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

from swarm.flight.router import Address, Outgoing, Team
from swarm.mavlink.packets import Decoder, split_packets

_HEARTBEAT = 0
_LARGEST_DATAGRAM = 65_536


@dataclass
class _Endpoint:
    ours: socket.socket
    port: int


@dataclass
class Relay:
    """The endpoints of a team's vehicles; ``ports`` is where the library must listen."""

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
        """Loopback port by system id."""
        return {system: endpoint.port for system, endpoint in self._endpoints.items()}

    def from_vehicles(self, link: str, address: Address | None, data: bytes) -> None:
        """Pass on what arrived, each packet that can be trusted to its vehicle's endpoint."""
        if self.closed:
            return
        for packet in split_packets(data)[0]:
            system = packet[5] if packet[0] == 0xFD else packet[3]
            endpoint = self._endpoints.get(system)
            if endpoint is not None and self.team.trusts(link, address, packet):
                try:
                    endpoint.ours.sendto(packet, ("127.0.0.1", endpoint.port))
                except OSError:
                    continue

    def to_vehicles(self) -> Iterator[Outgoing]:
        """Yield what the library wants sent."""
        for system, endpoint in self._endpoints.items():
            for arrived in _arrived(endpoint.ours):
                route = self.team.way_to(system)
                if self.closed or route is None:
                    continue
                for packet in split_packets(arrived)[0]:
                    (known,) = self._decoder.feed(packet) or (None,)
                    if known is not None and packet[0] == 0xFD and known.number != _HEARTBEAT:
                        data = self.team.sealed(route.link, packet)
                        yield Outgoing(route.link, route.address, data)

    def close(self) -> None:
        """Close the endpoints."""
        self.closed = True
        for endpoint in self._endpoints.values():
            endpoint.ours.close()


def _arrived(ours: socket.socket) -> Iterator[bytes]:
    while True:
        try:
            data, _ = ours.recvfrom(_LARGEST_DATAGRAM)
        except BlockingIOError:
            return
        except OSError:
            continue
        yield data
