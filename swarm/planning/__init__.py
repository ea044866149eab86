"""The plan, and its computation from a mission."""

from swarm.folding.layout import KnotLayout
from swarm.planning.assembly import fold_of, with_fold
from swarm.planning.candidates import Candidate, candidates, make_plan, repaired
from swarm.planning.digest import digest
from swarm.planning.phase_motion import usable_acceleration
from swarm.planning.plan import (
    CableState,
    Condition,
    Gate,
    KnotSummary,
    Phase,
    PhaseName,
    Plan,
)
from swarm.planning.repair import Shortfall

__all__ = [
    "CableState",
    "Candidate",
    "Condition",
    "Gate",
    "KnotLayout",
    "KnotSummary",
    "Phase",
    "PhaseName",
    "Plan",
    "Shortfall",
    "candidates",
    "digest",
    "fold_of",
    "make_plan",
    "repaired",
    "usable_acceleration",
    "with_fold",
]
