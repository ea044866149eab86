"""The printed lay-out sheet: cable to cut, marks and pads to measure before a flight."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from swarm.certification.assessment import Assessment
from swarm.flight.parameters import plan_requirements, rules
from swarm.mavlink.frames import AutopilotName
from swarm.mission.fleet import Fleet
from swarm.planning import Plan, digest
from swarm.planning.cable_shape import folded_back
from swarm.reports import scene
from swarm.reports.formatting import certified, certified_wind
from swarm.reports.pages import render
from swarm.reports.result import Table

Floats = npt.NDArray[np.float64]
Point = tuple[float, float]

END_PIECE: Final = 0.2
"""Metres of cable beyond the first and the last grip, for handling."""

_MAP_WIDTH: Final = 900.0
_MAP_MARGIN: Final = 60.0
_AUTOPILOTS: Final[dict[AutopilotName, str]] = {"px4": "PX4", "ardupilot": "ArduPilot"}
_CHECKLIST: Final = (
    "cable cut, marked, free of twists and snags, marks on their points",
    "every vehicle on its pad, label and pad agree, grippers open",
    "batteries full, propellers on and tight, no loose parts",
    "no person inside the fence, one person at the kill switch",
    "swarm check reports GO",
)


@dataclass(frozen=True)
class LayLine:
    """The line on the ground along which the cable is laid, from the first grip to the last.

    ``start`` and ``end`` (2,) and ``length`` in metres, ``bearing`` in degrees clockwise from the
    mission's y axis.
    """

    start: Floats
    end: Floats
    length: float
    bearing: float


@dataclass(frozen=True)
class LayoutMap:
    """A drawing of pads and grips, true to scale and north up, in pixels from the top left.

    ``pairs`` has the pad and the grip of every vehicle, ``bounds`` the lines of the fence and of
    each obstacle by name; the scale bar is ``bar_width`` pixels for ``bar_length`` metres.
    """

    width: float
    height: float
    pairs: tuple[tuple[Point, Point], ...]
    bounds: Mapping[str, Sequence[Sequence[Point]]]
    bar_width: float
    bar_length: float


def layout_sheet(
    plan: Plan,
    fleet: Fleet | None = None,
    systems: Sequence[int] = (),
    assessment: Assessment | None = None,
) -> str:
    """Return the sheet as a page: cable, grip marks, pads, lay line, vehicle labels, parameters.

    ``systems`` are the system ids in order along the cable as found by a check. Without them the
    labels are those of the fleet's pads; without a fleet they are left blank. With an
    ``assessment`` the sheet states e* and w*.
    """
    grips, pads = grip_places(plan), plan.motion.at(0.0)[0]
    marks = grip_marks(plan)
    cable = len(marks) > 0
    figures: list[tuple[str, object]] = []
    if cable:
        cable_mass = plan.mission.cable.mass_per_length * marks[-1]
        figures = [
            ("cut the cable to", f"{marks[-1] + END_PIECE:.2f} m"),
            ("of this free at each end", f"{END_PIECE:.2f} m"),
            ("grip marks", len(marks)),
            ("mass of the cable", f"{1000 * cable_mass:.0f} g"),
        ]
    return render(
        "layout_sheet.html.j2",
        mission=plan.mission,
        figures=[*figures, ("vehicles", plan.vehicles), *_certified(assessment)],
        digest=digest(plan),
        vehicles=_vehicles_table(plan, _labels(plan, fleet, systems), pads, grips),
        line=_lay_line(grips) if cable else None,
        map=_map(pads, grips, scene.workspace_lines(plan)),
        parameters=None if fleet is None else _parameters(plan, fleet),
        checklist=Table(("check", "done"), [(item, "☐") for item in _CHECKLIST]),
    )


def _certified(assessment: Assessment | None) -> list[tuple[str, object]]:
    """Return the largest tracking error and steady wind that are certified, where known."""
    if assessment is None:
        return []
    known = assessment.robustness
    rows = [
        ("largest tracking error e*", known.tracking, certified),
        ("largest steady wind w*", known.wind, certified_wind),
    ]
    return [(name, words(value)) for name, value, words in rows if value is not None]


def grip_marks(plan: Plan) -> Floats:
    """Return the arc lengths (n,) of the grip marks from the end of the cut cable, metres.

    Without cable there are none, (0,).
    """
    lengths = plan.layout.lengths
    marks: Floats = END_PIECE + np.concatenate([[0.0], np.cumsum(lengths)])
    return marks if len(lengths) else marks[:0]


def grip_places(plan: Plan) -> Floats:
    """Return the positions (n, 3) at which the vehicles grip the cable, mission ENU, metres."""
    gripped = next((gate.time for gate in plan.gates if gate.condition == "gripped"), 0.0)
    return plan.motion.at(gripped)[0]


def _labels(plan: Plan, fleet: Fleet | None, systems: Sequence[int]) -> list[str]:
    if systems:
        return [f"system {system}" for system in systems]
    on_pad = {listed.pad: listed.sysid for listed in fleet.vehicles} if fleet else {}
    return [
        f"system {on_pad[k]}" if k in on_pad else "________" for k in range(1, plan.vehicles + 1)
    ]


def _vehicles_table(plan: Plan, labels: Sequence[str], pads: Floats, grips: Floats) -> Table:
    """Return a row per vehicle: number, label, grip mark, pad, grip and next segment, metres."""
    none = ["–"] * plan.vehicles
    marks = [f"{mark:.2f} m" for mark in grip_marks(plan)] or none
    segments = [f"{length:.2f} m" for length in plan.layout.lengths]
    segments = [*segments, ""] if segments else none
    columns: tuple[str, ...] = (
        "vehicle", "label", "grip mark from the cable's end", "pad x, y", "grip x, y",
        "next segment",
    )  # fmt: skip
    folds: list[tuple[str, ...]] = [()] * plan.vehicles
    if plan.mission.lay == "slack" and len(plan.layout.lengths):
        columns = (*columns, "folded back by")
        each = zip(*folded_back(plan), strict=True)
        folds = [
            (f"{times} × {back:.2f} m" if times > 1 else f"{back:.2f} m",) for back, times in each
        ]
        folds.append(("",))
    rows = [
        (
            str(k + 1),
            labels[k],
            marks[k],
            f"{pads[k, 0]:.2f}, {pads[k, 1]:.2f}",
            f"{grips[k, 0]:.2f}, {grips[k, 1]:.2f}",
            segments[k],
            *folds[k],
        )
        for k in range(plan.vehicles)
    ]
    return Table(columns, rows, numbers=(0, *range(2, len(columns))))


def _lay_line(grips: Floats) -> LayLine:
    start, end = grips[0], grips[-1]
    bearing = np.degrees(np.arctan2(end[0] - start[0], end[1] - start[1])) % 360.0
    return LayLine(start[:2], end[:2], float(np.linalg.norm(end - start)), float(bearing))


def _parameters(plan: Plan, fleet: Fleet) -> list[tuple[str, Table]]:
    """Return each autopilot's name with the parameters that it needs."""
    columns = ("parameter", "required", "reason")
    demands = plan_requirements(plan, fleet)
    listed = {vehicle.autopilot for vehicle in fleet.vehicles}
    return [
        (
            name,
            Table(
                columns, [(rule.name, rule.words, rule.why) for rule in rules(autopilot, demands)]
            ),
        )
        for autopilot, name in _AUTOPILOTS.items()
        if autopilot in listed or "detect" in listed
    ]


def _map(pads: Floats, grips: Floats, lines: Mapping[str, list[Floats]]) -> LayoutMap:
    """Return the drawing; it is widened for what bounds the workspace within its own width."""
    points = np.concatenate([pads, grips])[:, :2]
    low, high = points.min(axis=0), points.max(axis=0)
    span = max(float((high - low).max()), 1.0)
    for strips in lines.values():
        corners = np.vstack(strips)[:, :2]
        if np.all(corners >= low - span) and np.all(corners <= high + span):
            points = np.concatenate([points, corners])
    low, high = points.min(axis=0), points.max(axis=0)
    extent = np.maximum(high - low, 1.0)
    scale = (_MAP_WIDTH - 2.0 * _MAP_MARGIN) / float(extent.max())
    width, height = (float(side) for side in extent * scale + 2.0 * _MAP_MARGIN)

    def pixel(point: Floats) -> Point:
        x, y = (point[:2] - low) * scale
        return _MAP_MARGIN + float(x), height - _MAP_MARGIN - float(y)

    bar_length = float(10.0 ** np.floor(np.log10(float(extent.max()) / 3.0)))
    pairs = tuple((pixel(pad), pixel(grip)) for pad, grip in zip(pads, grips, strict=True))
    bounds = {name: [[pixel(p) for p in strip] for strip in lines[name]] for name in lines}
    return LayoutMap(width, height, pairs, bounds, bar_length * scale, bar_length)
