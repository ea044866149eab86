"""Findings on the knot: the crossing code and the knot type of the cable at the end of a plan."""

from dataclasses import dataclass
from typing import Literal

from swarm.certification.clearances import segment_name
from swarm.certification.findings import Finding, Severity
from swarm.certification.topology import end_code, end_knot, end_time, layout_code
from swarm.errors import SwarmError
from swarm.geometry.chain import crossing_gaps
from swarm.knots.gauss import SignedGauss, parse_gauss, same_code
from swarm.planning import Plan

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
        found = end_knot(plan)
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
    if plan.knot.type and (found.name, found.chirality) != required:
        message = f"knot {found} at the end; {_knot(*required)} required"
        severity: Severity = "error" if found.known else "warning"
        findings.append(Finding(severity, "knot type", message, at_time))
    if not findings:
        as_required = ", as required" if plan.knot.type else ""
        message = f"knot {found} at the end, crossing code {_text(code)}{as_required}"
        findings.append(Finding("info", "crossing code", message, at_time))
    chirality: Chirality = found.chirality  # type: ignore[assignment]
    return TiedKnot(found.name, chirality, code.signed_text(), tuple(findings))


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
