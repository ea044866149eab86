"""The smallest value of many functions of time and place, enclosed by bisection.

A *box* is a pair of things, an interval of mission time, and a dyadic piece of each of the two. An
evaluator encloses the pair's smallest margin in a box from below, and says what it is somewhere in
it. Boxes that cannot hold one of the smallest margins any more, but for a tolerance, are put aside
with their lower bound; the others are cut where they are least certain.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.intp]

TOLERANCE = 0.004
"""By how much, in metres, a reported margin may fall short of the true one."""

MOMENTS = 5
"""How many of the tightest pairs are told exactly; of the others, that they are not tighter."""

_SURELY = 0.05
"""Margins by so much of the tolerance above 0 are shown not to be negative."""

_SMALLEST_HALF = 1e-6
_DEEPEST_PIECE = 2**20

MOST_BOXES = 500_000
MOST_PER_ROOT = 128
"""A search ends after so many boxes, and so many for each that it began with: what is not shown by
then is not shown."""

_PORTION = 2**17
"""Boxes that are looked at together: what they take of memory is bounded."""


@dataclass(frozen=True, eq=False)
class Boxes:
    """m boxes: pair, middle and half width in time, heap number of a piece of each thing.

    ``known`` is what margins in each box have been shown to be at least.
    """

    pair: Ints
    time: Floats
    half: Floats
    first: Ints
    second: Ints
    known: Floats

    def __len__(self) -> int:
        return len(self.pair)

    def taken(self, where: npt.NDArray[np.bool_] | Ints) -> "Boxes":
        """Return some of them."""
        return Boxes(
            self.pair[where],
            self.time[where],
            self.half[where],
            self.first[where],
            self.second[where],
            self.known[where],
        )

    def instants(self) -> tuple[Floats, Floats, Ints]:
        """Return the different middles, their half widths, and which of them each box has."""
        time, first, which = np.unique(self.time, return_index=True, return_inverse=True)
        return time, self.half[first], which


@dataclass(frozen=True, eq=False)
class Enclosure:
    """Margins of m boxes: none smaller than ``low``; about ``high`` at ``place`` (m, 3).

    ``doubts`` (m, 3) says how much of the difference comes from the width in time, and from the
    sizes of the first and of the second piece.
    """

    low: Floats
    high: Floats
    doubts: Floats
    place: Floats


@dataclass(frozen=True, eq=False)
class Minima:
    """Per pair: a lower bound of its margin, the margin found, and when and where (q, 3).

    The bound is −∞ where nothing could be shown of a pair.
    """

    low: Floats
    high: Floats
    time: Floats
    place: Floats
    boxes: int

    def tightest(self, count: int = MOMENTS) -> Ints:
        """Return the pairs with the smallest margins, tightest first.

        Those that cannot be shown to have a margin come before all others.
        """
        margin = np.where(self.low < 0.0, self.low, self.high)
        found: Ints = np.argsort(margin, kind="stable")[:count]
        return found


Evaluator = Callable[[Boxes], Enclosure]


def roots(pairs: int, spans: list[tuple[float, float]], width: float) -> Boxes:
    """Return boxes of at most ``width`` seconds for all pairs over the given spans of time."""
    middles: list[Floats] = [np.empty(0)]
    halves: list[Floats] = [np.empty(0)]
    for start, end in spans:
        count = max(1, int(np.ceil((end - start) / width)))
        half = 0.5 * (end - start) / count
        middles.append(start + half * np.arange(1.0, 2.0 * count, 2.0))
        halves.append(np.full(count, half))
    times, widths = np.concatenate(middles), np.concatenate(halves)
    pair = np.repeat(np.arange(pairs), len(times))
    return whole(pair, np.tile(times, pairs), np.tile(widths, pairs))


def whole(pair: Ints, time: Floats, half: Floats) -> Boxes:
    """Return boxes (m,) of pairs at times and within half widths, of which nothing is known."""
    ones = np.ones(len(pair), dtype=np.intp)
    return Boxes(pair, time, half, ones, ones, np.full(len(pair), -np.inf))


def smallest(
    evaluate: Evaluator,
    pairs: int,
    boxes: Boxes,
    *,
    tolerance: float = TOLERANCE,
    below: float = np.inf,
) -> Minima:
    """Enclose every pair's smallest margin over its boxes.

    The MOMENTS tightest pairs are told to ``tolerance``, or to 5 % of the margin (10 % of a
    shortfall) where that is more; of the others ``low`` is a true lower bound, not below that of
    the tightest. Near 0 margins are told more exactly, for nothing to fail by tolerance alone.
    Where ``below`` is given, all pairs are told of which the margin is less, and nothing of others.
    The search ends after MOST_BOXES boxes, with what is shown by then; a pair of which no box has a
    margin is one of which nothing is shown.
    """
    low, high = np.full(pairs, np.inf), np.full(pairs, np.inf)
    time, place = np.full(pairs, np.nan), np.full((pairs, 3), np.nan)
    time[boxes.pair] = boxes.time
    count, most = 0, _most(boxes)
    while len(boxes):
        count += len(boxes)
        found = _evaluated(evaluate, boxes)
        _note(boxes, found, high, time, place)
        limit = high if below < np.inf else np.minimum(high, _nth_smallest(high, MOMENTS))
        limit = np.minimum(_doubted(limit, high, tolerance), below)
        done = (found.low >= limit[boxes.pair]) | _exhausted(boxes, found) | (count >= most)
        np.minimum.at(low, boxes.pair[done], found.low[done])
        boxes = _cut(boxes, found, ~done)
    return Minima(np.where(low < np.inf, low, -np.inf), high, time, place, count)


def _most(boxes: Boxes) -> int:
    """How many boxes a search may look at that begins with some."""
    return MOST_BOXES + MOST_PER_ROOT * len(boxes)


def _exhausted(boxes: Boxes, found: Enclosure) -> npt.NDArray[np.bool_]:
    """Boxes that are not to be cut: they are too small, nothing counts there, or is a number."""
    deepest = np.maximum(boxes.first, boxes.second)
    small = (boxes.half < _SMALLEST_HALF) | (deepest > _DEEPEST_PIECE)
    done: npt.NDArray[np.bool_] = small | (found.low == np.inf) | (found.high == -np.inf)
    return done


def _doubted(limit: Floats, high: Floats, tolerance: float) -> Floats:
    """Where to stop looking at margins of which the smallest found are ``high``."""
    finite = np.where(np.isfinite(limit), limit, 0.0)
    lower = limit - np.maximum(tolerance, np.maximum(0.05 * finite, -0.1 * np.minimum(high, 0.0)))
    doubtful = (lower < 0.0) & (limit > _SURELY * tolerance)
    return np.where(doubtful, 0.0, lower)


def short_boxes(evaluate: Evaluator, boxes: Boxes) -> Minima:
    """Enclose the smallest margin of every given box by itself, of those where it is negative."""
    alone = replace(boxes, pair=np.arange(len(boxes)))

    def apart(cut: Boxes) -> Enclosure:
        return evaluate(replace(cut, pair=boxes.pair[cut.pair]))

    return smallest(apart, len(boxes), alone, below=0.0)


def holds(evaluate: Evaluator, boxes: Boxes) -> bool:
    """Whether every margin is certified not to be negative; stops at the first that is."""
    return failing(evaluate, boxes) is None


def failing(evaluate: Evaluator, boxes: Boxes) -> tuple[int, float] | None:
    """Return pair and time of a margin that cannot be certified not to be negative, if any.

    So is a pair of which no box has a margin, and what is not shown after MOST_BOXES boxes.
    """
    count, most = 0, _most(boxes)
    first = boxes
    counted = np.zeros(int(boxes.pair.max(initial=-1)) + 1, dtype=bool)
    while len(boxes):
        count += len(boxes)
        found = _evaluated(evaluate, boxes)
        counted[boxes.pair[found.low < np.inf]] = True
        open_yet = found.low < 0.0
        narrow = found.doubts.sum(axis=1) < 0.5 * TOLERANCE
        given_up = _exhausted(boxes, found) | narrow | (count >= most)
        lost = (found.high < 0.0) | (open_yet & given_up)
        if lost.any():
            worst = int(np.argmin(np.where(lost, found.high, np.inf)))
            return int(boxes.pair[worst]), float(boxes.time[worst])
        boxes = _cut(boxes, found, open_yet)
    unseen = np.flatnonzero(~counted[first.pair])
    return (int(first.pair[unseen[0]]), float(first.time[unseen[0]])) if len(unseen) else None


def _evaluated(evaluate: Evaluator, boxes: Boxes) -> Enclosure:
    """Enclose margins in boxes; what was shown of larger boxes holds in their parts, too.

    Of what is not a number nothing is known: its bound is −∞, and so is what is found there.
    """
    found = _in_portions(evaluate, boxes)
    unknown = np.isnan(found.low) | np.isnan(found.high)
    low = np.where(unknown, -np.inf, np.maximum(found.low, boxes.known))
    high = np.where(unknown, -np.inf, np.maximum(found.high, low))
    doubts = np.where(np.isnan(found.doubts), np.inf, found.doubts)
    return replace(found, low=low, high=high, doubts=doubts)


def _in_portions(evaluate: Evaluator, boxes: Boxes) -> Enclosure:
    if len(boxes) <= _PORTION:
        return evaluate(boxes)
    parts = [
        evaluate(boxes.taken(np.arange(begin, min(begin + _PORTION, len(boxes)))))
        for begin in range(0, len(boxes), _PORTION)
    ]
    return Enclosure(
        np.concatenate([part.low for part in parts]),
        np.concatenate([part.high for part in parts]),
        np.concatenate([part.doubts for part in parts]),
        np.concatenate([part.place for part in parts]),
    )


def _note(boxes: Boxes, found: Enclosure, high: Floats, time: Floats, place: Floats) -> None:
    """Remember each pair's smallest margin found, and when and where."""
    order = np.lexsort((found.high, boxes.pair))
    pair, index = np.unique(boxes.pair[order], return_index=True)
    best = order[index]
    better = found.high[best] < high[pair]
    pair, best = pair[better], best[better]
    high[pair], time[pair], place[pair] = found.high[best], boxes.time[best], found.place[best]


def _nth_smallest(values: Floats, count: int) -> float:
    if len(values) <= count:
        return np.inf
    return float(np.partition(values, count - 1)[count - 1])


def _cut(boxes: Boxes, found: Enclosure, where: npt.NDArray[np.bool_]) -> Boxes:
    """Halve some of the boxes, in all dimensions that matter about as much as the worst."""
    doubts = found.doubts[where]
    boxes = replace(boxes.taken(where), known=found.low[where])
    worst = doubts.max(axis=1)
    for dimension in range(3):
        split = doubts[:, dimension] >= 0.5 * worst
        whole, halved = boxes.taken(~split), boxes.taken(split)
        doubts = np.concatenate([doubts[~split], doubts[split], doubts[split]])
        worst = np.concatenate([worst[~split], worst[split], worst[split]])
        boxes = _joined(whole, *_halves(halved, dimension))
    return boxes


def _halves(boxes: Boxes, dimension: int) -> tuple[Boxes, Boxes]:
    if dimension == 0:
        half = 0.5 * boxes.half
        before, after = boxes.time - half, boxes.time + half
        return replace(boxes, time=before, half=half), replace(boxes, time=after, half=half)
    name = "first" if dimension == 1 else "second"
    piece = 2 * getattr(boxes, name)
    return replace(boxes, **{name: piece}), replace(boxes, **{name: piece + 1})


def _joined(*parts: Boxes) -> Boxes:
    return Boxes(
        np.concatenate([part.pair for part in parts]),
        np.concatenate([part.time for part in parts]),
        np.concatenate([part.half for part in parts]),
        np.concatenate([part.first for part in parts]),
        np.concatenate([part.second for part in parts]),
        np.concatenate([part.known for part in parts]),
    )
