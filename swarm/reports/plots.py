"""Figures of a knot, a plan and a flight: diagrams, views, curves over time.

``draw_…`` draws into axes, ``…_figure`` returns a whole figure, ``…_pictures`` those of a page.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
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
from matplotlib.transforms import Bbox

from swarm.certification.assessment import Assessment
from swarm.certification.clearances import Moment
from swarm.errors import InputError, Problem, reason
from swarm.flight.swinging import SwingCurves, swing_curves
from swarm.flight.trace import Trace
from swarm.knots.catalog import KnotChoice
from swarm.planning import KnotLayout, KnotSummary, Plan
from swarm.reports import scene
from swarm.reports.formatting import certified, counted, together
from swarm.reports.result import Picture, picture

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

_ASIDE: Final = 3.0
"""Points between a label and its place: half of a dot, and a gap."""

_PADDING: Final = 1.0
"""Points around a label that belong to it."""

_SIDES: Final = ((1, 1), (-1, 1), (1, -1), (-1, -1))
"""Sides of a place on which a label may be, the preferred one first: right and above."""

LABEL_GAP: Final = 0.055
"""Least distance of two labels, as a share of the axis: the height of a digit in these figures."""


def new_figure(width: float, height: float) -> Figure:
    """Return a figure of a size in inches, to be drawn within :data:`STYLE`."""
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def new_axes(
    size: tuple[float, float] = (4.6, 4.2), projection: str | None = None
) -> tuple[Figure, Axes]:
    """Return a figure of a size in inches with one pair of axes."""
    figure = new_figure(*size)
    return figure, figure.add_subplot(projection=projection)


def save(figure: Figure, path: Path) -> None:
    """Write a figure as PNG, at a size that is sharp on screens and small on disk.

    Raises :class:`InputError` where the file cannot be written.
    """
    try:
        figure.savefig(path, dpi=130, format="png")
    except OSError as error:
        raise InputError([Problem(str(path), reason(error))]) from None


def along_colours(count: int) -> Floats:
    """Return colours (count, 3) that run along the cable."""
    share = np.linspace(0.0, 1.0, count)[:, None]
    return (1 - share) * START + share * END


@mpl.rc_context(STYLE)
def plan_figure(plan: Plan) -> Figure:
    """Return grid diagram, plan view and folded cable; without a grid its part is left out."""
    grid = bool(plan.knot.grid_columns)
    figure = new_figure(12.0 if grid else 8.5, 4.2)
    shares = [1.0, 1.15, 1.35][not grid :]
    cells = figure.add_gridspec(1, len(shares), width_ratios=shares)
    if grid:
        draw_grid(figure.add_subplot(cells[0, 0]), plan.knot, plan.layout)
    above = figure.add_subplot(cells[0, -2])
    draw_plan_view(above, plan.layout)
    draw_workspace(above, plan)
    folded = figure.add_subplot(cells[0, -1], projection="3d")
    draw_fold(folded, plan.layout)
    figure.suptitle(_headline(plan))
    label_fold(folded, plan.layout, INK)
    return figure


def _headline(plan: Plan) -> str:
    hand = f", {plan.knot.chirality}-handed" if plan.knot.chirality != "none" else ""
    knot = f"knot {plan.knot.type}{hand}" if plan.knot.type else "no knot"
    length = plan.layout.lengths.sum()
    cable = f"{length:.1f} m of cable" if length else "no cable"
    return f"{plan.mission.name}: {knot}, {counted(plan.vehicles, 'vehicle')}, {cable}"


@mpl.rc_context(STYLE)
def flight_figure(plan: Plan, trace: Trace) -> Figure:
    """Return plan view, tracking errors and the mission clock of a flight."""
    figure = new_figure(12.0, 5.2)
    cells = figure.add_gridspec(2, 2, width_ratios=[1.0, 1.6])
    draw_flown_view(figure.add_subplot(cells[:, 0]), plan, trace)
    draw_errors(figure.add_subplot(cells[0, 1]), plan, trace)
    draw_clock(figure.add_subplot(cells[1, 1]), trace)
    figure.suptitle(f"{plan.mission.name}: flight")
    return figure


@mpl.rc_context(STYLE)
def schedule_figure(plan: Plan) -> Figure:
    """Return every vehicle's remaining way in the fold, and its height, over time."""
    figure = new_figure(8.0, 5.2)
    above, below = figure.subplots(2, 1, sharex=True)
    draw_schedule(above, plan)
    draw_heights(below, plan)
    return figure


@mpl.rc_context(STYLE)
def knot_figure(choice: KnotChoice) -> Figure:
    """Return a knot's grid diagram, and the cable with its vehicles in it."""
    opened, size = choice.opening, choice.grid.size
    side = max(3.2, 0.42 * size)
    figure = new_figure(2 * side, side + 0.5)
    left, right = figure.subplots(1, 2)
    columns = np.array(opened.grid.columns) - 1
    draw_diagram(left, columns)
    left.set_title(f"grid diagram, {size} × {size}")
    draw_diagram(right, columns, np.array(opened.corners) - 1)
    right.set_title(f"opened: {choice.vehicles} vehicles, {len(opened.crossings)} crossings")
    for axes in (left, right):
        axes.set(xticks=range(size), yticks=range(size))
        axes.set(xticklabels=range(1, size + 1), yticklabels=range(1, size + 1))
        axes.tick_params(length=0, colors=INK)
    hand = "" if choice.chirality == "none" else f", {choice.chirality}-handed"
    figure.suptitle(f"knot {choice.title or choice.name}{hand}")
    return figure


@mpl.rc_context(STYLE)
def plan_pictures(plan: Plan, assessment: Assessment) -> list[Picture]:
    """Return the pictures of a plan's page."""
    pictures = []
    if plan.knot.grid_columns:
        figure, axes = new_axes()
        draw_grid(axes, plan.knot, plan.layout)
        folded = grid_places(plan.knot, plan.layout) is not None
        words = "numbered like the plan view" if folded else "which this layout does not follow"
        pictures.append(picture(figure, f"Grid diagram of the knot, {words}"))
    figure, axes = new_axes()
    draw_plan_view(axes, plan.layout)
    draw_workspace(axes, plan)
    pictures.append(picture(figure, "The cable from above; under strands have gaps"))
    figure, axes = new_axes((8.0, 3.8), projection="3d")
    draw_fold(axes, plan.layout, zoom=1.35)
    label_fold(axes, plan.layout, INK)
    pictures.append(picture(figure, "The folded cable in space", wide=True))
    if len(plan.layout.lengths) >= 3:
        figure, axes = new_axes((8.0, 2.8))
        times, distance = scene.planned_strand_distances(plan)
        required = plan.mission.clearance.cable
        title = "Smallest distance of strands that are not neighbours, planned"
        moments = [moment for moment in assessment.moments if moment.check == "cable clearance"]
        tightest = min(moments, key=lambda moment: moment.distance, default=None)
        draw_clearance(axes, times, distance, required, title, tightest)
        pictures.append(picture(figure, title, wide=True))
    schedule = schedule_figure(plan)
    pictures.append(picture(schedule, "Schedule and heights of the vehicles", wide=True))
    return pictures


@mpl.rc_context(STYLE)
def flight_pictures(plan: Plan, trace: Trace) -> list[Picture]:
    """Return the pictures of a flight's page."""
    pictures = []
    figure, axes = new_axes((8.0, 3.0))
    draw_errors(axes, plan, trace)
    pictures.append(picture(figure, "Tracking error of every vehicle", wide=True))
    figure, axes = new_axes((8.0, 2.2))
    draw_clock(axes, trace)
    pictures.append(picture(figure, "Mission clock over time", wide=True))
    swing = swing_curves(plan, trace)
    if swing is not None:
        figure, axes = new_axes((8.0, 2.8))
        draw_swing(axes, swing)
        title = "Swing of the cable: estimated, planned, and allowed by tube and budget"
        pictures.append(picture(figure, title, wide=True))
    held = np.flatnonzero(scene.fold_and_hold(trace))
    sampled = held[:: scene.sampling_step(trace)]
    if len(plan.layout.lengths) >= 3 and len(sampled):
        figure, axes = new_axes((8.0, 2.8))
        distance = scene.smallest_strand_distances(plan, trace.position[sampled])
        required = plan.mission.clearance.cable
        title = "Distance of strands that are not neighbours, as flown (sampled)"
        draw_clearance(axes, trace.mission_time[sampled], distance, required, title)
        pictures.append(picture(figure, title, wide=True))
    figure, axes = new_axes()
    draw_flown_view(axes, plan, trace)
    pictures.append(
        picture(figure, "The planned cable from above, with the last reported positions")
    )
    if len(held):
        figure, axes = new_axes(projection="3d")
        last = replace(plan.layout, corners=trace.position[held[-1]])
        draw_fold(axes, last)
        axes.set_title("Cable at the end of the hold, distances at crossings")
        label_fold(axes, last, INK)
        pictures.append(picture(figure, "The cable in space at the end of the hold"))
    return pictures


def draw_grid(axes: Axes, knot: KnotSummary, layout: KnotLayout | None = None) -> None:
    """Draw the grid diagram of a plan's knot as :func:`draw_diagram`.

    Where the layout has a vehicle at each corner of the diagram but one, its corners are numbered
    and coloured like the plan view.
    """
    columns = grid_columns(knot)
    places = None if layout is None else grid_places(knot, layout)
    draw_diagram(axes, columns, places)
    # A searched layout, and given corners, are not those of the diagram.
    other = layout is not None and places is None
    size = len(columns)
    axes.set_title(f"Grid diagram {size}×{size}{', not folded' if other else ''}")


def draw_diagram(
    axes: Axes, columns: npt.NDArray[np.intp], places: npt.NDArray[np.intp] | None = None
) -> None:
    """Draw a grid diagram: columns, with rows (size, 2) of their ends, pass over rows.

    With the ``places`` (n, 2) of the vehicles, from 0, these are numbered, edges are coloured along
    the cable, and the two edges without cable are dotted.
    """
    size = len(columns)
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
    for segment, (start, end) in enumerate(pairwise(places)):
        axis = 0 if start[0] == end[0] else 1
        segments[axis, int(start[axis])] = segment
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


def draw_workspace(axes: Axes, plan: Plan) -> None:
    """Draw what bounds the workspace into a plan view, and show what is no wider than it whole."""
    shown = np.array([axes.get_xlim(), axes.get_ylim()]).T
    span = (shown[1] - shown[0]).max()
    for name, lines in scene.workspace_lines(plan).items():
        strips = [strip[:, :2] for strip in lines]
        drawn = LineCollection(strips, colors=ALARM, linewidths=0.9, linestyles="--")
        axes.add_collection(drawn, autolim=False)
        low, high = np.vstack(strips).min(axis=0), np.vstack(strips).max(axis=0)
        if np.all(low >= shown[0] - span) and np.all(high <= shown[1] + span):
            bounds = np.array([axes.get_xlim(), axes.get_ylim()]).T
            low, high = (
                np.minimum(bounds[0], low - 0.06 * span),
                np.maximum(bounds[1], high + 0.06 * span),
            )
            axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
            place = np.vstack(strips).mean(axis=0)
            axes.text(*place, name, color=ALARM, fontsize=7, ha="center", va="center")


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

    :func:`label_fold` adds them, when the figure is complete.
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
            f"certified {certified(low)}, {together(tightest.between)}",
            (tightest.time, low),
            textcoords="offset points",
            xytext=(-8 if late else 8, 0),
            ha="right" if late else "left",
            va="center",
            fontsize=7.5,
        )
    axes.set(xlabel="mission time, s", ylabel="distance, m", title=title)
    axes.set_ylim(bottom=0.0)


def draw_errors(axes: Axes, plan: Plan, trace: Trace) -> None:
    """Draw every vehicle's tracking error over time, and what is allowed then, metres."""
    errors = np.linalg.norm(trace.position - trace.setpoint, axis=-1)
    for i, colour in enumerate(along_colours(errors.shape[1])):
        axes.plot(trace.time, errors[:, i], color=colour, linewidth=0.7)
    allowed = [scene.allowed_error(plan, time) for time in trace.mission_time.tolist()]
    axes.plot(trace.time, allowed, color=ALARM, linewidth=1.2, linestyle="--")
    _shade_phases(axes, trace)
    axes.set(xlabel="time, s", ylabel="error, m")
    axes.set_title(
        "Tracking error; dashed: certified while cable is off the floor, else allowed",
        pad=_ABOVE_PHASES,
    )
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
    draw_workspace(axes, plan)
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


def label_fold(axes: Axes, layout: KnotLayout, colour: str) -> None:
    """Write numbers and distances beside a fold in space (:func:`draw_fold`).

    To be called when nothing else of the figure changes: places are compared as they are printed. A
    label is written where it covers no other label and no vehicle. A distance without such a place
    is left out; smaller distances come first. Numbers are always written.
    """
    figure = axes.figure
    figure.draw_without_rendering()
    taken = [_around(_printed(axes, corner), axes) for corner in layout.corners]
    for number, corner in enumerate(layout.corners, 1):
        _write(axes, str(number), [corner], taken, {"color": colour, "zorder": 8})
    box = {"boxstyle": "round,pad=0.1", "facecolor": "white", "alpha": 0.85, "lw": 0}
    style = {"color": colour, "zorder": 9, "bbox": box}
    for crossing in sorted(scene.crossings(layout), key=lambda crossing: crossing.distance):
        places = [crossing.upper, 0.5 * (crossing.upper + crossing.lower), crossing.lower]
        _write(axes, f"{crossing.distance:.2f} m", places, taken, style, needed=False)


def _write(
    axes: Axes,
    words: str,
    places: Sequence[Floats],
    taken: list[Bbox],
    style: dict[str, Any],
    *,
    needed: bool = True,
) -> None:
    """Write a label beside the first of some places where it covers nothing ``taken``.

    Where there is none, the first place is taken for a label that is ``needed``.
    """
    text = axes.annotate(
        words,
        (0.0, 0.0),
        xytext=(0.0, 0.0),
        textcoords="offset points",
        fontsize=7,
        annotation_clip=False,
        **style,
    )
    text.set_in_layout(False)
    extent = text.get_window_extent(axes.figure.canvas.get_renderer())
    pixels = axes.figure.dpi / 72.0
    size = np.array([extent.width, extent.height]) + 2.0 * _PADDING * pixels
    aside = _ASIDE * pixels
    spot = None
    for place in places:
        for side in _SIDES:
            middle = _printed(axes, place) + np.array(side) * (aside + 0.5 * size)
            box = Bbox([middle - 0.5 * size, middle + 0.5 * size])
            if spot is None and not any(box.overlaps(other) for other in taken):
                spot = place, side, box
    if spot is None and not needed:
        text.remove()
        return
    place, side = spot[:2] if spot else (places[0], _SIDES[0])
    text.xy = _projected(axes, place)
    text.set_position((_ASIDE * side[0], _ASIDE * side[1]))
    text.set(ha="left" if side[0] > 0 else "right", va="bottom" if side[1] > 0 else "top")
    if spot:
        taken.append(spot[2])


def _printed(axes: Axes, place: Floats) -> Floats:
    """Return where a place (3,) is printed (2,), in pixels."""
    printed: Floats = axes.transData.transform(_projected(axes, place))
    return printed


def _projected(axes: Axes, place: Floats) -> Floats:
    """Return a place (3,) in the coordinates of the axes' plane (2,)."""
    x, y, _, scale = axes.get_proj() @ np.append(place, 1.0)
    projected: Floats = np.array([x, y]) / scale
    return projected


def _around(middle: Floats, axes: Axes) -> Bbox:
    """Return the box of a dot with a middle (2,) in pixels."""
    half = 0.5 * _ASIDE * axes.figure.dpi / 72.0
    return Bbox([middle - half, middle + half])


def draw_schedule(axes: Axes, plan: Plan) -> None:
    """Draw how far each vehicle still has to go during the fold."""
    fold = plan.phase("fold")
    times = np.linspace(fold.start, fold.end, 400)
    remaining = remaining_ways(plan, times)
    labels = spread_labels(remaining[0], LABEL_GAP * float(np.ptp(remaining)))
    for i, colour in enumerate(along_colours(plan.vehicles)):
        axes.plot(times, remaining[:, i], color=colour, linewidth=1.4)
        axes.text(
            times[0], labels[i], f"{i + 1} ", fontsize=7.5, ha="right", va="center", color=colour
        )
    axes.set(ylabel="way to its corner, m", title="How far each vehicle still has to go")


def remaining_ways(plan: Plan, times: Floats) -> Floats:
    """Return the lengths (k, n) of the ways that vehicles still go from mission times (k,) on to
    the last of these, metres."""
    step = np.linalg.norm(np.diff(plan.motion.at(times)[0], axis=0), axis=-1)
    return np.vstack([step[::-1].cumsum(axis=0)[::-1], np.zeros(plan.vehicles)])


def draw_heights(axes: Axes, plan: Plan) -> None:
    """Draw the heights of the grip points during the fold."""
    fold = plan.phase("fold")
    times = np.linspace(fold.start, fold.end, 400)
    height = plan.motion.at(times)[0][:, :, 2]
    shown = places_of_labels(times, height)
    for i, colour in enumerate(along_colours(plan.vehicles)):
        axes.plot(times, height[:, i], color=colour, linewidth=1.4)
        k = shown[i]
        axes.text(
            times[k], height[k, i], str(i + 1), fontsize=7.5, color=colour, weight="bold",
            ha="center", va="center", zorder=5,
            bbox={"boxstyle": "circle,pad=0.15", "facecolor": "white", "linewidth": 0},
        )  # fmt: skip
    axes.set(xlabel="mission time, s", ylabel="height, m", title="Heights of the grip points")


def spread_labels(values: Floats, gap: float) -> Floats:
    """Return places (n,) for labels at values (n,), at least ``gap`` apart, in the same order."""
    order = np.argsort(values, kind="stable")
    places = values[order].astype(np.float64)
    places = np.maximum.accumulate(places - gap * np.arange(len(places)))
    spread = np.empty_like(places)
    spread[order] = places + gap * np.arange(len(places))
    return spread


def places_of_labels(times: Floats, curves: Floats) -> list[int]:
    """Return for each curve (k, n) the index at which its label is farthest from all others.

    Distances to other curves and to earlier labels are in shares of the axes.
    """
    x = (times - times[0]) / max(float(np.ptp(times)), 1e-9)
    y = (curves - curves.min()) / max(float(np.ptp(curves)), 1e-9)
    chosen: list[int] = []
    for i in range(curves.shape[1]):
        apart = np.delete(np.abs(y - y[:, [i]]), i, axis=1).min(axis=1, initial=1.0)
        for other, k in enumerate(chosen):
            apart = np.minimum(apart, np.hypot(x - x[k], y[:, i] - y[k, other]))
        inside = (x > 0.02) & (x < 0.98)
        chosen.append(int(np.argmax(np.where(inside, apart, -1.0))))
    return chosen


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
