"""The knot of the folded cable: its exact crossing code, its type, and findings on them."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from swarm.certification.distances import segment_name
from swarm.certification.findings import Finding, Severity
from swarm.errors import SwarmError
from swarm.geometry.chain import crossing_gaps, plan_crossings, polyline
from swarm.knots.curve import curve_gauss
from swarm.knots.gauss import SignedGauss, parse_gauss, same_code
from swarm.knots.invariants import Identification, identify_curve
from swarm.planning import KnotLayout, Plan

Floats = npt.NDArray[np.float64]

PIECES_PER_SEGMENT = 64
"""Straight pieces of a segment in a curve: 5 cm of a segment of 3 m."""


def layout_code(layout: KnotLayout) -> SignedGauss:
    """Return the signed Gauss code of the layout's corners and crossings, seen from above.

    Raises :class:`swarm.errors.SwarmError` where the crossings are not those of the corners.
    """
    crossings = plan_crossings(layout.corners)
    over_of = {frozenset(pair): pair[0] for pair in layout.crossings}
    met = {frozenset(pair) for pair in crossings.segments.tolist()}
    if met != set(over_of):
        wrong = sorted(sorted(i + 1 for i in pair) for pair in met ^ set(over_of))
        raise SwarmError(f"crossings in plan view and of the layout differ, segments: {wrong}")
    steps = np.diff(layout.corners[:, :2], axis=0)
    passes = []
    for label, (pair, where) in enumerate(
        zip(crossings.segments.tolist(), crossings.fractions.tolist(), strict=True), start=1
    ):
        over = over_of[frozenset(pair)]
        under = pair[1] if pair[0] == over else pair[0]
        turn = steps[over, 0] * steps[under, 1] - steps[over, 1] * steps[under, 0]
        sign = 1 if turn > 0 else -1
        passes += [
            ((segment, place), (label, segment == over, sign))
            for segment, place in zip(pair, where, strict=True)
        ]
    return SignedGauss.of((entry for _, entry in sorted(passes)), closed=False)


def cable_curve(grip_points: Floats, lengths: Floats) -> Floats:
    """Return the cable as a curve (k, 3), every segment the catenary of its length."""
    return polyline(grip_points, lengths, PIECES_PER_SEGMENT)


def end_code(plan: Plan) -> SignedGauss:
    """Return the signed Gauss code of the folded cable in plan view.

    Raises :class:`swarm.errors.SwarmError` where strands meet or the cable is over-stretched.
    """
    return curve_gauss(cable_curve(_held(plan), plan.layout.lengths))


def end_knot(plan: Plan) -> Identification:
    """Return the knot type of the folded cable in space, its ends closed upwards."""
    return identify_curve(cable_curve(_held(plan), plan.layout.lengths))


def ties_planned_knot(plan: Plan, knot: Identification, code: SignedGauss) -> bool:
    """Return whether a curve, identified and with its crossing ``code``, has the knot of a plan.

    A knot with a name is compared by name and chirality, which tracking errors do not change as
    long as no strand passes another; in plan view they may add crossings that change no knot. Any
    other knot is compared by its exact crossing code.
    """
    if plan.knot.type and knot.known:
        return (knot.name, knot.chirality) == (plan.knot.type, plan.knot.chirality)
    return same_code(code, layout_code(plan.layout))


def end_time(plan: Plan) -> float:
    """Return the mission time of the folded cable: the last one aloft before it unfolds."""
    return max(
        phase.end for phase in plan.phases if phase.cable == "aloft" and phase.name != "unfold"
    )


def _held(plan: Plan) -> Floats:
    return plan.motion.at(end_time(plan))[0]


Chirality = Literal["left", "right", "none"]


@dataclass(frozen=True)
class TiedKnot:
    """The knot at the end of a plan: type, chirality, signed Gauss code, and the findings on it."""

    type: str
    chirality: Chirality
    gauss: str
    findings: tuple[Finding, ...]


def tied_knot(plan: Plan) -> TiedKnot:
    """Return the knot of the folded cable, compared with the layout and the required knot."""
    if all(phase.cable != "aloft" for phase in plan.phases):
        message = "no cable is carried, so no knot is tied"
        return TiedKnot("0_1", "none", "", (Finding("info", "crossing code", message),))
    at_time = end_time(plan)
    try:
        code = end_code(plan)
        knot = end_knot(plan)
    except SwarmError as error:
        message = f"the knot at the end cannot be identified: {error}"
        failed = Finding("error", "crossing code", message, at_time)
        return TiedKnot("unknown", "none", "", (failed,))
    findings = _crossing_findings(plan, at_time)
    for source, expected in _expected_codes(plan):
        if isinstance(expected, str):
            findings.append(Finding("error", "crossing code", expected, at_time))
        elif not same_code(code.as_closed() if expected.closed else code, expected):
            message = f"crossing code {_text(code)} at the end; {source} has {_text(expected)}"
            findings.append(Finding("error", "crossing code", message, at_time))
    required = (plan.knot.type, plan.knot.chirality)
    if plan.knot.type and (knot.name, knot.chirality) != required:
        message = f"knot {knot} at the end; {_knot(*required)} required"
        severity: Severity = "error" if knot.known else "warning"
        findings.append(Finding(severity, "knot type", message, at_time))
    if not findings:
        as_required = ", as required" if plan.knot.type else ""
        message = f"knot {knot} at the end, crossing code {_text(code)}{as_required}"
        findings.append(Finding("info", "crossing code", message, at_time))
    chirality: Chirality = knot.chirality  # type: ignore[assignment]
    return TiedKnot(knot.name, chirality, code.signed_text(), tuple(findings))


def _crossing_findings(plan: Plan, at_time: float) -> list[Finding]:
    """Crossings of the layout at which the upper strand hangs below the lower one."""
    layout = plan.layout
    if not layout.crossings:
        return []
    gaps = crossing_gaps(layout.corners, layout.lengths, layout.crossings)
    return [
        Finding(
            "error",
            "crossing condition",
            f"{segment_name(over)} is {-gap:.3f} m below {segment_name(under)} at their crossing; "
            "it must be above it",
            at_time,
        )
        for (over, under), gap in zip(layout.crossings, gaps.tolist(), strict=True)
        if gap <= 0.0
    ]


def _expected_codes(plan: Plan) -> list[tuple[str, SignedGauss | str]]:
    """Codes of the layout and of the diagram, each with its source; or an error message."""
    expected: list[tuple[str, SignedGauss | str]] = []
    try:
        expected.append(("the layout", layout_code(plan.layout)))
        signed = parse_gauss(plan.knot.gauss).signed() if plan.knot.gauss else None
    except SwarmError as error:
        return [*expected, ("", str(error))]
    if signed is not None:
        expected.append(("the diagram", signed))
    return expected


def _text(code: SignedGauss) -> str:
    return f"[{code.signed_text()}]"


def _knot(name: str, chirality: str) -> str:
    return name if chirality == "none" else f"{name}, {chirality}-handed,"
