"""Figures of studies: many trials, simulated ropes, the Pareto front of a mission."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import matplotlib as mpl
import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure

from swarm.certification.assessment import rounded_down
from swarm.certification.kinds import FIGURES
from swarm.planning import Plan
from swarm.reports.formatting import DISTANCES
from swarm.reports.plots import (
    ALARM,
    END,
    FAINT,
    FAINT_INK,
    INK,
    START,
    STYLE,
    Axes,
    along_colours,
    new_figure,
    sparse_ticks,
)
from swarm.simulation.summaries import CertifiedClearances
from swarm.simulation.trials import Trial

if TYPE_CHECKING:
    from swarm.rope import RopeRun

Floats = npt.NDArray[np.float64]

_COLOURS: Final = (START, END)


@dataclass(frozen=True, eq=False)
class TrialDistances:
    """Smallest distances of the k trials of a trajectory, metres, NaN where unknown.

    ``by_kind`` maps each key of :data:`DISTANCES` to distances (k,); ``tracking_error`` (k,) is the
    largest in the trial; ``with_failure`` (k,) is true where a vehicle failed. ``certified`` maps
    each clearance to its bounds (m,) for tracking radii ``tracking_radius`` (m,).
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

    def column(values: Iterable[float | None]) -> Floats:
        return np.array([np.nan if value is None else value for value in values])

    return TrialDistances(
        label="the paper's trajectory" if plan.mission.fold.method == "paper" else "this plan",
        by_kind={name: column(trial.distances[name] for trial in trials) for name in DISTANCES},
        tracking_error=column(trial.tracking_error for trial in trials),
        with_failure=np.array([bool(trial.failure) for trial in trials]),
        tracking_radius=certified.tracking_radius,
        certified=certified.distances,
    )


@mpl.rc_context(STYLE)
def trials_figure(
    runs: Sequence[TrialDistances],
    required: Mapping[str, float],
    kinds: Sequence[str] = tuple(FIGURES),
) -> Figure:
    """Return a figure with a column per kind of distance.

    Above are the distributions of all trajectories, below the certified bounds of the first.
    ``required`` maps each kind to the mission's clearance, metres. A kind that no trial has a
    distance of is left out: a plan of two vehicles has no two strands apart.
    """
    kinds = [k for k in kinds if any(np.isfinite(r.by_kind[k]).any() for r in runs)] or kinds
    figure = new_figure(3.7 * len(kinds), 6.4)
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
    axes.set_title(DISTANCES[kind].capitalize(), pad=16)


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


def rope_curves(run: "RopeRun") -> RopeCurves:
    """Return the curves of a run: at each moment the largest deviation of a segment."""
    excess = np.where(run.deviation > run.allowed_swing, run.deviation, -np.inf).max(
        axis=1, initial=-np.inf
    )
    hand = "" if run.chirality == "none" else f", {run.chirality}-handed"
    verdict = f"{run.knot}{hand}" + ("" if run.as_planned else " (not as planned)")
    return RopeCurves(
        label=run.trajectory,
        verdict="invalid" if run.invalid else verdict,
        times=run.times,
        deviation=run.deviation.max(axis=1, initial=0.0),
        excess=np.where(np.isfinite(excess), excess, np.nan),
        strand_distance=run.distance,
        static_distance=run.static_distance,
        shape=run.shape,
    )


@mpl.rc_context(STYLE)
def rope_figure(runs: Sequence[RopeCurves], required: float) -> Figure:
    """Return a figure of distances over time and of final shapes; ``required`` is the clearance."""
    figure = new_figure(11.0, 2.9 + 3.6 * len(runs))
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


def draw_rope_above(axes: Axes, run: RopeCurves) -> None:
    """Draw the final rope from above; the higher strand covers the lower one."""
    shape, colours = run.shape, along_colours(len(run.shape) - 1)
    for k in np.argsort(shape[1:, 2] + shape[:-1, 2]):
        pair = shape[k : k + 2, :2].T
        axes.plot(*pair, color="white", linewidth=5.0, solid_capstyle="butt")
        axes.plot(*pair, color=colours[k], linewidth=2.0, solid_capstyle="round")
    axes.plot(*shape[[0, -1], :2].T, "o", color=INK, markersize=4)
    axes.set_aspect("equal")
    axes.set(xlabel="east, m", ylabel="north, m", title=f"{run.label}: {run.verdict}")


def draw_rope(axes: Axes, run: RopeCurves) -> None:
    """Draw the final rope in space."""
    shape, colours = run.shape, along_colours(len(run.shape) - 1)
    for k in range(len(shape) - 1):
        axes.plot(*shape[k : k + 2].T, color=colours[k], linewidth=1.6)
    low, high = shape.min(axis=0), shape.max(axis=0)
    sides = np.maximum(high - low, 0.2 * (high - low).max())
    axes.set_box_aspect(sides, zoom=0.95)
    sparse_ticks(axes, sides)
    axes.view_init(elev=28, azim=-62)
    axes.set(xlabel="east, m", ylabel="north, m", zlabel="up, m", title="in space, at the end")


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


@mpl.rc_context(STYLE)
def pareto_figure(points: Sequence[Point]) -> Figure:
    """Return the figure of a Pareto front: cable length, fold time and e* of plans.

    Points are numbered; a list beside names them. Where they have different numbers of vehicles,
    cable, fold time, e* and payload are shown over these, too. Dominated plans are faint.

    ``points`` have the fields of :class:`swarm.studies.FrontPoint`.
    """
    several = len({point["vehicles"] for point in points}) > 1
    figure = new_figure(14.0 if several else 9.0, 4.6)
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
