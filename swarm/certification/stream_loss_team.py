"""States of a team after a stream loss, in the middle of a box and around it; compiled.

A box is a case (0: the whole team has lost its setpoints, else that vehicle), the time of the loss,
the coasting of the vehicles without setpoints, and the advance of the others along the plan; see
:mod:`.stream_loss_bound`.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from swarm.certification.motion_bounds import largest_between, pieces_between
from swarm.geometry.motion import evaluate_piece, find_piece
from swarm.jit import inner
from swarm.signatures import Floats1, Floats2, Floats3, Floats4

Floats = npt.NDArray[np.float64]


class LossMotion(NamedTuple):
    """The planned motion of n vehicles, and how it continues without setpoints.

    ``times``, ``joints``, ``coefficients``, ``accelerations`` and ``jerks`` are those of a
    :class:`.motion_bounds.BoundedMotion`. Vehicles coast for ``coast_time`` seconds (n,) and
    descend by ``descent`` metres (n,). Within ``tracking`` metres of the planned positions at one
    time, everything is certified. ``end`` is the last mission time that is reached.
    """

    times: Floats1
    joints: Floats1
    coefficients: Floats4
    accelerations: Floats3
    jerks: Floats3
    coast_time: Floats1
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


class TeamState(NamedTuple):
    """Positions in a box's middle and their derivatives by the time of the loss (n, 3).

    ``spread`` (n,) bounds all other movement of each vehicle within the box, metres; ``scratch``
    (3, 3) is working memory.
    """

    position: Floats2
    velocity: Floats2
    spread: Floats1
    scratch: Floats2


def allocate_team(n: int) -> TeamState:
    """Return memory for the state of n vehicles."""
    return TeamState(np.empty((n, 3)), np.empty((n, 3)), np.empty(n), np.empty((3, 3)))


@inner
def write_state(box: Box, motion: LossMotion, team: TeamState, doubts: Floats) -> bool:
    """Write the team's state, and whether a vehicle may be outside the tracking radius.

    ``doubts`` (3,) becomes the uncertainty that the widths in time, coasting and advance cause.
    """
    position, velocity, spread = team.position, team.velocity, team.spread
    doubts[0] = doubts[1] = doubts[2] = 0.0
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
            position[i, axis], velocity[i, axis] = team.scratch[0, axis], team.scratch[1, axis]
        acceleration = largest_between(motion.accelerations, pieces, i)
        # Planned positions, of all vehicles at the same time.
        speed = _norm(velocity[i])
        spread[i] = speed * after_half + 0.5 * acceleration * width * width
        if moment + width > motion.end:
            spread[i] += 2.0 * speed * width
        if box.case in (0, i + 1):
            largest = max(largest, _coast(box, i, motion, team, doubts))
        else:
            doubts[2] = max(doubts[2], speed * box.advance_half)
    if largest <= motion.tracking:
        return False
    x = y = z = 0.0
    for i in range(len(velocity)):
        x, y, z = x + velocity[i, 0], y + velocity[i, 1], z + velocity[i, 2]
    x, y, z = x / len(velocity), y / len(velocity), z / len(velocity)
    largest = 0.0
    for i in range(len(velocity)):
        square = (velocity[i, 0] - x) ** 2 + (velocity[i, 1] - y) ** 2 + (velocity[i, 2] - z) ** 2
        largest = max(largest, square)
    doubts[0] = (np.sqrt(largest) + 1e-3) * box.half
    return True


@inner
def _coast(box: Box, i: int, motion: LossMotion, team: TeamState, doubts: Floats) -> float:
    """Move vehicle i from its planned position to where it coasts.

    Returns its largest distance from the position that is planned for the state of the others.
    """
    position, velocity, acceleration = team.scratch[0], team.scratch[1], team.scratch[2]
    piece, since, moving = find_piece(motion.times, box.time)
    evaluate_piece(motion.coefficients[piece], i, since, moving, team.scratch)
    pieces = pieces_between(motion.joints, box.time - box.half, box.time + box.half)
    largest_acceleration = largest_between(motion.accelerations, pieces, i)
    largest_jerk = largest_between(motion.jerks, pieces, i)
    # Whole team: each has coasted as long as the last to stop, or less where it stops earlier.
    longest = 0.0
    for k in range(len(motion.coast_time)):
        longest = max(longest, motion.coast_time[k])
    earlier = box.rate * (longest - motion.coast_time[i]) if box.case == 0 else 0.0
    sunk = 0.5 * motion.descent[i] if box.case > 0 else 0.0
    middle, most = max(box.coast - 0.5 * earlier, 0.0), box.coast + box.coast_half
    fastest = _norm(velocity) + largest_acceleration * box.half
    spread = fastest * (box.coast_half + 0.5 * earlier) + sunk
    deviation = 0.5 * (largest_acceleration + most * largest_jerk) * box.half
    spread += (deviation + 0.5 * largest_acceleration * earlier) * box.half
    doubts[1] = max(doubts[1], fastest * box.coast_half)
    apart = turned = 0.0
    for axis in range(3):
        position[axis] += middle * velocity[axis]
        velocity[axis] += middle * acceleration[axis]
    position[2] -= sunk
    for axis in range(3):
        apart += (position[axis] - team.position[i, axis]) ** 2
        turned += (velocity[axis] - team.velocity[i, axis]) ** 2
        team.position[i, axis], team.velocity[i, axis] = position[axis], velocity[axis]
    off = np.sqrt(apart) + np.sqrt(turned) * box.half + team.spread[i] + spread
    team.spread[i] = spread
    return float(off)


@inner
def _norm(vector: Floats) -> float:
    return float(np.sqrt(vector[0] ** 2 + vector[1] ** 2 + vector[2] ** 2))
