"""The tube of the swinging cable: it contains other simulations, stops, rewinds and resumes."""

import os
from dataclasses import replace
from typing import Literal

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from sitl.cable.swinging import SwingingRope
from sitl.physics.dynamics import STEP as TICK
from sitl.world import CableSpec
from swarm.certification.assessment import swing_findings
from swarm.certification.clearances import PlanChecks, tightest_moments, violations
from swarm.certification.strand_pieces import BIN, LEAVES, TubeRadii, radii_over
from swarm.certification.swing_runs import (
    COURSES,
    STEP,
    Course,
    aloft,
    model_of,
    swings,
    swings_after,
)
from swarm.certification.swing_tube import (
    NEAR,
    SwingTube,
    beyond_ordinary,
)
from swarm.flight.flight_plan import basis_of
from swarm.flight.guidance import MissionClock
from swarm.geometry.catenary import solve_catenaries
from swarm.geometry.distance import polyline_polyline
from swarm.geometry.lumped_mass import cable_model
from swarm.planning import Plan, digest
from swarm.planning.clock_limits import clock_limits
from tests.geometry.swinging import stray, swing
from tests.overhand import planned_overhand
from tests.shared import shared


def with_limit(plan: Plan, limit: float | str) -> Plan:
    fold = plan.mission.fold.model_copy(update={"swing": limit})
    return replace(plan, mission=plan.mission.model_copy(update={"fold": fold}))


@shared
def shaped_overhand() -> tuple[Plan, SwingTube]:
    result = planned_overhand()
    assert result.certificate.cleared
    plan = result.plan
    found = PlanChecks.of(plan).tube
    assert found is not None
    return plan, found


@pytest.fixture(scope="module")
def shaped() -> Plan:
    return shaped_overhand()[0]


@pytest.fixture(scope="module")
def tube() -> SwingTube:
    return shaped_overhand()[1]


def flown(plan: Plan, change: float | None, step: float, course: Course = COURSES[0]) -> np.ndarray:
    """Mission times (k,) in steps from the fold on, with a change of the mission clock's rate."""
    first, last = plan.phase("fold").start, plan.phase("hold").end
    if change is None:
        return np.arange(first, last, step)
    limits = clock_limits(plan.motion, plan.mission.vehicles.braking_acceleration)
    clock = MissionClock(limits, time=change, urgent=course.urgent)
    clock.set_running()
    # whole steps up to the change: the time would jump there by one and a part of one
    times = [*np.arange(first + (change - first) % step, change - step / 2, step), change]
    for k in range(round(course.duration / step)):
        clock.target = 0.0 if k * step < course.stopped else course.target
        clock.advance(step, first, last)
        times.append(clock.time)
    return np.array(times)


@pytest.mark.slow
@settings(max_examples=16, deadline=None)
@given(share=st.floats(0.05, 0.98), course=st.sampled_from(COURSES))
@example(share=0.6484375, course=COURSES[6])  # outside with beginnings every 2 s
@example(share=0.8, course=COURSES[2])
def test_it_contains_finer_simulations_of_every_change_of_rate(
    shaped: Plan, tube: SwingTube, share: float, course: Course
) -> None:
    cable, lengths, fold = shaped.mission.cable, shaped.layout.lengths, shaped.phase("fold")
    model = replace(cable_model(cable.mass_per_length, cable.diameter), links=40, step=0.006)
    times = flown(shaped, fold.start + share * (fold.end - fold.start), model.step, course)
    ends = shaped.motion.at(times)[0]
    strays = stray(swing(ends, lengths, model, 4), ends[::4], lengths)
    radii = tube.all_changes if course.urgent else tube.ordinary
    allowed = np.array([radii.strands(float(time)) for time in times[::4]])
    assert (strays <= allowed).all(), (strays - allowed).max()


@pytest.mark.slow
def test_it_contains_the_emulators_cable(shaped: Plan, tube: SwingTube) -> None:
    # another code with its own links, steps and drag, its grips exactly on the plan
    times, lengths = flown(shaped, None, TICK), shaped.layout.lengths
    grips = shaped.motion.at(times)[0]
    arcs = np.concatenate([[0.0], np.cumsum(lengths)])
    shape = _hanging(grips[0], lengths)
    cable = shaped.mission.cable
    spec = CableSpec(
        points=[tuple(point) for point in shape.tolist()],
        mass_per_length=cable.mass_per_length, diameter=cable.diameter,
    )  # fmt: skip
    rope = SwingingRope(spec, -100.0, np.zeros(3))
    for vehicle, arc in enumerate(arcs * rope.length / arcs[-1]):
        rope.attach(vehicle, float(arc))
    still = np.zeros_like(grips[0])
    for _ in range(round(8.0 / TICK)):
        rope.forces(grips[0], still)
    fractions = np.linspace(0.0, 1.0, 17)
    worst = -np.inf
    for k, place in enumerate(grips):
        rope.forces(place, still)
        if k % 10:
            continue
        joints = np.array(
            [
                [rope.position_at(float(arcs[i] + f * lengths[i])) for f in fractions]
                for i in range(len(lengths))
            ]
        )
        strays = stray(joints[None], place[None], lengths)[0]
        worst = max(worst, float((strays - tube.ordinary.strands(float(times[k]))).max()))
    assert worst <= 0.0


def _hanging(grips: np.ndarray, lengths: np.ndarray) -> np.ndarray:
    drawn = solve_catenaries(grips[:-1], grips[1:], lengths).points(np.linspace(0.0, 1.0, 40))
    return drawn.reshape(-1, 3)[np.r_[0, np.arange(len(drawn) * 40)[1:]]]


@pytest.mark.slow
@pytest.mark.parametrize("course", COURSES, ids=lambda course: course.name)
def test_courses_are_those_of_the_mission_clock(shaped: Plan, course: Course) -> None:
    fold = shaped.phase("fold")
    begin = fold.start + 2.0 if course.target > 0.0 else fold.end - 0.5
    limits = clock_limits(shaped.motion, shaped.mission.vehicles.braking_acceleration)
    (found,) = course.times(limits, np.array([begin]))
    expected = flown(shaped, begin, STEP, course)[-round(course.duration / STEP) :]
    assert found[1:] == pytest.approx(expected, abs=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("course", [COURSES[0], COURSES[5]], ids=lambda course: course.name)
def test_strands_come_no_nearer_than_the_approach_states(
    shaped: Plan, tube: SwingTube, course: Course
) -> None:
    # the same pairs at the same moments, in a change that begins between the simulated ones
    close, lengths = tube.pairs.close, shaped.layout.lengths
    limits = clock_limits(shaped.motion, shaped.mission.vehicles.braking_acceleration)
    model = replace(model_of(shaped), links=36, step=0.01)
    begin = shaped.phase("fold").start + 0.587 * shaped.phase("fold").duration
    times = flown(shaped, begin, model.step, course)
    assert limits.at(begin, urgent=True) > limits.at(begin, urgent=False)
    ends = shaped.motion.at(times)[0]
    joints = swing(ends, lengths, model, 10)
    still = solve_catenaries(ends[::10, :-1], ends[::10, 1:], lengths)
    strays = joints - still.points(np.linspace(0.0, 1.0, 37))
    at = np.rint(close.fractions * 36).astype(int)
    for row in np.flatnonzero(close.available < 0.6):
        now = np.abs(times[::10] - close.times[row]) <= 0.5 * BIN
        i, j = close.pairs[row]
        apart = strays[now, j, at[row, 1]] - strays[now, i, at[row, 0]]
        nearer = (apart @ close.normal[row]).max(initial=0.0)
        assert nearer <= tube.pairs.approach[row]


@pytest.mark.slow
@pytest.mark.skipif(
    not hasattr(os, "sched_setaffinity"), reason="no cores to choose on this system"
)
def test_the_tube_is_the_same_on_one_core(shaped: Plan, tube: SwingTube) -> None:
    cores = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(cores)})
    try:
        again = PlanChecks(digest(shaped), shaped).tube
    finally:
        os.sched_setaffinity(0, cores)
    assert again is not None
    assert np.array_equal(again.planned, tube.planned)
    assert np.array_equal(again.pairs.approach, tube.pairs.approach)
    assert np.array_equal(again.all_changes.pieces, tube.all_changes.pieces)
    assert np.array_equal(again.ordinary.pieces, tube.ordinary.pieces)


@pytest.mark.slow
@pytest.mark.parametrize(("limit", "known"), [(0.06, True), (0.06, False), ("auto", False)])
def test_near_pairs_swing_after_urgent_stops_as_all_do(
    shaped: Plan, limit: float | str, known: bool
) -> None:
    plan = with_limit(shaped, limit)
    if known:  # as where the clearances were certified in the tube before
        assert PlanChecks.of(plan).ordinary_swings is not None
    found, tube = PlanChecks.of(plan).swing_after_urgent_stops(), PlanChecks.of(plan).tube
    assert found is not None
    assert tube is not None
    near = tube.pairs.close.left < NEAR
    assert 0 < near.sum() < len(near)
    assert np.array_equal(found.close.pairs, tube.pairs.close.pairs[near])
    assert found.start == tube.pairs.start == tube.start
    checks = PlanChecks.of(plan)
    every = checks.planned_swings if limit == "auto" else checks.ordinary_swings
    assert every is not None
    every = replace(every, strays={}, approach=every.approach.copy())
    every.collect(swings_after(plan, every.span, every.planned, COURSES[:1]))
    assert np.array_equal(found.approach, every.pairs.approach[near])
    assert (found.approach <= tube.pairs.approach[near]).all()
    assert found.approach.sum() > 0.9 * tube.pairs.approach[near].sum()


@pytest.mark.slow
def test_all_ordinary_stops_are_simulated_where_clearances_hold_after_some(shaped: Plan) -> None:
    plan = with_limit(shaped, 0.07)
    assert violations(plan) == ()
    some, every = PlanChecks.of(plan).some_swings, PlanChecks.of(plan).ordinary_tube
    assert some is not None
    assert every is not None
    assert (some.radii.pieces <= every.pieces).all()
    assert (some.radii.pieces < every.pieces).mean() > 0.1
    cable = plan.mission.clearance.model_copy(update={"cable": 1.0})
    short = replace(plan, mission=plan.mission.model_copy(update={"clearance": cable}))
    assert any(moment.check == "cable clearance" for moment in violations(short))
    assert "ordinary_swings" not in vars(PlanChecks.of(short))


@pytest.mark.slow
def test_the_cable_does_not_swing_before_it_is_aloft(shaped: Plan) -> None:
    span = aloft(shaped)
    assert span is not None
    first = next(swings(shaped, span))
    assert first.course is None
    # at rest, links are this far from the curve of a catenary
    assert np.abs(first.strays[0, 0]).max() < 0.002


@pytest.mark.slow
@settings(max_examples=40)
@given(
    segment=st.integers(0, 7), time=st.floats(30.0, 90.0), half=st.floats(0.0, 9.0),
    depth=st.integers(0, 6), where=st.floats(0.0, 0.999),
)  # fmt: skip
def test_bounds_over_an_interval_are_those_of_its_moments(
    tube: SwingTube, segment: int, time: float, half: float, depth: int, where: float
) -> None:
    tables, number = tube.all_changes.tables, 2**depth + int(where * 2**depth)
    found = radii_over(tables, segment, number, (time, half))
    inside = np.arange(time - half, time + half + 0.5 * BIN, 0.5 * BIN).clip(max=time + half)
    values = [radii_over(tables, segment, number, (float(t), 0.0)).now for t in inside]
    assert found.most == max(values)
    assert found.least <= found.now <= found.most
    whole = radii_over(tables, segment, 1, (time, 0.0))
    assert found.now <= whole.now == tube.all_changes.strands(time)[segment]


@pytest.mark.slow
def test_the_default_overhand_is_certified_for_a_swinging_cable() -> None:
    result = planned_overhand()
    assert result.assessment.swing_certified
    basis = basis_of(result.certified(), cable=True)
    assert basis.checked == (
        "certified in the swinging-cable model for the planned motion and one ordinary stop with "
        "the resume that follows, in the quasi-static cable model for tracking errors of up to 0.1 m"
    )
    (scope,) = (found for found in result.assessment.findings if found.check == "scope")
    assert scope.message.startswith(
        "certified in the swinging-cable model for the planned motion and one ordinary stop with "
        "the resume that follows, at any moment of the fold, in the quasi-static cable model "
        "for every tracking error"
    )


@pytest.mark.slow
def test_clearances_are_certified_without_urgent_changes(shaped: Plan, tube: SwingTube) -> None:
    found = PlanChecks.of(shaped).certified_tube
    assert found is not None
    assert np.array_equal(found.pieces, tube.ordinary.pieces)
    assert PlanChecks.of(with_limit(shaped, "auto")).certified_tube is None
    assert (tube.ordinary.pieces <= tube.all_changes.pieces).all()
    assert tube.ordinary.largest < 0.7 * tube.all_changes.largest


@pytest.mark.slow
def test_a_shaped_fold_keeps_its_limit(shaped: Plan, tube: SwingTube) -> None:
    assert 0.02 < tube.planned.max() <= 0.06
    assert max(tube.changed.values()) > tube.planned.max()
    assert tube.start == pytest.approx(shaped.phase("fold").start)
    assert tube.times[-1] == pytest.approx(shaped.phase("hold").end, abs=BIN)


@pytest.mark.slow
def test_an_unshaped_fold_swings_four_times_as_far(overhand: Plan) -> None:
    found = PlanChecks.of(overhand).tube
    assert found is not None
    assert found.planned.max() > 0.2


@pytest.mark.slow
@pytest.mark.parametrize(
    ("limit", "severity"), [(0.06, "info"), (0.005, "error"), ("auto", "warning")]
)
def test_the_finding_is_an_error_beyond_the_limit(
    shaped: Plan, tube: SwingTube, limit: float | Literal["auto"], severity: str
) -> None:
    if limit == "auto":
        tube = replace(tube, planned=tube.planned + 0.1)
    (found,) = swing_findings(with_limit(shaped, limit), tube)
    assert found.severity == severity
    assert ("fold.swing allows 0.005 m" in found.message) is (severity == "error")
    assert f"with the errors of the model at most {tube.all_changes.largest:.2f} m" in found.message
    assert "at any moment: urgent stop 0." in found.message
    assert f"urgent rewind {tube.changed['urgent rewind']:.2f} m; with" in found.message


@pytest.mark.slow
def test_the_finding_names_segment_and_time(shaped: Plan, tube: SwingTube) -> None:
    planned = np.zeros_like(tube.planned)
    planned[7, 1] = 0.2
    (finding,) = swing_findings(with_limit(shaped, "auto"), replace(tube, planned=planned))
    assert finding.at_time == tube.times[7]
    assert (
        "0.20 m away from its catenary (segment 2) in the planned motion, in 2% of"
        in finding.message
    )
    assert swing_findings(shaped, None) == []


@pytest.mark.slow
def test_a_plan_with_a_chord_longer_than_its_cable_has_no_tube(shaped: Plan) -> None:
    lengths = shaped.layout.lengths.copy()
    lengths[3] *= 0.5
    assert (
        PlanChecks.of(replace(shaped, layout=replace(shaped.layout, lengths=lengths))).tube is None
    )


@pytest.mark.slow
@settings(max_examples=4, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), share=st.floats(0.1, 0.95))
def test_swinging_strands_with_tracking_errors_keep_the_certified_distance(
    shaped: Plan, seed: int, share: float
) -> None:
    # every vehicle is as far from its setpoint as allowed, and the operator stops the team
    lengths, cable = shaped.layout.lengths, shaped.mission.cable
    moments = tightest_moments(shaped, checks=("cable clearance",))
    certified = min(moment.distance for moment in moments)
    fold = shaped.phase("fold")
    model = replace(cable_model(cable.mass_per_length, cable.diameter), step=0.01)
    change = fold.start + share * (fold.end - fold.start)
    times = flown(shaped, change, model.step, COURSES[1])
    errors = np.random.default_rng(seed).normal(size=(shaped.vehicles, 3))
    errors *= shaped.mission.vehicles.tracking / np.linalg.norm(errors, axis=1, keepdims=True)
    joints = swing(shaped.motion.at(times)[0] + errors, lengths, model, 20)
    least = min(
        polyline_polyline(strands[i], strands[j]).distance
        for strands in joints
        for i in range(len(lengths))
        for j in range(i + 2, len(lengths))
    )
    assert least - cable.diameter >= certified


@pytest.mark.slow
def test_without_a_limit_of_the_swing_clearances_are_quasi_static(shaped: Plan) -> None:
    checks = ("cable clearance", "vehicle-cable clearance", "floor")
    swinging, still = (
        {(moment.check, moment.between): moment.distance for moment in tightest_moments(plan, checks=checks)}
        for plan in (shaped, with_limit(shaped, "auto"))
    )  # fmt: skip
    both = swinging.keys() & still.keys()
    assert len(both) >= 6
    assert all(swinging[name] < still[name] - 0.005 for name in both)


@pytest.mark.slow
def test_a_tube_that_other_stops_and_resumes_leave_is_refused(
    shaped: Plan, tube: SwingTube
) -> None:
    inside = beyond_ordinary(shaped, tube.ordinary)
    assert -0.03 < inside < 0.0
    leaves = tube.ordinary.pieces[:, :, LEAVES:]
    narrow = TubeRadii.of_leaves(tube.start, leaves + inside - 0.002)
    assert beyond_ordinary(shaped, narrow) == pytest.approx(0.002)
    (found,) = swing_findings(with_limit(shaped, 0.07), replace(tube, ordinary=narrow))
    assert found.severity == "error"
    assert found.message.endswith("; others, with twice the links, come 0.002 m out of their tube")
    (quasi_static,) = swing_findings(with_limit(shaped, "auto"), replace(tube, ordinary=narrow))
    assert quasi_static.severity == "info"
