"""Radii of a tube around each part of each strand, constant over short intervals of time.

The parts are dyadic pieces of a strand, numbered as in a heap: 1 is the whole strand, 8 to 15 its
eighths.
"""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from swarm.jit import inner
from swarm.signatures import Floats3, Floats4

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.intp]

BIN = 0.5
"""Seconds of mission time over which the tube is constant."""

LEAVES = 8
"""Equal parts of a strand with a radius of their own."""


@dataclass(frozen=True, eq=False)
class TubeRadii:
    """Radii in metres, constant over BIN seconds from ``start``.

    ``pieces`` (k, n − 1, 16) is the radius of each dyadic piece by its heap number, in each of k
    intervals; ``_most`` (levels, k, n − 1, 16) the largest of 1, 2, 4, … intervals from each on,
    ``_least`` (k, n − 1, 16) the smallest radius of the parts of a piece.
    """

    start: float
    pieces: Floats = field(repr=False)
    _most: Floats = field(repr=False)
    _least: Floats = field(repr=False)

    @staticmethod
    def of_leaves(start: float, leaves: Floats) -> "TubeRadii":
        """Return the radii of all pieces from those (k, n − 1, 8) of the finest."""
        pieces, least = np.zeros((2, *leaves.shape[:2], 2 * LEAVES))
        pieces[:, :, LEAVES:] = least[:, :, LEAVES:] = leaves
        for number in range(LEAVES - 1, 0, -1):
            parts = slice(2 * number, 2 * number + 2)
            pieces[:, :, number] = pieces[:, :, parts].max(axis=2)
            least[:, :, number] = least[:, :, parts].min(axis=2)
        return TubeRadii(start, pieces, _range_maxima(pieces), least)

    @property
    def whole(self) -> Floats:
        """The radii (k, n − 1) of whole strands, metres."""
        return np.asarray(self.pieces[:, :, 1])

    @property
    def largest(self) -> float:
        """The largest radius of all."""
        return float(self.whole.max())

    def strands(self, time: float) -> Floats:
        """Return the radii (n − 1,) of whole strands at a mission time."""
        found: Floats = self.whole[self._bins(np.array(time))]
        return found

    @property
    def tables(self) -> "TubeTables":
        """The radii for compiled code."""
        return TubeTables(self.start, self.pieces, self._most, self._least)

    def _bins(self, time: Floats) -> Ints:
        number = np.floor((time - self.start) / BIN).astype(np.intp)
        found: Ints = np.minimum(np.maximum(number, 0), len(self.pieces) - 1)
        return found


class TubeTables(NamedTuple):
    """Radii as of :class:`TubeRadii`: of pieces, the ``most`` in runs of intervals, the ``least``.

    Empty where strands do not swing.
    """

    start: float
    pieces: Floats3
    most: Floats4
    least: Floats3

    @staticmethod
    def none() -> "TubeTables":
        """Return the tables of strands that do not swing."""
        return TubeTables(0.0, np.empty((0, 0, 0)), np.empty((0, 0, 0, 0)), np.empty((0, 0, 0)))


class Radii(NamedTuple):
    """Radii of a piece: the ``most`` in an interval of time, that ``now`` at its middle.

    ``least`` is the smallest of the parts of the piece at the middle.
    """

    most: float
    now: float
    least: float


@inner
def radii_over(tube: TubeTables, segment: int, number: int, interval: tuple[float, float]) -> Radii:
    """Return bounds of the radii of a piece with a heap number, in an interval of time.

    ``interval`` is its middle and its half width, seconds.
    """
    if len(tube.pieces) == 0:
        return Radii(0.0, 0.0, 0.0)
    time, half = interval
    first, last = _bin(tube, time - half), _bin(tube, time + half)
    level, count = 0, 1
    while 2 * count <= last - first + 1:
        level, count = level + 1, 2 * count
    while number >= 2 * LEAVES:
        number //= 2
    most = max(
        tube.most[level, first, segment, number],
        tube.most[level, last - count + 1, segment, number],
    )
    middle = _bin(tube, time)
    return Radii(most, tube.pieces[middle, segment, number], tube.least[middle, segment, number])


@inner
def _bin(tube: TubeTables, time: float) -> int:
    """Return the interval of the tube in which a time lies; the nearest one outside of all."""
    return min(max(int(np.floor((time - tube.start) / BIN)), 0), len(tube.pieces) - 1)


def _range_maxima(values: Floats) -> Floats:
    """Return the maxima over 1, 2, 4, … entries from each one on, padded with the last."""
    found, size = [values], 1
    while 2 * size <= len(values):
        before = found[-1]
        shifted = np.concatenate([before[size:], np.repeat(before[-1:], size, axis=0)])
        found.append(np.maximum(before, shifted))
        size *= 2
    return np.stack(found)
