"""Grid diagrams (arc presentations): validity, crossings, symmetries, openings.

A grid diagram of size N has one vertical edge in each of N columns and one horizontal edge in each
of N rows; verticals pass over horizontals. Columns count from 1 at the left, rows from 1 at the
bottom.
"""

from collections import Counter
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from swarm.knots.gauss import KnotError, SignedGauss

Corner = tuple[int, int]


@dataclass(frozen=True)
class Grid:
    """A grid diagram of one knot: the (low, high) rows of each column's edge, left to right.

    Raises KnotError with every invalid column or row, or for a link.
    """

    columns: tuple[tuple[int, int], ...]

    def __post_init__(self) -> None:
        _check(self.columns)
        reached = len(self.corners)
        if reached != 2 * self.size:
            raise KnotError(
                f"the grid is that of a link: its first component has {reached} of its "
                f"{2 * self.size} corners; one cable has one component"
            )

    @property
    def size(self) -> int:
        """N, the number of columns and of rows."""
        return len(self.columns)

    @cached_property
    def rows(self) -> tuple[tuple[int, int], ...]:
        """The (left, right) columns of each row's edge, bottom to top."""
        ends: list[list[int]] = [[] for _ in self.columns]
        for column, pair in enumerate(self.columns, 1):
            for row in pair:
                ends[row - 1].append(column)
        return tuple((left, right) for left, right in ends)

    @cached_property
    def corners(self) -> tuple[Corner, ...]:
        """The corners (column, row) in order, from column 1's low end along its edge."""
        return _walk(self, 1)

    @cached_property
    def code(self) -> SignedGauss:
        """The signed Gauss code of the closed diagram, from column 1's low end on."""
        return _path_code(self.corners, closed=True)

    @property
    def crossings(self) -> int:
        """Number of crossings."""
        return self.code.crossings


@dataclass(frozen=True)
class OpenGrid:
    """A grid diagram opened at one corner whose two edges are free of crossings.

    ``corners`` are the other 2N − 1 corners (column, row) in order along the cable. ``crossings``
    are (over segment, under segment), where segment i joins corners i and i + 1, from 0.
    """

    grid: Grid
    removed: Corner
    corners: tuple[Corner, ...]
    crossings: tuple[tuple[int, int], ...]

    @property
    def code(self) -> SignedGauss:
        """The signed Gauss code from the first to the last corner."""
        return _path_code(self.corners, closed=False)

    @property
    def length(self) -> int:
        """Total length of the segments in plan, in cells."""
        pairs = zip(self.corners, self.corners[1:], strict=False)
        return sum(abs(a - c) + abs(b - d) for (a, b), (c, d) in pairs)


def _check(columns: tuple[tuple[int, int], ...]) -> None:
    size = len(columns)
    if size < 2:
        raise KnotError(f"a grid diagram has at least 2 columns, got {size}")
    wrong = [
        f"column {column}: expected rows (low, high) with 1 ≤ low < high ≤ {size}, got {pair}"
        for column, pair in enumerate(columns, 1)
        if len(pair) != 2 or not 1 <= pair[0] < pair[1] <= size
    ]
    if not wrong:
        ends = Counter(row for pair in columns for row in pair)
        wrong = [
            f"row {row}: expected the ends of 2 columns, got {ends[row]}"
            for row in range(1, size + 1)
            if ends[row] != 2
        ]
    if wrong:
        raise KnotError("; ".join(wrong))


def _walk(grid: Grid, column: int) -> tuple[Corner, ...]:
    """Return the corners from a column's low end, up its edge, back to the start."""
    corners: list[Corner] = []
    row = start = grid.columns[column - 1][0]
    first = column
    while True:
        corners.append((column, row))
        row = sum(grid.columns[column - 1]) - row
        corners.append((column, row))
        column = sum(grid.rows[row - 1]) - column
        if (column, row) == (first, start):
            return tuple(corners)


def _path_code(corners: tuple[Corner, ...], *, closed: bool) -> SignedGauss:
    """Return the signed Gauss code of a path of alternating vertical and horizontal edges."""
    passes = []
    for segment, place, over, other, sign in _passes(corners, closed=closed):
        vertical, horizontal = (segment, other) if over else (other, segment)
        passes.append((segment, place, (vertical, horizontal), over, sign))
    passes.sort(key=lambda item: item[:2])
    number = {pair: k for k, pair in enumerate(sorted({item[2] for item in passes}))}
    return SignedGauss.of(
        ((number[pair] + 1, over, sign) for _, _, pair, over, sign in passes), closed=closed
    )


def _passes(corners: tuple[Corner, ...], *, closed: bool) -> list[tuple[int, int, bool, int, int]]:
    """Return per pass: segment, distance along it, whether it passes over, other segment, sign."""
    ends = list(zip(corners, corners[1:] + corners[:1], strict=True))
    if not closed:
        ends.pop()
    vertical = [k for k, (a, b) in enumerate(ends) if a[0] == b[0]]
    horizontal = [k for k, (a, b) in enumerate(ends) if a[1] == b[1]]
    passes = []
    for v in vertical:
        (column, r0), (_, r1) = ends[v]
        for h in horizontal:
            (c0, row), (c1, _) = ends[h]
            if min(r0, r1) < row < max(r0, r1) and min(c0, c1) < column < max(c0, c1):
                # over × under = vertical × horizontal: up × right points down.
                sign = -1 if (r1 > r0) == (c1 > c0) else 1
                passes.append((v, abs(row - r0), True, h, sign))
                passes.append((h, abs(column - c0), False, v, sign))
    return passes


def grid_of_columns(columns: object) -> Grid:
    """Return the grid of nested lists of row pairs, in either order, as in a mission file."""
    if not isinstance(columns, list | tuple):
        raise KnotError(f"a grid is a list of row pairs, one per column, got {columns!r}")
    pairs = []
    for number, pair in enumerate(columns, 1):
        if (
            not isinstance(pair, list | tuple)
            or len(pair) != 2
            or not all(isinstance(row, int) and not isinstance(row, bool) for row in pair)
        ):
            raise KnotError(f"column {number}: expected a pair of row numbers, got {pair!r}")
        pairs.append((min(pair), max(pair)))
    return Grid(tuple(pairs))


def mirrored(grid: Grid) -> Grid:
    """Return the mirror image: columns from right to left, verticals still over."""
    return Grid(grid.columns[::-1])


def transposed(grid: Grid) -> Grid:
    """Return the grid of the same knot with rows and columns exchanged.

    Reflecting in the diagonal mirrors the knot; exchanging over and under mirrors it back.
    """
    return Grid(grid.rows)


def translated(grid: Grid, columns: int, rows: int) -> Grid:
    """Return the grid shifted to the right and up on the torus (a move of Cromwell's)."""
    size = grid.size
    start = -columns % size
    shifted = grid.columns[start:] + grid.columns[:start]
    return Grid(tuple(_pair(*((row - 1 + rows) % size + 1 for row in pair)) for pair in shifted))


def _pair(first: int, second: int) -> tuple[int, int]:
    return (first, second) if first < second else (second, first)


def openings(grid: Grid, *, limit: int | None = None) -> tuple[OpenGrid, ...]:
    """Return all openings of a grid diagram for a cable, best first, at most ``limit``.

    An opening removes one of the 2N corners whose two edges have no crossings, after any
    translation on the torus and a reflection in the diagonal (both preserve the knot), and walks
    the rest in either direction. Order: fewest crossings, then least total edge length, then a
    fixed order.
    """
    bases = (grid, transposed(grid))
    corners = np.concatenate([_free_corners(base, flip) for flip, base in enumerate(bases)])
    result: dict[tuple[Corner, ...], OpenGrid] = {}
    for _, _, right, up, column, row, flip in corners[np.lexsort(corners.T[::-1])].tolist():
        if limit is not None and len(result) >= limit:
            break
        for opened in _opened(translated(bases[flip], right, up), (column, row)):
            result.setdefault(opened.corners, opened)
    return tuple(result.values())[:limit]


@lru_cache(maxsize=16)  # the same grid is scored again where a search finds no other
def best_opening(grid: Grid) -> tuple[int, int] | None:
    """Return crossings and total edge length of the best opening; None without an opening."""
    corners = _free_corners(grid, 0)
    return (
        min((crossings, length) for crossings, length in corners[:, :2].tolist())
        if len(corners)
        else None
    )


def _free_corners(grid: Grid, flip: int) -> NDArray[np.int64]:
    """Return the corners with crossing-free edges, after every translation.

    Rows of (crossings, length of the other edges, translation in columns and rows, column and row
    of the corner, ``flip``).
    """
    size = grid.size
    columns, rows = np.array(grid.columns) - 1, np.array(grid.rows) - 1
    right, up = (part.ravel() for part in np.indices((size, size)))
    # Ends of every edge after every translation, (translations, edges, 2), edges as they were.
    column_ends = np.sort((columns[None] + up[:, None, None]) % size, axis=2)
    row_ends = np.sort((rows[None] + right[:, None, None]) % size, axis=2)
    column_at = (np.arange(size)[None] + right[:, None]) % size
    row_at = (np.arange(size)[None] + up[:, None]) % size
    crossed = (
        (column_ends[:, :, None, 0] < row_at[:, None, :])
        & (row_at[:, None, :] < column_ends[:, :, None, 1])
        & (row_ends[:, None, :, 0] < column_at[:, :, None])
        & (column_at[:, :, None] < row_ends[:, None, :, 1])
    )
    tall, wide = column_ends[:, :, 1] - column_ends[:, :, 0], row_ends[:, :, 1] - row_ends[:, :, 0]
    column, row = np.repeat(np.arange(size), 2), columns.ravel()
    on_column, on_row = np.any(crossed, axis=2), np.any(crossed, axis=1)
    moved, corner = np.nonzero(~(on_column[:, column] | on_row[:, row]))
    column, row = column[corner], row[corner]
    total = crossed.sum(axis=(1, 2))[moved]
    length = (tall.sum(axis=1) + wide.sum(axis=1))[moved] - tall[moved, column] - wide[moved, row]
    place = column_at[moved, column] + 1, row_at[moved, row] + 1
    return np.stack(
        [total, length, right[moved], up[moved], *place, np.full(len(moved), flip)], axis=1
    )


def _opened(grid: Grid, corner: Corner) -> list[OpenGrid]:
    """Return the openings at one corner, in both directions."""
    at = grid.corners.index(corner)
    path = grid.corners[at + 1 :] + grid.corners[:at]
    return [
        OpenGrid(
            grid,
            corner,
            way,
            tuple(
                sorted(
                    (segment, other)
                    for segment, _, over, other, _ in _passes(way, closed=False)
                    if over
                )
            ),
        )
        for way in (path, path[::-1])
    ]
