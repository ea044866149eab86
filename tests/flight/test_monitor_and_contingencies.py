"""Clearances of the live monitor, and the contingencies that are open."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from swarm.certification.contingency_windows import contingency_windows
from swarm.certification.monitor import Monitor
from swarm.geometry.chain import polyline
from tests.network import small_plan

FLIGHT_PLAN = small_plan(vehicles=4)
PLAN = FLIGHT_PLAN.plan
LINE = PLAN.layout.corners


def test_margins_are_what_is_left_of_what_the_mission_asks():
    monitor = Monitor(PLAN)
    (free,) = monitor.clearances(LINE[None], "free")
    assert free.vehicle == pytest.approx(3.0)
    assert free.margin == pytest.approx(3.0 - PLAN.mission.clearance.vehicle)
    assert free.cable == np.inf


def test_vehicles_one_above_the_other_are_apart_by_height():
    monitor = Monitor(PLAN)
    stacked = LINE.copy()
    stacked[1] = stacked[0] + [0.1, 0.0, 1.6]
    (seen,) = monitor.clearances(stacked[None], "free")
    assert seen.margin == pytest.approx(1.6 - PLAN.mission.clearance.downwash)


def test_strands_are_measured_as_densely_sampled_curves_are():
    monitor = Monitor(PLAN)
    rng = np.random.default_rng(3)
    for _ in range(30):
        crossed = np.array([[0, 0, 5], [3, 0, 5], [2.2, 2.2, 5], [1.5, -0.8, 5.0]], dtype=float)
        crossed += rng.normal(0.0, 0.15, crossed.shape)
        chords = np.linalg.norm(np.diff(crossed, axis=0), axis=1)
        if np.any(chords > 0.98 * PLAN.layout.lengths):
            continue
        (seen,) = monitor.clearances(crossed[None], "aloft")
        dense = polyline(crossed, PLAN.layout.lengths, 400)
        first, last = dense[:401], dense[800:]
        sampled = np.linalg.norm(first[:, None] - last[None], axis=2).min()
        real = sampled - PLAN.mission.cable.diameter
        assert seen.cable <= real + 0.02
        if real < 0.3:
            assert seen.cable == pytest.approx(real, abs=0.03)
        assert seen.margin <= seen.cable - PLAN.mission.clearance.cable + 1e-9


def test_an_overstretched_cable_has_no_margin():
    monitor = Monitor(PLAN)
    far = LINE.copy()
    far[3, 0] += 1.0
    (seen,) = monitor.clearances(far[None], "aloft")
    assert seen.chord > 1.0
    assert seen.margin < 0.0
    assert seen.clock_rate == 0.0


def test_pace_falls_to_zero_with_the_margin():
    monitor = Monitor(PLAN)
    places = []
    for gap in (1.3, 1.05, 1.0, 0.9):
        near = LINE.copy()
        near[1] = near[0] + [gap, 0.0, 0.0]
        places.append(near)
    paces = [seen.clock_rate for seen in monitor.clearances(np.array(places), "free")]
    assert paces == pytest.approx([1.0, 0.5, 0.0, 0.0])


@settings(max_examples=200, deadline=None)
@given(
    st.integers(0, 2**32 - 1),
    st.sampled_from([0.02, 0.3, 0.8]),
    st.sampled_from(["aloft", "lifting", "free"]),
)
def test_the_pace_is_that_of_the_smallest_margin_of_all(seed, off, cable):
    monitor = Monitor(PLAN)
    rng = np.random.default_rng(seed)
    crossed = np.array([[0, 0, 5], [3, 0, 5], [2.2, 2.2, 5], [1.5, -0.6, 5.0]], dtype=float)
    moments = np.array([LINE + np.array([0, 0, 5]), crossed]) + rng.normal(0.0, off, (2, 4, 3))
    slowest = min(seen.clock_rate for seen in monitor.clearances(moments, cable))
    assert monitor.clock_rate(moments, cable) == pytest.approx(slowest, abs=1e-9)


def test_ways_out_of_a_straight_line_are_always_open():
    open_ = contingency_windows(PLAN, whole=True)
    during = PLAN.phase("fold").start + 1.0
    assert open_.can_land(during)
    assert open_.can_release(during)
    assert open_.land.all()


def test_landing_is_closed_while_somebody_is_above_somebody():
    flight_plan = small_plan(vehicles=3)
    plan = flight_plan.plan
    position = plan.motion.coefficients.copy()
    fold = plan.phase("fold")
    during = (plan.motion.times[:-1] >= fold.start - 1e-9) & (plan.motion.times[:-1] < fold.end)
    position[during, 0, 2, 0] -= 2.7
    crowded = type(plan.motion)(plan.motion.times, position)
    plan = type(plan)(**{**vars(plan), "motion": crowded})
    open_ = contingency_windows(plan, whole=True)
    middle = 0.5 * (fold.start + fold.end)
    assert not open_.can_land(middle)
    moment = open_.nearest(open_.land, middle, fold.start - 5.0, fold.end - 0.5)
    assert moment is not None
    assert moment < fold.start
