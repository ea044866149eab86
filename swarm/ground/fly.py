"""One flight on real links, from the first heartbeat to the closed record.

Before the go, vehicles are audited and a person confirms: both block, so they run in a thread
beside the flight loop. So do the callbacks, which cannot delay it. After every tick come requests,
events, snapshots and the go.
"""

import math
import queue
import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from types import FrameType
from typing import Any, Literal, TypeVar

import numpy as np

from swarm import precompile
from swarm.errors import InputError, Problem, Refused, SwarmError
from swarm.flight.bodies import pose_rows
from swarm.flight.conductor import Conductor
from swarm.flight.fleet_listener import position_quality
from swarm.flight.flight_plan import Audit, ComparisonFlight, FlightPlan, go, require_tracking
from swarm.flight.parameters import (
    plan_requirements,
    start_as_required,
    stream_loss_findings,
    stream_loss_model,
)
from swarm.flight.requests import ABSENCE, Request
from swarm.flight.responding import COUNTDOWN
from swarm.flight.result import FlightResult, adherence, skipped_words
from swarm.flight.setup import FlightOptions
from swarm.flight.snapshot import Checked, Event, Snapshot
from swarm.flight.state import Found
from swarm.flight.tlog import ClockEncoder, LeftOff, Then
from swarm.flight.trace import Trace
from swarm.flight.training import Training, require_emulated
from swarm.flight.world import emulated_world
from swarm.ground.commissioning.check import (
    LOST_SETPOINTS,
    Auditor,
    save_parameters,
    wanted_fence,
)
from swarm.ground.corrections import open_corrections
from swarm.ground.emulator import EmulatorProcess, RealFirmware
from swarm.ground.loop import Feed, Loop
from swarm.ground.mocap import Capture, DatagramCapture, MocapBridge, origin_of
from swarm.ground.mocap_bridge import Borrowed, links_of, open_mocap
from swarm.ground.operator import (
    CLIENT,
    TERMINAL,
    ControlSocket,
    OperatorConsole,
    signal_handlers,
)
from swarm.ground.priority import run_behind_main_thread
from swarm.ground.record import Record, shared_folder
from swarm.ground.record_reader import recorded_flight
from swarm.ground.relay import Relay, open_forward
from swarm.ground.signing_key import signing_with
from swarm.ground.sockets import Links
from swarm.ground.world_clock import WorldClock, open_clock
from swarm.jit import sealed
from swarm.mission.fleet import Fleet

T = TypeVar("T")

_MAX_QUEUED = 200
_SEARCH = 10.0
"""Seconds in which a team that holds is found: streams begin in 2.5 s, then it rests for 1 s."""


@dataclass(frozen=True)
class FlightCallbacks:
    """Functions that a flight calls, each in a thread of its own or of the caller.

    - ``confirm``: called once the team has been audited on the ground; False refuses the flight.
      Without it an audit without errors is enough. None: it cannot be asked any more.
    - ``on_answered``: called when ``confirm`` need not be answered any more: a screen has answered,
      or the flight has ended.
    - ``on_snapshot``: called about ten times a second.
    - ``on_event``: called for every event.
    - ``on_emulator``: called with the process id of the emulator.

    Snapshots and events that the callbacks are too slow for are dropped.
    """

    confirm: Callable[[Audit], bool | None] | None = None
    on_answered: Callable[[], None] | None = None
    on_snapshot: Callable[[Snapshot], None] | None = None
    on_event: Callable[[Event], None] | None = None
    on_emulator: Callable[[int], None] | None = None


@contextmanager
def publisher(callbacks: FlightCallbacks) -> Iterator[Callable[[Snapshot | Event], None]]:
    """Yield a function that passes snapshots and events to the callbacks, in a thread."""
    on_snapshot, on_event = callbacks.on_snapshot, callbacks.on_event
    waiting: queue.Queue[Any] = queue.Queue(_MAX_QUEUED)

    def publish(item: Snapshot | Event) -> None:
        callback = on_event if isinstance(item, Event) else on_snapshot
        if callback is not None:
            with suppress(queue.Full):
                waiting.put_nowait(item)

    def work() -> None:
        run_behind_main_thread()
        while (item := waiting.get()) is not None:
            if isinstance(item, Event):
                if on_event is not None:
                    on_event(item)
            elif on_snapshot is not None:
                on_snapshot(item)

    worker = threading.Thread(target=work, name="callbacks", daemon=True)
    worker.start()
    try:
        yield publish
    finally:
        with suppress(queue.Full):
            waiting.put(None, timeout=1.0)
        worker.join(2.0)


@dataclass
class Preflight:
    """Audits the vehicles and obtains the confirmation.

    Without a ``relay`` the vehicles are not audited; without ``confirm`` an audit without errors
    is enough. Parameters are saved in ``folder``. ``poses`` are what vehicles get from motion
    capture, where that is known. Where ``screens_answer``, screens of the flight may answer in the
    place of ``confirm``. ``audited`` has all findings before the question; ``abandoned``: only
    screens can answer it any more. ``doing`` is what takes time now, in words.
    """

    conductor: Conductor
    folder: Path
    confirm: Callable[[Audit], bool | None] | None = None
    relay: Relay | None = None
    screens_answer: bool = False
    started: bool = False
    audited: Audit | None = None
    abandoned: bool = False
    doing: str = ""
    poses: MocapBridge | Borrowed | None = None
    _decision: "queue.SimpleQueue[Audit | str]" = field(default_factory=queue.SimpleQueue)

    def start(self, audit: Audit) -> None:
        """Start with the audit of the flight's preparation; at once if nothing blocks."""
        self.started = True
        if self.confirm is None and self.relay is None:
            self._run(audit)
        else:
            threading.Thread(target=self._run, args=(audit,), name="audit", daemon=True).start()

    def decision(self) -> Audit | str | None:
        """Return the audit to fly with, the reason for a refusal, or None while undecided."""
        with suppress(queue.Empty):
            return self._decision.get_nowait()
        return None

    def _run(self, audit: Audit) -> None:
        try:
            if self.relay is not None:
                audit = self._audit_vehicles(audit, self.relay)
            self.audited, self.doing = audit, ""
            confirmed = not audit.passed or self.confirm is None or self.confirm(audit)
            if confirmed is None and self.screens_answer:
                self.abandoned = True
                return
            self._decision.put(audit if confirmed else "not confirmed")
        except SwarmError as error:
            self._decision.put(str(error))
        except BaseException:
            self._decision.put("the question before the flight failed")
            raise

    def _say(self, words: str, _share: float = 0.0) -> None:
        """Say what takes time now; the auditor's words count its vehicles themselves."""
        self.doing = words

    def _audit_vehicles(self, audit: Audit, relay: Relay) -> Audit:
        """Return the audit with the findings on firmware, health, battery and parameters."""
        flyers = self.conductor.flyers
        names = {v.system: v.autopilot.name for v in flyers if v.autopilot is not None}
        plan, fleet = self.conductor.plan, self.conductor.fleet
        required, gps = plan_requirements(plan, fleet), fleet.frame == "gps"
        audits = Auditor(relay, names, required, self._say, on_earth=gps).audit()
        with suppress(OSError):
            save_parameters(self.folder, audits)
        values = {vehicle.system: vehicle.parameters for vehicle in audits}
        flown = [(names[v.system], values[v.system]) for v in flyers if v.system in names]
        model = stream_loss_model(flown, fleet.limits)
        loss, loss_findings = stream_loss_findings(
            self.conductor.flight_plan,
            model,
            lambda share: self._say(f"{LOST_SETPOINTS}, {share:.0%}"),
        )
        duration = plan.flight_duration + loss.delay
        battery = 100.0 * duration / plan.mission.vehicles.endurance
        remarks = [finding for vehicle in audits for finding in vehicle.findings(battery)]
        if gps:
            tracking = plan.mission.vehicles.tracking
            remarks += [position_quality(f"system {v.system}", v, fleet, tracking) for v in flyers]
        if self.poses is not None:
            now = self.conductor.now
            rows = pose_rows(flyers, self.poses.bodies(now), now, positions=True)
            remarks += [row.finding() for row in rows]
        wanted = wanted_fence(plan, flyers, fleet)
        if wanted is not None:
            remarks += [vehicle.fence_finding(wanted) for vehicle in audits]
        findings = (*audit.findings, *remarks, *loss_findings)
        return replace(audit, findings=findings, stream_loss=loss)


SNAPSHOT_INTERVAL = 0.1

Unattended = Literal["hold", "land", "fly-on"]
"""What the team does when the last screen of its flight is gone."""

_ABSENCE: Mapping[Unattended, str] = {
    "hold": "the last screen is gone: the team holds, and lands after the hold timeout",
    "land": "the last screen is gone: the team lands",
    "fly-on": "the last screen is gone: the flight goes on",
}


_INTERRUPTS = (signal.SIGINT, signal.SIGTERM)


@dataclass(frozen=True)
class Caller:
    """The process that began the flight, its first screen: its keys and interrupts.

    ``gone`` is set when it has ended, or has lost its terminal.
    """

    keys: "queue.SimpleQueue[str]" = field(default_factory=queue.SimpleQueue)
    interrupts: list[int] = field(default_factory=list)
    gone: threading.Event = field(default_factory=threading.Event)

    def interrupt(self, number: int, _frame: FrameType | None) -> None:
        """Note a signal; it is handled after the next tick."""
        self.interrupts.append(number)

    def pass_keys(self, console: OperatorConsole) -> None:
        """Pass the keys that have arrived to a console."""
        with suppress(queue.Empty):
            while True:
                console.key(self.keys.get_nowait())


@dataclass
class TickTasks:
    """Passes requests to the conductor, and its events and snapshots to record and callbacks.

    The caller's keys go to ``console``; ``control`` is polled for requests too. When the last
    screen of the flight is gone, the team holds, lands or flies on, as ``unattended`` says.
    ``events`` are all events so far. What ``feeds`` miss is reported. ``on_answered`` is called
    when the question before the flight needs no answer any more.
    """

    conductor: Conductor
    record: Record
    preflight: Preflight
    publish: Callable[[Snapshot | Event], None]
    caller: Caller
    console: OperatorConsole | None = None
    emulator: EmulatorProcess | None = None
    events: list[Event] = field(default_factory=list)
    feeds: Sequence[Feed] = ()
    control: ControlSocket | None = None
    unattended: Unattended = "hold"
    on_answered: Callable[[], None] | None = None
    _answered: bool = False
    _checked: bool = False
    _counted: int = COUNTDOWN + 1
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
        if self.console is not None:
            self.caller.pass_keys(self.console)
        if self.control is not None:
            self.control.poll()
        self._respond_to_absence()
        if conductor.stage == "ready" and conductor.audit is not None:
            self._decide(conductor.audit)
        answered = conductor.stage != "ready" or conductor.go_given is not None
        if self.preflight.started and answered and not self._answered:
            self._answered = True
            if self.on_answered is not None:
                self.on_answered()
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
            conductor.request(command, ABSENCE)

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
        conductor.ground_check(preflight.doing)
        if preflight.audited is not None and not self._checked:
            self._checked = True
            self._ask(preflight.audited)
        decision = preflight.decision()
        if conductor.go_given is not None and not isinstance(decision, str):
            decision = self._count_down(conductor.go_given)
        elif preflight.abandoned and self._alone:
            decision = "not confirmed"
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

    def _ask(self, audit: Audit) -> None:
        """Show the findings before the flight on all screens, and let them answer."""
        warnings = (
            finding
            for finding in self.conductor.flight_plan.assessment.findings
            if finding.severity == "warning"
        )
        if self.control is not None:
            self.control.publish(Checked((*warnings, *audit.findings)))
        preflight = self.preflight
        if preflight.screens_answer and preflight.confirm is not None and audit.passed:
            self.conductor.ask_for_go()

    def _count_down(self, since: float) -> Audit | None:
        """Count down after the go of a screen; return the audit to fly with at the end."""
        seconds = math.ceil(COUNTDOWN - (self.conductor.now - since))
        if seconds <= 0:
            return self.preflight.audited
        if seconds < self._counted:
            self._counted = seconds
            self.conductor.report("countdown", f"take-off in {seconds} s")
        return None


@dataclass(frozen=True)
class FlyOptions:
    """Options of a flight on real links.

    - ``speed``: times real time, for emulated fleets only.
    - ``no_cable``: fly the motion with no cable attached.
    - ``control``: path of the control socket (:mod:`swarm.ground.operator`).
    - ``audit``: get firmware, health and parameters through MAVSDK before the go; None does so for
      real vehicles only.
    - ``left``: the moment at which a flight was interrupted whose vehicles still fly. They are
      found, and the plan continues from there according to ``then``.
    - ``error_limit``: for flights that measure tracking errors: metres beyond which all vehicles
      land; smaller errors do not slow or hold the team.
    - ``forward``: udp://HOST:PORT that gets a copy of all packets of the vehicles.
    - ``firmware``: real autopilots for vehicles of the emulator, as ``swarm sitl --firmware``; they
      start with the parameters that the plan requires. ``positioning``: how they know their
      position, as there.
    - ``mocap``: URL of the motion capture system whose poses are sent to the vehicles
      (:mod:`swarm.ground.mocap`).
    - ``rtcm``: address of a source of corrections that are sent to the vehicles' receivers
      (:mod:`swarm.ground.corrections`).
    - ``world_clock``: file with the time of a world in another process (``swarm sitl --clock``),
      which the flight follows instead of the wall clock.
    - ``unattended``: what the team does when the last screen of the flight is gone.
    - ``training``: the faults that the emulator injects.
    - ``skipped``: the first tests that the fleet has not passed, in words.
    - ``share``: number of the group of accounts that may read the record and attach to the flight,
      with its commands.
    - ``screens_answer``: a screen of the flight, as a console, may give the go before arming, or
      refuse it, in the place of the caller's confirmation.
    """

    speed: float = 1.0
    no_cable: bool = False
    control: Path | None = None
    audit: bool | None = None
    left: LeftOff | None = None
    then: Then = "hold"
    error_limit: float | None = None
    forward: str | None = None
    firmware: str | None = None
    positioning: str = "rtk"
    mocap: str | None = None
    rtcm: str | None = None
    world_clock: Path | None = None
    unattended: Unattended = "hold"
    training: Training | None = None
    skipped: tuple[str, ...] = ()
    screens_answer: bool = False
    share: int | None = None


def fly(
    flight_plan: FlightPlan,
    fleet: Fleet,
    folder: Path,
    options: FlyOptions | None = None,
    callbacks: FlightCallbacks | None = None,
    *,
    caller: Caller | None = None,
) -> FlightResult:
    """Fly a checked plan; return the result, with the record in ``folder``.

    ``caller`` is the process that began the flight, if another one. The first interrupt holds and
    lands the team, the second lands it at once. The caller, and clients that watch the control
    socket, are the screens of the flight; without a screen, ``options.unattended`` says what the
    team does.

    Raises :class:`swarm.errors.VehicleError` for a link that cannot be opened, and
    :class:`swarm.errors.InputError` for a record that cannot be written.
    """
    options, callbacks = options or FlyOptions(), callbacks or FlightCallbacks()
    caller = caller or Caller()
    _refuse_unflyable(flight_plan, fleet, options)
    conductor = _conductor(flight_plan, fleet, options)
    with ExitStack() as resources:
        links, borrowed = resources.enter_context(links_of(fleet, options.mocap))
        conductor.team.signing = resources.enter_context(signing_with(fleet.signing_key))
        resources.enter_context(shared_folder(folder, options.share))
        record = Record(folder, time.time())
        resources.callback(record.close)
        bridge, feeds = _open_feeds(conductor, options, resources, borrowed)
        emulator = _start_emulator(flight_plan, fleet, links, folder, options, bridge)
        if emulator is not None:
            resources.callback(emulator.stop)
        # flight time begins once the emulator sends packets, which takes a while
        record.start_time = time.time()
        clock = _followed_clock(emulator, options, resources)
        started = clock.now() if clock is not None else None
        record.before(flight_plan, conductor.basis, fleet, _facts(options, record, started))
        if options.left is not None:
            record.frames(options.left.known)
        if emulator is not None and callbacks.on_emulator is not None:
            callbacks.on_emulator(emulator.pid)
        if record.problem is not None:
            raise InputError(
                [Problem(str(folder), f"the record cannot be written: {record.problem}")]
            )

        def console(author: str = TERMINAL) -> OperatorConsole:
            return OperatorConsole(conductor, conductor.available, author)

        preflight = Preflight(
            conductor, folder, callbacks.confirm, poses=borrowed or bridge,
            screens_answer=options.screens_answer,
        )  # fmt: skip
        with ExitStack() as running:
            running.enter_context(sealed())
            control = None
            if options.control is not None:
                control = ControlSocket(options.control, partial(console, CLIENT), options.share)
                running.callback(control.close)
            publish = running.enter_context(publisher(callbacks))
            running.enter_context(signal_handlers(_INTERRUPTS, caller.interrupt))
            real = fleet.emulated is None or options.firmware is not None
            audit = options.audit if options.audit is not None else real
            if audit and options.left is None:
                preflight.relay = Relay(conductor.team)
                running.callback(preflight.relay.close)
            tasks = TickTasks(
                conductor, record, preflight, publish, caller, console(), emulator, feeds=feeds,
                control=control, unattended=options.unattended, on_answered=callbacks.on_answered,
            )  # fmt: skip
            forward = open_forward(options.forward, conductor.team) if options.forward else None
            if forward is not None:
                running.callback(forward.close)
            loop = Loop(
                conductor, links, record, options.speed, tasks.run, preflight.relay,
                [copy for copy in (forward, borrowed) if copy is not None], feeds=feeds,
                world=clock, start=started,
            )  # fmt: skip
            loop.run()
            tasks.run(conductor.now)
        record.close()
        result = replace(
            _result(conductor, emulator, loop, tuple(tasks.events), record),
            training=_training(options, started),
            skipped=options.skipped,
        )
        record.after(result)
        return result


def with_found_team(
    flight_plan: FlightPlan, fleet: Fleet, options: FlyOptions, work: Callable[[Found], T]
) -> T | None:
    """Return the result of ``work`` with where the team of an interrupted flight rests.

    It is done in a thread, while the vehicles hear this station, so that they hold on, and get no
    command. None where they are not found at rest in :data:`_SEARCH` seconds, or where the flight
    itself is to send them their poses.

    Raises the errors of ``work``, and :class:`swarm.errors.VehicleError` for a link that cannot be
    opened.
    """
    setup = FlightOptions(no_cable=options.no_cable)
    conductor = Conductor(flight_plan, fleet, setup, left=options.left, then=None)
    results: queue.SimpleQueue[tuple[T | None, Exception | None]] = queue.SimpleQueue()
    workers: list[threading.Thread] = []

    def run(found: Found) -> None:
        try:
            results.put((work(found), None))
        except Exception as error:
            results.put((None, error))

    def each_tick(now: float) -> None:
        if workers:
            if not workers[0].is_alive():
                conductor.give_up("the search has ended")
        elif conductor.found is not None:
            workers.append(threading.Thread(target=run, args=(conductor.found,), daemon=True))
            workers[0].start()
        elif now > _SEARCH:
            conductor.give_up("the team was not found at rest")

    with ExitStack() as resources:
        links, borrowed = resources.enter_context(links_of(fleet, options.mocap))
        if options.mocap is not None and borrowed is None:
            return None
        conductor.team.signing = resources.enter_context(signing_with(fleet.signing_key))
        clock = _followed_clock(None, options, resources)
        copies = [borrowed] if borrowed is not None else []
        Loop(
            conductor, links, None, options.speed, each_tick, None, copies, feeds=copies,
            world=clock,
        ).run()  # fmt: skip
    if not workers:
        return None
    result, error = results.get()
    if error is not None:
        raise error
    return result


def _refuse_unflyable(flight_plan: FlightPlan, fleet: Fleet, options: FlyOptions) -> None:
    if isinstance(flight_plan, ComparisonFlight):
        raise Refused("a comparison is flown by swarm dry-run only: its plan is not certified")
    if fleet.emulated is None and options.speed != 1.0:
        raise Refused("only emulated vehicles fly faster or slower than real time")
    if options.training is not None:
        require_emulated(fleet)
    if fleet.emulated is not None and options.world_clock is not None and options.left is None:
        raise Refused("the built-in emulator keeps its own clock: --clock is for other worlds")


def _conductor(flight_plan: FlightPlan, fleet: Fleet, options: FlyOptions) -> Conductor:
    setup = FlightOptions(
        no_cable=options.no_cable,
        error_limit=options.error_limit,
        corrected=options.rtcm is not None,
    )
    conductor = Conductor(flight_plan, fleet, setup, left=options.left, then=options.then)
    if options.left is None:
        require_tracking(conductor.basis, fleet)
    if options.training is not None:
        conductor.report("training", options.training.words)
    if options.skipped:
        conductor.report("warning", skipped_words(options.skipped))
    precompile.load()
    return conductor


def _training(options: FlyOptions, started: float | None) -> Training | None:
    """Return the training with times since the record began, ``started`` on the world's clock."""
    if options.training is None or started is None:
        return None
    return options.training.recorded_from(started * options.speed)


def _facts(options: FlyOptions, record: Record, started: float | None) -> dict[str, Any]:
    """Return what a record says about its flight; ``started`` on the clock of its world."""
    training = _training(options, started)
    return {
        "speed": options.speed,
        "no_cable": options.no_cable,
        "start_time": record.start_time,
        "world_start": started * options.speed if started is not None else None,
        "training": asdict(training) if training is not None else None,
        "skipped_steps": list(options.skipped),
    }


def _followed_clock(
    emulator: EmulatorProcess | None, options: FlyOptions, resources: ExitStack
) -> WorldClock | None:
    """Return the clock of the world that the flight follows; None: the wall clock."""
    if emulator is not None:
        return emulator.clock
    if options.world_clock is None:
        return None
    clock = open_clock(options.world_clock)
    resources.callback(clock.close)
    return clock


def _open_feeds(
    conductor: Conductor, options: FlyOptions, resources: ExitStack, borrowed: Borrowed | None
) -> tuple[MocapBridge | None, list[Feed]]:
    """Open what the vehicles get from other systems; the first value is our own one of poses."""
    bridge = _open_bridge(conductor, options, resources) if borrowed is None else None
    corrections = resources.enter_context(
        open_corrections(options.rtcm, conductor.fleet, conductor.team)
    )
    return bridge, [feed for feed in (borrowed, bridge, corrections) if feed is not None]


def _open_bridge(
    conductor: Conductor, options: FlyOptions, resources: ExitStack
) -> MocapBridge | None:
    """Open the bridge from motion capture; that of the emulator sends to a free port."""
    url, fleet = options.mocap, conductor.fleet
    if url is None and not (options.firmware and options.positioning == "mocap"):
        return None
    if url is None:
        capture: Capture = DatagramCapture("127.0.0.1", 0)
        resources.callback(capture.close)
        return MocapBridge(capture, conductor.team, origin_of(fleet))
    return resources.enter_context(open_mocap(url, fleet, conductor.team))


def _start_emulator(
    flight_plan: FlightPlan,
    fleet: Fleet,
    links: Links,
    folder: Path,
    options: FlyOptions,
    bridge: MocapBridge | None,
) -> EmulatorProcess | None:
    """Start the emulator for an emulated fleet."""
    if fleet.emulated is None:
        return None
    seed = fleet.emulated.seed
    world = emulated_world(flight_plan.plan, fleet, with_cable=not options.no_cable, seed=seed)
    if options.firmware is not None:
        start_as_required(world, plan_requirements(flight_plan.plan, fleet))
    port = links.port(next(iter(fleet.links)))
    firmware = None
    if options.firmware is not None:
        mocap = bridge.capture.port if bridge is not None else None
        firmware = RealFirmware(options.firmware, options.positioning, mocap)
    scenario = options.training.document if options.training is not None else None
    return EmulatorProcess(
        world, folder, port, options.speed, fleet.signing_key, firmware=firmware, scenario=scenario
    )


def _result(
    conductor: Conductor,
    emulator: EmulatorProcess | None,
    loop: Loop,
    events: tuple[Event, ...],
    record: Record,
) -> FlightResult:
    outcome = conductor.finished
    if outcome is None:
        raise AssertionError("the loop ends when the conductor has finished")
    if emulator is not None and outcome.word == "failed" and (ended := emulator.ended()):
        outcome = replace(outcome, explanation=f"{outcome.explanation}; {ended}")
    trace = _flown_trace(conductor, record)
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
        record=record.folder,
    )


def _flown_trace(conductor: Conductor, record: Record) -> Trace:
    """Return the trace by the record, so that ``swarm verify`` finds the same figures in it.

    Strays of the cable are estimated in flight only. Of a record that is damaged, or has no flight,
    the trace that was kept in flight is returned.
    """
    kept = conductor.trace()
    if record.problem is not None or record.dropped or not len(kept.time):
        return kept
    try:
        log = recorded_flight(record.folder, conductor.plan)
    except InputError:
        return kept
    time = log.trace.time + log.event_time
    latest = np.searchsorted(kept.time, time, "right") - 1
    stray = np.where(latest[:, None] >= 0, kept.stray[latest], np.nan)
    return replace(log.trace, time=time, stray=stray)
