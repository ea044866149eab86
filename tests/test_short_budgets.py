"""Where budgets are short: after urgent stops of near pairs first, then at all."""

from dataclasses import replace

import pytest

from swarm.certification.budget import ShortBudget
from swarm.planner.short_budgets import (
    ShortBudgets,
    budgets_after_urgent_stops,
    complete_budgets,
    short_budgets,
)
from swarm.planning import Plan
from tests.overhand import planned_overhand


def short(complete: bool, *metres: float) -> ShortBudgets:
    moments = tuple(ShortBudget("cable clearance", 30.0, each, 0.1) for each in metres)
    return ShortBudgets(moments, moments, complete)


def with_clearance(plan: Plan, metres: float, *, accepted: bool = False) -> Plan:
    """The same motion where strands have to keep another distance."""
    mission = plan.mission
    clearance = mission.clearance.model_copy(update={"cable": metres})
    limits = mission.limits.model_copy(update={"accept_negative_budget": accepted})
    changed = mission.model_copy(update={"clearance": clearance, "limits": limits})
    return replace(plan, mission=changed)


@pytest.mark.parametrize(
    ("one", "other"),
    [
        (short(False, 0.01), short(False, 0.005, 0.006)),
        (short(True, 0.3), short(False, 0.1)),
    ],
)
def test_a_budget_is_less_short_where_only_all_of_it_shows_it_or_less_of_it(
    one: ShortBudgets, other: ShortBudgets
) -> None:
    assert one.less_short_than(other)
    assert not other.less_short_than(one)
    assert not one.less_short_than(one)


def test_a_budget_that_closes_is_computed_for_near_pairs_and_for_all_where_asked_for() -> None:
    plan = planned_overhand().plan
    near = ShortBudgets((), (), complete=False)
    assert short_budgets(plan, complete=False) == budgets_after_urgent_stops(plan) == near
    every = ShortBudgets((), (), complete=True)
    assert short_budgets(plan, complete=True) == complete_budgets(plan) == every


def test_a_budget_that_is_short_after_urgent_stops_is_not_computed_further() -> None:
    plan = planned_overhand().plan
    # 0.05 m more are not enough: of neighbours a larger clearance exempts more cable, too
    larger = plan.mission.clearance.cable + 0.25
    short = with_clearance(plan, larger)
    found, every = short_budgets(short, complete=True), complete_budgets(short)
    assert not found.complete
    assert 0 < len(found.moments) <= len(every.moments)
    assert 0.0 < found.total <= every.total + 1e-9


def test_repairs_aim_at_moments_that_are_short_with_more_swing_too() -> None:
    plan = planned_overhand().plan
    found = budgets_after_urgent_stops(with_clearance(plan, plan.mission.clearance.cable + 0.2))
    aims = {(one.check, one.time) for one in found.aims}
    assert aims > {(one.check, one.time) for one in found.moments}
    assert sum(one.metres for one in found.aims) > found.total


def test_a_budget_that_is_accepted_is_not_computed() -> None:
    accepted = with_clearance(planned_overhand().plan, 1.0, accepted=True)
    for complete in False, True:
        assert short_budgets(accepted, complete=complete) == ShortBudgets((), (), complete=True)
