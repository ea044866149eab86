"""Pictures of the swing of the cable."""

from matplotlib.axes import Axes

from swarm.flight.flown_swing import SwingCurves
from swarm.reports.plots import ALARM, END, INK


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
