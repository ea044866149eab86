"""Figures of a plan and a flight: grid diagram, plan view, the folded cable in space, distances.

``draw_…`` draws into axes, ``…_figure`` returns a whole figure, ``plot_…`` writes it as PNG.
"""

from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import matplotlib as mpl
import numpy as np
import numpy.typing as npt
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from swarm.certification.clearances import Moment
from swarm.errors import InputError, Problem, reason
from swarm.flight.trace import Trace
from swarm.planning import KnotLayout, KnotSummary, Plan
from swarm.reports import scene
from swarm.reports.fold_labels import label_fold
from swarm.reports.formatting import together

Floats = npt.NDArray[np.float64]
Axes = Any
"""Matplotlib's axes, in the plane or in space; its stubs do not distinguish them."""

STYLE: Final[Any] = {
    "font.size": 9.0,
    "axes.titlesize": 10.0,
    "axes.titleweight": "bold",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": "#606878",
    "figure.facecolor": "white",
    "savefig.facecolor": "white",
}
START: Final = np.array([38, 120, 178]) / 255
END: Final = np.array([214, 96, 40]) / 255
"""The cable is drawn from blue (vehicle 1) to orange (the last): which end is which shows."""

INK: Final = "#303848"
ALARM: Final = "#c03030"
FAINT: Final = "#c8cdd6"
FAINT_INK: Final = "#98a0ae"
FLAT: Final = 0.25
"""Least side of a drawing, as a share of its longest side; a straight line has no width."""

GAP: Final = 0.16
"""Half of the gap of an under strand, in cells or in shares of a median span."""

_ABOVE_PHASES: Final = 16.0
"""Points between axes and a title: the names of the phases, 7.5 points high, are between them."""


def plot_plan(plan: Plan, path: Path) -> None:
    """Write one PNG with the grid diagram, the plan view and the folded cable in space."""
    save(plan_figure(plan), path)


def plan_figure(plan: Plan) -> Figure:
    """Return the figure of :func:`plot_plan`; without a grid its first part is left out."""
    with mpl.rc_context(STYLE):
        grid = bool(plan.knot.grid_columns)
        figure = Figure(figsize=(12.0 if grid else 8.5, 4.2), layout="constrained")
        FigureCanvasAgg(figure)
        shares = [1.0, 1.15, 1.35][not grid :]
        cells = figure.add_gridspec(1, len(shares), width_ratios=shares)
        if grid:
            draw_grid(figure.add_subplot(cells[0, 0]), plan.knot, plan.layout)
        draw_plan_view(figure.add_subplot(cells[0, -2]), plan.layout)
        folded = figure.add_subplot(cells[0, -1], projection="3d")
        draw_fold(folded, plan.layout)
        figure.suptitle(_headline(plan))
        label_fold(folded, plan.layout, INK)
        return figure


def _headline(plan: Plan) -> str:
    hand = f", {plan.knot.chirality}-handed" if plan.knot.chirality != "none" else ""
    knot = f"knot {plan.knot.type}{hand}" if plan.knot.type else "no knot"
    vehicles = f"{plan.vehicles} vehicle{'s' if plan.vehicles > 1 else ''}"
    length = plan.layout.lengths.sum()
    cable = f"{length:.1f} m of cable" if length else "no cable"
    return f"{plan.mission.name}: {knot}, {vehicles}, {cable}"


def plot_flight(plan: Plan, trace: Trace, path: Path) -> None:
    """Write a PNG of a flight: plan view, tracking errors and the mission clock."""
    save(flight_figure(plan, trace), path)


def flight_figure(plan: Plan, trace: Trace) -> Figure:
    """Return the figure of :func:`plot_flight`."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(12.0, 5.2), layout="constrained")
        FigureCanvasAgg(figure)
        cells = figure.add_gridspec(2, 2, width_ratios=[1.0, 1.6])
        draw_flown_view(figure.add_subplot(cells[:, 0]), plan, trace)
        draw_errors(figure.add_subplot(cells[0, 1]), trace, plan.mission.vehicles.tracking)
        draw_clock(figure.add_subplot(cells[1, 1]), trace)
        figure.suptitle(f"{plan.mission.name}: flight")
        return figure


def save(figure: Figure, path: Path) -> None:
    """Write a figure as PNG, at a size that is sharp on screens and small on disk.

    Raises :class:`InputError` where the file cannot be written.
    """
    try:
        figure.savefig(path, dpi=130, format="png")
    except OSError as error:
        raise InputError([Problem(str(path), reason(error))]) from None


def new_axes(
    size: tuple[float, float] = (4.6, 4.2), projection: str | None = None
) -> tuple[Figure, Axes]:
    """Return a figure of a size in inches with one pair of axes."""
    figure = Figure(figsize=size, layout="constrained")
    FigureCanvasAgg(figure)
    return figure, figure.add_subplot(projection=projection)


def along_colours(count: int) -> Floats:
    """Return colours (count, 3) that run along the cable."""
    share = np.linspace(0.0, 1.0, count)[:, None]
    return (1 - share) * START + share * END


def draw_grid(axes: Axes, knot: KnotSummary, layout: KnotLayout | None = None) -> None:
    """Draw a grid diagram: columns pass over rows.

    Where the layout has a vehicle at each corner of the diagram but one, its corners are numbered
    and coloured like the plan view, and the two edges without cable are dotted.
    """
    columns = grid_columns(knot)
    size = len(columns)
    places = None if layout is None else grid_places(knot, layout)
    colour = _edge_colours(places)
    for row in range(size):
        left, right = np.flatnonzero((columns == row).any(axis=1))
        across = np.arange(left + 1, right)
        above = across[(columns[across, 0] < row) & (row < columns[across, 1])]
        edges = np.concatenate([[left], np.repeat(above, 2), [right]]).astype(float)
        edges[1:-1] += np.tile([-GAP, GAP], len(above))
        pieces = np.stack([edges.reshape(-1, 2), np.full((len(above) + 1, 2), row)], axis=-1)
        axes.add_collection(LineCollection(list(pieces), linewidths=2.2, **colour(1, row)))
    for column, (low, high) in enumerate(columns):
        ends = [[(column, low), (column, high)]]
        axes.add_collection(LineCollection(ends, linewidths=2.2, **colour(0, column)))
    for edge in range(size + 1):
        axes.axhline(edge - 0.5, color=FAINT, linewidth=0.6, zorder=0)
        axes.axvline(edge - 0.5, color=FAINT, linewidth=0.6, zorder=0)
    if places is None:
        axes.plot(np.repeat(np.arange(size), 2), columns.ravel(), "o", color=INK, markersize=4.5)
    else:
        _label_vehicles(axes, places.astype(np.float64))
    axes.set(xlim=(-0.5, size - 0.5), ylim=(-0.5, size - 0.5), aspect="equal", xticks=[], yticks=[])
    axes.set_frame_on(False)
    # A searched layout, and given corners, are not those of the diagram.
    other = layout is not None and places is None
    axes.set_title(f"Grid diagram {size}×{size}{', not folded' if other else ''}")


def grid_columns(knot: KnotSummary) -> npt.NDArray[np.intp]:
    """Return the rows (size, 2) of both ends of each column, from 0, the lower first."""
    numbers = np.sort(np.array(knot.grid_columns), axis=1)
    return np.unique(numbers, return_inverse=True)[1].reshape(len(numbers), 2)


def grid_places(knot: KnotSummary, layout: KnotLayout) -> npt.NDArray[np.intp] | None:
    """Return each vehicle's column and row (n, 2) in the grid diagram; None where it has no place.

    A layout has the order of its diagram's columns and rows, in metres, with one corner left out.
    """
    columns = grid_columns(knot)
    if len(layout.corners) != 2 * len(columns) - 1:
        return None
    places = np.stack(
        [np.unique(axis.round(6), return_inverse=True)[1] for axis in layout.corners[:, :2].T],
        axis=1,
    )
    corners = {(column, int(row)) for column, rows in enumerate(columns) for row in rows}
    return places if corners >= {tuple(place) for place in places.tolist()} else None


def _edge_colours(
    places: npt.NDArray[np.intp] | None,
) -> Callable[[int, int], dict[str, Any]]:
    """Return the style of the edge of a column (0, number) or of a row (1, number)."""
    if places is None:
        return lambda _axis, _number: {"colors": [INK]}
    segments = {}
    for segment, (one, other) in enumerate(pairwise(places)):
        axis = 0 if one[0] == other[0] else 1
        segments[axis, int(one[axis])] = segment
    colours = along_colours(len(places) - 1)

    def style(axis: int, number: int) -> dict[str, Any]:
        segment = segments.get((axis, number))
        if segment is None:
            return {"colors": [FAINT_INK], "linestyles": [":"]}
        return {"colors": [colours[segment]]}

    return style


def draw_plan_view(axes: Axes, layout: KnotLayout) -> None:
    """Draw the cable from above as a knot diagram: the under strand has a gap."""
    corners = layout.corners[:, :2]
    colours = along_colours(len(corners) - 1)
    for segment, pieces in enumerate(_visible_pieces(layout)):
        ends = corners[segment] + np.array(pieces)[..., None] * np.diff(
            corners[segment : segment + 2], axis=0
        )
        lines = LineCollection(list(ends), colors=[colours[segment]], linewidths=2.6)
        lines.set_capstyle("round")
        axes.add_collection(lines)
    _label_vehicles(axes, corners)
    low, high = _extent(corners)
    margin = 0.12 * float((high - low).max())
    axes.set(xlim=(low[0] - margin, high[0] + margin), ylim=(low[1] - margin, high[1] + margin))
    axes.set_aspect("equal")
    axes.set(xlabel="east, m", ylabel="north, m")
    axes.set_title("Plan view")


def _extent(points: Floats) -> tuple[Floats, Floats]:
    """Return two opposite corners of a box around points, with sides of at least FLAT."""
    low, high = points.min(axis=0), points.max(axis=0)
    half = np.maximum(0.5 * (high - low), 0.5 * FLAT * max(float((high - low).max()), 1.0))
    middle = 0.5 * (low + high)
    return middle - half, middle + half


def _visible_pieces(layout: KnotLayout) -> list[list[tuple[float, float]]]:
    """Return the drawn pieces of each segment, in shares of its span, without the gaps."""
    corners = scene.joined(layout.corners, layout.lengths)[:, :2]
    spans = np.linalg.norm(np.diff(corners, axis=0), axis=1)
    if not len(spans):
        return []
    half = GAP * (layout.cell if layout.cell > 0 else 0.3 * float(np.median(spans)))
    gaps: list[list[float]] = [[] for _ in spans]
    for over, under in layout.crossings:
        gaps[under].append(scene.crossing_shares(corners, over, under)[1])
    pieces = []
    for span, at in zip(spans, gaps, strict=True):
        edges = [0.0]
        for share in sorted(at):
            edges += [share - half / span, share + half / span]
        edges.append(1.0)
        pieces.append([(a, b) for a, b in zip(edges[::2], edges[1::2], strict=True) if b > a])
    return pieces


def _label_vehicles(axes: Axes, corners: Floats) -> None:
    axes.plot(*corners.T, "o", color="white", markeredgecolor=INK, markersize=13, zorder=5)
    for i, (x, y) in enumerate(corners):
        axes.text(x, y, str(i + 1), ha="center", va="center_baseline", fontsize=7.5, zorder=6)


def draw_fold(axes: Axes, layout: KnotLayout, zoom: float = 0.95) -> None:
    """Draw the folded cable in space, every segment a catenary, and its crossings, without labels.

    :func:`swarm.reports.fold_labels.label_fold` adds them, when the figure is complete.
    ``zoom`` enlarges the box, for axes that are wider than high.
    """
    strips = scene.strands(layout.corners, layout.lengths, 40)
    colours = along_colours(len(strips))
    for strip, colour in zip(strips, colours, strict=True):
        axes.plot(*strip.T, color=colour, linewidth=2.0, clip_on=False)
    for crossing in scene.crossings(layout):
        axes.plot(*np.array([crossing.lower, crossing.upper]).T, color=INK, linewidth=0.9)
    axes.plot(*layout.corners.T, "o", color=INK, markersize=3.0, clip_on=False)
    for artist in axes.lines:
        artist.set_in_layout(False)  # parts of an enlarged box are outside of the axes
    low, high = _extent(np.vstack([strips.reshape(-1, 3), layout.corners]))
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    axes.set_box_aspect(high - low, zoom=zoom)
    axes.view_init(elev=28, azim=-62)
    sparse_ticks(axes, high - low)
    axes.set(xlabel="east, m", ylabel="north, m", zlabel="up, m")
    for axis in (axes.xaxis, axes.yaxis):
        axis.labelpad = 9  # points; less is printed over the numbers of a short side
    axes.set_title("Folded cable, distances at crossings")


def sparse_ticks(axes: Axes, sides: Floats) -> None:
    """Set fewer ticks on the short ``sides`` (3,) of a box, so that labels do not overlap."""
    for side, axis in zip(sides, (axes.xaxis, axes.yaxis, axes.zaxis), strict=True):
        axis.set_major_locator(MaxNLocator(3 if side < 0.6 * sides.max() else 7))


def draw_clearance(
    axes: Axes,
    times: Floats,
    distance: Floats,
    required: float,
    title: str,
    tightest: Moment | None = None,
) -> None:
    """Draw a distance (k,) in metres over times (k,) with the required and certified values.

    ``tightest`` must be a moment of the strands that the curve is of.
    """
    axes.plot(times, distance, color=INK, linewidth=1.4)
    axes.axhline(required, color=ALARM, linewidth=1.2, linestyle="--")
    late = tightest is None or tightest.time > 0.5 * (times[0] + times[-1])
    axes.text(
        times[0] if late else times[-1], required, f"required {required:.2f} m", color=ALARM,
        ha="left" if late else "right", va="bottom", fontsize=7.5,
    )  # fmt: skip
    if tightest is not None and np.isfinite(tightest.distance):
        low = max(tightest.distance, 0.0)
        axes.plot([tightest.time], [low], "v", color=ALARM, markersize=6)
        axes.annotate(
            f"certified {low:.2f} m, {together(tightest.between)}",
            (tightest.time, low),
            textcoords="offset points",
            xytext=(-8 if late else 8, 0),
            ha="right" if late else "left",
            va="center",
            fontsize=7.5,
        )
    axes.set(xlabel="mission time, s", ylabel="distance, m", title=title)
    axes.set_ylim(bottom=0.0)


def draw_errors(axes: Axes, trace: Trace, tracking_radius: float) -> None:
    """Draw every vehicle's tracking error over time with the tracking radius, metres."""
    errors = np.linalg.norm(trace.position - trace.setpoint, axis=-1)
    for i, colour in enumerate(along_colours(errors.shape[1])):
        axes.plot(trace.time, errors[:, i], color=colour, linewidth=0.7)
    if tracking_radius > 0:
        axes.axhline(tracking_radius, color=ALARM, linewidth=1.2, linestyle="--")
    _shade_phases(axes, trace)
    axes.set(xlabel="time, s", ylabel="error, m")
    axes.set_title("Tracking error", pad=_ABOVE_PHASES)
    axes.set_ylim(bottom=0.0)


def draw_clock(axes: Axes, trace: Trace) -> None:
    """Draw the mission clock over time."""
    axes.plot(trace.time, trace.mission_time, color=INK, linewidth=1.4)
    _shade_phases(axes, trace)
    axes.set(xlabel="time, s", ylabel="mission time, s")
    axes.set_title("Mission clock", pad=_ABOVE_PHASES)


def draw_flown_view(axes: Axes, plan: Plan, trace: Trace) -> None:
    """Draw the planned plan view and the last reported positions of the hold."""
    draw_plan_view(axes, plan.layout)
    held = trace.position[np.array(trace.phase, dtype=str) == "hold"]
    known = held[np.isfinite(held).all(axis=(1, 2))]
    if len(known):
        axes.plot(*known[-1][:, :2].T, "x", color=ALARM, markersize=13, zorder=3)
    axes.set_title("Plan view; × last reported positions" if len(known) else "Plan view")


def _shade_phases(axes: Axes, trace: Trace) -> None:
    """Shade every second phase; write the names above the axes where there is room for them."""
    if not len(trace.time):
        return
    names = np.array(trace.phase)
    edges = np.flatnonzero(np.append(True, names[1:] != names[:-1]))
    span = trace.time[-1] - trace.time[0]
    # the names must lie within the axes also where no value is known
    axes.update_datalim([(trace.time[0], 0.0), (trace.time[-1], 0.0)], updatey=False)
    axes.autoscale_view(scaley=False)
    for k, begin in enumerate(edges):
        last = edges[k + 1] if k + 1 < len(edges) else len(names) - 1
        start, end = trace.time[begin], trace.time[last]
        if k % 2:
            axes.axvspan(start, end, color="#f0f2f6", zorder=0, linewidth=0)
        if end - start > 0.04 * span:
            axes.text(
                (start + end) / 2, 1.01, names[begin], transform=axes.get_xaxis_transform(),
                ha="center", va="bottom", fontsize=7.5, color="#667085",
            )  # fmt: skip
