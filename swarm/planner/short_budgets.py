"""Where the clearance budget of a plan is short: the quickest part of it first."""

from dataclasses import dataclass, replace

from swarm.certification.budget import ShortBudget, short_moments
from swarm.certification.clearances import Moment, PlanChecks, violations
from swarm.certification.swing_tube import PairSwing
from swarm.planning import Plan
from swarm.threads import both

_AIMED_SWING = 1.2
"""Swing, over that of the plan, for which repairs lead strands apart: each repair opens moments
beside those it mends, and urgent stops of near pairs do not show all of them. With 1.0, ten Carrick
mats that differ in last bits took 3 to 6 checked plans, 16 s, and fold in 267 to 274 s; with 1.2, 2
to 4 plans, 12 s, and 270 to 278 s."""


@dataclass(frozen=True)
class ShortBudgets:
    """Moments at which budgets are short, and at which repairs aim: short with 1.2 times the swing.

    They are ``complete`` of all pairs after all changes of the clock's rate, or of near pairs after
    urgent stops, which show most of it.
    """

    moments: tuple[ShortBudget, ...]
    aims: tuple[ShortBudget, ...]
    complete: bool

    @property
    def total(self) -> float:
        """The sum, metres: the largest does not tell one short moment from a thousand."""
        return sum(moment.metres for moment in self.moments)

    def less_short_than(self, other: "ShortBudgets") -> bool:
        """Whether only the complete budget shows it, or less of it."""
        return (not self.complete, self.total) < (not other.complete, other.total)


def short_budgets(plan: Plan, *, complete: bool) -> ShortBudgets:
    """Return where the budget is short after urgent stops, or where it is not, and all of it is
    asked for, where it is at all."""
    budgets = budgets_after_urgent_stops(plan)
    return budgets if budgets.moments or not complete else complete_budgets(plan)


def checked_clearances(plan: Plan) -> tuple[Moment, ...]:
    """Return the moments at which clearances do not hold.

    Meanwhile, begin the swings that tell where budgets are short; where clearances are certified in
    the tube, these begin with it.
    """
    if _accepted(plan) or plan.mission.fold.certifies_swing:
        return violations(plan)
    return both(lambda: violations(plan), lambda: PlanChecks.of(plan).planned_swings)[0]


def budgets_after_urgent_stops(plan: Plan) -> ShortBudgets:
    """Return where the budget of near pairs is short; nowhere where the mission accepts that."""
    swing = None if _accepted(plan) else PlanChecks.of(plan).swing_after_urgent_stops()
    return _short(plan, swing, complete=_accepted(plan))


def complete_budgets(plan: Plan) -> ShortBudgets:
    """Return where the budget of any pair is short; nowhere where the mission accepts that.

    It takes the whole tube, which the certificate needs too.
    """
    tube = None if _accepted(plan) else PlanChecks.of(plan).tube
    return _short(plan, tube.pairs if tube else None, complete=True)


def _short(plan: Plan, swing: PairSwing | None, *, complete: bool) -> ShortBudgets:
    if swing is None:
        return ShortBudgets((), (), complete)
    wider = replace(swing, approach=_AIMED_SWING * swing.approach)
    return ShortBudgets(short_moments(plan, swing), short_moments(plan, wider), complete)


def _accepted(plan: Plan) -> bool:
    return plan.mission.limits.accept_negative_budget
