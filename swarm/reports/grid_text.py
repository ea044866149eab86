"""A knot's opened grid diagram in the terminal."""

from typing import Final

from rich.text import Text

from swarm.knots.grid import OpenGrid

_BENDS: Final = {
    (True, True): "└",
    (True, False): "┘",
    (False, True): "┌",
    (False, False): "┐",
}
"""By (edge goes up, edge goes right)."""

_WIDTH: Final = 3
"""Characters per column, so that cells are about square."""


def grid_text(opened: OpenGrid) -> Text:
    """Return the opened grid diagram in box characters; the two removed edges are dotted."""
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
    """Return a cell's character, and the filling towards the next column, with their styles."""
    grid = opened.grid
    (low, high), (left, right) = grid.columns[column - 1], grid.rows[row - 1]
    removed_column, removed_row = opened.removed
    ghost = "dim"
    row_style = ghost if row == removed_row else ""
    column_style = ghost if column == removed_column else ""
    filling = " " * (_WIDTH - 1)
    if left <= column < right:
        filling = ("┄" if row == removed_row else "─") * (_WIDTH - 1)
    if row in (low, high):
        bend = _BENDS[row == low, column == left]
        if (column, row) == opened.removed:
            return [("×", ghost), (filling, row_style)]
        end = (column, row) in (opened.corners[0], opened.corners[-1])
        return [("●" if end else bend, "bold" if end else ""), (filling, row_style)]
    if low < row < high:
        return [("┆" if column == removed_column else "│", column_style), (filling, row_style)]
    if left < column < right:
        return [("┄" if row == removed_row else "─", row_style), (filling, row_style)]
    return [(" ", ""), (filling, row_style)]
