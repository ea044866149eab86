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

    ``runs`` are the JSON objects that ``swarm dry-run --rope --json`` prints, the one of this plan
    first.
    """
    return render(
        "rope.html.j2",
        mission=plan.mission,
        planned_knot=knot_in_words(plan.knot.type, plan.knot.chirality),
        run=runs[0],
        knot=_knot(runs[0]),
        pictures=[picture(figure, "The rope's motion and end", wide=True)],
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
    penetration, stray = run["penetration"], run["deviation"]
    return {
        "knot": _knot(run),
        "shows something": "no" if run["invalid"] else "yes",
        "closest strands": number_with_unit(run["smallest_distance"], "m"),
        "those of the quasi-static cable": number_with_unit(
            run["smallest_distance_of_quasi_static_cable"], "m"
        ),
        "deepest penetration": (
            f"{penetration['radii']:.2f} radii (invalid beyond {penetration['limit']:g})"
        ),
        "largest stretch": f"{run['stretch']['share']:.2%}",
        "top speed": f"{run['speed']['metres_per_second']:.1f} m/s",
        "farthest from the quasi-static cable": metres(stray["largest"]),
        "there and then by sway and a stop, in the budget's models": metres(stray["allowed_swing"]),
        "farther than these by": metres(stray["beyond_models"]["by"]),
        "simulated, took": f"{run['simulated']:.0f} s, {run['computing_time']:.0f} s",
    }
