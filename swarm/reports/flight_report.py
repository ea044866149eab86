"""The page of a flight or of a dry run."""

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

import matplotlib as mpl
import numpy as np
import numpy.typing as npt

from swarm.certification.assessment import Assessment
from swarm.flight.flown_swing import swing_curves
from swarm.flight.snapshot import Event
from swarm.flight.trace import Trace
from swarm.planning import Plan
from swarm.reports import plots
from swarm.reports.fold_labels import label_fold
from swarm.reports.formatting import (
    ROUTINE_KINDS,
    event_text,
    log_level,
    merge_events,
    metres,
    seconds,
)
from swarm.reports.motion_view import flown_motion
from swarm.reports.rendering import Picture, picture, render
from swarm.reports.strand_distances import sampling_step, smallest_strand_distances
from swarm.reports.swing_plots import draw_swing
from swarm.reports.verdicts import flight_verdict, largest_fold_error
from swarm.reports.wording import (
    CLEARANCES,
    knot_in_words,
    plan_figures,
    sorted_findings,
)


def flight_report(
    plan: Plan,
    assessment: Assessment,
    outcome: Mapping[str, Any],
    trace: Trace,
    events: Iterable[Event],
) -> str:
    """Return the page of a flight or of a dry run.

    ``outcome`` is the JSON object that ``swarm fly --json`` prints.
    """
    shown_events = merge_events(event for event in events if event.kind not in ROUTINE_KINDS)
    return render(
        "flight.html.j2",
        mission=plan.mission,
        knot=knot_in_words(plan.knot.type, plan.knot.chirality),
        outcome=outcome,
        verdict=flight_verdict(plan, outcome),
        figures=_figures(plan, outcome),
        motion=flown_motion(plan, outcome, trace),
        clearances=_clearances(outcome["clearance"]),
        pictures=_pictures(plan, trace),
        tracking_errors=[
            error for error in outcome["tracking_error"] if error["vehicle"] == 0 and error["phase"]
        ],
        tracking_radius=plan.mission.vehicles.tracking,
        events=[
            (one.time, log_level(one), event_text(one, others)) for one, others in shown_events
        ],
        plan_figures=plan_figures(plan, assessment),
        findings=sorted_findings(assessment),
    )


def _figures(plan: Plan, outcome: Mapping[str, Any]) -> list[tuple[str, object]]:
    chord = outcome["max_chord_ratio"]
    return [
        ("vehicles", plan.vehicles),
        ("duration of the flight", seconds(outcome["duration"])),
        ("largest tracking error in the fold", metres(largest_fold_error(outcome) or np.nan)),
        ("chord of the tautest segment", "–" if chord is None else f"{chord:.1%}"),
        ("setpoints sent", outcome["setpoints"]),
        ("longest time between setpoints", f"{outcome['setpoint_gap']['seconds']:.2f} s"),
        ("ms late (median, 99 %)", _lateness(outcome["setpoint_lateness"])),
        ("packets lost", sum(outcome["packets_lost"].values())),
    ]


def _lateness(lateness: Mapping[str, float] | None) -> str:
    return f"{lateness['median'] * 1e3:.1f}, {lateness['p99'] * 1e3:.1f}" if lateness else "–"


def _clearances(clearance: Mapping[str, Any]) -> list[tuple[str, Any, Any]]:
    """Return name, flown and certified distance of each clearance; none if none was flown.

    A clearance of two things that the plan does not have has no certified distance.
    """
    if all(both["flown"] is None for both in clearance.values()):
        return []
    return [
        (CLEARANCES[name], both["flown"], both["certified"])
        for name, both in clearance.items()
        if both["certified"]["distance"] is not None
    ]


@mpl.rc_context(plots.STYLE)
def _pictures(plan: Plan, trace: Trace) -> list[Picture]:
    pictures = []
    figure, axes = plots.new_axes((8.0, 3.0))
    plots.draw_errors(axes, trace, plan.mission.vehicles.tracking)
    pictures.append(picture(figure, "Tracking error of every vehicle", wide=True))
    figure, axes = plots.new_axes((8.0, 2.2))
    plots.draw_clock(axes, trace)
    pictures.append(picture(figure, "Mission clock over time", wide=True))
    swing = swing_curves(plan, trace)
    if swing is not None:
        figure, axes = plots.new_axes((8.0, 2.8))
        draw_swing(axes, swing)
        title = "Swing of the cable: estimated, planned, and allowed by tube and budget"
        pictures.append(picture(figure, title, wide=True))
    aloft = np.flatnonzero(_aloft(trace))
    sampled = aloft[:: sampling_step(trace)]
    if len(plan.layout.lengths) >= 3 and len(sampled):
        figure, axes = plots.new_axes((8.0, 2.8))
        distance = smallest_strand_distances(plan, trace.position[sampled])
        required = plan.mission.clearance.cable
        title = "Distance of strands that are not neighbours, as flown (sampled)"
        plots.draw_clearance(axes, trace.mission_time[sampled], distance, required, title)
        pictures.append(picture(figure, title, wide=True))
    figure, axes = plots.new_axes()
    plots.draw_flown_view(axes, plan, trace)
    pictures.append(
        picture(figure, "The planned cable from above, with the last reported positions")
    )
    if len(aloft):
        figure, axes = plots.new_axes(projection="3d")
        held = replace(plan.layout, corners=trace.position[aloft[-1]])
        plots.draw_fold(axes, held)
        axes.set_title("Cable at the end of the hold, distances at crossings")
        label_fold(axes, held, plots.INK)
        pictures.append(picture(figure, "The cable in space at the end of the hold"))
    return pictures


def _aloft(trace: Trace) -> npt.NDArray[np.bool_]:
    """Return at which instants (k,) of fold and hold every vehicle's position is reported."""
    aloft = np.isin(np.array(trace.phase, dtype=str), ["fold", "hold"])
    return aloft & np.isfinite(trace.position).all(axis=(1, 2))
