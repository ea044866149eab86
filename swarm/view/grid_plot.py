"""Pictures of a knot's grid diagram: in the terminal, and as PNG."""

from pathlib import Path
from typing import Final

import matplotlib as mpl
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from rich.text import Text

from swarm.knots.catalog import KnotChoice
from swarm.knots.grid import Corner, Grid, OpenGrid
from swarm.view.plots import END, FAINT, GAP, INK, START, STYLE, Axes, along_colours, save

_BENDS: Final = {
    (True, True): "└",
    (True, False): "┘",
    (False, True): "┌",
    (False, False): "┐",
}
"""By (edge goes up, edge goes right)."""

_WIDTH: Final = 3
"""Characters per column: cells come out about square."""


def grid_text(opened: OpenGrid) -> Text:
    """The opened grid diagram in box characters; the two edges taken out are dotted."""
    grid = opened.grid
    text = Text()
    for row in range(grid.size, 0, -1):
        text.append(f"{row:3d}  ", "dim")
        for column in range(1, grid.size + 1):
            for letter, style in _cell(opened, column, row):
                text.append(letter, style)
        text.append("\n")
    numbers = "".join(f"{column:<{_WIDTH}d}" for column in range(1, grid.size + 1))
    text.append("     " + numbers.rstrip(), "dim")
    return text


def _cell(opened: OpenGrid, column: int, row: int) -> list[tuple[str, str]]:
    """A cell's own character, and the filling towards the next column."""
    grid = opened.grid
    (low, high), (left, right) = grid.columns[column - 1], grid.rows[row - 1]
    gone_column, gone_row = opened.removed
    ghost = "dim"
    row_style = ghost if row == gone_row else ""
    column_style = ghost if column == gone_column else ""
    filling = " " * (_WIDTH - 1)
    if left <= column < right:
        filling = ("┄" if row == gone_row else "─") * (_WIDTH - 1)
    if row in (low, high):
        bend = _BENDS[row == low, column == left]
        if (column, row) == opened.removed:
            return [("×", ghost), (filling, row_style)]
        end = (column, row) in (opened.corners[0], opened.corners[-1])
        return [("●" if end else bend, "bold" if end else ""), (filling, row_style)]
    if low < row < high:
        return [("┆" if column == gone_column else "│", column_style), (filling, row_style)]
    if left < column < right:
        return [("┄" if row == gone_row else "─", row_style), (filling, row_style)]
    return [(" ", ""), (filling, row_style)]


def plot_grid(choice: KnotChoice, path: Path) -> None:
    """Write a PNG with a knot's grid diagram, and with the cable in it and who holds it where."""
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
    """A vertical edge with a white rim where it passes over."""
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
