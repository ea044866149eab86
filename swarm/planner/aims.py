"""What repairs aim at: more than where budgets are short and vehicles sink too far in jets."""

from collections.abc import Sequence
from dataclasses import replace

from swarm.certification.air import sinkings
from swarm.certification.budget import ShortBudget
from swarm.certification.kinds import kind_of
from swarm.planner.short_budgets import ShortBudgets
from swarm.planning import Plan
from swarm.planning.repair import Shortfall

RESERVE = 0.01
"""Metres that repairs for a budget aim beyond what it is short of: repairs that aim at nothing left
over ended 3 to 9 mm short, because each also moves the moments beside it."""

_SINKING = 0.9
"""Share of the allowed sinking that repairs aim at: what mends others moves vehicles into jets."""

_ASIDE = 3.0
"""Metres aside for a metre less of sinking: 3 m below a vehicle of 0.2 m radius, 0.1 m aside take a
quarter of the jet's speed, and so of 0.13 m of sinking. With 1, three repairs of the Carrick mat
took 29 mm to 25 mm; with 3, two of them took it to 0."""


def aims(plan: Plan, budget: ShortBudgets | None, share: float = 1.0) -> list[Shortfall]:
    """Return the shortfalls for which margins grow, for a share of what repairs aim at."""
    short = as_shortfalls(budget.aims) if budget else []
    led = [(lack, 1.0) for lack in short] + [(lack, _ASIDE) for lack in sinking(plan, _SINKING)]
    return [replace(lack, metres=aside * share * (lack.metres + RESERVE)) for lack, aside in led]


def as_shortfalls(moments: Sequence[ShortBudget]) -> list[Shortfall]:
    """Return moments at which budgets are short as shortfalls of their checks."""
    return [Shortfall(kind_of(lack.check).margin, lack.time, lack.metres) for lack in moments]


def sinking(plan: Plan, share: float = 1.0) -> list[Shortfall]:
    """Return where vehicles sink in the jets of others by more than a share of their tracking
    radius."""
    allowed = share * plan.mission.vehicles.tracking
    moments = sinkings(plan, allowed) if allowed else []
    return [Shortfall("jet", moment.time, moment.depth - allowed) for moment in moments]


def total(shortfalls: Sequence[Shortfall]) -> float:
    """Return the sum, metres: the largest does not tell one short moment from a thousand."""
    return sum(shortfall.metres for shortfall in shortfalls)
