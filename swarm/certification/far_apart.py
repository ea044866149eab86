"""Pairs that are far apart during an interval, shown by boxes around them, before a search.

A strand lies between its chord and the chord moved along the effective gravity: by as much as it
can hang below its higher end. A box around that contains it, for all movements of its grip points
within the interval and the tracking radius, and for all tilts. In a frame that moves with the pair,
boxes that are
farther apart than the required distance show that the pair keeps it.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from swarm.certification.branch_and_bound import Boxes
from swarm.certification.motion_bounds import TeamStates
from swarm.certification.strand_pieces import HeldCable
from swarm.geometry.catenary import max_depth
from swarm.geometry.sensitivity import LARGEST_RATIO
from swarm.jit import compiled, inner
from swarm.signatures import Bools1, Floats1, Floats2, Floats3, Ints1, Ints2, contiguous

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.intp]
Flags = npt.NDArray[np.bool_]


class _Team(NamedTuple):
    """States of the team at m instants, as :class:`.motion_bounds.TeamStates`."""

    half: Floats1
    position: Floats3
    velocity: Floats3
    deviation: Floats2


class _Cable(NamedTuple):
    """Lengths (n − 1,), sine of the largest angle of gravity, tracking radius and swing."""

    lengths: Floats1
    aside: float
    tracking: float
    swing: float


class _Body(NamedTuple):
    """Radius and height of a vehicle above its grip point, and the distance to keep, metres."""

    radius: float
    height: float
    distance: float


class _Memory(NamedTuple):
    """Working memory: two ``boxes`` (2, 6), and the velocity (3,) of a frame."""

    boxes: Floats2
    frame: Floats1


@dataclass(frozen=True, eq=False)
class FarPairs:
    """Tells which boxes of pairs of segments (q, 2) keep a distance of middles, metres."""

    cable: HeldCable
    pairs: Ints
    distance: float

    def __call__(self, boxes: Boxes) -> Flags:
        """Return whether pairs are shown to keep the distance in boxes of whole strands."""
        far = np.empty(len(boxes), dtype=np.bool_)
        team, instant = _team_of(self.cable, boxes)
        pairs = np.ascontiguousarray(self.pairs[boxes.group])
        cable, which = _cable_of(self.cable), (instant, pairs)
        _write_far_strands(team, cable, which, self.distance, _memory(), far)
        return far


@dataclass(frozen=True, eq=False)
class FarVehicles:
    """Tells which boxes of a vehicle and a segment (q, 2) keep a distance of its middle, metres.

    The vehicle does not hold the segment. It reaches ``height`` metres above its grip point, and
    ``radius`` aside.
    """

    cable: HeldCable
    pairs: Ints
    radius: float
    height: float
    distance: float

    def __call__(self, boxes: Boxes) -> Flags:
        """Return whether pairs are shown to keep the distance in boxes of whole strands."""
        far = np.empty(len(boxes), dtype=np.bool_)
        team, instant = _team_of(self.cable, boxes)
        pairs = np.ascontiguousarray(self.pairs[boxes.group])
        cable, body = _cable_of(self.cable), _Body(self.radius, self.height, self.distance)
        _write_far_vehicles(team, cable, (instant, pairs), body, _memory(), far)
        return far


def _memory() -> _Memory:
    return _Memory(np.empty((2, 6)), np.empty(3))


def _team_of(cable: HeldCable, boxes: Boxes) -> tuple[_Team, Ints]:
    time, half, instant = boxes.instants()
    team = TeamStates.at(cable.motion, time, half)
    arrays = (half, team.position, team.velocity, team.deviation)
    return _Team(*(contiguous(values) for values in arrays)), instant


def _cable_of(cable: HeldCable) -> _Cable:
    swing = 0.0 if cable.tube is None else cable.tube.largest
    aside = cable.tilt / float(np.hypot(1.0, cable.tilt))
    return _Cable(np.array(cable.lengths), aside, cable.tracking, swing)


@compiled
def _write_far_strands(
    team: _Team, cable: _Cable, which: tuple[Ints1, Ints2], distance: float, memory: _Memory,
    far: Bools1,
) -> None:  # fmt: skip
    """Write which pairs (b, 2) of segments at instants (b,) are farther apart than a distance."""
    (instant, pairs), (boxes, frame) = which, memory
    for b in range(len(instant)):
        m, i, j = instant[b], pairs[b, 0], pairs[b, 1]
        for axis in range(3):
            velocity = team.velocity[m]
            both = velocity[i, axis] + velocity[i + 1, axis]
            frame[axis] = 0.25 * (both + velocity[j, axis] + velocity[j + 1, axis])
        _write_box(team, cable, (m, i), frame, cable.tracking, boxes[0])
        _write_box(team, cable, (m, j), frame, cable.tracking, boxes[1])
        far[b] = _apart(boxes, distance + 2.0 * cable.swing)


@compiled
def _write_far_vehicles(
    team: _Team, cable: _Cable, which: tuple[Ints1, Ints2], body: _Body, memory: _Memory,
    far: Bools1,
) -> None:  # fmt: skip
    """Write which vehicles and segments (b, 2) at instants (b,) are farther apart."""
    (instant, pairs), boxes = which, memory.boxes
    for b in range(len(instant)):
        m, vehicle = instant[b], pairs[b, 0]
        spare = team.deviation[m, vehicle] + 2.0 * cable.tracking
        _write_box(team, cable, (m, pairs[b, 1]), team.velocity[m, vehicle], spare, boxes[0])
        for axis in range(3):
            grip = team.position[m, vehicle, axis]
            boxes[1, axis] = grip - body.radius if axis < 2 else grip
            boxes[1, 3 + axis] = grip + (body.radius if axis < 2 else body.height)
        far[b] = _apart(boxes, body.distance + cable.swing)


@inner
def _write_box(
    team: _Team, cable: _Cable, which: tuple[int, int], frame: Floats, spare: float, box: Floats
) -> None:
    """Write the box (6,) around a segment at an instant, in a frame with a velocity (3,).

    Its ends move by up to ``spare`` metres more than their drift.
    """
    m, i = which
    moved = 0.0
    for k in (i, i + 1):
        square = 0.0
        for axis in range(3):
            square += (team.velocity[m, k, axis] - frame[axis]) ** 2
        moved = max(moved, np.sqrt(square) * team.half[m] + team.deviation[m, k])
    moved += spare
    start, end = team.position[m, i], team.position[m, i + 1]
    if _stretched(team, cable, which):
        box[:3], box[3:] = -np.inf, np.inf
        return
    square = 0.0
    for axis in range(3):
        square += (end[axis] - start[axis]) ** 2
    chord = np.sqrt(square)
    rise = abs(end[2] - start[2]) + cable.aside * chord
    longest = min(rise, chord) + 2.0 * moved
    depth = max_depth(max(chord - 2.0 * moved, 0.0), longest, cable.lengths[i])
    for axis in range(3):
        aside = depth * cable.aside if axis < 2 else 0.0
        box[axis] = min(start[axis], end[axis]) - moved - (aside if axis < 2 else depth)
        box[3 + axis] = max(start[axis], end[axis]) + moved + aside


@inner
def _stretched(team: _Team, cable: _Cable, which: tuple[int, int]) -> bool:
    """Return whether a chord may be too long for bounds of movement, which the search reports."""
    m, i = which
    chord = parting = 0.0
    for axis in range(3):
        chord += (team.position[m, i + 1, axis] - team.position[m, i, axis]) ** 2
        parting += (team.velocity[m, i + 1, axis] - team.velocity[m, i, axis]) ** 2
    longest = np.sqrt(chord) + np.sqrt(parting) * team.half[m] + 2.0 * cable.tracking
    longest += team.deviation[m, i] + team.deviation[m, i + 1]
    return bool(longest >= LARGEST_RATIO * cable.lengths[i])


@inner
def _apart(boxes: Floats, distance: float) -> bool:
    """Return whether two boxes (2, 6) are farther apart than a distance."""
    square = 0.0
    for axis in range(3):
        beyond = boxes[0, axis] - boxes[1, 3 + axis]
        gap = max(beyond, boxes[1, axis] - boxes[0, 3 + axis], 0.0)
        square += gap * gap
    return bool(square > distance * distance)
