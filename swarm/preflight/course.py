"""What is known of a motion between samples: positions, velocities, and bounds on acceleration."""

from dataclasses import dataclass
from functools import cached_property
from math import comb, perm

import numpy as np
import numpy.typing as npt

from swarm.trajectory import Motion

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
    def _largest_acceleration(self) -> tuple[Floats, ...]:
        return self._largest(2)

    @cached_property
    def _largest_jerk(self) -> tuple[Floats, ...]:
        return self._largest(3)

    def acceleration_bound(self, start: Floats, end: Floats) -> Floats:
        """Upper bounds (m, n) of every grip point's acceleration on the intervals (m,), m/s²."""
        return self._over(self._largest_acceleration, start, end)

    def jerk_bound(self, start: Floats, end: Floats) -> Floats:
        """Upper bounds (m, n) of every grip point's jerk on the intervals (m,), m/s³."""
        return self._over(self._largest_jerk, start, end)

    def _largest(self, order: int) -> tuple[Floats, ...]:
        """Bounds of a derivative on 2^l consecutive pieces: per l one table (k − 2^l + 1, n).

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
        while len(tables[0]) >= 2 ** len(tables):
            half = 2 ** (len(tables) - 1)
            tables.append(np.maximum(tables[-1][:-half], tables[-1][half:]))
        return tuple(tables)

    def _over(self, tables: tuple[Floats, ...], start: Floats, end: Floats) -> Floats:
        joints = self.motion.times[1:-1]
        first = np.searchsorted(joints, start, side="left")
        last = np.searchsorted(joints, end, side="right")
        level = np.frexp(last - first + 1)[1] - 1
        bound = np.empty((len(start), self.motion.coefficients.shape[2]))
        for height in np.unique(level):
            at = level == height
            table = tables[height]
            bound[at] = np.maximum(table[first[at]], table[last[at] - 2**height + 1])
        return bound
