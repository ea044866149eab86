"""A simulated rope on the terminal, and its curves for the figure."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import Console

from swarm.planning import Plan
from swarm.reports.rope_plots import RopeCurves

if TYPE_CHECKING:
    from swarm_rope import RopeRun


def rope_curves(run: "RopeRun") -> RopeCurves:
    """Return the curves of a run: at each moment the largest deviation of a segment."""
    excess = np.where(run.deviation > run.allowed_swing, run.deviation, -np.inf).max(
        axis=1, initial=-np.inf
    )
    return RopeCurves(
        label=run.trajectory,
        verdict=_verdict(run),
        times=run.times,
        deviation=run.deviation.max(axis=1, initial=0.0),
        excess=np.where(np.isfinite(excess), excess, np.nan),
        strand_distance=run.distance,
        static_distance=run.static_distance,
        shape=run.shape,
    )


def print_rope(document: Mapping[str, Any], plan: Plan, console: Console) -> None:
    """Print the knot of a rope, its distances, and its deviation from the cable model.

    ``document`` is the JSON object of the result.
    """
    for line in _lines(document, plan):
        console.print(line, highlight=False, soft_wrap=True)


def _verdict(run: "RopeRun") -> str:
    if run.invalid:
        return "invalid"
    hand = "" if run.chirality == "none" else f", {run.chirality}-handed"
    return f"{run.knot}{hand}" + ("" if run.as_planned else " (not as planned)")


def _lines(document: Mapping[str, Any], plan: Plan) -> list[str]:
    knot, deviation = document["knot"], document["deviation"]
    lines = [
        f"\n[bold]A rope of {document['links']} links moved by {document['trajectory']}[/], "
        f"{document['simulated']:.0f} s in {document['computing_time']:.0f} s"
    ]
    if document["invalid"]:
        lines += [
            "[bold red]The run is invalid:[/]",
            *(f"  {reason}" for reason in document["invalid"]),
        ]
    style = "green" if knot["as_planned"] and not document["invalid"] else "red"
    hand = "" if knot["chirality"] == "none" else f" {knot['chirality']}-handed"
    planned = f"{plan.knot.type} {plan.knot.chirality}-handed".replace(" none-handed", "")
    planned = planned.strip() or "none"
    name = "Knot after tightening" if document["tightened"] else "Knot of the rope"
    lines.append(f"{name}: [{style}]{knot['type']}{hand}[/] (planned: {planned})")
    if document["tightened"]:
        lines.append(f"tightened until its ends were {document['end_distance']:.2f} m apart")
    if document["smallest_distance"] is not None:
        static = document["smallest_distance_of_quasi_static_cable"]
        lines.append(
            "smallest distance of segments without a common vehicle: "
            f"{document['smallest_distance']:.2f} m (quasi-static cable: {static:.2f} m)"
        )
    lines.append(
        f"largest distance from the quasi-static cable: {deviation['largest']:.2f} m, segment "
        f"{deviation['segment']} at {deviation['time']:.0f} s; the budget's models of sway and a "
        f"stop allow {deviation['allowed_swing']:.2f} m there"
    )
    beyond = deviation["beyond_models"]
    if beyond["share"]:
        lines.append(
            f"it exceeds these models by up to {beyond['by']:.2f} m, at {beyond['share']:.0%} "
            "of moments and segments: strands swing on after a movement"
        )
    depth, stretch, speed = document["penetration"], document["stretch"], document["speed"]
    lines.append(
        f"deepest penetration {depth['radii']:.2f} radii (invalid beyond {depth['limit']:g}), "
        f"largest stretch {stretch['share']:.2%} (invalid beyond {stretch['limit']:.0%}), "
        f"top speed {speed['metres_per_second']:.1f} m/s (invalid beyond {speed['limit']:g})"
    )
    return lines
