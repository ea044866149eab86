"""Figures of a plan over time: each vehicle's place along the path, and its height."""

from pathlib import Path
from typing import Final

import matplotlib as mpl
import numpy as np
import numpy.typing as npt
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from swarm.planning import Plan
from swarm.reports.plots import FAINT, STYLE, Axes, along_colours, save

Floats = npt.NDArray[np.float64]

LABEL_GAP: Final = 0.055
"""Least distance of two labels, as a share of the axis: the height of a digit in these figures."""


def plot_schedule(plan: Plan, path: Path) -> None:
    """Write a PNG of every vehicle's place along the fold's path and its height over time."""
    save(schedule_figure(plan), path)


def schedule_figure(plan: Plan) -> Figure:
    """Return the figure of :func:`plot_schedule`."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(8.0, 5.2), layout="constrained")
        FigureCanvasAgg(figure)
        above, below = figure.subplots(2, 1, sharex=True)
        draw_schedule(above, plan)
        draw_heights(below, plan)
        return figure


def draw_schedule(axes: Axes, plan: Plan) -> None:
    """Draw each vehicle's place along the common path during the fold."""
    fold = plan.phase("fold")
    times = np.linspace(fold.start, fold.end, 400)
    places = places_along_path(plan, times)
    corners = places[-1]
    step = LABEL_GAP * float(np.ptp(places))
    labels = spread_labels(corners, step)
    for i, colour in enumerate(along_colours(plan.vehicles)):
        axes.axhline(corners[i], color=FAINT, linewidth=0.6, zorder=0)
        axes.plot(times, places[:, i], color=colour, linewidth=1.4)
        axes.text(times[-1], labels[i], f" {i + 1}", fontsize=7.5, va="center", color=colour)
    axes.set(ylabel="along the path, m", title="Schedule: each vehicle stops at its own corner")


def places_along_path(plan: Plan, times: Floats) -> Floats:
    """Return each vehicle's arc length (k, n) on the fold's path at mission times (k,), metres.

    It is the arc length of the vehicle's corner minus its remaining distance, and negative before
    the start of the path.
    """
    position = plan.motion.at(times)[0]
    step = np.linalg.norm(np.diff(position, axis=0), axis=-1)
    remaining = np.vstack([step[::-1].cumsum(axis=0)[::-1], np.zeros(plan.vehicles)])
    arc = np.append(0.0, np.linalg.norm(np.diff(plan.path, axis=0), axis=1).cumsum())
    apart = np.linalg.norm(plan.path[:, None] - plan.layout.corners, axis=-1)
    places: Floats = arc[apart.argmin(axis=0)] - remaining
    return places


def draw_heights(axes: Axes, plan: Plan) -> None:
    """Draw the heights of the grip points during the fold."""
    fold = plan.phase("fold")
    times = np.linspace(fold.start, fold.end, 400)
    height = plan.motion.at(times)[0][:, :, 2]
    shown = places_of_labels(times, height)
    for i, colour in enumerate(along_colours(plan.vehicles)):
        axes.plot(times, height[:, i], color=colour, linewidth=1.4)
        k = shown[i]
        axes.text(
            times[k], height[k, i], str(i + 1), fontsize=7.5, color=colour, weight="bold",
            ha="center", va="center", zorder=5,
            bbox={"boxstyle": "circle,pad=0.15", "facecolor": "white", "linewidth": 0},
        )  # fmt: skip
    axes.set(xlabel="mission time, s", ylabel="height, m", title="Heights of the grip points")


def spread_labels(values: Floats, gap: float) -> Floats:
    """Return places (n,) for labels at values (n,), at least ``gap`` apart, in the same order."""
    order = np.argsort(values, kind="stable")
    places = values[order].astype(np.float64)
    places = np.maximum.accumulate(places - gap * np.arange(len(places)))
    spread = np.empty_like(places)
    spread[order] = places + gap * np.arange(len(places))
    return spread


def places_of_labels(times: Floats, curves: Floats) -> list[int]:
    """Return for each curve (k, n) the index at which its label is farthest from all others.

    Distances to other curves and to earlier labels are in shares of the axes.
    """
    x = (times - times[0]) / max(float(np.ptp(times)), 1e-9)
    y = (curves - curves.min()) / max(float(np.ptp(curves)), 1e-9)
    chosen: list[int] = []
    for i in range(curves.shape[1]):
        apart = np.delete(np.abs(y - y[:, [i]]), i, axis=1).min(axis=1, initial=1.0)
        for other, k in enumerate(chosen):
            apart = np.minimum(apart, np.hypot(x - x[k], y[:, i] - y[k, other]))
        inside = (x > 0.02) & (x < 0.98)
        chosen.append(int(np.argmax(np.where(inside, apart, -1.0))))
    return chosen
