"""The test hop: vehicles that hover badly are measured, and land where they are too bad."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from swarm.errors import Refused
from swarm.flight.bench_flight import (
    ERROR_LIMIT,
    HOVER,
    SPREAD,
    hop,
    hover_findings,
    hovers,
    tracking_to_plan_with,
)
from swarm.flight.result import FlightResult
from swarm.flight.setup import FlightOptions
from swarm.flight.trace import Trace
from swarm.flight.world import emulated_world
from swarm.mission.fleet import emulated_fleet
from swarm.simulation.loop import Callbacks, StepCallback, simulate_flight
from tests.network import small_plan, uncleared

PLAN = small_plan(vehicles=9)
LIKE_SIH = 0.6
"""m/s² of disturbance with which emulated PX4 vehicles hover as nine of 1.16 were recorded to."""

OPTIONS = FlightOptions(no_cable=True, error_limit=ERROR_LIMIT)


def flown(
    disturbance: float, autopilot: str = "px4", on_step: StepCallback | None = None
) -> FlightResult:
    """A hop of nine vehicles whose controllers have to reject random accelerations, and whose
    receivers are as noisy as SIH's."""
    plan, fleet = hop(PLAN), emulated_fleet(9, (autopilot,))
    world = emulated_world(plan.plan, fleet, with_cable=False, seed=1)
    for vehicle in world["vehicles"]:
        vehicle |= {"disturbance": disturbance, "gps_noise": 0.5 if disturbance else 0.0}
    return simulate_flight(
        plan, fleet=fleet, world=world, options=OPTIONS, callbacks=Callbacks(on_step=on_step)
    )


def apart(trace: Trace) -> float:
    """Smallest level distance between any two vehicles of a trace."""
    first, second = np.triu_indices(trace.position.shape[1], 1)
    level = trace.position[:, first, :2] - trace.position[:, second, :2]
    return float(np.nanmin(np.linalg.norm(level, axis=2)))


@pytest.mark.slow
@pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
def test_vehicles_that_wander_are_measured_for_the_whole_time(autopilot: str) -> None:
    result = flown(LIKE_SIH, autopilot)
    assert result.outcome.word == "done", result.outcome.explanation
    assert not [event for event in result.events if event.kind in {"hold", "failure"}]
    measured = hovers(result.trace)
    assert [one.vehicle for one in measured] == list(range(1, 10))
    assert all(HOVER - 0.3 <= one.seconds <= HOVER + 0.3 for one in measured)
    needed = tracking_to_plan_with(measured, len(measured))
    assert needed is not None
    assert needed >= max(one.both.largest for one in measured) > 0.5
    advice, *each = hover_findings(result.trace, PLAN)
    assert advice.severity == "error"
    assert f"plan with vehicles.tracking of {needed:.2f} m at least" in advice.message
    assert [finding.message.split(":")[0] for finding in each] == [
        f"vehicle {number}" for number in range(1, 10)
    ]


def test_the_emulator_wanders_as_px4_was_recorded_to() -> None:
    """Nine PX4 1.16.0 in SIH for a minute: level 0.31 to 0.40 m RMS, up 0.10 to 0.14 m."""
    measured = hovers(flown(LIKE_SIH).trace)
    assert 0.31 <= np.mean([one.level.rms for one in measured]) <= 0.40
    assert 0.05 <= np.mean([one.up.rms for one in measured]) <= 0.14


@pytest.mark.slow
def test_a_team_that_hovers_well_may_fly_the_plan() -> None:
    result = flown(0.0)
    assert {finding.severity for finding in hover_findings(result.trace, PLAN)} == {"info"}
    needed = tracking_to_plan_with(hovers(result.trace), 3)
    assert needed is not None
    assert needed <= PLAN.plan.mission.vehicles.tracking


@pytest.mark.parametrize("disturbance", [1.5, 2.5])
def test_beyond_the_limit_all_land_and_nothing_is_advised(disturbance: float) -> None:
    seen = []
    result = flown(disturbance, on_step=lambda _, emulator, __: seen.append(emulator.truth()))
    assert result.outcome.word == "failed"
    allowed = f"more than the limit of {ERROR_LIMIT:g} m", "less than the required 1 m"
    assert any(words in result.outcome.explanation for words in allowed)
    assert not seen[-1].armed.any()
    assert seen[-1].contacts == ()
    advice = hover_findings(result.trace, PLAN)[0]
    if hovers(result.trace):
        assert advice.severity == "error"
        assert "no vehicles.tracking to plan with" in advice.message
    landing = [event.time for event in result.events if event.kind == "contingency"]
    assert len(landing) == 1


def test_two_that_come_too_near_each_other_are_landed_before_either_is_far_off() -> None:
    near = uncleared("vehicles.tracking=0", "clearance.vehicle=3.3", vehicles=9)
    plan, fleet = hop(near), emulated_fleet(9)
    world = emulated_world(plan.plan, fleet, with_cable=False, seed=1)
    for vehicle in world["vehicles"]:
        vehicle["disturbance"] = LIKE_SIH
    result = simulate_flight(plan, fleet=fleet, world=world, options=OPTIONS)
    assert result.outcome.word == "failed"
    assert "less than the required 3.3 m" in result.outcome.explanation
    assert apart(result.trace) > 2.5


def test_a_low_ceiling_and_near_pads_are_refused_before_anything_is_armed() -> None:
    with pytest.raises(Refused, match="a hop may go up to"):
        hop(uncleared("workspace.ceiling=4"))
    with pytest.raises(Refused, match="pads are"):
        hop(uncleared("clearance.vehicle=3.6"))


@given(arrays(np.float64, (60, 2, 3), elements=st.floats(-2.0, 2.0)))
def test_horizontal_and_vertical_errors_are_separate(error: np.ndarray) -> None:
    setpoint = np.ones((60, 2, 3))
    time = np.linspace(0.0, HOVER, 60)
    trace = Trace(time, time, setpoint + error, setpoint, ("hold",) * 60)
    for one, own in zip(hovers(trace), np.swapaxes(error, 0, 1), strict=True):
        squares = (own**2).mean(axis=0)
        assert one.level.rms == pytest.approx(np.sqrt(squares[0] + squares[1]))
        assert one.up.rms == pytest.approx(np.sqrt(squares[2]))
        assert one.both.rms**2 == pytest.approx(one.level.rms**2 + one.up.rms**2)
        assert one.up.largest == pytest.approx(np.abs(own[:, 2]).max())
        assert max(one.level.largest, one.up.largest) <= one.both.largest + 1e-12
        assert one.tracking >= max(one.both.largest, SPREAD * one.both.rms)
    assert tracking_to_plan_with(hovers(trace), 3) is None
    needed = tracking_to_plan_with(hovers(trace), 2)
    assert needed is not None
    largest = max(one.tracking for one in hovers(trace))
    assert largest - 1e-6 <= needed <= largest + 0.01
