"""What may be flown, each kind with a type of its own that says what was checked.

Only a :class:`CertifiedPlan` carries cable on real vehicles. The others exist beside it because
they are useful without a certificate of their own: a hop and a raised flight carry nothing, a
resumed flight was certified before it was interrupted, and a comparison stays in the emulator.
"""

from dataclasses import dataclass, replace
from typing import Literal

from swarm.certification.assessment import Assessment
from swarm.certification.certificate import (
    Certificate,
    CertifiedPlan,
    require_no_errors,
    require_same_plan,
    without_cable,
)
from swarm.certification.stream_loss import StreamLossCertificate
from swarm.errors import Refused
from swarm.planning import Plan, digest

Kind = Literal["certified", "hop", "raised", "resumed", "comparison"]


@dataclass(frozen=True)
class Basis:
    """On what a flight is flown: the words and figures that its record and its report state.

    ``checked`` is one sentence, ``digest`` identifies the plan, ``cable`` says whether cable is
    carried, ``max_tracking_error`` is the largest tracking error in metres for which every
    clearance is certified (None: nothing is).
    """

    kind: Kind
    checked: str
    digest: str
    cable: bool
    max_tracking_error: float | None

    @property
    def words(self) -> str:
        """One line for logs and reports: what was checked, and whether cable is carried."""
        return f"{self.checked}; {'carrying cable' if self.cable else 'no cable is carried'}"


@dataclass(frozen=True)
class CableFreeFlight:
    """A hop or a raised flight: nothing is attached, and only its vehicles are certified.

    ``certificate`` belongs to the same motion :func:`without_cable`. Raises :class:`Refused` where
    it does not, or holds errors.
    """

    plan: Plan
    certificate: Certificate
    purpose: Literal["hop", "raised"]

    def __post_init__(self) -> None:
        self.check()

    def check(self) -> None:
        """Compare plan and certificate once more."""
        require_same_plan(without_cable(self.plan), self.certificate)
        require_no_errors(self.certificate)

    @property
    def assessment(self) -> Assessment:
        """What the checks found of the vehicles."""
        return self.certificate.assessment

    @property
    def stream_loss(self) -> StreamLossCertificate | None:
        """Nothing is known of cable and lost setpoints."""
        return None


@dataclass(frozen=True)
class ResumedFlight:
    """A flight whose ground station ended, taken up again: certified then, not checked again.

    ``basis`` and ``assessment`` are what its record states. Raises :class:`Refused` where the plan
    is not the recorded one.
    """

    plan: Plan
    basis: Basis
    assessment: Assessment

    def __post_init__(self) -> None:
        self.check()

    def check(self) -> None:
        """Compare the plan with the digest in the record once more."""
        if digest(self.plan) != self.basis.digest:
            raise Refused("the recorded plan is not the plan that was flown: its digest differs")

    @property
    def stream_loss(self) -> StreamLossCertificate | None:
        """Worked out anew: a record does not keep it."""
        return None


@dataclass(frozen=True)
class ComparisonFlight:
    """A plan that is flown in the emulator whatever its certificate says; never by vehicles."""

    plan: Plan
    certificate: Certificate

    def __post_init__(self) -> None:
        self.check()

    def check(self) -> None:
        """Compare plan and certificate once more; errors in it are no obstacle."""
        require_same_plan(self.plan, self.certificate)

    @property
    def assessment(self) -> Assessment:
        """What the checks found, errors among it."""
        return self.certificate.assessment

    @property
    def stream_loss(self) -> StreamLossCertificate | None:
        """The largest rates of the mission clock for lost setpoints, where they are known."""
        return self.assessment.stream_loss


FlightPlan = CertifiedPlan | CableFreeFlight | ResumedFlight | ComparisonFlight


def basis_of(flight_plan: FlightPlan, *, cable: bool) -> Basis:
    """Return on what a flight is flown; ``cable`` says whether it carries cable.

    Raises :class:`Refused` where cable is to be carried and is not part of what was checked.
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
    model = " in the quasi-static cable model" if len(plan.layout.lengths) else ""
    words = f"certified{model} for {ball}"
    return Basis("certified", words, name, cable, largest)


def _resumed(before: Basis, *, cable: bool) -> Basis:
    if cable and not before.cable:
        raise Refused("the flight that is resumed carried no cable")
    earlier = before.checked.removesuffix(_NOT_AGAIN)
    return replace(before, kind="resumed", checked=f"{earlier}{_NOT_AGAIN}", cable=cable)


_NOT_AGAIN = ", before it was interrupted; not checked again"


def max_tracking_error(plan: Plan, found: Assessment) -> float:
    """Return the largest tracking error, metres, for which clearances are certified.

    That is e* where it was worked out, and the mission's ``vehicles.tracking`` at least.
    """
    tracking = plan.mission.vehicles.tracking
    return max(tracking, found.robustness.tracking or 0.0)
