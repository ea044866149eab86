"""Where the clearance budget of a plan is short: computed in stages, the quickest first."""

from collections.abc import Iterator
from dataclasses import dataclass

from swarm.certification.smallest_budgets import ShortBudget, short_moments
from swarm.certification.swing_tube import pair_swings, swing_tube
from swarm.planning import Plan

COMPLETE = 2
"""The last stage, of all pairs after all changes of the clock's rate; before it are those of near
pairs, after urgent stops (0) and after all changes (1)."""


@dataclass(frozen=True)
class ShortBudgets:
    """Moments at which budgets are short, by the first ``stage`` that shows any, or else the last
    that was computed."""

    moments: tuple[ShortBudget, ...]
    stage: int

    @property
    def total(self) -> float:
        """The sum, metres: the largest does not tell one short moment from a thousand."""
        return sum(one.metres for one in self.moments)

    def less_short_than(self, other: "ShortBudgets") -> bool:
        """Whether a stage shows it later, or less of it."""
        return (-self.stage, self.total) < (-other.stage, other.total)


def short_budgets(plan: Plan, last: int = COMPLETE - 1) -> ShortBudgets:
    """Return where the budget is short by the first stage that shows it, of near pairs, and of all
    if ``last`` says so; nowhere where the mission accepts that."""
    found = ShortBudgets((), COMPLETE)
    for found in _stages(plan):
        if found.moments:
            return found
    return complete_budgets(plan) if last == COMPLETE else found


def budgets_after_urgent_stops(plan: Plan) -> ShortBudgets:
    """Return where the budget is short by the first stage alone, which shows most of it."""
    return next(_stages(plan), ShortBudgets((), COMPLETE))


def complete_budgets(plan: Plan) -> ShortBudgets:
    """Return where the budget of any pair is short; nowhere where the mission accepts that.

    It takes the whole tube, which the certificate needs too.
    """
    tube = None if plan.mission.limits.accept_negative_budget else swing_tube(plan)
    return ShortBudgets(short_moments(plan, tube.pairs) if tube else (), COMPLETE)


def _stages(plan: Plan) -> Iterator[ShortBudgets]:
    if plan.mission.limits.accept_negative_budget:
        return
    for stage, swing in enumerate(pair_swings(plan)):
        yield ShortBudgets(short_moments(plan, swing), stage)
