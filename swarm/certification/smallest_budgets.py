"""The rows of the clearance budget with the least that remains, of all pairs at all times."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from swarm.certification.approaches import PairSwing
from swarm.certification.budget import Budget, budget_at
from swarm.certification.clearances import segment_name
from swarm.planning import Plan

Floats = npt.NDArray[np.float64]

_PAIRS = 12
"""Pairs of strands whose nearest moment is evaluated with all effects: four times as many as a
report lists."""


def smallest_budgets(plan: Plan, swing: PairSwing) -> tuple[Budget, ...]:
    """Return the rows with the least that remains, one for each of up to 12 pairs of strands.

    All pairs are compared every half second while the cable is aloft, by the effects of tracking
    and swing; these rows then have all effects. Least first.
    """
    rows = _rows(plan, swing, swing.close.left - swing.approach)
    return tuple(sorted((row for _, row in rows), key=lambda row: row.remaining))


@dataclass(frozen=True)
class ShortBudget:
    """A moment at which the budget of two strands is short, by ``metres``.

    ``check`` is the check of their distance; ``swing`` how much nearer they come by swinging.
    """

    check: str
    time: float
    metres: float
    swing: float


def short_moments(plan: Plan, swing: PairSwing) -> tuple[ShortBudget, ...]:
    """Return the moments at which budgets are short.

    At all moments the other effects of a pair count as at its moment in :func:`smallest_budgets`.
    """
    found: list[ShortBudget] = []
    close, left = swing.close, swing.close.left - swing.approach
    for at, row in _rows(plan, swing, left):
        pair = close.pairs[at]
        check = "neighbouring segments" if pair[1] == pair[0] + 1 else "cable clearance"
        short = left - (left[at] - row.remaining)
        at_fault = np.flatnonzero((close.pairs == pair).all(axis=1) & (short < 0.0))
        found += [
            ShortBudget(check, float(close.times[k]), -float(short[k]), float(swing.approach[k]))
            for k in at_fault
        ]
    return tuple(found)


def _rows(plan: Plan, swing: PairSwing, left: Floats) -> list[tuple[int, Budget]]:
    """Return the close pair of strands and the row, for each of the pairs with the least left."""
    chosen: dict[tuple[int, int], int] = {}
    for row in np.argsort(left, kind="stable").tolist():
        i, j = swing.close.pairs[row].tolist()
        chosen.setdefault((i, j), row)
        if len(chosen) == _PAIRS:
            break
    required = plan.mission.clearance.cable
    return [
        (
            row,
            budget_at(
                plan,
                (segment_name(i), segment_name(j)),
                float(swing.close.times[row]),
                required,
                swing,
            ),
        )
        for (i, j), row in chosen.items()
    ]
