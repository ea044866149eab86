"""Pictures of the swing of the cable."""

from matplotlib.axes import Axes

from swarm.flight.flown_swing import SwingCurves
from swarm.reports.plots import ALARM, END, INK


def draw_swing(axes: Axes, swing: SwingCurves) -> None:
    """Draw the largest stray of all strands over mission time, metres.

    What was estimated in the flight, what is planned, and the radius of the certified tube. Where
    the clock waits or runs backwards, the estimate stays or returns.
    """
    order = swing.time.argsort(kind="stable")
    time = swing.time[order]
    axes.fill_between(
        time, swing.certified.max(axis=1)[order], color=END, alpha=0.15, linewidth=0.0,
        label="certified tube, with stops",
    )  # fmt: skip
    axes.plot(time, swing.planned.max(axis=1)[order], color=END, linewidth=1.2, label="planned")
    axes.plot(swing.time, swing.estimated.max(axis=1), color=INK, linewidth=1.0, label="estimated")
    outside = (swing.estimated > swing.certified).any(axis=1)
    axes.plot(
        swing.time[outside], swing.estimated.max(axis=1)[outside], ".", color=ALARM, markersize=3,
        label="a strand outside its tube",
    )  # fmt: skip
    axes.set(xlabel="mission time, s", ylabel="largest stray, m")
    axes.set_title("Swing of the cable")
    axes.set_ylim(bottom=0.0)
    axes.legend(fontsize=7.5, frameon=False, loc="upper left")
