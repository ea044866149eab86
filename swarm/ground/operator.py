"""The operator's input during a flight: single keys, and a line-based control socket.

The control socket is a Unix socket that only its owner may open. Each line is one request; the
answer is one line: the effect, or the reason why the request is not possible. ``status`` lists the
effect of every request at this moment. ``kill`` must be repeated as ``kill NUMBER``, with the
number in the answer to ``kill``; after the key for it, the number must be typed.
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
"""Keys and their requests."""
KILL_KEY = "k"
"""The key that asks for the number with which kill is confirmed: no single key stops motors."""
_DIGITS = 4
_MAX_LINE = 200
_MAX_CLIENTS = 8


class RequestHandler(Protocol):
    """An object that handles operator requests: the conductor."""

    def request(self, request: Request) -> str:
        """Handle a request; return its effect."""

    def report(self, kind: str, message: str) -> None:
        """Add an event to the record, which the operator sees."""


class KeyHandler(Protocol):
    """An object that handles keys: a console, in this process or another."""

    def key(self, key: str) -> str | None:
        """Handle one key."""


class OperatorConsole:
    """Converts keys and lines to operator requests; kill must be confirmed with a number."""

    def __init__(
        self, flight: RequestHandler, status: Callable[[], Mapping[str, tuple[bool, str]]]
    ) -> None:
        """``status`` returns for every request whether it is possible, and its effect."""
        self._flight, self._status = flight, status
        self._number: str | None = None
        self._typed: str | None = None

    def line(self, text: str) -> str:
        """Handle one line; return the answer, one line."""
        word, _, rest = text.strip().lower().partition(" ")
        if word == "status":
            return "; ".join(
                f"{name} {'open' if is_open else 'closed'} ({effect})"
                for name, (is_open, effect) in self._status().items()
            )
        if word == "kill":
            return self._kill(rest.strip())
        for request in REQUESTS:
            if word == request:
                return self._flight.request(request)
        return f"expected one of status, {', '.join(REQUESTS)}; got {word[:40]!r}"

    def key(self, key: str) -> str | None:
        """Handle one key; return the answer, None for a key without a request."""
        if self._typed is not None and key.isdigit():
            return self._digit(key)
        self._typed = None
        if key == KILL_KEY:
            self._typed = ""
            words = f"to stop all motors in the air, type {self._new_number()}; other keys cancel"
            self._flight.report("operator", words)
            return words
        request = KEYS.get(key)
        return None if request is None else self._flight.request(request)

    def _digit(self, digit: str) -> str | None:
        """Handle a digit of the number that confirms kill."""
        self._typed = (self._typed or "") + digit
        if len(self._typed) < _DIGITS:
            return None
        number, self._typed = self._typed, None
        if number == self._number:
            return self._kill(number)
        self._number = None
        words = f"kill: {number} is not the number; nothing was stopped"
        self._flight.report("operator", words)
        return words

    def _kill(self, number: str) -> str:
        if self._number is not None and number == self._number:
            self._number = None
            return self._flight.request("kill")
        return f"to stop all motors in the air, type: kill {self._new_number()}"

    def _new_number(self) -> str:
        """Return a new number for the confirmation; numbers before it are no longer valid."""
        self._number = f"{secrets.randbelow(9 * 10 ** (_DIGITS - 1)) + 10 ** (_DIGITS - 1)}"
        return self._number


class ControlSocket:
    """The control socket; :meth:`poll` never blocks."""

    def __init__(self, path: Path, console: OperatorConsole) -> None:
        """Create the socket; raises :class:`VehicleError` if that fails."""
        self._path, self._console = path, console
        self._clients: dict[socket.socket, bytes] = {}
        self._listening = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        before = os.umask(0o177)
        try:
            path.unlink(missing_ok=True)
            self._listening.bind(str(path))
            self._listening.listen(_MAX_CLIENTS)
            self._listening.setblocking(False)
        except OSError as error:
            self._listening.close()
            raise VehicleError(f"control socket {path}: {error.strerror or error}") from None
        finally:
            os.umask(before)

    def poll(self) -> None:
        """Accept clients, and answer the lines that have arrived."""
        with suppress(OSError):
            while len(self._clients) < _MAX_CLIENTS:
                client, _ = self._listening.accept()
                client.setblocking(False)
                self._clients[client] = b""
        for client in list(self._clients):
            try:
                data = client.recv(_MAX_LINE)
            except BlockingIOError:
                continue
            except OSError:
                data = b""
            if data:
                self._handle(client, data)
            else:
                self._disconnect(client)

    def _handle(self, client: socket.socket, data: bytes) -> None:
        *lines, rest = (self._clients[client] + data).split(b"\n")
        self._clients[client] = rest
        if len(rest) > _MAX_LINE:
            self._disconnect(client)
            return
        for line in lines:
            answer = self._console.line(line.decode("utf-8", "replace"))
            with suppress(OSError):
                client.send(answer.encode() + b"\n")

    def _disconnect(self, client: socket.socket) -> None:
        self._clients.pop(client, None)
        client.close()

    def close(self) -> None:
        """Close and remove the socket."""
        for client in list(self._clients):
            self._disconnect(client)
        self._listening.close()
        self._path.unlink(missing_ok=True)


@contextmanager
def terminal_keys(handler: KeyHandler, stream: Any = None) -> Iterator[Callable[[], None]]:
    """Read single keys from a terminal; yields a function to call once per tick.

    If ``stream`` (default: standard input) is not a terminal, nothing is read. Ctrl-C still raises
    SIGINT.
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
                handler.key(key)

    tty.setcbreak(number)
    try:
        yield poll
    finally:
        termios.tcsetattr(number, termios.TCSADRAIN, before)
