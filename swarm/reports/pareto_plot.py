"""The Pareto front of a mission as a figure."""

from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib as mpl
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from swarm.reports.plots import FAINT_INK, INK, START, STYLE


def pareto_figure(
    points: Sequence[Mapping[str, Any]],
) -> Figure:
    """Return the figure of a Pareto front: cable length, fold time and e* of plans.

    Dominated plans are faint.

    ``points`` have the fields of :class:`swarm.studies.FrontPoint`.
    """
    tracking = [point["max_tracking_error"] for point in points]
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(8.0, 4.6), layout="constrained")
        FigureCanvasAgg(figure)
        axes = figure.subplots()
        low, high = min(tracking), max(tracking)
        for point in points:
            cable, fold = point["cable_length"], point["fold_time"]
            error, dominated = point["max_tracking_error"], point["dominated"]
            share = (error - low) / (high - low) if high > low else 1.0
            axes.plot(
                cable, fold, "o", markersize=7 + 11 * share, color=START,
                alpha=0.25 if dominated else 0.9, markeredgewidth=0,
            )  # fmt: skip
            axes.annotate(
                f"e* {error:.3f} m\n{point['variant']}", (cable, fold), fontsize=7.5,
                textcoords="offset points", xytext=(12, -4),
                color=FAINT_INK if dominated else INK,
            )  # fmt: skip
        axes.set(xlabel="cable, m", ylabel="fold, s")
        axes.set_title("Cable, fold time and the largest tracking error e*")
        axes.margins(0.25, 0.18)
        return figure
