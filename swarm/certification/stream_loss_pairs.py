"""Margins of a team after a stream loss, in one box; compiled.

Only pairs with a vehicle that has lost its setpoints are computed: all other distances are
certified already. Functions return a lower bound of the margin in the box, and the margin in its
middle, in metres.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from swarm.certification.coarse_distance import box_distance, squared_point_distance
from swarm.certification.stream_loss_team import TeamState
from swarm.geometry.catenary_kernel import sample_strand
from swarm.geometry.distance import polyline_distance
from swarm.geometry.sensitivity import (
    BOTH_ENDS,
    LARGEST_RATIO,
    Sensitivity,
    chord_response,
    error_of_ends,
)
from swarm.jit import inner
from swarm.signatures import Bools1, Floats1, Floats3

Floats = npt.NDArray[np.float64]

TOLERANCE = 0.005
"""Metres by which a clearance may fall short and still count as kept: exactly at the limit, no
finite search can decide."""
_PIECES = 16
"""Pieces of a sampled strand: 20 cm of a strand of 3 m; near distances are computed exactly."""


class Required(NamedTuple):
    """Required distances, metres.

    ``chord`` (n − 1,): the longest chords; ``horizontal``, ``vertical``: of vehicles, one of both;
    ``strands``: of the middles of strands. ``lengths`` (n − 1,) are those of the segments;
    ``sensitivity`` has the tables of their response to their ends.
    """

    chord: Floats1
    horizontal: float
    vertical: float
    strands: float
    lengths: Floats1
    sensitivity: Sensitivity


class SampledStrands(NamedTuple):
    """Points (n − 1, k, 3) of the strands in a box's middle.

    ``bow`` (n − 1,) is the largest distance of a strand from the lines between its points;
    ``sampled`` (n − 1,) tells which strands are computed.
    """

    points: Floats3
    bow: Floats1
    sampled: Bools1


def allocate_strands(strands: int) -> SampledStrands:
    """Return memory for sampled strands."""
    points = np.empty((strands, _PIECES + 1, 3))
    return SampledStrands(points, np.empty(strands), np.zeros(strands, dtype=np.bool_))


@inner
def vehicle_margins(
    case: int, half: float, team: TeamState, required: Required
) -> tuple[float, float]:
    """Return the smallest margins of chords and between vehicles; ``half`` is the box's in time."""
    position, velocity, spread = team.position, team.velocity, team.spread
    low = here = np.inf
    for i in range(len(spread)):
        for j in range(i + 1, len(spread)):
            if case not in (0, i + 1, j + 1):
                continue
            x, y = position[j, 0] - position[i, 0], position[j, 1] - position[i, 1]
            z, turned = position[j, 2] - position[i, 2], 0.0
            for axis in range(3):
                turned += (velocity[j, axis] - velocity[i, axis]) ** 2
            moved = np.sqrt(turned) * half + spread[i] + spread[j]
            margin = max(np.sqrt(x * x + y * y) - required.horizontal, abs(z) - required.vertical)
            if j == i + 1:
                margin = min(margin, required.chord[i] - np.sqrt(x * x + y * y + z * z))
            low, here = min(low, margin - moved), min(here, margin)
    return float(low), float(here)


@inner
def strand_margins(
    case: int, half: float, team: TeamState, required: Required, strands: SampledStrands
) -> tuple[float, float]:
    """Return the smallest margins between strands that share no vehicle."""
    count, low, here = len(required.lengths), np.inf, np.inf
    for i in range(count):
        strands.sampled[i] = False
    for i in range(count):
        held = case in (0, i + 1, i + 2)
        for j in range(
            i + 2 if held else max(i + 2, case - 2), count if held else min(case, count)
        ):
            moved = _end_movements(i, j, team, half)
            distance = box_distance(
                team.position, required.lengths, (i, j), moved, required.strands
            )
            if distance < required.strands:
                margin = _strand_margin((i, j), moved, team.position, required, strands)
                low, here = min(low, margin[0]), min(here, margin[1])
    return low, here


@inner
def _strand_margin(
    pair: tuple[int, int],
    moved: tuple[float, float],
    position: Floats,
    required: Required,
    strands: SampledStrands,
) -> tuple[float, float]:
    """Margins between two strands whose ends move by up to ``moved``."""
    i, j = pair
    off = _deviation(i, moved[0], position, required, strands)
    off += _deviation(j, moved[1], position, required, strands)
    # The points' distance bounds from above, and less a spacing from below: lines through points
    # that are a spacing apart come nearer by at most a spacing, half of it on each.
    most = np.sqrt(squared_point_distance(strands.points[i], strands.points[j]))
    most -= required.strands
    longest = 0.0
    for k in range(len(required.lengths)):
        longest = max(longest, required.lengths[k])
    least = most - longest / _PIECES
    if least < off and most >= off - TOLERANCE:
        limit = most + required.strands
        exact = polyline_distance(strands.points[i], strands.points[j], limit)[0]
        least = most = exact - required.strands
    return least - off, most


@inner
def _deviation(
    i: int, moved: float, position: Floats, required: Required, strands: SampledStrands
) -> float:
    """Largest distance of a strand from its sampled lines when its ends move; samples it."""
    start, end, length = position[i], position[i + 1], required.lengths[i]
    rise = end[2] - start[2]
    span = np.sqrt((end[0] - start[0]) ** 2 + (end[1] - start[1]) ** 2)
    chord = np.sqrt(span * span + rise * rise)
    if not strands.sampled[i]:
        strands.sampled[i] = True
        drawn = max(length, chord / LARGEST_RATIO)
        strands.bow[i] = _sample(start, end, drawn, strands.points[i])
    if chord + 2.0 * moved >= LARGEST_RATIO * length:
        return np.inf
    errors = error_of_ends(BOTH_ENDS, moved)
    level, upright = chord_response(rise, span, length, errors, 1, required.sensitivity)
    return float(strands.bow[i] + np.sqrt(level * level + upright * upright) * moved)


@inner
def _sample(start: Floats, end: Floats, length: float, points: Floats) -> float:
    """Write a strand's points (k, 3) and return its largest distance from the lines between."""
    sample_strand(start, end, length, points)
    arc, shortest = length / (len(points) - 1), np.inf
    for k in range(len(points) - 1):
        square = 0.0
        for axis in range(3):
            square += (points[k + 1, axis] - points[k, axis]) ** 2
        shortest = min(shortest, square)
    return 0.5 * float(np.sqrt(max(arc * arc - shortest, 0.0)))


@inner
def _end_movements(i: int, j: int, team: TeamState, half: float) -> tuple[float, float]:
    """Largest movements of the ends of two strands, without their common movement."""
    velocity = team.velocity
    common = (
        0.25 * (velocity[i, 0] + velocity[i + 1, 0] + velocity[j, 0] + velocity[j + 1, 0]),
        0.25 * (velocity[i, 1] + velocity[i + 1, 1] + velocity[j, 1] + velocity[j + 1, 1]),
        0.25 * (velocity[i, 2] + velocity[i + 1, 2] + velocity[j, 2] + velocity[j + 1, 2]),
    )
    return (
        max(_end_movement(i, common, team, half), _end_movement(i + 1, common, team, half)),
        max(_end_movement(j, common, team, half), _end_movement(j + 1, common, team, half)),
    )


@inner
def _end_movement(
    k: int, common: tuple[float, float, float], team: TeamState, half: float
) -> float:
    """Largest movement of one end, without the common movement."""
    square = 0.0
    for axis in range(3):
        square += (team.velocity[k, axis] - common[axis]) ** 2
    return float(np.sqrt(square) * half + team.spread[k])
