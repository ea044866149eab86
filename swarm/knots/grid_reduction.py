"""Reduction of grid diagrams to small size, few crossings and short edges."""

import math
from random import Random

from swarm.knots.grid import Grid, best_opening
from swarm.knots.grid_search import MOVES, GridWalk, minimise_grid

_HOT, _COLD = 1.5, 0.2
"""Temperatures of the annealing, in crossings."""


def smallest_grid(
    grid: Grid,
    *,
    target: int = 2,
    starts: int = 4,
    steps: int = 300,
    moves: int = MOVES,
    fewest: int | None = None,
) -> Grid:
    """Return the smallest grid diagram of the same knot that is found, with a good opening.

    Commutations do not connect all grids of one size, so several searches with different seeds lead
    to ``starts`` grids. Each is annealed for ``steps``; the result is the best of them. With
    ``fewest`` crossings, up to four times as many are searched until that number is reached.
    """
    first = minimise_grid(grid, target=target, moves=moves)
    best = anneal(first, steps=steps)
    for seed in range(2, 4 * starts + 1):
        if seed > starts and (fewest is None or _score(best) < fewest + 1):
            break
        other = minimise_grid(grid, target=first.size, moves=moves, seed=seed)
        if other.size == first.size:
            best = min(best, anneal(other, steps=steps, seed=seed), key=_score)
    return best


def anneal(grid: Grid, *, steps: int, seed: int = 1) -> Grid:
    """Return a grid, connected by commutations, with a good best opening, by annealing.

    Good means fewest crossings, then least total edge length.
    """
    walk = GridWalk(grid, seed)
    chance = Random(seed).random
    best, best_score = grid, _score(grid)
    score = best_score
    for step in range(steps):
        temperature = _HOT * (_COLD / _HOT) ** (step / steps)
        before = walk.state()
        if not walk.commute():
            continue
        other = walk.grid()
        value = _score(other)
        if value > score and chance() >= math.exp((score - value) / temperature):
            walk.restore(before)
            continue
        score = value
        if value < best_score:
            best, best_score = other, value
    return best


def _score(grid: Grid) -> float:
    """Return the crossings of the best opening plus its scaled length, which is less than 1."""
    found = best_opening(grid)
    if found is None:
        return float(grid.size**2)
    crossings, length = found
    return crossings + length / (2 * grid.size**2)
