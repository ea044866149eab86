"""The motion of a plan or a flight as the data of the page's view in space.

The view (``static/motion_view.js``) draws frames of vehicles and strands, evenly spaced in time,
and interpolates between them. Coordinates are 16-bit numbers from the centre of all frames.
"""

import base64
import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import groupby
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from swarm.certification.assessment import Assessment
from swarm.certification.clearances import Moment
from swarm.certification.distances import Tightest
from swarm.flight.trace import Trace
from swarm.planning import Plan
from swarm.planning.cable_shape import cable_shape, grip_interval, laid_grip_points
from swarm.reports import scene
from swarm.reports.formatting import certified, metres, seconds, together
from swarm.reports.plots import along_colours

Floats = npt.NDArray[np.float64]

STEP: Final = 0.2
"""Least seconds between two frames: at 1 m/s² a straight line between them errs by 5 mm."""

MAX_BYTES: Final = 1_600_000
"""Size of all frames, beyond which they are farther apart: 2.1 MB of a page of 3 MB."""

_POINTS: Final = 11
"""Points of a strand; the view draws a smooth curve through them."""

_UNKNOWN: Final = -32768
_LARGEST: Final = 32767


@dataclass(frozen=True)
class Span:
    """A phase on the view's time axis, seconds; ``name`` is empty outside the plan."""

    name: str
    start: float
    end: float


@dataclass(frozen=True)
class MarkedMoment:
    """A tight moment on the view's time axis, in words, with the names of its two objects."""

    time: float
    words: str
    between: tuple[str, str]


@dataclass(frozen=True)
class MotionView:
    """What the view shows: its time axis, the tight moments, and the frames as JSON.

    ``start`` and ``end`` are the first and last second of the axis. ``note`` is a sentence on what
    is drawn.
    """

    start: float
    end: float
    spans: tuple[Span, ...]
    moments: tuple[MarkedMoment, ...]
    note: str
    data: str


def planned_motion(plan: Plan, assessment: Assessment) -> MotionView:
    """Return the view of a plan over mission time."""
    begins, ends = float(plan.motion.times[0]), plan.duration
    times = _frame_times(plan, begins, ends)
    spans = tuple(Span(phase.name, phase.start, phase.end) for phase in plan.phases)
    cable = cable_shape(plan, times, _POINTS)
    return MotionView(
        start=begins,
        end=ends,
        spans=spans,
        moments=_planned_moments(assessment),
        note="Planned grip points, without tracking errors. The cable hangs in catenaries.",
        data=_data(plan, times, spans, plan.motion.at(times)[0], cable),
    )


def flown_motion(plan: Plan, outcome: Mapping[str, Any], trace: Trace) -> MotionView | None:
    """Return the view of a flight over the ground station's time; None without a reported position.

    ``outcome`` is the JSON object that ``swarm fly --json`` prints.
    """
    if len(trace.time) < 2 or not np.isfinite(trace.position).all(axis=-1).any():
        return None
    times = _frame_times(plan, float(trace.time[0]), float(trace.time[-1]))
    sampled = np.minimum(np.searchsorted(trace.time, times), len(trace.time) - 1)
    places = trace.position[sampled]
    outside = np.array(trace.phase, dtype=str)[sampled] == ""
    cable = _implied_cable(plan, places, trace.mission_time[sampled], outside)
    spans = _flown_spans(trace)
    return MotionView(
        start=float(times[0]),
        end=float(times[-1]),
        spans=spans,
        moments=_flown_moments(outcome, trace),
        note="Reported grip points. The cable is implied: it hangs in catenaries between them. "
        "It is not drawn after its release, nor in a contingency, in which it may be released.",
        data=_data(plan, times, spans, places, cable),
    )


def _frame_times(plan: Plan, start: float, end: float) -> Floats:
    """Return evenly spaced times (k,), so far apart that the frames keep to the size."""
    numbers = 3 * (plan.vehicles + len(plan.layout.lengths) * _POINTS)
    largest = MAX_BYTES // (np.dtype(np.int16).itemsize * numbers)
    return np.linspace(start, end, int(min(largest, np.ceil((end - start) / STEP) + 1)))


def _implied_cable(
    plan: Plan, places: Floats, mission_times: Floats, outside: npt.NDArray[np.bool_]
) -> Floats:
    """Return the cable (k, n − 1, points, 3): laid before the grip, held, unknown afterwards.

    ``outside`` (k,) says when the team does not follow the plan; a cable that was gripped is then
    unknown, too, because it may have been released.
    """
    begins, ends = grip_interval(plan)
    laid = mission_times < begins
    grips = np.where(laid[:, None, None], laid_grip_points(plan), places)
    grips[(mission_times >= ends) | (outside & ~laid)] = np.nan
    if not len(plan.layout.lengths):
        return np.empty((len(places), 0, _POINTS, 3))
    return scene.strands(grips, plan.layout.lengths, _POINTS)


def _planned_moments(assessment: Assessment) -> tuple[MarkedMoment, ...]:
    """Return the tightest moment of each kind of clearance, then the other tightest moments."""
    kinds = assessment.distances.values()
    known = {(gap.between, round(gap.time, 1)) for gap in kinds}
    others = [gap for gap in assessment.tightest if (gap.between, round(gap.time, 1)) not in known]
    moments: list[Tightest | Moment] = [*kinds, *others]
    return tuple(
        MarkedMoment(
            gap.time,
            f"{certified(gap.distance)} certified, {_in_words(gap.between)}, {seconds(gap.time)}",
            gap.between,
        )
        for gap in moments
        if np.isfinite(gap.distance)
    )


def _flown_moments(outcome: Mapping[str, Any], trace: Trace) -> tuple[MarkedMoment, ...]:
    flown = [both["flown"] for both in outcome["clearance"].values() if both["flown"]]
    marked = []
    for gap in flown:
        at = int(np.nanargmin(np.abs(trace.mission_time - gap["time"])))
        words = f"{metres(gap['distance'])} flown, {_in_words(gap['between'])}"
        words += f", mission time {seconds(gap['time'])}"
        marked.append(MarkedMoment(float(trace.time[at]), words, tuple(gap["between"])))
    return tuple(marked)


def _in_words(between: tuple[str, str]) -> str:
    if all(re.fullmatch(r"\w+ \d+", name) for name in between):
        return together(between)
    return " and ".join(between)


def _flown_spans(trace: Trace) -> tuple[Span, ...]:
    spans = []
    for name, instants in groupby(range(len(trace.phase)), key=lambda k: trace.phase[k]):
        first, *others = instants
        following = min(max([first, *others]) + 1, len(trace.time) - 1)
        spans.append(Span(name, float(trace.time[first]), float(trace.time[following])))
    return tuple(spans)


def _data(plan: Plan, times: Floats, spans: tuple[Span, ...], places: Floats, cable: Floats) -> str:
    """Return the frames as JSON for a ``script`` element: vehicles (k, n, 3), strands (k, …, 3).

    The view first shows the end of the fold (``shown``) and plays from the lift (``begin``) on.
    """
    shown = np.concatenate([places.reshape(-1, 3), cable.reshape(-1, 3)])
    shown = shown[np.isfinite(shown).all(axis=-1)]
    low, high = shown.min(axis=0), shown.max(axis=0)
    centre = (0.5 * (low + high)).round(4)
    unit = max(float(np.abs([low - centre, high - centre]).max()), 1.0) / _LARGEST
    document = {
        "vehicles": plan.vehicles,
        "segments": cable.shape[1],
        "points": _POINTS,
        "frames": len(times),
        "start": float(times[0]),
        "end": float(times[-1]),
        "centre": centre.tolist(),
        "unit": unit,
        "unknown": _UNKNOWN,
        "radius": plan.mission.vehicles.radius,
        "grip": plan.mission.vehicles.grip_offset,
        "cable": 0.5 * plan.mission.cable.diameter,
        "lines": [
            strip.round(3).tolist()
            for strips in scene.workspace_lines(plan).values()
            for strip in strips
        ],
        "colours": along_colours(cable.shape[1]).round(3).tolist(),
        "shown": max((span.end for span in spans if span.name == "fold"), default=times[-1]),
        "begin": min(
            (span.start for span in spans if span.name in {"lift", "fold"}), default=times[0]
        ),
        "places": _encoded((places - centre) / unit),
        "strands": _encoded((cable - centre) / unit),
    }
    # "<" would end the element early; JSON allows the escape.
    return json.dumps(document).replace("<", "\\u003c")


def _encoded(values: Floats) -> str:
    """Return numbers as 16-bit little-endian integers in base64."""
    stored = np.where(np.isfinite(values), np.rint(values), _UNKNOWN)
    return base64.b64encode(stored.astype("<i2").tobytes()).decode("ascii")
