"""Repairs of a candidate: checked, repaired and checked again, until one keeps all clearances."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from swarm.certification.clearances import Moment, violations
from swarm.certification.kinds import kind_of
from swarm.folding.schedule import Flown
from swarm.planner.aims import RESERVE, aims, as_shortfalls, sinking, total
from swarm.planner.pacing import (
    PacedPlan,
    exceeds_endurance,
    slowed_for_stops,
    slowed_for_swing,
    timed_for_losses,
)
from swarm.planner.short_budgets import (
    ShortBudgets,
    budgets_after_urgent_stops,
    checked_clearances,
    complete_budgets,
    short_budgets,
)
from swarm.planning import Plan
from swarm.planning.candidates import Candidate, repairable, repaired
from swarm.planning.flown import flown_stages
from swarm.planning.repair import Shortfall

_BUDGET_ROUNDS, _JET_ROUNDS, _ROUNDS_SEARCHED = 4, 8, 10
"""Largest number of repairs of a plan for its budget, and for jets once that closes, and of a
searched motion: the eighth led a vehicle of the square knot around a jet of 0.15 m of sinking, and
one of 4_1 with 7, after four that changed little."""

_IDLE_ROUNDS = 2
"""Repairs that changed nothing after which the next one is not tried: margins grow with each, but
none of five led vehicles of 10_1 around their jets."""

_LONGER, _LONGER_SEARCHED = 1.3, 1.5
"""Most that a fold may take longer for its budget. A repair that lost setpoints slow down by more
is none, and slowing by more closed no budget of a grid: the Carrick mat's was still short at twice.
It closed that of 8_18 with 10, a searched motion, at 1.36."""

_SLOWED, _MOST_EXCESS = 6, 2.0
"""Rounds in which a plan is slowed for its budget, and the largest excess of the swing of one: a
rate of half."""

_NEARLY_CLOSED = 0.03
"""Metres in all up to which another repair is expected to close what a budget is short of."""

_SHARES = (1.0, 0.5, 0.25)
"""Shares of what a budget is short of that are tried to be repaired at once."""


@dataclass(frozen=True)
class Kept:
    """A candidate whose plan keeps all clearances, and where its ``budget`` is short.

    None where that is not computed yet, because the budget closed before repairs for jets alone.
    ``sinking`` is where a vehicle sinks in the jet of another by more than the tracking radius;
    ``shares`` are those of both that no repair has tried yet.
    """

    candidate: Candidate
    paced: PacedPlan
    budget: ShortBudgets | None
    sinking: Sequence[Shortfall]
    shares: tuple[float, ...] = _SHARES

    @property
    def shortfalls(self) -> list[Shortfall]:
        """What a repair should mend."""
        return [*(as_shortfalls(self.budget.moments) if self.budget else ()), *self.sinking]

    @property
    def short(self) -> bool:
        """Whether its budget is known to be short."""
        return self.budget is not None and bool(self.budget.moments)

    @property
    def closes(self) -> bool:
        """Whether its whole budget is known to close."""
        return self.budget is not None and not self.short and self.budget.complete

    def with_budget(self) -> "Kept":
        """Return it with its budget, of all pairs unless that of near ones is short.

        Its repairs are not tried yet where it is found to be short.
        """
        if self.short or self.closes:
            return self
        budget = complete_budgets(self.paced.plan)
        return replace(self, budget=budget, shares=_SHARES if budget.moments else self.shares)


@dataclass(frozen=True)
class Unfinished:
    """The last candidate of a folding, timed, and where it is short of clearances."""

    candidate: Candidate
    paced: PacedPlan
    shortfalls: Sequence[Shortfall]

    @property
    def short(self) -> float:
        """The sum of what it is short of, metres."""
        return total(self.shortfalls)

    def repaired(self) -> Candidate | None:
        """Return the next candidate of the folding, whose repairs are counted anew."""
        flown = _flown(self.candidate, self.paced)
        candidate = _repaired(replace(self.candidate, attempt=0), self.shortfalls, flown)
        return candidate and replace(candidate, notes=("repaired further",))


@dataclass(frozen=True)
class Repairs:
    """What became of a candidate and its repairs.

    ``kept`` are those that keep all clearances; ``first`` is the first that was checked, of
    ``attempts``; plans ``too_long`` were not. ``unfinished`` is what was left where the repairs ran
    out.
    """

    kept: Sequence[Kept]
    first: PacedPlan | None
    too_long: Sequence[Plan]
    unfinished: Unfinished | None
    attempts: int
    notes: tuple[str, ...]


def repair(candidate: Candidate, notes: tuple[str, ...], allowed: int) -> Repairs:
    """Check a candidate, and repair it until a repair is no longer possible or wanted.

    At most ``allowed`` plans are checked. Where clearances fail, a repair mends these, and what the
    clearance budget is short of, and leads vehicles around jets, all at once; once all hold, the
    latter two, as far as that goes.
    """
    longer = _longer(candidate)
    kept: list[Kept] = []
    first: PacedPlan | None = None
    too_long: list[Plan] = []
    failures: tuple[Moment, ...] = ()
    attempts = 0
    tried: Candidate | None = candidate
    last: Unfinished | None = None
    while tried is not None and attempts < allowed:
        notes += tried.notes
        paced, failures = _checked(replace(tried.plan, notes=notes), searched=tried.searched)
        tried = replace(tried, plan=paced.plan)
        if exceeds_endurance(paced.plan):
            notes += (_too_long(paced.plan),)
            too_long.append(paced.plan)
            tried = None
        else:
            attempts += 1
            first = first or paced
            if failures:
                last = Unfinished(tried, paced, [_shortfall(moment) for moment in failures])
                tried = _repaired_at_once(tried, paced, failures)
            else:
                if not kept or _fold_time(paced.plan) <= longer * _fold_time(kept[0].paced.plan):
                    kept.append(_keep(tried, paced, kept))
                tried = None
        if tried is None and kept:
            tried, kept = _repaired_again(kept)
    notes += _why_not(failures) if candidate.searched and failures and not kept else ()
    ended = last is not None and bool(failures) and not kept and last.candidate.last_attempt
    return Repairs(kept, first, too_long, last if ended else None, attempts, notes)


def _repaired_at_once(
    candidate: Candidate, paced: PacedPlan, failures: Sequence[Moment]
) -> Candidate | None:
    """Return the next candidate after one that fails, with a short budget and jets mended too.

    Where that cannot be, or nothing else is short, the clearances alone are. Repaired one after the
    other, each opens those before it again: the overhand took 10 repairs, and 2 at once.
    """
    short = [_shortfall(moment) for moment in failures]
    if not repairable(candidate, short):
        return None
    budget = budgets_after_urgent_stops(paced.plan)
    others = aims(paced.plan, budget)
    flown = _flown(candidate, paced)
    successor = _repaired(candidate, [*short, *others], flown) if others else None
    return successor or _repaired(candidate, short, flown)


def _flown(candidate: Candidate, paced: PacedPlan) -> Flown | None:
    """Return how a candidate is flown as its plan is paced; None where only its path is repaired.

    A shaped motion is not on its path: repairs on the path alone moved what others had mended, and
    the Carrick mat took 11 of them instead of 4. Searched motions have room to spare: with repairs
    on both, the fold of the overhand with five takes 36.8 s instead of 33.7 s, and holds up to
    0.127 m (e*) instead of 0.144 m.
    """
    if candidate.folding is None or candidate.searched or paced.pacing is None:
        return None
    return flown_stages(candidate.folding.schedule, paced.pacing.paced, paced.pacing.shaper)


def _repaired(
    candidate: Candidate, shortfalls: Sequence[Shortfall], flown: Flown | None
) -> Candidate | None:
    """Return the next candidate, repaired on its path and as it is flown, or else on its path.

    Where a motion misses too much as it is flown, its path may still be repaired: that of 6_1 was.
    """
    successor = repaired(candidate, shortfalls, flown) if flown else None
    return successor or repaired(candidate, shortfalls)


def _repaired_again(kept: Sequence[Kept]) -> tuple[Candidate | None, list[Kept]]:
    """Return the next candidate after plans that keep all clearances, and these.

    The complete budget of the last is computed once nothing is left to repair without it: it takes
    the longest of all, and repairs for jets alone seldom open it again. Where it stays short, the
    best plan is slowed for it, and then repaired for jets alone.
    """
    *before, last = kept
    candidate = None
    if len(kept) <= _rounds(last) and not _idle(kept):
        candidate, last = _led_apart(last)
    if candidate is None and not last.short and not last.closes:
        return _repaired_again([*before, last.with_budget()])
    slowed = _closed_by_slowing([*before, last]) if candidate is None and last.short else None
    return _repaired_again([*before, last, slowed]) if slowed else (candidate, [*before, last])


def _closed_by_slowing(kept: Sequence[Kept]) -> Kept | None:
    """Return a plan slowed until its budget closes: the best one, or the last repaired for jets.

    None where that is not enough, or where no jets are left to repair.
    """
    closed = [plan for plan in kept if plan.budget is not None and not plan.short]
    best = kept[-1] if closed else least_short(kept)
    if not closed and not best.sinking:
        return None
    paced, budget = _slowed(best)
    return None if budget.moments else Kept(best.candidate, paced, budget, sinking(paced.plan))


def _rounds(kept: Kept) -> int:
    """Return the largest number of repairs of plans that keep all clearances."""
    if kept.candidate.searched:
        return _ROUNDS_SEARCHED
    return _BUDGET_ROUNDS if kept.short else _JET_ROUNDS


def _idle(kept: Sequence[Kept]) -> bool:
    """Whether the last repairs changed nothing."""
    last = [plan.shortfalls for plan in kept[-1 - _IDLE_ROUNDS :]]
    return len(last) > _IDLE_ROUNDS and last.count(last[0]) == len(last)


def _longer(candidate: Candidate) -> float:
    return _LONGER_SEARCHED if candidate.searched else _LONGER


def _checked(plan: Plan, *, searched: bool) -> tuple[PacedPlan, tuple[Moment, ...]]:
    """Return the plan timed, and the moments at which it fails; unchecked where it is too long.

    A plan is checked as it is flown, slowed for the swing; before that too, where it was searched:
    slowing hides what repairs can mend. Slowed first, the overhand with five holds up to 0.109 m
    (e*) instead of 0.144 m, and its fold takes 37 s instead of 33 s. And where it would be too long
    when slowed, since a repair may make it shorter.
    """
    paced = timed_for_losses(plan)
    if exceeds_endurance(paced.plan):
        return paced, ()
    failures = violations(paced.plan, swinging=False) if searched else ()
    if failures:
        return paced, failures
    slowed = slowed_for_swing(paced)
    if not exceeds_endurance(slowed.plan):
        return slowed, checked_clearances(slowed.plan)
    failures = () if searched else violations(paced.plan, swinging=False)
    return (paced, failures) if failures else (slowed, ())


def _why_not(failures: Sequence[Moment]) -> tuple[str, ...]:
    """Return a note on the failing moment at which a folding was given up."""
    worst = min(failures, key=lambda moment: moment.margin)
    return (
        f"given up: {worst.check} of {worst.between[0]} and {worst.between[1]} short by "
        f"{-worst.margin:.2f} m",
    )


def _shortfall(moment: Moment) -> Shortfall:
    return Shortfall(kind_of(moment.check).margin, moment.time, -moment.margin)


def least_short(kept: Sequence[Kept]) -> Kept:
    """Return the plan whose budget is short by the least, and of these with the least sinking."""
    plans: list[Kept] = []
    for plan in sorted(kept, key=lambda plan: total(plan.sinking)):
        plans.append(plan.with_budget())
        if plans[-1].closes:
            return plans[-1]
    return min(plans, key=lambda plan: plan.budget.total if plan.budget else 0.0)


def _fold_time(plan: Plan) -> float:
    return plan.phase("fold").duration


def _keep(candidate: Candidate, paced: PacedPlan, before: Sequence[Kept]) -> Kept:
    """Return what is kept, with its budget unless that of the plan before it closes."""
    last = before[-1].budget if before else None
    nearly = last is not None and last.total < _NEARLY_CLOSED
    of_plan = complete_budgets if nearly else budgets_after_urgent_stops
    budget = of_plan(paced.plan) if not before or before[-1].short else None
    # repairs are counted anew from a plan that keeps all clearances
    return Kept(replace(candidate, attempt=0), paced, budget, sinking(paced.plan))


def slowed_for_budget(kept: Kept) -> PacedPlan:
    """Return the plan, slowed where its budget is short, while that makes it less so."""
    return _slowed(kept)[0]


def _slowed(kept: Kept) -> tuple[PacedPlan, ShortBudgets]:
    """Return the plan as :func:`slowed_for_budget`, and where it stays short.

    Of all pairs where that was known, so that slowing ends where they stay short.
    """
    best, budget = kept.paced, kept.budget or budgets_after_urgent_stops(kept.paced.plan)
    longest = _longer(kept.candidate) * _fold_time(best.plan)
    for _ in range(_SLOWED):
        if not budget.moments:
            break
        short = [(moment.time, moment.metres, moment.swing) for moment in budget.moments]
        times, metres, swing = np.array(short).T
        excess = swing / np.maximum(swing - metres - RESERVE, swing / _MOST_EXCESS)
        paced = slowed_for_stops(best, times, excess)
        if exceeds_endurance(paced.plan) or _fold_time(paced.plan) > longest:
            break
        if violations(paced.plan):
            break
        shortage = short_budgets(paced.plan, complete=budget.complete)
        if shortage.moments and not shortage.less_short_than(budget):
            break
        best, budget = paced, shortage
    return best, budget


def _led_apart(kept: Kept) -> tuple[Candidate | None, Kept]:
    """Return the candidate with strands farther apart, by as much as can be repaired at once.

    None where no share that is left can be; the plan is returned with those that are left then.
    """
    shares = kept.shares if kept.shortfalls else ()
    flown = _flown(kept.candidate, kept.paced) if shares else None
    for number, share in enumerate(shares, start=1):
        wanted = aims(kept.paced.plan, kept.budget, share)
        candidate = _repaired(kept.candidate, wanted, flown)
        if candidate is not None:
            return candidate, replace(kept, shares=kept.shares[number:])
    return None, replace(kept, shares=())


def _too_long(plan: Plan) -> str:
    endurance = plan.mission.vehicles.endurance
    return f"that took {plan.flight_duration:.0f} s of {endurance:g} s in the air"
