"""One flight on real links, from the first heartbeat to the closed record."""

import queue
import signal
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import FrameType
from typing import Any

from swarm.errors import Refused, SwarmError
from swarm.flight.adherence import adherence
from swarm.flight.clearance import Audit, go
from swarm.flight.conductor import Conductor
from swarm.flight.flight_plan import ComparisonFlight, FlightPlan
from swarm.flight.jit_warm_up import warm_up
from swarm.flight.parameters import demands_of_plan, stream_loss_findings, stream_loss_model
from swarm.flight.result import FlightResult
from swarm.flight.resuming import LeftOff, Then
from swarm.flight.setup import Options
from swarm.flight.snapshot import Event, Snapshot
from swarm.flight.tlog import ClockTeller
from swarm.flight.world import emulated_world
from swarm.ground.commissioning.audit import Auditor, save_parameters
from swarm.ground.emulator import EmulatorProcess
from swarm.ground.loop import Loop
from swarm.ground.operator import ControlSocket, Desk, keys
from swarm.ground.priority import run_behind_main_thread
from swarm.ground.record import Record
from swarm.ground.relay import Relay
from swarm.ground.signing_key import signing_with
from swarm.ground.sockets import Links, open_links
from swarm.mission.fleet import Fleet

SNAPSHOT_INTERVAL = 0.1
_MOST_WAITING = 200

Confirm = Callable[[Audit], bool]


def fly(
    flight_plan: FlightPlan,
    fleet: Fleet,
    record_folder: Path,
    *,
    speed: float = 1.0,
    no_cable: bool = False,
    confirm: Confirm | None = None,
    on_snapshot: Callable[[Snapshot], None] | None = None,
    on_event: Callable[[Event], None] | None = None,
    on_emulator: Callable[[int], None] | None = None,
    control: Path | None = None,
    take_keys: bool = False,
    typed: "queue.SimpleQueue[str] | None" = None,
    audit: bool | None = None,
    left: LeftOff | None = None,
    then: Then = "hold",
    stray_limit: float | None = None,
) -> FlightResult:
    """Fly a checked plan; returns how it went, with the record in ``record_folder``.

    ``confirm`` is asked, in a thread of its own, once the team has been audited on the ground; no
    answer, no flight. Without it a clean audit is enough. ``on_snapshot`` is called about ten times
    a second, ``on_event`` for every event, both in a thread of their own which may be slow: what it
    cannot take is dropped. ``on_emulator`` is told the emulator's process id. ``speed`` is for
    emulated fleets only. ``control`` is where the control socket is made, ``take_keys`` reads
    single keys from the terminal (:mod:`swarm.ground.operator`), ``typed`` are keys that were typed
    elsewhere. ``audit`` asks the vehicles for
    firmware, health and parameters through MAVSDK before the go; None does so for real ones. The
    first SIGINT holds and lands the team, the second lands it at once. ``left`` is where a flight
    broke off whose vehicles still fly: they are found and the plan is taken up there, and ``then``
    follows. ``stray_limit`` is for flights that measure tracking errors: metres beyond which all
    land, and up to which nothing is slowed or held in a hold.

    Raises :class:`swarm.errors.VehicleError` where a link cannot be opened, and
    :class:`swarm.errors.InputError` where the record cannot be written.
    """
    _refuse_unflyable(flight_plan, fleet, speed)
    conductor = _warm(
        Conductor(
            flight_plan,
            fleet,
            Options(no_cable=no_cable, error_limit=stray_limit, speed=speed),
            left=left,
            then=then,
        )
    )
    links = open_links(fleet.links)
    emulator: EmulatorProcess | None = None
    record: Record | None = None
    events: list[Event] = []
    keyed = ExitStack()
    try:
        conductor.team.signing = keyed.enter_context(signing_with(fleet.signing_key))
        record = Record(record_folder, time.time())
        emulator = _emulator(flight_plan, fleet, links, record_folder, speed, no_cable=no_cable)
        # Flight time begins once an emulator speaks, which takes it a while to do.
        record.began = time.time()
        record.before(
            flight_plan,
            conductor.basis,
            fleet,
            {"speed": speed, "no_cable": no_cable, "began": record.began},
        )
        if left is not None:
            record.frames(left.known)
        if emulator is not None and on_emulator is not None:
            on_emulator(emulator.pid)
        desk = Desk(conductor, lambda: conductor.snapshot(conductor.now).available)
        with ExitStack() as around:
            tell = around.enter_context(_listener(on_snapshot, on_event))
            interrupts = around.enter_context(_interrupts())
            poll = [around.enter_context(keys(desk))] if take_keys else []
            if typed is not None:
                poll.append(partial(_taken, typed, desk))
            if control is not None:
                socket = ControlSocket(control, desk)
                around.callback(socket.close)
                poll.append(socket.poll)
            shell = _Shell(conductor, record, events, tell, interrupts, emulator, confirm, poll)
            wanted = audit if audit is not None else fleet.emulated is None
            if wanted and left is None:
                shell.relay = Relay(conductor.team)
                around.callback(shell.relay.close)
            loop = Loop(conductor, links, record, speed, shell.each_tick, shell.relay)
            loop.run()
            shell.each_tick(conductor.now)
        result = _result(conductor, emulator, loop, tuple(events), record_folder)
        record.after(result)
        return result
    finally:
        if emulator is not None:
            emulator.stop()
        if record is not None:
            record.close()
        keyed.close()
        links.close()


def _result(
    conductor: Conductor,
    emulator: EmulatorProcess | None,
    loop: Loop,
    events: tuple[Event, ...],
    folder: Path,
) -> FlightResult:
    outcome = conductor.finished
    if outcome is None:
        raise AssertionError("the loop ends when the conductor has finished")
    if emulator is not None and outcome.word == "failed" and (how := emulator.ended()):
        outcome = replace(outcome, explanation=f"{outcome.explanation}; {how}")
    trace = conductor.trace()
    return FlightResult(
        outcome=outcome,
        trace=trace,
        events=events,
        statistics=replace(
            conductor.statistics(),
            lateness=loop.lateness_quantiles(),
            cpu=loop.cpu,
            unsent=loop.links.dropped(),
        ),
        basis=conductor.basis,
        adherence=adherence(conductor.plan, trace, conductor.basis),
        record=folder,
    )


def _refuse_unflyable(flight_plan: FlightPlan, fleet: Fleet, speed: float) -> None:
    if isinstance(flight_plan, ComparisonFlight):
        raise Refused("a comparison is flown by swarm dry-run alone: its plan need not be cleared")
    if fleet.emulated is None and speed != 1.0:
        raise Refused("only emulated vehicles fly faster than time")


def _warm(conductor: Conductor) -> Conductor:
    warm_up(conductor)
    return conductor


def _emulator(
    flight_plan: FlightPlan,
    fleet: Fleet,
    links: Links,
    folder: Path,
    speed: float,
    *,
    no_cable: bool,
) -> EmulatorProcess | None:
    """Start the emulator where the fleet is flown by it."""
    if fleet.emulated is None:
        return None
    seed = fleet.emulated.seed
    world = emulated_world(flight_plan.plan, fleet, with_cable=not no_cable, seed=seed)
    port = links.port(next(iter(fleet.links)))
    return EmulatorProcess(world, folder, port, speed, fleet.signing_key)


def _taken(typed: "queue.SimpleQueue[str]", desk: Desk) -> None:
    """Take the keys that were typed elsewhere."""
    with suppress(queue.Empty):
        while True:
            desk.key(typed.get_nowait())


class _Shell:
    """What happens around every tick: events out, wishes in, clearance."""

    def __init__(
        self,
        conductor: Conductor,
        record: Record,
        events: list[Event],
        tell: Callable[[Snapshot | Event], None],
        interrupts: list[int],
        emulator: EmulatorProcess | None,
        confirm: Confirm | None,
        polls: Sequence[Callable[[], None]] = (),
    ) -> None:
        self._polls = polls
        self._conductor, self._record, self._events = conductor, record, events
        self._tell, self._interrupts, self._emulator = tell, interrupts, emulator
        self._confirm = confirm
        self._next_snapshot = 0.0
        self._told_of_disk = False
        self._clock = ClockTeller(conductor.plan)
        self._answer: queue.SimpleQueue[Audit | str] | None = None
        self.relay: Relay | None = None

    def each_tick(self, now: float) -> None:
        conductor = self._conductor
        while self._interrupts:
            self._interrupts.pop()
            conductor.request("interrupt")
        for poll in self._polls:
            poll()
        if conductor.stage == "ready" and conductor.audit is not None:
            self._clear(conductor.audit)
        for event in conductor.events():
            self._events.append(event)
            self._record.event(event)
            self._tell(event)
        if now >= self._next_snapshot:
            self._next_snapshot = now + SNAPSHOT_INTERVAL
            self._tell(conductor.snapshot(now))
            if self._record.problem is not None and not self._told_of_disk:
                self._told_of_disk = True
                words = f"the record cannot be written: {self._record.problem}; the flight goes on"
                conductor.report("record", words)
            phase = conductor.phase.name if conductor.stage == "fly" else ""
            if conductor.stage in {"ready", "fly", "leave"}:
                self._record.packet(self._clock.tell(now, conductor.clock.time, phase), now)
            if conductor.stage in {"listen", "prepare"} and self._emulator is not None:
                how = self._emulator.ended()
                if how is not None:
                    conductor.give_up(how)

    def _clear(self, audit: Audit) -> None:
        """Ask for the go once, without waiting for the answer, and start when it has come."""
        if self._answer is None:
            self._answer = queue.SimpleQueue()
            ask = _Asking(
                self._conductor,
                self.relay,
                self._confirm,
                audit,
                self._answer,
                self._record.folder,
            )
            if self._confirm is None and self.relay is None:
                ask.run()
            else:
                threading.Thread(target=ask.run, name="audit", daemon=True).start()
        with suppress(queue.Empty):
            answer = self._answer.get_nowait()
            if self.relay is not None:
                self.relay.closed = True
            if isinstance(answer, Audit):
                try:
                    self._conductor.start(go(self._conductor.flight_plan, answer))
                except Refused as error:
                    self._conductor.refuse(str(error))
            else:
                self._conductor.refuse(answer)


class _Asking:
    """What takes time before the go: the audit of the vehicles, and a person's answer."""

    def __init__(
        self,
        conductor: Conductor,
        relay: Relay | None,
        confirm: Confirm | None,
        audit: Audit,
        answer: "queue.SimpleQueue[Audit | str]",
        folder: Path,
    ) -> None:
        self._folder = folder
        self._conductor, self._relay, self._confirm = conductor, relay, confirm
        self._audit, self._answer = audit, answer

    def run(self) -> None:
        """Put an audit into the answer, or why there is none."""
        try:
            audit = self._audit if self._relay is None else self._with_vehicles(self._relay)
            confirmed = not audit.passed or self._confirm is None or self._confirm(audit)
            self._answer.put(audit if confirmed else "not confirmed")
        except SwarmError as error:
            self._answer.put(str(error))
        except BaseException:
            self._answer.put("the question before the flight failed")
            raise

    def _with_vehicles(self, relay: Relay) -> Audit:
        flyers = self._conductor.flyers
        names = {v.system: v.autopilot.name for v in flyers if v.autopilot is not None}
        plan, fleet = self._conductor.plan, self._conductor.fleet
        audits = Auditor(relay, names, demands_of_plan(plan, fleet)).audit()
        with suppress(OSError):
            save_parameters(self._folder, audits)
        values = {one.system: one.parameters for one in audits}
        flown = [(names[v.system], values[v.system]) for v in flyers if v.system in names]
        known, coasting = stream_loss_findings(plan, stream_loss_model(flown, fleet.limits))
        takes = plan.duration + known.delay
        battery = 100.0 * takes / plan.mission.vehicles.endurance
        found = [finding for one in audits for finding in one.findings(battery)]
        findings = (*self._audit.findings, *found, *coasting)
        return replace(self._audit, findings=findings, stream_loss=known)


@contextmanager
def _interrupts() -> Iterator[list[int]]:
    """Collect SIGINT and SIGTERM instead of being ended by them, where this is the main thread."""
    caught: list[int] = []
    if threading.current_thread() is not threading.main_thread():
        yield caught
        return

    def catch(number: int, _frame: FrameType | None) -> None:
        caught.append(number)

    before = {number: signal.signal(number, catch) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield caught
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def _listener(
    on_snapshot: Callable[[Snapshot], None] | None, on_event: Callable[[Event], None] | None
) -> Iterator[Callable[[Snapshot | Event], None]]:
    """Give snapshots and events to callbacks in a thread that cannot hold the flight up."""
    waiting: queue.Queue[Any] = queue.Queue(_MOST_WAITING)

    def tell(what: Snapshot | Event) -> None:
        wanted = on_event if isinstance(what, Event) else on_snapshot
        if wanted is not None:
            with suppress(queue.Full):
                waiting.put_nowait(what)

    def work() -> None:
        run_behind_main_thread()
        while (what := waiting.get()) is not None:
            if isinstance(what, Event):
                if on_event is not None:
                    on_event(what)
            elif on_snapshot is not None:
                on_snapshot(what)

    worker = threading.Thread(target=work, name="listener", daemon=True)
    worker.start()
    try:
        yield tell
    finally:
        with suppress(queue.Full):
            waiting.put(None, timeout=1.0)
        worker.join(2.0)
