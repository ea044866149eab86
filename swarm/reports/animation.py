"""A moving picture of a plan: the cable and its vehicles in space, as an animated GIF."""

from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import numpy.typing as npt
from matplotlib.animation import FuncAnimation, PillowWriter
from matplotlib.figure import Figure
from scipy.ndimage import gaussian_filter1d

from swarm.planning import Plan
from swarm.planning.cable_shape import cable_shape
from swarm.reports.plots import INK, STYLE, along_colours

Floats = npt.NDArray[np.float64]

FRAMES_PER_SECOND = 10
_POINTS = 24
"""Points of a segment: its links are then shorter than a pixel row is high."""
_LAST_FRAMES = 12
"""Frames for which the folded cable is shown."""
_SMOOTHING = 5.0
"""Standard deviation of the camera's smoothing, in frames."""
_TURN = 50.0
"""Degrees by which the camera turns around the team, so that depth can be seen."""


@mpl.rc_context(STYLE)
def animate_plan(plan: Plan, path: Path, frames: int = 90) -> None:
    """Write the lift, fold and hold of a plan as an animated GIF of a few hundred kilobytes.

    ``frames`` are evenly spaced in mission time. Raises :class:`KeyError` for a plan without fold.
    """
    fold = plan.phase("fold")
    begin = plan.phase("lift").start if any(p.name == "lift" for p in plan.phases) else fold.start
    times = np.linspace(begin, fold.end, frames)
    places = plan.motion.at(times)[0]
    cable = cable_shape(plan, times, _POINTS)
    centre, size = _frame(places, cable)
    figure = Figure(figsize=(5.6, 4.0))
    axes: Any = figure.add_axes((-0.25, -0.3, 1.5, 1.5), projection="3d")
    axes.set_box_aspect((1.0, 1.0, 1.0), zoom=0.85)
    axes.set_axis_off()
    colours = along_colours(cable.shape[1])
    shadows: list[Any] = [
        axes.plot([], [], [], color=INK, alpha=0.15, linewidth=2.0)[0] for _ in colours
    ]
    strands: list[Any] = [
        axes.plot([], [], [], color=colour, linewidth=2.4)[0] for colour in colours
    ]
    vehicles = axes.plot([], [], [], "o", color=INK, markersize=5)[0]
    label = figure.text(0.03, 0.93, "", color=INK)

    def show(frame: int) -> list[Any]:
        k = min(frame, frames - 1)
        low, high = centre[k] - 0.5 * size[k], centre[k] + 0.5 * size[k]
        axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
        for strand, shadow, points in zip(strands, shadows, cable[k], strict=True):
            strand.set_data_3d(*points.T)
            shadow.set_data_3d(points[:, 0], points[:, 1], np.zeros(_POINTS))
        vehicles.set_data_3d(*places[k].T)
        axes.view_init(elev=32.0, azim=-75.0 + _TURN * k / frames)
        label.set_text(f"{plan.mission.name}, {times[k] - times[0]:.0f} s")
        return [*strands, *shadows, vehicles]

    moving = FuncAnimation(figure, show, frames=frames + _LAST_FRAMES)
    moving.save(path, writer=PillowWriter(fps=FRAMES_PER_SECOND), dpi=90)


def _frame(places: Floats, cable: Floats) -> tuple[Floats, Floats]:
    """Return the centres (k, 3) and the widths (k, 1) of cubes around the team, smooth over time.

    The cubes reach down to the floor, on which the plan view of the cable is drawn.
    """
    points = np.concatenate([places, cable.reshape(len(cable), -1, 3)], axis=1)
    low, high = points.min(axis=1), points.max(axis=1)
    low[:, 2] = 0.0
    size = (high - low).max(axis=1, keepdims=True)
    return (
        gaussian_filter1d(0.5 * (low + high), _SMOOTHING, axis=0, mode="nearest"),
        gaussian_filter1d(1.05 * size, _SMOOTHING, axis=0, mode="nearest"),
    )
