"""Repair of a schedule: larger margins at the moments where the certificate finds shortfalls."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from swarm.folding.schedule import Schedule, require_extra
from swarm.planning.foldings import SAMPLING_ERROR, Folding
from swarm.planning.plan import Plan

_LARGEST_STEP = 0.2
"""Largest increase of a margin in one repair, metres: the bounds of a failed check may be loose."""


@dataclass(frozen=True)
class Shortfall:
    """A moment of a plan at which a check misses the required value by ``metres``.

    ``margin`` is the field of :class:`swarm.folding.penalty.ExtraMargins` that a repair enlarges
    for it; None where none helps.
    """

    margin: str | None
    time: float
    metres: float


def with_larger_margins(folding: Folding, plan: Plan, shortfalls: Sequence[Shortfall]) -> Schedule:
    """Return the folding's schedule with margins enlarged around the shortfalls of its plan.

    Each margin grows by 1.1 times the shortfall and the error of sampled distances; where it was
    enlarged before, at least to twice that increase. The schedule does not keep the new margins
    before it is improved.
    """
    schedule = folding.schedule
    stages = np.arange(4.0 * schedule.last_stage) / 4.0
    places = schedule.at(stages)[0] + (plan.layout.corners[0] - folding.layout.corners[0])
    places = places.reshape(len(stages), -1)
    for margin in dict.fromkeys(each.margin for each in shortfalls if each.margin is not None):
        short = [(each.time, each.metres) for each in shortfalls if each.margin == margin]
        times, metres = np.array(short).T
        # pairs that are short at the same time share a row: thousands have a few hundred times
        moments, which = np.unique(times, return_inverse=True)
        teams = plan.motion.places(moments).reshape(len(moments), -1)
        apart = scipy.spatial.distance.cdist(teams, places, "sqeuclidean")
        at = stages[np.argmin(apart, axis=1)][which]
        # Where an earlier increase was not enough, double it.
        before = getattr(schedule.extra, margin)[at.astype(np.intp)]
        increase = np.minimum(np.maximum(1.1 * metres + SAMPLING_ERROR, before), _LARGEST_STEP)
        schedule = require_extra(schedule, margin, at, increase)
    return schedule
