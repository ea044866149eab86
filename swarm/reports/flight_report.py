"""The page of a flight or of a dry run, with pictures of the cable's swing, planned and flown."""

from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from swarm.certification.assessment import Assessment
from swarm.certification.kinds import FIGURES
from swarm.certification.swing_runs import aloft, swings
from swarm.errors import Refused
from swarm.flight.snapshot import Event
from swarm.flight.swinging import SwingCurves, swing_curves
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
from swarm.reports.plots import ALARM, END, INK, START, STYLE, save
from swarm.reports.rendering import Picture, picture, render
from swarm.reports.strand_distances import sampling_step, smallest_strand_distances
from swarm.reports.verdicts import flight_verdict, largest_fold_error
from swarm.reports.wording import knot_in_words, plan_figures, sorted_findings


def plot_shaping(shaped: Plan, time_optimal: Plan, path: Path) -> None:
    """Write a PNG of the planned swing of a plan, and of the same knot's time-optimal fold.

    Raises :class:`swarm.errors.Refused` where a plan folds no cable.
    """
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(8.0, 3.0), layout="constrained")
        FigureCanvasAgg(figure)
        axes = figure.subplots()
        for plan, words, colour in (
            (time_optimal, "time-optimal", START), (shaped, "as planned: shaped and slowed", END)
        ):  # fmt: skip
            _draw_planned(axes, plan, words, colour)
        since = "time since the beginning of the fold, s (dotted: its end)"
        axes.set(xlabel=since, ylabel="largest stray, m")
        axes.set_title("Swing of the cable in fold and hold, vehicles exactly on the plan")
        axes.set_ylim(0.0, 1.2 * axes.get_ylim()[1])
        axes.set_xlim(left=0.0)
        axes.legend(fontsize=8.0, frameon=False, loc="upper center", ncols=2)
    save(figure, path)


def _draw_planned(axes: Axes, plan: Plan, words: str, colour: object) -> None:
    span = aloft(plan)
    if span is None:
        raise Refused(f"{plan.mission.name}: the plan folds no cable")
    planned = next(swings(plan, span))
    fold, hold = plan.phase("fold"), plan.phase("hold")
    stray = np.linalg.norm(planned.strays[0], axis=-1).max(axis=(1, 2))
    shown = planned.times[0] <= hold.end
    time = planned.times[0][shown] - fold.start
    words = f"{words}: {fold.duration:.0f} s, at most {stray[shown].max():.2f} m"
    axes.plot(time, stray[shown], color=colour, linewidth=1.2, label=words)
    axes.axvline(fold.duration, color=colour, linewidth=0.8, linestyle=":")


def draw_swing(axes: Axes, swing: SwingCurves) -> None:
    """Draw the largest stray of all strands over mission time, metres.

    What was estimated in the flight, what is planned, the radius of the tube, and what tube and
    budget allow together. Where the clock waits or runs backwards, the estimate stays or returns.
    """
    order = swing.time.argsort(kind="stable")
    time, allowed, tube = (
        of[order] for of in (swing.time, swing.allowed.max(axis=1), swing.tube.max(axis=1))
    )
    axes.fill_between(
        time, tube, allowed, color=END, alpha=0.08, linewidth=0.0,
        label="excited by tracking errors (budget)",
    )  # fmt: skip
    axes.fill_between(
        time, tube, color=END, alpha=0.2, linewidth=0.0,
        label="tube of the plan, with stops and rewinds",
    )  # fmt: skip
    planned = swing.planned.max(axis=1)[order]
    axes.plot(time, planned, color=END, linewidth=1.2, label="planned")
    axes.plot(swing.time, swing.estimated.max(axis=1), color=INK, linewidth=1.0, label="estimated")
    beyond = (swing.estimated > swing.allowed).any(axis=1)
    if beyond.any():
        axes.plot(
            swing.time[beyond], swing.estimated.max(axis=1)[beyond], ".", color=ALARM,
            markersize=3, label="a strand beyond what it is allowed",
        )  # fmt: skip
    axes.set(xlabel="mission time, s", ylabel="largest stray, m")
    axes.set_title("Swing of the cable")
    axes.set_ylim(0.0, 1.45 * float(allowed.max()))
    axes.legend(fontsize=7.5, frameon=False, loc="upper left", ncols=2)


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
        (FIGURES[name], both["flown"], both["certified"])
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
