"""The drag of vehicles, fed forward in the accelerations of their setpoints."""

from functools import cache

import numpy as np
import pytest

from swarm.errors import InputError
from swarm.flight.failures import Latch
from swarm.flight.grip_slip import GripSlipDetector
from swarm.flight.streams import against_drag
from swarm.flight.trace import Trace
from swarm.geometry.catenary import STANDARD_GRAVITY
from swarm.mission.fleet import emulated_fleet, parse_fleet
from swarm.simulation.loop import simulate_flight
from tests.network import Network, small_plan
from tests.overhand import planned_overhand

PLAN = small_plan()


@cache
def flown(autopilot: str, drag: float) -> Trace:
    fleet = emulated_fleet(3, (autopilot,))
    vehicles = tuple(one.model_copy(update={"drag": drag}) for one in fleet.vehicles)
    return simulate_flight(PLAN, fleet=fleet.model_copy(update={"vehicles": vehicles})).trace


def largest_error(trace: Trace) -> float:
    folding = np.array(trace.phase) == "fold"
    return float(np.nanmax(np.linalg.norm(trace.position - trace.setpoint, axis=2)[folding]))


def mean_error(trace: Trace) -> float:
    """Root mean square in the fold."""
    folding = np.array(trace.phase) == "fold"
    errors = np.linalg.norm(trace.position - trace.setpoint, axis=2)[folding]
    return float(np.sqrt(np.nanmean(errors**2)))


@pytest.mark.slow
def test_the_emulated_drag_fed_forward_lowers_the_tracking_error() -> None:
    assert largest_error(flown("px4", 0.2)) < 0.8 * largest_error(flown("px4", 0.0))


@pytest.mark.slow
def test_the_drag_is_fitted_in_flight_where_the_fleet_file_has_none() -> None:
    """The emulated vehicles have 0.2 1/s, which the fleet file does not state."""
    plan, fleet = planned_overhand().certified(), emulated_fleet(9)
    result = simulate_flight(plan, fleet=fleet)
    (fitted,) = [event.message for event in result.events if event.kind == "drag"]
    words, _, value = fitted.removesuffix(" 1/s").rpartition(" ")
    assert words == "the vehicles' drag, fitted in this flight:"
    assert 0.17 < float(value) < 0.22
    vehicles = tuple(one.model_copy(update={"drag": 0.0}) for one in fleet.vehicles)
    without = simulate_flight(plan, fleet=fleet.model_copy(update={"vehicles": vehicles}))
    assert mean_error(result.trace) < 0.75 * mean_error(without.trace)


def fit(detector: GripSlipDetector, vehicles: int, drag: float) -> None:
    """Let vehicles in a row move apart and together, leaning by their drag."""
    grips = np.array([[2.5 * k, 0.0, 5.0] for k in range(vehicles)])
    apart, attitude = np.zeros((vehicles, 3)), np.zeros((vehicles, 3))
    apart[[0, -1], 1] = 0.3, -0.3
    for k in range(100):
        velocity = apart * np.sign(np.sin(0.05 * k)) * (k > 9)
        attitude[:, 1] = -np.arctan(drag * velocity[:, 1] / STANDARD_GRAVITY)
        now = 1000.0 + 0.25 * k
        detector.evaluate(np.full(len(grips), now), attitude, velocity, grips)


@pytest.mark.parametrize("drag", [0.0, 0.2, 0.55, 3.0])
def test_the_fitted_drag_is_that_of_the_vehicles_up_to_a_limit(drag: float) -> None:
    """3 1/s would be a wrong model."""
    detector = GripSlipDetector(PLAN.plan, Latch(), enabled=True)
    assert detector.drag == 0.0
    fit(detector, 3, drag)
    assert detector.drag == pytest.approx(min(drag, 0.6), abs=0.05)


@pytest.mark.parametrize("wrong", ["attitude", "velocity", "grips"])
def test_nan_does_not_reach_the_fit(wrong: str) -> None:
    """A thrust that points sideways has no lean; setpoints depend on the fitted drag."""
    detector = GripSlipDetector(PLAN.plan, Latch(), enabled=True)
    values = {
        "attitude": np.zeros((3, 3)),
        "velocity": np.array([[0.0, 0.3, 0.0], [0.0, 0.0, 0.0], [0.0, -0.3, 0.0]]),
        "grips": np.array([[2.5 * k, 0.0, 5.0] for k in range(3)]),
    }
    values["attitude"][:, 1] = -np.arctan(0.2 * values["velocity"][:, 1] / STANDARD_GRAVITY)
    bad = values[wrong].copy()
    bad[0, 0] = np.pi / 2.0 if wrong == "attitude" else np.nan
    for k in range(60):
        sample = {**values, wrong: bad} if k == 20 else values
        detector.evaluate(np.full(3, 0.25 * k), *sample.values())
        assert np.isfinite(detector.drag)


@pytest.mark.slow
def test_a_drag_of_the_fleet_file_counts_instead_of_the_fitted_one() -> None:
    fleet = emulated_fleet(4, ("px4", "px4", "px4", "ardupilot"))
    drags = (None, 0.0, 0.5, 0.5)
    vehicles = tuple(
        one.model_copy(update={"drag": drag})
        for one, drag in zip(fleet.vehicles, drags, strict=True)
    )
    network = Network(
        small_plan(vehicles=4), fleet.model_copy(update={"vehicles": vehicles})
    ).in_fold(3.0)
    flight = network.conductor.state
    fit(flight.detectors.grip_slip, 4, 0.2)
    fitted = flight.detectors.grip_slip.drag
    assert fitted == pytest.approx(0.2, abs=0.05)
    state = flight.guidance.state(flight.clock, flight.timing.moving)
    adds = np.array([True, True, True, False])
    found = against_drag(flight, state, adds) - state.acceleration
    order = [flight.roster.systems.index(one.sysid) for one in vehicles]
    assert np.abs(state.velocity[:, :2]).max(axis=1).min() > 0.05
    for k, expected in zip(order, (fitted, 0.0, 0.5, 0.0), strict=True):
        assert found[k] == pytest.approx(expected * state.velocity[k] * [1, 1, 0])


@pytest.mark.slow
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
