"""The conductor: one mission clock for the team, from the first heartbeat to the last disarm.

Sans-IO: bytes in (:meth:`Conductor.receive`), time in and bytes out (:meth:`Conductor.tick`). The
same conductor flies emulated vehicles in virtual time and vehicles on real links. At every tick it
observes, detects, decides and acts; the state is in :mod:`swarm.flight.state`, its stages in
:mod:`swarm.flight.stages`, the responses to failures in :mod:`swarm.flight.policy`.
"""

from collections.abc import Callable, Mapping, Sequence

from swarm.errors import Refused
from swarm.flight.clearance import ClearedPlan
from swarm.flight.detect import IN_FLIGHT
from swarm.flight.ending import conclude, finish
from swarm.flight.flight_plan import FlightPlan
from swarm.flight.flight_view import FlightView
from swarm.flight.modes import contingency, execute
from swarm.flight.modes.prepare import prepare, wait_for_clearance
from swarm.flight.modes.resume import find_team
from swarm.flight.modes.transitions import change_stage
from swarm.flight.observing import follow_swing, monitor, observe
from swarm.flight.operator import Availability, Request, available, request
from swarm.flight.reporting import record_sample, snapshot_of, statistics_of
from swarm.flight.responding import respond
from swarm.flight.result import Statistics
from swarm.flight.resuming import LeftOff, Then
from swarm.flight.router import Address, Outgoing
from swarm.flight.setup import Options, setup_of
from swarm.flight.snapshot import Event, Snapshot
from swarm.flight.stages import Stage, Trigger
from swarm.flight.starting import initial_state
from swarm.flight.state import LONGEST_TICK, FlightState, Resumption
from swarm.flight.streams import setpoints
from swarm.flight.trace import Trace
from swarm.mission.fleet import Fleet


class Conductor(FlightView):
    """Flies a checked plan with a fleet.

    ``now`` is seconds since the flight's record began, in every call. ``state`` is for reading;
    each of its parts is replaced by one module of this package alone.
    """

    def __init__(
        self,
        flight_plan: FlightPlan,
        fleet: Fleet,
        options: Options = Options(),  # noqa: B008 - frozen
        *,
        left: LeftOff | None = None,
        then: Then = "hold",
    ) -> None:
        """Raise :class:`Refused` where the fleet is too small or the plan must not be flown.

        ``left`` is where a flight broke off that is to be resumed, ``then`` the operator's order
        for after all vehicles have been found.
        """
        setup = setup_of(flight_plan, fleet, options)
        self.state = initial_state(setup, Resumption(left, then))

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
        _MODES[stage](flight)
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
        for stages, detector in flight.detectors.each_tick():
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
        change_stage(flight, Trigger.CLEARED)
        flight.report("flight", f"cleared for flight: {self.basis.words}")

    def refuse(self, message: str) -> None:
        """End the flight before it begins: the audit did not pass."""
        finish(self.state, "refused", message)

    def give_up(self, message: str) -> None:
        """End the flight in any stage; for shells that cannot go on."""
        finish(self.state, "failed", message)

    def request(self, command: Request) -> str:
        """Carry out an operator's command where it is possible; return its effect in words.

        :attr:`Snapshot.available` has the present effect of every command.
        """
        return request(self.state, command)

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


def _leave(flight: FlightState) -> None:
    if contingency.tick(flight) and flight.stage is Stage.CONTINGENCY:
        conclude(flight)


_MODES: Mapping[Stage, Callable[[FlightState], None]] = {
    Stage.PREPARE: prepare,
    Stage.READY: wait_for_clearance,
    Stage.RESUME: find_team,
    Stage.EXECUTE: execute.tick,
    Stage.CONTINGENCY: _leave,
    Stage.FINISHED: lambda _: None,
}
