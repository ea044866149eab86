"""Whatever happens, in any order: what a flight never does, and that it always ends.

Faults, losses, false reports and operators' commands come at any time of a whole flight; every
packet that goes out is read, and every tick's state is compared with the plan.
"""

from copy import copy
from functools import cache

import numpy as np
import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, rule, run_state_machine_as_test
from pymavlink.dialects.v20 import common

from swarm.flight.contingency import GIVE_UP
from swarm.flight.failures import FailureKind, Response
from swarm.flight.requests import REQUESTS
from swarm.flight.separation import AWAY
from swarm.flight.stages import STEP_TRANSITIONS, TRANSITIONS, Stage, Step
from swarm.mavlink.packets import Decoder, Encoder
from swarm.simulation.failure_cases import FAILURE_CASES
from swarm.simulation.loop import LINK, Fault
from swarm.simulation.stepped_simulation import (
    HOLD,
    SteppedSimulation,
    failure_test_fleet,
)
from tests.network import small_plan

PLAN = small_plan(vehicles=3)
VEHICLES = PLAN.plan.mission.vehicles
MOMENTS = ("takeoff", "grab", "lift", "fold", "finish", "land")
FAULTS = [case.fault for case in FAILURE_CASES if case.fault and case.fault["kind"] != "snag"]
BLEND_SPEED = 0.6
"""m/s that a blend into the plan adds at most, at its fastest: 1.875 times its mean of 0.3."""
LAND_WITHIN = HOLD + GIVE_UP + HOLD + 1.0
"""Seconds in which a team that leaves its plan is down: it comes to rest within T, and gives up
waiting for vehicles GIVE_UP + T after that."""
KILL = 21196.0


class Watched(SteppedSimulation):
    """A flight whose every packet and every tick is checked."""

    def begin(self):
        """Begin to check."""
        self.decoder, self.killed = Decoder(), False
        self.left_plan, self.failures = False, set()
        self.joined = set(range(3))
        self.before = copy(self.state.streams)

    @property
    def state(self):
        return self.conductor.state

    def step(self):
        """One step, checked."""
        self.ticks += 1
        flight, now = self.state, self.now
        was, mission_time = flight.stage, flight.clock.time
        step = flight.contingency.step if flight.contingency else None
        for system, data in self.emulator.step(now):
            self.conductor.receive(LINK, system, data, now)
        for outgoing in self.conductor.tick(now):
            self.check_packet(outgoing)
            self.emulator.receive(outgoing.address, outgoing.data, now)
        self.check_stage(was, step, mission_time)
        self.check_setpoints()
        self.check_failures()

    def check_packet(self, outgoing):
        vehicle = self.state.team.vehicles[outgoing.address]
        for packet in self.decoder.feed(outgoing.data):
            message = packet.message
            if packet.number == common.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED:
                speed = np.linalg.norm([message.vx, message.vy, message.vz])
                assert np.isfinite([message.x, message.y, message.z, speed]).all()
                assert speed <= VEHICLES.max_speed + BLEND_SPEED
            if packet.number != common.MAVLINK_MSG_ID_COMMAND_LONG:
                continue
            assert not vehicle.commands.idle, "its answer is awaited"
            assert message.command != common.MAV_CMD_NAV_RETURN_TO_LAUNCH
            if message.command == common.MAV_CMD_DO_SET_MODE:
                modes = {vehicle.autopilot.modes[name] for name in ("offboard", "land", "hold")}
                assert (int(message.param2), int(message.param3)) in modes
            if message.command == common.MAV_CMD_COMPONENT_ARM_DISARM:
                assert message.param2 in ({0.0, KILL} if self.killed else {0.0})
                assert message.param1 == 0.0 or message.param2 == 0.0, "armed by force"

    def check_stage(self, was, step, mission_time):
        flight = self.state
        # a tick may pass through two transitions: reports first, then detectors
        once = set(TRANSITIONS[was].values())
        twice = {after for stage in once for after in TRANSITIONS[stage].values()}
        assert flight.stage in {was} | once | twice
        self.left_plan |= flight.stage in {Stage.CONTINGENCY, Stage.FINISHED}
        if self.left_plan:
            assert flight.stage is not Stage.EXECUTE
        if flight.contingency is not None and step is not None:
            reachable = {step}
            for _ in range(3):
                reachable |= {x for s in reachable for x in STEP_TRANSITIONS[s].values()}
            assert flight.contingency.step in reachable
        if step in {Step.SEPARATE, Step.DESCEND}:
            assert flight.clock.time == mission_time, "the plan goes on after it was left"

    def check_setpoints(self):
        flight, before = self.state, self.before
        streams, plan = flight.streams, PLAN.plan
        self.before = copy(streams)
        self.joined |= set(streams.rejoining)
        if flight.stage is Stage.EXECUTE:
            planned = plan.motion.at(flight.clock.time)[0]
            off = np.linalg.norm(streams.setpoint - planned, axis=1)
            # a vehicle is blended in from its own place
            inside = [k for k in range(3) if k not in self.joined]
            assert (off[inside] < 1e-6).all(), "out of the plan's tube"
        if flight.stage in {Stage.EXECUTE, Stage.CONTINGENCY} and not streams.rejoining:
            moved = np.linalg.norm(streams.setpoint - before.setpoint, axis=1)
            fastest = (VEHICLES.max_speed + BLEND_SPEED) / self.fleet.rates.setpoint
            # beside a vehicle that flies without setpoints, its kept place becomes where it is
            sent = streams.active & before.active
            assert not (moved[sent] > fastest + 1e-6).any(), "a setpoint jumps"
            assert (streams.setpoint[:, 2] < plan.mission.workspace.ceiling).all()

    def check_failures(self):
        flight = self.state
        events = self.conductor.events()
        self.events += events
        for event in events:
            if event.kind == "failure":
                self.failures.add(FailureKind(event.message.partition(":")[0]))
        irreversible = {kind for kind in self.failures if kind.responses.irreversible}
        assert bool(irreversible) <= (flight.ending.failure is not None)
        beyond_hold = {k for k in self.failures if k.responses.execute is not Response.HOLD}
        if beyond_hold:
            assert flight.stage in {Stage.CONTINGENCY, Stage.FINISHED}, "the flight goes on"
        if flight.ending.outcome is not None and flight.ending.failure is not None:
            assert flight.ending.outcome.word == "failed"


@cache
def moment(team, phase):
    """A flight shortly after a phase of its plan has begun."""
    flight = Watched.create(PLAN, failure_test_fleet(3, team, 1), 1)
    flight.begin()
    start = PLAN.plan.phase(phase).start
    while flight.conductor.clock.time < start + 0.3 or not flight.can_be_copied:
        SteppedSimulation.step(flight)
    flight.begin()
    return flight


class Flights(RuleBasedStateMachine):
    """One flight, and what may happen to it."""

    @initialize(team=st.sampled_from(("px4", "ardupilot", "mixed")), phase=st.sampled_from(MOMENTS))
    def take_off(self, team, phase):
        self.flight = moment(team, phase).copy()
        self.encoders = {system: Encoder(system, 1) for system in (1, 2, 3)}

    def fly(self, seconds):
        end = self.flight.now + seconds
        while self.flight.now < end and self.flight.conductor.finished is None:
            self.flight.step()

    @rule(seconds=st.sampled_from((0.05, 0.5, 2.0, 8.0)))
    def time_passes(self, seconds):
        self.fly(seconds)

    @rule(values=st.sampled_from(FAULTS), system=st.sampled_from((1, 2, 3, "all")))
    def fault(self, values, system):
        world = values["kind"] == "wind"
        extra = {"steady": (4.0, 0.0, 0.0)} if world else {"vehicle": system}
        at = {"at": self.flight.now}
        self.flight.emulator.inject(Fault.model_validate({**at, **extra, **values}))
        self.fly(0.2)

    @rule(
        loss=st.sampled_from((0.3, 1.0)),
        direction=st.sampled_from(("up", "down", "both")),
        duration=st.sampled_from((0.4, 1.5, 6.0)),
        system=st.sampled_from((1, 2, 3, "all")),
    )
    def losses(self, loss, direction, duration, system):
        fault = {"kind": "link", "loss": loss, "direction": direction, "duration": duration}
        at = {"at": self.flight.now, "vehicle": system}
        self.flight.emulator.inject(Fault.model_validate({**at, **fault}))

    @rule(request=st.sampled_from(REQUESTS))
    def operator(self, request):
        open_ = dict(self.flight.conductor.snapshot(self.flight.now).available)[request][0]
        self.flight.killed |= request == "kill" and open_
        self.flight.conductor.request(request)

    @rule(
        system=st.sampled_from((1, 2, 3)),
        command=st.sampled_from((176, 211, 400, 511, 22)),
        result=st.integers(0, 6),
    )
    def false_answer(self, system, command, result):
        self.send(system, common.MAVLink_command_ack_message(command, result))

    @rule(system=st.sampled_from((1, 2, 3)), landed=st.integers(0, 4))
    def false_landing(self, system, landed):
        self.send(system, common.MAVLink_extended_sys_state_message(0, landed))

    def send(self, system, message):
        data = self.encoders[system].encode(message)
        self.flight.conductor.receive(LINK, system, data, self.flight.now)

    def teardown(self):
        flight = getattr(self, "flight", None)
        if flight is None:
            return
        flight.conductor.request("land")
        self.fly(LAND_WITHIN)
        assert flight.conductor.finished is not None, flight.events[-8:]
        sent = flight.conductor.tick(flight.now + 1.0)
        assert not any(len(one.data) > 60 for one in sent), "no setpoints after the end"


def test_the_others_move_apart_from_where_a_pilot_has_taken_a_vehicle():
    """Found at random: its kept place becomes its own position, and no setpoint of it is sent."""
    flights = Flights()
    flights.take_off(team="px4", phase="fold")
    flights.fault(system=1, values={"kind": "gps_loss"})
    flights.fault(system=1, values={"kind": "pilot"})
    before = flights.flight.state.streams.setpoint
    flights.time_passes(seconds=2.0)
    streams = flights.flight.state.streams
    assert np.linalg.norm(streams.setpoint[0] - before[0]) > 0.2
    assert streams.active.tolist() == [False, True, True]
    flights.teardown()


def test_a_vehicle_without_a_fix_lands_when_the_others_are_out_of_its_way():
    """An ordinary stop takes 8 s: the team that releases stops urgently, and moves away at once,
    before dead reckoning ends after 5 s."""
    flights = Flights()
    flights.take_off(team="px4", phase="fold")
    flights.fault(system=2, values={"kind": "gps_loss"})
    flight = flights.flight
    state = flight.state
    while state.contingency is None or state.contingency.step.name != "SEPARATE":
        flight.step()
    assert flight.now - state.contingency.since < 2.0
    place = state.streams.setpoint[:, :2].copy()
    before = np.linalg.norm(place - place[1], axis=1)[[0, 2]]
    while state.streams.active[1]:
        flight.step()
    moved = np.linalg.norm(state.streams.setpoint[:, :2] - place[1], axis=1)[[0, 2]] - before
    assert state.contingency.step.name == "SEPARATE"
    assert (moved > 0.9 * AWAY).all(), moved
    flights.teardown()


QUICK = settings(
    max_examples=20,
    stateful_step_count=8,
    deadline=None,
    derandomize=True,
    suppress_health_check=list(HealthCheck),
)


@pytest.mark.slow
def test_a_flight_stays_safe_and_ends_whatever_happens():
    run_state_machine_as_test(Flights, settings=QUICK)


@pytest.mark.full
def test_many_flights_stay_safe_and_end_whatever_happens():
    many = settings(QUICK, max_examples=400, stateful_step_count=15, derandomize=False)
    run_state_machine_as_test(Flights, settings=many)
