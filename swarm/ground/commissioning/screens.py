"""The screens of a check on the ground: its page shows what is done now, and what was found.

They are clients of a control socket, as those of a flight. Of the requests of a flight a check has
three: the answers to its question, and its end. The check works in a thread; the loop beside it
polls the socket.
"""

import json
import threading
import time
from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path

from swarm.certification.findings import Finding, by_system
from swarm.errors import Interrupted
from swarm.files import write_bytes, write_text
from swarm.flight.fleet_listener import FleetListener
from swarm.flight.requests import Request, request_words
from swarm.flight.snapshot import Checked, Event
from swarm.flight.stages import CheckStep
from swarm.ground.operator import CLIENT, ControlSocket, OperatorConsole
from swarm.mission.fleet import Fleet
from swarm.planning import Plan
from swarm.planning.archive import plan_document, plan_motion

INTERVAL = 0.1
"""Seconds between two snapshots."""
_LAST_WORDS = 2.0
"""Seconds in which screens get the result."""


@dataclass
class Question:
    """A question of a check, asked at the time ``asked``; the first answer of any screen counts."""

    words: str
    asked: float
    answer: bool | None = None
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def settle(self, answer: bool) -> bool:
        """Answer the question; return whether this is the answer that counts."""
        with self._lock:
            if self.answer is None:
                self.answer = answer
            return self.answer is answer


@dataclass
class CheckScreens:
    """What a check shows on its screens; without a ``control`` socket there are none.

    The check sets ``step`` and calls the methods from its thread.
    """

    control: Path | None = None
    step: CheckStep = CheckStep.VEHICLES
    steps: Sequence[str] = ()
    _listener: FleetListener | None = None
    _socket: ControlSocket | None = None
    _share: float = 0.0
    _doing: str = ""
    _states: Mapping[int, str] = field(default_factory=dict)
    _moving: int | None = None
    _wrong: Mapping[int, str] = field(default_factory=dict)
    _waiting: "deque[Event | Checked]" = field(default_factory=deque)
    _question: Question | None = None
    _ended_by: str | None = None
    _next: float = 0.0

    @contextmanager
    def opened(self, listener: FleetListener, plan: Plan | None) -> Iterator[None]:
        """Open the control socket, beside fleet and plan for the console; close it at the end."""
        self._listener = listener
        if self.control is None:
            yield
            return
        _describe(self.control.parent, listener.fleet, plan)
        self._socket = ControlSocket(
            self.control, lambda: OperatorConsole(self, self.available, CLIENT)
        )
        self.findings(())
        try:
            yield
        finally:
            self._socket.close()

    # For the check, in its thread

    def begin(self, step: CheckStep) -> None:
        """Begin a step."""
        self.step, self._share, self._doing = step, 0.0, ""
        self._states, self._moving = {}, None

    def progress(self, words: str, share: float) -> None:
        """Show what is done now, and the completed share of the step."""
        self._doing, self._share = words, max(self._share, share)

    def guide(self, words: str, states: Mapping[int, str], moving: int | None) -> None:
        """Show what a person is to do now, the states of systems in words, and which to move."""
        self._doing, self._states, self._moving = words, states, moving

    def say(self, words: str) -> None:
        """Add a line to the events."""
        self._waiting.append(Event(self.now, "check", words))

    def findings(self, findings: Iterable[Finding]) -> None:
        """Show all findings so far, and what is wrong in the rows of the vehicles."""
        findings = tuple(findings)
        wrong = [finding for finding in findings if finding.severity != "info"]
        self._wrong = by_system(sorted(wrong, key=lambda finding: finding.severity))
        self._waiting.append(Checked(findings, tuple(self.steps)))

    @contextmanager
    def asking(self, words: str) -> Iterator[Question]:
        """Ask whether to do what the words say; yields the question, which a screen may settle."""
        self._question = Question(words, self.now)
        try:
            yield self._question
        finally:
            self._question = None

    # For the loop

    def run(self, now: float) -> None:
        """Do what is due; raises :class:`Interrupted` where a screen has ended the check."""
        if self._socket is None or self._listener is None:
            return
        self._socket.poll()
        if self._ended_by is not None:
            raise Interrupted(f"ended by {self._ended_by}")
        while self._waiting:
            self._socket.publish(self._waiting.popleft())
        if now >= self._next:
            self._next = now + INTERVAL
            self._socket.publish(
                self._listener.snapshot(
                    self.step, self._place(), self._doing, self._states, self._moving, self._wrong,
                    dict(self.available().items()),
                )
            )  # fmt: skip

    def _place(self) -> float:
        """Return how far the check has come: steps, and the share of the present one."""
        if self.step not in self.steps:
            return float(len(self.steps))
        return self.steps.index(self.step) + min(max(self._share, 0.0), 1.0)

    def end(self, outcome: str, explanation: str, code: int) -> None:
        """Show the result, and write it beside the record, where the console reads it."""
        if self._socket is None or self.control is None:
            return
        text = {"outcome": outcome, "explanation": explanation, "exit_code": code}
        with suppress(OSError):
            (self.control.parent / "summary.json").write_text(json.dumps(text, indent=1))
        self.begin(CheckStep.RESULT)
        latest = time.monotonic() + _LAST_WORDS
        while self._waiting and time.monotonic() < latest:
            self._socket.publish(self._waiting.popleft())
        self._next = 0.0
        with suppress(Interrupted):
            self.run(self.now)

    # For the operator's console

    @property
    def now(self) -> float:
        """The time of snapshots and events."""
        return self._listener.now if self._listener is not None else 0.0

    @property
    def asked_at(self) -> float | None:
        """The time at which the present question was asked; None without one."""
        question = self._question
        return question.asked if question is not None else None

    def available(self) -> Mapping[Request, tuple[bool, str]]:
        """Return the requests of a check, with their effects."""
        question = self._question
        asked = question.words if question is not None and question.answer is None else ""
        return {
            "go": (bool(asked), asked or "nothing is asked now"),
            "refuse": (bool(asked), "changes nothing" if asked else "nothing is asked now"),
            "interrupt": (True, "ends the check: no vehicle is armed"),
        }

    def request(self, request: Request, author: str) -> str:
        """Carry out a request; return its effect."""
        question, closed = self._question, (False, "no vehicle flies in a check")
        possible, words = self.available().get(request, closed)
        if possible and request == "interrupt":
            self._ended_by = author
        elif possible and not (question is not None and question.settle(request == "go")):
            words = "answered before, or asked no more: changes nothing"
        self.report("operator", request_words(request, author, words))
        return words

    def report(self, kind: str, message: str) -> None:
        """Add an event."""
        self._waiting.append(Event(self.now, kind, message))


def _describe(folder: Path, fleet: Fleet, plan: Plan | None) -> None:
    """Write fleet and plan where the console reads them; raises InputError where it cannot."""
    write_text(folder / "fleet.json", fleet.model_dump_json(by_alias=True, indent=1))
    if plan is not None:
        write_text(folder / "plan.json", json.dumps(plan_document(plan), indent=1))
        write_bytes(folder / "motion.npz", plan_motion(plan))
