"""A knot's grid diagram as PNG."""

from pathlib import Path

import matplotlib as mpl
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from swarm.knots.catalog import KnotChoice
from swarm.knots.grid import Corner, Grid, OpenGrid
from swarm.reports.plots import END, FAINT, GAP, INK, START, STYLE, Axes, along_colours, save


def plot_grid(choice: KnotChoice, path: Path) -> None:
    """Write a PNG with a knot's grid diagram, and with the cable and its vehicles in it."""
    save(grid_figure(choice), path)


def grid_figure(choice: KnotChoice) -> Figure:
    """Return the figure of :func:`plot_grid`."""
    opened = choice.opening
    with mpl.rc_context(STYLE):
        side = max(3.2, 0.42 * choice.grid.size)
        figure = Figure(figsize=(2 * side, side + 0.5), layout="constrained")
        FigureCanvasAgg(figure)
        left, right = figure.subplots(1, 2)
        _draw_closed(left, opened.grid)
        left.set_title(f"grid diagram, {choice.grid.size} × {choice.grid.size}")
        _draw_cable(right, opened)
        right.set_title(f"opened: {choice.vehicles} vehicles, {len(opened.crossings)} crossings")
        hand = "" if choice.chirality == "none" else f", {choice.chirality}-handed"
        figure.suptitle(f"knot {choice.title or choice.name}{hand}")
        return figure


def _frame(axes: Axes, size: int) -> None:
    axes.set_aspect("equal")
    axes.set_xlim(0.4, size + 0.6)
    axes.set_ylim(0.4, size + 0.6)
    axes.set_xticks(range(1, size + 1))
    axes.set_yticks(range(1, size + 1))
    axes.tick_params(length=0, colors=INK)
    axes.grid(color=FAINT, linewidth=0.4)
    axes.set_axisbelow(True)


def _draw_closed(axes: Axes, grid: Grid) -> None:
    _frame(axes, grid.size)
    for row, (left, right) in enumerate(grid.rows, 1):
        axes.plot([left, right], [row, row], color=INK, linewidth=1.6, zorder=2)
    for column, (low, high) in enumerate(grid.columns, 1):
        _over(axes, column, (low, high), grid, INK)
    for column, row in grid.corners:
        axes.plot(column, row, "s", color=INK, markersize=3.5, zorder=5)


def _over(axes: Axes, column: int, ends: Corner, grid: Grid, colour: object) -> None:
    """Draw a vertical edge with a white rim where it passes over."""
    low, high = min(ends), max(ends)
    for row in range(low + 1, high):
        left, right = grid.rows[row - 1]
        if left < column < right:
            rim = [row - GAP, row + GAP]
            axes.plot([column, column], rim, color="white", linewidth=6, zorder=3)
    axes.plot([column, column], [low, high], color=colour, linewidth=1.6, zorder=4)


def _draw_cable(axes: Axes, opened: OpenGrid) -> None:
    _frame(axes, opened.grid.size)
    pairs = list(zip(opened.corners[:-1], opened.corners[1:], strict=True))
    colours = along_colours(len(pairs))
    for (start, end), colour in zip(pairs, colours, strict=True):
        if start[1] == end[1]:
            axes.plot([start[0], end[0]], [start[1], end[1]], color=colour, linewidth=2.0, zorder=2)
        else:
            _over(axes, start[0], (start[1], end[1]), opened.grid, colour)
    column, row = opened.removed
    axes.plot(column, row, "x", color=FAINT, markersize=7, zorder=5)
    for number, (column, row) in enumerate(opened.corners, 1):
        colour = {1: START, len(opened.corners): END}.get(number, INK)
        axes.plot(column, row, "o", color=colour, markersize=4, zorder=5)
        axes.annotate(
            str(number),
            (column, row),
            xytext=(3, 3),
            textcoords="offset points",
            fontsize=7,
            color=INK,
            zorder=6,
        )
