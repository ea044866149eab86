"""Curves and diagrams for tests, and oracles that share no code with swarm.knots."""

import json
from fractions import Fraction
from functools import lru_cache
from itertools import combinations, pairwise

import numpy as np
import pytest
from numpy.typing import NDArray

from swarm.knots.curve import curve_gauss
from swarm.knots.diagram import Diagram
from swarm.knots.gauss import SignedGauss
from swarm.knots.grid import OpenGrid

Points = NDArray[np.float64]


def random_polygon(seed: int, count: int) -> Points:
    """A closed polygon with random corners."""
    return np.random.default_rng(seed).normal(size=(count, 3))


def random_diagram(seed: int, count: int) -> Diagram:
    """The diagram of a random closed polygon."""
    return Diagram(curve_gauss(random_polygon(seed, count), closed=True))


def rotation(seed: int) -> Points:
    """A random rotation."""
    turn, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    return turn * np.sign(np.linalg.det(turn))


def hung(opened: OpenGrid, *, samples: int = 21, over: float = 0.5, under: float = -0.5) -> Points:
    """The cable of an opened grid: verticals bulge up to ``over``, horizontals to ``under``."""
    parts = []
    for start, end in pairwise(opened.corners):
        share = np.linspace(0, 1, samples, endpoint=False)[:, None]
        plan = (1 - share) * np.array(start) + share * np.array(end)
        height = (over if start[0] == end[0] else under) * (4 * share * (1 - share)) ** 0.25
        parts.append(np.hstack([plan, height]))
    last = np.array([[*opened.corners[-1], 0.0]])
    return np.concatenate([*parts, last])


def lifted(points: Points) -> Points:
    """An open curve closed over straight risers, as one closed polygon."""
    top = points[:, 2].max() + 5.0
    ends = points[[-1, 0]].copy()
    ends[:, 2] = top
    return np.concatenate([points, ends])


def exact_code(points: Points, *, closed: bool) -> SignedGauss:
    """The signed Gauss code in rational arithmetic, all pairs of segments: slow and exact."""
    exact = [[Fraction(float(x)) for x in point] for point in points]
    ends = list(pairwise([*exact, exact[0]] if closed else exact))
    passes = []
    for (i, (a, b)), (j, (c, d)) in combinations(enumerate(ends), 2):
        if j == i + 1 or (closed and i == 0 and j == len(ends) - 1):
            continue
        abx, aby, cdx, cdy = b[0] - a[0], b[1] - a[1], d[0] - c[0], d[1] - c[1]
        turn = abx * cdy - aby * cdx
        if turn == 0:
            continue
        s = ((c[0] - a[0]) * cdy - (c[1] - a[1]) * cdx) / turn
        t = ((c[0] - a[0]) * aby - (c[1] - a[1]) * abx) / turn
        if not (0 < s < 1 and 0 < t < 1):
            continue
        gap = (a[2] + s * (b[2] - a[2])) - (c[2] + t * (d[2] - c[2]))
        sign = (1 if turn > 0 else -1) * (1 if gap > 0 else -1)
        label = len(passes) // 2 + 1
        passes += [(i + s, label, gap > 0, sign), (j + t, label, gap < 0, sign)]
    return SignedGauss.of(((k, over, sign) for _, k, over, sign in sorted(passes)), closed=closed)


@lru_cache(maxsize=1)
def knotinfo() -> dict[str, dict[str, str]]:
    """KnotInfo's rows by name (the first thousand or so: all knots to eleven crossings)."""
    package = pytest.importorskip("database_knotinfo")
    rows = package.link_list()[1:1000]
    return {
        row["name"]: row
        for row in rows
        if row["crossing_number"].isdigit() and 0 < int(row["crossing_number"]) < 12
    }


def of_knotinfo(name: str, key: str) -> list[list[int]]:
    """A list in KnotInfo's table."""
    found: list[list[int]] = json.loads(knotinfo()[name][key])
    return found
