"""The page of a simulated rope."""

from collections.abc import Mapping, Sequence
from typing import Any

from matplotlib.figure import Figure

from swarm.certification.assessment import Assessment
from swarm.planning import Plan
from swarm.reports.formatting import metres, number_with_unit
from swarm.reports.rendering import picture, render
from swarm.reports.wording import knot_in_words, plan_figures, sorted_findings


def rope_report(
    plan: Plan, assessment: Assessment, runs: Sequence[Mapping[str, Any]], figure: Figure
) -> str:
    """Return the page of a simulated rope.

    ``runs`` are the JSON objects that ``swarm rope --json`` prints, the one of this plan
    first.
    """
    return render(
        "rope.html.j2",
        mission=plan.mission,
        planned_knot=knot_in_words(plan.knot.type, plan.knot.chirality),
        run=runs[0],
        knot=_knot(runs[0]),
        pictures=[picture(figure, "Distances of the rope and its final shape", wide=True)],
        head=["", *(run["trajectory"] for run in runs)],
        rows=_rows(runs),
        plan_figures=plan_figures(plan, assessment),
        findings=sorted_findings(assessment),
    )


def _knot(run: Mapping[str, Any]) -> str:
    return knot_in_words(run["knot"]["type"], run["knot"]["chirality"])


def _rows(runs: Sequence[Mapping[str, Any]]) -> list[tuple[str, ...]]:
    """Return a row per quantity: its name, and its value in each run."""
    values = [_values(run) for run in runs]
    return [(name, *(value[name] for value in values)) for name in values[0]]


def _values(run: Mapping[str, Any]) -> dict[str, str]:
    penetration, deviation = run["penetration"], run["deviation"]
    return {
        "knot": _knot(run),
        "valid": "no" if run["invalid"] else "yes",
        "smallest distance of strands": number_with_unit(run["smallest_distance"], "m"),
        "the same of the quasi-static cable": number_with_unit(
            run["smallest_distance_of_quasi_static_cable"], "m"
        ),
        "deepest penetration": (
            f"{penetration['radii']:.2f} radii (invalid beyond {penetration['limit']:g})"
        ),
        "largest stretch": f"{run['stretch']['share']:.2%}",
        "top speed": f"{run['speed']['metres_per_second']:.1f} m/s",
        "largest distance from the quasi-static cable": metres(deviation["largest"]),
        "allowed there by the budget's models": metres(deviation["allowed_swing"]),
        "largest excess over these models": metres(deviation["beyond_models"]["by"]),
        "simulated time": f"{run['simulated']:.0f} s",
        "computing time": f"{run['computing_time']:.0f} s",
    }
