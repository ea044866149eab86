"""The plan, and how it is made from a mission."""

from swarm.planning.digest import digest
from swarm.planning.plan import (
    CableState,
    Condition,
    Gate,
    KnotSummary,
    Layout,
    Phase,
    PhaseName,
    Plan,
)
from swarm.planning.planner import candidates, make_plan
from swarm.planning.repair import Shortfall

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
