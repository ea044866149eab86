"""The plan, and its computation from a mission.

Only the plan itself is imported here: a flight reads plans and does not make any.
"""

from swarm.folding.layout import KnotLayout
from swarm.planning.digest import digest
from swarm.planning.plan import (
    CableState,
    Condition,
    Gate,
    KnotSummary,
    Phase,
    PhaseName,
    Plan,
)

__all__ = [
    "CableState",
    "Condition",
    "Gate",
    "KnotLayout",
    "KnotSummary",
    "Phase",
    "PhaseName",
    "Plan",
    "digest",
]
