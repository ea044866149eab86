"""Figures of a simulated rope: its deviation from the quasi-static cable, and its final shape."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import matplotlib as mpl
import numpy as np
import numpy.typing as npt
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from swarm.reports.plots import ALARM, END, INK, START, STYLE, Axes, sparse_ticks

Floats = npt.NDArray[np.float64]

_COLOURS: Final = (START, END)


@dataclass(frozen=True, eq=False)
class RopeCurves:
    """The curves of a rope that was moved along a trajectory, in metres and seconds.

    At the ``times`` (k,): ``deviation`` (k,) is the largest distance of a segment of the rope from
    the quasi-static cable; ``excess`` (k,) is the largest distance of a segment whose distance
    exceeds the budget's models of sway and a stop for this segment and moment, NaN without one;
    ``strand_distance`` and ``static_distance`` (k,) are the smallest distances of segments without
    a common vehicle, of the rope and of the quasi-static cable. ``shape`` (m, 3) is the rope at the
    end; ``verdict`` is its knot in words.
    """

    label: str
    verdict: str
    times: Floats
    deviation: Floats
    excess: Floats
    strand_distance: Floats
    static_distance: Floats
    shape: Floats


def rope_figure(runs: Sequence[RopeCurves], required: float) -> Figure:
    """Return a figure of distances over time and of final shapes; ``required`` is the clearance."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(11.0, 2.9 + 3.6 * len(runs)), layout="constrained")
        FigureCanvasAgg(figure)
        cells = figure.add_gridspec(1 + len(runs), 2, height_ratios=[2.9, *[3.6] * len(runs)])
        draw_deviation(figure.add_subplot(cells[0, 0]), runs)
        draw_strand_distance(figure.add_subplot(cells[0, 1]), runs, required)
        for row, run in enumerate(runs, 1):
            draw_rope_above(figure.add_subplot(cells[row, 0]), run)
            draw_rope(figure.add_subplot(cells[row, 1], projection="3d"), run)
        return figure


def draw_deviation(axes: Axes, runs: Sequence[RopeCurves]) -> None:
    """Draw the deviation from the quasi-static cable, and where it exceeds the budget's models."""
    for run, colour in zip(runs, _COLOURS, strict=False):
        axes.plot(run.times, run.deviation, color=colour, linewidth=1.4, label=run.label)
    label: str | None = "more than sway and a stop in the budget, same segment and time"
    for run in runs:
        if np.isfinite(run.excess).any():
            axes.plot(run.times, run.excess, "o", color=ALARM, markersize=3.0, label=label)
            label = None
    axes.set(xlabel="time, s", ylabel="largest distance, m")
    axes.set_title("Distance of the rope from the quasi-static cable")
    axes.set_ylim(bottom=0.0)
    axes.legend(fontsize=7.5, frameon=False)


def draw_strand_distance(axes: Axes, runs: Sequence[RopeCurves], required: float) -> None:
    """Draw the smallest distance of segments without a common vehicle, over time."""
    for run, colour in zip(runs, _COLOURS, strict=False):
        axes.plot(run.times, run.strand_distance, color=colour, linewidth=1.4, label=run.label)
        axes.plot(
            run.times, run.static_distance, color=colour, linewidth=0.9, linestyle="--",
            label="the quasi-static cable",
        )  # fmt: skip
    axes.legend(fontsize=7.5, frameon=False)
    axes.axhline(required, color=ALARM, linewidth=1.2, linestyle="--")
    _annotate(axes, required, f"required {required:.2f} m")
    axes.set(xlabel="time, s", ylabel="smallest distance, m", title="Distance of strands")
    axes.set_ylim(bottom=min(0.0, *(float(run.strand_distance.min(initial=0.0)) for run in runs)))


def _annotate(axes: Axes, height: float, text: str) -> None:
    axes.annotate(
        text, (1.0, height), xycoords=("axes fraction", "data"), color=ALARM, fontsize=7.5,
        ha="right", va="bottom", zorder=9,
        bbox={"facecolor": "white", "alpha": 0.85, "linewidth": 0, "pad": 1},
    )  # fmt: skip


def _piece_colours(shape: Floats) -> Floats:
    share = np.linspace(0.0, 1.0, len(shape) - 1)[:, None]
    colours: Floats = (1 - share) * START + share * END
    return colours


def draw_rope_above(axes: Axes, run: RopeCurves) -> None:
    """Draw the final rope from above; the higher strand covers the lower one."""
    shape, colours = run.shape, _piece_colours(run.shape)
    for k in np.argsort(shape[1:, 2] + shape[:-1, 2]):
        pair = shape[k : k + 2, :2].T
        axes.plot(*pair, color="white", linewidth=5.0, solid_capstyle="butt")
        axes.plot(*pair, color=colours[k], linewidth=2.0, solid_capstyle="round")
    axes.plot(*shape[[0, -1], :2].T, "o", color=INK, markersize=4)
    axes.set_aspect("equal")
    axes.set(xlabel="east, m", ylabel="north, m", title=f"{run.label}: {run.verdict}")


def draw_rope(axes: Axes, run: RopeCurves) -> None:
    """Draw the final rope in space."""
    shape, colours = run.shape, _piece_colours(run.shape)
    for k in range(len(shape) - 1):
        axes.plot(*shape[k : k + 2].T, color=colours[k], linewidth=1.6)
    low, high = shape.min(axis=0), shape.max(axis=0)
    sides = np.maximum(high - low, 0.2 * (high - low).max())
    axes.set_box_aspect(sides, zoom=0.95)
    sparse_ticks(axes, sides)
    axes.view_init(elev=28, azim=-62)
    axes.set(xlabel="east, m", ylabel="north, m", zlabel="up, m", title="in space, at the end")
