"""Ports for programs that a test begins, which no other socket of the machine is given meanwhile."""

import itertools
import os
import socket

_BELOW = 32_768
"""Linux gives sockets that name no port those from here (`ip_local_port_range`, its default)."""

_EACH = 1_000
"""Ports for each process of pytest-xdist."""

_process = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw"))
_next = itertools.cycle(
    _BELOW - 1 - _EACH * (_process % 12) - (os.getpid() + number) % _EACH for number in range(_EACH)
)


def free_port() -> int:
    """Return a UDP port of this machine that nothing uses.

    A program binds it seconds later. A port that the kernel chose and that is closed again could go
    to any other socket in the meantime.
    """
    while True:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            try:
                probe.bind(("127.0.0.1", port := next(_next)))
            except OSError:
                continue
            return port
