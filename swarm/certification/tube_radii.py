"""Radii of a tube around each part of each strand, constant over short intervals of time.

The parts are dyadic pieces of a strand, numbered as in a heap: 1 is the whole strand, 8 to 15 its
eighths.
"""

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

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

    def over(self, segment: Ints, time: Floats, half: Floats, number: Ints) -> "Radii":
        """Return bounds of the radii (b,) of pieces of segments during ``time`` ± ``half`` seconds.

        ``segment``, ``time``, ``half`` and ``number``, the heap numbers of the pieces, are (b,).
        """
        first, middle, last = self._bins(np.stack([time - half, time, time + half]))
        level = np.frexp(last - first + 1)[1] - 1
        piece = _coarser(number)
        size = np.left_shift(1, level)
        most = np.maximum(
            self._most[level, first, segment, piece],
            self._most[level, last - size + 1, segment, piece],
        )
        return Radii(most, self.pieces[middle, segment, piece], self._least[middle, segment, piece])

    def _bins(self, time: Floats) -> Ints:
        number = np.floor((time - self.start) / BIN).astype(np.intp)
        found: Ints = np.minimum(np.maximum(number, 0), len(self.pieces) - 1)
        return found


@dataclass(frozen=True, eq=False)
class Radii:
    """Radii (b,) of pieces: the ``most`` in an interval of time, that ``now`` at its middle.

    ``least`` is the smallest of the parts of the piece at the middle.
    """

    most: Floats
    now: Floats
    least: Floats

    @property
    def in_time(self) -> Floats:
        """The part of the uncertainty that the interval causes."""
        return self.most - self.now

    @property
    def in_piece(self) -> Floats:
        """The part of the uncertainty that the size of the piece causes."""
        return self.now - self.least

    @staticmethod
    def none(count: int) -> "Radii":
        """Return the radii of strands without swing."""
        zero = np.zeros(count)
        return Radii(zero, zero, zero)


def _range_maxima(values: Floats) -> Floats:
    """Return the maxima over 1, 2, 4, … entries from each one on, padded with the last."""
    found, size = [values], 1
    while 2 * size <= len(values):
        before = found[-1]
        shifted = np.concatenate([before[size:], np.repeat(before[-1:], size, axis=0)])
        found.append(np.maximum(before, shifted))
        size *= 2
    return np.stack(found)


def _coarser(number: Ints) -> Ints:
    """Return the heap numbers of the eighths that contain finer pieces."""
    depth = np.frexp(number)[1] - 4
    found: Ints = np.right_shift(number, np.maximum(depth, 0))
    return found
