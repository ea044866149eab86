"""The operator's wishes while it flies: single keys, and a line-based control socket.

The socket is a Unix socket that only its owner may open. One line is one wish; the answer is one
line: what follows, or why it cannot be. ``status`` tells what each wish would do now. ``kill``
needs ``kill NUMBER`` with the number that a plain ``kill`` answers with.
"""

import os
import secrets
import select
import socket
import sys
import termios
import tty
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Protocol

from swarm.errors import VehicleError
from swarm.flight.operator import REQUESTS, Request

KEYS: Mapping[str, Request] = {
    " ": "hold",
    "h": "hold",
    "r": "resume",
    "b": "rewind",
    "l": "land",
    "x": "release",
    "j": "rejoin",
    "a": "abort",
}
"""Keys and what they ask for. Killing has no key: it is typed."""
_LONGEST_LINE = 200
_MOST_CLIENTS = 8


class Operated(Protocol):
    """What takes wishes: the conductor."""

    def request(self, request: Request) -> str:
        """Take a wish; say what follows."""


class Keyed(Protocol):
    """What takes keys: a desk, here or in another process."""

    def key(self, key: str) -> str | None:
        """Take one key."""


class Desk:
    """Turns typed lines into wishes; killing must be confirmed with a number."""

    def __init__(
        self, flight: Operated, status: Callable[[], Mapping[str, tuple[bool, str]]]
    ) -> None:
        self._flight, self._status = flight, status
        self._number: str | None = None

    def line(self, text: str) -> str:
        """Take one typed line; return the answer, one line."""
        word, _, rest = text.strip().lower().partition(" ")
        if word == "status":
            return "; ".join(
                f"{name} {'open' if is_open else 'closed'} ({words})"
                for name, (is_open, words) in self._status().items()
            )
        if word == "kill":
            return self._kill(rest.strip())
        for request in REQUESTS:
            if word == request:
                return self._flight.request(request)
        return f"expected one of status, {', '.join(REQUESTS)}; got {word[:40]!r}"

    def key(self, key: str) -> str | None:
        """Take one key; return the answer, None for a key that means nothing."""
        request = KEYS.get(key)
        return None if request is None else self._flight.request(request)

    def _kill(self, number: str) -> str:
        if self._number is not None and number == self._number:
            self._number = None
            return self._flight.request("kill")
        self._number = f"{secrets.randbelow(9000) + 1000}"
        return f"to stop all motors in the air, type: kill {self._number}"


class ControlSocket:
    """The control socket; asked once per tick, never waited for."""

    def __init__(self, path: Path, desk: Desk) -> None:
        """Open it; raises :class:`VehicleError` where it cannot be made."""
        self._path, self._desk = path, desk
        self._clients: dict[socket.socket, bytes] = {}
        self._listening = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        before = os.umask(0o177)
        try:
            path.unlink(missing_ok=True)
            self._listening.bind(str(path))
            self._listening.listen(_MOST_CLIENTS)
            self._listening.setblocking(False)
        except OSError as error:
            self._listening.close()
            raise VehicleError(f"control socket {path}: {error.strerror or error}") from None
        finally:
            os.umask(before)

    def poll(self) -> None:
        """Take what has been typed, and answer it."""
        with suppress(OSError):
            while len(self._clients) < _MOST_CLIENTS:
                client, _ = self._listening.accept()
                client.setblocking(False)
                self._clients[client] = b""
        for client in list(self._clients):
            try:
                data = client.recv(_LONGEST_LINE)
            except BlockingIOError:
                continue
            except OSError:
                data = b""
            if data:
                self._take(client, data)
            else:
                self._forget(client)

    def _take(self, client: socket.socket, data: bytes) -> None:
        *lines, rest = (self._clients[client] + data).split(b"\n")
        self._clients[client] = rest
        if len(rest) > _LONGEST_LINE:
            self._forget(client)
            return
        for line in lines:
            answer = self._desk.line(line.decode("utf-8", "replace"))
            with suppress(OSError):
                client.send(answer.encode() + b"\n")

    def _forget(self, client: socket.socket) -> None:
        self._clients.pop(client, None)
        client.close()

    def close(self) -> None:
        """Close and remove it."""
        for client in list(self._clients):
            self._forget(client)
        self._listening.close()
        self._path.unlink(missing_ok=True)


@contextmanager
def keys(desk: Keyed, stream: Any = None) -> Iterator[Callable[[], None]]:
    """Take single keys from a terminal while it lasts; yields what to call once per tick.

    Where ``stream`` (standard input) is no terminal, nothing is taken. Ctrl-C stays what it is.
    """
    stream = stream if stream is not None else sys.stdin
    try:
        number = stream.fileno()
        before = termios.tcgetattr(number)
    except (OSError, ValueError, AttributeError, termios.error):
        yield lambda: None
        return

    def poll() -> None:
        while select.select([number], [], [], 0.0)[0]:
            typed = os.read(number, 16)
            if not typed:
                return
            for key in typed.decode("ascii", "ignore"):
                desk.key(key)

    tty.setcbreak(number)
    try:
        yield poll
    finally:
        termios.tcsetattr(number, termios.TCSADRAIN, before)
