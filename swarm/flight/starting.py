"""The state of a flight before its first tick."""

import numpy as np

from swarm.certification.stream_loss import (
    StreamLossCertificate,
    certify_stream_loss,
)
from swarm.flight.clock import MissionClock
from swarm.flight.detect import Detectors
from swarm.flight.estimation import Measured
from swarm.flight.guidance import Guidance
from swarm.flight.observation import observation_of
from swarm.flight.parameters import stream_loss_model
from swarm.flight.preparation import Preparation
from swarm.flight.recorder import Recorder
from swarm.flight.router import Team
from swarm.flight.setup import Setup
from swarm.flight.stages import Stage
from swarm.flight.state import FlightState, Mode, Placement, Resumption, Roster, Streams
from swarm.planning.clock_limits import clock_limits


def initial_state(setup: Setup, resumption: Resumption) -> FlightState:
    """Return the state of a flight that has not begun, or that is to be resumed in the air."""
    plan, fleet, recorder = setup.plan, setup.fleet, Recorder()
    n, left = plan.vehicles, resumption.left_off
    guidance, braking = Guidance(plan.motion), plan.mission.vehicles.braking_acceleration
    starts = guidance.planned(0.0).position
    standing = starts + setup.lift
    team = Team(fleet, lambda *_: None)
    # the order of the vehicles is a guess until their positions are known
    flying = list(team.vehicles.values())[:n]
    placement = Placement(None, np.zeros(n), np.full((n, 3), np.nan))
    if left is not None:
        flying = [team.vehicles[system] for system in left.systems]
        placement = Placement(left.frames, left.yaw, starts)
    roster = Roster.of(flying)
    flight = FlightState(
        setup=setup,
        team=team,
        preparation=Preparation(team, fleet, standing),
        clock=MissionClock(clock_limits(plan.motion, braking)),
        guidance=guidance,
        detectors=Detectors.of(setup),
        recorder=recorder,
        stream_loss=_stream_loss_of(setup),
        roster=roster,
        placement=placement,
        observation=observation_of(
            0.0, roster.names, team.telemetry.values, roster.rows, Measured.of(n)
        ),
        streams=Streams.of(n),
        mode=Mode(Stage.PREPARE if left is None else Stage.RESUME),
        resumption=resumption,
    )
    team.report_to(flight.report_of_system)
    return flight


def _stream_loss_of(setup: Setup) -> StreamLossCertificate:
    """Return the certified rates of the clock for lost setpoints, from the plan or computed."""
    fleet = setup.fleet
    model = stream_loss_model([(v.autopilot, {}) for v in fleet.vehicles], fleet.limits)
    certified = setup.flight_plan.stream_loss
    if certified is not None and certified.holds_for(setup.plan, model):
        return certified
    return certify_stream_loss(setup.plan, model)
