"""The rows of the clearance budget with the least that remains, of all pairs at all times."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from swarm.certification.budget import Budget, budget_at
from swarm.certification.clearances import segment_name
from swarm.certification.swing_tube import SwingTube
from swarm.geometry.catenary import solve_catenaries
from swarm.geometry.linear_response import linear_response
from swarm.geometry.sensitivity import BOTH_ENDS, FAR_END, NEAR_END
from swarm.planning import Plan

Floats = npt.NDArray[np.float64]

_PAIRS = 12
"""Pairs of strands whose nearest moment is evaluated with all effects: four times as many as a
report lists."""


def smallest_budgets(plan: Plan, tube: SwingTube) -> tuple[Budget, ...]:
    """Return the rows with the least that remains, one for each of up to 12 pairs of strands.

    All pairs are compared every half second while the cable is aloft, by the effects of tracking
    and swing; these rows then have all effects. Least first.
    """
    rows = _rows(plan, tube, _after_tracking_and_swing(plan, tube))
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


def short_moments(plan: Plan, tube: SwingTube) -> tuple[ShortBudget, ...]:
    """Return the moments at which budgets are short.

    At all moments the other effects of a pair count as at its moment in :func:`smallest_budgets`.
    """
    found: list[ShortBudget] = []
    left = _after_tracking_and_swing(plan, tube)
    for at, row in _rows(plan, tube, left):
        pair = tube.close.pairs[at]
        check = "neighbouring segments" if pair[1] == pair[0] + 1 else "cable clearance"
        short = left - (left[at] - row.remaining)
        at_fault = np.flatnonzero((tube.close.pairs == pair).all(axis=1) & (short < 0.0))
        found += [
            ShortBudget(
                check, float(tube.close.times[k]), -float(short[k]), float(tube.approach[k])
            )
            for k in at_fault
        ]
    return tuple(found)


def _rows(plan: Plan, tube: SwingTube, left: Floats) -> list[tuple[int, Budget]]:
    """Return the close pair of strands and the row, for each of the pairs with the least left."""
    chosen: dict[tuple[int, int], int] = {}
    for row in np.argsort(left, kind="stable").tolist():
        i, j = tube.close.pairs[row].tolist()
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
                float(tube.close.times[row]),
                required,
                tube,
            ),
        )
        for (i, j), row in chosen.items()
    ]


def _after_tracking_and_swing(plan: Plan, tube: SwingTube) -> Floats:
    """Return what tracking and swing leave of the distances of close pairs (r,), metres."""
    left: Floats = tube.close.available - tube.approach - _tracking(plan, tube)
    return left - plan.mission.clearance.cable


def _tracking(plan: Plan, tube: SwingTube) -> Floats:
    """Return the largest approach (r,) of the close pairs by tracking errors, to first order."""
    close = tube.close
    if not len(close.bins):
        return np.empty(0)
    place = plan.motion.at(close.times)[0]
    rows = np.arange(len(close.bins))
    neighbours = close.pairs[:, 1] == close.pairs[:, 0] + 1
    total = np.zeros(len(rows))
    for side, alone in enumerate((NEAR_END, FAR_END)):
        segment, fraction = close.pairs[:, side], close.fractions[:, side]
        ends, lengths = (place[rows, segment], place[rows, segment + 1]), plan.layout.lengths
        found = linear_response(
            solve_catenaries(*ends, lengths[segment]), fraction,
            np.where(neighbours, alone, BOTH_ENDS), close.normal, (fraction, fraction),
            np.zeros(len(rows)),
        )  # fmt: skip
        moved = np.where(found.known, found.at_point, 1.0)
        total += np.where(neighbours, 2.0, 1.0) * moved
    return plan.mission.vehicles.tracking * total
