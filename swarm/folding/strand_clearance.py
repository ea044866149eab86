"""Missed margins between strands that share no vehicle; compiled.

Functions named ``penalize_…`` add to a :class:`swarm.folding.margins.Penalty` of s moments: to
``missed`` the squares of missed margins in units of a margin, to ``gradient`` half the derivative.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from swarm.folding.end_response import add_to_ends, arc_fraction, point_movement
from swarm.folding.margins import Margins, Penalty, PenaltyModel, Team
from swarm.folding.outlines import (
    PIECES,
    OutlineRow,
    crossing_height,
    direction_between,
    plan_crossing,
)
from swarm.geometry.distance import boxes_closer, polyline_distance, times
from swarm.geometry.sensitivity import BOTH_ENDS, error_of_ends
from swarm.jit import compiled, inner
from swarm.signatures import Floats1, Signs2

Floats = npt.NDArray[np.float64]

PREFERRED = 0.25
"""Share of a margin's unit that the optimizer keeps beyond the margin: it stops short of a
bound."""


class StrandPair(NamedTuple):
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
    team: Team, signs: Signs2, extra: Floats1, model: PenaltyModel, penalty: Penalty
) -> None:
    """Add the missed margins of strands that share no vehicle.

    ``signs`` (s, pairs) are as in :class:`swarm.folding.crossing_constraints.CrossingSigns`;
    ``extra`` (s,) is required beyond the margin, in metres.
    """
    margins, count = model.margins, team.points.shape[1]
    wanted = preferred_distance(margins)
    for s in range(len(team.points)):
        boxes, number = team.boxes[s], -1
        points, shapes, response = team.points[s], team.shapes[s], team.response[s]
        gradient = penalty.gradient[s]
        for i in range(count):
            for j in range(i + 2, count):
                number += 1
                error = margins.tracking * (response[i, 0] + response[j, 0])
                limit = wanted + extra[s] + error
                if boxes_closer(boxes, i, boxes, j, limit):
                    pair = StrandPair(i, j, signs[s, number], extra[s], limit)
                    penalty.missed[s] += penalize_pair(points, shapes, pair, model, gradient)


@inner
def preferred_distance(margins: Margins) -> float:
    """Return the distance that two strands should have at their places, without errors."""
    return margins.cable + PREFERRED * (margins.cable + 2.0 * margins.tracking)


@inner
def penalize_pair(
    points: Floats, shapes: Floats, pair: StrandPair, model: PenaltyModel, gradient: Floats
) -> float:
    """Return the square of the missed margin of two strands; add to the gradient (n, 3)."""
    i, j, margins = pair.first, pair.second, model.margins
    first, second = points[i], points[j]
    unit = margins.cable + 2.0 * margins.tracking
    beyond = -pair.sign * crossing_height(first, second) if pair.sign else 0.0
    if beyond > 0.0:
        # The wrong strand is over: loops come out of others upward and downward, not through them.
        here, there = plan_crossing(first, second)
        distance, normal = -beyond, (0.0, 0.0, float(pair.sign))
    else:
        distance, here, there = polyline_distance(first, second, pair.limit)
        if distance >= pair.limit:
            return 0.0
        normal = direction_between(first, here, second, there, distance)
        here, there = here / PIECES, there / PIECES
    here, there = arc_fraction(shapes[i], here), arc_fraction(shapes[j], there)
    moved = error_of_ends(BOTH_ENDS, margins.tracking)
    error = point_movement(shapes[i], here, normal[2], moved, model.tables)
    error += point_movement(shapes[j], there, normal[2], moved, model.tables)
    short = PREFERRED - (distance - margins.cable - pair.extra - error) / unit
    if short <= 0.0:
        return 0.0
    add_to_ends(gradient, i, first, shapes[i], here, times(-short / unit, normal))
    add_to_ends(gradient, j, second, shapes[j], there, times(short / unit, normal))
    return float(short * short)


@compiled
def spare_margins(own: OutlineRow, other: OutlineRow, model: PenaltyModel, spare: Floats1) -> None:
    """Write by how much strands (q,) keep more than their margin from others, pair by pair.

    They share no vehicle; metres, negative where the margin is missed.
    """
    moved = error_of_ends(BOTH_ENDS, model.margins.tracking)
    for q in range(len(own.points)):
        points, other_points = own.points[q], other.points[q]
        distance, here, there = polyline_distance(points, other_points, np.inf)
        upright = direction_between(points, here, other_points, there, distance)[2]
        here = arc_fraction(own.shapes[q], here / PIECES)
        there = arc_fraction(other.shapes[q], there / PIECES)
        error = point_movement(own.shapes[q], here, upright, moved, model.tables)
        error += point_movement(other.shapes[q], there, upright, moved, model.tables)
        spare[q] = distance - model.margins.cable - error
