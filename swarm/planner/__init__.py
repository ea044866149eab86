"""The planner: propose a plan, certify it, repair it, until a plan is cleared."""

import importlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from itertools import chain, islice

import numpy as np
import numpy.typing as npt
from threadpoolctl import threadpool_limits

from swarm.certification.air import LEAST_SINKING, deepest_sinking, wind_tilt
from swarm.certification.assessment import Assessment
from swarm.certification.budget import least_remaining, smallest_budgets
from swarm.certification.certificate import (
    Certificate,
    CertifiedPlan,
    certify,
    certify_robustness,
    with_recorded_robustness,
)
from swarm.certification.clearances import PlanChecks, Robustness, certified
from swarm.errors import Refused
from swarm.mission import Mission
from swarm.planner.pacing import PacedPlan, slowed_for_swing, slower
from swarm.planner.repairs import Kept, Unfinished, least_short, repair, slowed_for_budget
from swarm.planner.rest_of_fold import rest_of_fold_from
from swarm.planner.shortening import (
    HURRIED,
    THOROUGH,
    Effort,
    Verdict,
    aimed_wind,
    shorten,
)
from swarm.planning import Plan
from swarm.planning.candidates import Candidate, candidates
from swarm.planning.searched_foldings import may_search
from swarm.precompile import OPTIMISATION, SEARCH
from swarm.threads import both

Floats = npt.NDArray[np.float64]
Progress = Callable[[str, float], None]

_ATTEMPTS, _ATTEMPTS_SEARCHED = 96, 32
"""Largest numbers of plans with a number of vehicles that are checked, of all foldings of a grid
diagram, and of searched motions: repairs of eight foldings may run out, and those of four of 8_9
did on one of two CPUs. Where none is cleared, the first of all is returned as it is; a search for
the fewest goes on with more vehicles."""

_FURTHER = 2
"""Foldings that are repaired further where none is cleared, of those whose repairs ran out: all of
10_35 and 10_56 did, most of them 3 to 14 mm short of one clearance. Those with the least need one
and three more."""

_STARTS = 3
"""Candidates from which one optimisation begins: the first was enough for all seven in the results
of plans."""

_FLOWN_SINKING = 0.8
"""Largest share of a stated sinking that vehicles sank by in dry runs: 0.28 to 0.79 of 46."""

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
        optimised = mission.fold.method == "optimised"
        proposals = candidates(mission, progress=progress)
        result = (_optimised if optimised else _cleared_or_first)(proposals, progress)
        if robustness and result.certificate.cleared:
            certificate = certify_robustness(result.plan, result.certificate, progress)
            result = replace(result, certificate=certificate)
    return result


def rest_of_fold(
    plan: Plan, time: float, places: Floats, progress: Progress | None = None
) -> PlanningResult:
    """Return a cleared plan of the rest of a fold, for vehicles at rest that hold the cable.

    They are at ``places`` (n, 3), ENU metres, about where they are planned at a ``time`` of the
    fold. The new plan begins there, at time 0. e* and w* are left out.

    Raises :class:`swarm.errors.Refused` where no such plan is cleared, or
    :func:`.rest_of_fold_from` does.
    """
    with one_thread():
        start = rest_of_fold_from(plan, time, places)
        result = _shortest(start, None, progress, HURRIED)
    if result is None:
        raise Refused("no way from here to the knot was cleared")
    return result


def _optimised(proposals: Iterator[Candidate], progress: Progress | None) -> PlanningResult:
    """Return the plan with the shortest fold that one optimisation finds.

    It begins with candidates as they are, and where none of them leads to a cleared plan, with the
    plan that repairs clear, which stays as it is, with a note, where no shorter fold is as safe.
    """
    tried: list[Candidate] = []
    for candidate in islice(proposals, _STARTS):
        tried.append(candidate)
        start = replace(candidate.plan, notes=(*candidate.plan.notes, *candidate.notes))
        shortest = _shortest(start, None, progress, THOROUGH) if candidate.folding else None
        if shortest is not None:
            return shortest
    result = _cleared_or_first(chain(tried, proposals), progress)
    if not result.certificate.cleared or not any(p.name == "fold" for p in result.plan.phases):
        return result
    note = "no shorter fold was cleared that is as safe in all that the certificate states"
    unchanged = replace(result, plan=replace(result.plan, notes=(*result.plan.notes, note)))
    return _shortest(result.plan, result, progress, THOROUGH) or unchanged


def _shortest(
    start: Plan, before: PlanningResult | None, progress: Progress | None, effort: Effort
) -> PlanningResult | None:
    """Return the cleared plan with the shortest fold that is found from a ``start``.

    It is as safe as the one ``before`` in all that the certificate states; where there is none,
    lost setpoints never slow the clock. Where any does, it holds in :func:`.aimed_wind`; a hurried
    search ends with the first that is cleared.
    """
    best, least_rate = before, 1.0 if before is None else _slowest(before.plan)
    in_wind = False

    def accepted(shorter: Plan) -> Verdict:
        nonlocal best, in_wind
        longer = best is not None and shorter.flight_duration >= best.plan.flight_duration
        if longer and (in_wind or best is before):
            return "refused"
        tracking = shorter.mission.vehicles.tracking
        short_of = _remaining(shorter) < _least_accepted(shorter, before)
        if short_of or not certified(shorter, tracking=tracking):
            return "refused"  # as the certificate would, in a third of its time
        _measure(shorter, None)
        if _slowest(shorter) < least_rate:
            return "refused"
        again = PlanningResult(shorter, certify(shorter))
        if not (again.certificate.cleared and _as_safe(again, before)):
            return "refused"
        tilt = wind_tilt(shorter, aimed_wind(shorter.mission))
        holds = effort.hurried or certified(shorter, tracking=tracking, tilt=tilt)
        if holds or best is before:
            best, in_wind = again, holds
        return "enough" if holds else "cleared"

    shorten(start, accepted, progress or (lambda _stage, _share: None), effort)
    if best is None or best is before:
        return None
    first, shortest = (plan.phase("fold").duration for plan in (start, best.plan))
    note = f"shortened the fold from {first:.1f} s to {shortest:.1f} s by one optimisation"
    if before is None:
        note = f"found a fold of {shortest:.1f} s by one optimisation, from one of {first:.1f} s"
    return replace(best, plan=replace(best.plan, notes=(*best.plan.notes, note)))


def _as_safe(again: PlanningResult, before: PlanningResult | None) -> bool:
    """Return whether a cleared plan with another fold is no less safe than one before.

    No vehicle sinks farther than the tracking radius in jets, the budget is no shorter, and no
    check warns that did not before. Where there is none before, all can soon land at any time.
    """
    plan, tracking = again.plan, again.plan.mission.vehicles.tracking
    sinking, warned = max(tracking, LEAST_SINKING), _warned(again) - {"windows"}
    if before is not None:
        sinking, warned = max(sinking, _deepest_sinking(before)), _warned(before)
    return bool(
        _deepest_sinking(again) <= sinking
        and least_remaining(again.assessment.budget) >= _least_accepted(plan, before)
        and _warned(again) <= warned
    )


def _remaining(plan: Plan) -> float:
    """Return what remains least of the budgets of strands; 0 where the plan has no tube."""
    tube = PlanChecks.of(plan).tube
    return 0.0 if tube is None else least_remaining(smallest_budgets(plan, tube.pairs))


def _least_accepted(plan: Plan, before: PlanningResult | None) -> float:
    """Return what must remain of budgets at least."""
    if before is not None:
        return min(0.0, least_remaining(before.assessment.budget))
    return -np.inf if plan.mission.limits.accept_negative_budget else 0.0


def _slowest(plan: Plan) -> float:
    """Return the lowest rate of the clock that lost setpoints ask for."""
    return float(PlanChecks.of(plan).limits_ahead.rates.min(initial=1.0))


def _warned(result: PlanningResult) -> set[str]:
    """Return the checks that warn."""
    findings = result.assessment.findings
    return {finding.check for finding in findings if finding.severity == "warning"}


def compiled_for(mission: Mission) -> tuple[str, ...]:
    """Return the packages that planning a mission may call, beside ``precompile.PLANNING``."""
    searched = SEARCH if may_search(mission) else ()
    optimised = OPTIMISATION if mission.fold.method == "optimised" else ()
    return (*searched, *optimised)


def certify_again(
    plan: Plan, recorded: Robustness | None, progress: Progress | None = None
) -> PlanningResult:
    """Certify a plan that was planned before, with its recorded e* and w*.

    All checks are computed again from the plan; e* and w* are None in the result where they do not
    hold. Without ``recorded`` ones, e* and w* of a cleared plan are computed too.
    """
    with one_thread():
        certificate = certify(plan, progress=progress)
        if certificate.cleared and recorded is None:
            certificate = certify_robustness(plan, certificate, progress)
        elif certificate.cleared and recorded is not None:
            if progress:
                progress("recorded e* and w*", 0.0)
            certificate = with_recorded_robustness(plan, certificate, recorded)
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


def _cleared_or_first(proposals: Iterable[Candidate], progress: Progress | None) -> PlanningResult:
    """Certify and repair candidates until one is cleared; otherwise return the first one checked.

    A plan that exceeds the endurance is not checked, because no repair shortens it; the shortest
    one is returned where nothing else was found. Where only the budget stays short, the plan that
    comes closest counts. A searched motion in which a vehicle sinks so far in the jet of another
    that it would leave its certificate counts only where all searched ones have this.
    """
    notes: tuple[str, ...] = ()
    first: PacedPlan | None = None
    too_long: list[Plan] = []
    certified: list[PlanningResult] = []
    others: list[Kept] = []
    unfinished: list[Unfinished] = []
    attempts, vehicles = 0, 0
    for candidate in proposals:
        if candidate.plan.vehicles != vehicles:
            attempts, vehicles = 0, candidate.plan.vehicles
        most = _ATTEMPTS_SEARCHED if candidate.searched else _ATTEMPTS
        if attempts >= most:
            if candidate.searched:
                continue
            break
        if not candidate.searched and _cleared(certified):
            break
        repairs = repair(candidate, notes, most - attempts)
        attempts += repairs.attempts
        notes = repairs.notes
        first = first or repairs.first
        too_long += repairs.too_long
        if repairs.kept:
            result = _certified(slowed_for_budget(least_short(repairs.kept)), progress)
            given_up = _why_given_up(result, searched=candidate.searched)
            if not given_up:
                return result
            certified.append(result)
            others += repairs.kept
            notes += given_up if candidate.searched else ()
        if repairs.unfinished:
            unfinished.append(repairs.unfinished)
    return (
        _closest(certified)
        or _closest(_with_fewer_repairs(others, progress))
        or _closest(_repaired_further(unfinished, notes, progress))
        or _rejected(first, too_long, progress)
    )


def _with_fewer_repairs(others: Sequence[Kept], progress: Progress | None) -> list[PlanningResult]:
    """Certify the shortest of plans that keep all clearances, where the best ones were refused.

    Repairs for a budget and for jets take time: those of 10_102 led to 599 s of flight, which the
    certificate counts as 601 of 600; its first plan takes 580 s.
    """
    shortest = min(others, key=lambda kept: kept.paced.plan.flight_duration, default=None)
    return [_certified(shortest.paced, progress)] if shortest else []


def _repaired_further(
    unfinished: Sequence[Unfinished], notes: tuple[str, ...], progress: Progress | None
) -> list[PlanningResult]:
    """Repair the foldings that were left the least short by their repairs, until one is cleared."""
    certified: list[PlanningResult] = []
    for folding in sorted(unfinished, key=lambda last: last.short)[:_FURTHER]:
        again = folding.repaired()
        if again is None or _cleared(certified):
            continue
        repairs = repair(again, notes, _ATTEMPTS)
        notes = repairs.notes
        if repairs.kept:
            certified.append(_certified(slowed_for_budget(least_short(repairs.kept)), progress))
    return certified


def _closest(certified: Sequence[PlanningResult]) -> PlanningResult | None:
    """Return the cleared plan with the least sinking, or else with the budget least short."""
    cleared = _cleared(certified)
    if cleared:
        return min(cleared, key=_deepest_sinking)
    short = [outcome for outcome in certified if _certifiable(outcome.assessment)]
    return max(short, key=lambda outcome: least_remaining(outcome.assessment.budget), default=None)


def _cleared(certified: Sequence[PlanningResult]) -> list[PlanningResult]:
    return [outcome for outcome in certified if outcome.certificate.cleared]


def _rejected(
    first: PacedPlan | None, too_long: Sequence[Plan], progress: Progress | None
) -> PlanningResult:
    """Return the first plan that was checked, or else the shortest of those that were not."""
    plan = (
        slowed_for_swing(first).plan
        if first
        else min(too_long, key=lambda long: long.flight_duration)
    )
    return PlanningResult(plan, certify(plan, progress=progress))


def _why_given_up(outcome: PlanningResult, *, searched: bool) -> tuple[str, ...]:
    """Return notes on why the search goes on after a plan; none where it ends with it."""
    if not outcome.certificate.cleared:
        return _why_refused(outcome)
    sinking = _deepest_sinking(outcome) if searched else 0.0
    if _FLOWN_SINKING * sinking <= outcome.plan.mission.vehicles.tracking:
        return ()
    return (f"given up: a vehicle sinks in the jet of another by {sinking:.2f} m",)


def _deepest_sinking(outcome: PlanningResult) -> float:
    deepest = deepest_sinking(outcome.plan)
    return deepest.depth if deepest else 0.0


def _why_refused(outcome: PlanningResult) -> tuple[str, ...]:
    """Return notes on the errors with which a certificate refused a folding."""
    errors = [finding for finding in outcome.assessment.findings if finding.severity == "error"]
    return tuple(f"given up: {finding.check}: {finding.message}" for finding in errors)


def _certifiable(assessment: Assessment) -> bool:
    """Whether no finding is an error but for a short budget, which another repair may close."""
    errors = {finding.check for finding in assessment.findings if finding.severity == "error"}
    return errors <= {"budget"}


def _certified(paced: PacedPlan, progress: Progress | None) -> PlanningResult:
    """Certify a plan, timed again while lost setpoints would lower the rate of the clock.

    Of several timings the last one that is cleared is returned. Where none is, it is the last one
    that is short of nothing but its budget, or else the first.
    """
    _measure(paced.plan, progress)
    timings = [paced]
    for _ in range(_RETIMED):
        again = slower(timings[-1])
        if again is None:
            break
        _measure(again.plan, progress)
        timings.append(again)
    refused: list[PlanningResult] = []
    for again in reversed(timings):
        outcome = PlanningResult(again.plan, certify(again.plan, progress=progress))
        if outcome.certificate.cleared:
            return outcome
        refused.append(outcome)
    return next((outcome for outcome in refused if _certifiable(outcome.assessment)), refused[-1])


def _measure(plan: Plan, progress: Progress | None) -> None:
    """Measure the clearances of a plan, and meanwhile its limits for lost setpoints."""
    checks = PlanChecks.of(plan)
    both(lambda: checks.moments(progress), lambda: checks.limits_ahead)
