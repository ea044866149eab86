"""The planner: propose a plan, certify it, repair it, until a plan is cleared."""

import importlib
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace

from threadpoolctl import threadpool_limits

from swarm.certification.assessment import Assessment, Robustness
from swarm.certification.certificate import (
    Certificate,
    CertifiedPlan,
    MeasuredClearances,
    certify,
    certify_robustness,
    measure_clearances,
    with_recorded_robustness,
)
from swarm.certification.clearances import Moment, checks_of, violations
from swarm.certification.stream_loss import certify_stream_loss
from swarm.mission import Mission
from swarm.planner.pacing import PacedPlan, slowed_for_swing, slower, timed_for_losses
from swarm.planning import Plan, Shortfall, candidates, repaired

Progress = Callable[[str, float], None]

_ATTEMPTS = 16
"""Largest number of plans that are checked before the first of them is returned as it is."""

_RETIMED = 4
"""Largest number of times that a plan is timed again for the rates of its certificate."""


@dataclass(frozen=True)
class PlanningResult:
    """A plan and its certificate, cleared or not."""

    plan: Plan
    certificate: Certificate

    @property
    def assessment(self) -> Assessment:
        """Results of all checks."""
        return self.certificate.assessment

    def certified(self) -> CertifiedPlan:
        """Return the cleared plan; raises :class:`swarm.errors.Refused` with every error."""
        return CertifiedPlan(self.plan, self.certificate)


def plan(
    mission: Mission, progress: Progress | None = None, *, robustness: bool = True
) -> PlanningResult:
    """Return the first plan for a mission that the checks clear.

    Where no plan is cleared, the result is the first plan that was checked, with its errors. With
    ``robustness`` the certificate of a cleared plan includes e* and w*. ``progress`` is called with
    the name of a stage and its completed share, 0…1.

    Raises :class:`swarm.errors.Refused` where no motion exists to check.
    """
    with one_thread():
        result = _cleared_or_first(mission, progress)
        if robustness and result.certificate.cleared:
            certificate = certify_robustness(result.plan, result.certificate, progress)
            result = replace(result, certificate=certificate)
    return result


def certify_again(
    plan: Plan, recorded: Robustness, progress: Progress | None = None, *, confirm: bool = True
) -> PlanningResult:
    """Certify a plan that was planned before, with its recorded e* and w*.

    All checks are computed again from the plan. With ``confirm`` this includes e* and w*, which are
    None in the result where they do not hold; otherwise they are taken as recorded.
    """
    with one_thread():
        certificate = certify(plan, progress=progress)
        if certificate.cleared:
            if progress:
                progress("recorded e* and w*", 0.0)
            certificate = with_recorded_robustness(plan, certificate, recorded, confirm=confirm)
    return PlanningResult(plan, certificate)


def one_thread() -> AbstractContextManager[object]:
    """Return the context in which linear algebra has one thread.

    The result of a sum depends on the number of threads, and so would the plan: one thread gives
    the same plan on every machine. It is also faster, because the arrays are small.
    """
    # Only loaded libraries are limited, and SciPy loads its own with this module.
    importlib.import_module("scipy.linalg")
    limits: AbstractContextManager[object] = threadpool_limits(limits=1, user_api="blas")
    return limits


def _cleared_or_first(mission: Mission, progress: Progress | None) -> PlanningResult:
    """Certify and repair candidates until one is cleared; otherwise return the first one checked.

    A plan that exceeds the endurance is not checked, because no repair shortens it; the shortest
    one is returned where nothing else was found. The swing takes the longest to compute: plans are
    slowed for it, and checked again, once they pass the checks without.
    """
    proposals = candidates(mission, progress=progress)
    candidate = next(proposals, None)
    notes: tuple[str, ...] = ()
    first: PacedPlan | None = None
    too_long: list[Plan] = []
    failed_checks: frozenset[str] = frozenset()
    attempts = 0
    while candidate is not None and attempts < _ATTEMPTS:
        notes += candidate.notes
        paced = timed_for_losses(replace(candidate.plan, notes=notes))
        if not _exceeds_endurance(paced.plan):
            attempts += 1
            first = first or paced
            measured = None
            failures = _failures(paced.plan, failed_checks)
            slowed = paced if failures else slowed_for_swing(paced)
            if slowed is not paced:
                paced = slowed
                if not _exceeds_endurance(paced.plan):
                    failures, measured = _measured_failures(paced.plan, progress)
        if _exceeds_endurance(paced.plan):
            notes += (_too_long(paced.plan),)
            too_long.append(paced.plan)
            candidate = next(proposals, None)
            continue
        if not failures:
            found = _certified(paced, measured, progress)
            if found.certificate.cleared:
                return found
        failed_checks = frozenset(moment.check for moment in failures)
        missing = [Shortfall(moment.check, moment.time, -moment.margin) for moment in failures]
        candidate = replace(candidate, plan=paced.plan)
        candidate = repaired(candidate, missing) or next(proposals, None)
    rejected = (
        slowed_for_swing(first).plan
        if first
        else min(too_long, key=lambda long: long.flight_duration)
    )
    return PlanningResult(rejected, certify(rejected, progress=progress))


def _certified(
    paced: PacedPlan, measured: MeasuredClearances | None, progress: Progress | None
) -> PlanningResult:
    """Certify a plan, timed again while lost setpoints would lower the rate of the clock.

    Of several timings the last one that is cleared is returned; the first where none is.
    """
    timings = [paced]
    for _ in range(_RETIMED):
        again = slower(timings[-1], certify_stream_loss(timings[-1].plan))
        if again is None:
            break
        timings.append(again)
    for again in reversed(timings[1:]):
        certificate = certify(again.plan, progress=progress)
        if certificate.cleared:
            return PlanningResult(again.plan, certificate)
    return PlanningResult(paced.plan, certify(paced.plan, measured=measured, progress=progress))


def _exceeds_endurance(plan: Plan) -> bool:
    return plan.flight_duration > plan.mission.vehicles.endurance


def _too_long(plan: Plan) -> str:
    endurance = plan.mission.vehicles.endurance
    return f"that took {plan.flight_duration:.0f} s of {endurance:g} s in the air"


def _failures(plan: Plan, failed_checks: frozenset[str]) -> tuple[Moment, ...]:
    """Return all moments at which clearances fail.

    The checks that the previous candidate failed come first. Where one fails again, the others are
    not computed: the plan has to be repaired anyway. A repair needs all failing moments of a check
    at once; repaired one at a time, each would take an attempt.
    """
    failures = violations(plan, failed_checks) if failed_checks else ()
    return failures or violations(plan, checks_of(plan) - failed_checks)


def _measured_failures(
    plan: Plan, progress: Progress | None
) -> tuple[tuple[Moment, ...], MeasuredClearances]:
    """Return all moments at which clearances fail, and the clearances.

    For a plan that is likely to be certified, which needs the clearances.
    """
    measured = measure_clearances(plan, progress)
    failed = {moment.check for moment in measured.moments if moment.margin < 0.0}
    return violations(plan, failed) if failed else (), measured
