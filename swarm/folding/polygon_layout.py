"""A layout in metres from an open polygon in space: heights, sags and lengths of its segments.

In plan view the polygon is the layout. Where two edges cross, the higher one must stay the higher
one. Strands hang almost as parabolas, so that the least sags and heights that keep a gap at all
crossings are a linear program. Then vehicles move until the team keeps its margins at rest.
"""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import scipy

from swarm.folding.crossing_constraints import free_signs
from swarm.folding.layout import KnotLayout
from swarm.folding.margins import Margins
from swarm.folding.penalty import KEPT, TeamGeometry
from swarm.geometry.catenary import solve_catenaries
from swarm.geometry.chain import crossing_gaps, plan_crossings, segment_lengths

Floats = npt.NDArray[np.float64]

_SAG = 0.17
"""Least sag of a segment over its span: a chord of 0.93 lengths, well below the largest one."""

_STEEP = 0.45
"""Largest difference of heights of two neighbours over the span between them (24°): steeper strands
reach into the rotor discs when they are slack."""

_UNEVEN = 0.5
"""Cost of a metre of height at a vehicle, over that of a metre of sag."""

_GAP, _GAP_ERRORS = 2.1, 6.0
"""Height between strands at a crossing, in cable margins and tracking errors: 0.95 m with the
defaults; the pentagram's overhand keeps all margins from there."""

_SPANS = (5.5, 6.5, 7.5, 9.0, 11.0)
"""Mean spans that are tried in distances that vehicles keep, the shortest first."""

_STAY = 1e-4
"""Cost of a metre by which a vehicle moves in plan view and height, squared."""

_STEPS = 200
"""Iterations of the quasi-Newton method."""


def lay_out_polygon(polygon: Floats, margins: Margins) -> KnotLayout | None:
    """Return the smallest layout of an open polygon (n, 3) that keeps the margins at rest.

    The unit of the polygon is arbitrary; its heights decide which edge passes over. The first edge
    of the layout is at the origin. None where no size keeps the margins.
    """
    pairs, shares = _over_under(polygon)
    return _smallest(polygon[:, :2], pairs, shares, margins)


def lay_out_star(vertices: int, order: Sequence[int], margins: Margins) -> KnotLayout | None:
    """Return the smallest layout of a star polygon without its last edge, or None.

    Its vertices are evenly spaced on a circle, and its edges lead almost through the centre.
    ``order`` are its edges, the highest first; an edge passes over the lower ones.
    """
    turn = 2.0 * np.pi * (vertices // 2) / vertices
    angles = turn * np.arange(vertices)
    flat = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    crossings = plan_crossings(flat)
    level = np.argsort(np.asarray(order))
    swap = level[crossings.segments[:, 0]] > level[crossings.segments[:, 1]]
    pairs = np.where(swap[:, None], crossings.segments[:, ::-1], crossings.segments)
    shares = np.where(swap[:, None], crossings.fractions[:, ::-1], crossings.fractions)
    return _smallest(flat, pairs, shares, margins)


def _smallest(
    flat: Floats, pairs: npt.NDArray[np.intp], shares: Floats, margins: Margins
) -> KnotLayout | None:
    """Return the smallest layout of a plan view (n, 2) with its crossings (c, 2), over first."""
    flat = flat - flat[0]
    mean = float(np.linalg.norm(np.diff(flat, axis=0), axis=1).mean())
    apart = margins.vehicle + 2.0 * margins.tracking
    gap = _GAP * margins.cable + _GAP_ERRORS * margins.tracking
    for span in _SPANS:
        plan = flat * (span * apart / mean)
        levels = _levels(plan, pairs, shares, gap)
        if levels is None:
            return None
        heights, sags = levels
        placed = np.concatenate([plan, heights[:, None]], axis=1)
        lengths = segment_lengths(placed, sags)
        corners = _apart(placed, TeamGeometry(lengths, margins))
        if corners is None:
            continue
        met = plan_crossings(corners).segments
        if {frozenset(pair) for pair in met.tolist()} != {frozenset(p) for p in pairs.tolist()}:
            continue
        if len(pairs) and crossing_gaps(corners, lengths, pairs).min() <= 0.0:
            continue
        corners -= [*corners[0, :2], 0.0]
        return KnotLayout(
            corners=corners,
            sags=solve_catenaries(corners[:-1], corners[1:], lengths).sag(),
            lengths=lengths,
            lanes=np.zeros(len(lengths)),
            crossings=tuple((int(a), int(b)) for a, b in pairs),
            cell=0.0,
        )
    return None


def _over_under(polygon: Floats) -> tuple[npt.NDArray[np.intp], Floats]:
    """Return the crossings (c, 2) of edges in plan view, over first, and their shares (c, 2)."""
    crossings = plan_crossings(polygon)
    shares = crossings.fractions
    at, rise = polygon[:-1, 2], np.diff(polygon[:, 2])
    heights = at[crossings.segments] + shares * rise[crossings.segments]
    swap = heights[:, 0] < heights[:, 1]
    pairs = np.where(swap[:, None], crossings.segments[:, ::-1], crossings.segments)
    return pairs, np.where(swap[:, None], shares[:, ::-1], shares)


def _levels(
    plan: Floats, pairs: npt.NDArray[np.intp], shares: Floats, gap: float
) -> tuple[Floats, Floats] | None:
    """Return heights (n,) and sags (n − 1,), metres; None where no ones keep the gap.

    Variables of the program are heights, sags, and the sizes of heights.
    """
    count, edges = len(plan), len(plan) - 1
    spans = np.linalg.norm(np.diff(plan, axis=0), axis=1)
    crossed = np.zeros((len(pairs), 2 * count + edges))
    for row, (segments, places) in enumerate(zip(pairs, shares, strict=True)):
        for sign, k, share in zip((-1.0, 1.0), segments, places, strict=True):
            crossed[row, k] += sign * (1.0 - share)
            crossed[row, k + 1] += sign * share
            crossed[row, count + k] -= sign * 4.0 * share * (1.0 - share)
    rises = np.zeros((edges, 2 * count + edges))
    rises[:, :count] = np.diff(np.eye(count), axis=0)
    sizes = np.zeros((count, 2 * count + edges))
    sizes[:, :count] = np.eye(count)
    above = np.zeros_like(sizes)
    above[:, count + edges :] = np.eye(count)
    limits = np.concatenate([crossed, rises, -rises, sizes - above, -sizes - above])
    bounds = [np.full(len(pairs), -gap), _STEEP * spans, _STEEP * spans, np.zeros(2 * count)]
    solved = scipy.optimize.linprog(
        np.concatenate([np.zeros(count), np.ones(edges), np.full(count, _UNEVEN)]),
        A_ub=limits,
        b_ub=np.concatenate(bounds),
        bounds=[(None, None)] * count
        + [(_SAG * span, None) for span in spans]
        + [(0, None)] * count,
    )
    if not solved.success:
        return None
    solution: Floats = np.asarray(solved.x)
    return solution[:count], solution[count : count + edges]


def _apart(placed: Floats, team: TeamGeometry) -> Floats | None:
    """Return positions (n, 3) near the given ones at which a team keeps its margins, or None."""
    signs = free_signs(1, len(team.lengths))
    start = placed.ravel()

    def cost(flat: Floats) -> tuple[float, Floats]:
        penalty = team.penalty(flat.reshape(1, -1, 3), signs)
        moved = flat - start
        total = float(penalty.missed[0] + _STAY * (moved**2).sum())
        return total, 2.0 * (penalty.gradient.ravel() + _STAY * moved)

    minimum = scipy.optimize.minimize(
        cost, start, jac=True, method="L-BFGS-B", options={"maxiter": _STEPS}
    )
    positions: Floats = np.ascontiguousarray(minimum.x.reshape(-1, 3))
    return positions if team.penalty(positions[None], signs).missed[0] <= KEPT else None
