"""Rerun blueprints: the layout of views for a flight, for a plan, and for their comparison."""

import numpy as np
import numpy.typing as npt
import rerun.blueprint as rrb

from swarm.planning import Plan

Floats = npt.NDArray[np.float64]

TRAIL = 8.0
"""Seconds of trail behind each vehicle."""

BACKGROUND = (22, 26, 34)
UNLABELLED = "- /plan/crossings/labels"
FLOWN_ONLY = ("- /plan/team/**", "- /plan/path", UNLABELLED)


def flight_blueprint(plan: Plan, *, live: bool) -> rrb.Blueprint:
    """Return the blueprint of a flight; with ``live`` it follows the newest moment."""
    return _blueprint(
        rrb.Horizontal(
            rrb.Vertical(
                _scene("Knot", "time", _knot_eye(plan), "- /plan/team/**", UNLABELLED),
                _scene("Field", "time", _field_eye(plan), *FLOWN_ONLY),
                rrb.Horizontal(_states(), _log(), column_shares=[1, 1]),
                row_shares=[6, 2.4, 3],
            ),
            rrb.Vertical(
                _curves("error", "Tracking error (m)"),
                _curves("margin", "Margin: clearance above the required one (m)"),
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
                _scene("Knot", "mission_time", _knot_eye(plan)),
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
                _scene("Planned", "mission_time", _knot_eye(plan), "- /flight/**", UNLABELLED),
                _scene("Flown", "mission_time", _knot_eye(plan), *FLOWN_ONLY),
            ),
            rrb.Horizontal(
                _scene("Planned and flown", "mission_time", _field_eye(plan, near=0.4), UNLABELLED),
                _curves("error", "Tracking error (m)"),
                _curves("distance", "Sampled distance of strands (m)"),
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


def _scene(name: str, timeline: str, eye: rrb.EyeControls3D, *excluded: str) -> rrb.Spatial3DView:
    trail = rrb.VisibleTimeRanges(
        timeline=timeline,
        start=rrb.TimeRangeBoundary.cursor_relative(seconds=-TRAIL),
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
    origin: str, name: str, limits: tuple[float, float] | None = None
) -> rrb.TimeSeriesView:
    return rrb.TimeSeriesView(
        origin=f"plots/{origin}",
        name=name,
        axis_y=rrb.ScalarAxis(range=limits, zoom_lock=False) if limits else None,
        plot_legend=rrb.PlotLegend(visible=False),
    )


def _knot_eye(plan: Plan) -> rrb.EyeControls3D:
    """Return a view of the knot from above, from the south-west."""
    low, high = plan.layout.corners.min(axis=0), plan.layout.corners.max(axis=0)
    low[2] = high[2] - float(plan.layout.sags.max(initial=0.0))
    extent = float(np.linalg.norm((high - low)[:2]))
    return _eye((low + high) / 2, np.array([-0.6, -1.0, 0.75]), 0.55 * extent + 2.5)


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
