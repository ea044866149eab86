"""Detection of failures in whole flights, at any order and timing of the reports."""

import re

import pytest

from sitl.faults.scenario import Fault
from swarm.flight.setup import Options
from swarm.mission.fleet import emulated_fleet
from swarm.simulation.loop import simulate_flight
from tests.network import Network, small_plan, uncleared

PLAN = small_plan()
TOO_NEAR = uncleared("clearance.vehicle=3.5")


@pytest.mark.parametrize("early", [0.0, 0.013], ids=["in step", "between ticks"])
def test_a_position_jump_is_detected_at_any_time_of_its_report(early):
    flight = Network(PLAN, early=early)
    flight.until_phase("fold", 1.0)
    flight.emulator.inject(Fault(at=0.0, kind="gps_jump", vehicle=2, offset=(2.0, 0.0, 0.0)))
    flight.run(lambda: flight.conductor.stage == "contingency", most=5.0)
    assert any("vehicle 2's position jumped by 2.0 m" in words for words in flight.words())


def test_a_clock_at_standstill_for_lack_of_clearance_is_reported_and_ends_in_landing():
    fleet = emulated_fleet(3)
    fleet = fleet.model_copy(update={"limits": fleet.limits.model_copy(update={"hold": 4.0})})
    result = simulate_flight(TOO_NEAR, fleet=fleet)
    said = [event.message for event in result.events if event.kind == "failure"]
    assert said[0].startswith("standstill: no clearance remains (strands ")
    (apart,) = re.findall(r"vehicles ([0-9.]+) m apart", said[0])
    assert float(apart) == pytest.approx(3.0, abs=0.1)
    assert said[1].startswith("hold timeout: on hold for 4 s")
    assert result.outcome.word == "interrupted"
    assert result.statistics.duration < 90.0


def test_an_open_loop_flight_keeps_its_pace():
    result = simulate_flight(TOO_NEAR, options=Options(open_loop=True))
    assert result.outcome.word == "done"
    assert not [event for event in result.events if event.kind in {"failure", "hold"}]
