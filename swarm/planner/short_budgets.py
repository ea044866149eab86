"""Where the clearance budget of a plan is short: the quickest part of it first."""

from dataclasses import dataclass

from swarm.certification.clearances import Moment, violations
from swarm.certification.smallest_budgets import ShortBudget, short_moments
from swarm.certification.swing_tube import begin_swings, swing_after_urgent_stops, swing_tube
from swarm.planning import Plan
from swarm.threads import both


@dataclass(frozen=True)
class ShortBudgets:
    """Moments at which budgets are short: ``complete`` of all pairs after all changes of the
    clock's rate, or of near pairs after urgent stops, which show most of it."""

    moments: tuple[ShortBudget, ...]
    complete: bool

    @property
    def total(self) -> float:
        """The sum, metres: the largest does not tell one short moment from a thousand."""
        return sum(one.metres for one in self.moments)

    def less_short_than(self, other: "ShortBudgets") -> bool:
        """Whether only the complete budget shows it, or less of it."""
        return (not self.complete, self.total) < (not other.complete, other.total)


def short_budgets(plan: Plan, *, complete: bool) -> ShortBudgets:
    """Return where the budget is short after urgent stops, or where it is not, and all of it is
    asked for, where it is at all."""
    found = budgets_after_urgent_stops(plan)
    return found if found.moments or not complete else complete_budgets(plan)


def checked_clearances(plan: Plan) -> tuple[Moment, ...]:
    """Return the moments at which clearances do not hold.

    Meanwhile, begin the swings that tell where budgets are short; where clearances are certified in
    the tube, these begin with it.
    """
    if _accepted(plan) or plan.mission.fold.certifies_swing:
        return violations(plan)
    return both(lambda: violations(plan), lambda: begin_swings(plan))[0]


def budgets_after_urgent_stops(plan: Plan) -> ShortBudgets:
    """Return where the budget of near pairs is short; nowhere where the mission accepts that."""
    swing = None if _accepted(plan) else swing_after_urgent_stops(plan)
    return ShortBudgets(short_moments(plan, swing) if swing else (), _accepted(plan))


def complete_budgets(plan: Plan) -> ShortBudgets:
    """Return where the budget of any pair is short; nowhere where the mission accepts that.

    It takes the whole tube, which the certificate needs too.
    """
    tube = None if _accepted(plan) else swing_tube(plan)
    return ShortBudgets(short_moments(plan, tube.pairs) if tube else (), complete=True)


def _accepted(plan: Plan) -> bool:
    return plan.mission.limits.accept_negative_budget
