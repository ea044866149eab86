"""From a checked plan and an audited team to the cleared plan, the only one that may fly."""

from dataclasses import dataclass

from swarm.certification.findings import Finding
from swarm.certification.stream_loss import StreamLossCertificate
from swarm.errors import Refused
from swarm.flight.flight_plan import FlightPlan
from swarm.flight.words import in_common
from swarm.planning import digest


@dataclass(frozen=True)
class Audit:
    """The findings on the team while it stood on the ground.

    ``systems`` are the system ids in order along the cable. ``stream_loss`` is
    the certificate of lost setpoints for these vehicles, where their parameters are known.
    """

    systems: tuple[int, ...]
    findings: tuple[Finding, ...]
    stream_loss: StreamLossCertificate | None = None

    @property
    def passed(self) -> bool:
        """Whether no finding is an error."""
        return all(finding.severity != "error" for finding in self.findings)


@dataclass(frozen=True)
class ClearedPlan:
    """A checked plan with an audit without errors.

    Raises :class:`Refused` where the plan was changed since, or the audit is of another plan.
    """

    flight_plan: FlightPlan
    audit: Audit

    def __post_init__(self) -> None:
        self.flight_plan.check()
        errors = [f for f in self.audit.findings if f.severity == "error"]
        if len(self.audit.systems) != self.flight_plan.plan.vehicles:
            raise Refused(
                f"the plan is for {self.flight_plan.plan.vehicles} vehicles, "
                f"{len(self.audit.systems)} were audited"
            )
        stream_loss = self.audit.stream_loss
        if stream_loss is not None and stream_loss.digest != digest(self.flight_plan.plan):
            raise Refused("the audit worked out lost setpoints for another plan")
        if errors:
            words = [f"{check}: {found}" for _, check, found in in_common(errors)]
            if any(finding.check == "parameters" for finding in errors):
                words.append("swarm check MISSION --fleet FLEET --fix asks, and sets parameters")
            raise Refused("\n".join(words))


def go(flight_plan: FlightPlan, audit: Audit) -> ClearedPlan:
    """Return the plan as cleared for flight; raises :class:`Refused` with every error."""
    return ClearedPlan(flight_plan, audit)
