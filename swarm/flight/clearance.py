"""From a proven plan and an audited team to the only thing that may fly."""

from dataclasses import dataclass

from swarm.errors import Refused
from swarm.flight.words import in_common
from swarm.preflight.coast import CoastCertificate
from swarm.preflight.findings import Finding, ProvenPlan


@dataclass(frozen=True)
class Audit:
    """What was found out about the team while it stood on the ground.

    ``systems`` are the system ids in order along the cable. ``coast`` is what the ends of streams
    do to these vehicles, where their parameters are known.
    """

    systems: tuple[int, ...]
    findings: tuple[Finding, ...]
    coast: CoastCertificate | None = None

    @property
    def passed(self) -> bool:
        """Whether no finding is an error."""
        return all(finding.severity != "error" for finding in self.findings)


@dataclass(frozen=True)
class ClearedPlan:
    """A proven plan together with an audit without errors. Made by :func:`go` alone."""

    proven: ProvenPlan
    audit: Audit

    def __post_init__(self) -> None:
        errors = [f for f in self.audit.findings if f.severity == "error"]
        if len(self.audit.systems) != self.proven.plan.vehicles:
            raise Refused(
                f"the plan is for {self.proven.plan.vehicles} vehicles, "
                f"{len(self.audit.systems)} were audited"
            )
        if errors:
            words = [f"{check}: {found}" for _, check, found in in_common(errors)]
            if any(finding.check == "parameters" for finding in errors):
                words.append("swarm check MISSION --fleet FLEET --fix asks, and sets parameters")
            raise Refused("\n".join(words))


def go(proven: ProvenPlan, audit: Audit) -> ClearedPlan:
    """Return the plan as cleared for flight; raises :class:`Refused` with every error."""
    return ClearedPlan(proven, audit)
