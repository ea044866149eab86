"""Missed margins between strands that share no vehicle; compiled.

Functions named ``penalize_…`` add to a :class:`swarm.folding.margins.Penalty` of s moments: to
``missed`` the squares of missed margins in units of a margin, to ``gradient`` half the derivative.
Strands are :class:`swarm.folding.outlines.Outlines` (s, n − 1).
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from swarm.folding.end_sensitivity import (
    PIECES,
    add_to_ends,
    max_point_movement,
    point_movement,
    sag_response,
)
from swarm.folding.margins import Margins, Penalty
from swarm.folding.outlines import (
    OutlineRow,
    Outlines,
    crossing_height,
    direction_between,
    plan_crossing,
)
from swarm.geometry.distance import boxes_closer, polyline_distance
from swarm.jit import compiled
from swarm.signatures import Floats1, Signs2

Floats = npt.NDArray[np.float64]

PREFERRED = 0.25
"""Share of a margin's unit that the optimizer keeps beyond the margin: it stops short of a
bound."""


class _Pair(NamedTuple):
    """Segments ``first`` and ``second``, and the sign and the metres that their margin adds.

    ``sign`` is 1 where the first must pass over the second, −1 under, 0 where free. Beyond
    ``limit`` metres the pair misses no margin.
    """

    first: int
    second: int
    sign: int
    extra: float
    limit: float


@compiled
def penalize_strands(
    strands: Outlines,
    signs: Signs2,
    extra: Floats1,
    margins: Margins,
    penalty: Penalty,
) -> None:
    """Add the missed margins of strands that share no vehicle.

    ``signs`` (s, pairs) are as in :class:`swarm.folding.crossing_constraints.CrossingSigns`;
    ``extra`` (s,) is required beyond the margin, in metres.
    """
    points, ratio = strands.points, strands.ratio
    count = ratio.shape[1]
    wanted = margins.cable + PREFERRED * (margins.cable + 2.0 * margins.tracking)
    response, error = np.empty(count), np.empty(count)
    for s in range(len(points)):
        for i in range(count):
            response[i] = sag_response(ratio[s, i])
            error[i] = margins.tracking * max_point_movement(response[i])
        boxes, number = strands.boxes[s], -1
        team, gradient = points[s], penalty.gradient[s]
        for i in range(count):
            for j in range(i + 2, count):
                number += 1
                limit = wanted + extra[s] + error[i] + error[j]
                if boxes_closer(boxes, i, boxes, j, limit):
                    pair = _Pair(i, j, signs[s, number], extra[s], limit)
                    penalty.missed[s] += _penalize_pair(team, response, pair, margins, gradient)


@compiled
def _penalize_pair(
    points: Floats, response: Floats, pair: _Pair, margins: Margins, gradient: Floats
) -> float:
    """Return the square of the missed margin of two strands; add to the gradient (n, 3)."""
    i, j = pair.first, pair.second
    one, other = points[i], points[j]
    unit = margins.cable + 2.0 * margins.tracking
    push = np.zeros(3)
    beyond = -pair.sign * crossing_height(one, other) if pair.sign else 0.0
    if beyond > 0.0:
        # The wrong strand is over: loops come out of others upward and downward, not through them.
        here, there = plan_crossing(one, other)
        distance, push[2], upright = -beyond, pair.sign, 1.0
    else:
        distance, here, there = polyline_distance(one, other, pair.limit)
        if distance >= pair.limit:
            return 0.0
        upright = direction_between(one, here, other, there, distance, push)
        here, there = here / PIECES, there / PIECES
    error = point_movement(response[i], here, upright) + point_movement(response[j], there, upright)
    short = PREFERRED - (distance - margins.cable - pair.extra - margins.tracking * error) / unit
    if short <= 0.0:
        return 0.0
    push *= -short / unit
    add_to_ends(gradient, i, here, response[i], one, push)
    push *= -1.0
    add_to_ends(gradient, j, there, response[j], other, push)
    return float(short * short)


@compiled
def spare_margins(one: OutlineRow, other: OutlineRow, margins: Margins, found: Floats1) -> None:
    """Write by how much strands (q,) keep more than their margin from others, pair by pair.

    They share no vehicle; metres, negative where the margin is missed.
    """
    push = np.empty(3)
    for q in range(len(one.points)):
        points, other_points = one.points[q], other.points[q]
        response, other_response = sag_response(one.ratio[q]), sag_response(other.ratio[q])
        distance, here, there = polyline_distance(points, other_points, np.inf)
        upright = direction_between(points, here, other_points, there, distance, push)
        error = point_movement(response, here / PIECES, upright)
        error += point_movement(other_response, there / PIECES, upright)
        found[q] = distance - margins.cable - margins.tracking * error
