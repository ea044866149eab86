"""Who is at the console, who has command, and what becomes of each message of a browser.

Sans-IO: connections, texts and the time go in; messages to browsers, connections to close and lines
for the control socket come out. One person has command; all others read. Command is taken where
no one has it, and otherwise asked for: the person who has it hands it over or keeps it, and loses
it to the one who asked by not answering. A person whose connection is lost keeps it for a while,
unless another one takes it, so that a page can be loaded again in mid-flight.

Keys of terminals are not subject to this: the person at the ground station can stop the team,
whatever a browser does.
"""

import hmac
import json
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final

from swarm.errors import printable
from swarm.flight.requests import REQUESTS
from swarm.ground.operator import CONFIRMATION

LARGEST_MESSAGE: Final = 1024
"""Characters of a message of a browser; the longest that the page sends has less than 200."""
JOIN_TIME: Final = 5.0
"""Seconds within which a connection must send its token."""
KEPT_TIME: Final = 30.0
"""Seconds for which a person whose connection is lost is remembered: a page that is loaded again on
a slow radio takes ten."""
ABSENT_TIME: Final = 10.0
"""Seconds after which a lost connection counts as a screen of the flight that is gone: loading a
page again must not hold the team."""
ANSWER_TIME: Final = 15.0
"""Seconds within which the person who has command answers a person who asks for it."""
MOST_CONNECTIONS: Final = 64
_MOST_PEOPLE: Final = 64
_MOST_ADDRESSES: Final = 256
_LONGEST_NAME: Final = 24
"""Characters of a name: with four bytes each they fit into a line of the control socket."""

JOIN_CODE, TOKEN_CODE, MANY_TOKENS_CODE, REPLACED_CODE, MESSAGE_CODE, RATE_CODE, FULL_CODE = range(
    4000, 4007
)
"""Codes with which a WebSocket is closed: no token in time, a wrong one, too many wrong ones;
joined again elsewhere; a message that no page sends; too many messages; too many connections."""


@dataclass(frozen=True)
class Send:
    """A message to a connection."""

    connection: int
    message: Mapping[str, Any]


@dataclass(frozen=True)
class Close:
    """The end of a connection, with the reason that its page shows."""

    connection: int
    code: int
    reason: str


@dataclass(frozen=True)
class Tell:
    """A line for the control socket of the flight."""

    line: str


Output = Send | Close | Tell


@dataclass
class Allowance:
    """How often something may happen: ``most`` times at once, then ``rate`` times a second."""

    most: float
    rate: float
    since: float
    left: float = field(init=False)
    reported: bool = False

    def __post_init__(self) -> None:
        self.left = self.most

    def allows(self, now: float) -> bool:
        """Return whether it may happen once more now."""
        self.left = min(self.most, self.left + self.rate * max(now - self.since, 0.0))
        self.since = now
        return self.left >= 1.0

    def take(self) -> None:
        """Count that it happened."""
        self.left -= 1.0


def wrong_tokens(now: float) -> Allowance:
    """Return the allowance of wrong tokens from one address: a person who mistypes is not stopped,
    and a program that guesses tries one a second."""
    return Allowance(5.0, 1.0, now)


def messages(now: float) -> Allowance:
    """Return the allowance of messages of one browser: more than a person can type and click."""
    return Allowance(30.0, 10.0, now)


@dataclass
class Person:
    """A person at a browser. ``key`` makes a page that is loaded again the same person.

    ``lost_at`` is when the connection was lost.
    """

    number: int
    name: str
    key: str
    connection: int | None
    lost_at: float = 0.0

    @property
    def words(self) -> str:
        """The person in messages and in the record."""
        return f"{self.name} (console {self.number})" if self.name else f"console {self.number}"


@dataclass
class _Connection:
    address: str
    since: float
    messages: Allowance
    person: Person | None = None


class _MessageError(Exception):
    """A message that no page sends."""


class Session:
    """The people at the console of one flight.

    ``token`` lets them in, ``new_key`` returns a new secret at every call. ``closed`` says why the
    flight takes no requests, "" while it does; ``screens`` is how many people look at it.
    """

    def __init__(self, token: str, new_key: Callable[[], str]) -> None:
        self._token, self._new_key = _plain(token), new_key
        self._connections: dict[int, _Connection] = {}
        self._people: dict[int, Person] = {}
        self._holder: Person | None = None
        self._asking: tuple[Person, float] | None = None
        self._kill: Person | None = None
        self._asked: deque[tuple[Person, str]] = deque()
        self._wrong: dict[str, Allowance] = {}
        self._number = 0
        self.screens = 0
        self.closed = "the flight has not begun yet"

    @property
    def joined(self) -> tuple[int, ...]:
        """The connections of people: those that the flight is shown to."""
        return tuple(k for k, client in self._connections.items() if client.person is not None)

    @property
    def holder(self) -> str | None:
        """Who has command."""
        return self._holder.words if self._holder else None

    def connect(self, connection: int, address: str, now: float) -> list[Output]:
        """Take a new connection."""
        if len(self._connections) >= MOST_CONNECTIONS:
            return [Close(connection, FULL_CODE, "too many browsers")]
        self._connections[connection] = _Connection(address, now, messages(now))
        return []

    def disconnect(self, connection: int, now: float) -> list[Output]:
        """Take the end of a connection."""
        ended = self._connections.pop(connection, None)
        if ended is None or ended.person is None or ended.person.connection != connection:
            return []
        person = ended.person
        person.connection, person.lost_at = None, now
        out: list[Output] = []
        if self._asking is not None and self._asking[0] is person:
            self._asking = None
        if self._holder is person:
            out.append(_note(f"{person.words} has command and lost the connection"))
        return [*out, *self._cancel_kill(person), *self._everyone(now)]

    def receive(self, connection: int, text: str | bytes, now: float) -> list[Output]:
        """Take a message of a browser."""
        known = self._connections.get(connection)
        if known is None:
            return []
        if not known.messages.allows(now):
            return self._close(connection, RATE_CODE, "too many messages", now)
        known.messages.take()
        try:
            message = _parsed(text)
            if known.person is None:
                return self._join(connection, known, message, now)
            return self._act(known.person, message, now)
        except _MessageError as error:
            return self._close(connection, MESSAGE_CODE, str(error), now)

    def answer(self, words: str) -> list[Output]:
        """Take the flight's answer to the oldest request without one."""
        if not self._asked:
            return []
        person, command = self._asked.popleft()
        if person.connection is None:
            return []
        if words.startswith(CONFIRMATION):
            if self._holder is not person:
                return []
            self._kill = person
            number = words.removeprefix(CONFIRMATION)
            again = command not in {"kill", "kill cancel"}
            return [Send(person.connection, {"kind": "kill", "number": number, "again": again})]
        shown = {"kind": "answer", "command": command.partition(" ")[0], "words": words}
        return [Send(person.connection, shown)]

    def tick(self, now: float) -> list[Output]:
        """Let time pass: end what has waited too long."""
        out: list[Output] = []
        for connection, client in list(self._connections.items()):
            if client.person is None and now - client.since > JOIN_TIME:
                out += self._close(connection, JOIN_CODE, "no token", now)
        gone = [client for client in self._people.values() if client.connection is None]
        for person in gone:
            if now - person.lost_at > KEPT_TIME:
                del self._people[person.number]
                if self._holder is person:
                    out += self._give(None, now, f"{person.words} did not come back")
                else:
                    out += self._everyone(now)
        if self._asking is not None and now - self._asking[1] >= ANSWER_TIME:
            asking, holder = self._asking[0], self._holder
            words = f"{holder.words} did not answer" if holder else ""
            out += self._give(asking, now, words)
        return [*out, *self._count_screens(now)]

    # What people do

    def _join(
        self, connection: int, known: _Connection, message: Mapping[str, Any], now: float
    ) -> list[Output]:
        if message.get("do") != "join":
            raise _MessageError("expected a token")
        wrong = self._wrong.get(known.address) or wrong_tokens(now)
        if not wrong.allows(now):
            words = "too many wrong tokens from this address: wait a few seconds"
            return self._close(connection, MANY_TOKENS_CODE, words, now)
        if not _same(_plain(_text(message, "token")), self._token):
            out = self._count_wrong(known.address, wrong)
            return [*out, *self._close(connection, TOKEN_CODE, "wrong token", now)]
        out = list[Output]()
        person = self._returning(_text(message, "key"))
        if person is None:
            person = self._new_person()
        elif person.connection is not None:
            before = self._connections[person.connection]
            before.person = None
            words = "this console was opened in another window"
            out += self._close(person.connection, REPLACED_CODE, words, now)
        person.name = _name(message) or person.name
        person.connection, known.person = connection, person
        joined = {"kind": "joined", "number": person.number, "name": person.name}
        out.append(Send(connection, {**joined, "key": person.key}))
        return [*out, *self._count_screens(now), *self._everyone(now)]

    def _act(self, person: Person, message: Mapping[str, Any], now: float) -> list[Output]:
        do = message.get("do")
        match do:
            case "name":
                person.name = _name(message)
                return self._everyone(now)
            case "take":
                return self._take(person, now)
            case "hand over" | "keep" | "leave" | "command" | "kill" | "cancel kill":
                if self._holder is not person:
                    words = f"{self.holder or 'no one'} has command"
                    return self._say(person, str(do), f"{words}: this console only reads")
                return self._as_holder(person, do, message, now)
            case _:
                raise _MessageError("expected something that this page can do")

    def _as_holder(
        self, person: Person, do: str, message: Mapping[str, Any], now: float
    ) -> list[Output]:
        match do:
            case "leave":
                return self._give(None, now, "")
            case "command":
                command = _text(message, "command")
                if command == "go":
                    return self._request(person, f"go {_seen(message)}")
                if command not in REQUESTS or command == "kill":
                    raise _MessageError("expected a command")
                return self._request(person, command)
            case "kill":
                number = _text(message, "number")
                if number and not (number.isascii() and number.isdigit() and len(number) <= 8):
                    raise _MessageError("expected a number")
                return self._request(person, f"kill {number}".strip())
            case "cancel kill":
                return self._cancel_kill(person)
            case _:
                return self._reply(person, do, now)

    def _reply(self, person: Person, do: str, now: float) -> list[Output]:
        """Hand command over to the person who asks for it, or keep it."""
        if self._asking is None:
            return self._say(person, do, "no one asks for command now")
        asking, _ = self._asking
        if do == "hand over":
            return self._give(asking, now, "")
        self._asking = None
        out = self._say(asking, "take", f"{person.words} keeps command")
        return [*out, *self._everyone(now)]

    def _take(self, person: Person, now: float) -> list[Output]:
        holder = self._holder
        if holder is person:
            return []
        if holder is None or holder.connection is None:
            return self._give(person, now, f"{holder.words} is not connected" if holder else "")
        if self._asking is not None:
            if self._asking[0] is person:
                return []
            return self._say(person, "take", f"{self._asking[0].words} has asked before")
        self._asking = person, now
        return self._everyone(now)

    def _give(self, person: Person | None, now: float, why: str) -> list[Output]:
        """Give command to a person, or to no one."""
        before, self._holder, self._asking = self._holder, person, None
        out = self._cancel_kill(before) if before else []
        words = f"{person.words} takes command" if person else "no one has command of the console"
        if before is not None:
            words += f" from {before.words}" if person else f": {before.words} left it"
        return [*out, _note(f"{words} ({why})" if why else words), *self._everyone(now)]

    def _request(self, person: Person, command: str) -> list[Output]:
        if self.closed:
            return self._say(person, command, self.closed)
        self._asked.append((person, command))
        if command != "kill" and command.startswith("kill"):
            self._kill = None
        return [Tell(f"name {person.words}"), Tell(command)]

    def _cancel_kill(self, person: Person) -> list[Output]:
        """Have the number for kill made invalid that a person got."""
        if self._kill is not person:
            return []
        self._kill = None
        return self._request(person, "kill cancel")

    # People and tokens

    def _returning(self, key: str) -> Person | None:
        return next((user for user in self._people.values() if key and _same(key, user.key)), None)

    def _new_person(self) -> Person:
        while len(self._people) >= _MOST_PEOPLE:
            gone = [user for user in self._people.values() if user.connection is None]
            del self._people[min(gone, key=lambda user: user.lost_at).number]
        self._number += 1
        person = Person(self._number, "", self._new_key(), None)
        self._people[person.number] = person
        return person

    def _count_wrong(self, address: str, wrong: Allowance) -> list[Output]:
        """Count a wrong token; the record has the first one with which an address is stopped."""
        wrong.take()
        self._wrong.pop(address, None)
        while len(self._wrong) >= _MOST_ADDRESSES:
            del self._wrong[next(iter(self._wrong))]
        self._wrong[address] = wrong
        if wrong.left >= 1.0 or wrong.reported:
            return []
        wrong.reported = True
        return [_note(f"wrong tokens for the console from {address}")]

    def _close(self, connection: int, code: int, reason: str, now: float) -> list[Output]:
        return [Close(connection, code, reason), *self.disconnect(connection, now)]

    def _say(self, person: Person, command: str, words: str) -> list[Output]:
        """Return an answer of the console itself."""
        if person.connection is None:
            return []
        return [Send(person.connection, {"kind": "answer", "command": command, "words": words})]

    def _count_screens(self, now: float) -> list[Output]:
        """Tell the flight how many people look at it, where the number has changed."""
        before = self.screens
        self.screens = sum(
            user.connection is not None or now - user.lost_at <= ABSENT_TIME
            for user in self._people.values()
        )
        return [] if self.screens == before else [Tell(f"screens {self.screens}")]

    def _everyone(self, now: float) -> list[Output]:
        """Tell all who is there, who has command, and who asks for it."""
        asking = self._asking
        seconds = None if asking is None else max(ANSWER_TIME - (now - asking[1]), 0.0)
        message = {
            "kind": "people",
            "people": [
                {"number": user.number, "words": user.words, "here": user.connection is not None}
                for user in self._people.values()
            ],
            "holder": self._holder.number if self._holder else None,
            "asking": None if asking is None else asking[0].number,
            "left": seconds,
        }
        return [Send(connection, message) for connection in self.joined]


def _parsed(text: str | bytes) -> Mapping[str, Any]:
    if isinstance(text, bytes) or len(text) > LARGEST_MESSAGE:
        raise _MessageError("expected a short text")
    try:
        message = json.loads(text)
    except (ValueError, RecursionError):
        raise _MessageError("expected JSON") from None
    if not isinstance(message, dict):
        raise _MessageError("expected an object")
    return message


def _text(message: Mapping[str, Any], key: str) -> str:
    value = message.get(key, "")
    if not isinstance(value, str):
        raise _MessageError(f"{key}: expected a text")
    return value


def _seen(message: Mapping[str, Any]) -> float:
    """Return the time of the state that the page of a go has drawn."""
    seen = message.get("seen")
    if isinstance(seen, bool) or not isinstance(seen, int | float):
        raise _MessageError("seen: expected a time")
    return seen


def _name(message: Mapping[str, Any]) -> str:
    return " ".join(printable(_text(message, "name")).split())[:_LONGEST_NAME]


def _plain(token: str) -> str:
    """Return a token as it is compared: people type it with and without hyphens."""
    return "".join(token.replace("-", "").split()).lower()


def _same(first: str, second: str) -> bool:
    """Compare two secrets in a time that says nothing about them."""
    return hmac.compare_digest(first.encode("utf-8", "replace"), second.encode("utf-8", "replace"))


def _note(words: str) -> Tell:
    return Tell(f"note {words}")
