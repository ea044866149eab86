"""A read-only view of a flight, for shells and displays."""

from collections.abc import Sequence

from swarm.certification.stream_loss import StreamLossCertificate
from swarm.flight.clearance import Audit
from swarm.flight.clock import MissionClock
from swarm.flight.flight_plan import Basis, FlightPlan
from swarm.flight.result import Outcome
from swarm.flight.router import Team
from swarm.flight.stages import Stage
from swarm.flight.state import FlightState
from swarm.mavlink.vehicle import Vehicle
from swarm.mission.fleet import Fleet
from swarm.planning import Phase, Plan


class FlightView:
    """The values of a flight's ``state`` that shells read."""

    state: FlightState

    @property
    def flight_plan(self) -> FlightPlan:
        """The plan, with what was checked of it."""
        return self.state.setup.flight_plan

    @property
    def plan(self) -> Plan:
        """The plan."""
        return self.state.setup.plan

    @property
    def fleet(self) -> Fleet:
        """The fleet."""
        return self.state.setup.fleet

    @property
    def basis(self) -> Basis:
        """The basis on which the plan is flown."""
        return self.state.setup.basis

    @property
    def stream_loss(self) -> StreamLossCertificate:
        """The largest rates of the clock for lost setpoints."""
        return self.state.stream_loss

    @property
    def team(self) -> Team:
        """The vehicles and the links to them."""
        return self.state.team

    @property
    def waiting(self) -> bool:
        """Whether the clock waits at a gate."""
        return self.state.progress.waiting

    @property
    def stage(self) -> Stage:
        """The stage of the flight."""
        return self.state.stage

    @property
    def now(self) -> float:
        """The time of the last tick."""
        return self.state.now

    @property
    def clock(self) -> MissionClock:
        """The mission clock."""
        return self.state.clock

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
    def holding(self) -> str | None:
        """Why the clock is held; None while it is not."""
        return self.state.holds.message

    @property
    def finished(self) -> Outcome | None:
        """The outcome of the flight; None while it goes on."""
        return self.state.ending.outcome

    @property
    def over(self) -> bool:
        """Whether the flight has ended."""
        return self.state.stage is Stage.FINISHED
