"""One page per plan and per flight, to be kept, printed and sent: HTML that needs no network."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any, Final

import matplotlib as mpl
import numpy as np
import numpy.typing as npt
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from swarm import __version__
from swarm.flight.snapshot import Event
from swarm.flight.trace import Trace
from swarm.plans import Plan
from swarm.preflight.findings import Assessment, Tightest
from swarm.view import plots, scene
from swarm.view.distances import CLEARANCE_STEP, distances_of_strands, strand_distances
from swarm.view.page import Html, key_figures, page, picture, pictures, section, table, tag
from swarm.view.words import ROUTINE, clock, level, merged, metres, seconds, sentence

CERTIFIED: Final = "certified in the quasi-static cable model"
SEVERITIES: Final = {"error": "bad", "warning": "warn", "info": "dim"}
CLEARANCES: Final = {
    "cable": "cable to cable",
    "vehicle": "vehicle to vehicle",
    "vehicle_cable": "vehicle to cable",
}
TRIAL_DISTANCES: Final = {**CLEARANCES, "hung": "cable to cable, as the emulator's cable hung"}
LEVELS: Final = {"ERROR": "bad", "WARN": "warn", "INFO": ""}


def plan_report(plan: Plan, assessment: Assessment) -> str:
    """Return the page of a plan: verdict, findings, figures, pictures, tables."""
    verdict = (
        tag("div", f"Cleared: {CERTIFIED}.", kind="verdict good")
        if assessment.cleared
        else tag("div", f"Refused: {_errors(assessment)}.", kind="verdict bad")
    )
    return page(
        f"Plan: {plan.mission.name}",
        tag("h1", f"{plan.mission.name}: plan for {_knot(plan.knot.type, plan.knot.chirality)}"),
        tag("p", f"Gauss code {plan.knot.gauss}", kind="dim"),
        verdict,
        key_figures(_plan_figures(plan, assessment)),
        section("Findings", _findings(assessment)),
        section("Smallest distances", _certified(assessment)),
        section("Pictures", pictures(*_plan_pictures(plan, assessment))),
        *_plan_tables(plan),
        _footer(),
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
    implied = _knot(outcome["knot"]["type"], outcome["knot"]["chirality"])
    as_planned = outcome["knot"]["as_planned"]
    return page(
        f"Flight: {plan.mission.name}",
        tag("h1", f"{plan.mission.name}: flight"),
        tag("p", f"Asked for {_knot(plan.knot.type, plan.knot.chirality)}", kind="dim"),
        tag(
            "div",
            f"{outcome['outcome'].capitalize()}: {outcome['explanation']}. "
            f"The reported positions imply {implied} in the cable model"
            f"{'' if as_planned else ', which is not what was planned'}.",
            kind="verdict good" if done and as_planned else "verdict bad",
        ),
        _left_the_ball(plan, outcome),
        key_figures(_flight_figures(plan, outcome)),
        section("Smallest distances", _flown(outcome)),
        section("Notes", *(tag("p", note) for note in outcome["notes"])),
        section("Pictures", pictures(*_flight_pictures(plan, trace))),
        section("Tracking error", _tracking(outcome["tracking"], plan)),
        section("Events", _events(events)),
        section("The plan", key_figures(_plan_figures(plan, assessment)), _findings(assessment)),
        _footer(),
    )


def trials_report(
    plan: Plan, assessment: Assessment, told: Sequence[Mapping[str, Any]], figure: Figure
) -> str:
    """Return the page of many dry runs: what they say, pictures, worst trials, and the plan.

    ``told`` are the JSON objects that ``swarm dry-run --trials --json`` prints, of this plan first,
    ``figure`` is what is drawn of them.
    """
    first = told[0]
    sound, below = first["no_vehicle_failing"], first["certificate"]["below"]
    good = sound["completed"]["count"] == sound["trials"] and not below
    words = (
        f"{sound['completed']['count']} of {sound['trials']} trials without a failing vehicle "
        f"were completed as planned; {len(below)} of {first['certificate']['compared']} came "
        "closer than was certified for their tracking error."
    )
    return page(
        f"Trials: {plan.mission.name}",
        tag("h1", f"{plan.mission.name}: {first['trials']} dry runs"),
        tag("p", f"Seed {first['seed']}; virtual time, emulated vehicles and cable", kind="dim"),
        tag("div", words, kind="verdict good" if good else "verdict bad"),
        key_figures(_trial_figures(first)),
        section(
            "Pictures", pictures(picture(figure, "Smallest distances of all trials", wide=True))
        ),
        *(section(_whose(one), _distances_table(one), _reasons(one)) for one in told),
        section("Worth a look", _worst_trials(first)),
        section("What was drawn", _drawn(first["spread"])),
        section("The plan", key_figures(_plan_figures(plan, assessment)), _findings(assessment)),
        _footer(),
    )


def rope_report(
    plan: Plan, assessment: Assessment, told: Sequence[Mapping[str, Any]], figure: Figure
) -> str:
    """Return the page of a simulated rope.

    ``told`` are the JSON objects that ``swarm dry-run --rope --json`` prints, this plan's first.
    """
    first = told[0]
    implied = _knot(first["knot"]["type"], first["knot"]["chirality"])
    good = first["knot"]["as_planned"] and not first["void"]
    words = (
        f"This run shows nothing: {'; '.join(first['void'])}."
        if first["void"]
        else f"The rope ends in {implied}{'' if good else ', which is not what was planned'}."
    )
    return page(
        f"Rope: {plan.mission.name}",
        tag("h1", f"{plan.mission.name}: a rope of {first['links']} links"),
        tag("p", f"Asked for {_knot(plan.knot.type, plan.knot.chirality)}", kind="dim"),
        tag("div", words, kind="verdict good" if good else "verdict bad"),
        section("Pictures", pictures(picture(figure, "The rope's motion and end", wide=True))),
        section("Figures", _rope_table(told)),
        section("The plan", key_figures(_plan_figures(plan, assessment)), _findings(assessment)),
        _footer(),
    )


def _rope_table(told: Sequence[Mapping[str, Any]]) -> Html:
    def depth(one: Mapping[str, Any]) -> str:
        return (
            f"{one['penetration']['radii']:.2f} radii (void beyond {one['penetration']['most']:g})"
        )

    rows = [
        ("knot", *(_knot(one["knot"]["type"], one["knot"]["chirality"]) for one in told)),
        ("shows something", *("no" if one["void"] else "yes" for one in told)),
        ("closest strands", *(_or_dash(one["smallest_distance"], "m") for one in told)),
        ("deepest penetration", *map(depth, told)),
        ("largest stretch", *(f"{one['stretch']['share']:.2%}" for one in told)),
        ("top speed", *(f"{one['speed']['metres_per_second']:.1f} m/s" for one in told)),
        (
            "farthest from the quasi-static cable",
            *(metres(one["stray"]["largest"]) for one in told),
        ),
        ("the budget's sway and stop", *(metres(one["stray"]["budget"]) for one in told)),
        ("simulated, took", *(f"{one['simulated']:.0f} s, {one['took']:.0f} s" for one in told)),
    ]
    return table(("", *(one["trajectory"] for one in told)), rows)


def _whose(told: Mapping[str, Any]) -> str:
    return "The paper's trajectory" if told["method"] == "paper" else "This plan"


def _trial_figures(told: Mapping[str, Any]) -> list[tuple[str, object]]:
    sound = told["no_vehicle_failing"]
    low, high = sound["completed"]["interval"] or (0.0, 1.0)
    return [
        ("trials", told["trials"]),
        ("of them with a failing vehicle", told["one_vehicle_failing"]["trials"]),
        (f"completed, {told['confidence']:.0%} interval", f"{low:.1%} to {high:.1%}"),
        ("with a rotor on cable", told["trials_with_strikes"]),
        ("with vehicles touching", told["trials_with_collisions"]),
        ("vehicles lost", told["vehicles_lost"]),
    ]


def _distances_table(told: Mapping[str, Any]) -> Html:
    rows = []
    for kind, values in told["no_vehicle_failing"]["clearance"].items():
        if values["count"]:
            cells = [_kept(values["smallest"], values["required"])]
            for share in ("0.05", "0.5"):
                quantile = values["quantiles"][share]
                low, high = (f"{v:.2f}" if v is not None else "?" for v in quantile["interval"])
                cells.append(Html(f"{metres(quantile['value'])} [{low}, {high}]"))
            rows.append((TRIAL_DISTANCES[kind], *cells, metres(values["required"])))
    head = ("no vehicle failing", "smallest", "5 %", "median", "required")
    return table(head, rows, frozenset({1, 2, 3, 4}))


def _reasons(told: Mapping[str, Any]) -> Html:
    rows = [(reason, count) for reason, count in told["reasons"].items()]
    return table(("not completed, because of", "trials"), rows, frozenset({1}))


def _worst_trials(told: Mapping[str, Any]) -> Html:
    rows = [
        (
            one["trial"],
            "unknown" if one["cable"] is None else metres(one["cable"]),
            one["outcome"],
            one["failing"] or "–",
            one["reason"] or "–",
        )
        for one in told["worst"]
    ]
    head = ("trial", "cable to cable", "outcome", "what was made to fail", "reason")
    return table(head, rows, frozenset({0, 1}))


def _drawn(spread: Mapping[str, Any]) -> Html:
    rows = [
        (name, ", ".join(value) if isinstance(value, list) else f"{value:g}")
        for name, value in spread.items()
    ]
    return table(("key of the scenario's spread", "value"), rows)


def _left_the_ball(plan: Plan, outcome: Mapping[str, Any]) -> Html:
    ball, worst = plan.mission.vehicles.tracking, _worst_in_fold(outcome)
    if not worst > ball:
        return Html("")
    words = (
        f"Tracking errors reached {metres(worst)} in the fold. The plan is certified for "
        f"{metres(ball)}: what it promises did not hold for this flight."
    )
    return tag("div", words, kind="verdict warn")


def _worst_in_fold(outcome: Mapping[str, Any]) -> float:
    return max((e["max"] for e in outcome["tracking"] if e["phase"] == "fold"), default=np.nan)


def _errors(assessment: Assessment) -> str:
    count = sum(finding.severity == "error" for finding in assessment.findings)
    return f"{count} error{'s' if count > 1 else ''}"


def _knot(name: str, chirality: str) -> str:
    return name if chirality == "none" else f"{name}, {chirality}-handed"


def _plan_figures(plan: Plan, assessment: Assessment) -> list[tuple[str, object]]:
    fold = plan.phase("fold")
    robustness = assessment.robustness
    return [
        ("vehicles", plan.vehicles),
        ("cable", metres(float(plan.layout.lengths.sum()))),
        ("fold", seconds(fold.end - fold.start)),
        ("from take-off to the ground", seconds(plan.duration)),
        ("tracking error certified for", metres(plan.mission.vehicles.tracking)),
        ("largest tracking error e*", _or_dash(robustness.tracking, "m")),
        ("largest steady wind w*", _or_dash(robustness.wind, "m/s")),
    ]


def _or_dash(value: float | None, unit: str) -> str:
    return "–" if value is None else f"{value:.2f} {unit}"


def _findings(assessment: Assessment) -> Html:
    order = list(SEVERITIES)
    rows = [
        (
            tag("span", finding.severity, kind=SEVERITIES[finding.severity]),
            finding.check,
            finding.message,
            "" if finding.at_time is None else seconds(finding.at_time),
        )
        for finding in sorted(assessment.findings, key=lambda found: order.index(found.severity))
    ]
    return table(("severity", "check", "says", "at"), rows, frozenset({3}))


def _certified(assessment: Assessment) -> Html:
    rows = [
        (name, _kept(kept.distance, kept.required), metres(kept.required), *_where(kept))
        for name, kept in zip(
            CLEARANCES.values(),
            (assessment.cable, assessment.vehicle, assessment.vehicle_cable),
            strict=True,
        )
    ]
    head = ("", "certified", "required", "at", "between")
    return table(head, rows, frozenset({1, 2, 3}))


def _where(kept: Tightest) -> tuple[str, str]:
    if not np.isfinite(kept.distance):
        return "–", "–"
    return seconds(kept.time), " and ".join(kept.between)


def _kept(distance: float, required: float) -> Html:
    return tag("span", metres(distance), kind="good" if distance >= required else "bad")


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
    rows = []
    for name, both in outcome["clearance"].items():
        was, certified = both["flown"], both["certified"]
        if certified["distance"] is None:
            continue  # there are no two things of this kind
        rows.append(
            (
                CLEARANCES[name],
                "unknown" if was is None else _kept(was["distance"], certified["required"]),
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


def _footer() -> Html:
    return tag(
        "footer",
        f"swarm {__version__}. {CERTIFIED.capitalize()} means: for every displacement of every "
        "grip point within the tracking ball, as long as the cable hangs as catenaries do. It is "
        "not a proof about the real cable, and no eye has seen the knot.",
    )
