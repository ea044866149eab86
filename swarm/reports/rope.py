"""A simulated rope: its knot and its deviation from the cable model; terminal and page.

A run is everywhere the JSON object that ``swarm rope --json`` prints.
"""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from rich.console import Console

from swarm.certification.assessment import Assessment
from swarm.planning import Plan
from swarm.reports.formatting import knot_in_words, metres
from swarm.reports.result import Table, Verdict, picture, say

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Document = Mapping[str, Any]


def print_rope(run: Document, plan: Plan, console: Console) -> None:
    """Print the knot of a rope, its distances, and its deviation from the cable model."""
    knot, deviation = run["knot"], run["deviation"]
    say(
        console,
        f"\n[bold]A rope of {run['links']} links moved by {run['trajectory']}[/], "
        f"{run['simulated']:.0f} s in {run['computing_time']:.0f} s",
    )
    if run["invalid"]:
        reasons = (f"  {reason}" for reason in run["invalid"])
        say(console, "[bold red]The run is invalid:[/]", *reasons)
    style = "green" if knot["as_planned"] and not run["invalid"] else "red"
    hand = "" if knot["chirality"] == "none" else f" {knot['chirality']}-handed"
    planned = f"{plan.knot.type} {plan.knot.chirality}-handed".replace(" none-handed", "")
    planned = planned.strip() or "none"
    name = "Knot after tightening" if run["tightened"] else "Knot of the rope"
    say(console, f"{name}: [{style}]{knot['type']}{hand}[/] (planned: {planned})")
    if run["tightened"]:
        say(console, f"tightened until its ends were {run['end_distance']:.2f} m apart")
    if run["smallest_distance"] is not None:
        static = run["smallest_distance_of_quasi_static_cable"]
        say(
            console,
            "smallest distance of segments without a common vehicle: "
            f"{run['smallest_distance']:.2f} m (quasi-static cable: {static:.2f} m)",
        )
    say(
        console,
        f"largest distance from the quasi-static cable: {deviation['largest']:.2f} m, segment "
        f"{deviation['segment']} at {deviation['time']:.0f} s; the budget's models of sway and a "
        f"stop allow {deviation['allowed_swing']:.2f} m there",
    )
    beyond = deviation["beyond_models"]
    if beyond["share"]:
        say(
            console,
            f"it exceeds these models by up to {beyond['by']:.2f} m, at {beyond['share']:.0%} "
            "of moments and segments: strands swing on after a movement",
        )
    depth, stretch, speed = run["penetration"], run["stretch"], run["speed"]
    say(
        console,
        f"deepest penetration {depth['radii']:.2f} radii (invalid beyond {depth['limit']:g}), "
        f"largest stretch {stretch['share']:.2%} (invalid beyond {stretch['limit']:.0%}), "
        f"top speed {speed['metres_per_second']:.1f} m/s (invalid beyond {speed['limit']:g})",
    )


def rope_report(
    plan: Plan, assessment: Assessment, runs: Sequence[Document], figure: "Figure"
) -> str:
    """Return the page of a simulated rope; the first run is that of this plan."""
    from swarm.reports import pages  # noqa: PLC0415 - slow to import

    run = runs[0]
    pictures = [picture(figure, "Distances of the rope and its final shape", wide=True)]
    columns = ["", *(run["trajectory"] for run in runs)]
    values = [_quantities(run) for run in runs]
    rows = [(name, *(value[name] for value in values)) for name in values[0]]
    return pages.page(
        "Rope",
        plan.mission.name,
        f"a rope of {run['links']} links",
        _verdict(run),
        [
            pages.Section("Pictures", pictures=pictures),
            pages.Section("Figures", [Table(columns, rows)]),
            pages.plan_section(plan, assessment),
        ],
        about=[f"Planned knot: {knot_in_words(plan.knot.type, plan.knot.chirality)}"],
    )


def _knot(run: Document) -> str:
    return knot_in_words(run["knot"]["type"], run["knot"]["chirality"])


def _verdict(run: Document) -> Verdict:
    if run["invalid"]:
        return Verdict("bad", f"This run is invalid: {'; '.join(run['invalid'])}.")
    if run["knot"]["as_planned"]:
        return Verdict("good", f"The rope ends in {_knot(run)}.")
    return Verdict("bad", f"The rope ends in {_knot(run)}, not the planned knot.")


def _quantities(run: Document) -> dict[str, str]:
    penetration, deviation = run["penetration"], run["deviation"]
    return {
        "knot": _knot(run),
        "valid": "no" if run["invalid"] else "yes",
        "smallest distance of strands": metres(run["smallest_distance"]),
        "the same of the quasi-static cable": metres(
            run["smallest_distance_of_quasi_static_cable"]
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
