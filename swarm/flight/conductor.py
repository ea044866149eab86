"""The conductor: one mission clock for the team, from the first heartbeat to the last disarm.

Sans-IO: bytes in (:meth:`Conductor.receive`), time in and bytes out (:meth:`Conductor.tick`). The
same conductor flies the emulator in virtual time and vehicles on real links.

The flight goes through stages: ``listen`` (who is there), ``prepare`` (streams, origins, modes,
readiness), ``ready`` (audited; waits for :meth:`Conductor.start`), ``fly`` (the mission clock),
``land`` (everybody down together, out of turn), ``finished``.
"""

import math
from collections.abc import Callable, Mapping
from typing import Literal

import numpy as np
import numpy.typing as npt
from pymavlink.dialects.v20 import common

from swarm.errors import Refused
from swarm.fleet import Fleet
from swarm.flight.clearance import Audit, ClearedPlan
from swarm.flight.clock import MissionClock
from swarm.flight.failures import FATAL, RESPONSES, Failure
from swarm.flight.gates import GATES
from swarm.flight.readiness import make_frames, named, placement, readiness
from swarm.flight.result import Outcome, Statistics
from swarm.flight.snapshot import Event, Snapshot
from swarm.flight.team import Address, Outgoing, Team
from swarm.flight.trace import Trace
from swarm.mavlink.frames import Frames
from swarm.mavlink.vehicle import Vehicle, VehicleEvent
from swarm.plans import Phase
from swarm.preflight.findings import Finding, ProvenPlan

Floats = npt.NDArray[np.float64]
Stage = Literal["listen", "prepare", "ready", "fly", "land", "finished"]
Request = Literal["hold", "resume", "land", "interrupt", "kill"]

STANDING_TIME = 1.0
"""Seconds over which the positions of standing vehicles are averaged."""
SLOW_FROM = 0.6
"""Share of the tracking ball from which the clock slows down; at the full ball it stands still."""
LOOSE_BUDGET = 0.5
"""Metres of tracking error that are allowed while nobody holds the cable."""
SHORTEST_BLEND = 2.0
BLEND_SPEED = 0.3
TRACE_INTERVAL = 0.1
TOUCHDOWN = 0.05
GIVE_UP_LANDING = 90.0


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
        self.grips = fleet.gripper == "mavlink" and not no_cable
        self.gates = tuple(sorted(plan.gates, key=lambda gate: gate.time))
        _check_rest(proven)

        self.stage: Stage = "listen"
        self.outcome: Outcome | None = None
        self.audit: Audit | None = None
        self.now = 0.0
        self._last = 0.0
        self._stage_since = 0.0
        self._events: list[Event] = []
        self.team = Team(fleet, self._report)
        self.flyers: list[Vehicle] = _in_cable_order(fleet, self.team.vehicles, plan.vehicles)
        self._number = {vehicle.system: k for k, vehicle in enumerate(self.flyers, 1)}
        self.systems = tuple(vehicle.system for vehicle in self.flyers)

        n = plan.vehicles
        vehicles = plan.mission.vehicles
        self.clock = MissionClock(steepest=vehicles.braking_acceleration / vehicles.max_speed)
        self.gate = 0
        self.gate_since = 0.0
        self.settled_since = 0.0
        self._waiting = False
        self._holds: dict[str, str] = {}
        self._hold_since: float | None = None
        self._failed: str | None = None
        self._interrupted = False
        self._silent: set[int] = set()
        self._done_once: set[tuple[int, int, str]] = set()

        self.frames: Frames | None = None
        self._lift = np.array([0.0, 0.0, vehicles.grip_offset])
        self._yaw = np.zeros(n)
        self._standing: list[tuple[float, Floats]] = []
        self.start_position = np.full((n, 3), np.nan)
        self.position = np.full((n, 3), np.nan)
        self.velocity = np.full((n, 3), np.nan)
        self.setpoint = np.full((n, 3), np.nan)
        self.setpoint_velocity = np.zeros((n, 3))
        self.error = np.full(n, np.nan)
        self.streaming = np.zeros(n, dtype=np.bool_)
        self._expected_armed = np.zeros(n, dtype=np.bool_)
        self._blend = np.zeros((n, 3))
        self._blend_from = np.zeros(n)
        self._blend_time = np.ones(n)
        self._descent: tuple[float, Floats] | None = None
        self._landing = np.zeros(n, dtype=np.bool_)
        self._trace: list[tuple[float, float, Floats, Floats, str]] = []
        self._next_trace = 0.0
        self.setpoints_sent = 0

    # What the shell calls

    def receive(self, link: str, address: Address | None, data: bytes, now: float) -> None:
        """Take bytes that arrived on a link from an address."""
        self.team.receive(link, address, data, now)

    def tick(self, now: float) -> list[Outgoing]:
        """Let time pass; return what to send. Called at the fleet's setpoint rate."""
        self._last, self.now = self.now, now
        self._hear()
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
        self._say("flight", "cleared for flight")

    def request(self, request: Request) -> None:
        """Take the operator's wish; what it does depends on where the flight is."""
        self._say("operator", f"asked to {request}")
        match request:
            case "hold":
                self._hold("operator", "the operator asked")
            case "resume":
                self._holds.pop("operator", None)
            case "land":
                self._begin_landing("the operator asked to land")
            case "kill":
                for vehicle in self.flyers:
                    vehicle.kill()
                self._fail("killed by the operator")
                self._enter("land")
            case "interrupt":
                self._interrupt()

    def refuse(self, words: str) -> None:
        """End the flight before it begins: the audit did not pass."""
        self._finish_as("refused", words)

    def give_up(self, words: str) -> None:
        """End the flight whatever it is doing; for shells that cannot go on."""
        self._finish_as("failed", words)

    @property
    def finished(self) -> Outcome | None:
        """How the flight ended; None while it goes on."""
        return self.outcome if self.stage == "finished" else None

    def events(self) -> list[Event]:
        """Return the events since the last call."""
        events, self._events = self._events, []
        return events

    def snapshot(self, now: float) -> Snapshot:
        """Return what the flight looks like at this moment."""
        flyers = self.flyers
        return Snapshot(
            time=now,
            mission_time=self.clock.time,
            rate=self.clock.rate,
            phase=self.phase.name if self.stage == "fly" else self.stage,
            waiting_for=self._waiting_for(),
            position=self.position.copy(),
            velocity=self.velocity.copy(),
            setpoint=self.setpoint.copy(),
            modes=tuple(vehicle.mode for vehicle in flyers),
            states=tuple(self._state(k) for k in range(len(flyers))),
            armed=tuple(vehicle.armed for vehicle in flyers),
            gripped=tuple(vehicle.gripped for vehicle in flyers),
            battery=np.array([vehicle.battery for vehicle in flyers]),
            link_age=np.array([now - vehicle.heard_at for vehicle in flyers]),
        )

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

    def statistics(self) -> Statistics:
        """Return what the flight's links did so far."""
        latencies = np.array([x for v in self.flyers for x in v.commands.latencies])
        return Statistics(
            duration=self.now,
            setpoints=self.setpoints_sent,
            command_latency=(float(np.median(latencies)), float(latencies.max()))
            if len(latencies)
            else None,
            received={v.system: v.packets for v in self.flyers},
            lost={v.system: v.lost_packets for v in self.flyers},
            round_trip={v.system: v.round_trip for v in self.flyers},
        )

    # What gates use

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

    def stream(self, k: int, now: float) -> None:
        """Begin to stream setpoints to a vehicle, from where it is, blending into the plan."""
        if self.streaming[k]:
            return
        self.streaming[k] = True
        planned = self.plan.motion.at(self.clock.time)[0][k]
        self._blend[k] = self.position[k] - planned
        self._blend_from[k] = now
        distance = float(np.linalg.norm(self._blend[k]))
        self._blend_time[k] = max(SHORTEST_BLEND, 1.875 * distance / BLEND_SPEED)

    def expect_armed(self) -> None:
        """From now on, a vehicle that is not armed has failed."""
        self._expected_armed[:] = True

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

    # Stages

    def _listen(self) -> None:
        heard = [v for v in self.flyers if v.autopilot is not None and v.heartbeat_at > -math.inf]
        if len(heard) == len(self.flyers):
            self._prepare_vehicles()
            self._enter("prepare")
        elif self._stage_age > self.fleet.limits.ready:
            missing = [self._name(v) for v in self.flyers if v not in heard]
            self._finish_as("failed", f"not heard: {', '.join(missing)}")

    def _prepare_vehicles(self) -> None:
        rates = self.fleet.rates
        wanted = {
            common.MAVLINK_MSG_ID_LOCAL_POSITION_NED: rates.position,
            common.MAVLINK_MSG_ID_ATTITUDE: rates.status,
            common.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: rates.status,
            common.MAVLINK_MSG_ID_SYS_STATUS: 1.0,
            common.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 1.0,
        }
        for vehicle in self.flyers:
            for message, rate in wanted.items():
                vehicle.request_interval(message, rate)

    def _prepare(self) -> None:
        for vehicle in self.flyers:
            if vehicle.origin is None and self.fleet.frame == "gps" and vehicle.commands.idle:
                vehicle.request_message(common.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN)
            early = vehicle.autopilot is not None and vehicle.autopilot.offboard_early
            if early and not vehicle.in_mode("offboard"):
                vehicle.set_mode("offboard")
        findings = readiness(self.flyers, self.fleet, self.now)
        if findings:
            self._standing.clear()
            if self._stage_age > self.fleet.limits.ready:
                silent = any(finding.check == "heard" for finding in findings)
                words = "\n".join(finding.message for finding in findings)
                self._finish_as("failed" if silent else "refused", words)
            return
        self._standing.append((self.now, _positions_ned(self.flyers)))
        if self.now - self._standing[0][0] < STANDING_TIME:
            return
        for vehicle in self.flyers:
            vehicle.quieten(self._stage_since, self.now)
        self._finish_preparing()

    def _finish_preparing(self) -> None:
        measured = np.mean([row for _, row in self._standing], axis=0)
        standing = self.plan.motion.at(0.0)[0] + self._lift
        self.frames = make_frames(self.flyers, self.fleet, standing, measured)
        findings = placement(self.flyers, self.fleet, self.frames, standing, measured)
        findings.extend(
            Finding("warning", "fleet", f"system {system} is heard and not in the fleet file")
            for system in self.team.strangers
        )
        self._yaw = np.array([vehicle.attitude[2] for vehicle in self.flyers])
        self._measure()
        self.start_position = self.position.copy()
        self.audit = Audit(self.systems, tuple(findings))
        self._say("flight", "all vehicles are ready")
        self._enter("ready")

    def _ready(self) -> None:
        findings = readiness(self.flyers, self.fleet, self.now)
        if findings and self._stage_age > 5.0:
            words = "\n".join(finding.message for finding in findings)
            self._finish_as("failed", f"no longer ready:\n{words}")

    def _fly(self) -> None:
        self._watch()
        if self.stage != "fly":
            return
        self._bound_hold()
        self._steer()
        duration = self.now - self._last
        if not self._waiting:
            upper = self.gates[self.gate].time if self.gate < len(self.gates) else math.inf
            lower = self.gates[self.gate - 1].time if self.gate else 0.0
            self.clock.advance(duration, lower, min(upper, self.plan.duration))
            if self.gate < len(self.gates) and self.clock.time >= upper - 1e-9:
                self._reach_gate()
            elif self.gate == len(self.gates) and self.clock.time >= self.plan.duration:
                self._complete()
        if self._waiting:
            self._wait_at_gate()

    def _reach_gate(self) -> None:
        self._waiting = True
        self.gate_since = self.now
        self.clock.set_stopped()
        gate = self.gates[self.gate]
        self._say("gate", f"waiting until all are {gate.condition}")
        GATES[gate.condition].begin(self, self.now)

    def _wait_at_gate(self) -> None:
        gate = self.gates[self.gate]
        if GATES[gate.condition].passed(self, self.now):
            self._say("gate", f"all are {gate.condition}")
            self._waiting = False
            self.gate += 1
            self.clock.set_running()
            if gate.condition == "landed":
                self._complete()
        elif self.now - self.gate_since > gate.timeout:
            self._failure("gate timed out", f"not all are {gate.condition} in {gate.timeout:g} s")

    def _steer(self) -> None:
        """Set the rate that the clock should have: held, or slowed by the worst tracker."""
        if self._holds:
            self.clock.target = 0.0
            return
        errors = self.error[np.isfinite(self.error)]
        worst = float(errors.max()) / self.budget if len(errors) else 0.0
        self.clock.target = min(1.0, max(0.0, (1.0 - worst) / (1.0 - SLOW_FROM)))

    def _bound_hold(self) -> None:
        if not self._holds:
            self._hold_since = None
        elif self._hold_since is None:
            self._hold_since = self.now
        elif self._interrupted and self.clock.stopped:
            self._begin_landing("interrupted")
        elif self.now - self._hold_since > self.fleet.limits.hold:
            self._failure("held too long", f"on hold for {self.fleet.limits.hold:g} s")

    def _land(self) -> None:
        """Bring everybody straight down together, then land, then disarm."""
        self._watch()
        self.clock.target = 0.0
        if not self.clock.stopped:
            self.clock.advance(self.now - self._last, 0.0, self.plan.duration)
        elif self._descent is None:
            self._descent = (self.now, self.setpoint.copy())
        for k, vehicle in enumerate(self.flyers):
            if not vehicle.armed:
                self.streaming[k] = False
                continue
            if not self.streaming[k] or (
                self._descent is not None and self.setpoint[k, 2] <= TOUCHDOWN
            ):
                self._landing[k] = True
            if self._landing[k] and not vehicle.in_mode("land") and self._heard(vehicle):
                vehicle.set_mode("land")
            if vehicle.on_ground and vehicle.in_mode("land") and self._stage_age > DISARM_GRACE:
                vehicle.disarm()
        self.stop_streams_of_landing()
        still = [v for v in self.flyers if v.armed and self._heard(v, self.fleet.limits.lost)]
        if not still:
            self._conclude()
        elif self._stage_age > GIVE_UP_LANDING:
            names = ", ".join(self._name(v) for v in still)
            self._fail(f"still armed {GIVE_UP_LANDING:g} s after landing was begun: {names}")
            self._conclude()

    # Watching

    def _watch(self) -> None:
        """Notice vehicles that fall silent."""
        limits = self.fleet.limits
        ages = {v.system: self.now - v.heard_at for v in self.flyers}
        lost = [v for v in self.flyers if ages[v.system] > limits.lost]
        if len(lost) == len(self.flyers):
            self._failure("all lost", f"no vehicle has been heard for {limits.lost:g} s")
            self._conclude()
            return
        for vehicle in self.flyers:
            age, name = ages[vehicle.system], self._name(vehicle)
            if age > limits.silence and vehicle.system not in self._silent:
                self._silent.add(vehicle.system)
                self._failure("silent", f"{name} has been silent for {age:.1f} s", vehicle)
            elif age <= limits.silence and vehicle.system in self._silent:
                self._silent.discard(vehicle.system)
                self._holds.pop(f"silent {vehicle.system}", None)
                self._say("link", f"{name} is heard again", vehicle)
        if lost and self.stage == "fly":
            names = ", ".join(self._name(vehicle) for vehicle in lost)
            self._failure("lost", f"not heard for {limits.lost:g} s: {names}")

    def _hear(self) -> None:
        """Turn what vehicles reported into events, and failures of theirs into responses."""
        for vehicle in self.team.vehicles.values():
            for event in vehicle.take_events():
                if not (event.kind == "done" and event.subject.startswith("interval")):
                    self._say(event.kind, event.message, vehicle)
                if vehicle.system in self._number:
                    self._judge(vehicle, event)

    def _judge(self, vehicle: Vehicle, event: VehicleEvent) -> None:
        if event.kind == "done" and event.subject in {"grab", "release"}:
            vehicle.gripped = event.subject == "grab"
        if self.stage not in {"fly", "land"}:
            return
        k, name = self._number[vehicle.system] - 1, self._name(vehicle)
        match event.kind:
            case "failed":
                self._failure("command failed", f"{name}: {event.message}", vehicle)
            case "disarmed" if self._expected_armed[k] and not self._may_be_down(vehicle):
                self.streaming[k] = False
                self._failure("disarmed", f"{name} disarmed in flight", vehicle)
            case "mode" if self.streaming[k] and self._expected_armed[k]:
                if not vehicle.in_mode("offboard") and not self._may_be_down(vehicle):
                    self.streaming[k] = False
                    said = vehicle.recent_words(self.now)
                    words = f"{name} left offboard mode by itself: {event.message}"
                    words += f" ({said})" if said else ""
                    self._failure("left offboard", words, vehicle)
            case "rebooted":
                self.streaming[k] = False
                self._failure("rebooted", f"{name} {event.message}", vehicle)
            case "origin":
                self._failure("origin moved", f"{name}: {event.message}", vehicle)

    def _may_be_down(self, vehicle: Vehicle) -> bool:
        """Whether the vehicle was told to land: leaving offboard and disarming are then meant."""
        k = self._number[vehicle.system] - 1
        at_end = self._waiting and self.gates[self.gate].condition == "landed"
        return bool(self._landing[k]) or (self.stage == "fly" and at_end)

    def _failure(self, failure: Failure, words: str, vehicle: Vehicle | None = None) -> None:
        """Answer a failure as the table says."""
        self._say("failure", f"{failure}: {words}", vehicle)
        if failure in FATAL:
            self._fail(words)
        if self.stage != "fly":
            return
        match RESPONSES[failure]:
            case "hold":
                key = f"{failure} {vehicle.system}" if vehicle else failure
                self._hold(key, words)
            case "land":
                self._begin_landing(words)

    def _hold(self, cause: str, words: str) -> None:
        if cause not in self._holds:
            self._holds[cause] = words
            self._say("hold", f"holding: {words}")

    def _begin_landing(self, words: str) -> None:
        if self.stage in {"listen", "prepare", "ready"}:
            self._finish_as("interrupted", words)
        elif self.stage == "fly":
            self._say("land", f"landing together: {words}")
            self._enter("land")
            self._waiting = False
            if not np.any(self._expected_armed):
                for vehicle in self.flyers:
                    vehicle.disarm()

    def _interrupt(self) -> None:
        again, self._interrupted = self._interrupted, True
        if self.stage in {"listen", "prepare", "ready"}:
            self._finish_as("interrupted", "interrupted before anything was armed")
        elif again or self._waiting:
            self._begin_landing("interrupted")
        else:
            self._hold("operator", "interrupted")

    def _fail(self, words: str) -> None:
        if self._failed is None:
            self._failed = words

    def _complete(self) -> None:
        if any(vehicle.armed for vehicle in self.flyers):
            self._begin_landing("the plan has ended")
        else:
            self._conclude()

    def _conclude(self) -> None:
        if self._failed is not None:
            self._finish_as("failed", self._failed)
        elif self._interrupted:
            self._finish_as("interrupted", "interrupted; everybody has landed")
        elif self.stage == "land":
            self._finish_as("failed", "landed before the plan was flown")
        else:
            self._finish_as("done", "all vehicles have landed and disarmed")

    def _finish_as(
        self, word: Literal["done", "refused", "failed", "interrupted"], why: str
    ) -> None:
        self.streaming[:] = False
        self.outcome = Outcome(word, why)
        self._say("outcome", f"{word}: {why}")
        self._enter("finished")

    # Numbers

    def _measure(self) -> None:
        """Bring what the vehicles say to this moment, in mission ENU, as grip points."""
        if self.frames is None:
            return
        flyers = self.flyers
        velocity = self.frames.vectors_to_mission(np.array([v.velocity for v in flyers]))
        age = np.array([self.now - v.position_at for v in flyers])
        position = self.frames.points_to_mission(_positions_ned(flyers)) - self._lift
        self.velocity = velocity
        self.position = position + velocity * np.clip(age, 0.0, FRESHEST)[:, None]
        elapsed = self.now - self._last
        ahead = self.setpoint + self.setpoint_velocity * elapsed
        self.error = np.where(
            self.streaming & (age < self.fleet.limits.silence),
            np.linalg.norm(self.position - ahead, axis=1),
            np.nan,
        )

    def _setpoints(self) -> list[Outgoing]:
        if self.frames is None or self.stage not in {"fly", "land"}:
            return []
        position, velocity, acceleration = self._wanted()
        self.setpoint, self.setpoint_velocity = position, velocity
        if not self.streaming.any():
            return []
        # a setpoint stands until the next one comes: aim at the middle of its time
        lead = 0.5 / self.fleet.rates.setpoint
        aimed = position + lead * velocity + 0.5 * lead**2 * acceleration
        sending = self.team.setpoints(
            self.systems,
            self.streaming,
            self.now,
            self.frames.points_to_vehicles(aimed + self._lift),
            self.frames.vectors_to_vehicles(velocity),
            self.frames.vectors_to_vehicles(acceleration),
            self._yaw,
        )
        self.setpoints_sent += len(sending)
        return sending

    def _wanted(self) -> tuple[Floats, Floats, Floats]:
        """Return position, velocity and acceleration (n, 3) of the grip points now, mission ENU."""
        if self._descent is not None:
            return self._descending(*self._descent)
        rate, slope = self.clock.rate, self.clock.slope
        position, along, curve = self.plan.motion.at(self.clock.time)
        velocity = rate * along
        acceleration = rate**2 * curve + slope * along
        if np.any(self._blend):
            u = np.clip((self.now - self._blend_from) / self._blend_time, 0.0, 1.0)[:, None]
            length = self._blend_time[:, None]
            left = 1.0 - u**3 * (10.0 - 15.0 * u + 6.0 * u**2)
            slowing = -30.0 * u**2 * (1.0 - u) ** 2 / length
            bending = -60.0 * u * (1.0 - u) * (1.0 - 2.0 * u) / length**2
            position = position + self._blend * left
            velocity = velocity + self._blend * slowing
            acceleration = acceleration + self._blend * bending
            if np.all(u >= 1.0):
                self._blend[:] = 0.0
        return position, velocity, acceleration

    def _descending(self, since: float, start: Floats) -> tuple[Floats, Floats, Floats]:
        """Straight down from rest at the fleet's descent speed, reached over one second."""
        speed, time = self.fleet.limits.descent, self.now - since
        ramp = min(time, 1.0)
        down = speed * (0.5 * ramp**2 + max(0.0, time - 1.0))
        position, velocity = start.copy(), np.zeros_like(start)
        position[:, 2] = np.maximum(start[:, 2] - down, np.minimum(start[:, 2], 0.0))
        velocity[position[:, 2] > 0.0, 2] = -speed * ramp
        return position, velocity, np.zeros_like(start)

    def _record(self) -> None:
        if self.frames is None or self.now < self._next_trace:
            return
        self._next_trace = self.now + TRACE_INTERVAL
        phase = self.phase.name if self.stage == "fly" else ""
        stale = np.array([self.now - v.position_at > FRESH_IN_TRACE for v in self.flyers])
        position = np.where(stale[:, None], np.nan, self.position)
        row = (self.now, self.clock.time, position, self.setpoint.copy(), phase)
        self._trace.append(row)

    # Words

    def _report(self, kind: str, words: str, system: int | None) -> None:
        self._say(kind, words, self.team.vehicles.get(system) if system else None)

    def _say(self, kind: str, words: str, vehicle: Vehicle | None = None) -> None:
        number = self._number.get(vehicle.system) if vehicle else None
        self._events.append(Event(self.now, kind, words, number))

    def _name(self, vehicle: Vehicle) -> str:
        return named(vehicle, self._number.get(vehicle.system, vehicle.system))

    def _heard(self, vehicle: Vehicle, within: float | None = None) -> bool:
        return self.now - vehicle.heard_at <= (within or self.fleet.limits.silence)

    @property
    def _stage_age(self) -> float:
        return self.now - self._stage_since

    def _enter(self, stage: Stage) -> None:
        self.stage = stage
        self._stage_since = self.now

    def _waiting_for(self) -> str | None:
        if self.stage == "fly" and self._waiting:
            return self.gates[self.gate].condition
        if self._holds:
            return "; ".join(self._holds.values())
        return {"listen": "heartbeats", "prepare": "readiness", "ready": "go"}.get(self.stage)

    def _state(self, k: int) -> str:
        vehicle = self.flyers[k]
        if not self._heard(vehicle):
            return "silent"
        if not vehicle.armed:
            return "ready" if vehicle.ready else "waiting"
        return "on the ground" if vehicle.on_ground else "flying"


FRESHEST = 0.5
"""Seconds over which a position is carried on with its velocity."""
FRESH_IN_TRACE = 1.0
DISARM_GRACE = 5.0

_STAGES: Mapping[Stage, Callable[[Conductor], None]] = {
    "listen": Conductor._listen,
    "prepare": Conductor._prepare,
    "ready": Conductor._ready,
    "fly": Conductor._fly,
    "land": Conductor._land,
    "finished": lambda _: None,
}


def _positions_ned(vehicles: list[Vehicle]) -> Floats:
    return np.array([vehicle.position for vehicle in vehicles])


def _in_cable_order(fleet: Fleet, vehicles: Mapping[int, Vehicle], needed: int) -> list[Vehicle]:
    """Return the vehicles that fly, in order along the cable, as the fleet file places them."""
    placed = {listed.pad: vehicles[listed.sysid] for listed in fleet.vehicles if listed.pad}
    others = [vehicles[listed.sysid] for listed in fleet.vehicles if listed.pad is None]
    return [placed.get(pad) or others.pop(0) for pad in range(1, needed + 1)]


def _check_rest(proven: ProvenPlan) -> None:
    """Raise :class:`Refused` where the plan moves at a gate, at which the clock would stop dead."""
    for gate in proven.plan.gates:
        _, velocity, acceleration = proven.plan.motion.at(gate.time)
        fastest = float(np.linalg.norm(velocity, axis=1).max())
        strongest = float(np.linalg.norm(acceleration, axis=1).max())
        if fastest > 1e-3 or strongest > 0.05:
            raise Refused(
                f"the plan moves at the gate at {gate.time:.2f} s "
                f"({fastest:.3f} m/s, {strongest:.3f} m/s²); it must rest there"
            )
