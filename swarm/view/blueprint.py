"""How a recording opens: one arrangement for flying, one for studying a plan."""

import numpy as np
import numpy.typing as npt
import rerun.blueprint as rrb

from swarm.plans import Plan

TRAIL = 8.0
"""Seconds of trail behind each vehicle."""

WINDOW = 30.0
"""Seconds of curves shown while flying."""


def flight_blueprint(plan: Plan, *, live: bool) -> rrb.Blueprint:
    """Return the arrangement for a flight; ``live`` follows the newest moment."""
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(
                _scene(plan, "Scene", "time", "- /plan/team/**"),
                rrb.Horizontal(
                    _states(),
                    rrb.TextLogView(origin="log", name="Log", columns=_log_columns()),
                    column_shares=[1, 1],
                ),
                row_shares=[5, 2],
            ),
            rrb.Vertical(
                _curves("error", "Tracking error, m"),
                _curves("rate", "Mission clock rate", (-1.1, 1.1)),
                _curves("battery", "Battery, %", (0.0, 100.0)),
                _curves("link", "Link age, s"),
                row_shares=[3, 1, 1, 1],
            ),
            column_shares=[5, 2],
        ),
        rrb.TimePanel(
            timeline="time",
            state="collapsed",
            play_state="following" if live else "playing",
        ),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        auto_layout=False,
        auto_views=False,
    )


def _scene(plan: Plan, name: str, timeline: str, *without: str) -> rrb.Spatial3DView:
    return rrb.Spatial3DView(
        origin="/",
        contents=["+ /**", "- /plots/**", "- /states/**", "- /log", *without],
        name=name,
        line_grid=rrb.LineGrid3D(visible=True, spacing=1.0, color=(255, 255, 255, 14)),
        background=rrb.Background(color=(22, 26, 34)),
        eye_controls=_eye(plan),
        overrides={
            "flight/trails": rrb.VisibleTimeRanges(
                timeline=timeline,
                start=rrb.TimeRangeBoundary.cursor_relative(seconds=-TRAIL),
                end=rrb.TimeRangeBoundary.cursor_relative(),
            )
        },
    )


def _states() -> rrb.Tabs:
    return rrb.Tabs(
        rrb.StateTimelineView(
            origin="states",
            contents=["+ /states/phase", "+ /states/waiting", "+ /states/vehicles/**"],
            name="Phase and vehicles",
        ),
        rrb.StateTimelineView(origin="states/modes", name="Modes"),
    )


def _log_columns() -> rrb.TextLogColumns:
    return rrb.TextLogColumns(timeline_columns=["time"], text_log_columns=["LogLevel", "Body"])


def _curves(
    origin: str, name: str, limits: tuple[float, float] | None = None
) -> rrb.TimeSeriesView:
    return rrb.TimeSeriesView(
        origin=f"plots/{origin}",
        name=name,
        axis_y=rrb.ScalarAxis(range=limits, zoom_lock=False) if limits else None,
        plot_legend=rrb.PlotLegend(visible=False),
    )


def _eye(plan: Plan) -> rrb.EyeControls3D:
    """Look at the knot from above its south-west, as far away as the lifted line needs."""
    corners = plan.layout.corners
    centre = (corners.min(axis=0) + corners.max(axis=0)) / 2
    extent = float(np.linalg.norm(np.ptp(corners[:, :2], axis=0)))
    towards: npt.NDArray[np.float64] = np.array([-0.6, -1.0, 0.62])
    towards /= np.linalg.norm(towards)
    target = centre - [0.0, 0.0, 0.3 * centre[2]]
    return rrb.EyeControls3D(
        position=target + towards * (1.25 * extent + 3.0),
        look_target=target,
        eye_up=(0.0, 0.0, 1.0),
    )
