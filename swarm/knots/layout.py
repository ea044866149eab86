"""Grid diagrams that a cable would rather have: few crossings, short edges, same size."""

from itertools import islice

from swarm.knots.grid import Grid, least_opening
from swarm.knots.search import rearranged


def compact(grid: Grid, *, tries: int, seed: int = 1) -> Grid:
    """Among grids of the same size and knot, one whose best opening is best.

    Looks at ``tries`` grids along a walk of commutations, half of them near the best one so far.
    """
    best, score = grid, _score(grid)
    for apart in (30, 4):
        for other in islice(rearranged(best, seed=seed, apart=apart), tries // 2):
            value = _score(other)
            if value < score:
                best, score = other, value
    return best


def _score(grid: Grid) -> tuple[int, int]:
    return least_opening(grid) or (grid.size**2, 0)
