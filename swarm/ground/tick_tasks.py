"""The work of the flight process after every tick: requests, events, snapshots, the go."""

import queue
import threading
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Literal

from swarm.errors import Refused
from swarm.flight.clearance import Audit, go
from swarm.flight.conductor import Conductor
from swarm.flight.operator import Request
from swarm.flight.snapshot import Event, Snapshot
from swarm.flight.tlog import ClockEncoder
from swarm.ground.emulator import EmulatorProcess
from swarm.ground.loop import Feed
from swarm.ground.operator import TERMINAL, ControlSocket, OperatorConsole
from swarm.ground.preflight import Preflight
from swarm.ground.record import Record

SNAPSHOT_INTERVAL = 0.1

Unattended = Literal["hold", "land", "fly-on"]
"""What the team does when the last screen of its flight is gone."""

_ABSENCE: Mapping[Unattended, str] = {
    "hold": "the last screen is gone: the team holds, and lands after the hold timeout",
    "land": "the last screen is gone: the team lands",
    "fly-on": "the last screen is gone: the flight goes on",
}


@dataclass(frozen=True)
class Caller:
    """The process that began the flight, its first screen: its keys and interrupts.

    ``gone`` is set when it has ended, or has lost its terminal.
    """

    keys: "queue.SimpleQueue[str]" = field(default_factory=queue.SimpleQueue)
    interrupts: list[int] = field(default_factory=list)
    gone: threading.Event = field(default_factory=threading.Event)

    def key_reader(self, console: OperatorConsole) -> Callable[[], None]:
        """Return a function that handles the keys that have arrived."""

        def poll() -> None:
            with suppress(queue.Empty):
                while True:
                    console.key(self.keys.get_nowait())

        return poll


@dataclass
class TickTasks:
    """Passes requests to the conductor, and its events and snapshots to record and callbacks.

    ``inputs`` and ``control`` are polled for operator requests. When the last screen of the flight
    is gone, the team holds, lands or flies on, as ``unattended`` says. ``events`` are all events so
    far. What ``feeds`` miss is reported.
    """

    conductor: Conductor
    record: Record
    preflight: Preflight
    publish: Callable[[Snapshot | Event], None]
    caller: Caller
    emulator: EmulatorProcess | None = None
    inputs: Sequence[Callable[[], None]] = ()
    events: list[Event] = field(default_factory=list)
    feeds: Sequence[Feed] = ()
    control: ControlSocket | None = None
    unattended: Unattended = "hold"
    _alone: bool = False
    _due: bool = False
    _next_snapshot: float = 0.0
    _disk_reported: bool = False
    _phase: str = ""

    def __post_init__(self) -> None:
        self._clock = ClockEncoder(self.conductor.plan)

    def run(self, now: float) -> None:
        """Do the work after the tick at ``now``."""
        conductor = self.conductor
        while self.caller.interrupts:
            self.caller.interrupts.pop()
            conductor.request("interrupt", TERMINAL)
        for poll in self.inputs:
            poll()
        if self.control is not None:
            self.control.poll()
        self._respond_to_absence()
        if conductor.stage == "ready" and conductor.audit is not None:
            self._decide(conductor.audit)
        for event in conductor.events():
            self.events.append(event)
            self.record.event(event)
            self._show(event)
        if now >= self._next_snapshot:
            self._next_snapshot = now + SNAPSHOT_INTERVAL
            self._snapshot(now)

    def _respond_to_absence(self) -> None:
        """Report that the last screen is gone, or that one is back; hold or land once possible."""
        conductor, control = self.conductor, self.control
        watched = control is not None and control.watched
        alone = self.caller.gone.is_set() and not watched
        if alone != self._alone:
            self._alone = alone
            self._due = alone and self.unattended != "fly-on"
            words = _ABSENCE[self.unattended] if alone else "a screen is attached again"
            conductor.report("screens", words)
        if not self._due:
            return
        on_ground = conductor.stage in {"prepare", "ready"}
        command: Request = (
            "interrupt" if on_ground else "land" if self.unattended == "land" else "hold"
        )
        if conductor.available()[command].open:
            self._due = False
            conductor.request(command, "the absence of screens")

    def _show(self, item: Snapshot | Event) -> None:
        self.publish(item)
        if self.control is not None:
            self.control.publish(item)

    def _snapshot(self, now: float) -> None:
        conductor, record = self.conductor, self.record
        self._show(conductor.snapshot(now))
        if record.problem is not None and not self._disk_reported:
            self._disk_reported = True
            text = f"the record cannot be written: {record.problem}; the flight goes on"
            conductor.report("record", text)
        phase = conductor.phase.name if conductor.stage == "execute" else ""
        if (entered := phase or conductor.stage) != self._phase:
            self._phase = entered
            conductor.report("phase", entered)
        for feed in self.feeds:
            if (change := feed.change(now)) is not None:
                conductor.report(*change)
        if conductor.stage in {"ready", "execute", "contingency"}:
            record.packet(self._clock.encode(now, conductor.clock.time, phase), now)
        if conductor.stage == "prepare" and self.emulator is not None:
            ended = self.emulator.ended()
            if ended is not None:
                conductor.give_up(ended)

    def _decide(self, audit: Audit) -> None:
        """Start the preflight once; start or refuse the flight when it has decided."""
        preflight, conductor = self.preflight, self.conductor
        if not preflight.started:
            preflight.start(audit)
        decision = preflight.decision()
        if decision is None:
            return
        if preflight.relay is not None:
            preflight.relay.closed = True
        if isinstance(decision, str):
            conductor.refuse(decision)
            return
        try:
            conductor.start(go(conductor.flight_plan, decision))
        except Refused as error:
            conductor.refuse(str(error))
