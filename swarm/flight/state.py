"""The whole state of a flight, in parts that have the methods which change them.

Everything is of n vehicles in order along the cable; positions are grip points, mission ENU. Arrays
and collections of the parts are replaced, not written into: what a detector was given stays as it
was.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from swarm.certification.monitor import Clearances
from swarm.certification.stream_loss import StreamLossCertificate
from swarm.flight.detect import Detectors
from swarm.flight.failures import FailureKind, HoldCause, Response
from swarm.flight.flight_plan import Audit
from swarm.flight.guidance import Guidance, MissionClock
from swarm.flight.observation import Expected, Observation, Sample
from swarm.flight.preparation import Preparation, named
from swarm.flight.result import Outcome, Word
from swarm.flight.router import Team
from swarm.flight.setup import LOOSE_ERROR, Setup
from swarm.flight.snapshot import Recorder
from swarm.flight.stages import Stage, Step, StepTrigger, Trigger, next_stage, next_step
from swarm.flight.swinging import Swing
from swarm.flight.tlog import LeftOff, Then
from swarm.mavlink.frames import Frames
from swarm.mavlink.vehicle import Vehicle
from swarm.planning import Gate, Phase

Floats = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]
Indices = npt.NDArray[np.int64]


LONGEST_TICK = 0.1
"""Seconds that pass in one tick at most. Time in which the ground station did not run is not flown
afterwards, since the setpoints would jump, and counts against no vehicle."""
_LEAST_DRAG = 0.05
"""Smallest fitted drag, 1/s, that is reported: smaller ones are within the error of the fit."""


@dataclass(frozen=True)
class Timing:
    """``now`` and ``last`` are the times of this tick and of the one before; ``moving`` the seconds
    that setpoints have advanced, in which a tick counts LONGEST_TICK at most; ``real`` is real time
    in seconds. ``streaming`` says whether setpoints are sent; ``gap`` is the longest time between
    two ticks with setpoints, which began at ``gap_at``."""

    now: float = 0.0
    last: float = 0.0
    moving: float = 0.0
    real: float = 0.0
    streaming: bool = False
    gap: float = 0.0
    gap_at: float = 0.0

    def advanced(self, now: float, real: float, *, streaming: bool) -> "Timing":
        """Return the times of the next tick."""
        elapsed = now - self.now
        moving = self.moving + min(elapsed, LONGEST_TICK)
        longer = streaming and elapsed > self.gap
        gap, gap_at = (elapsed, self.now) if longer else (self.gap, self.gap_at)
        return Timing(now, self.now, moving, real, streaming, gap, gap_at)

    @property
    def elapsed(self) -> float:
        """Seconds since the tick before."""
        return self.now - self.last


@dataclass(frozen=True, eq=False)
class Roster:
    """The vehicles that fly, with their system ids and their rows (n,) in the telemetry table.

    ``numbers`` are their places along the cable, from 1, by system id. Before all are received it
    is a guess.
    """

    vehicles: tuple[Vehicle, ...]
    systems: tuple[int, ...]
    numbers: Mapping[int, int]
    names: tuple[str, ...]
    rows: Indices

    @classmethod
    def of(cls, vehicles: Sequence[Vehicle]) -> "Roster":
        """Return the roster of vehicles in order along the cable."""
        numbers = {vehicle.system: number for number, vehicle in enumerate(vehicles, 1)}
        return cls(
            vehicles=tuple(vehicles),
            systems=tuple(numbers),
            numbers=numbers,
            names=tuple(named(vehicle, numbers[vehicle.system]) for vehicle in vehicles),
            rows=np.array([vehicle.row for vehicle in vehicles]),
        )


@dataclass(eq=False)
class Placement:
    """The vehicles' frames, their yaw (n,) in radians, and where they started (n, 3).

    ``moved`` are vehicles whose frames have moved in flight, and may move on.
    """

    frames: Frames | None
    yaw: Floats
    start_position: Floats
    audit: Audit | None = None
    moved: frozenset[int] = frozenset()


@dataclass
class Progress:
    """How far the plan is flown.

    ``gate`` is the index of the next gate; ``waiting`` says whether the clock waits at it, since
    ``gate_since``; ``settled_since`` is when the team came to rest there, ``ready_at`` when all
    were last ready. ``rewinding`` says whether the clock runs backwards, ``error_kept_since`` since
    which mission time tracking errors have been small. ``done`` are actions that are done once:
    gate, vehicle, action.
    """

    gate: int = 0
    waiting: bool = False
    gate_since: float = 0.0
    settled_since: float = 0.0
    ready_at: float = 0.0
    rewinding: bool = False
    error_kept_since: float = 0.0
    done: set[tuple[int, int, str]] = field(default_factory=set)

    def first_time(self, k: int, action: str) -> bool:
        """Return whether a vehicle's action is new at this gate, and note it."""
        key = (self.gate, k, action)
        first = key not in self.done
        self.done.add(key)
        return first


@dataclass
class Holds:
    """Why the clock is held: the causes, with a message for each."""

    causes: Mapping[HoldCause, str] = field(default_factory=dict)

    @property
    def message(self) -> str | None:
        """All causes in words; None where the clock is not held."""
        return "; ".join(self.causes.values()) or None

    def end(self, ended: Iterable[HoldCause]) -> None:
        """End the holds of these causes."""
        gone = set(ended)
        self.causes = {cause: words for cause, words in self.causes.items() if cause not in gone}

    def end_failures(self, kinds: Iterable[FailureKind], system: int | None) -> None:
        """End the holds by failures of these kinds, of a vehicle and of the team."""
        self.end(HoldCause(kind, of) for kind in kinds for of in (system, None))

    def end_vehicle(self, system: int) -> None:
        """End every hold by a failure of a vehicle."""
        self.end([cause for cause in self.causes if cause.system == system])


@dataclass(eq=False)
class Streams:
    """The setpoints of the team, and to which vehicles they are sent.

    ``setpoint`` and ``velocity`` (n, 3); ``active`` (n,) which vehicles get setpoints,
    ``expected_armed`` (n,) which have failed where they are not armed. ``rejoining`` are vehicles
    that return to offboard mode, with the time since when; ``fallen`` vehicles that are given up.
    ``sent`` counts setpoints.
    """

    setpoint: Floats
    velocity: Floats
    active: Flags
    expected_armed: Flags
    rejoining: Mapping[int, float] = field(default_factory=dict)
    fallen: frozenset[int] = frozenset()
    sent: int = 0

    @classmethod
    def of(cls, n: int) -> "Streams":
        """Return the streams of n vehicles before anything is sent."""
        none = np.zeros(n, dtype=np.bool_)
        return cls(np.full((n, 3), np.nan), np.zeros((n, 3)), none, none.copy())

    def switch(self, k: int, *, on: bool) -> None:
        """Send setpoints to a vehicle from now on, or no longer."""
        self.active = self.active.copy()
        self.active[k] = on

    def stop_all(self) -> None:
        """End all setpoints."""
        self.active = np.zeros_like(self.active)

    def expect_armed(self, *, armed: bool = True) -> None:
        """From now on, a vehicle that is not armed has failed; or none has."""
        self.expected_armed = np.full_like(self.expected_armed, armed)

    def give_up(self, k: int) -> None:
        """Give up a vehicle that falls: no setpoints any more."""
        self.switch(k, on=False)
        self.fallen |= {k}

    def end_rejoining(self, k: int) -> None:
        """Note that a vehicle has returned, or has not in time."""
        self.rejoining = {j: since for j, since in self.rejoining.items() if j != k}


@dataclass
class Contingency:
    """The flight outside the plan, from the moment at which it was decided.

    ``since`` is when it began, ``step_since`` when its step began. ``target`` is the mission time
    to move to first (None: stop at once), ``moving_at`` when the team last moved, had arrived or
    waited for a silent vehicle. ``landing`` are the system ids of vehicles that were commanded to
    land, ``on_ground_since`` since when they report the ground. ``opening`` are the vehicles that
    were to release; ``staggered`` says that some grippers open before the others; ``cornered`` that
    the team lands although neither landing nor release is open; ``down_since`` is when all
    setpoints had come down. ``alone`` are the vehicles that fly without setpoints, those excepted
    whose setpoints have come down, ``alone_since`` is since when it is these. ``waited`` is for how
    many seconds the descent has paused for vehicles that stay above, or whose rotors turn on the
    ground below cable. ``caught`` are the vehicles that a strand holds back in the descent.
    """

    response: Response
    since: float
    step_since: float
    step: Step = Step.APPROACH
    target: float | None = None
    moving_at: float = 0.0
    landing: frozenset[int] = frozenset()
    on_ground_since: dict[int, float] = field(default_factory=dict)
    opening: frozenset[int] = frozenset()
    staggered: bool = False
    cornered: bool = False
    down_since: float | None = None
    alone: tuple[int, ...] = ()
    alone_since: float = 0.0
    waited: float = 0.0
    caught: frozenset[int] = frozenset()

    def change_step(self, trigger: StepTrigger, now: float) -> None:
        """Go to the step that the table of transitions has; ValueError where it has none."""
        self.step, self.step_since = next_step(self.step, trigger), now


@dataclass
class Ending:
    """How the flight ends: the first reason for which it has failed, whether the operator has
    interrupted it, and the outcome once it has ended."""

    failure: str | None = None
    interrupted: bool = False
    outcome: Outcome | None = None


@dataclass(frozen=True, eq=False)
class Found:
    """Where an interrupted team is: its ``places`` (n, 3), ENU metres of the plan, the mission
    ``time`` whose planned places are nearest, and how far ``off`` them a vehicle is at most."""

    time: float
    places: Floats
    off: float


@dataclass
class Resumption:
    """Where an interrupted flight broke off, and the operator's order for after it is resumed.

    ``then`` is None for a team that is only searched: nothing is commanded. ``found`` is where it
    rests then.
    """

    left_off: LeftOff | None = None
    then: Then | None = "hold"
    found: Found | None = None


@dataclass(eq=False)
class FlightState:
    """One flight: its constants, the parts of its state, and the objects that it works with.

    ``monitored`` is the live monitor's latest sample (None: there is nothing to monitor),
    ``next_monitoring`` the time of the next. ``go_asked``: since when a screen may give the
    go, ``go_given`` when it has; ``ground_check`` is what the check before it does, in words.
    """

    setup: Setup
    team: Team
    preparation: Preparation
    clock: MissionClock
    guidance: Guidance
    detectors: Detectors
    recorder: Recorder
    stream_loss: StreamLossCertificate
    roster: Roster
    placement: Placement
    observation: Observation
    streams: Streams
    stage: Stage = Stage.PREPARE
    monitored: Sample | None = None
    next_monitoring: float = 0.0
    swing: Swing | None = None
    timing: Timing = field(default_factory=Timing)
    progress: Progress = field(default_factory=Progress)
    holds: Holds = field(default_factory=Holds)
    contingency: Contingency | None = None
    ending: Ending = field(default_factory=Ending)
    resumption: Resumption = field(default_factory=Resumption)
    go_asked: float | None = None
    ground_check: str = ""
    go_given: float | None = None
    _phase: tuple[float, Phase] | None = None

    @property
    def now(self) -> float:
        """The time of this tick."""
        return self.timing.now

    @property
    def phase(self) -> Phase:
        """The plan's phase at this moment."""
        time = self.clock.time
        if self._phase is None or self._phase[0] != time:
            self._phase = time, self.setup.plan.phase_at(time)
        return self._phase[1]

    @property
    def gate(self) -> Gate | None:
        """The next gate; None after the last."""
        gates = self.setup.gates
        return gates[self.progress.gate] if self.progress.gate < len(gates) else None

    @property
    def landing_as_planned(self) -> bool:
        """Whether the clock waits at the gate at which all land."""
        gate = self.gate
        return self.progress.waiting and gate is not None and gate.condition == "landed"

    @property
    def allowed_error(self) -> float:
        """Tracking error in metres at which the clock stands still.

        The tracking radius where a cable is attached or taken for attached; vehicles that could
        not hold one need not stay within it. Where a flight measures errors: its own limit.
        """
        if self.setup.options.error_limit is not None:
            return self.setup.options.error_limit
        tracking = self.setup.plan.mission.vehicles.tracking
        held = self.phase.cable in {"lifting", "aloft"} and not self.setup.bare
        return tracking if held and tracking > 0 else max(tracking, LOOSE_ERROR)

    @property
    def clearances(self) -> Clearances | None:
        """The latest distances of the live monitor; None where there is nothing to monitor."""
        return self.monitored.clearances if self.monitored else None

    @property
    def expected(self) -> Expected:
        """The commanded state of the vehicles."""
        streams, contingency = self.streams, self.contingency
        may_land = np.full(len(streams.active), self.landing_as_planned)
        approaches = False
        if contingency is not None:
            systems = self.roster.systems
            may_land = np.array([system in contingency.landing for system in systems])
            approaches = contingency.step is Step.APPROACH
        return Expected(
            setpoint=streams.setpoint,
            velocity=streams.velocity,
            streaming=streams.active,
            armed=streams.expected_armed,
            may_land=may_land,
            fallen=streams.fallen,
            rejoining=frozenset(streams.rejoining),
            opening=(contingency.opening if contingency else frozenset()) - streams.fallen,
            start_height=self.placement.start_position[:, 2],
            cable=self.phase.cable,
            descending=self.guidance.descending,
            waiting=self.progress.waiting,
            holds=self.holds.causes,
            rate=self.clock.rate,
            rewinding=self.progress.rewinding,
            allowed_error=self.allowed_error,
            monitored=self.monitored,
            blocked=self.now - contingency.moving_at if contingency and approaches else 0.0,
        )

    @property
    def attached(self) -> bool:
        """Whether any vehicle holds the cable."""
        return any(vehicle.gripped for vehicle in self.roster.vehicles)

    def received(self, vehicle: Vehicle, within: float | None = None) -> bool:
        """Whether a packet of a vehicle was received lately, within so many seconds."""
        return self.now - vehicle.received_at <= (within or self.setup.fleet.limits.silence)

    def name(self, vehicle: Vehicle) -> str:
        """Return the name of a vehicle in messages."""
        return named(vehicle, self.roster.numbers.get(vehicle.system, vehicle.system))

    def names(self, vehicles: Iterable[Vehicle]) -> str:
        """Return the names of vehicles in messages."""
        return ", ".join(self.name(vehicle) for vehicle in vehicles)

    def report(self, kind: str, message: str, vehicle: Vehicle | None = None) -> None:
        """Add an event to the record."""
        number = self.roster.numbers.get(vehicle.system) if vehicle else None
        self.recorder.event(self.now, kind, message, number)

    def report_of_system(self, kind: str, message: str, system: int | None) -> None:
        """Add an event of a system to the record."""
        self.report(kind, message, self.team.vehicles.get(system) if system else None)

    # Changes

    def hold(self, cause: HoldCause, message: str) -> None:
        """Hold the clock until the cause has ended; another of the same cause does nothing."""
        if cause not in self.holds.causes:
            self.holds.causes = {**self.holds.causes, cause: message}
            self.report("hold", f"holding: {message}")

    def start_stream(self, k: int) -> None:
        """Begin to send setpoints to a vehicle, from its position, blending into the plan."""
        if not self.streams.active[k]:
            self.streams.switch(k, on=True)
            position = self.observation.position[k]
            self.guidance.join(k, position, self.clock.time, self.timing.moving)

    def begin_rejoining(self, k: int) -> None:
        """Begin to send setpoints to a vehicle that shall return to offboard mode."""
        self.streams.rejoining = {**self.streams.rejoining, k: self.now}
        self.start_stream(k)

    def stop_streams_of_landing(self) -> None:
        """End the setpoints to vehicles that have left offboard mode to land."""
        for k, vehicle in enumerate(self.roster.vehicles):
            if self.streams.active[k] and vehicle.in_mode("land"):
                self.streams.switch(k, on=False)

    def change_stage(self, trigger: Trigger) -> None:
        """Go to the stage that the table of transitions has; ValueError where it has none."""
        self.stage = next_stage(self.stage, trigger)

    def mark_failed(self, message: str) -> None:
        """Keep the first reason for which the flight has failed, however it ends."""
        if self.ending.failure is None:
            self.ending.failure = message

    def conclude(self) -> None:
        """End a flight whose vehicles have all landed, with its outcome."""
        if self.ending.failure is not None:
            self.finish("failed", self.ending.failure)
        elif self.ending.interrupted:
            self.finish("interrupted", "interrupted; all vehicles have landed")
        elif self.stage is Stage.CONTINGENCY:
            self.finish("interrupted", "landed before the plan was flown to its end")
        else:
            self.finish("done", "all vehicles have landed and disarmed")

    def finish(self, word: Word, message: str) -> None:
        """End the flight with an outcome."""
        self.streams.stop_all()
        for vehicle in self.roster.vehicles:
            vehicle.restore_streams()
        self.ending.outcome = Outcome(word, message)
        drag = self.detectors.grip_slip.drag
        if drag > _LEAST_DRAG:
            self.report("drag", f"the vehicles' drag, fitted in this flight: {drag:.2f} 1/s")
        self.report("outcome", f"{word}: {message}")
        self.change_stage(Trigger.END)
