"""Verification of a trace: the implied knot, the smallest distances, the tracking errors."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from swarm.certification.distances import closest_strands
from swarm.flight.trace import Trace
from swarm.geometry.chain import segment_lengths
from swarm.geometry.distance import strand_strand
from swarm.geometry.motion import through_states
from swarm.mission import mission_for_knot
from swarm.planning import KnotLayout, KnotSummary, Phase, Plan
from swarm.verification import tracking_errors, verify_trace

CELL = 2.4
CORNERS = CELL * np.array(
    [[0, 0], [2, 0], [2, 2], [4, 2], [4, -1], [1, -1], [1, 1], [3, 1], [3, 3]], dtype=float
)
SAGS = np.array([1.6, 2.2, 1.6, 1.6, 1.6, 2.2, 1.6, 2.2])


@pytest.fixture(scope="module")
def plan() -> Plan:
    """An overhand that hangs folded already and only sways by a hand's breadth, then holds."""
    corners = np.column_stack([CORNERS, np.full(len(CORNERS), 6.0)])
    lengths = segment_lengths(corners, SAGS)
    swayed = corners + np.array([0.1, 0.0, 0.0])
    places = np.array([corners, swayed, corners, corners])
    motion = through_states(np.array([0.0, 4.0, 8.0, 12.0]), places, 0 * places, 0 * places)
    return Plan(
        mission=mission_for_knot("overhand"),
        knot=KnotSummary("3_1", "right", "", ()),
        layout=KnotLayout(corners, SAGS, lengths, 0 * SAGS, ((0, 5), (2, 7), (6, 1)), CELL),
        motion=motion,
        phases=(
            Phase("fold", 0.0, 8.0, "aloft", True),
            Phase("hold", 8.0, 12.0, "aloft", True),
        ),
        gates=(),
        path=corners,
    )


def traced(plan, change=lambda _, place: place):
    time = np.arange(0.0, plan.duration, 0.05)
    setpoint = plan.motion.at(time)[0]
    phase = tuple(plan.phase_at(float(instant)).name for instant in time)
    return Trace(time, time, change(time, setpoint.copy()), setpoint, phase)


def test_an_exact_flight_implies_the_planned_knot_and_its_clearances(plan):
    flown = verify_trace(plan, traced(plan))
    assert (flown.knot, flown.chirality, flown.as_planned) == ("3_1", "right", True)
    assert flown.notes == ()
    # Vehicles stand one cell's diagonal apart, strands cross 0.6 m and more above another.
    assert flown.distances["vehicle"] is not None
    assert flown.distances["vehicle"].distance == pytest.approx(CELL * np.sqrt(2), abs=1e-6)
    assert flown.distances["cable"] is not None
    assert 0.3 < flown.distances["cable"].distance < 0.7
    assert flown.distances["vehicle_cable"] is not None
    assert flown.distances["vehicle_cable"].distance > 0.3
    assert flown.max_chord_ratio == pytest.approx(
        np.max(np.linalg.norm(np.diff(plan.layout.corners, axis=0), axis=1) / plan.layout.lengths)
    )


def test_a_vehicle_on_the_wrong_side_of_a_strand_implies_another_knot(plan):
    def strayed(time, place):
        place[time > 7.0, 8] = [3 * CELL, 1.6 * CELL, 6.0]  # short of segment 3, which it crosses
        return place

    flown = verify_trace(plan, traced(plan, strayed))
    assert flown.knot == "0_1"
    assert not flown.as_planned


def test_strands_above_all_others_cross_them_in_plan_view_and_change_no_knot(plan):
    def passed_above(time, place):
        place[time > 7.0, 4] = [2.5 * CELL, 1.35 * CELL, 10.5]
        return place

    exact, flown = (verify_trace(plan, traced(plan, *how)) for how in [(), (passed_above,)])
    assert (flown.knot, flown.chirality, flown.as_planned) == ("3_1", "right", True)
    assert flown.gauss != exact.gauss
    assert flown.notes[-1] == (
        "it is the planned knot, with other crossings in plan view than planned"
    )


def test_a_mirrored_flight_is_the_other_hand_and_not_as_planned(plan):
    flown = verify_trace(plan, traced(plan, lambda _, place: place * [-1.0, 1.0, 1.0]))
    assert (flown.knot, flown.chirality, flown.as_planned) == ("3_1", "left", False)


def test_the_closest_moment_is_found_between_the_coarse_samples(plan):
    def dipped(time, place):
        # Vehicle 1 comes within 0.8 m of vehicle 2 for one sample.
        place[np.argmin(np.abs(time - 3.05)), 0] = place[0, 1] - [0.8, 0.0, 0.0]
        return place

    flown = verify_trace(plan, traced(plan, dipped))
    assert flown.distances["vehicle"] is not None
    assert flown.distances["vehicle"].between == ("vehicle 1", "vehicle 2")
    assert flown.distances["vehicle"].distance < 1.0
    assert flown.distances["vehicle"].time == pytest.approx(3.05)


def test_tracking_errors_per_phase_and_vehicle(plan):
    def off(time, place):
        place[time >= 8.0, 2, 0] += 0.3
        place[:, 4, 2] -= 0.1
        return place

    found = {(e.phase, e.vehicle): e for e in tracking_errors(traced(plan, off))}
    assert found["hold", 3].rms == pytest.approx(0.3)
    assert found["fold", 3].largest == pytest.approx(0.0)
    assert found["fold", 5].p999 == pytest.approx(0.1)
    assert found["", 0].largest == pytest.approx(0.3)
    assert found["hold", 0].rms == pytest.approx(np.sqrt((0.3**2 + 0.1**2) / 9))


def test_unknown_positions_are_excluded(plan):
    def silent(time, place):
        place[time < 2.0, 3] = np.nan
        return place

    assert verify_trace(plan, traced(plan, silent)).as_planned
    nothing = verify_trace(plan, traced(plan, lambda _, place: np.full_like(place, np.nan)))
    assert (nothing.knot, nothing.as_planned) == ("unknown", False)
    assert nothing.notes == ("no positions were reported in the hold",)
    assert set(nothing.distances.values()) == {None}
    assert nothing.tracking == ()


def test_a_flight_without_a_hold_implies_no_knot(plan):
    trace = traced(plan)
    landed = replace(trace, phase=tuple("" for _ in trace.phase))
    assert verify_trace(plan, landed).knot == "unknown"


def test_an_over_stretched_report_is_noted(plan):
    def pulled(time, place):
        place[time > 9.0, 0] -= [3.0, 0.0, 0.0]
        return place

    flown = verify_trace(plan, traced(plan, pulled))
    assert flown.max_chord_ratio is not None
    assert flown.max_chord_ratio > 1.0
    assert any(note.startswith("the reported ends of segment 1 are") for note in flown.notes)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0.1, 6.0))
def test_the_closest_strands_equal_those_of_a_full_search(seed, spread):
    rng = np.random.default_rng(seed)
    instants, count, points = rng.integers([1, 3, 2], [40, 9, 12])
    steps = 0.2 * rng.normal(size=(instants, count, points, 3))
    strands = np.cumsum(steps, axis=2) + spread * rng.normal(size=(instants, count, 1, 3))
    pairs = np.stack(np.triu_indices(count, 2), axis=1)
    every = strand_strand(strands, pairs).distance
    found = closest_strands(strands, pairs)
    assert found == (every.min(), *np.unravel_index(np.argmin(every), every.shape))
