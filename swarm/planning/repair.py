"""What a plan falls short of, as its certificate says, and asking its schedule for more there."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from swarm.folding.schedule import Schedule, require_extra
from swarm.planning.plan import Plan
from swarm.planning.shapes import SAMPLING, Folding


@dataclass(frozen=True)
class Shortfall:
    """A moment at which a plan falls short of what a check asks, by metres."""

    check: str
    time: float
    metres: float


Shortfalls = Sequence[Shortfall]


def with_more(folding: Folding, made: Plan, missing: Shortfalls) -> Schedule:
    """A folding's schedule, asked for more where its plan falls short, by that and a little."""
    plan = folding.plan
    stages = np.arange(4.0 * plan.last_stage) / 4.0
    places = plan.at(stages)[0] + (made.layout.corners[0] - folding.layout.corners[0])
    for check, margin in MENDABLE.items():
        found = [(each.time, each.metres) for each in missing if each.check == check]
        if found:
            times, metres = np.array(found).T
            apart = made.motion.at(times)[0][:, None] - places
            at = stages[np.argmin((apart**2).sum(axis=(2, 3)), axis=1)]
            # What was asked for there before was not enough: twice as much, then.
            before = getattr(plan.extra, margin)[at.astype(np.intp)]
            asked = np.minimum(np.maximum(1.1 * metres + SAMPLING, before), _MOST)
            plan = require_extra(plan, margin, at, asked)
    return plan


MENDABLE = {
    "cable clearance": "cable",
    "neighbouring segments": "neighbour",
    "vehicle clearance": "vehicle",
    "vehicle-cable clearance": "vehicle_cable",
    "rotor disc": "rotor_disc",
    "taut": "chord",
}
"""What is asked for where a check fails."""

_MOST = 0.2
"""Metres that are asked for at once: bounds of a certificate that fails may be far from tight."""
