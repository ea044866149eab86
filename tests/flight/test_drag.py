"""The drag of vehicles, fed forward in the accelerations of their setpoints."""

import numpy as np
import pytest

from swarm.errors import InputError
from swarm.flight.trace import Trace
from swarm.mission.fleet import emulated_fleet, parse_fleet
from swarm.simulation.loop import simulate_flight
from tests.network import small_plan

PLAN = small_plan()


def flown(autopilot: str, drag: float) -> Trace:
    fleet = emulated_fleet(3, (autopilot,))
    vehicles = tuple(one.model_copy(update={"drag": drag}) for one in fleet.vehicles)
    return simulate_flight(PLAN, fleet=fleet.model_copy(update={"vehicles": vehicles})).trace


def largest_error(trace: Trace) -> float:
    folding = np.array(trace.phase) == "fold"
    return float(np.nanmax(np.linalg.norm(trace.position - trace.setpoint, axis=2)[folding]))


def test_the_emulated_drag_fed_forward_lowers_the_tracking_error() -> None:
    assert largest_error(flown("px4", 0.2)) < 0.8 * largest_error(flown("px4", 0.0))


def test_an_autopilot_that_adds_no_accelerations_is_sent_none() -> None:
    with_drag, without = flown("ardupilot", 0.2), flown("ardupilot", 0.0)
    np.testing.assert_array_equal(with_drag.position, without.position)


def test_a_drag_is_a_number_of_a_vehicle() -> None:
    text = """
schema: 1
name: two
links: {one: "udpin://127.0.0.1:14550"}
vehicles:
- {sysid: 1, links: [one], drag: -0.1}
- {sysid: 2, links: [one], drag: 3}
"""
    with pytest.raises(InputError) as caught:
        parse_fleet(text, "fleet.yaml")
    assert str(caught.value).splitlines() == [
        "fleet.yaml:6: vehicles.0.drag: expected a number >= 0 in 1/s, got -0.1",
        "fleet.yaml:7: vehicles.1.drag: expected a number <= 2 in 1/s, got 3",
    ]
