"""The plan, and how it is made from a mission."""

from swarm.plans.digest import digest
from swarm.plans.make import candidates, make_plan
from swarm.plans.mending import Shortfall
from swarm.plans.plan import (
    CableState,
    Condition,
    Gate,
    KnotSummary,
    Layout,
    Phase,
    PhaseName,
    Plan,
)

__all__ = [
    "CableState",
    "Condition",
    "Gate",
    "KnotSummary",
    "Layout",
    "Phase",
    "PhaseName",
    "Plan",
    "Shortfall",
    "candidates",
    "digest",
    "make_plan",
]
