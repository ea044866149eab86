"""The smallest margins of pairs over time, by branch and bound.

The coordinates of a box are mission time; in wind both parts of the tilt of the effective gravity;
and, for margins of strands, the fractions between which a piece of each strand lies. The group of a
box is the number of its pair.

Theory of operation. A search begins with boxes that cover all coordinates of all pairs. For each
box an evaluator encloses the smallest margin: it is nowhere in the box below ``low``, and about
``high`` somewhere in it. A box is decided once ``low`` reaches the limit of the search, and is
halved otherwise (:mod:`.branch_and_bound`). The limit is 0 where only the sign matters
(:func:`failing`, :func:`smallest_in_boxes`), and the fifth smallest ``high`` so far, less a
tolerance, where the tightest pairs are measured (:func:`smallest`). :func:`most_steps` finds the
largest tracking radius, or tilt, in one search: it takes a smaller one where a margin is not kept.

A search shows no more than is true: boxes that are too small to be halved, that remain after
MOST_BOXES, or whose margins are not numbers are not shown, and their pair fails.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import reduce

import numpy as np
import numpy.typing as npt

from swarm.certification.branch_and_bound import Boxes, Enclosure, Evaluator, evaluated, search

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.intp]
Flags = npt.NDArray[np.bool_]
Intervals = Sequence[tuple[float, float]]

TOLERANCE = 0.004
"""Largest difference in metres between a reported margin and the true one: below what a vehicle's
position is known to."""

MOMENTS = 5
"""Number of tightest pairs with exact margins; as many as a report lists."""

_TOGETHER = 1024
"""Boxes that are halved together in the search for a largest value: so few that it soon falls, so
many that calls take little of the time."""

_CLEARLY_POSITIVE = 0.05
"""Margins above this share of the tolerance are shown not to be negative."""

_SMALLEST_HALF = 1e-6
"""Half widths, in seconds or as a share of strand or tilt, below which a box is not halved:
far below what changes a margin by the tolerance."""

MOST_BOXES, MOST_PER_ROOT = 500_000, 128
"""A search ends after MOST_BOXES boxes and MOST_PER_ROOT for each initial box: seconds of work.
Margins that are not shown by then count as not shown."""


@dataclass(frozen=True, eq=False)
class Minima:
    """Per pair (q,): a lower bound of its margin, the margin found, its time and place (q, 3).

    The bound is −∞ where none was found. ``boxes`` is the number of evaluated boxes.
    """

    low: Floats
    high: Floats
    time: Floats
    place: Floats
    boxes: int

    def tightest(self, count: int = MOMENTS) -> Ints:
        """Return the pairs with the smallest margins, tightest first.

        Pairs without a shown margin come first.
        """
        margin = np.where(self.low < 0.0, self.low, self.high)
        pairs: Ints = np.argsort(margin, kind="stable")[:count]
        return pairs


def roots(pairs: int, spans: Intervals, width: float, others: Intervals = ()) -> Boxes:
    """Return boxes of at most ``width`` seconds for all pairs over the given spans of time.

    They are as wide as the intervals of all ``others``, the coordinates beside time.
    """
    middles: list[Floats] = [np.empty(0)]
    halves: list[Floats] = [np.empty(0)]
    for start, end in spans:
        count = max(1, int(np.ceil((end - start) / width)))
        half = 0.5 * (end - start) / count
        middles.append(start + half * np.arange(1.0, 2.0 * count, 2.0))
        halves.append(np.full(count, half))
    times, widths = np.concatenate(middles), np.concatenate(halves)
    pair = np.repeat(np.arange(pairs), len(times))
    return boxes_of(pair, np.tile(times, pairs), np.tile(widths, pairs), others)


def boxes_of(pair: Ints, time: Floats, half: Floats, others: Intervals) -> Boxes:
    """Return boxes (m,) of pairs at times within half widths, as wide as all other intervals."""
    low, high = np.reshape(np.asarray(others, dtype=float), (-1, 2)).T
    middle, width = (
        np.column_stack([values, np.tile(other, (len(pair), 1))])
        for values, other in ((time, 0.5 * (low + high)), (half, 0.5 * (high - low)))
    )
    return Boxes(pair, middle, width, np.full(len(pair), -np.inf))


def smallest(
    evaluate: Evaluator,
    pairs: int,
    boxes: Boxes,
    *,
    tolerance: float = TOLERANCE,
    below: float = np.inf,
    initial: int = 0,
) -> Minima:
    """Return every pair's smallest margin over its boxes.

    ``initial`` is the number of initial boxes before some were left out, which counts for the limit
    of the search.

    The MOMENTS tightest pairs are found to ``tolerance``, or to 5 % of the margin (10 % of a
    shortfall) where that is more; for the others ``low`` is a true lower bound, not below that of
    the tightest. Margins near 0 are found more exactly, so that the tolerance alone refuses no
    plan. With ``below``, all pairs with a smaller margin are found, and no others.
    """
    low, high = np.full(pairs, np.inf), np.full(pairs, np.inf)
    time, place = np.full(pairs, np.nan), np.full((pairs, 3), np.nan)
    time[boxes.group] = boxes.middle[:, 0]
    count, most = 0, _most(boxes, initial)

    def undecided(boxes: Boxes, bounds: Enclosure) -> Flags:
        nonlocal count
        count += len(boxes)
        pair, best = _best_of_pairs(boxes, bounds)
        better = bounds.high[best] < high[pair]
        pair, best = pair[better], best[better]
        high[pair], time[pair] = bounds.high[best], boxes.middle[best, 0]
        place[pair] = bounds.place[best]
        limit = high if below < np.inf else np.minimum(high, _nth_smallest(high, MOMENTS))
        limit = np.minimum(_with_tolerance(limit, high, tolerance), below)
        done = (bounds.low >= limit[boxes.group]) | _exhausted(boxes, bounds) | (count >= most)
        np.minimum.at(low, boxes.group[done], bounds.low[done])
        return ~done

    search(evaluate, replace(boxes, enough=below), undecided)
    return Minima(np.where(low < np.inf, low, -np.inf), high, time, place, count)


def smallest_in_boxes(
    evaluate: Evaluator, boxes: Boxes, initial: int = 0, tolerance: float = TOLERANCE
) -> Minima:
    """Return the smallest margin of every given box where it is negative, to a tolerance."""
    alone = replace(boxes, group=np.arange(len(boxes)))

    def of_pair(cut: Boxes) -> Enclosure:
        return evaluate(replace(cut, group=boxes.group[cut.group]))

    return smallest(of_pair, len(boxes), alone, below=0.0, initial=initial, tolerance=tolerance)


def failing(
    evaluate: Evaluator, boxes: Boxes, initial: int = 0, tolerance: float = TOLERANCE
) -> tuple[int, float] | None:
    """Return pair and time of a margin that cannot be certified not to be negative, if any.

    A pair without a margin in any box fails, too. ``initial`` as for :func:`smallest`; margins
    whose width is half the ``tolerance`` or less are not looked at more closely.
    """
    count, most = 0, _most(boxes, initial)
    counted = np.zeros(int(boxes.group.max(initial=-1)) + 1, dtype=bool)
    failed: tuple[int, float] | None = None

    def undecided(boxes: Boxes, bounds: Enclosure) -> Flags:
        nonlocal count, failed
        count += len(boxes)
        counted[boxes.group[bounds.low < np.inf]] = True
        negative = bounds.low < 0.0
        lost = _lost(boxes, bounds, tolerance) | (negative & (count >= most))
        if lost.any():
            worst = int(np.argmin(np.where(lost, bounds.high, np.inf)))
            failed = int(boxes.group[worst]), float(boxes.middle[worst, 0])
            negative[:] = False
        return negative

    search(evaluate, replace(boxes, enough=0.0), undecided)
    unseen = np.flatnonzero(~counted[boxes.group])
    if failed is None and len(unseen):
        return int(boxes.group[unseen[0]]), float(boxes.middle[unseen[0], 0])
    return failed


def most_steps(
    at: Callable[[int], Evaluator],
    steps: int,
    boxes: Boxes,
    initial: int = 0,
    tolerance: float = TOLERANCE,
    guess: int | None = None,
) -> int:
    """Return the largest number of steps, of at most ``steps``, for which no margin is negative.

    ``at`` returns the evaluator for a number from 1 on. The boxes contain the cases of all smaller
    numbers, so what a number shows of a box holds for those, too, and is not searched again: where
    a margin is not kept, the number falls, and the search goes on with what is left. Returns 0, for
    which nothing is searched, where no other number is left. ``initial`` and ``tolerance`` as for
    :func:`failing`. With ``guess``, the search ends after that number of boxes.
    """
    count, lower, most = 0, 1, _most(boxes, initial)
    enough = most // 2
    counted = np.zeros(int(boxes.group.max(initial=-1)) + 1, dtype=bool)

    def relevant(boxes: Boxes) -> Flags:
        return np.full(len(boxes), steps > 0 and (guess is None or count < guess))

    def undecided(boxes: Boxes, bounds: Enclosure) -> Flags:
        nonlocal count, enough, lower, steps
        count += len(boxes)
        counted[boxes.group[bounds.low < np.inf]] = True
        lost = _lost(boxes, bounds, tolerance)
        if lost.any():
            steps = _fewer(at, steps, boxes.taken(lost), tolerance)
        elif count >= enough:
            # Margins that are kept may take too many boxes to show.
            enough, steps, lower = count + most // 8, max(steps - lower, 0), 4 * lower
        negative: Flags = bounds.low < 0.0
        return negative

    def evaluate(boxes: Boxes) -> Enclosure:
        return at(steps)(boxes)

    search(
        evaluate, replace(boxes, enough=0.0), undecided,
        relevant=relevant, together=_TOGETHER if guess is None else _TOGETHER // 16,
    )  # fmt: skip
    return steps if counted[boxes.group].all() else 0


def _fewer(at: Callable[[int], Evaluator], steps: int, boxes: Boxes, tolerance: float) -> int:
    """Return the largest number below ``steps`` for which none of the boxes is lost."""

    def kept(steps: int) -> bool:
        return steps <= 0 or not _lost(boxes, evaluated(at(steps), boxes), tolerance).any()

    less = 1
    while not kept(steps - less):
        less *= 2
    # Those from the first to before the second are in question.
    first, second = max(steps - less, 0), steps - less // 2
    while second - first > 1:
        middle = (first + second) // 2
        first, second = (middle, second) if kept(middle) else (first, middle)
    return first


def _lost(boxes: Boxes, bounds: Enclosure, tolerance: float) -> Flags:
    """Boxes with a negative margin, or with a doubtful one that is not looked at more closely."""
    narrow = reduce(np.add, bounds.widths.T) < 0.5 * tolerance
    lost: Flags = (bounds.high < 0.0) | ((bounds.low < 0.0) & (_exhausted(boxes, bounds) | narrow))
    return lost


def _most(boxes: Boxes, initial: int) -> int:
    """Largest number of boxes of a search with these initial ones, or with that many."""
    return MOST_BOXES + MOST_PER_ROOT * max(len(boxes), initial)


def _exhausted(boxes: Boxes, bounds: Enclosure) -> Flags:
    """Boxes that are not halved: too small, without a margin, or not a number."""
    small = reduce(np.minimum, boxes.half.T) < _SMALLEST_HALF
    done: Flags = small | (bounds.low == np.inf) | (bounds.high == -np.inf)
    return done


def _with_tolerance(limit: Floats, high: Floats, tolerance: float) -> Floats:
    """Lower bounds from which a box is decided; ``high`` are the smallest margins found."""
    finite = np.where(np.isfinite(limit), limit, 0.0)
    lower = limit - np.maximum(tolerance, np.maximum(0.05 * finite, -0.1 * np.minimum(high, 0.0)))
    doubtful = (lower < 0.0) & (limit > _CLEARLY_POSITIVE * tolerance)
    return np.where(doubtful, 0.0, lower)


def _best_of_pairs(boxes: Boxes, bounds: Enclosure) -> tuple[Ints, Ints]:
    """The pairs of the boxes, and the index of each pair's box with the smallest margin."""
    order = np.lexsort((bounds.high, boxes.group))
    pair, index = np.unique(boxes.group[order], return_index=True)
    return pair, order[index]


def _nth_smallest(values: Floats, count: int) -> float:
    if len(values) <= count:
        return np.inf
    return float(np.partition(values, count - 1)[count - 1])
