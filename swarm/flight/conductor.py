"""The conductor: one mission clock for the team, from the first heartbeat to the last disarm.

Sans-IO: bytes in (:meth:`Conductor.receive`), time in and bytes out (:meth:`Conductor.tick`). The
same conductor flies emulated vehicles in virtual time and vehicles on real links.

Theory of operation. The plan is a function of mission time, and :class:`.MissionClock` says how
mission time goes on: at rate 1 as planned, slower for tracking errors and small clearances, not at
all in a hold, backwards in a rewind. So all vehicles stay together on the certified path, whatever
slows one of them. At every tick the conductor

1. observes: the latest reports in one table, in the frame of the mission;
2. detects: each detector compares them with the commanded state; the policy responds at once;
3. decides: what the stage of the flight requires: a request of the operator, the next gate;
4. acts: setpoints of all vehicles at one mission time go first, then commands.

A flight has stages (:mod:`swarm.flight.stages`); :mod:`swarm.flight.execute` and
:mod:`swarm.flight.contingency` have what happens in each. Once the team has left its plan, it is in
a contingency, which ends on the ground. The state is in :mod:`swarm.flight.state`, responses to
failures are in :mod:`swarm.flight.failures`.
"""

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from swarm.certification.stream_loss import StreamLossCertificate
from swarm.errors import Refused
from swarm.flight import contingency, execute
from swarm.flight.detect import IN_FLIGHT, Detectors
from swarm.flight.estimation import Measured
from swarm.flight.flight_plan import Audit, ClearedPlan, FlightPlan
from swarm.flight.guidance import Guidance, MissionClock
from swarm.flight.observation import Observation
from swarm.flight.observing import follow_swing, monitor, observe
from swarm.flight.parameters import stream_loss_model, stream_loss_of
from swarm.flight.preparation import Preparation
from swarm.flight.reporting import record_sample, snapshot_of, statistics_of
from swarm.flight.requests import Request
from swarm.flight.responding import Availability, available, request, respond
from swarm.flight.result import Outcome, Statistics
from swarm.flight.router import Address, Outgoing, Team
from swarm.flight.setup import FlightOptions, Setup, setup_of
from swarm.flight.snapshot import Event, Recorder, Snapshot
from swarm.flight.stages import Stage, Trigger
from swarm.flight.state import (
    LONGEST_TICK,
    FlightState,
    Found,
    Placement,
    Resumption,
    Roster,
    Streams,
)
from swarm.flight.streams import setpoints
from swarm.flight.tlog import LeftOff, Then
from swarm.flight.trace import Trace
from swarm.mavlink.vehicle import Vehicle
from swarm.mission.fleet import Fleet
from swarm.planning import Phase
from swarm.planning.assembly import begins_aloft
from swarm.planning.clock_limits import clock_limits


def initial_state(setup: Setup, resumption: Resumption) -> FlightState:
    """Return the state of a flight that has not begun, or that is to be resumed in the air."""
    plan, fleet, recorder = setup.plan, setup.fleet, Recorder()
    n, ending = plan.vehicles, resumption.left_off
    tracking = plan.mission.vehicles.tracking if setup.options.corrected else None
    guidance, braking = Guidance(plan.motion), plan.mission.vehicles.braking_acceleration
    starts = guidance.planned(0.0).position
    standing = starts + setup.lift
    team = Team(fleet, lambda *_: None)
    # the order of the vehicles is a guess until their positions are known
    flying = list(team.vehicles.values())[:n]
    placement = Placement(None, np.zeros(n), np.full((n, 3), np.nan))
    if ending is not None:
        flying = [team.vehicles[system] for system in ending.known.systems]
        ground = starts * [1.0, 1.0, 0.0] if begins_aloft(plan) else starts
        placement = Placement(ending.known.frames, ending.known.yaw, ground)
    roster = Roster.of(flying)
    flight = FlightState(
        setup=setup,
        team=team,
        preparation=Preparation(team, fleet, standing, tracking),
        clock=MissionClock(clock_limits(plan.motion, braking)),
        guidance=guidance,
        detectors=Detectors(setup),
        recorder=recorder,
        stream_loss=_stream_loss_of(setup),
        roster=roster,
        placement=placement,
        observation=Observation.of(
            0.0, roster.names, team.telemetry.values, roster.rows, Measured.of(n)
        ),
        streams=Streams.of(n),
        stage=Stage.PREPARE if ending is None else Stage.RESUME,
        resumption=resumption,
    )
    team.report_to(flight.report_of_system)
    return flight


def _stream_loss_of(setup: Setup) -> StreamLossCertificate:
    """Return the certified rates of the clock for lost setpoints, from the plan or computed."""
    fleet = setup.fleet
    model = stream_loss_model([(v.autopilot, {}) for v in fleet.vehicles], fleet.limits)
    return stream_loss_of(setup.flight_plan, model)


class Conductor:
    """Flies a checked plan with a fleet.

    ``now`` is seconds since the flight's record began, in every call. ``state`` is for reading.
    ``flight_plan`` is the plan with what was checked of it, ``basis`` that on which it is flown;
    ``team`` are the vehicles and the links to them.
    """

    def __init__(
        self,
        flight_plan: FlightPlan,
        fleet: Fleet,
        options: FlightOptions = FlightOptions(),  # noqa: B008 - frozen
        *,
        left: LeftOff | None = None,
        then: Then | None = "hold",
    ) -> None:
        """Raise :class:`Refused` where the fleet is too small or the plan must not be flown.

        ``left`` is where a flight broke off that is to be resumed, ``then`` the operator's order
        for after all vehicles have been found. With None they are only searched: see ``found``.
        """
        setup = setup_of(flight_plan, fleet, options)
        self.state = initial_state(setup, Resumption(left, then))
        self.flight_plan, self.plan, self.basis = flight_plan, setup.plan, setup.basis
        self.fleet, self.team, self.clock = fleet, self.state.team, self.state.clock

    @property
    def stage(self) -> Stage:
        """The stage of the flight."""
        return self.state.stage

    @property
    def now(self) -> float:
        """The time of the last tick."""
        return self.state.now

    @property
    def phase(self) -> Phase:
        """The plan's phase at this moment."""
        return self.state.phase

    @property
    def flyers(self) -> Sequence[Vehicle]:
        """The vehicles that fly, in order along the cable."""
        return self.state.roster.vehicles

    @property
    def audit(self) -> Audit | None:
        """The audit of the team on the ground; None before all are ready."""
        return self.state.placement.audit

    @property
    def asked_at(self) -> float | None:
        """Since when screens may give the go before arming; None before."""
        return self.state.go_asked

    @property
    def go_given(self) -> float | None:
        """When a screen gave the go; None before."""
        return self.state.go_given

    @property
    def holding(self) -> str | None:
        """Why the clock is held; None while it is not."""
        return self.state.holds.message

    @property
    def found(self) -> Found | None:
        """Where a team rests that is only searched; None before."""
        return self.state.resumption.found

    @property
    def finished(self) -> Outcome | None:
        """The outcome of the flight; None while it goes on."""
        return self.state.ending.outcome

    @property
    def over(self) -> bool:
        """Whether the flight has ended."""
        return self.state.stage is Stage.FINISHED

    def receive(self, link: str, address: Address | None, data: bytes, now: float) -> bool:
        """Take bytes that arrived on a link from an address; return whether they were read."""
        return self.state.team.receive(link, address, data, now)

    def receive_all(
        self, link: str, arrived: Sequence[tuple[Address | None, bytes]], now: float
    ) -> None:
        """As :meth:`receive`, of bytes from any number of addresses at once, and quicker."""
        self.state.team.receive_all(link, arrived, now)

    def tick(self, now: float, real: float | None = None) -> list[Outgoing]:
        """Let time pass; return the packets to send. Called at the fleet's setpoint rate.

        ``real`` is real time in seconds where ``now`` follows a simulated world.
        """
        flight = self.state
        flight.timing = flight.timing.advanced(
            now,
            now if real is None else real,
            streaming=bool(flight.streams.active.any()) and flight.stage in IN_FLIGHT,
        )
        self._take_stall()
        self._take_reports(now)
        observe(flight)
        stage = flight.stage
        if stage is Stage.EXECUTE:
            follow_swing(flight)
            monitor(flight)
        self._detect()
        _STAGES[stage](flight)
        # setpoints first: all other packets come behind them
        outgoing = setpoints(flight)
        outgoing.extend(flight.team.tick(now))
        record_sample(flight)
        return outgoing

    def _take_stall(self) -> None:
        """Count no time against vehicles in which this program did not run; respond to a stall."""
        flight, timing = self.state, self.state.timing
        longest = max(LONGEST_TICK, 2.0 / self.fleet.rates.setpoint)
        if timing.elapsed > longest:
            flight.team.pause(timing.last, timing.elapsed - longest)
        if timing.streaming:
            for failure in flight.detectors.station.stalled(timing.now, timing.elapsed):
                respond(flight, failure)

    def _take_reports(self, now: float) -> None:
        """Record the events of all vehicles; respond to failures that they report themselves."""
        flight = self.state
        for vehicle in flight.team.vehicles.values():
            for event in vehicle.take_events():
                flies = vehicle.system in flight.roster.numbers
                if not (event.kind == "done" and event.subject.startswith("interval")):
                    spare = "" if flies else f"system {vehicle.system}: "
                    flight.report(event.kind, spare + event.message, vehicle)
                if not flies:
                    continue
                if event.kind == "done" and event.subject in {"grab", "release"}:
                    vehicle.gripped = event.subject == "grab"
                if flight.stage in IN_FLIGHT:
                    k = flight.roster.numbers[vehicle.system] - 1
                    seen, expected = flight.observation, flight.expected
                    for failure in flight.detectors.reports.detect(
                        seen, expected, k, vehicle, event, now
                    ):
                        respond(flight, failure)

    def _detect(self) -> None:
        """Run the detectors in their order, and respond to each one's failures at once."""
        flight = self.state
        if flight.stage not in IN_FLIGHT:
            return
        expected = flight.expected
        for stages, detector in flight.detectors.each_tick:
            if flight.stage in stages:
                findings = detector.detect(flight.observation, expected)
                for finding in findings:
                    respond(flight, finding)
                if findings:
                    expected = flight.expected

    # What the shell calls

    def start(self, cleared: ClearedPlan) -> None:
        """Begin the flight of a cleared plan; raises :class:`Refused` where it is not ready."""
        flight = self.state
        if cleared.flight_plan is not self.flight_plan or flight.stage is not Stage.READY:
            raise Refused("this flight is not ready for that plan")
        if cleared.audit.stream_loss is not None:
            flight.stream_loss = cleared.audit.stream_loss
        flight.change_stage(Trigger.CLEARED)
        flight.report("flight", f"cleared for flight: {self.basis.words}")

    def ground_check(self, words: str) -> None:
        """Show what the ground check does now; "": nothing that takes long."""
        self.state.ground_check = words

    def ask_for_go(self) -> None:
        """Let screens give the go before arming, or refuse it."""
        self.state.go_asked = self.now

    def refuse(self, message: str) -> None:
        """End the flight before it begins: the audit did not pass."""
        self.state.finish("refused", message)

    def give_up(self, message: str) -> None:
        """End the flight in any stage; for shells that cannot go on."""
        self.state.finish("failed", message)

    def request(self, command: Request, author: str = "") -> str:
        """Carry out an operator's command where it is possible; return its effect in words.

        The record names the ``author``. :attr:`Snapshot.available` has the present effect of every
        command.
        """
        return request(self.state, command, author)

    def available(self) -> Mapping[Request, Availability]:
        """Return, for every operator's command, whether it is possible now, and its effect."""
        return available(self.state)

    def report(self, kind: str, message: str) -> None:
        """Add an event of the shell to the record."""
        self.state.report(kind, message)

    def events(self) -> list[Event]:
        """Return the events since the last call."""
        return self.state.recorder.take_events()

    def snapshot(self, now: float) -> Snapshot:
        """Return the flight at this moment."""
        return snapshot_of(self.state, now)

    def statistics(self) -> Statistics:
        """Return the statistics of the flight's links so far."""
        return statistics_of(self.state)

    def trace(self) -> Trace:
        """Return the flown positions so far."""
        return self.state.recorder.trace(self.plan.vehicles, len(self.plan.layout.lengths))


_STAGES: Mapping[Stage, Callable[[FlightState], None]] = {
    Stage.PREPARE: execute.prepare,
    Stage.READY: execute.wait_for_clearance,
    Stage.RESUME: execute.find_team,
    Stage.EXECUTE: execute.tick,
    Stage.CONTINGENCY: contingency.tick,
    Stage.FINISHED: lambda _: None,
}
