"""All checks of a plan, with their findings."""

from collections.abc import Callable, Iterable
from dataclasses import replace

from swarm.certification.assessment import Assessment, Tightest
from swarm.certification.budget import budgets
from swarm.certification.cable_spans import cable_spans
from swarm.certification.clearance_findings import (
    clearance_findings,
    limit_findings,
    smoothness_findings,
    tightest_findings,
    wind_findings,
)
from swarm.certification.clearances import (
    Moment,
    certified_tube,
    tightest_moments,
)
from swarm.certification.compared_pairs import MOST_EXEMPT, exempt_length
from swarm.certification.findings import Finding
from swarm.certification.knot_findings import tied_knot
from swarm.certification.operational_findings import (
    budget_findings,
    contingencies_of,
    downwash_findings,
    endurance_findings,
    load_findings,
    tolerance_findings,
)
from swarm.certification.robustness import robustness_of
from swarm.certification.smallest_budgets import smallest_budgets
from swarm.certification.stream_loss import certify_stream_loss
from swarm.certification.swing_findings import swing_findings
from swarm.certification.swing_tube import swing_tube
from swarm.planning import Plan
from swarm.planning.phase_order import finish_of

Progress = Callable[[str, float], None]

BUDGETS = 3
"""Rows of the budget: the pairs of strands with the least that remains."""

_MODEL_END = {
    None: "to the end of the motion",
    "release": "to the release; the cable after it, and with it the knot, is outside the model",
    "tighten": "until the inner vehicles release it; the fall of the cable and the tightening of "
    "the knot are outside the model, in which then only distances of vehicles are certified",
    "unfold": "through the hold and back to the floor; the shape of slack cable on the floor is "
    "outside the model",
    "hold": "through the hold and the common vertical descent until the cable touches the floor; "
    "the contact of strands there is outside the model",
}
"""The end of the cable model, for each finish."""


def assess(
    plan: Plan,
    *,
    moments: tuple[Moment, ...] | None = None,
    progress: Progress | None = None,
    robustness: bool = False,
) -> Assessment:
    """Return the results of all checks of a plan.

    ``moments`` are its :func:`tightest_moments`, if already computed. ``progress`` is called with
    the name of a stage and the share of it that is done. With ``robustness``, e* and w* are
    computed too (:func:`with_robustness`).
    """
    moments = moments or tightest_moments(plan, progress=progress)
    tube = swing_tube(plan)
    findings = [
        *(Finding("error", "phases", *problem) for problem in cable_spans(plan).problems),
        *clearance_findings(plan, moments),
        *wind_findings(plan),
        *smoothness_findings(plan),
        *limit_findings(plan),
        *load_findings(plan),
        *downwash_findings(plan),
        *swing_findings(plan, tube),
    ]
    knot = tied_knot(plan)
    contingencies, found = contingencies_of(plan)
    findings += [*knot.findings, *found]
    # A refused plan is not flown, so it needs no certificate of stream losses.
    refused = any(finding.severity == "error" for finding in (*findings, *endurance_findings(plan)))
    stream_loss = None if refused else certify_stream_loss(plan)
    findings += stream_loss.findings() if stream_loss else []
    findings += endurance_findings(plan, stream_loss.delay if stream_loss else 0.0)
    rows = smallest_budgets(plan, tube.pairs) if tube else budgets(plan, moments)
    budget = tuple(sorted(rows, key=lambda row: row.remaining))[:BUDGETS]
    assessment = Assessment(
        findings=(),
        cable=_tightest(moments, ("cable clearance", "neighbouring segments"), plan),
        vehicle=_tightest(moments, ("vehicle clearance",), plan),
        vehicle_cable=_tightest(moments, ("vehicle-cable clearance",), plan),
        knot=knot.type,
        chirality=knot.chirality,
        gauss=knot.gauss,
        moments=moments,
        budget=budget,
        contingencies=contingencies,
        stream_loss=stream_loss,
        tube=tube,
        swing_certified=certified_tube(plan) is not None,
    )
    findings += tightest_findings(assessment.tightest)
    findings += budget_findings(budget, accepted=plan.mission.limits.accept_negative_budget)
    findings += tolerance_findings(plan)
    findings.append(_scope(plan, swing_certified=assessment.swing_certified))
    assessment = replace(assessment, findings=tuple(findings))
    return with_robustness(plan, assessment, progress) if robustness else assessment


def with_robustness(
    plan: Plan, assessment: Assessment, progress: Progress | None = None
) -> Assessment:
    """Return the assessment with e* and w*; as long as a dozen certificates.

    A plan without cable aloft has none.
    """
    if all(phase.cable != "aloft" for phase in plan.phases):
        return assessment
    return replace(assessment, robustness=robustness_of(plan, assessment.moments, progress))


def _tightest(moments: Iterable[Moment], checks: tuple[str, ...], plan: Plan) -> Tightest:
    chosen = [moment for moment in moments if moment.check in checks]
    if not chosen:
        return Tightest(float("inf"), 0.0, float(plan.motion.times[0]), ("", ""))
    worst = min(chosen, key=lambda moment: moment.margin)
    return Tightest(max(worst.distance, 0.0), worst.required, worst.time, worst.between)


def _scope(plan: Plan, *, swing_certified: bool) -> Finding:
    """State the model, the tracking errors and the times for which a plan is certified."""
    tracking = plan.mission.vehicles.tracking
    errors = (
        f"for every tracking error up to {tracking:g} m"
        if tracking > 0
        else "for exact tracking only (vehicles.tracking is 0: geometry only)"
    )
    spans = cable_spans(plan)
    if not spans.ever:
        message = f"distances of vehicles are certified {errors}; no cable is carried"
        return Finding("info", "scope", message)
    exempt = ""
    if plan.vehicles > 2:
        exempt = (
            f"; between two segments that share a vehicle, {exempt_length(plan):.2f} m of cable "
            f"from its grip (at most {MOST_EXEMPT:.0%} of the shorter one) are exempt"
        )
        if spans.low:
            exempt += ", and all of both while cable lies on the floor in a line"
    model = "in the quasi-static cable model"
    if swing_certified:
        model = (
            "in the swinging-cable model for the planned motion and one ordinary stop with the "
            f"resume that follows, at any moment of the fold, {model}"
        )
    return Finding(
        "info",
        "scope",
        f"certified {model} {errors}, from the grip at "
        f"{spans.gripped:.1f} s {_MODEL_END[finish_of([phase.name for phase in plan.phases])]}; "
        f"all vehicles hold the cable until {spans.released:.1f} s{exempt}",
    )
