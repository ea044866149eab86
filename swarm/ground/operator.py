"""The operator's input during a flight: single keys, and a line-based control socket.

The control socket is a Unix socket that only its owner may open, and a group of accounts where the
owner shares it. Each line is one request; the
answer is one line: the effect, or the reason why the request is not possible. ``status`` lists the
effect of every request at this moment. ``kill`` must be repeated as ``kill NUMBER``, with the
number in the answer to ``kill``; after the key for it, the number must be typed. ``kill cancel``
makes that number invalid. ``go TIME`` gives the go before arming: TIME is that of the state that
was seen, so that no page that stands still, or is slow, arms vehicles. ``key X`` is a typed key.
``snapshot`` returns the team's state as JSON.
After ``watch`` the client is a screen of the flight: it gets the events so far, then every snapshot
and event, each as a line of JSON.

Three lines have no answer. ``name TEXT`` says who makes the requests that follow: the record names
the author of each. ``note TEXT`` adds an event to the record. After ``screens N`` the client gets
what a screen gets, and counts as one if N is not 0: for the console, a process that passes the
flight on to any number of browsers, or none.
"""

import grp
import json
import os
import pwd
import secrets
import select
import signal
import socket
import struct
import sys
import termios
import threading
import tty
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from types import FrameType
from typing import Any, Final, Protocol, get_origin, get_type_hints

import numpy as np

from swarm.certification.findings import Finding
from swarm.certification.monitor import Clearances
from swarm.errors import VehicleError, printable
from swarm.flight.requests import REQUESTS, Request
from swarm.flight.snapshot import Checked, Event, Snapshot

_TUPLES = {name for name, hint in get_type_hints(Snapshot).items() if get_origin(hint) is tuple}


def screen_line(item: Snapshot | Event | Checked) -> bytes:
    """Return a snapshot, an event or findings as a line of JSON; numbers may be NaN."""
    kind = type(item).__name__.lower()
    return json.dumps({kind: asdict(item)}, default=np.ndarray.tolist).encode() + b"\n"


def read_screen_line(line: bytes) -> Snapshot | Event | Checked | str:
    """Return what a line holds: a snapshot, an event, findings, or the answer to a request.

    Raises :class:`ValueError` for JSON that is none of them.
    """
    if not line.startswith(b"{"):
        return line.decode("utf-8", "replace").strip()
    try:
        ((kind, content),) = json.loads(line).items()
        if kind == "checked":
            findings = tuple(Finding(**finding) for finding in content["findings"])
            return Checked(findings, tuple(content["steps"]))
        return Event(**content) if kind == "event" else _snapshot(content)
    except (TypeError, KeyError, AttributeError, ValueError) as error:
        raise ValueError(f"expected a snapshot or an event: {error}") from None


def _snapshot(content: dict[str, Any]) -> Snapshot:
    """Return a snapshot with its arrays, tuples and distances, from the values of its fields."""
    clearances = content.pop("clearances")
    available = {name: tuple(answer) for name, answer in content.pop("available").items()}
    values: dict[str, Any] = {
        name: value
        if not isinstance(value, list)
        else tuple(value)
        if name in _TUPLES
        else np.array(value, dtype=np.float64)
        for name, value in content.items()
    }
    return Snapshot(
        clearances=None if clearances is None else Clearances(**clearances),
        available=available,
        **values,
    )


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
_MAX_LINE = 400
"""Bytes of a request: of notes that name three people."""
_MAX_CLIENTS = 8
_CANCEL = "cancel"
CONFIRMATION = "to stop all motors in the air, type: kill "
"""The answer to kill, without the number."""
CANCELLED = "kill: cancelled; nothing was stopped"
TERMINAL = "terminal"
"""The author of what comes from the terminal that began the flight."""
CLIENT = "client of the control socket"
"""The author of what comes from a client that does not say who it is."""
STALE: Final = 2.0
"""Seconds after which what a screen has shown is too old to give the go."""
_MOST_WAITING = 20
"""Lines that wait for a slow screen before it misses snapshots: those of two seconds."""


class RequestHandler(Protocol):
    """An object that handles operator requests: the conductor."""

    @property
    def now(self) -> float:
        """The time of snapshots and events."""

    @property
    def asked_at(self) -> float | None:
        """The time at which the go that is possible now was asked for; None without one."""

    def request(self, request: Request, author: str) -> str:
        """Handle a request of an author; return its effect."""

    def report(self, kind: str, message: str) -> None:
        """Add an event to the record, which the operator sees."""


class OperatorConsole:
    """Converts keys and lines to operator requests; kill must be confirmed with a number."""

    def __init__(
        self,
        flight: RequestHandler,
        status: Callable[[], Mapping[Request, tuple[bool, str]]],
        author: str = TERMINAL,
    ) -> None:
        """``status`` returns for every request whether it is possible, and its effect."""
        self._flight, self._status, self.author = flight, status, author
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
        if word == "go":
            return self._go(rest)
        if word == "key":
            return self.key(rest.strip()[:1] or " ") or "no request has this key"
        for request in REQUESTS:
            if word == request:
                return self._flight.request(request, self.author)
        return f"expected one of status, {', '.join(REQUESTS)}; got {word[:40]!r}"

    def key(self, key: str) -> str | None:
        """Handle one key; return the answer, None for a key without a request."""
        if self._typed is not None and key.isdigit():
            return self._digit(key)
        if self._typed is not None:
            self._cancel()
        if key == KILL_KEY:
            self._typed = ""
            words = f"to stop all motors in the air, type {self._new_number()}; other keys cancel"
            self._flight.report("operator", words)
            return words
        request = KEYS.get(key)
        return None if request is None else self._flight.request(request, self.author)

    def _go(self, seen: str) -> str:
        """Give the go, by a screen that shows the present state."""
        asked = self._flight.asked_at
        try:
            age = self._flight.now - float(seen)
        except ValueError:
            age = STALE
        if 0.0 <= age < STALE and (asked is None or float(seen) >= asked):
            return self._flight.request("go", self.author)
        words = "go: this screen does not show the present state; nothing was armed"
        self._flight.report("operator", f"{words} ({self.author})")
        return words

    def note(self, text: str) -> None:
        """Add an event to the record, with its author."""
        self._flight.report("operator", text)

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
            return self._flight.request("kill", self.author)
        if number == _CANCEL:
            return self._cancel()
        return f"{CONFIRMATION}{self._new_number()}"

    def _cancel(self) -> str:
        """Make the number invalid; the operator sees that nothing was stopped."""
        self._number = self._typed = None
        self._flight.report("operator", CANCELLED)
        return CANCELLED

    def _new_number(self) -> str:
        """Return a new number for the confirmation; numbers before it are no longer valid."""
        self._number = f"{secrets.randbelow(9 * 10 ** (_DIGITS - 1)) + 10 ** (_DIGITS - 1)}"
        return self._number


@dataclass(eq=False)
class _Client:
    """A client of the control socket; ``lines`` wait to be sent.

    ``account`` is its account where that is not ours; ``follows`` says whether it gets snapshots
    and events, ``asked`` whether it waits for the first snapshot, ``watches`` whether it is a
    screen.
    """

    console: OperatorConsole
    received: bytes = b""
    account: str = ""
    follows: bool = False
    asked: bool = False
    watches: bool = False
    lines: deque[bytes] = field(default_factory=deque)


class ControlSocket:
    """The control socket; :meth:`poll` never blocks."""

    def __init__(
        self, path: Path, console: Callable[[], OperatorConsole], group: int | None = None
    ) -> None:
        """Create the socket; raises :class:`VehicleError` if that fails.

        The members of ``group`` may open it, too: they command the team. Every client has a
        ``console`` of its own: the number that stops the motors belongs to it.
        """
        self._path, self._console = path, console
        self._clients: dict[socket.socket, _Client] = {}
        self._events: list[bytes] = []
        self._snapshot: Snapshot | None = None
        self._checked: bytes | None = None
        self._listening = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        before = os.umask(0o177)
        try:
            path.unlink(missing_ok=True)
            self._listening.bind(str(path))
            if group is not None:
                os.chown(path, -1, group)
                path.chmod(0o660)
            self._listening.listen(_MAX_CLIENTS)
            self._listening.setblocking(False)
        except OSError as error:
            self._listening.close()
            raise VehicleError(f"control socket {path}: {error.strerror or error}") from None
        finally:
            os.umask(before)

    @property
    def watched(self) -> bool:
        """Whether a client is a screen of the flight."""
        return any(client.watches for client in self._clients.values())

    def publish(self, item: Snapshot | Event | Checked) -> None:
        """Queue an item for the screens; a slow one misses snapshots, nothing else."""
        watching = [client for client in self._clients.values() if client.follows]
        if isinstance(item, Event):
            self._events.append(screen_line(item))
        elif isinstance(item, Checked):
            self._checked = screen_line(item)
        else:
            self._snapshot = item
            watching = [
                client
                for client in self._clients.values()
                if client.asked or (client.follows and len(client.lines) < _MOST_WAITING)
            ]
            for client in watching:
                client.asked = False
        if watching:
            line = screen_line(item)
            for client in watching:
                client.lines.append(line)

    def poll(self) -> None:
        """Accept clients, answer the lines that have arrived, and send what waits."""
        with suppress(OSError):
            while len(self._clients) < _MAX_CLIENTS:
                accepted, _ = self._listening.accept()
                accepted.setblocking(False)
                client = _Client(self._console(), account=_other_account(accepted))
                client.console.author = _named(client, client.console.author)
                self._clients[accepted] = client
        for connection, client in list(self._clients.items()):
            try:
                data = connection.recv(_MAX_LINE)
            except BlockingIOError:
                self._send(connection, client)
                continue
            except OSError:
                data = b""
            if data and self._handle(client, data):
                self._send(connection, client)
            else:
                self._disconnect(connection)

    def _handle(self, client: _Client, data: bytes) -> bool:
        """Answer complete lines; return whether the client may stay."""
        *lines, client.received = (client.received + data).split(b"\n")
        for line in lines:
            text = line.decode("utf-8", "replace").strip()
            word, _, rest = text.partition(" ")
            if word == "name":
                client.console.author = _named(client, printable(rest))
            elif word == "note":
                client.console.note(_named(client, printable(rest)))
            elif text == "watch" or word == "screens":
                client.watches = rest != "0"
                self._follow(client)
            elif text == "snapshot":
                self._show_latest(client)
            else:
                client.lines.append(client.console.line(text).encode() + b"\n")
        return len(client.received) <= _MAX_LINE

    def _follow(self, client: _Client) -> None:
        """Begin to send what a screen gets, with the events so far."""
        if not client.follows:
            client.follows = True
            client.lines.extend(self._events)
            if self._checked is not None:
                client.lines.append(self._checked)
            self._show_latest(client)

    def _show_latest(self, client: _Client) -> None:
        """Send the latest snapshot, or as soon as there is one."""
        client.asked = self._snapshot is None
        if self._snapshot is not None:
            client.lines.append(screen_line(self._snapshot))

    def _send(self, connection: socket.socket, client: _Client) -> None:
        """Send what waits, as far as the client reads."""
        try:
            while client.lines:
                sent = connection.send(client.lines[0])
                client.lines[0] = client.lines[0][sent:]
                if not client.lines[0]:
                    client.lines.popleft()
        except BlockingIOError:
            pass
        except OSError:
            self._disconnect(connection)

    def _disconnect(self, connection: socket.socket) -> None:
        self._clients.pop(connection, None)
        connection.close()

    def close(self) -> None:
        """Send what waits, then close and remove the socket."""
        self.poll()
        for connection, client in list(self._clients.items()):
            self._send(connection, client)
            self._disconnect(connection)
        self._listening.close()
        self._path.unlink(missing_ok=True)


def parse_group(name: str) -> int:
    """Return the number of a group of accounts; raises ValueError for one that is not ours."""
    try:
        number = grp.getgrnam(name).gr_gid
    except KeyError:
        raise ValueError(f"expected a group of this machine, got {name!r}") from None
    if os.geteuid() and number not in {os.getegid(), *os.getgroups()}:
        raise ValueError(f"expected a group that this account is in, got {name!r}")
    return number


def _named(client: _Client, name: str) -> str:
    """Return how the record names a client: with its account where that is another one than ours,
    as the system says, whatever the client says."""
    return f"{name} (account {client.account})" if client.account else name


def _other_account(connection: socket.socket) -> str:
    """Return the account at the other end; "" for our own, and where the system does not say."""
    option = getattr(socket, "SO_PEERCRED", None)
    if option is None:
        return ""
    _, uid, _ = struct.unpack("3i", connection.getsockopt(socket.SOL_SOCKET, option, 12))
    if uid == os.getuid():
        return ""
    try:
        return pwd.getpwuid(uid).pw_name
    except KeyError:
        return str(uid)


@contextmanager
def terminal_keys(
    on_key: Callable[[str], object], stream: Any = None
) -> Iterator[Callable[[], None]]:
    """Read single keys from a terminal for ``on_key``; yields a function to call once per tick.

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
                on_key(key)

    tty.setcbreak(number)
    try:
        yield poll
    finally:
        termios.tcsetattr(number, termios.TCSADRAIN, before)


@contextmanager
def signal_handlers(
    numbers: Iterable[int], handler: Callable[[int, FrameType | None], None]
) -> Iterator[None]:
    """Handle signals in this context, if this is the main thread."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.signal(number, handler) for number in numbers}
    try:
        yield
    finally:
        for number, previous in before.items():
            signal.signal(number, previous)
