"""The conductor: one mission clock for the team, from the first heartbeat to the last disarm.

Sans-IO: bytes in (:meth:`Conductor.receive`), time in and bytes out (:meth:`Conductor.tick`). The
same conductor flies the emulator in virtual time and vehicles on real links.

The flight goes through stages: ``prepare`` (who is there, streams, origins, readiness), ``ready``
(audited; waits for :meth:`Conductor.start`), ``fly`` (the mission clock), ``leave`` (everybody
down together, out of turn), ``finished``.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Literal

import numpy as np
import numpy.typing as npt

from swarm.errors import Refused
from swarm.fleet import Fleet
from swarm.flight.clearance import Audit, ClearedPlan
from swarm.flight.clock import MissionClock
from swarm.flight.failures import failure, hear, watch
from swarm.flight.gates import GATES
from swarm.flight.guidance import Guidance
from swarm.flight.load import PlannedPull
from swarm.flight.monitor import AHEAD, Clearances, Monitor
from swarm.flight.operator import GRANT, Request, available
from swarm.flight.options import options, rewind_limit
from swarm.flight.preparation import Preparation, Prepared
from swarm.flight.readiness import named, readiness
from swarm.flight.reporting import snapshot_of, statistics_of
from swarm.flight.result import Outcome, Statistics, Word
from swarm.flight.snapshot import Event, Snapshot
from swarm.flight.team import Address, Outgoing, Team
from swarm.flight.trace import Trace
from swarm.flight.wayout import Kind, WayOut
from swarm.mavlink.frames import Frames
from swarm.mavlink.vehicle import Vehicle
from swarm.plans import Phase
from swarm.preflight.findings import ProvenPlan

Floats = npt.NDArray[np.float64]
Stage = Literal["prepare", "ready", "fly", "leave", "finished"]

SLOW_FROM = 0.6
"""Share of the tracking ball from which the clock slows down; at the full ball it stands still."""
LOOSE_BUDGET = 0.5
"""Metres of tracking error that are allowed while nobody holds the cable."""
TRACE_INTERVAL = 0.1
MONITOR_INTERVAL = 0.1
FRESHEST = 0.5
"""Seconds over which a position is carried on with its velocity."""
FRESH_IN_TRACE = 1.0
_NO_LONGER_READY = 5.0


class Conductor:
    """Flies a proven plan with a fleet.

    ``now`` is seconds since the flight's record began, in every call.
    """

    def __init__(self, proven: ProvenPlan, fleet: Fleet, *, no_cable: bool = False) -> None:
        """Raise :class:`Refused` where the fleet is too small or the plan does not rest at gates.

        ``no_cable`` flies the same plan with nothing attached: grips are simulated.
        """
        plan = proven.plan
        if len(fleet.vehicles) < plan.vehicles:
            raise Refused(
                f"the plan needs {plan.vehicles} vehicles, the fleet {fleet.name} "
                f"has {len(fleet.vehicles)}"
            )
        self.proven, self.plan, self.fleet = proven, plan, fleet
        tied_on = plan.mission.grab == "attached"
        self.grips = fleet.gripper == "mavlink" and not no_cable and not tied_on
        self._carries = not no_cable
        self.gates = tuple(sorted(plan.gates, key=lambda gate: gate.time))
        _check_rest(proven)
        self.options = options(plan)
        self._monitor = Monitor(plan)
        self._pull = PlannedPull(plan)
        self.clearances: Clearances | None = None
        self.guidance = Guidance(plan.motion)
        vehicles = plan.mission.vehicles
        self.clock = MissionClock(steepest=vehicles.braking_acceleration / vehicles.max_speed)

        self.stage: Stage = "prepare"
        self.outcome: Outcome | None = None
        self.audit: Audit | None = None
        self.now = self._last = self._stage_since = 0.0
        self._events: list[Event] = []
        self.team = Team(fleet, self._report)
        self._fly_with(list(self.team.vehicles.values())[: plan.vehicles])
        self._lift = np.array([0.0, 0.0, vehicles.grip_offset])
        standing = self.guidance.planned(0.0).position + self._lift
        self.preparation = Preparation(self.team, fleet, standing)
        self._reset_flight()
        self._reset_numbers(plan.vehicles)

    def _fly_with(self, flyers: list[Vehicle]) -> None:
        """Say who flies, in order along the cable; a guess until everybody has been heard."""
        self.flyers = flyers
        self.systems = tuple(vehicle.system for vehicle in flyers)
        self.number = {system: number for number, system in enumerate(self.systems, 1)}

    def _reset_flight(self) -> None:
        self.gate = 0
        self.gate_since = self.settled_since = 0.0
        self.waiting = False
        self.budget_kept_since = 0.0
        self.stopped_for_good = False
        self.rewinding = False
        self.holds: dict[str, str] = {}
        self._hold_since: float | None = None
        self.way_out: WayOut | None = None
        self._failed: str | None = None
        self.interrupted = False
        self.silent: set[int] = set()
        self._done_once: set[tuple[int, int, str]] = set()

    def _reset_numbers(self, n: int) -> None:
        self.frames: Frames | None = None
        self._yaw = np.zeros(n)
        self.start_position = np.full((n, 3), np.nan)
        self.position = np.full((n, 3), np.nan)
        self.velocity = np.full((n, 3), np.nan)
        self.setpoint = np.full((n, 3), np.nan)
        self._setpoint_velocity = np.zeros((n, 3))
        self.error = np.full(n, np.nan)
        self.streaming = np.zeros(n, dtype=np.bool_)
        self.expected_armed = np.zeros(n, dtype=np.bool_)
        self._trace: list[tuple[float, float, Floats, Floats, str]] = []
        self._next_trace = self._next_look = 0.0
        self.setpoints_sent = 0

    # What the shell calls

    def receive(self, link: str, address: Address | None, data: bytes, now: float) -> None:
        """Take bytes that arrived on a link from an address."""
        self.team.receive(link, address, data, now)

    def tick(self, now: float) -> list[Outgoing]:
        """Let time pass; return what to send. Called at the fleet's setpoint rate."""
        self._last, self.now = self.now, now
        hear(self)
        self._measure()
        if self.outcome is None:
            _STAGES[self.stage](self)
        outgoing = self.team.tick(now)
        outgoing.extend(self._setpoints())
        self._record()
        return outgoing

    def start(self, cleared: ClearedPlan) -> None:
        """Begin the flight; only a cleared plan can, and only once it is ready."""
        if cleared.proven is not self.proven or self.stage != "ready":
            raise Refused("this flight is not ready for that plan")
        self._enter("fly")
        self.say("flight", "cleared for flight")

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
        n = self.plan.vehicles
        return Trace(
            time=np.array([row[0] for row in self._trace]),
            mission_time=np.array([row[1] for row in self._trace]),
            position=np.array([row[2] for row in self._trace]).reshape(-1, n, 3),
            setpoint=np.array([row[3] for row in self._trace]).reshape(-1, n, 3),
            phase=tuple(row[4] for row in self._trace),
        )

    # What gates and ways out use

    @property
    def phase(self) -> Phase:
        """The plan's phase at this moment."""
        return self.plan.phase_at(self.clock.time)

    @property
    def budget(self) -> float:
        """Tracking error in metres at which the clock stands still."""
        tracking = self.plan.mission.vehicles.tracking
        held = self.phase.cable in {"lifting", "aloft"}
        return tracking if held and tracking > 0 else max(tracking, LOOSE_BUDGET)

    @property
    def holding(self) -> str | None:
        """Why the clock is held; None while it is not."""
        return "; ".join(self.holds.values()) or None

    @property
    def leaving(self) -> bool:
        """Whether the team has left the plan."""
        return self.way_out is not None

    def stream(self, k: int, now: float) -> None:
        """Begin to stream setpoints to a vehicle, from where it is, blending into the plan."""
        if not self.streaming[k]:
            self.streaming[k] = True
            self.guidance.join(k, self.position[k], self.clock.time, now)

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

    def advance_clock(self) -> bool:
        """Let mission time pass up to the next gate; return whether it was reached."""
        gates, gate = self.gates, self.gate
        upper = gates[gate].time if gate < len(gates) else self.plan.duration
        gate_before = gates[gate - 1].time if gate else 0.0
        lower = rewind_limit(self.phase, gate_before, self.budget_kept_since)
        lowest = self.clock.time if lower is None else lower
        self.clock.advance(self.now - self._last, min(lowest, self.clock.time), upper)
        return self.clock.time >= upper - 1e-9

    def heard(self, vehicle: Vehicle, within: float | None = None) -> bool:
        """Whether a vehicle has been heard lately."""
        return self.now - vehicle.heard_at <= (within or self.fleet.limits.silence)

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

    # Stages

    def _prepare(self) -> None:
        result = self.preparation.tick(self.now)
        if isinstance(result, Outcome):
            self.finish_as(result.word, result.explanation)
        elif isinstance(result, Prepared):
            self._fly_with(result.flyers)
            self.frames, self._yaw, self.audit = result.frames, result.yaw, result.audit
            self._measure()
            self.start_position = self.position.copy()
            self.say("flight", "all vehicles are ready")
            self._enter("ready")

    def _ready(self) -> None:
        findings = readiness(self.flyers, self.fleet, self.now)
        if not findings:
            self._stage_since = self.now
        elif self.now - self._stage_since > _NO_LONGER_READY:
            words = "\n".join(finding.message for finding in findings)
            self.finish_as("failed", f"no longer ready:\n{words}")

    def _fly(self) -> None:
        watch(self)
        self._look()
        self._bound_hold()
        if self.stage != "fly":
            return
        if not self.waiting:
            self._steer()
            if self.advance_clock():
                if self.gate < len(self.gates):
                    self._reach_gate()
                else:
                    self.conclude()
        if self.waiting:
            self._wait_at_gate()

    def _reach_gate(self) -> None:
        self.waiting = True
        self.gate_since = self.now
        self.clock.set_stopped()
        gate = self.gates[self.gate]
        who = "all inner vehicles" if gate.inner else "all"
        self.say("gate", f"waiting until {who} are {gate.condition}")
        GATES[gate.condition].begin(self, self.now)

    def _wait_at_gate(self) -> None:
        gate = self.gates[self.gate]
        if self.holds and gate.condition != "landed":
            self.gate_since += self.now - self._last
        elif GATES[gate.condition].passed(self, self.now):
            self.say("gate", f"all are {gate.condition}")
            self.waiting = False
            self.gate += 1
            self.clock.set_running()
            if gate.condition == "landed":
                self.conclude()
        elif self.now - self.gate_since > gate.timeout:
            failure(self, "gate timed out", f"not all are {gate.condition} in {gate.timeout:g} s")

    def _steer(self) -> None:
        """Set the rate that the clock should have: held, or slowed by the worst of the team."""
        if self.holds:
            self.clock.target = 0.0
            return
        worst = float(np.nanmax(self.error, initial=0.0)) / self.budget
        if worst > 1.0:
            self.budget_kept_since = self.clock.time
        pace = min(1.0, max(0.0, (1.0 - worst) / (1.0 - SLOW_FROM)))
        if self.clearances is not None:
            pace = min(pace, self.clearances.pace)
        if self.rewinding:
            pace = -pace
            if self.clock.stopped and self.clock.time <= self._rewind_end() + 1e-6:
                self.rewinding = False
                self.hold("operator", "rewound as far as it is safe")
                pace = 0.0
        self.clock.target = pace

    def _rewind_end(self) -> float:
        gate_before = self.gates[self.gate - 1].time if self.gate else 0.0
        end = rewind_limit(self.phase, gate_before, self.budget_kept_since)
        return self.clock.time if end is None else end

    def _look(self) -> None:
        """Look at the clearances, now and a moment ahead, ten times a second."""
        if self.now < self._next_look or not np.isfinite(self.position).all():
            return
        self._next_look = self.now + MONITOR_INTERVAL
        cable = self.phase.cable if any(v.gripped for v in self.flyers) else "free"
        if self.phase.cable == "floor" or self.waiting:
            self.clearances = None
            return
        moments = np.stack([self.position, self.position + AHEAD * self.velocity])
        here, ahead = self._monitor.look(moments, cable)
        self.clearances = replace(here, margin=min(here.margin, ahead.margin))

    def _bound_hold(self) -> None:
        if not self.holds:
            self._hold_since = None
        elif self._hold_since is None:
            self._hold_since = self.now
        elif self.interrupted and self.clock.stopped:
            self.leave("land", "interrupted", move=True)
        elif self.now - self._hold_since > self.fleet.limits.hold:
            failure(self, "held too long", f"on hold for {self.fleet.limits.hold:g} s")

    def _leave_tick(self) -> None:
        watch(self)
        if self.way_out is not None and self.way_out.tick() and self.stage == "leave":
            self.conclude()

    # Responses

    def hold(self, cause: str, words: str) -> None:
        """Hold the clock until the cause is gone."""
        if cause not in self.holds:
            self.holds[cause] = words
            self.say("hold", f"holding: {words}")

    def leave(self, kind: Kind, words: str, *, move: bool) -> None:
        """Leave the plan: land together, or release, separate and land together."""
        if self.stage in {"prepare", "ready"}:
            self.finish_as("interrupted", words)
        elif self.stage == "fly":
            what = "landing together" if kind == "land" else "releasing and landing"
            self.say("leave", f"{what}: {words}")
            self.waiting = False
            self.rewinding = False
            self._enter("leave")
            self.way_out = WayOut(self, kind, move=move)
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
        self._enter("finished")

    # Numbers

    def _measure(self) -> None:
        """Bring what the vehicles say to this moment, in mission ENU, as grip points."""
        if self.frames is None:
            return
        states = np.array([(v.position, v.velocity) for v in self.flyers])
        position, velocity = self.frames.states_to_mission(states)
        age = np.array([self.now - v.position_at for v in self.flyers])
        carried = np.minimum(age, FRESHEST)
        self.velocity = velocity
        self.position = position - self._lift + velocity * carried[:, None]
        off = self.position - self.setpoint
        off -= self._setpoint_velocity * (self.now - self._last)
        error = np.sqrt(np.einsum("ij,ij->i", off, off))
        error[~self.streaming | (age > self.fleet.limits.silence)] = np.nan
        self.error = error

    def _setpoints(self) -> list[Outgoing]:
        if self.frames is None or self.stage not in {"fly", "leave"}:
            return []
        position, velocity, acceleration = self.guidance.wanted(self.clock, self.now)
        self.setpoint, self._setpoint_velocity = position, velocity
        if not self.streaming.any():
            return []
        # a setpoint stands until the next one comes: aim at the middle of its time
        lead = 0.5 / self.fleet.rates.setpoint
        aimed = position + lead * velocity + (0.5 * lead * lead) * acceleration + self._lift
        if self._carries and all(vehicle.gripped for vehicle in self.flyers):
            acceleration = (
                acceleration - self._pull.at(self.clock.time) / self.plan.mission.vehicles.mass
            )
        sending = self.team.setpoints(
            self.systems,
            self.streaming,
            self.now,
            self.frames.to_vehicles(aimed, velocity, acceleration),
            self._yaw,
        )
        self.setpoints_sent += len(sending)
        return sending

    def _record(self) -> None:
        if self.frames is None or self.now < self._next_trace:
            return
        self._next_trace = self.now + TRACE_INTERVAL
        phase = self.phase.name if self.stage == "fly" else ""
        stale = [self.now - v.position_at > FRESH_IN_TRACE for v in self.flyers]
        position = self.position.copy()
        position[stale] = np.nan
        self._trace.append((self.now, self.clock.time, position, self.setpoint.copy(), phase))

    # Words

    def _report(self, kind: str, words: str, system: int | None) -> None:
        self.say(kind, words, self.team.vehicles.get(system) if system else None)

    def _enter(self, stage: Stage) -> None:
        self.stage = stage
        self._stage_since = self.now


_STAGES: Mapping[Stage, Callable[[Conductor], None]] = {
    "prepare": Conductor._prepare,
    "ready": Conductor._ready,
    "fly": Conductor._fly,
    "leave": Conductor._leave_tick,
    "finished": lambda _: None,
}


def _check_rest(proven: ProvenPlan) -> None:
    """Raise :class:`Refused` where the plan moves at a gate, at which the clock would stop dead."""
    for gate in proven.plan.gates:
        _, velocity, acceleration = proven.plan.motion.at(gate.time)
        fastest = float(np.linalg.norm(velocity, axis=1).max())
        strongest = float(np.linalg.norm(acceleration, axis=1).max())
        if not (fastest <= 1e-3 and strongest <= 0.05 and math.isfinite(gate.timeout)):
            raise Refused(
                f"the plan moves at the gate at {gate.time:.2f} s "
                f"({fastest:.3f} m/s, {strongest:.3f} m/s²); it must rest there"
            )
