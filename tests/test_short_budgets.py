"""Where budgets are short: stages that are computed one after the other."""

from dataclasses import replace

import pytest

from swarm.certification.smallest_budgets import ShortBudget
from swarm.planner.short_budgets import COMPLETE, ShortBudgets, complete_budgets, short_budgets
from swarm.planning import Plan
from tests.overhand import planned_overhand


def short(stage: int, *metres: float) -> ShortBudgets:
    return ShortBudgets(
        tuple(ShortBudget("cable clearance", 30.0, each, 0.1) for each in metres), stage
    )


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
        (short(0, 0.01), short(0, 0.005, 0.006)),
        (short(1, 0.3), short(0, 0.1)),
        (short(COMPLETE, 0.3), short(1, 0.1)),
    ],
)
def test_a_budget_is_less_short_where_a_later_stage_shows_it_or_less_of_it(
    one: ShortBudgets, other: ShortBudgets
) -> None:
    assert one.less_short_than(other)
    assert not other.less_short_than(one)
    assert not one.less_short_than(one)


def test_a_budget_that_closes_is_computed_for_near_pairs_and_for_all_where_asked_for() -> None:
    plan = planned_overhand().plan
    assert short_budgets(plan) == ShortBudgets((), COMPLETE - 1)
    assert short_budgets(plan, COMPLETE) == complete_budgets(plan) == ShortBudgets((), COMPLETE)


def test_a_budget_that_is_short_after_urgent_stops_is_not_computed_further() -> None:
    plan = planned_overhand().plan
    remaining = min(row.remaining for row in planned_overhand().assessment.budget)
    larger = plan.mission.clearance.cable + remaining + 0.05
    found, every = (
        compute(with_clearance(plan, larger)) for compute in (short_budgets, complete_budgets)
    )
    assert found.stage == 0
    assert 0 < len(found.moments) <= len(every.moments)
    assert 0.0 < found.total <= every.total + 1e-9


def test_a_budget_that_is_accepted_is_not_computed() -> None:
    accepted = with_clearance(planned_overhand().plan, 1.0, accepted=True)
    assert short_budgets(accepted) == complete_budgets(accepted) == ShortBudgets((), COMPLETE)
