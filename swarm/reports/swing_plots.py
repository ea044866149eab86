"""Pictures of the swing of the cable, planned and flown."""

from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from swarm.certification.swing_runs import aloft, swings
from swarm.errors import Refused
from swarm.flight.flown_swing import SwingCurves
from swarm.planning import Plan
from swarm.reports.plots import ALARM, END, INK, START, STYLE, save


def plot_shaping(shaped: Plan, time_optimal: Plan, path: Path) -> None:
    """Write a PNG of the planned swing of a plan, and of the same knot's time-optimal fold.

    Raises :class:`swarm.errors.Refused` where a plan folds no cable.
    """
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(8.0, 3.0), layout="constrained")
        FigureCanvasAgg(figure)
        axes = figure.subplots()
        for plan, words, colour in (
            (time_optimal, "time-optimal", START), (shaped, "as planned: shaped and slowed", END)
        ):  # fmt: skip
            _draw_planned(axes, plan, words, colour)
        since = "time since the beginning of the fold, s (dotted: its end)"
        axes.set(xlabel=since, ylabel="largest stray, m")
        axes.set_title("Swing of the cable in fold and hold, vehicles exactly on the plan")
        axes.set_ylim(0.0, 1.2 * axes.get_ylim()[1])
        axes.set_xlim(left=0.0)
        axes.legend(fontsize=8.0, frameon=False, loc="upper center", ncols=2)
    save(figure, path)


def _draw_planned(axes: Axes, plan: Plan, words: str, colour: object) -> None:
    span = aloft(plan)
    if span is None:
        raise Refused(f"{plan.mission.name}: the plan folds no cable")
    planned = next(swings(plan, span))
    fold, hold = plan.phase("fold"), plan.phase("hold")
    stray = np.linalg.norm(planned.strays[0], axis=-1).max(axis=(1, 2))
    shown = planned.times[0] <= hold.end
    time = planned.times[0][shown] - fold.start
    words = f"{words}: {fold.duration:.0f} s, at most {stray[shown].max():.2f} m"
    axes.plot(time, stray[shown], color=colour, linewidth=1.2, label=words)
    axes.axvline(fold.duration, color=colour, linewidth=0.8, linestyle=":")


def draw_swing(axes: Axes, swing: SwingCurves) -> None:
    """Draw the largest stray of all strands over mission time, metres.

    What was estimated in the flight, what is planned, the radius of the tube, and what tube and
    budget allow together. Where the clock waits or runs backwards, the estimate stays or returns.
    """
    order = swing.time.argsort(kind="stable")
    time, allowed, tube = (
        of[order] for of in (swing.time, swing.allowed.max(axis=1), swing.tube.max(axis=1))
    )
    axes.fill_between(
        time, tube, allowed, color=END, alpha=0.08, linewidth=0.0,
        label="excited by tracking errors (budget)",
    )  # fmt: skip
    axes.fill_between(
        time, tube, color=END, alpha=0.2, linewidth=0.0,
        label="tube of the plan, with stops and rewinds",
    )  # fmt: skip
    planned = swing.planned.max(axis=1)[order]
    axes.plot(time, planned, color=END, linewidth=1.2, label="planned")
    axes.plot(swing.time, swing.estimated.max(axis=1), color=INK, linewidth=1.0, label="estimated")
    beyond = (swing.estimated > swing.allowed).any(axis=1)
    if beyond.any():
        axes.plot(
            swing.time[beyond], swing.estimated.max(axis=1)[beyond], ".", color=ALARM,
            markersize=3, label="a strand beyond what it is allowed",
        )  # fmt: skip
    axes.set(xlabel="mission time, s", ylabel="largest stray, m")
    axes.set_title("Swing of the cable")
    axes.set_ylim(0.0, 1.45 * float(allowed.max()))
    axes.legend(fontsize=7.5, frameon=False, loc="upper left", ncols=2)
