"""The chains with which the swing of a plan is simulated: finer where the cable bends narrowly."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from swarm.certification.clearances import PlanChecks
from swarm.certification.swing_runs import STEP, aloft, model_of, strands_of, swings
from swarm.flight.swinging import SwingEstimator
from swarm.geometry.lumped_mass import cable_model
from swarm.mission import mission_for_knot, parse_mission
from swarm.planner.pacing import slowed_for_swing, timed_for_losses
from swarm.planning import Plan
from swarm.planning.candidates import make_plan
from swarm.planning.shaping import COMPARED, steps_between_compared
from tests.geometry.swinging import stray, swing
from tests.shared import shared

FIVE = Path(__file__).parents[2] / "missions" / "overhand_five.yaml"


@shared
def shaped_with_five() -> Plan:
    """The overhand of five vehicles, with a segment of 12 m: shaped, not certified."""
    plan = make_plan(parse_mission(FIVE.read_text(encoding="utf-8"), str(FIVE)))
    return slowed_for_swing(timed_for_losses(plan)).plan


@pytest.fixture(scope="module")
def bent() -> Plan:
    return shaped_with_five()


def accepting(plan: Plan) -> Plan:
    limits = plan.mission.limits.model_copy(update={"accept_negative_budget": True})
    return replace(plan, mission=plan.mission.model_copy(update={"limits": limits}))


def test_narrow_bends_have_twice_the_links_at_half_the_step(bent: Plan) -> None:
    model = model_of(bent)
    assert (model.links, model.step) == (48, STEP / 2)
    estimator = SwingEstimator.of(bent)
    assert estimator is not None
    assert (estimator.model.links, estimator.model.step) == (48, STEP / 4)
    few, many = strands_of(bent)
    assert (few.model.links, few.model.step) == (24, STEP)
    assert sorted([*few.segments, *many.segments]) == list(range(bent.vehicles - 1))
    lengths = bent.layout.lengths
    assert lengths[many.segments].min() > np.median(lengths), "long segments bend narrowly"


def test_few_links_are_kept_where_a_negative_budget_is_accepted(bent: Plan) -> None:
    model = model_of(accepting(bent))
    assert (model.links, model.step) == (24, STEP)


def test_wide_bends_keep_few_links() -> None:
    plan = make_plan(mission_for_knot("overhand", ["limits.accept_negative_budget=false"]))
    model = model_of(plan)
    assert (model.links, model.step) == (24, STEP)


def test_swings_are_compared_at_the_same_moments_with_either_step(bent: Plan) -> None:
    span = aloft(bent)
    assert span is not None
    finer = next(swings(bent, span))
    coarser = next(swings(accepting(bent), span))
    assert finer.times == pytest.approx(coarser.times)
    assert np.diff(finer.times[0])[:-1] == pytest.approx(COMPARED)
    few = strands_of(bent)[0].segments
    assert finer.strays[..., few, ::2, :] == pytest.approx(coarser.strays[..., few, :, :], abs=1e-5)


def test_strays_are_interpolated_between_the_joints_of_few_links(bent: Plan) -> None:
    span = aloft(bent)
    assert span is not None
    few, many = (strands.segments for strands in strands_of(bent))
    strays = next(swings(bent, span)).strays
    within = 0.5 * (strays[..., :-2:2, :] + strays[..., 2::2, :])
    assert strays[..., 1::2, :][:, :, few] == pytest.approx(within[:, :, few], abs=1e-12)
    assert np.abs(strays[..., 1::2, :] - within)[:, :, many].max() > 1e-3


def test_the_tube_of_finer_chains_contains_still_finer_ones(bent: Plan) -> None:
    tube, lengths, fold = PlanChecks.of(bent).tube, bent.layout.lengths, bent.phase("fold")
    assert tube is not None
    cable = bent.mission.cable
    model = replace(cable_model(cable.mass_per_length, cable.diameter), links=96, step=0.0025)
    times = np.arange(fold.start, fold.end, model.step)
    ends, every = bent.motion.at(times)[0], steps_between_compared(model)
    strays = stray(swing(ends, lengths, model, every), ends[::every], lengths)
    allowed = np.array([tube.ordinary.strands(float(time)) for time in times[::every]])
    assert (strays <= allowed).all(), (strays - allowed).max()
