"""Bounds of a motion on intervals of time: positions, velocities, accelerations and jerks."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from math import comb, perm
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from swarm.certification.branch_and_bound import ROUNDING, Boxes, Enclosure, Evaluator
from swarm.geometry.distance import Vector, norms
from swarm.geometry.motion import Motion, find_piece, place_in_piece, speed_in_piece
from swarm.jit import compiled, inner
from swarm.signatures import Floats1, Floats2, Floats3, Floats4, contiguous

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.intp]


class MotionTables(NamedTuple):
    """A motion for compiled code, its joints between pieces, and bounds of its accelerations.

    ``jumps`` (k, n, 2) are the sums of the jumps of position and velocity at the first k joints.
    """

    times: Floats1
    joints: Floats1
    coefficients: Floats4
    accelerations: Floats3
    jumps: Floats3


@dataclass(frozen=True, eq=False)
class BoundedMotion:
    """A motion of n grip points with upper bounds of its accelerations and jerks."""

    motion: Motion

    @cached_property
    def tables(self) -> MotionTables:
        """The motion for compiled code."""
        times, motion = self.motion.times, self.motion
        tables = times, times[1:-1], motion.coefficients, self.accelerations, self._jump_sums
        return MotionTables(*(contiguous(each) for each in tables))

    def at(self, time: Floats) -> tuple[Floats, Floats, Floats]:
        """Return positions, velocities and accelerations, each (m, n, 3), at times (m,)."""
        return self.motion.at(time)

    @cached_property
    def jumps(self) -> Floats:
        """The jumps (k − 1, 3, n) of position, velocity and acceleration between pieces."""
        duration = np.diff(self.motion.times)[:-1, None]
        power = np.arange(6)
        jumps = []
        for order in range(3):
            factor = np.array([perm(int(p), order) if p >= order else 0 for p in power], float)
            weight = factor * duration ** np.maximum(power - order, 0)
            reached = np.einsum("kp,kpnx->knx", weight, self.motion.coefficients[:-1])
            begins = self.motion.coefficients[1:, order] * perm(order, order)
            jumps.append(np.linalg.norm(reached - begins, axis=-1))
        return np.stack(jumps, axis=1)

    @property
    def _jump_sums(self) -> Floats:
        """Sums (k, n, 2) of the jumps of position and velocity at the first joints."""
        sums = np.cumsum(self.jumps[:, :2], axis=0)
        return np.moveaxis(np.concatenate([np.zeros((1, *sums.shape[1:])), sums]), 1, 2)

    @cached_property
    def kinks(self) -> Floats:
        """Jumps of velocity at both ends of each piece over its duration (k, n), m/s².

        Counted as acceleration: pieces that are short enough hide any acceleration in jumps.
        """
        ends = np.zeros((len(self.motion.coefficients), self.motion.coefficients.shape[2]))
        ends[1:] += self.jumps[:, 1]
        ends[:-1] += self.jumps[:, 1]
        return ends / np.diff(self.motion.times)[:, None]

    @cached_property
    def accelerations(self) -> Floats:
        """Largest accelerations (l, k, n) on 2^l consecutive pieces; see :func:`pieces_between`."""
        return self._largest(2)

    @cached_property
    def jerks(self) -> Floats:
        """Largest jerks (l, k, n), as :attr:`accelerations`."""
        return self._largest(3)

    def acceleration_bound(self, start: Floats, end: Floats) -> Floats:
        """Return upper bounds (m, n) of the accelerations on the intervals (m,), m/s²."""
        return self._over(self.accelerations, start, end)

    def jerk_bound(self, start: Floats, end: Floats) -> Floats:
        """Return upper bounds (m, n) of the jerks on the intervals (m,), m/s³."""
        return self._over(self.jerks, start, end)

    def _largest(self, order: int) -> Floats:
        """Bounds (l, k, n) of a derivative on the 2^l pieces from piece k on.

        On one piece, the Bernstein coefficients of a polynomial enclose its values.
        """
        degree = 5 - order
        power = np.arange(degree + 1)
        factor = np.array([perm(int(p) + order, order) for p in power], dtype=float)
        duration = np.diff(self.motion.times)
        scaled = self.motion.coefficients[:, order:] * factor[:, None, None]
        scaled = scaled * (duration[:, None] ** power)[:, :, None, None]
        to_bernstein = [[comb(row, p) / comb(degree, p) for p in power] for row in power]
        control = np.einsum("bp,kpnx->kbnx", to_bernstein, scaled)
        tables = [np.linalg.norm(control, axis=-1).max(axis=1)]
        while len(self.motion.coefficients) >= 2 ** len(tables):
            half, wider = 2 ** (len(tables) - 1), tables[-1].copy()
            wider[:-half] = np.maximum(tables[-1][:-half], tables[-1][half:])
            tables.append(wider)
        return np.stack(tables)

    def _over(self, tables: Floats, start: Floats, end: Floats) -> Floats:
        bound = np.empty((len(start), tables.shape[2]))
        start, end = contiguous(start), contiguous(end)
        _bounds_between(tables, self.tables.joints, start, end, bound)
        return bound

    def deviation(self, time: Floats, half: Floats) -> Floats:
        """Return bounds (m, n) of the distance from uniform motion around times (m,), metres.

        By the acceleration, and by the jumps between pieces: of position, and of velocity for as
        long as the half width.
        """
        deviations = np.empty((len(time), self.motion.coefficients.shape[2]))
        _deviations(self.tables, contiguous(time), contiguous(half), deviations)
        return deviations


@dataclass(frozen=True, eq=False)
class TeamStates:
    """States of the team at m instants ``time``, with bounds within half widths (m,) around them.

    ``position`` and ``velocity`` (m, n, 3); ``deviation`` (m, n) bounds the distance from uniform
    motion, metres.
    """

    time: Floats
    half: Floats
    position: Floats
    velocity: Floats
    deviation: Floats

    @staticmethod
    def at(motion: BoundedMotion, time: Floats, half: Floats) -> "TeamStates":
        """Return the states at times (m,) with half widths (m,)."""
        position, velocity, _ = motion.at(time)
        return TeamStates(time, half, position, velocity, motion.deviation(time, half))

    def drift(self, instant: Ints, vehicle: Ints, frame: Floats) -> Floats:
        """Bound the movement (b,) of grip points in a frame with velocity ``frame`` (b, 3)."""
        speed = norms(self.velocity[instant, vehicle] - frame)
        bound: Floats = speed * self.half[instant] + self.deviation[instant, vehicle]
        return bound


Margin = Callable[[TeamStates, Ints, Ints], tuple[Floats, Floats, Floats]]
"""From states of the team, and the instant and the group of each box (b,): margins (b,) at the
instants, how much less they are at most within the half widths, and their places (b, 3)."""


def over_time(motion: BoundedMotion, margin: Margin) -> Evaluator:
    """Return the evaluator of a margin whose only coordinate is time."""

    def evaluate(boxes: Boxes) -> Enclosure:
        time, half, instant = boxes.instants()
        high, less, place = margin(TeamStates.at(motion, time, half), instant, boxes.group)
        return Enclosure(high - less, high, less[:, None], place)

    return evaluate


class Instant(NamedTuple):
    """A time and the ``half`` width of an interval around it, seconds.

    The time lies ``since`` seconds into a ``piece`` of the motion; ``moving`` is 0 outside of it.
    ``pieces`` cover the interval: see :func:`pieces_between`.
    """

    time: float
    half: float
    piece: int
    since: float
    moving: float
    pieces: tuple[int, int, int]


class Grip(NamedTuple):
    """A grip point at an instant; ``deviation`` bounds its distance from uniform motion, metres."""

    place: Vector
    velocity: Vector
    deviation: float


@inner
def instant_at(motion: MotionTables, time: float, half: float) -> Instant:
    """Return an instant of a motion, with the interval around it, which covers rounded times."""
    half += ROUNDING
    piece, since, moving = find_piece(motion.times, time)
    covering = pieces_between(motion.joints, time - half, time + half)
    return Instant(time, half, piece, since, moving, covering)


@inner
def grip_at(motion: MotionTables, instant: Instant, i: int) -> Grip:
    """Return grip point i at an instant."""
    c, u, moving = motion.coefficients[instant.piece], instant.since, instant.moving
    return Grip(
        (place_in_piece(c, i, 0, u), place_in_piece(c, i, 1, u), place_in_piece(c, i, 2, u)),
        (
            moving * speed_in_piece(c, i, 0, u),
            moving * speed_in_piece(c, i, 1, u),
            moving * speed_in_piece(c, i, 2, u),
        ),
        _deviation(motion, instant.pieces, instant.half, i),
    )


@inner
def _deviation(motion: MotionTables, pieces: tuple[int, int, int], half: float, i: int) -> float:
    """Return :meth:`BoundedMotion.deviation` of grip point i on pieces of a motion."""
    first, last, level = pieces
    last += (1 << level) - 1
    bound = largest_between(motion.accelerations, pieces, i)
    jump = motion.jumps[last, i, 0] - motion.jumps[first, i, 0]
    kink = motion.jumps[last, i, 1] - motion.jumps[first, i, 1]
    return float(jump + half * (kink + 0.5 * bound * half))


@inner
def ends_at(motion: MotionTables, instant: Instant, segment: int) -> tuple[Grip, Grip]:
    """Return both grip points of a segment at an instant."""
    return grip_at(motion, instant, segment), grip_at(motion, instant, segment + 1)


@compiled
def _bounds_between(
    tables: Floats3, joints: Floats1, start: Floats1, end: Floats1, bounds: Floats2
) -> None:
    """Write the bounds (m, n) of all grip points on intervals (m,)."""
    for m in range(len(start)):
        pieces = pieces_between(joints, start[m], end[m])
        for i in range(bounds.shape[1]):
            bounds[m, i] = largest_between(tables, pieces, i)


@compiled
def _deviations(motion: MotionTables, time: Floats1, half: Floats1, deviations: Floats2) -> None:
    """Write the deviations (m, n) of all grip points around times (m,)."""
    for m in range(len(time)):
        pieces = pieces_between(motion.joints, time[m] - half[m], time[m] + half[m])
        for i in range(deviations.shape[1]):
            deviations[m, i] = _deviation(motion, pieces, half[m], i)


@inner
def pieces_between(joints: Floats, start: float, end: float) -> tuple[int, int, int]:
    """Return two runs of 2^level pieces that cover an interval: first piece of each, and level.

    ``joints`` are the times between pieces.
    """
    first = np.searchsorted(joints, start)
    last = np.searchsorted(joints, end, side="right")
    level, count = 0, 1
    while 2 * count <= last - first + 1:
        level, count = level + 1, 2 * count
    return int(first), int(last - count + 1), level


@inner
def largest_between(tables: Floats, pieces: tuple[int, int, int], i: int) -> float:
    """Return the bound of grip point i on the runs that :func:`pieces_between` returned."""
    first, last, level = pieces
    return float(max(tables[level, first, i], tables[level, last, i]))
