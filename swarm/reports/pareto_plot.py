"""The Pareto front of a mission as a figure."""

from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from swarm.certification.assessment import rounded_down
from swarm.reports.plots import FAINT_INK, INK, START, STYLE

Point = Mapping[str, Any]

_BY_VEHICLES = (
    ("cable_length", 1.0, "cable, m"),
    ("fold_time", 1.0, "fold, s"),
    ("max_tracking_error", 1.0, "e*, m"),
    ("payload", 1e3, "payload, g"),
)
"""Field of a point, factor and label of what is shown over the number of vehicles."""

_FAINT = 0.25
"""Opacity of dominated plans."""


def pareto_figure(points: Sequence[Point]) -> Figure:
    """Return the figure of a Pareto front: cable length, fold time and e* of plans.

    Points are numbered; a list beside names them. Where they have different numbers of vehicles,
    cable, fold time, e* and payload are shown over these, too. Dominated plans are faint.

    ``points`` have the fields of :class:`swarm.studies.FrontPoint`.
    """
    several = len({point["vehicles"] for point in points}) > 1
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(14.0 if several else 9.0, 4.6), layout="constrained")
        FigureCanvasAgg(figure)
        grid = figure.add_gridspec(2, 4 if several else 2)
        _draw_cable_and_time(figure.add_subplot(grid[:, :2]), points)
        for number, (field, factor, label) in enumerate(_BY_VEHICLES if several else ()):
            axes = figure.add_subplot(grid[number // 2, 2 + number % 2])
            _draw_by_vehicles(axes, points, field, factor)
            axes.set(ylabel=label, xlabel="vehicles" if number >= 2 else "")
        return figure


def _draw_cable_and_time(axes: Axes, points: Sequence[Point]) -> None:
    """Draw fold time over cable, larger e* as larger marks, with their numbers in a list beside."""
    tracking = [point["max_tracking_error"] for point in points]
    low, high = min(tracking), max(tracking)
    for number, point in enumerate(points, start=1):
        error, dominated = point["max_tracking_error"], point["dominated"]
        share = (error - low) / (high - low) if high > low else 1.0
        ink = FAINT_INK if dominated else INK
        place = point["cable_length"], point["fold_time"]
        axes.plot(
            *place, "o", markersize=10 + 8 * share, color=START,
            alpha=_FAINT if dominated else 0.9, markeredgewidth=0,
        )  # fmt: skip
        axes.annotate(
            f"{number}",
            place,
            fontsize=7.5,
            ha="center",
            va="center",
            color=INK if dominated else "white",
        )
        axes.plot(
            [], [], linestyle="", marker=f"${number}$", color=ink, markeredgewidth=0,
            label=f"{point['variant']}, e* {rounded_down(error, 3):.3f} m",
        )  # fmt: skip
    axes.set(xlabel="cable, m", ylabel="fold, s")
    axes.set_title("Cable, fold time and the largest tracking error e*")
    axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), fontsize=7.5, frameon=False)
    axes.margins(0.1, 0.12)


def _draw_by_vehicles(axes: Axes, points: Sequence[Point], field: str, factor: float) -> None:
    for point in points:
        axes.plot(
            point["vehicles"], factor * point[field], "o", markersize=7, color=START,
            alpha=_FAINT if point["dominated"] else 0.9, markeredgewidth=0,
        )  # fmt: skip
    axes.set_xticks(sorted({point["vehicles"] for point in points}))
    axes.margins(0.15, 0.2)
