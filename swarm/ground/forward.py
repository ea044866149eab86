"""A read-only copy of what the vehicles send, for another ground station such as QGroundControl.

The socket is never read: nothing that the other program sends reaches a vehicle. Sending never
blocks, and a program that does not listen costs nothing.
"""

import re
import socket
from dataclasses import dataclass

from swarm.errors import VehicleError, reason
from swarm.flight.router import Address, Team
from swarm.mavlink.packets import split_packets

_URL = re.compile(r"udp://(?P<host>[^/:\s]+|\[[0-9a-fA-F:]+\]):(?P<port>\d{1,5})")


def parse_forward(url: str) -> tuple[str, int]:
    """Return host and port of udp://HOST:PORT; raises ValueError for another text."""
    found = _URL.fullmatch(url)
    if found is None or not 0 < int(found["port"]) < 65536:
        raise ValueError(f"expected udp://HOST:PORT, got {url!r}")
    return found["host"].strip("[]"), int(found["port"])


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
