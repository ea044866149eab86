"""Where a team is after lost setpoints, in the middle of a box of a coast and around it; compiled.

A box is a case (0: all have lost the stream, else that vehicle), a time at which it is lost, a way
that the lost have coasted, and one by which the others have gone on; see :mod:`.stream_loss_bound`.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from swarm.certification.motion_bounds import largest_between, pieces_between
from swarm.geometry.motion import evaluate_piece, find_piece
from swarm.jit import compiled

Floats = npt.NDArray[np.float64]


class Leaving(NamedTuple):
    """What decides how n vehicles leave their plan.

    ``breaks``, ``joints``, ``coefficients``, ``accelerations`` and ``jerks`` are their course's;
    they coast for ``after`` seconds (n,) and sink by ``sinking`` metres (n,). Within ``ball``
    metres of where they are planned at one and the same time all is certified; nobody goes beyond
    ``end``.
    """

    breaks: Floats
    joints: Floats
    coefficients: Floats
    accelerations: Floats
    jerks: Floats
    after: Floats
    sinking: Floats
    ball: float
    end: float


class Box(NamedTuple):
    """A box: middles and half widths of time, of what is coasted and of what is gone on."""

    case: int
    rate: float
    time: float
    half: float
    coasted: float
    coasted_half: float
    on: float
    on_half: float


class Standing(NamedTuple):
    """Where all are in a box's middle, and how fast they go with the time of the loss (n, 3), how
    much else each may move within the box (n,); and room (3, 3) for one of them."""

    place: Floats
    along: Floats
    loose: Floats
    one: Floats


def room_for(n: int) -> Standing:
    """Room for a team of n."""
    return Standing(np.empty((n, 3)), np.empty((n, 3)), np.empty(n), np.empty((3, 3)))


@compiled
def stand(box: Box, leaving: Leaving, standing: Standing, doubts: Floats) -> bool:
    """Work out where everybody stands; whether anybody may be out of the ball.

    Writes how much is open (3,) because of the widths in time, coasted and gone on.
    """
    place, along, loose = standing.place, standing.along, standing.loose
    doubts[:] = 0.0
    gone, gone_half = (box.coasted, box.coasted_half) if box.case == 0 else (box.on, box.on_half)
    moment, width = box.time + gone, box.half + gone_half
    later, until = min(moment, leaving.end), min(moment + width, leaving.end)
    piece, since, moving = find_piece(leaving.breaks, later)
    run = pieces_between(leaving.joints, later - width, until)
    largest = 0.0
    for i in range(len(loose)):
        evaluate_piece(
            leaving.coefficients[piece], i, since, moving, place[i], along[i], standing.one[2]
        )
        bound = largest_between(leaving.accelerations, run, i)
        # Where the plan may have it, at the same time as the others.
        size = _size(along[i])
        loose[i] = size * gone_half + 0.5 * bound * width * width
        if moment + width > leaving.end:
            loose[i] += 2.0 * size * width
        if box.case in (0, i + 1):
            largest = max(largest, _coasting(box, i, leaving, standing, doubts))
        else:
            doubts[2] = max(doubts[2], size * box.on_half)
    if largest <= leaving.ball:
        return False
    x, y, z = along[:, 0].mean(), along[:, 1].mean(), along[:, 2].mean()
    largest = 0.0
    for i in range(len(along)):
        square = (along[i, 0] - x) ** 2 + (along[i, 1] - y) ** 2 + (along[i, 2] - z) ** 2
        largest = max(largest, square)
    doubts[0] = (np.sqrt(largest) + 1e-3) * box.half
    return True


@compiled
def _coasting(box: Box, i: int, leaving: Leaving, standing: Standing, doubts: Floats) -> float:
    """Put one that has lost the stream from where the plan has it to where it coasts.

    Returns how far it may be from where it is planned when all others are where they are.
    """
    begun, speed, push = standing.one[0], standing.one[1], standing.one[2]
    piece, since, moving = find_piece(leaving.breaks, box.time)
    evaluate_piece(leaving.coefficients[piece], i, since, moving, begun, speed, push)
    run = pieces_between(leaving.joints, box.time - box.half, box.time + box.half)
    strongest = largest_between(leaving.accelerations, run, i)
    sharpest = largest_between(leaving.jerks, run, i)
    # all: each has coasted by what the farthest has, or by as much less as it stops earlier
    behind = box.rate * (leaving.after.max() - leaving.after[i]) if box.case == 0 else 0.0
    sunk = 0.5 * leaving.sinking[i] if box.case > 0 else 0.0
    middle, most = max(box.coasted - 0.5 * behind, 0.0), box.coasted + box.coasted_half
    fastest = _size(speed) + strongest * box.half
    loose = fastest * (box.coasted_half + 0.5 * behind) + sunk
    swerve = 0.5 * (strongest + most * sharpest) * box.half
    loose += (swerve + 0.5 * strongest * behind) * box.half
    doubts[1] = max(doubts[1], fastest * box.coasted_half)
    apart = turned = 0.0
    for axis in range(3):
        begun[axis] += middle * speed[axis]
        speed[axis] += middle * push[axis]
    begun[2] -= sunk
    for axis in range(3):
        apart += (begun[axis] - standing.place[i, axis]) ** 2
        turned += (speed[axis] - standing.along[i, axis]) ** 2
        standing.place[i, axis], standing.along[i, axis] = begun[axis], speed[axis]
    off = np.sqrt(apart) + np.sqrt(turned) * box.half + standing.loose[i] + loose
    standing.loose[i] = loose
    return float(off)


@compiled
def _size(vector: Floats) -> float:
    return float(np.sqrt(vector[0] ** 2 + vector[1] ** 2 + vector[2] ** 2))
