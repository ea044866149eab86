"""A flight outside its certificate says so, in its exit code too where cable was carried."""

from dataclasses import replace

import numpy as np
import pytest

from swarm.flight.flight_plan import basis_of, confirmed_basis
from swarm.flight.result import adherence
from swarm.flight.trace import Trace
from swarm.simulation.loop import simulate_flight
from tests.network import small_plan
from tests.test_certified_plan_files import reviewed

CERTIFIED = small_plan()
PLAN = CERTIFIED.plan
CARRYING = basis_of(CERTIFIED, cable=True)


def trace(error, phase="fold", vehicle=1):
    """A flight that is exact but for one vehicle at one moment of a phase."""
    times = np.linspace(0.0, PLAN.duration, 400)
    asked = PLAN.motion.at(times)[0]
    position = asked.copy()
    names = tuple(PLAN.phase_at(float(time)).name for time in times)
    position[names.index(phase) + 2, vehicle, 0] += error
    return Trace(times, times, position, asked, names)


@pytest.mark.parametrize(
    ("error", "within"),
    [(0.0, True), (0.0999999, True), (0.1000001, False), (0.8, False)],
)
def test_the_certified_tracking_error_is_the_limit(error, within):
    kept = adherence(PLAN, trace(error), CARRYING)
    assert kept.within is within
    assert kept.largest == pytest.approx(error, abs=1e-12)
    assert bool(kept.words) is not within


def test_the_words_name_vehicle_size_time_and_limit():
    kept = adherence(PLAN, trace(0.8, vehicle=2), CARRYING)
    time = kept.mission_time
    assert PLAN.phase_at(time).name == "fold"
    assert kept.words == (
        f"flown outside its certificate: vehicle 3 was 0.80 m off its setpoint at {time:.1f} s of "
        "the plan; it was certified for 0.1 m"
    )
    wider = replace(CARRYING, max_tracking_error=0.125)
    assert adherence(PLAN, trace(0.8), wider).words.endswith(
        "; it was certified for 0.1 m and would hold up to 0.125 m"
    )
    assert adherence(PLAN, trace(0.12), wider).within


def test_errors_count_while_the_cable_is_aloft():
    assert adherence(PLAN, trace(0.8, "takeoff"), CARRYING).within
    assert not adherence(PLAN, trace(0.8, "hold"), CARRYING).within
    unknown = trace(0.0)
    unknown.position[:] = np.nan
    kept = adherence(PLAN, unknown, CARRYING)
    assert (kept.within, kept.largest) == (True, None)


@pytest.mark.slow
def test_a_recorded_tracking_error_counts_only_where_it_is_shown_again():
    plan = reviewed().plan
    carrying = basis_of(reviewed(), cable=True)
    assert carrying.max_tracking_error > plan.mission.vehicles.tracking
    assert confirmed_basis(plan, carrying) == carrying
    forged = replace(carrying, max_tracking_error=0.9)
    shown = confirmed_basis(plan, forged).max_tracking_error
    assert shown == plan.mission.vehicles.tracking
    narrow = replace(forged, max_tracking_error=0.01)
    assert confirmed_basis(plan, narrow) == narrow


def test_only_where_cable_was_carried_it_is_a_failure():
    result = simulate_flight(CERTIFIED)
    assert (result.outcome.word, result.exit_code, result.error()) == ("done", 0, None)
    outside = adherence(PLAN, trace(0.8), CARRYING)
    carried = replace(result, adherence=outside)
    assert carried.exit_code == 3
    assert str(carried.error()) == outside.words
    alone = replace(carried, basis=replace(CARRYING, cable=False))
    assert alone.exit_code == 0
