"""What the pages of plans, flights and dry runs have in common."""

from collections.abc import Mapping
from typing import Any, Final

from swarm.certification.assessment import Assessment
from swarm.planning import Plan
from swarm.reports.formatting import metres, seconds
from swarm.reports.page import Html, table, tag
from swarm.version import __version__

CERTIFIED: Final = "certified in the quasi-static cable model"
_SEVERITIES: Final = {"error": "bad", "warning": "warn", "info": "dim"}
CLEARANCES: Final = {
    "cable": "cable to cable",
    "vehicle": "vehicle to vehicle",
    "vehicle_cable": "vehicle to cable",
}


def knot_in_words(name: str, chirality: str) -> str:
    """Return a knot's name with its handedness."""
    if not name:
        return "no knot"
    return name if chirality == "none" else f"{name}, {chirality}-handed"


def implied_in_words(plan: Plan, knot: Mapping[str, Any]) -> str:
    """Return what reported positions tell of the knot, a sentence; nothing without a cable.

    ``knot`` is the outcome's: type, chirality, as_planned.
    """
    if not len(plan.layout.lengths):
        return ""
    if knot["type"] == "unknown":
        return "Which knot the cable has is not known."
    untied = knot["type"] == "0_1" and not plan.knot.type
    implied = "no knot" if untied else knot_in_words(knot["type"], knot["chirality"])
    unplanned = "" if knot["as_planned"] else ", which is not what was planned"
    return f"The reported positions imply {implied} in the cable model{unplanned}."


def certified_in_words(plan: Plan) -> str:
    """Return what a cleared plan is certified for."""
    return CERTIFIED if len(plan.layout.lengths) else "distances between vehicles are certified"


def or_dash(value: float | None, unit: str) -> str:
    """Return a figure with its unit, a dash where there is none."""
    return "–" if value is None else f"{value:.2f} {unit}"


def kept(distance: float, required: float) -> Html:
    """Return a distance, marked by whether it is what is required."""
    return tag("span", metres(distance), kind="good" if distance >= required else "bad")


def plan_figures(plan: Plan, assessment: Assessment) -> list[tuple[str, object]]:
    """Return the figures that a careful reader looks at first."""
    fold = plan.phase("fold")
    robustness = assessment.robustness
    return [
        ("vehicles", plan.vehicles),
        ("cable", metres(float(plan.layout.lengths.sum()))),
        ("fold", seconds(fold.end - fold.start)),
        ("from take-off to the ground", seconds(plan.duration)),
        ("tracking error certified for", metres(plan.mission.vehicles.tracking)),
        ("largest tracking error e*", or_dash(robustness.tracking, "m")),
        ("largest steady wind w*", or_dash(robustness.wind, "m/s")),
    ]


def findings(assessment: Assessment) -> Html:
    """Return what the checks found, the gravest first."""
    order = list(_SEVERITIES)
    rows = [
        (
            tag("span", finding.severity, kind=_SEVERITIES[finding.severity]),
            finding.check,
            finding.message,
            "" if finding.at_time is None else seconds(finding.at_time),
        )
        for finding in sorted(assessment.findings, key=lambda found: order.index(found.severity))
    ]
    return table(("severity", "check", "says", "at"), rows, frozenset({3}))


def footer() -> Html:
    """Return what every page says at its end."""
    return tag(
        "footer",
        f"swarm {__version__}. {CERTIFIED.capitalize()} means: for every displacement of every "
        "grip point within the tracking ball, as long as the cable hangs as catenaries do. It is "
        "not a proof about the real cable, and no eye has seen the knot.",
    )
