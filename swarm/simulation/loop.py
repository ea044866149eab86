"""A flight in virtual time: the conductor and the emulator's step function, no sockets, no clock.

The same seed gives the same flight.
"""

import json
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

from sitl import Emulator
from sitl.faults.scenario import Fault, Scenario, parse_scenario
from sitl.world import WorldError, parse_world
from sitl.world import schema as world_schema
from swarm.errors import InputError, Problem, Refused
from swarm.flight.adherence import adherence
from swarm.flight.clearance import go
from swarm.flight.conductor import Conductor
from swarm.flight.flight_plan import FlightPlan
from swarm.flight.result import FlightResult
from swarm.flight.snapshot import Event, Snapshot
from swarm.flight.world import emulated_world
from swarm.mission.fleet import Fleet, emulated_fleet

__all__ = [
    "Emulator",
    "Fault",
    "Observer",
    "Recorder",
    "faults_from",
    "parse_world",
    "scenario_schema",
    "simulate_flight",
    "world_schema",
]  # fmt: skip

SNAPSHOT_INTERVAL = 0.1
_LINK = "loopback"
_LONGEST_WAIT = 600.0
"""Seconds by which a flight may outlast its plan before it is given up."""


class Recorder(Protocol):
    """What keeps a flight's packets and events."""

    def packet(self, data: bytes, now: float) -> None:
        """Keep a packet that was sent or received."""

    def event(self, event: Event) -> None:
        """Keep an event."""


Observer = Callable[[Conductor, Emulator, float], None]
"""Called after each step of virtual time with both sides of the flight, and that time."""


def faults_from(text: str, source: str) -> tuple[Fault, ...]:
    """Return the faults of a scenario file; raises :class:`InputError` with every error in it."""
    try:
        return tuple(parse_scenario(text, source))
    except WorldError as error:
        raise InputError([Problem("", line) for line in str(error).splitlines()]) from None


def scenario_schema() -> dict[str, Any]:
    """Return the JSON schema of scenario files, for editors."""
    return Scenario.model_json_schema(by_alias=True)


def simulate_flight(
    flight_plan: FlightPlan,
    *,
    fleet: Fleet | None = None,
    seed: int = 1,
    no_cable: bool = False,
    open_loop: bool = False,
    world: Mapping[str, Any] | None = None,
    faults: Sequence[Fault] = (),
    observer: Observer | None = None,
    on_snapshot: Callable[[Snapshot], None] | None = None,
    on_event: Callable[[Event], None] | None = None,
    recorder: Recorder | None = None,
    stray_limit: float | None = None,
) -> FlightResult:
    """Fly a plan in virtual time against the emulator; returns how it went.

    ``fleet`` is an emulated one, by default of PX4 vehicles; ``world`` is what the emulator is told
    instead of what the plan expects, ``faults`` are what goes wrong. ``open_loop`` keeps the
    planned pace whatever comes near, which shows what a trajectory would do that no clock protects.
    ``on_snapshot`` is called ten times a second of flight time, ``observer`` after every step: it
    alone sees what really is. ``stray_limit`` is as in :class:`Conductor`.
    Raises :class:`swarm.errors.Refused` where the fleet does not fit.
    """
    fleet = fleet or emulated_fleet(flight_plan.plan.vehicles, seed=seed)
    conductor = Conductor(
        flight_plan, fleet, no_cable=no_cable, open_loop=open_loop, stray_limit=stray_limit
    )
    if world is None:
        world = emulated_world(flight_plan.plan, fleet, with_cable=not no_cable, seed=seed)
    emulator = Emulator(parse_world(json.dumps(world)), faults)
    step = 1.0 / fleet.rates.setpoint
    events: list[Event] = []
    next_snapshot = 0.0
    tick = 0
    while conductor.finished is None:
        now = tick * step
        _exchange(conductor, emulator, recorder, now)
        if conductor.stage == "ready" and conductor.audit is not None:
            try:
                conductor.start(go(flight_plan, conductor.audit))
            except Refused as error:
                conductor.refuse(str(error))
        _tell(conductor, events, recorder, on_event)
        if observer is not None:
            observer(conductor, emulator, now)
        if on_snapshot is not None and now >= next_snapshot:
            next_snapshot = now + SNAPSHOT_INTERVAL
            on_snapshot(conductor.snapshot(now))
        if now > flight_plan.plan.duration + _LONGEST_WAIT:
            conductor.give_up("the flight does not end")
        tick += 1
    _tell(conductor, events, recorder, on_event)
    trace = conductor.trace()
    return FlightResult(
        outcome=conductor.finished,
        trace=trace,
        events=tuple(events),
        statistics=conductor.statistics(),
        basis=conductor.basis,
        adherence=adherence(flight_plan.plan, trace, conductor.basis),
    )


def _exchange(
    conductor: Conductor, emulator: Emulator, recorder: Recorder | None, now: float
) -> None:
    """One step of virtual time: what the vehicles sent, then what the conductor answers."""
    arrived = emulator.step(now)
    conductor.receive_all(_LINK, arrived, now)
    if recorder is not None:
        for _, data in arrived:
            recorder.packet(data, now)
    outgoing = conductor.tick(now)
    arriving = [(one.address, one.data) for one in outgoing if isinstance(one.address, int)]
    emulator.receive_all(arriving, now)
    if recorder is not None:
        for one in outgoing:
            recorder.packet(one.data, now)


def _tell(
    conductor: Conductor,
    events: list[Event],
    recorder: Recorder | None,
    on_event: Callable[[Event], None] | None,
) -> None:
    for event in conductor.events():
        events.append(event)
        if recorder is not None:
            recorder.event(event)
        if on_event is not None:
            on_event(event)
