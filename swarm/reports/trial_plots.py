"""Figures of many trials: distributions of distances, and distances against certified bounds."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import matplotlib as mpl
import numpy as np
import numpy.typing as npt
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from swarm.certification.kinds import MEASURED
from swarm.planning import Plan
from swarm.reports.plots import ALARM, END, FAINT, INK, START, STYLE, Axes
from swarm.reports.wording import TRIAL_DISTANCES
from swarm.simulation.monte_carlo import CertifiedClearances, Trial

Floats = npt.NDArray[np.float64]

_COLOURS: Final = (START, END)


@dataclass(frozen=True, eq=False)
class TrialDistances:
    """Smallest distances of the k trials of a trajectory, metres, NaN where unknown.

    ``by_kind`` maps each key of :data:`.TRIAL_DISTANCES` to distances (k,); ``tracking_error`` (k,)
    is the largest in the trial; ``with_failure`` (k,) is true where a vehicle failed. ``certified``
    maps each clearance to its bounds (m,) for tracking radii ``tracking_radius`` (m,).
    """

    label: str
    by_kind: Mapping[str, Floats]
    tracking_error: Floats
    with_failure: npt.NDArray[np.bool_]
    tracking_radius: Floats
    certified: Mapping[str, Floats]


def trial_distances(
    plan: Plan, trials: Sequence[Trial], certified: CertifiedClearances
) -> TrialDistances:
    """Return the distances of a plan's trials with their certified bounds."""

    def column(found: Iterable[float | None]) -> Floats:
        return np.array([np.nan if value is None else value for value in found])

    return TrialDistances(
        label="the paper's trajectory" if plan.mission.fold.method == "paper" else "this plan",
        by_kind={
            name: column(trial.distances[name] for trial in trials) for name in TRIAL_DISTANCES
        },
        tracking_error=column(trial.tracking_error for trial in trials),
        with_failure=np.array([bool(trial.failure) for trial in trials]),
        tracking_radius=certified.tracking_radius,
        certified=certified.distances,
    )


def trials_figure(
    runs: Sequence[TrialDistances],
    required: Mapping[str, float],
    kinds: Sequence[str] = tuple(MEASURED),
) -> Figure:
    """Return a figure with a column per kind of distance.

    Above are the distributions of all trajectories, below the certified bounds of the first.
    ``required`` maps each kind to the mission's clearance, metres. A kind that no trial has a
    distance of is left out: a plan of two vehicles has no two strands apart.
    """
    kinds = [k for k in kinds if any(np.isfinite(r.by_kind[k]).any() for r in runs)] or kinds
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(3.7 * len(kinds), 6.4), layout="constrained")
        FigureCanvasAgg(figure)
        axes = figure.subplots(2, len(kinds), squeeze=False)
        for above, below, kind in zip(axes[0], axes[1], kinds, strict=True):
            draw_distribution(above, runs, kind, required[kind])
            draw_certified(below, runs[0], kind, required[kind])
            if len(runs) > 1:
                below.set_title(f"Flown and certified, {runs[0].label}")
        handles, labels = axes[0, 0].get_legend_handles_labels()
        more_handles, more_labels = axes[1, 0].get_legend_handles_labels()
        figure.legend(
            handles + more_handles, labels + more_labels, loc="outside lower center",
            ncols=5 if len(kinds) > 1 else 1, fontsize=8.5, frameon=False,
        )  # fmt: skip
        return figure


def draw_distribution(
    axes: Axes, runs: Sequence[TrialDistances], kind: str, required: float
) -> None:
    """Draw the cumulative distribution of the smallest distance in trials without a failure."""
    for run, colour in zip(runs, _COLOURS, strict=False):
        values = run.by_kind[kind][~run.with_failure]
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
    axes.set_title(TRIAL_DISTANCES[kind].capitalize(), pad=16)


def draw_certified(axes: Axes, run: TrialDistances, kind: str, required: float) -> None:
    """Draw each trial's smallest distance over its tracking error, and the certified bound.

    A point below the line contradicts the certificate.
    """
    bound = np.asarray(run.certified[kind], dtype=np.float64)
    finite = np.isfinite(bound)
    axes.plot(run.tracking_radius[finite], np.maximum(bound[finite], 0.0), color=INK, linewidth=1.6,
              label="certified for this error")  # fmt: skip
    right = 1.15 * float(np.nanmax(run.tracking_error[~run.with_failure], initial=0.1))
    for failed, marker, name in ((False, "o", "trials"), (True, "x", "trials with a failure")):
        chosen = (run.with_failure == failed) & np.isfinite(run.by_kind[kind])
        if chosen.any():
            errors, distances = run.tracking_error[chosen], run.by_kind[kind][chosen]
            outside = int(np.count_nonzero(errors > right))
            note = f" ({outside} of {len(errors)} beyond the right edge)" if outside else ""
            axes.plot(errors, np.maximum(distances, 0.0), marker, markersize=3.5,
                      color=END if failed else START, alpha=0.7, label=name + note)  # fmt: skip
    axes.axhline(required, color=ALARM, linewidth=1.0, linestyle="--")
    axes.set_xlim(0.0, right)
    axes.set_ylim(bottom=0.0)
    axes.grid(color=FAINT, linewidth=0.4)
    axes.set(xlabel="largest tracking error in the trial, m", ylabel="smallest distance, m")
    axes.set_title("Flown and certified")
