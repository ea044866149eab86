"""PX4 and ArduPilot behaviour that a flight must tolerate: slow boots, odd modes, few heartbeats."""

from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from pymavlink.dialects.v20 import common

import sitl.physics.dynamics
from swarm.flight.bench_flight import RAISED, raised
from swarm.flight.conductor import Conductor
from swarm.flight.failures import FailureKind
from swarm.flight.setup import FlightOptions
from swarm.front.files import load_mission
from swarm.mavlink.packets import CURRENT_MODE, Decoder
from swarm.mission.fleet import emulated_fleet
from swarm.planner import plan as plan_mission
from tests.network import Network, small_plan

PLAN = small_plan()
MISSIONS = Path(__file__).parents[2] / "missions"


def network(autopilots, frame="gps", **options) -> Network:
    fleet = emulated_fleet(3, autopilots).model_copy(update={"frame": frame})
    return Network(PLAN, fleet, no_cable=True, **options)


def commands(flight: Network) -> Counter[tuple[int, int]]:
    """How often each command was sent, by second of flight and number."""
    decoder = Decoder()
    messages = [(now, p.message) for now, _, data in flight.sent for p in decoder.feed(data)]
    return Counter(
        (int(now), message.command) for now, message in messages if hasattr(message, "command")
    )


@pytest.mark.slow
@pytest.mark.parametrize("autopilots", [("px4",), ("ardupilot",)], ids="-".join)
def test_vehicles_that_have_flown_fly_again(autopilots):
    """PX4 is back in offboard mode then, in which it cannot be armed without a stream."""
    flight = network(autopilots, frame="pads")
    assert flight.run().word == "done"
    flight.conductor = Conductor(PLAN, flight.fleet, FlightOptions(no_cable=True))
    assert flight.run(most=150.0).word == "done", flight.words()[-8:]


def test_ardupilots_that_boot_are_waited_for_and_not_pestered():
    """No origin and no position for 42 s: it says nothing when it is asked for what it lacks."""
    flight = network(("ardupilot",))
    for vehicle in flight.emulator.vehicles:
        vehicle.reboot()
    flight.run(lambda: flight.conductor.stage == "execute", most=90.0)
    assert flight.now > 42.0
    asked = commands(flight)
    for number in (common.MAV_CMD_REQUEST_MESSAGE, common.MAV_CMD_DO_SET_MODE):
        busiest = max(count for (_, one), count in asked.items() if one == number)
        assert busiest <= 2 * len(flight.conductor.flyers)


def test_a_px4_that_leaves_offboard_is_detected_between_its_heartbeats():
    flight = network(("px4",)).in_fold(2.0)
    victim, since = flight.emulator.vehicles[1], flight.now
    flight.until_time(0.1)
    victim.autopilot.leave_offboard()
    flight.run(lambda: flight.conductor.holding is not None, most=1.0)
    assert flight.now - since < 0.5
    causes = flight.conductor.state.holds.causes
    assert FailureKind.LEFT_OFFBOARD in {cause.failure for cause in causes}


def test_an_older_px4_without_mode_messages_flies_by_its_heartbeats():
    """CURRENT_MODE came with 1.15."""

    def older(_now, _system, data):
        return data[7:10] != CURRENT_MODE.to_bytes(3, "little")

    flight = network(("px4",), downlink=older)
    assert flight.run().word == "done"


def test_a_refused_rate_does_not_end_a_flight():
    flight = network(("px4",)).in_fold(1.0)
    flight.conductor.flyers[0].request_interval(int(common.MAVLINK_MSG_ID_HEARTBEAT), 4.0)
    flight.until_time(2.0)
    assert "interval of HEARTBEAT: failed" in flight.words("failed")
    assert flight.conductor.stage == "execute"
    assert not flight.conductor.holding


def test_receivers_that_jump_about_by_half_a_metre_do_not_end_a_flight():
    """As PX4's simulated one does, which says that it is good to 1.78 m."""
    flight = network(("px4",), frame="pads")
    for vehicle in flight.emulator.vehicles:
        vehicle.gps_noise = 0.5
    assert flight.run().word == "done", flight.words("failure")


def bare(plan=PLAN):
    """Simulated PX4s, which have no gripper: where each stands is its pad."""
    fleet = emulated_fleet(3, ("px4",)).model_copy(update={"frame": "pads", "gripper": "none"})
    return Network(raised(plan, fleet, no_cable=True), fleet, no_cable=True)


def test_vehicles_without_grippers_never_touch_the_ground_on_their_way():
    fleet = emulated_fleet(3).model_copy(update={"gripper": "none"})
    higher = raised(PLAN, fleet, no_cable=True).plan
    speeds = np.abs(PLAN.plan.motion.at(PLAN.plan.motion.times)[1]).max(axis=(1, 2))
    above = np.flatnonzero(speeds < 1e-6)[1]
    before, first = PLAN.plan.motion.times[above], higher.motion.times[above]
    climb, slower = (
        PLAN.plan.motion.at(np.linspace(0.0, before, 100)),
        higher.motion.at(np.linspace(0.0, first, 100)),
    )
    assert np.all(np.diff(slower[0][..., 2], axis=0) >= -1e-9)
    assert slower[0][..., :2] == pytest.approx(climb[0][..., :2])
    for faster, less in zip(climb[1:], slower[1:], strict=True):
        assert np.abs(less).max() <= np.abs(faster).max() + 1e-9
    times = np.linspace(before, PLAN.plan.duration, 400)
    one, other = PLAN.plan.motion.at(times), higher.motion.at(times + (first - before))
    up = other[0] - one[0]
    assert up[..., 2] == pytest.approx(RAISED)
    assert up[..., :2] == pytest.approx(0.0, abs=1e-9)
    for after, before_it in zip(other[1:], one[1:], strict=True):
        assert after == pytest.approx(before_it, abs=1e-9)
    for kind in ("phases", "gates"):
        assert len(getattr(higher, kind)) == len(getattr(PLAN.plan, kind))
    assert higher.phases[-1].end == higher.duration == pytest.approx(times[-1] + first - before)
    with_grippers = emulated_fleet(3)
    assert raised(PLAN, with_grippers, no_cable=True) is PLAN
    assert raised(PLAN, fleet, no_cable=False) is PLAN


def test_the_recommended_first_steps_fly_without_cable():
    mission = load_mission(str(MISSIONS / "first-steps" / "two_carry.yaml"))
    planned = plan_mission(mission, robustness=False).certified()
    fleet = emulated_fleet(2).model_copy(update={"gripper": "none"})
    assert raised(planned, fleet, no_cable=True).plan is not planned.plan


def test_a_team_that_wanders_as_simulated_ones_do_flies_to_the_end(monkeypatch):
    """PX4's own simulator hovers within 0.1 to 0.5 m, more than any cable would bear."""
    monkeypatch.setattr(sitl.physics.dynamics, "NOISE_SIGMA", np.full(3, 0.1))
    flight = bare()
    for vehicle in flight.emulator.vehicles:
        vehicle.gps_noise = 0.5
    assert flight.run().word == "done", flight.words("failure")
    trace = flight.conductor.trace()
    error = np.linalg.norm(trace.position - trace.setpoint, axis=2)
    assert np.nanmax(error) > 2 * PLAN.plan.mission.vehicles.tracking


@pytest.mark.slow
@pytest.mark.parametrize(("speed", "word"), [(5.0, None), (1.0, "failed")])
def test_programs_start_in_real_time_however_fast_flight_time_runs(speed, word):
    """After 100 s of flight time 20 s have passed at five times real time: not too late."""
    flight = network(("px4",), downlink=lambda now, *_: now > 100.0)
    flight.speed = speed
    flight.run(lambda: flight.conductor.stage == "execute", most=120.0)
    assert (flight.conductor.finished and flight.conductor.finished.word) == word
