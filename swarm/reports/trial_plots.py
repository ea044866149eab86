"""Figures of many dry runs: how close things came, and whether the certificate told the truth."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import matplotlib as mpl
import numpy as np
import numpy.typing as npt
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from swarm.planning import Plan
from swarm.reports.plots import ALARM, END, FAINT, INK, START, STYLE, Axes
from swarm.simulation.monte_carlo import CLEARANCES, Certificates, Trial

Floats = npt.NDArray[np.float64]

NAMES: Final = {
    "cable": "cable to cable",
    "hung": "cable to cable, as it hung",
    "vehicle": "vehicle to vehicle",
    "vehicle_cable": "vehicle to cable",
}
_COLOURS: Final = (START, END)


@dataclass(frozen=True, eq=False)
class Distances:
    """Smallest distances of k trials, metres (NaN where unknown), under one trajectory's name.

    ``by_kind`` maps "cable", "vehicle", "vehicle_cable" and "hung" to (k,), ``error`` (k,) is the
    largest tracking error and ``failing`` (k,) says in which trials a vehicle failed. ``radius``
    (m,) and ``certified`` (name → (m,)) are what certificates promise for tracking errors.
    """

    label: str
    by_kind: Mapping[str, Floats]
    error: Floats
    failing: npt.NDArray[np.bool_]
    radius: Floats
    certified: Mapping[str, Floats]


def distances_of(plan: Plan, flown: Sequence[Trial], certified: Certificates) -> Distances:
    """Return what the figure shows of a plan's trials, and of what was certified for them."""

    def column(name: str) -> Floats:
        return np.array([np.nan if (v := getattr(t, name)) is None else v for t in flown])

    return Distances(
        label="the paper's trajectory" if plan.mission.fold.method == "paper" else "this plan",
        by_kind={name: column(name) for name in (*CLEARANCES, "hung")},
        error=column("error"),
        failing=np.array([bool(trial.failing) for trial in flown]),
        radius=certified.radius,
        certified={name: getattr(certified, name) for name in CLEARANCES},
    )


KINDS: Final = ("cable", "vehicle", "vehicle_cable")


def trials_figure(
    runs: Sequence[Distances], required: Mapping[str, float], kinds: Sequence[str] = KINDS
) -> Figure:
    """Return the picture: distributions of all trajectories, and certificates of the first.

    ``required`` maps the kinds of distances to what the mission asks for, metres; ``kinds`` are
    those that are drawn, one beside the other.
    """
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(3.7 * len(kinds), 6.4), layout="constrained")
        FigureCanvasAgg(figure)
        axes = figure.subplots(2, len(kinds), squeeze=False)
        for above, below, kind in zip(axes[0], axes[1], kinds, strict=True):
            draw_distribution(above, runs, kind, required[kind])
            draw_promise(below, runs[0], kind, required[kind])
            if len(runs) > 1:
                below.set_title(f"Kept and certified, {runs[0].label}")
        handles, words = axes[0, 0].get_legend_handles_labels()
        more, further = axes[1, 0].get_legend_handles_labels()
        figure.legend(
            handles + more, words + further, loc="outside lower center",
            ncols=5 if len(kinds) > 1 else 1, fontsize=8.5, frameon=False,
        )  # fmt: skip
        return figure


def draw_distribution(axes: Axes, runs: Sequence[Distances], kind: str, required: float) -> None:
    """Draw which share of the trials came closer than each distance; no vehicle failing."""
    for run, colour in zip(runs, _COLOURS, strict=False):
        values = run.by_kind[kind][~run.failing]
        values = np.sort(np.maximum(values[np.isfinite(values)], 0.0))
        if len(values):
            share = np.arange(len(values) + 1) / len(values)
            axes.step(np.append(values[0], values), share, where="post", color=colour,
                      linewidth=1.8, label=f"{run.label} ({len(values)} trials)")  # fmt: skip
            axes.plot(values[:1], [0.0], "^", color=colour, markersize=5, clip_on=False)
    axes.axvline(required, color=ALARM, linewidth=1.2, linestyle="--")
    axes.text(required, 1.02, f"required {required:.2f} m", color=ALARM, fontsize=7.5, ha="center")
    axes.set(xlabel="smallest distance, m", ylabel="share of trials that came closer", ylim=(0, 1))
    right = axes.get_xlim()[1]
    axes.set_xlim(-0.02 * right, right)
    axes.set_title(NAMES[kind].capitalize(), pad=16)


def draw_promise(axes: Axes, run: Distances, kind: str, required: float) -> None:
    """Draw every trial's smallest distance at its tracking error over the certified one.

    A point below the line would be a certificate that did not tell the truth.
    """
    bound = np.asarray(run.certified[kind], dtype=np.float64)
    holds = np.isfinite(bound)
    axes.plot(run.radius[holds], np.maximum(bound[holds], 0.0), color=INK, linewidth=1.6,
              label="certified for that error")  # fmt: skip
    right = 1.15 * float(np.nanmax(run.error[~run.failing], initial=0.1))
    for failing, mark, words in ((False, "o", "trials"), (True, "x", "trials, a vehicle failing")):
        chosen = (run.failing == failing) & np.isfinite(run.by_kind[kind])
        if chosen.any():
            beyond = int(np.count_nonzero(run.error[chosen] > right))
            farther = f" ({beyond} of {np.count_nonzero(chosen)} farther right)" if beyond else ""
            axes.plot(run.error[chosen], np.maximum(run.by_kind[kind][chosen], 0.0), mark,
                      markersize=3.5, color=END if failing else START, alpha=0.7,
                      label=words + farther)  # fmt: skip
    axes.axhline(required, color=ALARM, linewidth=1.0, linestyle="--")
    axes.set_xlim(0.0, right)
    axes.set_ylim(bottom=0.0)
    axes.grid(color=FAINT, linewidth=0.4)
    axes.set(xlabel="largest tracking error in the trial, m", ylabel="smallest distance, m")
    axes.set_title("Kept and certified")
