"""The page of many simulated flights of a plan."""

from collections.abc import Mapping, Sequence
from typing import Any

from matplotlib.figure import Figure

from swarm.certification.assessment import Assessment
from swarm.planning import Plan
from swarm.reports.rendering import picture, render
from swarm.reports.verdicts import trials_verdict
from swarm.reports.wording import TRIAL_DISTANCES, plan_figures, sorted_findings


def trials_report(
    plan: Plan,
    assessment: Assessment,
    summaries: Sequence[Mapping[str, Any]],
    figures: Sequence[Figure],
) -> str:
    """Return the page of many trials: distributions, pictures, worst trials, and the plan.

    ``summaries`` are the JSON objects that ``swarm trials --json`` prints, the one of
    this plan first; ``figures`` are drawn from them.
    """
    summary = summaries[0]
    return render(
        "trials.html.j2",
        mission=plan.mission,
        summary=summary,
        verdict=trials_verdict(summary),
        figures=_figures(summary),
        pictures=[picture(figure, "Smallest distances of all trials") for figure in figures],
        trajectories=[_trajectory(one) for one in summaries],
        spread=[
            (name, ", ".join(value) if isinstance(value, list) else f"{value:g}")
            for name, value in summary["spread"].items()
        ],
        plan_figures=plan_figures(plan, assessment),
        findings=sorted_findings(assessment),
    )


def _figures(summary: Mapping[str, Any]) -> list[tuple[str, object]]:
    low, high = summary["without_failure"]["completed"]["interval"] or (0.0, 1.0)
    return [
        ("trials", summary["trials"]),
        ("of them with a failure", summary["with_failure"]["trials"]),
        (f"completed, {summary['confidence']:.0%} interval", f"{low:.1%} to {high:.1%}"),
        ("with rotor strikes", summary["trials_with_rotor_strikes"]),
        ("with collisions of vehicles", summary["trials_with_collisions"]),
        ("vehicles lost", summary["vehicles_lost"]),
    ]


def _trajectory(summary: Mapping[str, Any]) -> dict[str, Any]:
    return {
        "title": "The paper's trajectory" if summary["method"] == "paper" else "This plan",
        "clearances": [
            (TRIAL_DISTANCES[name], clearance)
            for name, clearance in summary["without_failure"]["clearance"].items()
            if clearance["count"]
        ],
        "reasons": summary["reasons"],
    }
