"""The verbs of the command line as a small Python API."""

from collections.abc import Callable
from dataclasses import dataclass

from threadpoolctl import threadpool_limits

from swarm.certification.assessment import Assessment
from swarm.certification.certificate import (
    Certificate,
    CertifiedPlan,
    MeasuredClearances,
    certify,
    certify_robustness,
    measure_clearances,
)
from swarm.certification.clearances import Moment, violations
from swarm.mission import Mission
from swarm.planning import Plan, Shortfall, candidates

Progress = Callable[[str, float], None]

_ATTEMPTS = 16
"""Plans that the certificate is asked to judge before the first of them is shown as it is."""


@dataclass(frozen=True)
class Planned:
    """A plan and its certificate, cleared or not."""

    plan: Plan
    certificate: Certificate

    @property
    def assessment(self) -> Assessment:
        """What the checks found."""
        return self.certificate.assessment

    def certified(self) -> CertifiedPlan:
        """Return the plan as cleared; raises :class:`swarm.errors.Refused` with every error."""
        return CertifiedPlan(self.plan, self.certificate)


def plan(mission: Mission, progress: Progress | None = None, *, robustness: bool = True) -> Planned:
    """Plan a mission and check it.

    A plan that passes comes with e* and w* where ``robustness`` is asked for. ``progress`` is
    called with a stage's name and the share of it that is done. Raises
    :class:`swarm.errors.Refused` when no motion was found at all; a motion that was found and does
    not pass is returned, with its findings.
    """
    # Sums of arrays depend on how many threads share them, and plans with them: another machine
    # would make another plan. Arrays here are small, so that one thread is quicker, too.
    with threadpool_limits(limits=1, user_api="blas"):
        return _plan(mission, progress, robustness=robustness)


def _plan(mission: Mission, progress: Progress | None, *, robustness: bool) -> Planned:
    search = candidates(mission, progress=progress)
    made = next(search)
    first = None
    doubted: frozenset[str] = frozenset()
    for _ in range(_ATTEMPTS):
        missing, measured = _judged(made, doubted, progress)
        first = first or (made, measured)
        if not missing:
            certificate = certify(made, measured=measured, progress=progress)
            if certificate.cleared:
                if robustness:
                    certificate = certify_robustness(made, certificate, progress)
                return Planned(made, certificate)
        doubted = frozenset(moment.check for moment in missing)
        try:
            made = search.send(
                [Shortfall(moment.check, moment.time, -moment.margin) for moment in missing]
            )
        except StopIteration:
            break
    assert first is not None  # noqa: S101 - the first plan was judged
    made, measured = first
    return Planned(made, certify(made, measured=measured, progress=progress))


def _judged(
    made: Plan, doubted: frozenset[str], progress: Progress | None
) -> tuple[tuple[Moment, ...], MeasuredClearances | None]:
    """Where a plan falls short, and its clearances; None where it fails in what is doubted.

    Whoever mends plans need not know everything about one that is to be mended again, but all
    moments that need it: mended one by one they would take a round each.
    """
    missing = violations(made, doubted) if doubted else ()
    if missing:
        return missing, None
    measured = measure_clearances(made, progress)
    failed = {moment.check for moment in measured.moments if moment.margin < 0.0}
    return violations(made, failed) if failed else (), measured
