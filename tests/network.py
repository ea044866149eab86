"""A conductor and the emulator on a network in memory, in virtual time, as bad as a test wants it.

Everything is deterministic by the seed. Delays are in seconds, one way.
"""

import heapq
import itertools
import json
from collections.abc import Callable, Hashable
from dataclasses import dataclass, field, fields

import numpy as np

from sitl import Emulator
from sitl.world import parse_world
from swarm.certification.certificate import CertifiedPlan, certify
from swarm.flight.conductor import Conductor
from swarm.flight.flight_plan import ComparisonFlight, FlightPlan, go
from swarm.flight.result import Outcome
from swarm.flight.setup import FlightOptions
from swarm.flight.snapshot import Event
from swarm.flight.world import emulated_world
from swarm.geometry.motion import concatenate, leg
from swarm.mission import Mission, mission_for_knot
from swarm.mission.fleet import Fleet, emulated_fleet
from swarm.planning import KnotLayout, KnotSummary, Plan
from swarm.planning.phase_sequence import flight_around_fold
from swarm.simulation.stepped_simulation import branch, lasting, nothing_pending
from tests.shared import shared

Keep = Callable[[float, int, bytes], bool]
"""Whether a packet gets through: time, system id, bytes."""


def every(_time: float, _system: int, _data: bytes) -> bool:
    """All packets get through."""
    return True


def small_mission(*overrides: str) -> Mission:
    """Three vehicles' worth of mission."""
    return mission_for_knot("3_1", overrides)


@shared
def small_plan(*overrides: str, vehicles: int = 3, height: float = 5.0) -> CertifiedPlan:
    """A real flight around a fold that moves the whole line sideways and back, certified."""
    plan = sideways(*overrides, vehicles=vehicles, height=height)
    return CertifiedPlan(plan, certify(plan))


def uncleared(*overrides: str, vehicles: int = 3) -> ComparisonFlight:
    """The same flight with a mission that it does not keep to."""
    plan = sideways(*overrides, vehicles=vehicles)
    return ComparisonFlight(plan, certify(plan))


def sideways(*overrides: str, vehicles: int = 3, height: float = 5.0) -> Plan:
    """The plan of :func:`small_plan`."""
    mission = small_mission(*overrides)
    spacing, length = 3.0, 3.6
    line = np.array([[spacing * k, 0.0, height] for k in range(vehicles)])
    aside = line + np.array([0.0, 3.0, 0.5])
    fold = concatenate(leg(line, aside, 1.0, 0.5), leg(aside, line, 1.0, 0.5))
    lengths = np.full(vehicles - 1, length)
    flight = flight_around_fold(mission, lengths, fold)
    layout = KnotLayout(
        corners=line,
        sags=np.full(vehicles - 1, 0.8),
        lengths=lengths,
        lanes=np.zeros(vehicles - 1),
        crossings=(),
        cell=0.0,
    )
    summary = KnotSummary("0_1", "none", "", ())
    return Plan(mission, summary, layout, flight.motion, flight.phases, flight.gates, line)


@dataclass
class Network:
    """Runs a conductor against the emulator.

    ``uplink`` and ``downlink`` say which packets get through; ``delay`` is added to each way with
    a uniform ``jitter``, so that packets may overtake each other; ``loss`` and ``duplication`` are
    shares. Shares of the packets to the conductor are ``late`` or ``copied``: they, or a second
    copy of them, arrive ``lateness`` seconds later. The conductor hears packets ``early`` seconds
    before it next acts, as it does on sockets, where they come between its ticks. ``speed`` is
    virtual over real time. A team that is ready ``starts`` without a question.
    """

    flight_plan: FlightPlan
    fleet: Fleet | None = None
    no_cable: bool = False
    seed: int = 1
    delay: float = 0.0
    jitter: float = 0.0
    loss: float = 0.0
    duplication: float = 0.0
    late: float = 0.0
    copied: float = 0.0
    lateness: float = 0.0
    early: float = 0.0
    speed: float = 1.0
    starts: bool = True
    uplink: Keep = every
    downlink: Keep = every
    events: list[Event] = field(default_factory=list)
    sent: list[tuple[float, int, bytes]] = field(default_factory=list)
    now: float = 0.0

    def __post_init__(self) -> None:
        plan = self.flight_plan.plan
        self.fleet = self.fleet or emulated_fleet(plan.vehicles)
        self.conductor = Conductor(
            self.flight_plan, self.fleet, FlightOptions(no_cable=self.no_cable)
        )
        world = emulated_world(plan, self.fleet, with_cable=not self.no_cable, seed=self.seed)
        self.emulator = Emulator(parse_world(json.dumps(world)))
        self.step = 1.0 / self.fleet.rates.setpoint
        self._rng = np.random.default_rng(self.seed)
        self._flying: list[tuple[float, int, bool, int, bytes]] = []
        self._order = itertools.count()
        self._tick = 0

    def run(self, until: Callable[[], bool] = lambda: False, most: float = 400.0) -> Outcome | None:
        """Go on until the flight ends or ``until`` holds; fail after ``most`` more seconds."""
        end = self.now + most
        while self.conductor.finished is None and not until():
            assert self.now < end, f"after {most} s: {self.words()[-12:]}"
            self.once()
        return self.conductor.finished

    def once(self) -> None:
        """One step of virtual time."""
        self.now = now = self._tick * self.step
        self._tick += 1
        for system, data in self.emulator.step(now):
            if self.downlink(now, system, data):
                self._post(now, system, data, up=False)
        self._deliver(now)
        for outgoing in self.conductor.tick(now, now / self.speed):
            system = int(outgoing.address)  # type: ignore[call-overload]
            self.sent.append((now, system, outgoing.data))
            if self.uplink(now, system, outgoing.data):
                self._post(now, system, outgoing.data, up=True)
        self._deliver(now)
        ready = self.conductor.stage == "ready" and self.conductor.audit is not None
        if ready and self.starts:
            self.conductor.start(go(self.flight_plan, self.conductor.audit))
        self.events.extend(self.conductor.events())

    def until_phase(self, name: str, after: float = 0.0) -> None:
        """Run until so many seconds into a phase of the plan."""
        start = self.flight_plan.plan.phase(name).start + after  # type: ignore[arg-type]
        self.run(lambda: self.conductor.clock.time >= start)
        assert self.conductor.stage == "execute", self.words()[-12:]

    def in_fold(self, after: float) -> "Network":
        """Return this flight, which has not begun, so many seconds into the fold.

        The way there is flown once by a process for all flights that begin alike.
        """
        assert self._tick == 0
        own = (every, getattr(self, "kept", every))
        alike = self.uplink in own and self.downlink in own
        flown = _FLOWN.setdefault(self._beginning(), self) if alike else self
        start = self.flight_plan.plan.phase("fold").start
        flown.run(
            lambda: (
                flown.conductor.clock.time >= start
                and nothing_pending(flown.conductor, flown.emulator)
            )
        )
        flight = branch(flown, (flown.flight_plan, flown.fleet, *lasting(flown.conductor)))
        flight.until_phase("fold", after)
        return flight

    def _beginning(self) -> Hashable:
        """Return what determines the flight up to a command; equal for flights that begin alike."""
        aside = {"events", "sent", "uplink", "downlink"}
        given = [getattr(self, one.name) for one in fields(self) if one.name not in aside]
        plan = self.flight_plan
        return (type(self), *(id(one) if one is plan else repr(one) for one in given))

    def until_time(self, seconds: float) -> None:
        """Run for so many seconds."""
        end = self.now + seconds
        self.run(lambda: self.now >= end)

    def words(self, kind: str | None = None) -> list[str]:
        """What was reported, of one kind or all."""
        return [event.message for event in self.events if kind in {None, event.kind}]

    def _post(self, now: float, system: int, data: bytes, *, up: bool) -> None:
        copies = 1 + (self._rng.random() < self.duplication)
        for _ in range(copies):
            if self._rng.random() < self.loss:
                continue
            arrival = now + self.delay + self.jitter * self._rng.random()
            if not up and self.late and self._rng.random() < self.late:
                arrival += self.lateness
            heapq.heappush(self._flying, (arrival, next(self._order), up, system, data))
        if not up and self.copied and self._rng.random() < self.copied:
            arrival = now + self.lateness
            heapq.heappush(self._flying, (arrival, next(self._order), up, system, data))

    def _deliver(self, now: float) -> None:
        while self._flying and self._flying[0][0] <= now:
            _, _, up, system, data = heapq.heappop(self._flying)
            if up:
                self.emulator.receive(system, data, now)
            else:
                self.conductor.receive("loopback", system, data, now - self.early)


_FLOWN: dict[Hashable, Network] = {}
"""Flights of this process at the beginning of their fold, by what determines them."""
