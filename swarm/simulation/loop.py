"""A flight in virtual time: conductor and emulator step by step, without sockets or clocks.

The same seed gives the same flight.
"""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

from sitl import Emulator
from sitl.faults import Fault, Scenario, parse_scenario
from sitl.world import WorldError, parse_world
from sitl.world import schema as world_schema
from swarm.errors import InputError, Problem, Refused
from swarm.flight.conductor import Conductor
from swarm.flight.flight_plan import FlightPlan, go
from swarm.flight.result import FlightResult, adherence
from swarm.flight.setup import FlightOptions
from swarm.flight.snapshot import Event, Snapshot
from swarm.flight.world import emulated_world
from swarm.mission.fleet import Fleet, emulated_fleet

__all__ = [
    "DEFAULT_OPTIONS", "NO_CALLBACKS", "Callbacks", "Emulator", "Fault", "StepCallback",
    "faults_from", "parse_world", "scenario_schema", "simulate_flight", "world_schema",
]  # fmt: skip

SNAPSHOT_INTERVAL: Final = 0.1
"""Seconds of flight between two snapshots."""

LINK: Final = "loopback"
"""The only link of an emulated fleet."""

_MAX_EXTRA_TIME: Final = 600.0
"""Seconds beyond the plan's duration after which the flight is aborted."""


@dataclass(eq=False)
class Simulation:
    """Conductor and emulator of a flight, which advance together in virtual time.

    ``delivers`` decides whether a packet of a system id reaches the ground station (None: all do).
    ``unread`` are packets that came while the ground station stood still: its socket keeps them.
    """

    flight_plan: FlightPlan
    fleet: Fleet
    conductor: Conductor
    emulator: Emulator
    events: list[Event] = field(default_factory=list)
    delivers: Callable[[int, bytes], bool] | None = None
    unread: list[tuple[int, bytes]] = field(default_factory=list)
    on_event: Callable[[Event], None] | None = None

    def advance(self, now: float, *, station: bool = True) -> None:
        """Advance to ``now`` seconds; without ``station`` the ground station is stopped."""
        conductor = self.conductor
        for system, data in self.emulator.step(now):
            if self.delivers is None or self.delivers(system, data):
                self.unread.append((system, data))
        if not station:
            return
        arrived, self.unread = self.unread, []
        conductor.receive_all(LINK, arrived, now)
        sent = [(p.address, p.data) for p in conductor.tick(now) if isinstance(p.address, int)]
        self.emulator.receive_all(sent, now)
        if conductor.stage == "ready" and conductor.audit is not None:
            try:
                conductor.start(go(self.flight_plan, conductor.audit))
            except Refused as error:
                conductor.refuse(str(error))
        self.collect()

    def collect(self) -> None:
        """Take the events since the last call."""
        for event in self.conductor.events():
            self.events.append(event)
            if self.on_event is not None:
                self.on_event(event)


StepCallback = Callable[[Conductor, Emulator, float], None]
"""Receives both sides of the flight and the time in seconds, after a step of virtual time."""


@dataclass(frozen=True)
class Callbacks:
    """Functions that a simulation calls; None for none.

    ``on_step`` is called after every step of virtual time, and alone has access to the emulator's
    ground truth; ``on_snapshot`` every :data:`SNAPSHOT_INTERVAL`; ``on_event`` with each event.
    """

    on_step: StepCallback | None = None
    on_snapshot: Callable[[Snapshot], None] | None = None
    on_event: Callable[[Event], None] | None = None


DEFAULT_OPTIONS: Final = FlightOptions()
NO_CALLBACKS: Final = Callbacks()


def faults_from(text: str, source: str) -> tuple[Fault, ...]:
    """Return the faults of a scenario file; raise :class:`InputError` with every error in it."""
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
    world: Mapping[str, Any] | None = None,
    faults: Sequence[Fault] = (),
    options: FlightOptions = DEFAULT_OPTIONS,
    callbacks: Callbacks = NO_CALLBACKS,
) -> FlightResult:
    """Fly a plan against the emulator in virtual time and return the result.

    ``fleet`` is an emulated fleet, by default of PX4 vehicles. ``world`` is the emulator's world,
    by default the world that the plan expects, drawn from ``seed``. ``faults`` are injected.
    Raises :class:`swarm.errors.Refused` where the fleet does not fit the plan.
    """
    plan = flight_plan.plan
    fleet = fleet or emulated_fleet(plan.vehicles, seed=seed)
    conductor = Conductor(flight_plan, fleet, options)
    if world is None:
        world = emulated_world(plan, fleet, with_cable=not options.no_cable, seed=seed)
    emulator = Emulator(parse_world(json.dumps(world)), faults)
    flight = Simulation(flight_plan, fleet, conductor, emulator, on_event=callbacks.on_event)
    step = 1.0 / fleet.rates.setpoint
    next_snapshot = 0.0
    tick = 0
    while conductor.finished is None:
        now = tick * step
        flight.advance(now)
        if callbacks.on_step is not None:
            callbacks.on_step(conductor, emulator, now)
        if callbacks.on_snapshot is not None and now >= next_snapshot:
            next_snapshot = now + SNAPSHOT_INTERVAL
            callbacks.on_snapshot(conductor.snapshot(now))
        if now > plan.duration + _MAX_EXTRA_TIME:
            conductor.give_up("the flight does not end")
        tick += 1
    flight.collect()
    trace = conductor.trace()
    return FlightResult(
        outcome=conductor.finished,
        trace=trace,
        events=tuple(flight.events),
        statistics=conductor.statistics(),
        basis=conductor.basis,
        adherence=adherence(plan, trace, conductor.basis),
    )
