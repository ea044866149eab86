"""Branch and bound: functions of several coordinates, enclosed on boxes that are halved.

A *box* is an interval of every coordinate; it belongs to a group, for example a pair of objects. An
evaluator bounds a group's function from below on a box, and gives its value somewhere in the box.
Undecided boxes are halved in the coordinates that cause most of the uncertainty.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import reduce
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from swarm.jit import compiled, inner
from swarm.signatures import Bools2, Floats1, Floats2, Ints1, contiguous

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.intp]
Flags = npt.NDArray[np.bool_]

CUT = 0.5
"""Share of the largest uncertainty from which a coordinate is cut: coordinates that matter about
as much are cut in the same round. Of more than three coordinates, only the worst: all five at
once would make 32 boxes."""

ROUNDING = 1e-9
"""Seconds by which intervals of time are wider than their boxes: more than the rounding of times up
to :data:`swarm.planning.ranges.LATEST`, so that the parts of a box leave no gap."""

_BATCH = 2**17
"""Boxes that are evaluated together, which bounds the memory."""


@dataclass(frozen=True, eq=False)
class Boxes:
    """m boxes: group (m,), middle and half width (m, d) of d coordinates.

    ``known`` (m,) is a lower bound that is already shown for each box. Of a box for which an
    evaluator has shown the bound ``enough``, nothing else counts.
    """

    group: Ints
    middle: Floats
    half: Floats
    known: Floats
    enough: float = np.inf

    def __len__(self) -> int:
        return len(self.group)

    def taken(self, where: Flags | Ints | slice) -> "Boxes":
        """Return some of the boxes."""
        arrays = self.group[where], self.middle[where], self.half[where], self.known[where]
        return Boxes(*arrays, self.enough)

    def arrays(self) -> "BoxArrays":
        """Return the boxes for compiled code."""
        arrays = contiguous(self.group), contiguous(self.middle), contiguous(self.half)
        return BoxArrays(*arrays, self.enough)

    def instants(self) -> tuple[Floats, Floats, Ints]:
        """Return the distinct middles of time, the half widths of their intervals, and the index of
        each box's."""
        time, first, index = np.unique(self.middle[:, 0], return_index=True, return_inverse=True)
        return time, self.half[first, 0] + ROUNDING, index


class BoxArrays(NamedTuple):
    """Group (m,), middle and half width (m, d) of boxes, and the bound that is enough.

    For compiled code.
    """

    group: Ints1
    middle: Floats2
    half: Floats2
    enough: float


@inner
def same_in(boxes: BoxArrays, a: int, b: int, coordinates: int) -> bool:
    """Return whether two boxes of the same group have the same first coordinates."""
    if boxes.group[a] != boxes.group[b]:
        return False
    for k in range(coordinates):
        if boxes.middle[a, k] != boxes.middle[b, k] or boxes.half[a, k] != boxes.half[b, k]:
            return False
    return True


@dataclass(frozen=True, eq=False)
class Enclosure:
    """Values on m boxes: none below ``low``; about ``high`` at ``place`` (m, 3), ENU metres.

    ``widths`` (m, d) is the part of the difference that the width of each coordinate causes.
    """

    low: Floats
    high: Floats
    widths: Floats
    place: Floats

    @staticmethod
    def not_found(boxes: Boxes) -> "Enclosure":
        """Return the enclosure of boxes without any value, in which compiled code writes some."""
        count, coordinates = boxes.middle.shape
        low, high = np.full((2, count), np.inf)
        return Enclosure(low, high, np.zeros((count, coordinates)), np.zeros((count, 3)))

    def arrays(self) -> "EnclosureArrays":
        """Return the arrays, which compiled code may change."""
        return EnclosureArrays(self.low, self.high, self.widths, self.place)


class EnclosureArrays(NamedTuple):
    """Arrays of an :class:`Enclosure`, for compiled code."""

    low: Floats1
    high: Floats1
    widths: Floats2
    place: Floats2


Evaluator = Callable[[Boxes], Enclosure]


def search(
    evaluate: Evaluator,
    boxes: Boxes,
    undecided: Callable[[Boxes, Enclosure], Flags],
    *,
    relevant: Callable[[Boxes], Flags] | None = None,
    cut: float | None = None,
    together: int | None = None,
) -> None:
    """Evaluate boxes and halve the ``undecided`` ones, until none is left.

    ``relevant`` selects the boxes that are evaluated at all (default: all); ``cut`` is the share of
    the largest uncertainty from which a coordinate is cut. With ``together``, at most so many
    boxes are evaluated and halved before the others, those with the smallest values first.
    """
    if cut is None:
        cut = CUT if boxes.middle.shape[1] <= 3 else 1.0
    pending = [boxes]
    while pending:
        boxes = pending.pop()
        if relevant is not None:
            boxes = boxes.taken(relevant(boxes))
        if not len(boxes):
            continue
        bounds = evaluated(evaluate, boxes)
        where = np.flatnonzero(undecided(boxes, bounds))
        if together is None:
            pending.append(_halved(boxes, bounds, where, cut))
            continue
        where = where[np.argsort(-bounds.high[where], kind="stable")]
        boxes = _halved(boxes, bounds, where, cut)
        pending += [
            boxes.taken(slice(begin, begin + together)) for begin in range(0, len(boxes), together)
        ]


def evaluated(evaluate: Evaluator, boxes: Boxes) -> Enclosure:
    """Enclose values on boxes; the bound of a box holds in its parts, too.

    A value that is not a number has the bound −∞, and so has a box whose halves are too narrow to
    have middles of their own: they would leave gaps.
    """
    bounds = _in_batches(evaluate, boxes)
    unknown = np.isnan(bounds.low) | np.isnan(bounds.high)
    closed = (boxes.half > 0.0) & (0.5 * boxes.half <= np.spacing(np.abs(boxes.middle)))
    unknown |= closed.any(axis=1)
    low = np.where(unknown, -np.inf, np.maximum(bounds.low, boxes.known))
    high = np.where(unknown, -np.inf, np.maximum(bounds.high, low))
    uncertainty = np.where(np.isnan(bounds.widths), np.inf, bounds.widths)
    return replace(bounds, low=low, high=high, widths=uncertainty)


def _in_batches(evaluate: Evaluator, boxes: Boxes) -> Enclosure:
    if len(boxes) <= _BATCH:
        return evaluate(boxes)
    parts = [
        evaluate(boxes.taken(slice(begin, begin + _BATCH)))
        for begin in range(0, len(boxes), _BATCH)
    ]
    return Enclosure(
        np.concatenate([part.low for part in parts]),
        np.concatenate([part.high for part in parts]),
        np.concatenate([part.widths for part in parts]),
        np.concatenate([part.place for part in parts]),
    )


def _halved(boxes: Boxes, bounds: Enclosure, where: Ints, cut: float) -> Boxes:
    """Halve some of the boxes in every coordinate with at least ``cut`` of the largest width.

    The halves of a box follow each other: what they share is computed once for both.
    """
    uncertainty = bounds.widths[where]
    splits = uncertainty >= cut * reduce(np.maximum, uncertainty.T)[:, None]
    parts = 1 << splits.sum(axis=1)
    group, known = np.repeat(boxes.group[where], parts), np.repeat(bounds.low[where], parts)
    middle, half = np.empty((2, len(group), uncertainty.shape[1]))
    _write_halves(boxes.arrays(), where, splits, middle, half)
    return Boxes(group, middle, half, known, boxes.enough)


@compiled
def _write_halves(
    boxes: BoxArrays, where: Ints1, splits: Bools2, middle: Floats2, half: Floats2
) -> None:
    """Write middles and half widths of the halves of some boxes, in the coordinates (b, d) that are
    split: the lower ones first, and those of the last coordinate next to each other."""
    written = 0
    for b in range(len(where)):
        parts = 1
        for k in range(splits.shape[1]):
            if splits[b, k]:
                parts *= 2
        for part in range(parts):
            bit = parts
            for k in range(splits.shape[1]):
                middle[written, k] = boxes.middle[where[b], k]
                half[written, k] = boxes.half[where[b], k]
                if splits[b, k]:
                    bit //= 2
                    half[written, k] *= 0.5
                    middle[written, k] += half[written, k] if part & bit else -half[written, k]
            written += 1
