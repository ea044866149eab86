"""One page per plan and per flight, to be kept, printed and sent: HTML that needs no network."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any, Final

import matplotlib as mpl
import numpy as np
import numpy.typing as npt
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from swarm.certification.assessment import Assessment, Tightest
from swarm.flight.snapshot import Event
from swarm.flight.trace import Trace
from swarm.planning import Plan
from swarm.reports import plots, scene
from swarm.reports.formatting import ROUTINE, clock, level, merged, metres, seconds, sentence
from swarm.reports.page import Html, key_figures, page, picture, pictures, section, table, tag
from swarm.reports.report_parts import (
    CLEARANCES,
    certified_in_words,
    findings,
    footer,
    implied_in_words,
    kept,
    knot_in_words,
    plan_figures,
)
from swarm.reports.strand_distances import CLEARANCE_STEP, distances_of_strands, strand_distances

LEVELS: Final = {"ERROR": "bad", "WARN": "warn", "INFO": ""}


def plan_report(plan: Plan, assessment: Assessment) -> str:
    """Return the page of a plan: verdict, findings, figures, pictures, tables."""
    asked_for = knot_in_words(plan.knot.type, plan.knot.chirality)
    verdict = (
        tag("div", f"Cleared: {certified_in_words(plan)}.", kind="verdict good")
        if assessment.cleared
        else tag("div", f"Refused: {_errors(assessment)}.", kind="verdict bad")
    )
    return page(
        f"Plan: {plan.mission.name}",
        tag("h1", f"{plan.mission.name}: plan for {asked_for}"),
        tag("p", f"Gauss code {plan.knot.gauss}", kind="dim") if plan.knot.gauss else Html(""),
        verdict,
        key_figures(plan_figures(plan, assessment)),
        section("Findings", findings(assessment)),
        section("Smallest distances", _certified(assessment)),
        section("Pictures", pictures(*_plan_pictures(plan, assessment))),
        *_plan_tables(plan),
        footer(),
    )


def flight_report(
    plan: Plan,
    assessment: Assessment,
    outcome: Mapping[str, Any],
    trace: Trace,
    events: Iterable[Event],
) -> str:
    """Return the page of a flight or of a dry run.

    ``outcome`` is the JSON object that ``swarm fly --json`` prints: word, implied knot, clearances
    flown and certified, tracking, timing.
    """
    done = outcome["outcome"] == "done"
    implied = implied_in_words(plan, outcome["knot"])
    as_planned = outcome["knot"]["as_planned"]
    good = done and as_planned and outcome["adherence"]["within"]
    return page(
        f"Flight: {plan.mission.name}",
        tag("h1", f"{plan.mission.name}: flight"),
        tag("p", f"Asked for {knot_in_words(plan.knot.type, plan.knot.chirality)}", kind="dim"),
        tag("p", f"Flown {outcome['certificate']['words']}.", kind="dim"),
        _outside_certificate(outcome),
        tag(
            "div",
            f"{outcome['outcome'].capitalize()}: {outcome['explanation']}. {implied}".rstrip(),
            kind="verdict good" if good else "verdict bad",
        ),
        key_figures(_flight_figures(plan, outcome)),
        section("Smallest distances", _flown(outcome)),
        section("Notes", *(tag("p", note) for note in outcome["notes"])),
        section("Pictures", pictures(*_flight_pictures(plan, trace))),
        section("Tracking error", _tracking(outcome["tracking"], plan)),
        section("Events", _events(events)),
        section("The plan", key_figures(plan_figures(plan, assessment)), findings(assessment)),
        footer(),
    )


def _outside_certificate(outcome: Mapping[str, Any]) -> Html:
    kept = outcome["adherence"]
    if kept["within"]:
        return Html("")
    return tag("div", f"{kept['words'][0].upper()}{kept['words'][1:]}.", kind="verdict bad")


def _worst_in_fold(outcome: Mapping[str, Any]) -> float:
    return max((e["max"] for e in outcome["tracking"] if e["phase"] == "fold"), default=np.nan)


def _errors(assessment: Assessment) -> str:
    count = sum(finding.severity == "error" for finding in assessment.findings)
    return f"{count} error{'s' if count > 1 else ''}"


def _certified(assessment: Assessment) -> Html:
    rows = [
        (name, kept(least.distance, least.required), metres(least.required), *_where(least))
        for name, least in zip(
            CLEARANCES.values(),
            (assessment.cable, assessment.vehicle, assessment.vehicle_cable),
            strict=True,
        )
    ]
    head = ("", "certified", "required", "at", "between")
    return table(head, rows, frozenset({1, 2, 3}))


def _where(least: Tightest) -> tuple[str, str]:
    if not np.isfinite(least.distance):
        return "–", "–"
    return seconds(least.time), " and ".join(least.between)


@mpl.rc_context(plots.STYLE)
def _plan_pictures(plan: Plan, assessment: Assessment) -> list[Html]:
    found = []
    if plan.knot.grid_columns:
        figure, axes = _axes()
        plots.draw_grid(axes, plan.knot)
        found.append(picture(figure, "Grid diagram of the knot"))
    figure, axes = _axes()
    plots.draw_plan_view(axes, plan.layout)
    found.append(picture(figure, "The cable from above; under strands have gaps"))
    figure, axes = _axes(projection="3d")
    plots.draw_fold(axes, plan.layout)
    found.append(picture(figure, "The folded cable in space"))
    if plan.vehicles >= 4:
        figure, axes = _axes((8.0, 2.8))
        times, distance = strand_distances(plan)
        required = plan.mission.clearance.cable
        title = "Distance of strands that are not neighbours (sampled, without errors)"
        plots.draw_over_time(axes, times, distance, required, title, assessment.cable)
        found.append(picture(figure, title, wide=True))
    schedule = plots.schedule_figure(plan)
    found.append(picture(schedule, "Schedule and heights of the vehicles", wide=True))
    return found


@mpl.rc_context(plots.STYLE)
def _flight_pictures(plan: Plan, trace: Trace) -> list[Html]:
    found = []
    figure, axes = _axes((8.0, 3.0))
    plots.draw_errors(axes, trace, plan.mission.vehicles.tracking)
    found.append(picture(figure, "Tracking error of every vehicle", wide=True))
    figure, axes = _axes((8.0, 2.2))
    plots.draw_clock(axes, trace)
    found.append(picture(figure, "Mission clock over time", wide=True))
    held = _held(trace)
    known = np.flatnonzero(held)[:: _every(trace)]
    if plan.vehicles >= 4 and len(known):
        figure, axes = _axes((8.0, 2.8))
        distance = distances_of_strands(plan, trace.position[known])
        required = plan.mission.clearance.cable
        title = "Distance of strands that are not neighbours, as flown (sampled)"
        plots.draw_over_time(axes, trace.mission_time[known], distance, required, title)
        found.append(picture(figure, title, wide=True))
    figure, axes = _axes()
    plots.draw_flown_view(axes, plan, trace)
    found.append(picture(figure, "The cable from above as planned, and where it was held"))
    if len(known):
        figure, axes = _axes(projection="3d")
        flown = trace.position[np.flatnonzero(held)[-1]]
        plots.draw_fold(axes, replace(plan.layout, corners=flown))
        axes.set_title("As held at last, distances at crossings in m")
        found.append(picture(figure, "The cable in space as it was held at last"))
    return found


def _held(trace: Trace) -> npt.NDArray[np.bool_]:
    """Return at which instants all vehicles' positions in fold and hold are known."""
    held = np.isin(np.array(trace.phase, dtype=str), ["fold", "hold"])
    return held & np.isfinite(trace.position).all(axis=(1, 2))


def _every(trace: Trace) -> int:
    """Return how many instants make a step of the sampled curves."""
    if len(trace.time) < 2:
        return 1
    step = float(np.median(np.diff(trace.time)))
    return max(1, round(CLEARANCE_STEP / step))


def _axes(
    size: tuple[float, float] = (4.6, 4.2), projection: str | None = None
) -> tuple[Figure, plots.Axes]:
    figure = Figure(figsize=size, layout="constrained")
    FigureCanvasAgg(figure)
    return figure, figure.add_subplot(projection=projection)


def _plan_tables(plan: Plan) -> tuple[Html, ...]:
    layout = plan.layout
    chords = np.linalg.norm(np.diff(layout.corners, axis=0), axis=1)
    segments = [
        (i + 1, *(f"{value:.2f}" for value in values))
        for i, values in enumerate(
            zip(layout.lengths, chords, layout.sags, layout.lanes, strict=True)
        )
    ]
    crossings = [(f"{c.over} over {c.under}", f"{c.distance:.2f}") for c in scene.crossings(layout)]
    phases = [
        (phase.name, f"{phase.start:.1f}", f"{phase.end - phase.start:.1f}", phase.cable)
        for phase in plan.phases
    ]
    gates = [(f"{g.time:.1f}", g.condition, f"{g.timeout:.0f}") for g in plan.gates]
    numbers = frozenset(range(5))
    head = ("segment", "cable, m", "chord, m", "sag, m", "lane, m")
    return (
        section("Segments", table(head, segments, numbers)),
        section("Crossings", table(("segments", "apart, m"), crossings, frozenset({1}))),
        section(
            "Phases", table(("phase", "from, s", "lasts, s", "cable"), phases, frozenset({1, 2}))
        ),
        section(
            "Gates", table(("at, s", "waits until all are", "at most, s"), gates, frozenset({0, 2}))
        ),
        section("What the planner says", *(tag("p", note) for note in plan.notes)),
        section(
            "Mission",
            tag("pre", plan.mission.model_dump_json(by_alias=True, exclude_none=True, indent=1)),
        ),
    )


def _flight_figures(plan: Plan, outcome: Mapping[str, Any]) -> list[tuple[str, object]]:
    lateness = outcome["lateness"]
    worst = _worst_in_fold(outcome)
    chord = outcome["largest_chord"]
    return [
        ("vehicles", plan.vehicles),
        ("of flight", seconds(outcome["duration"])),
        ("largest tracking error in the fold", metres(worst)),
        ("chord of the tautest segment", "–" if chord is None else f"{chord:.1%}"),
        ("setpoints sent", outcome["setpoints"]),
        ("ms late (median, 99 %)", _lateness(lateness)),
        ("packets lost", sum(outcome["lost"].values())),
    ]


def _lateness(lateness: Sequence[float] | None) -> str:
    return "–" if not lateness else f"{lateness[0] * 1e3:.1f}, {lateness[1] * 1e3:.1f}"


def _flown(outcome: Mapping[str, Any]) -> Html:
    """The smallest distances that were flown; nothing where the fold was not."""
    rows = []
    if all(both["flown"] is None for both in outcome["clearance"].values()):
        return Html("")
    for name, both in outcome["clearance"].items():
        was, certified = both["flown"], both["certified"]
        if certified["distance"] is None:
            continue  # there are no two things of this kind
        rows.append(
            (
                CLEARANCES[name],
                "unknown" if was is None else kept(was["distance"], certified["required"]),
                metres(certified["distance"]),
                metres(certified["required"]),
                "" if was is None else seconds(was["time"]),
                "" if was is None else " and ".join(was["between"]),
            )
        )
    head = ("", "flown", "certified", "required", "at mission time", "between")
    return table(head, rows, frozenset({1, 2, 3, 4}))


def _tracking(errors: Sequence[Mapping[str, Any]], plan: Plan) -> Html:
    ball = plan.mission.vehicles.tracking
    rows = [
        (
            error["phase"],
            f"{error['rms']:.3f}",
            f"{error['p999']:.3f}",
            tag(
                "span",
                f"{error['max']:.3f}",
                kind="bad" if error["phase"] == "fold" and error["max"] > ball > 0 else "",
            ),
        )
        for error in errors
        if error["vehicle"] == 0 and error["phase"]
    ]
    head = ("phase, all vehicles", "RMS, m", "99.9 %, m", "largest, m")
    return table(head, rows, frozenset({1, 2, 3}))


def _events(events: Iterable[Event]) -> Html:
    told = merged(event for event in events if event.kind not in ROUTINE)
    rows = [
        (clock(event.time), tag("span", sentence(event, others), kind=LEVELS[level(event)]))
        for event, others in told
    ]
    return table(("time", "event"), rows, frozenset({0}))
