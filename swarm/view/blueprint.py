"""Rerun blueprints: the layout of views for a flight, for a plan, and for their comparison."""

import numpy as np
import numpy.typing as npt
import rerun.blueprint as rrb

from swarm.planning import Plan
from swarm.reports import scene

Floats = npt.NDArray[np.float64]

FIELD_TRAIL = 8.0
"""Seconds of trail behind each vehicle in a view of the whole flown area."""

KNOT_TRAIL = 1.5
"""Seconds of trail in a view of the knot: the direction of motion; longer ones hide the strands."""

FIELD_OF_VIEW = np.radians(55.0)
"""Vertical field of view of Rerun's camera by default."""

ASPECT = 1.5
"""Width over height of the narrowest view of a knot, that of the comparison on a 16:9 screen."""

FILLED = 0.88
"""Share of a view's height or width that the knot takes; the rest is for the labels."""

BACKGROUND = (22, 26, 34)
UNLABELLED = "- /plan/crossings/labels"
FLOWN_ONLY = ("- /plan/team/**", "- /plan/path", UNLABELLED)


def flight_blueprint(plan: Plan, *, live: bool) -> rrb.Blueprint:
    """Return the blueprint of a flight; with ``live`` it follows the newest moment."""
    return _blueprint(
        rrb.Horizontal(
            rrb.Vertical(
                _knot("Knot", "time", plan, "- /plan/team/**", UNLABELLED),
                _scene("Field", "time", _field_eye(plan), *FLOWN_ONLY),
                rrb.Horizontal(_states(), _log(), column_shares=[1, 1]),
                row_shares=[6, 2.4, 3],
            ),
            rrb.Vertical(
                _curves("error", "Tracking error (m)"),
                rrb.Tabs(
                    _curves("margin", "Margin above the required (m)", legend=True),
                    _curves("swing", "Estimated swing of the cable (m)"),
                ),
                _curves("rate", "Mission clock rate", (-1.1, 1.1)),
                rrb.Tabs(
                    _curves("battery", "Battery (%)", (0.0, 100.0)),
                    _curves("link", "Link age (s)"),
                    _curves("round_trip", "Round trip (ms)"),
                    _curves("loss", "Packets lost (%)", (0.0, 100.0)),
                ),
                row_shares=[3, 2, 1, 1],
            ),
            column_shares=[5, 2],
        ),
        "time",
        play_state="following" if live else "playing",
    )


def plan_blueprint(plan: Plan) -> rrb.Blueprint:
    """Return the blueprint of a plan over mission time."""
    return _blueprint(
        rrb.Horizontal(
            rrb.Vertical(
                _knot("Knot", "mission_time", plan),
                _scene("Field", "mission_time", _field_eye(plan), UNLABELLED),
                row_shares=[6, 2.4],
            ),
            rrb.Vertical(
                _curves("plan/clearance", "Sampled distance of strands (m)"),
                _curves("plan/speed", "Speed (m/s)"),
                _curves("plan/tautness", "Chord over length of the segments"),
                rrb.StateTimelineView(origin="plan/phase", name="Phase"),
                row_shares=[2, 2, 2, 1],
            ),
            column_shares=[5, 2],
        ),
        "mission_time",
    )


def comparison_blueprint(plan: Plan) -> rrb.Blueprint:
    """Return the blueprint with planned and flown motion side by side on the mission clock."""
    return _blueprint(
        rrb.Vertical(
            rrb.Horizontal(
                _knot("Planned", "mission_time", plan, "- /flight/**", UNLABELLED),
                _knot("Flown", "mission_time", plan, *FLOWN_ONLY),
            ),
            rrb.Horizontal(
                _scene("Planned and flown", "mission_time", _field_eye(plan, near=0.4), UNLABELLED),
                _curves("error", "Tracking error (m)"),
                rrb.Tabs(
                    _curves("distance", "Sampled distance of strands (m)"),
                    _curves("swing", "Largest swing of the cable (m)"),
                ),
                column_shares=[3, 2, 2],
            ),
            row_shares=[3, 2],
        ),
        "mission_time",
    )


def _blueprint(
    views: rrb.Horizontal | rrb.Vertical, timeline: str, play_state: str = "playing"
) -> rrb.Blueprint:
    return rrb.Blueprint(
        views,
        rrb.TimePanel(timeline=timeline, state="collapsed", play_state=play_state),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        auto_layout=False,
        auto_views=False,
    )


def _knot(name: str, timeline: str, plan: Plan, *excluded: str) -> rrb.Spatial3DView:
    """Return a view of the knot, without the planned paths, which would hide it."""
    hidden = {"- /plan/path", *excluded}
    return _scene(name, timeline, _knot_eye(plan), *sorted(hidden), trail_seconds=KNOT_TRAIL)


def _scene(
    name: str,
    timeline: str,
    eye: rrb.EyeControls3D,
    *excluded: str,
    trail_seconds: float = FIELD_TRAIL,
) -> rrb.Spatial3DView:
    trail = rrb.VisibleTimeRanges(
        timeline=timeline,
        start=rrb.TimeRangeBoundary.cursor_relative(seconds=-trail_seconds),
        end=rrb.TimeRangeBoundary.cursor_relative(),
    )
    return rrb.Spatial3DView(
        origin="/",
        contents=["+ /**", "- /plots/**", "- /states/**", "- /plan/phase", "- /log", *excluded],
        name=name,
        line_grid=rrb.LineGrid3D(visible=True, spacing=1.0, color=(255, 255, 255, 14)),
        background=rrb.Background(color=BACKGROUND),
        eye_controls=eye,
        overrides={"flight/trails": trail, "plan/team/trails": trail},
    )


def _states() -> rrb.Tabs:
    return rrb.Tabs(
        rrb.StateTimelineView(
            origin="states",
            contents=["+ /states/gate", "+ /states/phase", "+ /states/vehicles/**"],
            name="Phase and vehicles",
        ),
        rrb.StateTimelineView(origin="states/windows", name="Windows"),
        rrb.StateTimelineView(origin="states/modes", name="Modes"),
    )


def _log() -> rrb.TextLogView:
    # The text begins with the time, for which the viewer's own column is too narrow.
    hidden = rrb.encodings.TimelineColumn("time", visible=False)
    columns = rrb.TextLogColumns(timeline_columns=[hidden], text_log_columns=["LogLevel", "Body"])
    return rrb.TextLogView(origin="log", name="Log", columns=columns)


def _curves(
    origin: str, name: str, limits: tuple[float, float] | None = None, *, legend: bool = False
) -> rrb.TimeSeriesView:
    return rrb.TimeSeriesView(
        origin=f"plots/{origin}",
        name=name,
        axis_y=rrb.ScalarAxis(range=limits, zoom_lock=False) if limits else None,
        plot_legend=rrb.PlotLegend("LeftTop", visible=legend),
    )


def _knot_eye(plan: Plan) -> rrb.EyeControls3D:
    """Return a view from above, from the south-west, that the folded knot fills."""
    layout, vehicles = plan.layout, plan.mission.vehicles
    strands = scene.strands(layout.corners, layout.lengths, scene.POINTS_PER_SEGMENT)
    above = layout.corners + np.array([0.0, 0.0, vehicles.grip_offset + vehicles.radius])
    points = np.concatenate([strands.reshape(-1, 3), above])
    towards = np.array([-0.6, -1.0, 0.75])
    target = (points.min(axis=0) + points.max(axis=0)) / 2
    return _eye(target, towards, _framing_distance(points - target, towards))


def _framing_distance(points: Floats, towards: Floats) -> float:
    """Return the least distance of a camera from which points (k, 3) around its target are seen."""
    back = towards / np.linalg.norm(towards)
    right = np.cross([0.0, 0.0, 1.0], back)
    right /= np.linalg.norm(right)
    half_height = FILLED * np.tan(FIELD_OF_VIEW / 2)
    beside = np.abs(points @ right) / (ASPECT * half_height)
    over = np.abs(points @ np.cross(back, right)) / half_height
    return float((np.maximum(beside, over) + points @ back).max())


def _field_eye(plan: Plan, near: float = 0.2) -> rrb.EyeControls3D:
    """Return a view of the whole flown area, across its longer side."""
    flown = plan.motion.at(plan.motion.times)[0].reshape(-1, 3)
    low, high = flown.min(axis=0), flown.max(axis=0)
    east, north, _ = high - low
    across = np.array([0.0, -1.0, 0.4]) if east >= north else np.array([1.0, 0.0, 0.4])
    return _eye((low + high) / 2, across, near * max(east, north) + 4.0)


def _eye(target: Floats, towards: Floats, distance: float) -> rrb.EyeControls3D:
    return rrb.EyeControls3D(
        position=target + towards / np.linalg.norm(towards) * distance,
        look_target=target,
        eye_up=(0.0, 0.0, 1.0),
    )
