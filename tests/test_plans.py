"""Whole plans: phases, gates, motion and limits, checked without the planner's code."""

import os
import subprocess
import sys
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from swarm import planner
from swarm.certification.air import deepest_sinking
from swarm.certification.budget import ShortBudget
from swarm.certification.clearances import violations
from swarm.certification.kinds import kind_of
from swarm.errors import Refused
from swarm.mission import mission_for_knot, parse_mission
from swarm.planner.pacing import slowed_for_swing, timed_for_losses
from swarm.planner.repairs import Kept, _repaired_at_once, least_short, repair
from swarm.planner.short_budgets import ShortBudgets, budgets_after_urgent_stops
from swarm.planning import Plan, digest
from swarm.planning.candidates import candidates, make_plan
from swarm.planning.repair import Shortfall

ROOT = Path(__file__).parents[1]
STILL = ("takeoff", "grab", "contract", "lift", "fold", "hold", "finish", "land")


@pytest.fixture(scope="module")
def overhand() -> Plan:
    return make_plan(mission_for_knot("overhand"))


@pytest.fixture(scope="module")
def printed() -> Plan:
    return make_plan(mission_for_knot("overhand", ["fold.method=paper"]))


def test_phases_follow_each_other(overhand: Plan) -> None:
    assert tuple(phase.name for phase in overhand.phases) == STILL
    assert overhand.phases[0].start == 0.0
    for before, after in pairwise(overhand.phases):
        assert before.end == after.start
        assert before.start < before.end
    assert overhand.phases[-1].end == pytest.approx(overhand.duration)


def test_gates_lie_at_rest(overhand: Plan) -> None:
    conditions = [gate.condition for gate in overhand.gates]
    assert conditions == [
        "armed", "airborne", "gripped", "settled", "settled", "settled", "released", "landed",
    ]  # fmt: skip
    times = np.array([gate.time for gate in overhand.gates])
    assert np.all(np.diff(times) > 0.0)
    _, velocity, acceleration = overhand.motion.at(times)
    assert np.abs(velocity).max() < 1e-3
    assert np.abs(acceleration).max() < 2e-2
    assert overhand.phase("finish").start == overhand.gates[-2].time


def test_begins_and_ends_on_the_ground(overhand: Plan) -> None:
    position, _, _ = overhand.motion.at([0.0, overhand.duration])
    np.testing.assert_allclose(position[..., 2], 0.0, atol=1e-6)


def test_ends_of_the_fold_are_the_corners(overhand: Plan) -> None:
    fold = overhand.phase("fold")
    position, _, _ = overhand.motion.at([fold.start, fold.end])
    np.testing.assert_allclose(position[1], overhand.layout.corners, atol=1e-4)
    line = position[0]
    np.testing.assert_allclose(line[:, 1:], line[:1, 1:].repeat(9, axis=0), atol=1e-4)
    assert np.all(np.diff(line[:, 0]) > 0.0), "vehicle n leads"


def test_limits_and_vehicles_apart(overhand: Plan) -> None:
    mission = overhand.mission
    times = np.linspace(0.0, overhand.duration, 20_000)
    position, velocity, acceleration = overhand.motion.at(times)
    reserve = mission.vehicles.max_acceleration - mission.vehicles.braking_acceleration
    assert np.linalg.norm(velocity, axis=2).max() <= mission.vehicles.max_speed
    assert np.linalg.norm(acceleration, axis=2).max() <= reserve * 1.002
    error = 2.0 * mission.vehicles.tracking
    i, j = np.triu_indices(overhand.vehicles, 1)
    apart = position[:, i] - position[:, j]
    level = np.linalg.norm(apart[..., :2], axis=2) - mission.clearance.vehicle - error
    above = np.abs(apart[..., 2]) - mission.clearance.downwash - error
    assert np.maximum(level, above).min() >= 0.0


def test_no_segment_is_taut_aloft(overhand: Plan) -> None:
    times = np.linspace(overhand.phase("lift").start, overhand.phase("hold").end, 10_000)
    position, _, _ = overhand.motion.at(times)
    chord = np.linalg.norm(np.diff(position, axis=1), axis=2)
    ball = 2.0 * overhand.mission.vehicles.tracking
    assert np.all(chord + ball <= 0.985 * overhand.layout.lengths)


def test_landing_places_are_clear_of_the_fallen_cable(overhand: Plan) -> None:
    ground = overhand.motion.at(overhand.duration)[0][:, :2]
    corners = overhand.layout.corners[:, :2]
    low, high = corners.min(axis=0) - 1.0, corners.max(axis=0) + 1.0
    assert not np.all((ground > low) & (ground < high), axis=1).any()
    apart = np.linalg.norm(ground[:, None] - ground[None], axis=2)
    assert apart[np.triu_indices(9, 1)].min() > overhand.mission.clearance.vehicle


def test_same_mission_same_plan(printed: Plan) -> None:
    again = make_plan(mission_for_knot("overhand", ["fold.method=paper"]))
    np.testing.assert_array_equal(again.motion.coefficients, printed.motion.coefficients)


def test_the_paper_stops_every_vehicle_at_its_corner(printed: Plan) -> None:
    fold = printed.phase("fold")
    np.testing.assert_allclose(printed.motion.at(fold.end)[0], printed.layout.corners, atol=1e-9)
    deepest = printed.layout.sags.max()
    np.testing.assert_allclose(printed.layout.lanes[:2], [-1.5 * deepest, -0.5 * deepest])
    assert len(np.unique(printed.layout.sags.round(6))) <= 2 + len(printed.layout.sags) // 2


def test_impossible_numbers_are_refused() -> None:
    mission = mission_for_knot("overhand", ["layout.cell=0.6"])
    with pytest.raises(Refused, match="keeps the clearances"):
        make_plan(mission)


def test_a_plan_knows_its_phases(printed: Plan) -> None:
    assert printed.phase_at(0.0).name == "takeoff"
    assert printed.phase_at(printed.phase("fold").start).name == "fold"
    assert printed.phase_at(printed.duration + 1.0).name == "land"
    with pytest.raises(KeyError):
        replace(printed, phases=()).phase("fold")


@pytest.mark.full
def test_planning_has_one_thread_for_sums_of_arrays_whatever_the_machine_has() -> None:
    """The number of threads decides how a sum is rounded."""
    threads: set[int] = set()

    def note(_stage: str, _share: float) -> None:
        pools = threadpool_info()
        threads.update(p["num_threads"] for p in pools if p["user_api"] == "blas")

    carried = ROOT / "missions" / "first-steps" / "two_carry.yaml"
    with threadpool_limits(limits=2, user_api="blas"):
        planner.plan(parse_mission(carried.read_text(), str(carried)), note)
    assert threads == {1}


@pytest.mark.full
def test_a_plan_does_not_depend_on_the_threads_of_a_machine() -> None:
    """With two threads for sums of arrays, 5_2 had another plan than with one."""
    mission = mission_for_knot("5_2", ())
    with threadpool_limits(limits=1, user_api="blas"):
        one = digest(planner.plan(mission, robustness=False).plan)
    with threadpool_limits(limits=2, user_api="blas"):
        two = digest(planner.plan(mission, robustness=False).plan)
    assert one == two


@pytest.mark.slow
def test_libraries_that_planning_loads_have_one_thread_too() -> None:
    """In a process of its own: this one has loaded them already."""
    program = (
        "from swarm.planner import one_thread\n"
        "from threadpoolctl import threadpool_info\n"
        "with one_thread():\n"
        "    import scipy.linalg, scipy.optimize\n"
        "    found = [pool for pool in threadpool_info() if pool['user_api'] == 'blas']\n"
        "    print(len(found), {pool['num_threads'] for pool in found})\n"
    )
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "2"}
    done = subprocess.run(
        [sys.executable, "-c", program], env=environment, capture_output=True, text=True, check=True
    )
    libraries, threads = done.stdout.split(maxsplit=1)
    assert int(libraries) > 0
    assert threads.strip() == "{1}"


@pytest.mark.full
def test_a_motion_that_exceeds_the_endurance_is_noted_and_the_shortest_is_returned() -> None:
    mission = mission_for_knot("overhand", ["vehicles.endurance=60", "layout.cell=1.6"])
    with planner.one_thread():
        repairs = repair(next(candidates(mission)), (), 64)
    assert repairs.attempts == 0
    (long,) = repairs.too_long
    assert long.flight_duration > 60.0
    assert repairs.notes[-1] == f"that took {long.flight_duration:.0f} s of 60 s in the air"
    result = planner.plan(mission, robustness=False)
    errors = [found.check for found in result.certificate.findings if found.severity == "error"]
    assert "endurance" in errors
    assert 60.0 < result.plan.flight_duration <= long.flight_duration


@pytest.mark.slow
def test_a_folding_whose_repairs_ran_out_can_be_repaired_further() -> None:
    mission = mission_for_knot("3_1", ["limits.accept_negative_budget=true"])
    with planner.one_thread():
        last = replace(next(candidates(mission)), attempt=12)
        ended = repair(last, (), 64)
        assert not ended.kept
        assert ended.attempts == 1
        assert ended.unfinished is not None
        assert 0.0 < ended.unfinished.short < 1.0
        further = ended.unfinished.repaired()
        assert further is not None
        assert repair(further, (), 3).kept


@pytest.mark.slow
def test_clearances_a_short_budget_and_jets_are_repaired_at_once() -> None:
    mission = mission_for_knot("3_1", ["limits.accept_negative_budget=false", "fold.swing=0.06"])
    with planner.one_thread():
        first = next(candidates(mission))
        paced = slowed_for_swing(timed_for_losses(first.plan))
        failures = violations(paced.plan)
        budgets = budgets_after_urgent_stops(paced.plan)
        short = {moment.check for moment in budgets.moments}
        failing = {moment.check for moment in failures}
        assert failing
        assert short - failing, "the budget is short of more than clearances"
        aims = {(aim.check, aim.time) for aim in budgets.aims}
        assert aims > {(moment.check, moment.time) for moment in budgets.moments}, "nearly short"
        repaired = _repaired_at_once(replace(first, plan=paced.plan), paced, failures)
        assert repaired is not None
        assert repaired.folding is not None
        for margin in {*(kind_of(check).margin for check in failing | short), "jet"}:
            assert getattr(repaired.folding.schedule.extra, margin).max() > 0.0
        assert _repaired_at_once(replace(first, attempt=12), paced, failures) is None


def test_a_closed_budget_counts_first_and_then_the_least_sinking() -> None:
    mission = mission_for_knot("3_1", ["limits.accept_negative_budget=true"])
    with planner.one_thread():
        first = next(candidates(mission))
        paced = timed_for_losses(first.plan)
        low, deep = ([Shortfall("jet", 60.0, metres)] for metres in (0.01, 0.02))
        moment = ShortBudget("cable clearance", 60.0, 0.001, 0.1)
        short = Kept(first, paced, ShortBudgets((moment,), (moment,), complete=False), ())
        closes = ShortBudgets((), (), complete=True)
        sinks, sinks_deep = Kept(first, paced, closes, low), Kept(first, paced, closes, deep)
        assert least_short([short, sinks_deep, sinks]) is sinks
        assert least_short([short]) is short
        later = Kept(first, paced, None, ())
        near = Kept(first, paced, ShortBudgets((), (), complete=False), ())
        for unknown in later, near:
            found = least_short([short, sinks, unknown])
            assert found == replace(unknown, budget=closes), "the budget counts once computed"


@pytest.mark.full
def test_no_vehicle_of_the_carrick_mat_sinks_by_more_than_its_tracking_radius() -> None:
    """Before its repairs, one sinks by 0.22 m."""
    path = ROOT / "missions" / "carrick_mat.yaml"
    text = path.read_text(encoding="utf-8")
    mission = parse_mission(text, str(path), ["fold.method=certified"])
    result = planner.plan(mission, robustness=False)
    assert result.certificate.cleared
    deepest = deepest_sinking(result.plan)
    assert deepest is not None
    assert deepest.depth <= mission.vehicles.tracking


@pytest.mark.full
def test_repairs_that_ran_out_go_on_where_no_folding_is_cleared(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """With one attempt for each folding; of knots of ten crossings, twelve were not enough."""
    monkeypatch.setattr("swarm.planning.candidates._ATTEMPTS", 1)
    mission = mission_for_knot("3_1", ["limits.accept_negative_budget=true"])
    result = planner.plan(mission, robustness=False)
    assert result.certificate.cleared
    assert "repaired further" in result.plan.notes


@pytest.mark.full
def test_a_plan_with_fewer_repairs_is_cleared_where_the_best_exceeds_the_endurance() -> None:
    """Repairs for jets led 10_102 to 601 of 600 s of flight, which only the certificate counts."""
    mission = mission_for_knot("10_102", ["limits.accept_negative_budget=true"])
    result = planner.plan(mission, robustness=False)
    assert result.certificate.cleared
    assert result.plan.flight_duration < 590.0
