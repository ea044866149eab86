"""What is known of a motion between samples: positions, velocities, and bounds on acceleration."""

from dataclasses import dataclass
from functools import cached_property
from math import comb, perm

import numpy as np
import numpy.typing as npt

from swarm.geometry.motion import Motion
from swarm.jit import compiled

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Course:
    """A motion of n grip points, with what interval bounds need of it."""

    motion: Motion

    def jumps(self) -> Floats:
        """Jumps (k − 1, 3, n) of position, velocity and acceleration where pieces join."""
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

    @cached_property
    def accelerations(self) -> Floats:
        """Largest accelerations (l, k, n) on runs of 2^l pieces; see :func:`pieces_between`."""
        return self._largest(2)

    @cached_property
    def jerks(self) -> Floats:
        """The same of jerks."""
        return self._largest(3)

    def acceleration_bound(self, start: Floats, end: Floats) -> Floats:
        """Upper bounds (m, n) of every grip point's acceleration on the intervals (m,), m/s²."""
        return self._over(self.accelerations, start, end)

    def jerk_bound(self, start: Floats, end: Floats) -> Floats:
        """Upper bounds (m, n) of every grip point's jerk on the intervals (m,), m/s³."""
        return self._over(self.jerks, start, end)

    def _largest(self, order: int) -> Floats:
        """Bounds (l, k, n) of a derivative on 2^l consecutive pieces, from every one of them on.

        On one piece, a polynomial's Bernstein coefficients enclose its values.
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
        joints = np.require(self.motion.times[1:-1], requirements=["C", "W"])
        start, end = np.ascontiguousarray(start), np.ascontiguousarray(end)
        _bounds_between(tables, joints, start, end, bound)
        return bound


@compiled
def _bounds_between(
    tables: Floats, joints: Floats, start: Floats, end: Floats, found: Floats
) -> None:
    """Write the largest that ``tables`` know of all (n,) in intervals (m,)."""
    for m in range(len(start)):
        run = pieces_between(joints, start[m], end[m])
        for i in range(found.shape[1]):
            found[m, i] = largest_between(tables, run, i)


@compiled
def pieces_between(joints: Floats, start: float, end: float) -> tuple[int, int, int]:
    """Where tables of a course have what is between two times: of two runs the first pieces and the
    level. ``joints`` are the times at which the course's pieces join."""
    first = np.searchsorted(joints, start)
    last = np.searchsorted(joints, end, side="right")
    level, run = 0, 1
    while 2 * run <= last - first + 1:
        level, run = level + 1, 2 * run
    return int(first), int(last - run + 1), level


@compiled
def largest_between(tables: Floats, run: tuple[int, int, int], i: int) -> float:
    """The largest that ``tables`` know of one of n between the times of :func:`pieces_between`."""
    first, last, level = run
    return float(max(tables[level, first, i], tables[level, last, i]))
