"""States of a team after a stream loss, in the middle of a box and around it; compiled.

A box is a case (0: the whole team has lost its setpoints, else that vehicle), the time of the loss,
the coasting of the vehicles without setpoints, and the advance of the others along the plan; see
:mod:`.stream_loss_bound`.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from swarm.certification.motion_bounds import largest_between, pieces_between
from swarm.certification.team_margins import Team
from swarm.geometry.motion import evaluate_piece, find_piece
from swarm.jit import inner
from swarm.signatures import Floats1, Floats3, Floats4

Floats = npt.NDArray[np.float64]


class LossMotion(NamedTuple):
    """The planned motion of n vehicles, and how it continues without setpoints.

    ``times``, ``joints``, ``coefficients``, ``accelerations`` and ``jerks`` are those of a
    :class:`.motion_bounds.BoundedMotion`. If all coast, each is up to ``lag`` (n,) seconds of
    coasting behind the first; one that lands alone descends by ``descent`` metres (n,). Within
    ``tracking`` metres of the planned positions at one time, everything is certified. ``end`` is
    the last mission time that is reached.
    """

    times: Floats1
    joints: Floats1
    coefficients: Floats4
    accelerations: Floats3
    jerks: Floats3
    lag: Floats1
    descent: Floats1
    tracking: float
    end: float


class Box(NamedTuple):
    """A box: middles and half widths of the time of the loss, of coasting and of the advance.

    ``rate`` is the mission clock's rate; coasting is in seconds at the velocity at the loss, the
    advance in seconds of mission time.
    """

    case: int
    rate: float
    time: float
    half: float
    coast: float
    coast_half: float
    advance: float
    advance_half: float


@inner
def write_state(box: Box, motion: LossMotion, team: Team, doubts: Floats) -> bool:
    """Write the team's state, and whether a vehicle may be outside the tracking radius.

    Its coordinates are the time of the loss, coasting and advance; ``doubts`` (3,) becomes the
    uncertainty that the widths in these cause.
    """
    position, slopes, spread = team.position, team.slopes, team.spread
    together = 1 if box.case == 0 else 2  # the coordinate in which the planned positions advance
    after, after_half = (
        (box.coast, box.coast_half) if box.case == 0 else (box.advance, box.advance_half)
    )
    moment, width = box.time + after, box.half + after_half
    later, until = min(moment, motion.end), min(moment + width, motion.end)
    piece, since, moving = find_piece(motion.times, later)
    pieces = pieces_between(motion.joints, later - width, until)
    largest = 0.0
    for i in range(len(spread)):
        evaluate_piece(motion.coefficients[piece], i, since, moving, team.scratch)
        for axis in range(3):
            position[i, axis] = team.scratch[0, axis]
            slopes[0, i, axis] = slopes[together, i, axis] = team.scratch[1, axis]
            slopes[3 - together, i, axis] = 0.0
        acceleration = largest_between(motion.accelerations, pieces, i)
        # Planned positions, of all vehicles at the same time.
        spread[i] = 0.5 * acceleration * width * width
        if moment + width > motion.end:
            spread[i] += 2.0 * _norm(slopes[0, i]) * width
        if box.case in (0, i + 1):
            largest = max(largest, _coast(box, i, motion, team))
    if largest <= motion.tracking:
        doubts[0] = doubts[1] = doubts[2] = 0.0
        return False
    halves = box.half, box.coast_half, box.advance_half
    for coordinate in range(3):
        doubts[coordinate] = _apart(slopes[coordinate], team.scratch[0]) * halves[coordinate]
    return True


@inner
def _apart(slopes: Floats, mean: Floats) -> float:
    """Return how far slopes (n, 3) differ from their mean at most, and a tenth of that.

    Distances of vehicles change with their differences, those from floor and fence with all of it.
    ``mean`` (3,) is working memory.
    """
    for axis in range(3):
        mean[axis] = 0.0
        for i in range(len(slopes)):
            mean[axis] += slopes[i, axis] / len(slopes)
    largest = 0.0
    for i in range(len(slopes)):
        square = 0.0
        for axis in range(3):
            square += (slopes[i, axis] - mean[axis]) ** 2
        largest = max(largest, square)
    return float(np.sqrt(largest) + 0.1 * _norm(mean) + 1e-3)


@inner
def _coast(box: Box, i: int, motion: LossMotion, team: Team) -> float:
    """Move vehicle i from its planned position to where it coasts.

    Returns its largest distance from the position that is planned for the state of the others.
    """
    position, velocity, acceleration = team.scratch[0], team.scratch[1], team.scratch[2]
    piece, since, moving = find_piece(motion.times, box.time)
    evaluate_piece(motion.coefficients[piece], i, since, moving, team.scratch)
    pieces = pieces_between(motion.joints, box.time - box.half, box.time + box.half)
    largest_acceleration = largest_between(motion.accelerations, pieces, i)
    largest_jerk = largest_between(motion.jerks, pieces, i)
    # Whole team: each has coasted as long as the last to stop, or less where it lags behind.
    earlier = box.rate * motion.lag[i] if box.case == 0 else 0.0
    sunk = 0.5 * motion.descent[i] if box.case > 0 else 0.0
    middle, most = max(box.coast - 0.5 * earlier, 0.0), box.coast + box.coast_half
    fastest = _norm(velocity) + largest_acceleration * box.half
    deviation = 0.5 * (largest_acceleration + most * largest_jerk) * box.half
    deviation += largest_acceleration * (box.coast_half + 0.5 * earlier)
    spread = fastest * 0.5 * earlier + deviation * box.half + sunk
    halves, off = (box.half, box.coast_half, box.advance_half), team.spread[i] + spread
    position[2] -= sunk
    for axis in range(3):
        position[axis] += middle * velocity[axis]
        acceleration[axis] = velocity[axis] + middle * acceleration[axis]
    apart = 0.0
    for axis in range(3):
        apart += (position[axis] - team.position[i, axis]) ** 2
        team.position[i, axis] = position[axis]
    for coordinate in range(3):
        turned = 0.0
        for axis in range(3):
            # by time, by coasting, and not at all by the advance of the others
            slope = acceleration[axis] if coordinate == 0 else velocity[axis]
            if coordinate == 2:
                slope = 0.0
            turned += (slope - team.slopes[coordinate, i, axis]) ** 2
            team.slopes[coordinate, i, axis] = slope
        off += np.sqrt(turned) * halves[coordinate]
    team.spread[i] = spread
    return float(np.sqrt(apart) + off)


@inner
def _norm(vector: Floats) -> float:
    return float(np.sqrt(vector[0] ** 2 + vector[1] ** 2 + vector[2] ** 2))
