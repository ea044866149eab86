"""The conductor: one mission clock for the team, from the first heartbeat to the last disarm.

Sans-IO: bytes in (:meth:`Conductor.receive`), time in and bytes out (:meth:`Conductor.tick`). The
same conductor flies the emulator in virtual time and vehicles on real links.

The flight goes through stages: ``prepare`` (who is there, streams, origins, readiness), ``ready``
(audited; waits for :meth:`Conductor.start`), ``fly`` (the mission clock), ``leave`` (everybody
down together, out of turn), ``finished``. A flight that is taken up again begins with ``find``.
"""

from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np
import numpy.typing as npt

from swarm.analysis.separation import separations
from swarm.certification.contingency_windows import contingency_windows
from swarm.certification.monitor import Clearances, Monitor
from swarm.certification.stream_loss import StreamLossModel, certify_stream_loss
from swarm.errors import Refused
from swarm.flight.bench_flight import is_bare
from swarm.flight.clearance import Audit, ClearedPlan
from swarm.flight.clock import MissionClock
from swarm.flight.contingency import Contingency, Kind
from swarm.flight.estimation import Measured
from swarm.flight.failure_detection import Reports, hear
from swarm.flight.flight_plan import FlightPlan, basis_of
from swarm.flight.gates import check_rest
from swarm.flight.grip_slip import GripSlipDetector
from swarm.flight.guidance import Guidance
from swarm.flight.load import PlannedPull
from swarm.flight.measuring import Sight, keep_trace, measure
from swarm.flight.operator import GRANT, Request, available
from swarm.flight.pace import LONGEST_TICK
from swarm.flight.parameters import STREAM_LOSS_TIME
from swarm.flight.preparation import Preparation
from swarm.flight.readiness import named
from swarm.flight.reporting import snapshot_of, statistics_of, trace_of
from swarm.flight.result import Outcome, Statistics, Word
from swarm.flight.resuming import LeftOff, Then
from swarm.flight.router import Address, Outgoing, Team
from swarm.flight.sending import setpoints
from swarm.flight.snapshot import Event, Snapshot
from swarm.flight.stages import STAGES
from swarm.flight.trace import Trace
from swarm.mavlink.frames import Frames
from swarm.mavlink.vehicle import Vehicle
from swarm.mission.fleet import Fleet
from swarm.planning import Phase

Floats = npt.NDArray[np.float64]
Stage = Literal["prepare", "ready", "find", "fly", "leave", "finished"]

LOOSE_BUDGET = 0.5
"""Metres of tracking error that are allowed while nobody holds the cable."""


class Conductor:
    """Flies a plan that was checked with a fleet.

    ``now`` is seconds since the flight's record began, in every call.
    """

    def __init__(
        self,
        flight_plan: FlightPlan,
        fleet: Fleet,
        *,
        no_cable: bool = False,
        left: LeftOff | None = None,
        then: Then = "hold",
        open_loop: bool = False,
        stray_limit: float | None = None,
        speed: float = 1.0,
    ) -> None:
        """Raise :class:`Refused` where the fleet is too small, the plan does not rest at gates, is
        not the one that was checked, or would carry cable that was not.

        ``no_cable`` flies the same plan with nothing attached: grips are simulated. ``left`` is
        where a flight broke off that is to be taken up again, ``then`` what follows once everybody
        has been found. ``open_loop`` keeps the planned pace whatever comes near, pulls or falls
        behind: for comparisons in the emulator alone. With a ``stray_limit`` in metres tracking
        errors slow and hold nothing in a hold; beyond it, or too near each other, all land.
        ``speed`` is how many seconds of flight time pass in one of real time.
        """
        flight_plan.check()
        plan = flight_plan.plan
        if len(fleet.vehicles) < plan.vehicles:
            raise Refused(
                f"the plan needs {plan.vehicles} vehicles, the fleet {fleet.name} "
                f"has {len(fleet.vehicles)}"
            )
        self.flight_plan, self.plan, self.fleet = flight_plan, plan, fleet
        self.open_loop, self.stray_limit = open_loop, stray_limit
        tied_on = plan.mission.grab == "attached"
        self.grips = fleet.gripper == "mavlink" and not no_cable and not tied_on
        self.carries = not no_cable and len(plan.layout.lengths) > 0
        self.basis = basis_of(flight_plan, cable=self.carries)
        self.bare = is_bare(fleet, no_cable=no_cable)
        self.gates = tuple(sorted(plan.gates, key=lambda gate: gate.time))
        check_rest(flight_plan.plan)
        self.windows = contingency_windows(plan, whole=True)
        self.separations = separations(plan)
        model = StreamLossModel((STREAM_LOSS_TIME,), fleet.limits.silence)
        known = flight_plan.stream_loss
        fits = known is not None and known.holds_for(plan, model)
        self.stream_loss = known if known is not None and fits else certify_stream_loss(plan, model)
        self.monitor = Monitor(plan)
        self.pull = PlannedPull(plan)
        self.sight: Sight | None = None
        self.guidance = Guidance(plan.motion)
        vehicles = plan.mission.vehicles
        self.clock = MissionClock(steepest=vehicles.braking_acceleration / vehicles.max_speed)

        self._phase = self.clock.time, plan.phase_at(self.clock.time)

        self.stage: Stage = "prepare"
        self.outcome: Outcome | None = None
        self.audit: Audit | None = None
        self.now = self.last = self.moving = self.stage_since = 0.0
        self._events: list[Event] = []
        self.team = Team(fleet, self._report)
        self.fly_with(list(self.team.vehicles.values())[: plan.vehicles])
        self.lift = np.array([0.0, 0.0, vehicles.grip_offset])
        standing = self.guidance.planned(0.0).position + self.lift
        self.preparation = Preparation(self.team, fleet, standing, speed)
        self._reset_flight()
        self._reset_numbers(plan.vehicles)
        self.then: Then = then
        self.left_off = left
        if left is not None:
            self._look_for(left, standing - self.lift)

    def fly_with(self, flyers: list[Vehicle]) -> None:
        """Say who flies, in order along the cable; a guess until everybody has been heard."""
        self.flyers = flyers
        self.systems = tuple(vehicle.system for vehicle in flyers)
        self.number = {system: number for number, system in enumerate(self.systems, 1)}
        self.rows = np.array([vehicle.row for vehicle in flyers])

    def _reset_flight(self) -> None:
        self.gate = 0
        self.gate_since = self.settled_since = 0.0
        self.waiting = False
        self.budget_kept_since = 0.0
        self.still_since = 0.0
        self.rewinding = False
        self.holds: dict[str, str] = {}
        self.hold_since: float | None = None
        self.dead: set[int] = set()
        self.rejoining: dict[int, float] = {}
        self.way_out: Contingency | None = None
        self._failed: str | None = None
        self.interrupted = False
        self.silent: set[int] = set()
        self._done_once: set[tuple[int, int, str]] = set()

    def _reset_numbers(self, n: int) -> None:
        self.frames: Frames | None = None
        self.yaw = np.zeros(n)
        self.start_position = np.full((n, 3), np.nan)
        self.measured = Measured.of(n)
        self.reports = Reports.of(n)
        self.grasps = GripSlipDetector(self.plan)
        self.position = np.full((n, 3), np.nan)
        self.velocity = np.full((n, 3), np.nan)
        self.setpoint = np.full((n, 3), np.nan)
        self.setpoint_velocity = np.zeros((n, 3))
        self.error = np.full(n, np.nan)
        self.streaming = np.zeros(n, dtype=np.bool_)
        self.expected_armed = np.zeros(n, dtype=np.bool_)
        self.flown: list[tuple[float, float, Floats, Floats, str]] = []
        self.next_trace = self.next_look = 0.0
        self.setpoints_sent = 0

    def _look_for(self, left: LeftOff, pads: Floats) -> None:
        """Begin with a team that flies already, wherever it is."""
        self.fly_with([self.team.vehicles[system] for system in left.systems])
        self.frames, self.yaw, self.start_position = left.frames, left.yaw, pads
        self.stage = "find"

    # What the shell calls

    def receive(self, link: str, address: Address | None, data: bytes, now: float) -> bool:
        """Take bytes that arrived on a link from an address; return whether they were read."""
        return self.team.receive(link, address, data, now)

    def receive_all(
        self, link: str, arrived: Sequence[tuple[Address | None, bytes]], now: float
    ) -> None:
        """As :meth:`receive`, of bytes from any number of addresses at once, and quicker."""
        self.team.receive_all(link, arrived, now)

    def tick(self, now: float) -> list[Outgoing]:
        """Let time pass; return what to send. Called at the fleet's setpoint rate."""
        self.last, self.now = self.now, now
        self.moving += min(now - self.last, LONGEST_TICK)
        hear(self)
        measure(self)
        if self.outcome is None:
            STAGES[self.stage](self)
        # setpoints first: whatever else is sent comes behind them
        outgoing = setpoints(self)
        outgoing.extend(self.team.tick(now))
        keep_trace(self)
        return outgoing

    def start(self, cleared: ClearedPlan) -> None:
        """Begin the flight; only a cleared plan can, and only once it is ready."""
        if cleared.flight_plan is not self.flight_plan or self.stage != "ready":
            raise Refused("this flight is not ready for that plan")
        if cleared.audit.stream_loss is not None:
            self.stream_loss = cleared.audit.stream_loss
        self.enter("fly")
        self.say("flight", f"cleared for flight: {self.basis.words}")

    def refuse(self, words: str) -> None:
        """End the flight before it begins: the audit did not pass."""
        self.finish_as("refused", words)

    def give_up(self, words: str) -> None:
        """End the flight whatever it is doing; for shells that cannot go on."""
        self.finish_as("failed", words)

    def request(self, request: Request) -> str:
        """Take the operator's wish, and say what follows from it.

        What each wish would do now, and whether it can, is in :attr:`Snapshot.available`.
        """
        answer = available(self)[request]
        self.say("operator", f"{request}: {answer.words}")
        if answer.open:
            GRANT[request](self)
        return answer.words

    @property
    def finished(self) -> Outcome | None:
        """How the flight ended; None while it goes on."""
        return self.outcome if self.stage == "finished" else None

    @property
    def over(self) -> bool:
        """Whether the flight has ended."""
        return self.stage == "finished"

    def events(self) -> list[Event]:
        """Return the events since the last call."""
        events, self._events = self._events, []
        return events

    def snapshot(self, now: float) -> Snapshot:
        """Return what the flight looks like at this moment."""
        return snapshot_of(self, now)

    def statistics(self) -> Statistics:
        """Return what the flight's links did so far."""
        return statistics_of(self)

    def trace(self) -> Trace:
        """Return what was flown so far."""
        return trace_of(self)

    # What gates and ways out use

    @property
    def phase(self) -> Phase:
        """The plan's phase at this moment."""
        if self._phase[0] != self.clock.time:
            self._phase = self.clock.time, self.plan.phase_at(self.clock.time)
        return self._phase[1]

    @property
    def budget(self) -> float:
        """Tracking error in metres at which the clock stands still.

        The tracking ball, where a cable is held or pretended to be; vehicles that never could hold
        one need not keep within it. Where a flight measures errors, as far as they are allowed.
        """
        if self.stray_limit is not None:
            return self.stray_limit
        tracking = self.plan.mission.vehicles.tracking
        held = self.phase.cable in {"lifting", "aloft"} and not self.bare
        return tracking if held and tracking > 0 else max(tracking, LOOSE_BUDGET)

    @property
    def holding(self) -> str | None:
        """Why the clock is held; None while it is not."""
        return "; ".join(self.holds.values()) or None

    @property
    def clearances(self) -> Clearances | None:
        """What the live monitor saw last; None where there is nothing to look at."""
        return self.sight.clearances if self.sight else None

    @property
    def leaving(self) -> bool:
        """Whether the team has left the plan."""
        return self.way_out is not None

    def stream(self, k: int) -> None:
        """Begin to stream setpoints to a vehicle, from where it is, blending into the plan."""
        if not self.streaming[k]:
            self.streaming[k] = True
            self.guidance.join(k, self.position[k], self.clock.time, self.moving)

    def expect_armed(self) -> None:
        """From now on, a vehicle that is not armed has failed."""
        self.expected_armed[:] = True

    def height_above_start(self, k: int) -> float:
        """Return how far above its pad a vehicle is."""
        return float(self.position[k, 2] - self.start_position[k, 2])

    def first_time(self, k: int, what: str) -> bool:
        """Whether this is the first time that a gate wants to do this for a vehicle."""
        key = (self.gate, k, what)
        new = key not in self._done_once
        self._done_once.add(key)
        return new

    def stop_streams_of_landing(self) -> None:
        """End the stream to vehicles that have left offboard mode to land."""
        for k, vehicle in enumerate(self.flyers):
            if self.streaming[k] and vehicle.in_mode("land"):
                self.streaming[k] = False

    def heard(self, vehicle: Vehicle, within: float | None = None) -> bool:
        """Whether a vehicle has been heard lately."""
        return self.now - vehicle.received_at <= (within or self.fleet.limits.silence)

    def name(self, vehicle: Vehicle) -> str:
        """Return what a vehicle is called in messages."""
        return named(vehicle, self.number.get(vehicle.system, vehicle.system))

    def say(self, kind: str, words: str, vehicle: Vehicle | None = None) -> None:
        """Report an event."""
        number = self.number.get(vehicle.system) if vehicle else None
        self._events.append(Event(self.now, kind, words, number))

    def fail(self, words: str) -> None:
        """Remember the first reason for which the flight has failed, however it ends."""
        if self._failed is None:
            self._failed = words

    # Responses

    def take_up(self, time: float) -> None:
        """Go on at a mission time with a team that flies, standing still, nobody streamed to."""
        left = self.left_off
        if left is None:
            raise Refused("this flight did not break off")
        self.clock.time, self.gate = time, left.gate
        self.clock.set_stopped()
        self.expect_armed()
        for vehicle in self.flyers:
            vehicle.gripped = left.gripped
            vehicle.take_events()
        self.enter("fly")

    def hold(self, cause: str, words: str) -> None:
        """Hold the clock until the cause is gone."""
        if cause not in self.holds:
            self.holds[cause] = words
            self.say("hold", f"holding: {words}")

    def cut_loose(self, vehicle: Vehicle, words: str) -> None:
        """Let go of a vehicle that falls, and of the cable around it; land what is left."""
        k = self.number[vehicle.system] - 1
        if k in self.dead:
            return
        self.dead.add(k)
        self.streaming[k] = False
        if self.stage == "fly":
            self.leave("cut loose", words, move=False)
        elif self.way_out is not None and len(self.dead) == 1:
            self.way_out.cut()

    def leave(self, kind: Kind, words: str, *, move: bool, told: str = "") -> None:
        """Leave the plan: land together, or release, separate and land together; it is ``told`` as
        that, or as something else."""
        if self.stage in {"prepare", "ready"}:
            self.finish_as("interrupted", words)
        elif self.stage == "fly":
            self.say("leave", f"{told or _LEAVING[kind]}: {words}")
            self.waiting = False
            self.rewinding = False
            self.enter("leave")
            self.way_out = Contingency(self, kind, move=move)
            if not np.any(self.expected_armed):
                for vehicle in self.flyers:
                    vehicle.disarm()

    def conclude(self) -> None:
        """End the flight, everybody being down: as well as it went."""
        if self._failed is not None:
            self.finish_as("failed", self._failed)
        elif self.interrupted:
            self.finish_as("interrupted", "interrupted; everybody has landed")
        elif self.stage == "leave":
            self.finish_as("interrupted", "landed before the plan was flown to its end")
        else:
            self.finish_as("done", "all vehicles have landed and disarmed")

    def finish_as(self, word: Word, why: str) -> None:
        """End the flight with this outcome."""
        self.streaming[:] = False
        for vehicle in self.flyers:
            vehicle.restore_streams()
        self.outcome = Outcome(word, why)
        self.say("outcome", f"{word}: {why}")
        self.enter("finished")

    # Words

    def _report(self, kind: str, words: str, system: int | None) -> None:
        self.say(kind, words, self.team.vehicles.get(system) if system else None)

    def enter(self, stage: Stage) -> None:
        """Begin a stage now."""
        self.stage = stage
        self.stage_since = self.now


_LEAVING: Mapping[Kind, str] = {
    "land": "landing together",
    "release": "releasing and landing",
    "cut loose": "letting go of what falls, separating and landing",
}
