"""The kinds of plans that may be flown, each with a type for the checks that it has passed; and the
cleared plan, with an audited team: the only one that may fly.

Only a :class:`CertifiedPlan` carries cable on real vehicles. The others need no certificate of
their own: a hop and a raised flight carry no cable, a resumed flight was certified before it was
interrupted, and a comparison stays in the emulator.
"""

from dataclasses import dataclass, replace
from typing import Literal

from swarm.certification.assessment import Assessment, rounded_down
from swarm.certification.certificate import (
    Certificate,
    CertifiedPlan,
    require_no_errors,
    require_same_plan,
    without_cable,
)
from swarm.certification.clearances import certified
from swarm.certification.findings import Finding, in_common
from swarm.certification.stream_loss import StreamLossCertificate
from swarm.errors import Refused
from swarm.mission.fleet import Fleet
from swarm.planning import Plan, digest
from swarm.planning.assembly import begins_aloft

Kind = Literal["certified", "hop", "raised", "resumed", "comparison"]


@dataclass(frozen=True)
class Basis:
    """The basis of a flight, as its record and its report state it.

    ``checked`` is one sentence, ``digest`` identifies the plan, ``cable`` says whether cable is
    carried, ``max_tracking_error`` is the largest tracking error in metres for which every
    clearance is certified (None: none is).
    """

    kind: Kind
    checked: str
    digest: str
    cable: bool
    max_tracking_error: float | None

    @property
    def words(self) -> str:
        """One line for logs and reports: the checks, and whether cable is carried."""
        return f"{self.checked}; {'carrying cable' if self.cable else 'no cable is carried'}"


@dataclass(frozen=True)
class CableFreeFlight:
    """A hop or a raised flight: no cable is attached, and only the vehicles are certified.

    ``certificate`` is of the same motion :func:`without_cable`. Raises :class:`Refused` where it is
    of another, or has errors.
    """

    plan: Plan
    certificate: Certificate
    purpose: Literal["hop", "raised"]

    def __post_init__(self) -> None:
        self.check()

    def check(self) -> None:
        """Compare plan and certificate again."""
        require_same_plan(without_cable(self.plan), self.certificate)
        require_no_errors(self.certificate)

    @property
    def assessment(self) -> Assessment:
        """The findings on the vehicles."""
        return self.certificate.assessment

    @property
    def stream_loss(self) -> StreamLossCertificate | None:
        """None: cable and lost setpoints are not certified."""
        return None


@dataclass(frozen=True)
class ResumedFlight:
    """A flight whose ground station ended: certified then, not checked again.

    ``basis`` and ``assessment`` come from its record. Raises :class:`Refused` where the plan
    is not the recorded one.
    """

    plan: Plan
    basis: Basis
    assessment: Assessment

    def __post_init__(self) -> None:
        self.check()

    def check(self) -> None:
        """Compare the plan with the digest in the record again."""
        if digest(self.plan) != self.basis.digest:
            raise Refused("the recorded plan is not the plan that was flown: its digest differs")

    @property
    def stream_loss(self) -> StreamLossCertificate | None:
        """None: a record does not keep it, and it is computed again."""
        return None


@dataclass(frozen=True)
class ComparisonFlight:
    """A plan that is flown in the emulator alone, also with errors in its certificate."""

    plan: Plan
    certificate: Certificate

    def __post_init__(self) -> None:
        self.check()

    def check(self) -> None:
        """Compare plan and certificate again; errors in it are allowed."""
        require_same_plan(self.plan, self.certificate)

    @property
    def assessment(self) -> Assessment:
        """All findings, with errors."""
        return self.certificate.assessment

    @property
    def stream_loss(self) -> StreamLossCertificate | None:
        """The largest rates of the mission clock for lost setpoints, where they are known."""
        return self.assessment.stream_loss


FlightPlan = CertifiedPlan | CableFreeFlight | ResumedFlight | ComparisonFlight


def basis_of(flight_plan: FlightPlan, *, cable: bool) -> Basis:
    """Return the basis of a flight; ``cable`` says whether it carries cable.

    Raises :class:`Refused` where cable is carried that the checks do not cover.
    """
    if isinstance(flight_plan, ResumedFlight):
        return _resumed(flight_plan.basis, cable=cable)
    plan, name = flight_plan.plan, digest(flight_plan.plan)
    largest = max_tracking_error(plan, flight_plan.assessment)
    ball = f"tracking errors of up to {plan.mission.vehicles.tracking:g} m"
    if isinstance(flight_plan, ComparisonFlight):
        cleared = flight_plan.certificate.cleared
        words = f"certified for {ball}" if cleared else "not certified: flown for comparison"
        return Basis("comparison", words, name, cable, largest if cleared else None)
    if isinstance(flight_plan, CableFreeFlight):
        if cable:
            raise Refused(f"a {flight_plan.purpose} flight carries no cable: none was checked")
        what = {
            "hop": "a hop straight up and down",
            "raised": "the plan raised for vehicles without grippers",
        }[flight_plan.purpose]
        words = f"{what}, certified without cable for {ball}"
        return Basis(flight_plan.purpose, words, name, False, largest)
    words = f"certified{_model(plan, flight_plan.assessment)} for {ball}"
    kind: Kind = "resumed" if begins_aloft(plan) else "certified"
    return Basis(kind, words, name, cable, largest)


def _model(plan: Plan, assessment: Assessment) -> str:
    if not len(plan.layout.lengths):
        return ""
    quasi_static = " in the quasi-static cable model"
    if not assessment.swing_certified:
        return quasi_static
    return (
        " in the swinging-cable model for the planned motion and one ordinary stop with "
        "the resume that follows,"
        f"{quasi_static}"
    )


def _resumed(before: Basis, *, cable: bool) -> Basis:
    if cable and not before.cable:
        raise Refused("the flight that is resumed carried no cable")
    earlier = before.checked.removesuffix(_NOT_AGAIN)
    return replace(before, kind="resumed", checked=f"{earlier}{_NOT_AGAIN}", cable=cable)


_NOT_AGAIN = ", before it was interrupted; not checked again"


def require_tracking(basis: Basis, fleet: Fleet) -> None:
    """Raise :class:`Refused` where cable is carried by vehicles that err by more than certified.

    Their error is the one that a hop measured, as the fleet file states it.
    """
    measured, most = fleet.tracking, basis.max_tracking_error
    if basis.cable and measured is not None and most is not None and measured > most:
        raise Refused(
            f"fleet {fleet.name}: vehicles were measured with a tracking error of {measured:g} m, "
            f"the plan holds up to {rounded_down(most, 3):g} m: plan again with swarm plan "
            "--fleet"
        )


def confirmed_basis(plan: Plan, recorded: Basis) -> Basis:
    """Return a recorded basis with a tracking error for which clearances are shown again to hold.

    That is the recorded one; the mission's own where that does not hold; None where neither does.
    """
    most = recorded.max_tracking_error
    if most is None:
        return recorded
    checked = plan if recorded.cable else without_cable(plan)
    errors = sorted({most, min(most, plan.mission.vehicles.tracking)}, reverse=True)
    held = (error for error in errors if certified(checked, tracking=error))
    return replace(recorded, max_tracking_error=next(held, None))


def max_tracking_error(plan: Plan, assessment: Assessment) -> float:
    """Return the largest tracking error, metres, for which clearances are certified.

    That is e* where it was computed, and the mission's ``vehicles.tracking`` at least.
    """
    tracking = plan.mission.vehicles.tracking
    return max(tracking, assessment.robustness.tracking or 0.0)


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
            words = [f"{finding.check}: {finding.message}" for finding in in_common(errors)]
            if any(finding.check == "parameters" for finding in errors):
                words.append("swarm check MISSION --fleet FLEET --fix asks, and sets parameters")
            raise Refused("\n".join(words))


def go(flight_plan: FlightPlan, audit: Audit) -> ClearedPlan:
    """Return the plan as cleared for flight; raises :class:`Refused` with every error."""
    return ClearedPlan(flight_plan, audit)
