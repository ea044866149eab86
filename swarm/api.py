"""The verbs of the command line as a small Python API."""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import islice

from swarm.errors import Refused
from swarm.mission import Mission
from swarm.plans import Plan, candidates
from swarm.preflight.assess import assess
from swarm.preflight.findings import Assessment, ProvenPlan, prove

Progress = Callable[[str, float], None]

_ATTEMPTS = 6
"""Plans that the certificate is asked to judge before the first of them is shown as it is."""


@dataclass(frozen=True)
class Planned:
    """A plan and what the checks say of it."""

    plan: Plan
    assessment: Assessment

    def proven(self) -> ProvenPlan:
        """Return the plan as cleared; raises :class:`swarm.errors.Refused` with every error."""
        return prove(self.plan, self.assessment)


def plan(mission: Mission, progress: Progress | None = None) -> Planned:
    """Plan a mission and check it.

    ``progress`` is called with a stage's name and the share of it that is done. Raises
    :class:`swarm.errors.Refused` when no motion was found at all; a motion that was found and does
    not pass is returned, with its findings.
    """
    first: Planned | None = None
    try:
        for made in islice(candidates(mission, progress=progress), _ATTEMPTS):
            planned = Planned(made, assess(made, progress=progress))
            if planned.assessment.cleared:
                return planned
            first = first or planned
    except Refused:
        if first is None:
            raise
    assert first is not None  # noqa: S101 - candidates yields something or raises
    return first
