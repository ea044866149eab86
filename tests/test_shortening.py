"""One optimisation of a fold: its derivatives, its needs, and the plan that it finds."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import toeplitz
from scipy.optimize import brentq

from swarm import planner
from swarm.certification.air import deepest_sinking
from swarm.certification.certificate import certify
from swarm.certification.clearances import PlanChecks
from swarm.errors import Refused
from swarm.geometry.solids import distances
from swarm.mission import parse_mission
from swarm.planner import PlanningResult, shortening
from swarm.planner.fold_problem import Fold, Frozen, Problem, localised
from swarm.planner.shortening import Shortening
from swarm.planner.team_terms import Needs, _by_end, _write_strand
from swarm.planning import Plan
from swarm.planning.candidates import candidates
from tests.shared import shared

Floats = npt.NDArray[np.float64]

FIVE = Path(__file__).parents[1] / "missions" / "overhand_five.yaml"


def five(method: str) -> PlanningResult:
    text = FIVE.read_text(encoding="utf-8")
    text = text.replace("method: optimised", f"method: {method}")
    return planner.plan(parse_mission(text, str(FIVE)), robustness=False)


@shared
def as_certified() -> PlanningResult:
    """The overhand with five vehicles, which follow one curve."""
    return five("certified")


@shared
def as_optimised() -> PlanningResult:
    """The same mission, its fold shortened."""
    return five("optimised")


def begun() -> tuple[Shortening, Fold, Frozen]:
    """The problem at a motion somewhat quicker than planned, where all terms count."""
    short, fold = Shortening.of(as_certified().plan)
    frozen = shortening._measured_first(short, fold)
    fold = replace(fold, duration=0.7 * fold.duration)
    room = np.full(len(short.loss_shares), 0.1)
    allowed = np.linspace(1.0, 0.4, frozen.gains.size).reshape(frozen.gains.shape)
    coasting = shortening._coasting(short, fold, room)
    frozen = replace(frozen, allowed=allowed, coasting=coasting)
    return short, fold, frozen


def parts_of(problem: Problem, fold: Fold, frozen: Frozen) -> Floats:
    """Return the cost, and its derivatives by all unknowns."""
    shown, slopes = problem.derived(fold, frozen)
    bordered = shortening._by_unknowns(problem, fold, slopes, 0.0)
    return np.concatenate([[shown.cost], bordered.gradient])


TERMS = (
    "clearances", "after losses", "speed and acceleration", "swing", "sinking", "walls", "all",
    "given places",
)  # fmt: skip

WALLS = parse_mission(
    """
schema: 1
name: walls
knot: {gauss: "1- 2+ 3- 1+ 2- 3+", chirality: right}
clearance: {obstacle: 0.3}
workspace:
  ceiling: 9
  fence: [[-40, -40], [0, -6], [40, -40], [40, 40], [-40, 40]]
  obstacles:
    - {name: pole, shape: cylinder, centre: [1.5, 1.0], radius: 0.1, top: 12}
    - {name: table, shape: box, centre: [-2.0, 1.0], size: [2.0, 1.0], turn: 0.4, top: 3.5}
    - {name: net, shape: half-space, point: [0.0, 8.0, 0.0], normal: [0.0, -1.0, 0.1]}
""",
    "walls.yaml",
)
"""A ceiling, a fence with a corner that points inwards, and obstacles amid the team."""


@pytest.mark.slow
@pytest.mark.parametrize("term", TERMS)
def test_derivatives_of_each_term_are_those_of_its_values(term: str) -> None:
    short, fold, frozen = begun()
    problem = short.problem
    if term == "given places":
        given = problem.first(fold.pose)
        problem = replace(problem, given=given, before=np.empty((0, 4)))
    if term in {"walls", "all"}:
        walls = shortening._walls(WALLS, 0.1, 0.1)
        problem = replace(problem, team=problem.team._replace(walls=walls))
        needs = shortening._needs(problem.team, np.zeros(problem.moments))
        assert problem.shown_by(problem.states(fold, problem.shares)[0], needs).missed.max() > 0.0
        frozen = replace(frozen, needs=frozen.needs._replace(inside=needs.inside))
    rng = np.random.default_rng(4)
    fold = replace(fold, free=fold.free + rng.normal(scale=0.005, size=fold.free.shape))
    if term not in {"all", "given places"}:
        limits = problem.limits
        far = replace(limits, speed=1e6, acceleration=1e6, swing=1e6, sinking=1e6)
        kept = {
            "speed and acceleration": replace(
                far, speed=limits.speed, acceleration=limits.acceleration
            ),
            "swing": replace(far, swing=limits.swing),
            "sinking": replace(far, sinking=0.1 * limits.sinking),
        }
        problem = replace(problem, limits=kept.get(term, far))
    if term not in {"after losses", "all", "given places"}:
        frozen = replace(frozen, coasting=None)
    before = parts_of(problem, fold, frozen)
    seen = 0
    for _ in range(3):
        step = rng.normal(size=len(before) - 1) * 0.1
        size = 1e-6
        ahead, behind = (
            problem.evaluate(shortening._moved(fold, step, sign * size), frozen).cost
            for sign in (1.0, -1.0)
        )
        slope = (ahead - behind) / (2.0 * size)
        parts = before[1:] * step  # of which many cancel
        assert slope == pytest.approx(parts.sum(), rel=2e-4, abs=2e-5 * np.abs(parts).sum())
        seen += abs(slope) > 1e-3
    assert seen


@given(
    st.floats(0.5, 0.97), st.floats(-0.4, 0.4), st.floats(0.0, 6.3), st.integers(1, 199),
    st.integers(0, 2),
)  # fmt: skip
@settings(max_examples=40, deadline=None)
def test_points_of_a_strand_are_those_of_its_catenary_and_move_with_its_ends(
    ratio: float, steep: float, heading: float, piece: int, axis: int
) -> None:
    length, share = 3.0, piece / 200
    rise, chord = steep * ratio * length, ratio * length
    level = np.sqrt(chord**2 - rise**2)
    end = np.array([level * np.cos(heading), level * np.sin(heading), rise])

    def point(end: Floats) -> Floats:
        """The point by the equations of the catenary (Routh, *Statics*, § 443)."""
        span = float(np.hypot(end[0], end[1]))
        excess = np.sqrt(length**2 - end[2] ** 2)
        a = brentq(lambda a: 2 * a * np.sinh(0.5 * span / a) - excess, span / 200, span * 1e4)
        first = np.arctanh(end[2] / length) - 0.5 * span / a
        arc = np.arcsinh(np.sinh(first) + share * length / a)
        along = a * (arc - first) / span
        return np.array([*(along * end[:2]), a * (np.cosh(arc) - np.cosh(first))])

    shown = strand_point(np.zeros(3), end, length, piece)
    np.testing.assert_allclose(shown[0], point(end), atol=1e-6)
    step = 1e-5 * np.eye(3)[axis]
    moved = (point(end + step) - point(end - step)) / 2e-5
    np.testing.assert_allclose(shown[1][:, axis], moved, atol=2e-3)


def strand_point(start: Floats, end: Floats, length: float, piece: int) -> tuple[Floats, Floats]:
    """Return a point of 200 along a strand, and its derivative (3, 3) by the far end."""
    points, response = np.empty((201, 3)), np.empty((201, 5))
    _write_strand(start, end, length, points, response)
    by = [_by_end(start, end, response, (piece, 0.0), tuple(axis)) for axis in np.eye(3).tolist()]
    return points[piece], np.array(by)


@pytest.mark.parametrize("order", [slice(None), slice(None, None, -1), [0, 0, 1, 2, 3, 4, 0]])
def test_walls_are_as_far_as_the_sides_of_a_fence_that_has_a_corner_inwards(
    order: slice | list[int],
) -> None:
    fence = np.array(WALLS.workspace.fence)
    corners = tuple(map(tuple, fence[order].tolist()))
    workspace = WALLS.workspace.model_copy(update={"fence": corners})
    walls = shortening._walls(WALLS.model_copy(update={"workspace": workspace}), 0.0, 0.0)
    rng = np.random.default_rng(1)
    inside = rng.uniform([-39, -5, 1], [39, 39, 2], size=(200, 3))
    inside = np.concatenate([inside, rng.uniform([-39, -38, 1], [-30, 39, 2], size=(200, 3))])
    sides = np.stack([fence, np.roll(fence, -1, axis=0)], axis=1)
    step = sides[:, 1] - sides[:, 0]
    share = ((inside[:, None, :2] - sides[:, 0]) * step).sum(axis=2) / (step**2).sum(axis=1)
    nearest = sides[:, 0] + np.clip(share, 0.0, 1.0)[..., None] * step
    expected = np.linalg.norm(inside[:, None, :2] - nearest, axis=2).min(axis=1)
    assert (len(walls.grown), len(walls.solids)) == (1 + 5 + 3, 5 + 3), "ceiling, sides, obstacles"
    found = distances(walls.solids[None, :5], inside[:, None]).min(axis=1)
    np.testing.assert_allclose(found, expected, atol=1e-9)


@pytest.mark.slow
def test_the_way_to_the_line_is_that_of_the_flight() -> None:
    plan = as_certified().plan
    problem, fold = shortening._problem_of(plan)
    places, _ = problem.way_to_line(fold.pose)
    n = plan.vehicles
    pads, above, laid = places[: 3 * n].reshape(n, 3, 3).transpose(1, 0, 2)
    lifted = places[3 * n :].reshape(n, -1, 3)
    takeoff, lift = plan.phase("takeoff"), plan.phase("lift")
    for shown, time in ((pads, 0.0), (laid, takeoff.end), (lifted[:, -1], lift.end)):
        np.testing.assert_allclose(shown, plan.motion.at(np.array([time]))[0][0], atol=1e-5)
    np.testing.assert_allclose(above[:, :2], pads[:, :2])
    np.testing.assert_allclose(above[:, 2], laid[:, 2])
    assert (lifted[:, 0, 2] == 0.0).all()


WORKSPACE = (
    "wind.steady=2", "workspace.ceiling=12.5",
    "workspace.fence=[[-30, -9], [30, -9], [30, 9], [-30, 9]]",
    "workspace.obstacles=[{name: lamp, shape: box, centre: [4, -6], size: [2, 2], bottom: 10.5, "
    "top: 20}]",
)  # fmt: skip


def optimised_with(*overrides: str) -> tuple[PlanningResult, list[Plan]]:
    """The plan with the first candidate's fold shortened, and the plans that were tried."""
    mission = parse_mission(FIVE.read_text(encoding="utf-8"), str(FIVE), overrides)
    tried: list[Plan] = []

    def accepted(plan: Plan) -> shortening.Verdict:
        tried.append(plan)
        return "enough" if PlanningResult(plan, certify(plan)).certificate.cleared else "refused"

    with planner.one_thread():
        first = next(iter(candidates(mission))).plan
        shortening.shorten(first, accepted, lambda _stage, _share: None)
        return PlanningResult(first, certify(tried[-1] if tried else first)), tried


@pytest.mark.full
def test_a_shorter_fold_keeps_inside_fence_and_ceiling_beside_obstacles_and_in_wind() -> None:
    result, tried = optimised_with(*WORKSPACE)
    assert result.certificate.cleared
    assert tried[-1].phase("fold").duration < 22.0
    free = as_optimised().plan  # would leave the fence
    assert np.abs(free.motion.at(np.linspace(0.0, free.motion.times[-1], 500))[0][..., 1]).max() > 9


@pytest.mark.full
def test_no_plan_is_tried_where_the_knot_itself_is_above_the_ceiling() -> None:
    assert optimised_with("workspace.ceiling=6")[1] == []


@pytest.mark.full
def test_a_shorter_fold_is_cleared_and_needs_no_slower_clock() -> None:
    before, after = as_certified().plan, as_optimised().plan
    assert as_optimised().certificate.cleared
    assert after.phase("fold").duration < 0.5 * before.phase("fold").duration
    assert after.flight_duration < before.flight_duration - 20.0
    np.testing.assert_array_equal(after.layout.lengths, before.layout.lengths)
    assert after.knot == before.knot
    sinking = deepest_sinking(after)
    assert sinking is None or sinking.depth <= after.mission.vehicles.tracking
    assert PlanChecks.of(after).limits_ahead.rates.min() == 1.0
    assert any(note.startswith("found a fold of ") for note in after.notes)


@pytest.mark.full
def test_an_optimised_fold_is_the_same_from_a_start_that_differs_by_millimetres() -> None:
    """It has converged, and is not where chance ended it."""
    short, fold = Shortening.of(as_certified().plan)
    room = np.full(len(short.loss_shares), 0.05)
    rng = np.random.default_rng(1)
    found = []
    for size in (0.0, 0.002):
        start = replace(fold, free=fold.free + rng.normal(scale=size, size=fold.free.shape))
        frozen = shortening._measured_first(short, start)
        wanted = shortening.Wanted.nothing(frozen.needs)
        centred = shortening._centred(short, start, frozen, (wanted, room), 300.0)
        assert centred is not None
        found.append(centred[0])
    assert found[0].duration == pytest.approx(found[1].duration, rel=0.03)


def stricter(plan: Plan, **clearance: float) -> Plan:
    """The same plan, of a mission with larger clearances."""
    larger = plan.mission.clearance.model_copy(update=clearance)
    return replace(plan, mission=plan.mission.model_copy(update={"clearance": larger}))


def asked_of(short: Shortening, fold: Fold) -> tuple[Needs, shortening.Wanted]:
    """The needs of a motion, and nothing that the certificate asks for beyond them."""
    needs = shortening._measured_first(short, fold).needs
    return needs, shortening.Wanted.nothing(needs)


@pytest.mark.slow
def test_the_certificate_asks_for_more_where_a_clearance_does_not_hold() -> None:
    plan = as_certified().plan
    short, fold = Shortening.of(plan)
    needs, none = asked_of(short, fold)
    before = shortening._wanted(short, plan, needs, none)
    asked = shortening._wanted(short, stricter(plan, vehicle_cable=2.5), needs, none)
    np.testing.assert_array_equal(asked.strands, before.strands)
    assert not before.bodies.any()
    short_of = asked.bodies > 0.0
    assert short_of.any(axis=(1, 2)).mean() < 1.0, "at some moments only"
    assert (asked.bodies > needs.bodies)[short_of].all()
    again = shortening._wanted(short, plan, needs, asked)
    np.testing.assert_array_equal(again.bodies, asked.bodies)
    apart = shortening._wanted(short, stricter(plan, vehicle=3.0), needs, none).aside
    assert (apart > short.problem.team.aside)[apart > 0.0].all()
    assert not before.aside.any()
    assert apart[:, 0].any()


@pytest.mark.slow
def test_a_budget_asks_at_the_end_for_no_more_than_the_knot_keeps_but_for_less_swing() -> None:
    plan = as_certified().plan
    short, fold = Shortening.of(plan)
    asked = shortening._wanted(short, stricter(plan, cable=0.6), *asked_of(short, fold))
    near = np.isfinite(short.kept)
    assert near.any()
    assert (asked.strands[-1] <= short.kept)[near].all()
    assert (asked.strands > short.kept)[:, near].any(), "where the vehicles are still on their way"
    swinging_less = np.flatnonzero(asked.less[-1])
    first, second = np.nonzero(near)
    assert len(swinging_less)
    assert set(swinging_less) <= {*first, *second}
    assert not asked.less[: len(asked.less) // 2].any(), "near the knot only"


def test_less_swing_is_asked_for_where_lumped_masses_swing_too_far() -> None:
    short, fold = Shortening.of(as_certified().plan)
    limit = short.problem.limits.swing
    calm, quick = (replace(fold, duration=share * fold.duration) for share in (3.0, 0.2))
    assert short.swinging_less(calm).problem.limits == short.problem.limits
    assert 0.0 < short.swinging_less(quick).problem.limits.swing < 0.5 * limit


def test_steps_lower_the_cost_and_shorten_the_fold_while_strands_stay_apart() -> None:
    short, fold = Shortening.of(as_certified().plan)
    frozen = shortening._measured_first(short, fold)
    problem, begun_at, weight, damping = short.problem, fold.duration, 600.0, 1.0
    cost = problem.evaluate(fold, frozen).cost + weight * np.log(fold.duration)
    for _ in range(8):
        step = shortening._newton_step(problem, fold, frozen, weight, damping)
        fold, damping = step.fold, step.damping
        after = problem.evaluate(fold, frozen)
        assert after.cost + weight * np.log(fold.duration) < cost
        cost = after.cost + weight * np.log(fold.duration)
    distances = after.needs.distances
    assert distances[distances > 0.0].min() > 0.2
    assert fold.duration < 0.75 * begun_at


@pytest.mark.parametrize("unknowns", [0, 2500])
def test_a_step_solves_the_equations_of_the_whole_matrix(unknowns: int) -> None:
    """Also of what memory couples beyond the band, by a matrix that is multiplied out."""
    short, fold, frozen = begun()
    problem, damping = replace(short.problem, whole=unknowns), 1.0
    fold = replace(fold, duration=3.0 * fold.duration)  # whose band is narrow
    _, slopes = problem.derived(fold, frozen)
    quadratic = shortening._by_unknowns(problem, fold, slopes, 600.0)
    size = slopes.gradient.size
    assert (slopes.band.shape[1] < 0.7 * size) is (unknowns == 0)
    units = np.eye(size).reshape(size, *slopes.gradient.shape)
    whole = shortening.matrix_times(slopes, units).reshape(size, size)
    np.testing.assert_allclose(whole, whole.T, atol=1e-9 * np.abs(whole).max())
    matrix = np.block(
        [
            [quadratic.corner, quadratic.border.T],
            [quadratic.border, whole[quadratic.inner, quadratic.inner]],
        ]
    )
    matrix += damping * np.diag([*shortening._STIFF, *np.ones(len(matrix) - 5)])
    rest = matrix @ quadratic.step(damping) + quadratic.gradient
    assert np.linalg.norm(rest) < 1.01e-3 * np.linalg.norm(quadratic.gradient)


@given(st.integers(2, 40), st.integers(1, 120))
def test_couplings_in_a_band_have_no_negative_eigenvalues(reach: int, count: int) -> None:
    row = np.zeros(max(count, reach))
    row[:reach] = localised(reach)
    assert row[0] == 1.0
    assert np.linalg.eigvalsh(toeplitz(row[:count])).min() > -1e-9


def test_what_is_too_large_is_refused() -> None:
    shortening.require_solvable(19, 293.5, 161)
    with pytest.raises(Refused) as refused:
        shortening.require_solvable(21, 320.3, 176)
    assert str(refused.value) == (
        "fold.method: expected certified for 21 vehicles and a fold of 320 s, got optimised: "
        "11,088 unknowns, at most 10,000"
    )
