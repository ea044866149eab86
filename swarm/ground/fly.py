"""One flight on real links, from the first heartbeat to the closed record."""

import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np

from swarm import precompile
from swarm.errors import InputError, Problem, Refused
from swarm.flight.adherence import adherence
from swarm.flight.conductor import Conductor
from swarm.flight.flight_plan import ComparisonFlight, FlightPlan, require_tracking
from swarm.flight.parameters import plan_requirements, required_values
from swarm.flight.result import FlightResult
from swarm.flight.resuming import LeftOff, Then
from swarm.flight.setup import Options
from swarm.flight.snapshot import Event
from swarm.flight.trace import Trace
from swarm.flight.world import emulated_world
from swarm.ground.callbacks import FlightCallbacks, publisher
from swarm.ground.corrections import open_corrections
from swarm.ground.emulator import EmulatorProcess, RealFirmware
from swarm.ground.forward import open_forward
from swarm.ground.loop import Feed, Loop
from swarm.ground.mocap import ANYWHERE, DatagramCapture, MocapBridge, open_capture
from swarm.ground.operator import (
    CLIENT,
    TERMINAL,
    ControlSocket,
    OperatorConsole,
    terminal_keys,
)
from swarm.ground.preflight import Preflight
from swarm.ground.record import Record
from swarm.ground.record_reader import recorded_flight
from swarm.ground.relay import Relay
from swarm.ground.signing_key import signing_with
from swarm.ground.sockets import Links, open_links
from swarm.ground.tick_tasks import Caller, TickTasks, Unattended
from swarm.ground.world_clock import WorldClock, open_clock
from swarm.jit import sealed
from swarm.mavlink.frames import Origin
from swarm.mission.fleet import Fleet


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


def fly(
    flight_plan: FlightPlan,
    fleet: Fleet,
    folder: Path,
    options: FlyOptions | None = None,
    callbacks: FlightCallbacks | None = None,
    *,
    read_keys: bool = False,
    caller: Caller | None = None,
) -> FlightResult:
    """Fly a checked plan; return the result, with the record in ``folder``.

    ``read_keys`` reads single keys from the terminal; ``caller`` is the process that began the
    flight, if another one. The first interrupt holds and lands the team, the second lands it at
    once. The caller, and clients that watch the control socket, are the screens of the flight;
    without a screen, ``options.unattended`` says what the team does.

    Raises :class:`swarm.errors.VehicleError` for a link that cannot be opened, and
    :class:`swarm.errors.InputError` for a record that cannot be written.
    """
    options, callbacks = options or FlyOptions(), callbacks or FlightCallbacks()
    caller = caller or Caller()
    _refuse_unflyable(flight_plan, fleet, options)
    conductor = _conductor(flight_plan, fleet, options)
    with ExitStack() as resources:
        links = open_links(fleet.links)
        resources.callback(links.close)
        conductor.team.signing = resources.enter_context(signing_with(fleet.signing_key))
        record = Record(folder, time.time())
        resources.callback(record.close)
        bridge, feeds = resources.enter_context(_open_feeds(conductor, options))
        emulator = _start_emulator(flight_plan, fleet, links, folder, options, bridge)
        if emulator is not None:
            resources.callback(emulator.stop)
        # flight time begins once the emulator sends packets, which takes a while
        record.start_time = time.time()
        clock = resources.enter_context(_followed_clock(emulator, options))
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

        preflight = Preflight(conductor, folder, callbacks.confirm)
        with ExitStack() as running:
            running.enter_context(sealed())
            control = running.enter_context(
                _open_control(options.control, partial(console, CLIENT))
            )
            publish = running.enter_context(publisher(callbacks))
            running.enter_context(_caught_interrupts(caller.interrupts))
            inputs = [caller.key_reader(console())]
            if read_keys:
                inputs.append(running.enter_context(terminal_keys(console())))
            real = fleet.emulated is None or options.firmware is not None
            audit = options.audit if options.audit is not None else real
            if audit and options.left is None:
                preflight.relay = Relay(conductor.team)
                running.callback(preflight.relay.close)
            tasks = TickTasks(
                conductor, record, preflight, publish, caller, emulator, inputs, feeds=feeds,
                control=control, unattended=options.unattended,
            )  # fmt: skip
            forward = open_forward(options.forward, conductor.team) if options.forward else None
            if forward is not None:
                running.callback(forward.close)
            loop = Loop(
                conductor, links, record, options.speed, tasks.run, preflight.relay, forward,
                feeds=feeds, world=clock, start=started,
            )  # fmt: skip
            loop.run()
            tasks.run(conductor.now)
        record.close()
        result = _result(conductor, emulator, loop, tuple(tasks.events), record)
        record.after(result)
        return result


def _refuse_unflyable(flight_plan: FlightPlan, fleet: Fleet, options: FlyOptions) -> None:
    if isinstance(flight_plan, ComparisonFlight):
        raise Refused("a comparison is flown by swarm dry-run only: its plan is not certified")
    if fleet.emulated is None and options.speed != 1.0:
        raise Refused("only emulated vehicles fly faster or slower than real time")
    if fleet.emulated is not None and options.world_clock is not None and options.left is None:
        raise Refused("the built-in emulator keeps its own clock: --clock is for other worlds")


def _conductor(flight_plan: FlightPlan, fleet: Fleet, options: FlyOptions) -> Conductor:
    setup = Options(no_cable=options.no_cable, error_limit=options.error_limit)
    conductor = Conductor(flight_plan, fleet, setup, left=options.left, then=options.then)
    if options.left is None:
        require_tracking(conductor.basis, fleet)
    precompile.load()
    return conductor


@contextmanager
def _followed_clock(
    emulator: EmulatorProcess | None, options: FlyOptions
) -> Iterator[WorldClock | None]:
    """Open the clock of the world that the flight follows; None: the wall clock."""
    if emulator is not None:
        yield emulator.clock
        return
    if options.world_clock is None:
        yield None
        return
    clock = open_clock(options.world_clock)
    try:
        yield clock
    finally:
        clock.close()


def _facts(options: FlyOptions, record: Record, started: float | None) -> dict[str, Any]:
    """Return what a record says about its flight; ``started`` on the clock of its world."""
    return {
        "speed": options.speed,
        "no_cable": options.no_cable,
        "start_time": record.start_time,
        "world_start": started * options.speed if started is not None else None,
    }


@contextmanager
def _open_control(
    path: Path | None, console: Callable[[], OperatorConsole]
) -> Iterator[ControlSocket | None]:
    """Open the control socket of the flight, if it has one."""
    if path is None:
        yield None
        return
    control = ControlSocket(path, console)
    try:
        yield control
    finally:
        control.close()


@contextmanager
def _open_feeds(
    conductor: Conductor, options: FlyOptions
) -> Iterator[tuple[MocapBridge | None, list[Feed]]]:
    """Open what the vehicles get from other systems; the first value is the one of poses."""
    with (
        _open_bridge(conductor, options) as bridge,
        open_corrections(options.rtcm, conductor.fleet, conductor.team) as corrections,
    ):
        yield bridge, [feed for feed in (bridge, corrections) if feed is not None]


@contextmanager
def _open_bridge(conductor: Conductor, options: FlyOptions) -> Iterator[MocapBridge | None]:
    """Open the bridge from motion capture; that of the emulator sends to a free port."""
    emulated = options.firmware is not None and options.positioning == "mocap"
    if options.mocap is None and not emulated:
        yield None
        return
    url = options.mocap
    capture = DatagramCapture("127.0.0.1", 0) if url is None else open_capture(url)
    place = conductor.fleet.origin
    origin = Origin(place.latitude, place.longitude, place.altitude or 0.0) if place else ANYWHERE
    try:
        yield MocapBridge(capture, conductor.team, origin)
    finally:
        capture.close()


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
        required = plan_requirements(flight_plan.plan, fleet)
        for vehicle in world["vehicles"]:
            vehicle["parameters"] = required_values(vehicle["autopilot"], required)
    port = links.port(next(iter(fleet.links)))
    firmware = None
    if options.firmware is not None:
        mocap = bridge.capture.port if bridge is not None else None
        firmware = RealFirmware(options.firmware, options.positioning, mocap)
    return EmulatorProcess(world, folder, port, options.speed, fleet.signing_key, firmware=firmware)


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


@contextmanager
def _caught_interrupts(caught: list[int]) -> Iterator[None]:
    """Collect SIGINT and SIGTERM in a list instead of ending, if this is the main thread."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def catch(number: int, _frame: FrameType | None) -> None:
        caught.append(number)

    before = {number: signal.signal(number, catch) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
