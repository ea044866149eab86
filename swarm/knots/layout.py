"""Grid diagrams that a cable would rather have: few crossings, short edges, same size."""

from itertools import islice

from swarm.knots.grid import Grid, OpenGrid, openings
from swarm.knots.search import rearranged


def best_opening(grid: Grid) -> OpenGrid | None:
    """The first of a grid's openings; None where every corner's edges have crossings."""
    found = openings(grid, limit=1)
    return found[0] if found else None


def compact(grid: Grid, *, tries: int, seed: int = 1) -> Grid:
    """Among grids of the same size and knot, one whose best opening is best.

    Looks at ``tries`` grids along a walk of commutations.
    """
    best = grid
    score = _score(grid)
    for other in islice(rearranged(grid, seed=seed), tries):
        value = _score(other)
        if value < score:
            best, score = other, value
    return best


def _score(grid: Grid) -> tuple[int, int]:
    opened = best_opening(grid)
    if opened is None:
        return (grid.size**2, 0)
    return (len(opened.crossings), opened.length)
