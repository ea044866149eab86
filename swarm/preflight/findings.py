"""What the checks say of a plan, and the type that only a plan without errors can have."""

from dataclasses import dataclass, field
from typing import Literal

from swarm.errors import Refused
from swarm.plans import Plan

Severity = Literal["error", "warning", "info"]


@dataclass(frozen=True)
class Finding:
    """One thing that a check has to say.

    ``at_time`` is mission time in seconds, ``where`` a place in ENU metres; None where it has none.
    """

    severity: Severity
    check: str
    message: str
    at_time: float | None = None
    where: tuple[float, float, float] | None = None


@dataclass(frozen=True)
class Tightest:
    """The tightest moment of one kind of clearance: what, when, how much, how much was asked.

    ``distance`` is the certified lower bound in metres, for every displacement in the tracking
    ball; ``between`` names the two things ("segment 3", "vehicle 5").
    """

    distance: float
    required: float
    time: float
    between: tuple[str, str]


@dataclass(frozen=True)
class Robustness:
    """e* (largest tracking error, m) and w* (largest steady wind, m/s); None where unknown."""

    tracking: float | None = None
    wind: float | None = None


@dataclass(frozen=True)
class Assessment:
    """Everything that the pre-flight checks found out about a plan."""

    findings: tuple[Finding, ...]
    cable: Tightest
    vehicle: Tightest
    vehicle_cable: Tightest
    knot: str
    chirality: Literal["left", "right", "none"]
    gauss: str
    robustness: Robustness = field(default_factory=Robustness)

    @property
    def cleared(self) -> bool:
        """Whether no finding is an error."""
        return all(finding.severity != "error" for finding in self.findings)


@dataclass(frozen=True)
class ProvenPlan:
    """A plan that the checks have cleared: what a dry run flies. Made by :func:`prove` alone."""

    plan: Plan
    assessment: Assessment

    def __post_init__(self) -> None:
        if not self.assessment.cleared:
            errors = [f for f in self.assessment.findings if f.severity == "error"]
            raise Refused("\n".join(f"{finding.check}: {finding.message}" for finding in errors))


def prove(plan: Plan, assessment: Assessment) -> ProvenPlan:
    """Return the plan as cleared for a dry run; raises :class:`Refused` with every error."""
    return ProvenPlan(plan, assessment)
