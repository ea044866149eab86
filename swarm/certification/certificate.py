"""The certificate: what the checks found out about exactly one plan, and the only way to make one.

A certificate carries the digest of the plan that it was computed from. Whatever flies takes a plan
together with its certificate and compares the two; nothing else says that a plan is certified.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import InitVar, dataclass, replace

import numpy as np

from swarm.certification.assess import assess, with_robustness
from swarm.certification.assessment import Assessment
from swarm.certification.clearances import Moment, tightest_moments
from swarm.certification.findings import Finding
from swarm.certification.stream_loss import StreamLossCertificate
from swarm.errors import Refused
from swarm.notebook import table
from swarm.planning import Gate, Phase, Plan, digest

Progress = Callable[[str, float], None]

_MADE_HERE = object()
"""Known to this module alone: only its functions measure and certify."""


def _refuse_forgery(made_by: object, what: str) -> None:
    if made_by is not _MADE_HERE:
        raise TypeError(f"{what} are made by swarm.certification.certificate alone")


@dataclass(frozen=True)
class MeasuredClearances:
    """The tightest moments of the plan with this digest. Made by :func:`measure_clearances`."""

    digest: str
    moments: tuple[Moment, ...]
    made_by: InitVar[object]

    def __post_init__(self, made_by: object) -> None:
        _refuse_forgery(made_by, "measured clearances")


@dataclass(frozen=True, repr=False)
class Certificate:
    """What the checks found out about the plan with this digest. Made by :func:`certify` alone.

    ``digest`` is :func:`swarm.planning.digest` of the plan, ``tracking`` the tracking error in
    metres for which it was checked (the mission's ``vehicles.tracking``), ``assessment`` everything
    that the checks found.
    """

    digest: str
    assessment: Assessment
    tracking: float
    made_by: InitVar[object]

    def __post_init__(self, made_by: object) -> None:
        _refuse_forgery(made_by, "certificates")

    @property
    def cleared(self) -> bool:
        """Whether no finding is an error."""
        return self.assessment.cleared

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Everything that the checks have to say."""
        return self.assessment.findings

    @property
    def tightest(self) -> tuple[Moment, ...]:
        """The five tightest moments of all clearances, tightest first: what, where, when, metres.

        Distances are certified lower bounds for every tracking error up to ``tracking``.
        """
        return self.assessment.tightest

    @property
    def max_tracking_error(self) -> float | None:
        """e*: the largest tracking error in metres for which every clearance still holds.

        None where it was not worked out, and where clearances do not even hold for exact tracking.
        """
        return self.assessment.robustness.tracking

    @property
    def max_wind(self) -> float | None:
        """w*: the largest steady wind in m/s, from any direction, for which clearances still hold.

        None where it was not worked out, and where clearances do not hold in still air.
        """
        return self.assessment.robustness.wind

    def __repr__(self) -> str:
        return f"<Certificate: {', '.join(self._words())}>"

    def _repr_html_(self) -> str:
        cleared, *held = self._words()
        rows = [(found.severity, f"{found.check}: {found.message}") for found in self.findings]
        return table(f"Certificate: {', '.join((cleared, *held))}", rows)

    def _words(self) -> list[str]:
        """What one line says: cleared or not, and for how much more than asked it would hold."""
        words = [f"{'' if self.cleared else 'not '}cleared for {self.tracking:g} m"]
        errors = sum(finding.severity == "error" for finding in self.findings)
        if errors:
            words.append(f"{errors} error{'s' if errors > 1 else ''}")
        # Rounded down: a certificate never says more than it holds for.
        if self.max_tracking_error is not None:
            words.append(f"e* {math.floor(100.0 * self.max_tracking_error) / 100.0:g} m")
        if self.max_wind is not None:
            words.append(f"w* {math.floor(10.0 * self.max_wind) / 10.0:g} m/s")
        return words

    def of(self, plan: Plan) -> bool:
        """Whether this certificate was computed from exactly this plan."""
        return self.digest == digest(plan)


def measure_clearances(plan: Plan, progress: Progress | None = None) -> MeasuredClearances:
    """Return the tightest moments of a plan; ``progress`` is as in :func:`certify`."""
    moments = tightest_moments(plan, progress=progress)
    return MeasuredClearances(digest(plan), moments, _MADE_HERE)


def certify(
    plan: Plan,
    *,
    measured: MeasuredClearances | None = None,
    progress: Progress | None = None,
    robustness: bool = False,
) -> Certificate:
    """Check a plan and return its certificate, cleared or not.

    ``measured`` are its clearances where they are known already. ``progress`` is called with a
    stage's name and the share of it that is done. ``robustness`` asks for e* and w* too.

    Raises :class:`ValueError` where ``measured`` belongs to another plan.
    """
    measured = measured or measure_clearances(plan, progress)
    name = digest(plan)
    if measured.digest != name:
        raise ValueError("the clearances were measured on another plan")
    found = assess(plan, moments=measured.moments, progress=progress, robustness=robustness)
    return Certificate(name, found, plan.mission.vehicles.tracking, _MADE_HERE)


def certify_robustness(
    plan: Plan, certificate: Certificate, progress: Progress | None = None
) -> Certificate:
    """Return the certificate with e* and w* added, which takes a dozen certificates more.

    Raises :class:`Refused` where it belongs to another plan.
    """
    require_same_plan(plan, certificate)
    found = with_robustness(plan, certificate.assessment, progress)
    return replace(certificate, assessment=found, made_by=_MADE_HERE)


def without_cable(plan: Plan) -> Plan:
    """Return the same motion with nothing attached: what its vehicles do is left to be checked."""
    phases = tuple(_free(phase) for phase in plan.phases)
    none = np.empty(0)
    layout = replace(plan.layout, sags=none, lengths=none, lanes=none, crossings=())
    return replace(plan, layout=layout, phases=phases, gates=tuple(_without_grips(plan.gates)))


def _free(phase: Phase) -> Phase:
    return replace(phase, cable="free")


def _without_grips(gates: Sequence[Gate]) -> list[Gate]:
    return [gate for gate in gates if gate.condition not in {"gripped", "released"}]


def require_same_plan(plan: Plan, certificate: Certificate) -> None:
    """Raise :class:`Refused` unless the certificate was computed from exactly this plan."""
    if not certificate.of(plan):
        raise Refused(
            "the certificate belongs to another plan: the motion, the cable or the mission was "
            "changed after it was certified"
        )


def require_no_errors(certificate: Certificate) -> None:
    """Raise :class:`Refused` with every error that the certificate holds."""
    errors = [finding for finding in certificate.findings if finding.severity == "error"]
    if errors:
        raise Refused("\n".join(f"{finding.check}: {finding.message}" for finding in errors))


@dataclass(frozen=True)
class CertifiedPlan:
    """A plan and the certificate that was computed from it, without errors.

    Raises :class:`Refused` where the certificate belongs to another plan or holds errors.
    """

    plan: Plan
    certificate: Certificate

    def __post_init__(self) -> None:
        self.check()

    def check(self) -> None:
        """Compare plan and certificate once more: arrays of a plan can be written to."""
        require_same_plan(self.plan, self.certificate)
        require_no_errors(self.certificate)

    @property
    def assessment(self) -> Assessment:
        """What the checks found."""
        return self.certificate.assessment

    @property
    def stream_loss(self) -> StreamLossCertificate | None:
        """The largest rates of the mission clock for lost setpoints, where they are known."""
        return self.assessment.stream_loss
