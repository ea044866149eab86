"""The start of a console: its address, its token, and its process.

The process is not a child that ends with the terminal: as the flight, it goes on when the terminal
is closed. It ends with the flight.
"""

import ipaddress
import json
import secrets
import socket
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from swarm.child_modules import module_command
from swarm.console.certificate import fingerprint, read_certificate, self_signed
from swarm.errors import InputError, Problem, reason
from swarm.ground.record import control_socket

DEFAULT: Final = "127.0.0.1:8766"
MODULE: Final = "swarm.console.server"
_LETTERS: Final = "23456789abcdefghjkmnpqrstuvwxyz"
"""Letters and digits that are not mistaken for each other."""
_GROUPS, _GROUP = 4, 4
"""Sixteen of them: 79 bits. Five guesses, then one a second, never find one."""
_WAITING: Final = 16


@dataclass(frozen=True)
class Address:
    """An interface of this machine, and a TCP port; 0 is any free one."""

    host: str
    port: int

    @property
    def loopback(self) -> bool:
        """Whether only this machine reaches it."""
        return ipaddress.ip_address(self.host).is_loopback


def parse_address(text: str) -> Address:
    """Return an address from its text; raises :class:`ValueError` for another text."""
    host, _, port = text.rpartition(":")
    host = host.removeprefix("[").removesuffix("]")
    try:
        ipaddress.ip_address("127.0.0.1" if host == "localhost" else host)
    except ValueError:
        raise ValueError(
            f"expected ADDRESS:PORT, as {DEFAULT} or 0.0.0.0:8443, got {text!r}"
        ) from None
    if not (port.isascii() and port.isdigit() and int(port) < 1 << 16):
        raise ValueError(f"expected a port from 0 to 65535, got {port!r}")
    return Address("127.0.0.1" if host == "localhost" else host, int(port))


@dataclass(frozen=True)
class Console:
    """A console that has been opened: the address of its page, and what to say of it."""

    url: str
    message: str
    process: "subprocess.Popen[bytes]"


def require_usable(address: Address, certificate: Path | None) -> None:
    """Raise :class:`InputError` for an address or a certificate that cannot be used now."""
    if certificate:
        read_certificate(certificate)
    _listening(address).close()


@contextmanager
def open_console(folder: Path, address: Address, certificate: Path | None) -> Iterator[Console]:
    """Open the console of the flight with this record, which may begin later.

    At the end of the block a console ends that never reached its flight; another one ends with it.
    Raises :class:`InputError` for an address or a certificate that cannot be used.
    """
    control = control_socket(folder.absolute())
    if control is None:
        raise InputError(
            [Problem(str(folder), "too long a path for the control socket of a console")]
        )
    pem = read_certificate(certificate) if certificate else None
    listening = _listening(address)
    with listening:
        port: int = listening.getsockname()[1]
        hosts = (
            [address.host] if not ipaddress.ip_address(address.host).is_unspecified else _hosts()
        )
        if pem is None and not address.loopback:
            pem = self_signed(hosts)
        token = "-".join(
            "".join(secrets.choice(_LETTERS) for _ in range(_GROUP)) for _ in range(_GROUPS)
        )
        ours, theirs = socket.socketpair()
        process = subprocess.Popen(  # noqa: S603 - our own module
            module_command(MODULE, str(listening.fileno()), str(folder.absolute())),
            pass_fds=[listening.fileno()],
            stdin=theirs.fileno(),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
    theirs.close()
    host = f"[{hosts[0]}]" if ":" in hosts[0] else hosts[0]
    url = f"{'https' if pem else 'http'}://{host}:{port}/#{token}"
    message = f"Console: {url}"
    if pem is not None and certificate is None:
        message += f"\nIts certificate is self-signed; compare SHA-256 {fingerprint(pem)}"
    # Its input stays open to the end: a console that waits for its flight ends with it.
    with suppress(OSError):
        secret = {"token": token, "pem": pem.decode() if pem else None}
        ours.sendall(json.dumps(secret).encode() + b"\n")
    with ours:
        yield Console(url, message, process)


def _listening(address: Address) -> socket.socket:
    family = socket.AF_INET6 if ":" in address.host else socket.AF_INET
    listening = socket.socket(family, socket.SOCK_STREAM)
    try:
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listening.bind((address.host, address.port))
        listening.listen(_WAITING)
    except OSError as error:
        listening.close()
        words = f"{address.host}:{address.port}: {reason(error)}"
        raise InputError([Problem("--console", words)]) from None
    return listening


def _hosts() -> list[str]:
    """Return the address by which others reach this machine, and its name."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe, suppress(OSError):
        probe.connect(("192.0.2.1", 9))  # sends nothing: only asks for the way
        return [probe.getsockname()[0], socket.gethostname()]
    return [socket.gethostname()]
