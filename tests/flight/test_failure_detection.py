"""Detection of failures in whole flights, at any order and timing of the reports."""

import re

import pytest

from sitl.faults import Fault
from swarm.flight.setup import FlightOptions
from swarm.mission.fleet import emulated_fleet
from swarm.simulation.loop import simulate_flight
from swarm.simulation.stepped_simulation import (
    SteppedSimulation,
    failure_test_fleet,
)
from tests.network import Network, small_plan, uncleared

PLAN = small_plan()
TOO_NEAR = uncleared("clearance.vehicle=3.5")


@pytest.mark.parametrize("early", [0.0, 0.013], ids=["in step", "between ticks"])
def test_a_position_jump_is_detected_at_any_time_of_its_report(early):
    flight = Network(PLAN, early=early).in_fold(1.0)
    flight.emulator.inject(Fault(at=0.0, kind="gps_jump", vehicle=2, offset=(2.0, 0.0, 0.0)))
    flight.run(lambda: flight.conductor.stage == "contingency", most=5.0)
    assert any("vehicle 2's position jumped by 2.0 m" in words for words in flight.words())


def test_a_clock_at_standstill_for_lack_of_clearance_is_reported_and_ends_in_landing():
    fleet = emulated_fleet(3)
    fleet = fleet.model_copy(update={"limits": fleet.limits.model_copy(update={"hold": 4.0})})
    result = simulate_flight(TOO_NEAR, fleet=fleet)
    said = [event.message for event in result.events if event.kind == "failure"]
    assert said[0].startswith("standstill: no clearance remains (vehicle clearance: margin -")
    (apart,) = re.findall(r"vehicles ([0-9.]+) m apart", said[0])
    assert float(apart) == pytest.approx(3.0, abs=0.1)
    assert said[1].startswith("hold timeout: on hold for 4 s")
    assert result.outcome.word == "interrupted"
    assert result.statistics.duration < 90.0


def test_an_open_loop_flight_keeps_its_pace():
    result = simulate_flight(TOO_NEAR, options=FlightOptions(open_loop=True))
    assert result.outcome.word == "done"
    assert not [event for event in result.events if event.kind in {"failure", "hold"}]


def test_a_vehicle_that_a_fallen_neighbour_pulls_down_for_a_moment_stays_in_the_team():
    flight = Network(PLAN).in_fold(3.0)
    began, (_, fallen, pulled) = flight.now, (one.system for one in flight.conductor.flyers)
    faults = (
        {"at": began, "vehicle": fallen, "kind": "motor_loss"},
        {
            "at": began + 0.3, "vehicle": pulled, "kind": "weak_thrust", "fraction": 0.3,
            "duration": 1.0,
        },
    )  # fmt: skip
    for fault in faults:
        flight.emulator.inject(Fault.model_validate(fault))
    lowest = 0.0
    while flight.conductor.finished is None:
        flight.once()
        if flight.now < began + 2.0:
            lowest = min(lowest, flight.conductor.state.observation.velocity[2, 2])
    assert lowest < -1.5  # it sank faster than a vehicle that follows ever does
    failures = [event for event in flight.events if event.kind == "failure"]
    assert {event.vehicle for event in failures} == {2}
    assert failures[0].message.startswith("falling: vehicle 2 falls")
    assert flight.conductor.finished.explanation == failures[0].message.removeprefix("falling: ")
    assert not flight.emulator.truth().gripped.any()
    assert flight.emulator.bodies.crashed.tolist() == [False, True, False]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("autopilot", "seconds"),
    [("ardupilot", 0.4), ("ardupilot", 1.0), ("ardupilot", 3.0), ("px4", 1.0)],
)
def test_a_stall_of_the_ground_station_is_its_own_failure_and_no_silence_of_vehicles(
    autopilot, seconds
):
    """A PX4 has left offboard mode by then; what vehicles sent meanwhile is still read."""
    stalls = SteppedSimulation.create(PLAN, failure_test_fleet(3, autopilot), 1)
    while stalls.conductor.clock.time < PLAN.plan.phase("fold").start + 3.0:
        stalls.step()
    stalls.events.clear()
    began = stalls.now
    while stalls.now < began + seconds:
        stalls.step(station=False)
    while stalls.now < began + seconds + 15.0 and stalls.conductor.finished is None:
        stalls.step()
    failures = [event for event in stalls.events if event.kind == "failure"]
    assert not any("silent" in event.message or "link" in event.message for event in failures)
    gap, at = stalls.conductor.statistics().gap
    assert (gap, at) == (pytest.approx(seconds + 0.05), pytest.approx(began))
    if seconds <= 0.5:
        assert failures == []
        return
    words = f"the ground station stood still for {gap:.1f} s and sent no setpoint"
    assert failures[0].message == f"ground station stalled: {words}"
    assert failures[0].vehicle is None
    if stalls.conductor.state.ending.failure is not None:
        assert stalls.conductor.state.ending.failure.startswith(words)
        return
    follow = "all vehicles follow the setpoints again" in [one.message for one in stalls.events]
    assert (follow, bool(stalls.conductor.holding)) == (
        autopilot == "ardupilot",
        autopilot == "px4",
    )


def test_a_vehicle_that_is_silent_before_a_stall_is_still_found_silent():
    """Also where the ground station stalls again and again: only the time that it runs counts."""
    flight = Network(PLAN).in_fold(3.0)
    began, silent = flight.now, flight.conductor.flyers[1].system
    flight.downlink = lambda _now, system, _data: system != silent
    while not flight.words("failure"):
        flight.once()
        if flight._tick % 4 == 0:
            flight._tick += 8
            flight.emulator.step(flight._tick * flight.step)
        assert flight.now < began + 5.0
    assert flight.words("failure") == ["silent: vehicle 2 has been silent for 0.7 s"]
    assert flight.now > began + 1.0
