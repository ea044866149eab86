"""Commands to one vehicle, each followed to its acknowledgement and to the state it should bring.

Sans-IO: :class:`CommandQueue` says what to send when, and what became of it. One command of a kind
(MAV_CMD number) is under way at a time, since acknowledgements carry nothing else.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

from pymavlink.dialects.v20 import common

from swarm.mavlink.packets import GROUND_COMPONENT, GROUND_SYSTEM, Message

RESEND_AFTER = 1.0
"""Seconds without an acknowledgement after which a command is sent again."""
ATTEMPTS = 5
IN_PROGRESS_PATIENCE = 5.0
"""Seconds that each IN_PROGRESS buys."""
RETRY_REJECTED_AFTER = 1.0
_MAYBE_LATER = frozenset(
    {int(common.MAV_RESULT_TEMPORARILY_REJECTED), int(common.MAV_RESULT_FAILED)}
)
"""Refusals that may not last: ArduPilot says FAILED of what it would take a moment later."""
STATE_PATIENCE = 4.0
"""Seconds between an acknowledgement and the state that it promised."""

Reached = Callable[[], bool]

RESULTS = {
    int(value): name.removeprefix("MAV_RESULT_").replace("_", " ").lower()
    for name, value in vars(common).items()
    if name.startswith("MAV_RESULT_") and not name.endswith("ENUM_END")
}


@dataclass(frozen=True)
class Command:
    """A command: its name in words, MAV_CMD number, seven parameters.

    ``reached`` tells whether the state that it should bring is there; None where the
    acknowledgement is all there is. ``retry_for`` is how long refusals that may not last are
    answered by asking again.
    """

    name: str
    number: int
    parameters: Sequence[float]
    reached: Reached | None = None
    state_patience: float = STATE_PATIENCE
    retry_for: float = 0.0


@dataclass(frozen=True)
class Outcome:
    """What became of a command, after how many seconds; ``reason`` says why it failed."""

    command: Command
    succeeded: bool
    after: float
    reason: str = ""


@dataclass
class _Underway:
    command: Command
    since: float
    stage: Literal["waiting", "acknowledged"] = "waiting"
    attempts: int = 0
    next_send: float = 0.0
    deadline: float | None = None
    asked_again: bool = False


@dataclass
class CommandQueue:
    """The commands of one vehicle."""

    system: int
    component: int
    latencies: list[float] = field(default_factory=list)
    _underway: dict[int, _Underway] = field(default_factory=dict)
    _waiting: list[Command] = field(default_factory=list)
    _outcomes: list[Outcome] = field(default_factory=list)
    busy: bool = False
    """Whether a command may be under way, waiting, or done and not yet reported."""

    @property
    def idle(self) -> bool:
        """Whether no command is under way, waiting, or done and not yet reported."""
        return not (self._underway or self._waiting or self._outcomes)

    def put(self, command: Command) -> None:
        """Queue a command; it is sent at the next tick unless one of its kind is under way."""
        self._waiting.append(command)
        self.busy = True

    def has(self, name: str) -> bool:
        """Whether a command of that name is under way or waiting."""
        return any(one.command.name == name for one in self._underway.values()) or any(
            command.name == name for command in self._waiting
        )

    def drop_all(self) -> None:
        """Forget everything that is waiting or under way."""
        self._waiting.clear()
        self._underway.clear()

    def acknowledge(self, message: Message, now: float) -> None:
        """Take a COMMAND_ACK that came from this vehicle."""
        if message.target_system not in {0, GROUND_SYSTEM} or message.target_component not in {
            0,
            GROUND_COMPONENT,
        }:
            return
        one = self._underway.get(message.command)
        if one is None or one.stage == "acknowledged":
            return
        match message.result:
            case common.MAV_RESULT_ACCEPTED:
                self.latencies.append(now - one.since)
                if one.command.reached is None:
                    self._finish(one, now, succeeded=True)
                else:
                    one.stage = "acknowledged"
                    one.deadline = now + one.command.state_patience
            case common.MAV_RESULT_IN_PROGRESS:
                one.next_send = now + IN_PROGRESS_PATIENCE
            case result if result in _MAYBE_LATER and now - one.since < one.command.retry_for:
                one.next_send = now + RETRY_REJECTED_AFTER
                one.attempts, one.asked_again = 0, True
            case result:
                self._finish(one, now, succeeded=False, reason=RESULTS.get(result, str(result)))

    def tick(self, now: float) -> tuple[list[Message], list[Outcome]]:
        """Return what to send now and what became of commands since the last tick."""
        sending: list[Message] = []
        for one in list(self._underway.values()):
            self._advance(one, now, sending)
        while (command := self._startable()) is not None:
            self._waiting.remove(command)
            one = _Underway(command, since=now, next_send=now)
            self._underway[command.number] = one
            self._advance(one, now, sending)
        outcomes, self._outcomes = self._outcomes, []
        self.busy = not self.idle
        return sending, outcomes

    def _startable(self) -> Command | None:
        return next((c for c in self._waiting if c.number not in self._underway), None)

    def _advance(self, one: _Underway, now: float, sending: list[Message]) -> None:
        if one.command.reached is not None and one.command.reached():
            self._finish(one, now, succeeded=True)
        elif one.deadline is not None and now >= one.deadline:
            self._finish(one, now, succeeded=False, reason="accepted, but it did not happen")
        elif one.stage == "waiting" and now >= one.next_send:
            if one.attempts >= ATTEMPTS:
                self._finish(one, now, succeeded=False, reason="no answer")
                return
            sending.append(self._message(one))
            one.attempts += 1
            one.next_send = now + RESEND_AFTER

    def _message(self, one: _Underway) -> Any:
        return common.MAVLink_command_long_message(
            self.system,
            self.component,
            one.command.number,
            min(one.attempts, 255),
            *one.command.parameters,
        )

    def _finish(self, one: _Underway, now: float, *, succeeded: bool, reason: str = "") -> None:
        self._underway.pop(one.command.number, None)
        self._outcomes.append(Outcome(one.command, succeeded, now - one.since, reason))
