"""The lay-out sheet: what to cut, mark and lay out on the ground before a flight; to be printed."""

from collections.abc import Sequence
from html import escape

import numpy as np
import numpy.typing as npt

from swarm.flight.parameters import demands_of_plan, rules
from swarm.mavlink.frames import Projection
from swarm.mission.fleet import Fleet
from swarm.planning import Plan
from swarm.reports.page import Html, key_figures, page, section, table, tag

Floats = npt.NDArray[np.float64]

END_PIECE = 0.2
"""Metres of cable beyond the first and the last grip, for knots and hands."""
_WIDTH, _MARGIN = 900.0, 60.0


def layout_sheet(plan: Plan, fleet: Fleet | None = None, systems: Sequence[int] = ()) -> str:
    """Return the sheet as a page: cable, grip marks, pads, lay line, vehicle labels, parameters.

    ``systems`` are the system ids in order along the cable as found by a check; without them the
    fleet's pads say who stands where, and without a fleet the place is left to be written in.
    """
    grips, pads = grip_places(plan), plan.motion.at(0.0)[0]
    marks = grip_marks(plan)
    who = _labels(plan, fleet, systems)
    first, last = grips[0], grips[-1]
    bearing = np.degrees(np.arctan2(last[0] - first[0], last[1] - first[1])) % 360.0
    mission = plan.mission
    return page(
        f"Lay-out sheet: {mission.name}",
        tag("h1", f"{mission.name}: lay-out sheet"),
        tag("p", "Metres; x east, y north of the mission's origin. Vehicles are numbered in order "
            "along the cable.", kind="dim"),
        key_figures(
            [
                ("cut the cable to", f"{marks[-1] + END_PIECE:.2f} m"),
                ("of which at each end free", f"{END_PIECE:.2f} m"),
                ("grip marks", str(len(marks))),
                ("mass of the cable", f"{1000 * mission.cable.mass_per_length * marks[-1]:.0f} g"),
                ("vehicles", str(plan.vehicles)),
            ]
        ),
        section(
            "Vehicles, grip marks and pads",
            table(
                ("vehicle", "label", "grip mark from the cable's end", "pad x", "pad y",
                 "grip x", "grip y", "next segment"),
                [
                    (
                        k + 1,
                        who[k],
                        f"{marks[k]:.2f} m",
                        f"{pads[k, 0]:.2f}",
                        f"{pads[k, 1]:.2f}",
                        f"{grips[k, 0]:.2f}",
                        f"{grips[k, 1]:.2f}",
                        f"{plan.layout.lengths[k]:.2f} m" if k + 1 < plan.vehicles else "",
                    )
                    for k in range(plan.vehicles)
                ],
                frozenset({0, 2, 3, 4, 5, 6, 7}),
            ),
            tag("p", f"Each segment may be off by {mission.cable.length_tolerance:g} m. Pads: "
                "the vehicle's axis over the point. Where a fleet has a spare, it takes the label "
                "and the pad of the vehicle that it replaces.", kind="dim"),
        ),
        section(
            "Lay line",
            tag("p", f"Stretch a line from ({first[0]:.2f}, {first[1]:.2f}) to "
                f"({last[0]:.2f}, {last[1]:.2f}), {np.linalg.norm(last - first):.2f} m, compass "
                f"bearing {bearing:.0f}° from grip 1 to grip {plan.vehicles} (of the mission's y "
                "axis). Lay each grip mark on its point; slack lies in a bow to the left, seen "
                "from grip 1."),
            _map(pads, grips),
        ),
        section("Parameters", *_parameters(plan, fleet)),
        section(
            "By hand",
            table(
                ("look", "done"),
                [
                    (words, "☐")
                    for words in (
                        "cable cut, marked, free of twists and snags, marks on their points",
                        "every vehicle on its pad, label and pad agree, grippers open",
                        "batteries full, propellers on and tight, nothing loose",
                        "nobody inside the fence, one person at the kill switch",
                        "swarm check says GO",
                    )
                ],
            ),
        ),
    )  # fmt: skip


def grip_marks(plan: Plan) -> Floats:
    """Return the arc lengths (n,) of the grip marks from the end of the cut cable, metres."""
    marks: Floats = END_PIECE + np.concatenate([[0.0], np.cumsum(plan.layout.lengths)])
    return marks


def grip_places(plan: Plan) -> Floats:
    """Return where the grips are taken, (n, 3) mission ENU metres."""
    gripped = next((gate.time for gate in plan.gates if gate.condition == "gripped"), 0.0)
    return plan.motion.at(gripped)[0]


def _labels(plan: Plan, fleet: Fleet | None, systems: Sequence[int]) -> list[str]:
    if systems:
        return [f"system {system}" for system in systems]
    on_pad = {listed.pad: listed.sysid for listed in fleet.vehicles} if fleet else {}
    return [
        f"system {on_pad[k]}" if k in on_pad else "________" for k in range(1, plan.vehicles + 1)
    ]


def _parameters(plan: Plan, fleet: Fleet | None) -> list[Html]:
    if fleet is None:
        return [tag("p", "Depend on the fleet: swarm check MISSION --fleet FILE --sheet FILE.")]
    demands = demands_of_plan(plan, fleet)
    listed = {vehicle.autopilot for vehicle in fleet.vehicles}
    kinds: list[Projection] = ["px4", "ardupilot"]
    names = {"px4": "PX4", "ardupilot": "ArduPilot"}
    return [
        Html(
            tag("h3", names[kind])
            + table(
                ("parameter", "should be", "why"),
                [(rule.name, rule.words, rule.why) for rule in rules(kind, demands)],
            )
        )
        for kind in kinds
        if kind in listed or "detect" in listed
    ]


def _map(pads: Floats, grips: Floats) -> Html:
    """Return a drawing of pads and lay line, true to scale, north up."""
    points = np.concatenate([pads, grips])[:, :2]
    low, high = points.min(axis=0), points.max(axis=0)
    extent = np.maximum(high - low, 1.0)
    scale = (_WIDTH - 2.0 * _MARGIN) / float(extent.max())
    height = extent[1] * scale + 2.0 * _MARGIN
    width = extent[0] * scale + 2.0 * _MARGIN

    def at(point: Floats) -> tuple[float, float]:
        x, y = (point[:2] - low) * scale
        return _MARGIN + x, height - _MARGIN - y

    parts = []
    line = " ".join(f"{x:.1f},{y:.1f}" for x, y in map(at, grips))
    parts.append(f'<polyline points="{line}" fill="none" stroke="#b54708" stroke-width="2"/>')
    for k, (pad, grip) in enumerate(zip(pads, grips, strict=True), 1):
        (px, py), (gx, gy) = at(pad), at(grip)
        parts.append(
            f'<line x1="{px:.1f}" y1="{py:.1f}" x2="{gx:.1f}" y2="{gy:.1f}" stroke="#98a2b3" '
            'stroke-dasharray="4 4"/>'
            f'<circle cx="{gx:.1f}" cy="{gy:.1f}" r="4" fill="#b54708"/>'
            f'<circle cx="{px:.1f}" cy="{py:.1f}" r="13" fill="#fff" stroke="#1d2430"/>'
            f'<text x="{px:.1f}" y="{py + 5:.1f}" text-anchor="middle" font-size="14">{k}</text>'
        )
    bar = 10.0 ** np.floor(np.log10(float(extent.max()) / 3.0))
    parts.append(
        f'<line x1="20" y1="{height - 15:.1f}" x2="{20 + bar * scale:.1f}" y2="{height - 15:.1f}" '
        'stroke="#1d2430" stroke-width="2"/>'
        f'<text x="{28 + bar * scale:.1f}" y="{height - 10:.1f}" font-size="13">{bar:g} m, '
        f"{escape('north up')}</text>"
    )
    words = "pads (numbered circles) and the lay line with its grip marks, true to scale"
    return Html(
        f'<figure><svg viewBox="0 0 {width:.0f} {height:.0f}" role="img" aria-label="{words}" '
        f'style="width:100%;max-height:28rem">{"".join(parts)}</svg></figure>'
    )
