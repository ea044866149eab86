"""Everything that is checked before a plan may fly, put into findings."""

from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Literal

import numpy as np

from swarm.certification.assessment import Assessment, Tightest
from swarm.certification.budget import budgets
from swarm.certification.cable_spans import cable_spans
from swarm.certification.clearances import (
    Moment,
    exempt_length,
    limits,
    moments_of,
    segment_name,
    tightest_moments,
)
from swarm.certification.findings import Finding, Severity
from swarm.certification.floor_limits import LYING
from swarm.certification.limits import TAUT
from swarm.certification.motion_bounds import BoundedMotion
from swarm.certification.robustness import DIRECTIONS, failure_in_wind, robustness_of
from swarm.certification.strands import MOST_EXEMPT
from swarm.certification.stream_loss import certify_stream_loss
from swarm.certification.topology import end_code, end_knot, end_time, layout_code
from swarm.certification.what_if import (
    budget_findings,
    contingencies_of,
    downwash_findings,
    endurance_findings,
    load_findings,
    tolerance_findings,
)
from swarm.errors import SwarmError
from swarm.geometry.chain import crossing_gaps
from swarm.knots.gauss import SignedGauss, parse_gauss, same_code
from swarm.planning import Plan
from swarm.planning.phase_order import finish_of

Progress = Callable[[str, float], None]
Chirality = Literal["left", "right", "none"]

LIMIT_TOLERANCE = 1e-4
"""m/s and m/s²: how closely the largest speeds and accelerations are found."""

BUDGETS = 3
SMOOTH = (("position", "m", 1e-6), ("velocity", "m/s", 1e-3), ("acceleration", "m/s²", 0.05))
"""What may jump where pieces of the motion join: rounding."""

_OUTSIDE = {
    None: "to the end of the motion",
    "release": "to its release; what the cable does after that, and with it the knot, is outside "
    "the model",
    "tighten": "until the inner vehicles let go of it; how the cable falls from them and whether "
    "the ends draw the knot tight is outside the model, in which only vehicles are kept apart then",
    "unfold": "through the hold and back to the floor; how slack cable lies down there is outside "
    "the model",
    "hold": "through the hold; coming straight down together, everything keeps its distances until "
    "it touches the floor, and how the strands then lie on each other is outside the model",
}
"""Where the model ends, for each finish."""


def assess(
    plan: Plan,
    *,
    moments: tuple[Moment, ...] | None = None,
    progress: Progress | None = None,
    robustness: bool = False,
) -> Assessment:
    """Check a plan and return everything found out about it.

    ``moments`` are its :func:`tightest_moments`, where they are known. ``progress`` is called with
    a stage's name and the share of it that is done. ``robustness`` asks for e* and w* too
    (:func:`with_robustness`).
    """
    moments = moments or tightest_moments(plan, progress=progress)
    findings = [
        *(Finding("error", "phases", *problem) for problem in cable_spans(plan).problems),
        *_meeting(plan, moments),
        *(_clearance_finding(plan, moment) for moment in _failing(moments)),
        *_wind_findings(plan),
        *_smoothness_findings(plan),
        *_limit_findings(plan),
        *load_findings(plan),
        *downwash_findings(plan),
    ]
    knot, chirality, gauss, topology = _topology(plan)
    findings += topology
    contingencies, found = contingencies_of(plan)
    findings += found
    # A plan that is refused anyway never meets the end of its setpoints.
    refusing = [*findings, *endurance_findings(plan)]
    refused = any(finding.severity == "error" for finding in refusing)
    stream_loss = None if refused else certify_stream_loss(plan)
    findings += stream_loss.findings() if stream_loss else []
    findings += endurance_findings(plan, stream_loss.delay if stream_loss else 0.0)
    budget = budgets(plan, sorted(moments, key=lambda moment: moment.margin))[:BUDGETS]
    assessment = Assessment(
        findings=(),
        cable=_tightest(moments, ("cable clearance", "neighbouring segments"), plan),
        vehicle=_tightest(moments, ("vehicle clearance",), plan),
        vehicle_cable=_tightest(moments, ("vehicle-cable clearance",), plan),
        knot=knot,
        chirality=chirality,
        gauss=gauss,
        moments=moments,
        budget=budget,
        contingencies=contingencies,
        stream_loss=stream_loss,
    )
    findings += _tightest_findings(assessment.tightest)
    findings += budget_findings(budget)
    findings += tolerance_findings(plan)
    findings.append(_scope(plan))
    assessment = replace(assessment, findings=tuple(findings))
    return with_robustness(plan, assessment, progress) if robustness else assessment


def with_robustness(
    plan: Plan, assessment: Assessment, progress: Progress | None = None
) -> Assessment:
    """Add e* and w* to what was found out about a plan; takes a dozen certificates more.

    A plan without cable aloft has none.
    """
    if all(phase.cable != "aloft" for phase in plan.phases):
        return assessment
    return replace(assessment, robustness=robustness_of(plan, assessment.moments, progress))


def _failing(moments: Iterable[Moment]) -> list[Moment]:
    return [moment for moment in moments if moment.margin < 0.0]


def _clearance_finding(plan: Plan, moment: Moment) -> Finding:
    tracking = plan.mission.vehicles.tracking
    one, other = moment.between
    errors = f" when tracking errs by up to {tracking:g} m" if tracking > 0 else ""
    if not np.isfinite(moment.distance):
        message = f"{one} and {other}: nothing can be shown of what they keep"
    elif moment.check == "taut":
        message = f"{one} is {-moment.margin:.3f} m beyond {TAUT:.1%} of its length{errors}"
    elif moment.check == "over-stretched on the floor":
        message = f"{one} is pulled {-moment.margin:.3f} m beyond its length on the floor"
    elif moment.check == "rotor disc":
        message = f"{other} runs into the rotor disc of its own {one}{errors}"
    elif moment.check in _CLAIMS:
        message = _CLAIMS[moment.check].format(one=one, other=other)
    elif moment.check == "ground":
        message = f"{one} goes as low as {-moment.margin:.3f} m below the floor"
    elif moment.check in {"ceiling", "fence"}:
        message = f"{one} crosses {other} by {-moment.margin:.3f} m{errors}"
    else:
        distance = (
            f"can be certified only {moment.distance:.3f} m from"
            if moment.distance > 0
            else "can touch"
        )
        message = f"{one} {distance} {other}{errors}; {moment.required:g} m are required"
    return _at("error", moment.check, message, moment)


_CLAIMS = {
    "lying": f"{{one}} is more than {LYING:g} m above the floor while its cable is to lie there",
    "drawn out": "{one} and {other} are not drawn out in a line while cable may lie on the floor: "
    "they are more than 60° off it in plan view",
    "beside rotors": "{one} is too steep beside the rotors of its vehicles while cable may lie on "
    "the floor",
    "straight down": "{one} does not come straight down together with the others: the knot that "
    "they carry would change its shape",
}
"""What fails where cable is not looked at as hanging."""


def _at(severity: Severity, check: str, message: str, moment: Moment) -> Finding:
    place = ", ".join(f"{value:.2f}" for value in moment.where)
    return Finding(
        severity,
        check,
        f"{message} (at {moment.time:.2f} s, near ({place}))",
        moment.time,
        moment.where,
    )


def _meeting(plan: Plan, moments: Iterable[Moment]) -> list[Finding]:
    """Strands that meet even where every vehicle is exactly at its setpoint."""
    if all(moment.margin >= 0.0 for moment in moments if moment.check == "cable clearance"):
        return []
    exact = tightest_moments(plan, tracking=0.0, checks=("cable clearance",))
    meeting = [moment for moment in exact if moment.distance <= 0.0]
    return [
        _at(
            "error",
            "strands meet",
            f"{moment.between[0]} and {moment.between[1]} meet even without tracking errors: "
            "the cable would entangle",
            moment,
        )
        for moment in meeting
    ]


def _smoothness_findings(plan: Plan) -> list[Finding]:
    """Jumps of position, velocity or acceleration, which no vehicle can follow."""
    found = []
    jumps = BoundedMotion(plan.motion).jumps()
    for order, (what, unit, allowed) in enumerate(SMOOTH):
        if not jumps.size or jumps[:, order].max() <= allowed:
            continue
        joint, vehicle = np.unravel_index(np.argmax(jumps[:, order]), jumps[:, order].shape)
        size = jumps[joint, order, vehicle]
        message = f"the {what} of vehicle {vehicle + 1} jumps by {size:.3g} {unit}"
        place = plan.motion.coefficients[joint + 1, 0, vehicle]
        at = float(plan.motion.times[joint + 1])
        where = (float(place[0]), float(place[1]), float(place[2]))
        found.append(Finding("error", "smoothness", message, at, where))
    return found


def _limit_findings(plan: Plan) -> list[Finding]:
    vehicles = plan.mission.vehicles
    usable = vehicles.max_acceleration - vehicles.braking_acceleration
    reserve = f" ({vehicles.max_acceleration:g} less {vehicles.braking_acceleration:g} to brake)"
    findings = []
    for family in limits(plan):
        failing = [m for m in moments_of(family, LIMIT_TOLERANCE) if m.margin < 0.0]
        if not failing:
            continue
        worst = failing[0]
        largest, unit, why = (
            (vehicles.max_speed, "m/s", "")
            if family.check == "speed"
            else (usable, "m/s²", reserve)
        )
        more = ", and is not the only one" if len(failing) > 1 else ""
        message = (
            f"{worst.between[0]} is asked for up to {largest - worst.margin:.3f} {unit}{more}; "
            f"{largest:g} {unit} are allowed{why}"
        )
        findings.append(_at("error", family.check, message, worst))
    return findings


def _wind_findings(plan: Plan) -> list[Finding]:
    steady = plan.mission.wind.steady
    if steady == 0.0:
        return []
    lost = failure_in_wind(plan, steady)
    if lost is None:
        message = (
            f"cable that hangs free keeps every clearance, and from floor and fence, in a steady "
            f"wind of {steady:g} m/s from each of {DIRECTIONS} directions"
        )
        return [Finding("info", "wind", message)]
    check, (one, other), time = lost
    message = (
        f"the clearances do not hold in the mission's steady wind of {steady:g} m/s: {check}, "
        f"{one} and {other} (at {time:.2f} s)"
    )
    return [Finding("error", "wind", message, time)]


def _wrong_crossings(plan: Plan, at_time: float) -> list[Finding]:
    """Crossings of the layout where the strand that should pass over hangs below the other."""
    layout = plan.layout
    if not layout.crossings:
        return []
    gaps = crossing_gaps(layout.corners, layout.lengths, layout.crossings)
    return [
        Finding(
            "error",
            "crossing condition",
            f"{segment_name(over)} should pass over {segment_name(under)}, "
            f"but hangs {-gap:.3f} m below it where they cross",
            at_time,
        )
        for (over, under), gap in zip(layout.crossings, gaps.tolist(), strict=True)
        if gap <= 0.0
    ]


def _topology(plan: Plan) -> tuple[str, Chirality, str, list[Finding]]:
    if all(phase.cable != "aloft" for phase in plan.phases):
        message = "no cable is carried, so no knot is tied"
        return "0_1", "none", "", [Finding("info", "crossing code", message)]
    at_time = end_time(plan)
    try:
        code = end_code(plan)
        found = end_knot(plan)
    except SwarmError as error:
        message = f"no knot can be read off the end: {error}"
        return "unknown", "none", "", [Finding("error", "crossing code", message, at_time)]
    findings = _wrong_crossings(plan, at_time)
    for what, wanted in _wanted_codes(plan):
        if isinstance(wanted, str):
            findings.append(Finding("error", "crossing code", wanted, at_time))
        elif not same_code(code.as_closed() if wanted.closed else code, wanted):
            message = f"the cable ends in the crossing code {_shown(code)}, {what} {_shown(wanted)}"
            findings.append(Finding("error", "crossing code", message, at_time))
    asked = (plan.knot.type, plan.knot.chirality)
    if plan.knot.type and (found.name, found.chirality) != asked:
        message = f"the cable ends as {found}, but {_knot(*asked)} was asked for"
        severity: Severity = "error" if found.known else "warning"
        findings.append(Finding(severity, "knot type", message, at_time))
    if not findings:
        as_asked = ", as asked" if plan.knot.type else ""
        message = f"the cable ends as {found}, with the crossing code {_shown(code)}{as_asked}"
        findings.append(Finding("info", "crossing code", message, at_time))
    chirality: Chirality = found.chirality  # type: ignore[assignment]
    return found.name, chirality, code.signed_text(), findings


def _wanted_codes(plan: Plan) -> list[tuple[str, SignedGauss | str]]:
    wanted: list[tuple[str, SignedGauss | str]] = []
    try:
        wanted.append(("but the layout's is", layout_code(plan.layout)))
        signed = parse_gauss(plan.knot.gauss).signed() if plan.knot.gauss else None
    except SwarmError as error:
        return [*wanted, ("", str(error))]
    if signed is not None:
        wanted.append(("but the diagram's is", signed))
    return wanted


def _shown(code: SignedGauss) -> str:
    return f"[{code.signed_text()}]"


def _knot(name: str, chirality: str) -> str:
    return name if chirality == "none" else f"{name}, {chirality}-handed,"


def _tightest_findings(moments: Iterable[Moment]) -> list[Finding]:
    return [
        _at(
            "info",
            "tightest",
            f"{number}. {moment.check}: {moment.between[0]} and {moment.between[1]}, "
            f"certified {moment.distance:.3f} m, required {moment.required:g} m, "
            f"margin {moment.margin:+.3f} m",
            moment,
        )
        for number, moment in enumerate(moments, start=1)
    ]


def _tightest(moments: Iterable[Moment], checks: tuple[str, ...], plan: Plan) -> Tightest:
    chosen = [moment for moment in moments if moment.check in checks]
    if not chosen:
        return Tightest(float("inf"), 0.0, float(plan.motion.times[0]), ("", ""))
    worst = min(chosen, key=lambda moment: moment.margin)
    return Tightest(max(worst.distance, 0.0), worst.required, worst.time, worst.between)


def _scope(plan: Plan) -> Finding:
    tracking = plan.mission.vehicles.tracking
    ball = (
        f"for every tracking error of up to {tracking:g} m"
        if tracking > 0
        else "for exact tracking only (vehicles.tracking is 0: geometry only)"
    )
    when = cable_spans(plan)
    if not when.ever:
        message = f"distances of vehicles are certified {ball}; no cable is carried"
        return Finding("info", "scope", message)
    names = [phase.name for phase in plan.phases]
    exempt = ""
    if plan.vehicles > 2:
        near = exempt_length(plan)
        exempt = (
            f"; of two segments that share a vehicle, cable within {near:.2f} m of its grip (at "
            f"most {MOST_EXEMPT:.0%} of the shorter one) is exempt from the clearance between them"
        )
        if when.low:
            exempt += ", and so is all of both while cable lies on the floor in a line"
    return Finding(
        "info",
        "scope",
        f"certified in the quasi-static cable model, {ball}, from {when.gripped:.1f} s, when the "
        f"cable is gripped, {_OUTSIDE[finish_of(names)]}; all vehicles hold it until "
        f"{when.released:.1f} s{exempt}",
    )
