"""The phases after the fold: motion, certificate and flight of each finish."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from swarm.certification.assessment import assess
from swarm.errors import InputError
from swarm.geometry.motion import Motion
from swarm.mission import mission_for_knot, parse_mission
from swarm.planning import Plan
from swarm.planning.cable_shape import folded_back, laid_cable, laid_grip_points
from swarm.planning.finishes import MAX_TIGHTENED_SHARE
from swarm.planning.formation import formation_plan
from swarm.planning.phase_motion import CARRY_HEIGHT, GRAB_HEIGHT
from swarm.planning.phase_sequence import flight_around_fold
from tests.certification.conftest import recorded_overhand
from tests.network import Network, small_plan, uncleared

TIED_ON = ("grab=attached", "vehicles.breakaway=6.0")
BEFORE = ("takeoff", "grab", "contract", "lift", "fold", "hold")
AFTER = {
    "hold": ("descend", "land"),
    "unfold": ("unfold", "lower", "spread", "finish", "land"),
    "tighten": ("tighten", "finish", "land"),
}


def finished(*overrides: str) -> Plan:
    """The recorded overhand with another finish."""
    plan = recorded_overhand()
    fold, motion = plan.phase("fold"), plan.motion
    first, last = (int(np.argmin(abs(motion.times - at))) for at in (fold.start, fold.end))
    only = Motion(motion.times[first : last + 1] - fold.start, motion.coefficients[first:last])
    mission = mission_for_knot("overhand", overrides)
    flight = flight_around_fold(mission, plan.layout.lengths, only)
    return replace(
        plan, mission=mission, motion=flight.motion, phases=flight.phases, gates=flight.gates
    )


def at(plan: Plan, name: str, end: bool = False) -> np.ndarray:
    phase = plan.phase(name)
    return plan.motion.at(phase.end if end else phase.start)[0]


@pytest.mark.slow
@pytest.mark.parametrize(
    "finish",
    [*(pytest.param(name, marks=pytest.mark.full) for name in ("hold", "unfold")), "tighten"],
)
def test_every_finish_is_certified_and_states_the_limits_of_the_model(finish: str) -> None:
    plan = finished(f"finish={finish}")
    assert tuple(phase.name for phase in plan.phases) == BEFORE + AFTER[finish]
    assessment = assess(plan)
    assert assessment.cleared, [f for f in assessment.findings if f.severity == "error"]
    assert (assessment.knot, assessment.chirality) == ("3_1", "right")
    (scope,) = [finding for finding in assessment.findings if finding.check == "scope"]
    assert "outside the model" in scope.message
    _, velocity, acceleration = plan.motion.at([gate.time for gate in plan.gates])
    assert np.abs(velocity).max() < 1e-3
    assert np.abs(acceleration).max() < 2e-2


def test_unfolding_ends_with_the_cable_as_it_lay_and_every_vehicle_on_its_pad() -> None:
    plan = finished("finish=unfold")
    gripped = next(gate.time for gate in plan.gates if gate.condition == "gripped")
    released = next(gate.time for gate in plan.gates if gate.condition == "released")
    np.testing.assert_allclose(plan.motion.at(released)[0], plan.motion.at(gripped)[0], atol=1e-6)
    np.testing.assert_allclose(plan.motion.at(plan.duration)[0], plan.motion.at(0.0)[0], atol=1e-6)
    fold, back = plan.phase("fold"), plan.phase("unfold")
    into = np.linspace(0.0, fold.end - fold.start, 50)
    there, speed, push = plan.motion.at(fold.end - into)
    again, backwards_speed, same_push = plan.motion.at(back.start + into)
    np.testing.assert_allclose(again, there, atol=1e-6)
    np.testing.assert_allclose(backwards_speed[1:-1], -speed[1:-1], atol=1e-5)
    np.testing.assert_allclose(same_push[1:-1], push[1:-1], atol=1e-3)


def test_with_its_slack_laid_the_cable_is_not_contracted() -> None:
    """Vehicles rise from their legs, where errors of those that stand are no reason to wait."""
    straight, plan = finished("finish=unfold"), finished("finish=unfold", "lay=slack")
    assert [phase.name for phase in plan.phases] == [phase.name for phase in straight.phases]
    contract = plan.phase("contract")
    assert contract.cable == "floor"
    moved = at(plan, "contract", end=True) - at(plan, "contract")
    assert np.abs(moved[:, :2]).max() < 1e-9
    assert moved[:, 2] == pytest.approx(CARRY_HEIGHT - GRAB_HEIGHT)
    np.testing.assert_array_equal(at(plan, "fold"), at(straight, "fold"))
    assert plan.duration < straight.duration - 10.0


@pytest.mark.parametrize("lay", ["straight", "slack"])
def test_all_of_the_cable_lies_on_the_floor(lay: str) -> None:
    plan = finished(f"lay={lay}")
    bends, grips, lengths = laid_cable(plan), laid_grip_points(plan), plan.layout.lengths
    steps = np.linalg.norm(np.diff(bends, axis=0), axis=1)
    each = len(steps) // len(lengths)
    np.testing.assert_allclose(steps.reshape(-1, each).sum(axis=1), lengths, atol=1e-9)
    np.testing.assert_array_equal(bends[::each], grips)
    along = (grips[-1] - grips[0]) / np.linalg.norm(grips[-1] - grips[0])
    beside = np.linalg.norm(np.cross(bends - grips[0], along), axis=1).max()
    assert beside < (1e-9 if lay == "slack" else 0.08 * lengths.max())


@given(share=st.floats(0.1, 0.99))
def test_slack_is_folded_back_between_the_grips(share: float) -> None:
    """However near they are to each other, never nearer to a grip than a quarter of their distance."""
    plan = finished("lay=slack")
    near = replace(plan, layout=replace(plan.layout, lengths=spacing(plan) / share))
    back, times = folded_back(near)
    np.testing.assert_allclose(spacing(plan) + 2.0 * times * back, near.layout.lengths)
    assert (back <= 0.5 * spacing(plan) + 1e-12).all()
    bends = laid_cable(near)
    length = np.linalg.norm(np.diff(bends, axis=0), axis=1).sum()
    assert length == pytest.approx(near.layout.lengths.sum())


def spacing(plan: Plan) -> np.ndarray:
    return np.linalg.norm(np.diff(laid_grip_points(plan), axis=0), axis=1)


def test_a_held_knot_is_put_down_straight_and_together() -> None:
    plan = finished("finish=hold", "hold_time=20.0")
    hold, descend = plan.phase("hold"), plan.phase("descend")
    assert hold.end - hold.start == pytest.approx(20.0)
    assert descend.cable == "landing"
    path = plan.motion.at(np.linspace(descend.start, descend.end, 60))[0]
    apart = path - path[:, :1]
    np.testing.assert_allclose(apart, np.broadcast_to(apart[0], apart.shape), atol=1e-9)
    released = [gate.time for gate in plan.gates if gate.condition == "released"]
    assert released == pytest.approx([descend.end])


def test_tightening_pulls_the_ends_apart_under_the_others() -> None:
    plan = finished("finish=tighten")
    held, pulled = at(plan, "tighten"), at(plan, "tighten", end=True)
    moved = pulled - held
    assert np.abs(moved[1:-1, :2]).max() < 1e-9
    clearance, tracking = plan.mission.clearance, plan.mission.vehicles.tracking
    assert moved[1:-1, 2].min() > clearance.downwash + 2 * tracking
    assert np.abs(moved[[0, -1], 2]).max() < 1e-9
    apart = np.linalg.norm(pulled[-1] - pulled[0])
    total = plan.layout.lengths.sum()
    assert np.linalg.norm(held[-1] - held[0]) < apart <= MAX_TIGHTENED_SHARE * total + 1e-9
    inner = [gate.inner for gate in plan.gates if gate.condition == "released"]
    assert inner == [True, False]


def test_a_cable_that_is_tied_on_is_lifted_from_below_the_line() -> None:
    plan = finished("finish=hold", *TIED_ON)
    assert tuple(phase.name for phase in plan.phases) == (
        "takeoff", "lift", "fold", "hold", "descend", "land",
    )  # fmt: skip
    assert not any(gate.condition == "released" for gate in plan.gates)
    np.testing.assert_allclose(at(plan, "takeoff")[:, :2], at(plan, "fold")[:, :2], atol=1e-9)


@pytest.mark.full
def test_an_overhand_is_tied_in_a_cable_that_is_tied_on() -> None:
    assessment = assess(finished("finish=hold", *TIED_ON))
    assert assessment.cleared
    assert (assessment.knot, assessment.chirality) == ("3_1", "right")


def test_a_tied_cable_that_breaks_away_too_early_is_refused() -> None:
    findings = small_plan("finish=hold", *TIED_ON).assessment.findings
    (breakaway,) = [finding.message for finding in findings if finding.check == "breakaway"]
    assert breakaway.endswith("; the tied cable breaks away at 6 N")
    torn = uncleared("finish=hold", "grab=attached", "vehicles.breakaway=0.1").assessment
    assert [f.check for f in torn.findings if f.severity == "error"] == ["breakaway"]


@pytest.mark.slow
@pytest.mark.parametrize(
    "overrides",
    [
        pytest.param(("finish=hold",), marks=pytest.mark.full),
        pytest.param(("finish=unfold",), marks=pytest.mark.full),
        ("finish=tighten",),
        ("finish=hold", *TIED_ON),
        ("finish=unfold", "lay=slack"),
    ],
)
def test_every_finish_is_flown_to_its_end(overrides: tuple[str, ...]) -> None:
    network = Network(small_plan(*overrides))
    outcome = network.run(most=600.0)
    assert outcome is not None
    assert outcome.word == "done", network.words()[-8:]
    assert (
        not any(vehicle.gripped for vehicle in network.conductor.flyers) or TIED_ON[0] in overrides
    )


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        (
            "grab: attached, finish: hold",
            "m.yaml: expected vehicles.breakaway in newtons with grab: attached; "
            "for example: vehicles: {breakaway: 5}",
        ),
        (
            "grab: attached, vehicles: {breakaway: 8}",
            "m.yaml: expected finish: hold or unfold with grab: attached, because a tied-on "
            "cable is not released, got release",
        ),
        (
            "vehicles: {breakaway: 8}",
            "m.yaml: expected vehicles.breakaway only with grab: attached",
        ),
        (
            "grab: attached, finish: hold, lay: slack, vehicles: {breakaway: 8}",
            "m.yaml: expected lay: slack only with grab: floor, got grab: attached",
        ),
        ("hold_time: 1", "m.yaml:1: hold_time: expected a number >= 4 in s, got 1"),
        ("finish: drop", "m.yaml:1: finish: expected release, unfold, tighten or hold, got 'drop'"),
    ],
)
def test_incompatible_keys_are_refused(keys: str, message: str) -> None:
    text = f"{{schema: 1, name: k, knot: {{name: 3_1, chirality: left}}, {keys}}}"
    with pytest.raises(InputError) as caught:
        parse_mission(text, "m.yaml")
    assert str(caught.value) == message


def test_a_formation_of_different_heights_is_levelled_before_the_descent() -> None:
    """Only a team at one height keeps its cable's shape down to the floor."""
    text = """
schema: 1
name: steps
formation:
  lengths: [4.0, 4.0]
  places: [[[-3.0, 0.0, 4.0], [0.0, 0.0, 4.4], [3.0, 0.0, 4.0]]]
finish: hold
"""
    plan = formation_plan(mission := parse_mission(text, "steps.yaml"), mission.formation)
    heights = at(plan, "descend")[:, 2]
    np.testing.assert_allclose(heights, 4.4, atol=1e-9)
    assert [f for f in assess(plan).findings if f.severity == "error"] == []
