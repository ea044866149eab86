"""The certificate: the results of all checks of exactly one plan, and its only constructors.

A certificate carries the digest of the plan that it was computed from. A flight takes a plan
together with its certificate and compares both; no other value states that a plan is certified.
"""

from collections.abc import Callable
from dataclasses import InitVar, dataclass, replace

import numpy as np

from swarm.certification.assessment import Assessment, assess, rounded_down, with_robustness
from swarm.certification.clearances import Moment, Robustness, confirmed
from swarm.certification.findings import Finding
from swarm.certification.stream_loss import StreamLossCertificate
from swarm.errors import Refused
from swarm.notebook import table
from swarm.planning import Plan, digest

Progress = Callable[[str, float], None]

_CONSTRUCTION_KEY = object()
"""Private to this module: only its functions create certificates."""


@dataclass(frozen=True, repr=False)
class Certificate:
    """The results of all checks of the plan with this digest, from :func:`certify` only.

    ``digest`` is :func:`swarm.planning.digest` of the plan, ``tracking`` the tracking error in
    metres for which it was checked (the mission's ``vehicles.tracking``), ``assessment`` the
    results.
    """

    digest: str
    assessment: Assessment
    tracking: float
    key: InitVar[object]

    def __post_init__(self, key: object) -> None:
        if key is not _CONSTRUCTION_KEY:
            raise TypeError("certificates are created only by swarm.certification.certificate")

    @property
    def cleared(self) -> bool:
        """Whether no finding is an error."""
        return self.assessment.cleared

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Findings of all checks."""
        return self.assessment.findings

    @property
    def tightest(self) -> tuple[Moment, ...]:
        """The five tightest moments of all clearances, tightest first.

        Distances are certified lower bounds for every tracking error up to ``tracking``.
        """
        return self.assessment.tightest

    @property
    def max_tracking_error(self) -> float | None:
        """e*: the largest tracking error in metres for which every clearance still holds.

        None where it was not computed, or where clearances fail even for exact tracking.
        """
        return self.assessment.robustness.tracking

    @property
    def max_wind(self) -> float | None:
        """w*: the largest steady wind in m/s, from any direction, for which clearances still hold.

        None where it was not computed, or where clearances fail in still air.
        """
        return self.assessment.robustness.wind

    def __repr__(self) -> str:
        return f"<Certificate: {', '.join(self._summary())}>"

    def _repr_html_(self) -> str:
        cleared, *held = self._summary()
        rows = [(entry.severity, f"{entry.check}: {entry.message}") for entry in self.findings]
        return table(f"Certificate: {', '.join((cleared, *held))}", rows)

    def _summary(self) -> list[str]:
        """Parts of a one-line summary: cleared or not, errors, e* and w*."""
        words = [f"{'' if self.cleared else 'not '}cleared for {self.tracking:g} m"]
        errors = sum(finding.severity == "error" for finding in self.findings)
        if errors:
            words.append(f"{errors} error{'s' if errors > 1 else ''}")
        if self.max_tracking_error is not None:
            words.append(f"e* {rounded_down(self.max_tracking_error, 2):g} m")
        if self.max_wind is not None:
            words.append(f"w* {rounded_down(self.max_wind, 1):g} m/s")
        return words

    def of(self, plan: Plan) -> bool:
        """Whether this certificate was computed from exactly this plan."""
        return self.digest == digest(plan)


def certify(
    plan: Plan,
    *,
    progress: Progress | None = None,
    robustness: bool = False,
) -> Certificate:
    """Check a plan and return its certificate, cleared or not.

    ``progress`` is called with the name of a stage and the share of it that is done. With
    ``robustness``, e* and w* are computed too.
    """
    assessment = assess(plan, progress=progress, robustness=robustness)
    return Certificate(digest(plan), assessment, plan.mission.vehicles.tracking, _CONSTRUCTION_KEY)


def certify_robustness(
    plan: Plan, certificate: Certificate, progress: Progress | None = None
) -> Certificate:
    """Return the certificate with e* and w*; as long as a dozen certificates.

    Raises :class:`Refused` where it belongs to another plan.
    """
    require_same_plan(plan, certificate)
    assessment = with_robustness(plan, certificate.assessment, progress)
    return replace(certificate, assessment=assessment, key=_CONSTRUCTION_KEY)


def with_recorded_robustness(
    plan: Plan, certificate: Certificate, recorded: Robustness
) -> Certificate:
    """Return the certificate with e* and w* that were computed before.

    Each is shown again to hold, and left out (None) where it does not.

    Raises :class:`Refused` where the certificate belongs to another plan.
    """
    require_same_plan(plan, certificate)
    assessment = replace(certificate.assessment, robustness=confirmed(plan, recorded))
    return replace(certificate, assessment=assessment, key=_CONSTRUCTION_KEY)


def without_cable(plan: Plan) -> Plan:
    """Return the same motion without cable, to check the motion of the vehicles alone."""
    phases = tuple(replace(phase, cable="free") for phase in plan.phases)
    gates = tuple(gate for gate in plan.gates if gate.condition not in {"gripped", "released"})
    none = np.empty(0)
    layout = replace(plan.layout, sags=none, lengths=none, lanes=none, crossings=())
    return replace(plan, layout=layout, phases=phases, gates=gates)


def require_same_plan(plan: Plan, certificate: Certificate) -> None:
    """Raise :class:`Refused` unless the certificate was computed from exactly this plan."""
    if not certificate.of(plan):
        raise Refused(
            "the certificate belongs to another plan: the motion, the cable or the mission was "
            "changed after certification"
        )


def require_no_errors(certificate: Certificate) -> None:
    """Raise :class:`Refused` with every error of the certificate."""
    errors = [finding for finding in certificate.findings if finding.severity == "error"]
    if errors:
        raise Refused("\n".join(f"{finding.check}: {finding.message}" for finding in errors))


@dataclass(frozen=True)
class CertifiedPlan:
    """A plan and its certificate without errors.

    Raises :class:`Refused` where the certificate belongs to another plan or has errors.
    """

    plan: Plan
    certificate: Certificate

    def __post_init__(self) -> None:
        self.check()

    def check(self) -> None:
        """Compare plan and certificate again: the arrays of a plan are writable."""
        require_same_plan(self.plan, self.certificate)
        require_no_errors(self.certificate)

    @property
    def assessment(self) -> Assessment:
        """Results of the checks."""
        return self.certificate.assessment

    @property
    def stream_loss(self) -> StreamLossCertificate | None:
        """The largest rates of the mission clock for stream losses; None where not computed."""
        return self.assessment.stream_loss
