"""Words and figures that pages, the terminal and plots share."""

from collections.abc import Mapping
from typing import Any, Final

from swarm.certification.assessment import Assessment, rounded_down
from swarm.certification.findings import Finding
from swarm.certification.kinds import FIGURES
from swarm.planning import Plan
from swarm.reports.formatting import metres, number_with_unit, seconds

CERTIFIED: Final = "certified in the quasi-static cable model"
TRIAL_DISTANCES: Final = {**FIGURES, "emulated_cable": "cable to cable, emulated"}
SEVERITIES: Final = ("error", "warning", "info")
"""Severities of findings, the worst first."""


def knot_in_words(name: str, chirality: str) -> str:
    """Return a knot's name with its chirality."""
    if not name:
        return "no knot"
    return name if chirality == "none" else f"{name}, {chirality}-handed"


def implied_in_words(plan: Plan, knot: Mapping[str, Any]) -> str:
    """Return a sentence with the knot that the reported positions imply.

    It is "" without a cable, and for a cable without a knot that was to have none.
    ``knot`` is the outcome's: type, chirality, as_planned.
    """
    if not len(plan.layout.lengths):
        return ""
    if knot["type"] == "unknown":
        return "The knot of the cable is not known."
    untied = knot["type"] == "0_1" and not plan.knot.type
    if untied and knot["as_planned"]:
        return ""
    implied = "no knot" if untied else knot_in_words(knot["type"], knot["chirality"])
    unplanned = "" if knot["as_planned"] else ", not the planned knot"
    return f"In the cable model, the reported positions imply {implied}{unplanned}."


def plan_figures(plan: Plan, assessment: Assessment) -> list[tuple[str, object]]:
    """Return the key figures of a plan with their names."""
    fold = plan.phase("fold")
    robustness = assessment.robustness
    return [
        ("vehicles", plan.vehicles),
        ("cable", metres(float(plan.layout.lengths.sum()))),
        ("fold", seconds(fold.duration)),
        ("from take-off to the ground", seconds(plan.flight_duration)),
        ("tracking error certified for", metres(plan.mission.vehicles.tracking)),
        ("largest tracking error e*", _held(robustness.tracking, "m")),
        ("largest steady wind w*", _held(robustness.wind, "m/s")),
    ]


def _held(value: float | None, unit: str) -> str:
    return number_with_unit(None if value is None else rounded_down(value, 2), unit)


def sorted_findings(assessment: Assessment) -> list[Finding]:
    """Return the findings, errors before warnings before remarks."""
    return sorted(assessment.findings, key=lambda found: SEVERITIES.index(found.severity))
