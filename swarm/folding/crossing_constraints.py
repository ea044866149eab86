"""Who passes over whom while a team folds: what must not change while its vehicles give way."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from swarm.folding.crossings import find_crossings, required_signs
from swarm.folding.soft_constraints import Outlines

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.intp]
Signs = npt.NDArray[np.int8]


@dataclass(frozen=True, eq=False)
class CrossingSigns:
    """Who is to pass over whom: 1 where the first passes over the second, −1 under, 0 where free.

    ``strands`` (s, pairs) are of two strands, in the order of :func:`segment_pairs`; ``bodies``
    (s, n, n − 1) of vehicles and strands.
    """

    strands: Signs
    bodies: Signs

    def __getitem__(self, moments: Ints | slice) -> "CrossingSigns":
        return CrossingSigns(self.strands[moments], self.bodies[moments])


def segment_pairs(count: int) -> tuple[Ints, Ints]:
    """All pairs (p,) and (p,) of ``count`` segments that do not share a vehicle."""
    first, second = np.triu_indices(count, 2)
    return first, second


def crossing_signs(hung: Outlines, around: int) -> CrossingSigns:
    """Which of strands (s, n − 1) are to pass over others, and which vehicles over which strands.

    Those do that are over at the end, and whoever is joined to them by :mod:`.crossings`. The
    vehicle whose passing begins or ends a time in which two strands cross passes on its strand's
    side. All that counts for ``around`` moments before and after, too: who gives way may cross a
    little sooner or later.
    """
    moments, count = hung.ratio.shape
    first, second = segment_pairs(count)
    found = np.zeros((moments, len(first)), dtype=np.int8)
    bodies = np.zeros((moments, count + 1, count), dtype=np.int8)
    crossed = find_crossings(hung, first, second)
    for each, side in zip(crossed, required_signs(crossed, count), strict=True):
        found[each.begin : each.end + 1, each.pair] = side
        for passing in each.passings:
            near = slice(max(passing.moment - around, 0), passing.moment + around + 1)
            bodies[near, passing.vehicle, passing.strand] = side * each.as_passed(passing)
    for pair in np.unique([each.pair for each in crossed]).astype(np.intp):
        found[:, pair] = _longer(found[:, pair], around)
    return CrossingSigns(found, bodies)


def _longer(sides: Signs, around: int) -> Signs:
    """Sides (s,), where there are none taken from the nearest moment that is at most so far."""
    known = np.flatnonzero(sides)
    moments = np.arange(len(sides))
    after = np.minimum(np.searchsorted(known, moments), len(known) - 1)
    before = np.maximum(after - 1, 0)
    nearer = np.abs(known[before] - moments) < np.abs(known[after] - moments)
    nearest = known[np.where(nearer, before, after)]
    found: Signs = sides[nearest] * (np.abs(nearest - moments) <= around)
    return found
