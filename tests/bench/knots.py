"""How fast knots are drawn as minimal grids, and curves named: ``python tests/bench/knots.py``.

Grids are searched from the Gauss code, without the catalogue's. The search is told nothing: where
the arc index is not known beforehand (knots that do not alternate), it uses up all its moves.
"""

from itertools import pairwise
from statistics import median
from time import perf_counter

import numpy as np

from swarm.knots.catalog import lookup_knot
from swarm.knots.diagram import diagrams_of_gauss
from swarm.knots.grid import openings
from swarm.knots.grid_search import grid_of_diagram, minimise_grid
from swarm.knots.invariants import identify_curve
from swarm.knots.table import TableKnot, knot_table


def best_of(times: int, work: object, *arguments: object, **options: object) -> float:
    """Shortest time of several runs, in seconds."""
    found = []
    for _ in range(times):
        start = perf_counter()
        work(*arguments, **options)  # type: ignore[operator]
        found.append(perf_counter() - start)
    return min(found)


def searched(gauss: str, target: int) -> int:
    """Size of the grid that the search finds from a Gauss code."""
    return minimise_grid(grid_of_diagram(diagrams_of_gauss(gauss)[0]), target=target).size


def search_time(knot: TableKnot, times: int = 1) -> tuple[float, float]:
    """Seconds to search a grid as the planner does, and to meet the minimal one."""
    gauss = knot.diagram.code.text()
    target = knot.crossings + 2 if knot.diagram.alternating else 2
    size = searched(gauss, target)
    if size != knot.arc_index:
        print(f"{knot.name}: N = {size}, arc index {knot.arc_index}")
    return (
        best_of(times, searched, gauss, target),
        best_of(times, searched, gauss, knot.arc_index),
    )


def hung(name: str, count: int) -> np.ndarray:
    """About so many points of the cable in a knot's best opening."""
    corners = np.array(openings(lookup_knot(name).grid, limit=1)[0].corners, dtype=float)
    share = np.linspace(0, 1, count // (len(corners) - 1), endpoint=False)[:, None]
    parts = []
    for start, end in pairwise(corners):
        rise = (0.5 if start[0] == end[0] else -0.5) * (4 * share * (1 - share)) ** 0.25
        parts.append(np.hstack([(1 - share) * start + share * end, rise]))
    return np.concatenate(parts)


def main() -> None:
    """Print the figures beside what they must reach."""
    for name, limit in (("3_1", 0.1), ("8_18", 0.3)):
        whole, _ = search_time(knot_table()[name], times=5)
        print(f"Gauss → minimal grid  {name:9}{whole * 1e3:9.1f} ms   (limit {limit * 1e3:.0f} ms)")
    ten = {knot.name: search_time(knot) for knot in knot_table().values() if knot.crossings == 10}
    worst = max(ten, key=lambda name: ten[name][0])
    print(f"  ten crossings, worst {worst:9}{ten[worst][0] * 1e3:8.1f} ms   (limit 3000 ms)")
    print(f"  ten crossings, median         {median(t for t, _ in ten.values()) * 1e3:8.1f} ms")
    late = max(ten, key=lambda name: ten[name][1])
    print(f"  until N is met, worst {late:8}{ten[late][1] * 1e3:8.1f} ms")
    identify_curve(hung("3_1", 100))
    for name in ("3_1", "8_18", "10_45", "10_123", "10_132", "10_104"):
        points = hung(name, 2000)
        known = identify_curve(points)
        assert known.name == name, known
        taken = best_of(7, identify_curve, points)
        print(
            f"name a knot from {len(points)} points  {name:7}{taken * 1e3:7.1f} ms   (limit 50 ms)"
        )
    walk = np.random.default_rng(1).normal(size=(2000, 3)).cumsum(axis=0)
    taken = best_of(3, identify_curve, walk)
    print(f"  a random walk of 2000 steps   {taken * 1e3:8.1f} ms   ({identify_curve(walk)})")


if __name__ == "__main__":
    main()
