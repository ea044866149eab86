"""Signs of crossings during the fold: which strand or vehicle must pass over which strand."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from swarm.folding.crossings import find_crossings, required_signs
from swarm.folding.outlines import Outlines

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.intp]
Signs = npt.NDArray[np.int8]


@dataclass(frozen=True, eq=False)
class CrossingSigns:
    """Required signs at s moments: 1 where the first passes over the second, −1 under, 0 free.

    ``strands`` (s, pairs) are of two strands, in the order of :func:`segment_pairs`; ``vehicles``
    (s, n, n − 1) of vehicles and strands.
    """

    strands: Signs
    vehicles: Signs

    def __getitem__(self, moments: Ints | slice) -> "CrossingSigns":
        return CrossingSigns(self.strands[moments], self.vehicles[moments])


def segment_pairs(count: int) -> tuple[Ints, Ints]:
    """Return all pairs (p,) and (p,) of ``count`` segments that share no vehicle."""
    first, second = np.triu_indices(count, 2)
    return first, second


def crossing_signs(strands: Outlines, around: int) -> CrossingSigns:
    """Return the signs that strands (s, n − 1) must keep so that the knot forms as planned.

    A crossing has the sign of the final crossing to which :mod:`.crossings` connects it. The
    vehicle whose passing begins or ends a crossing passes on the side of its strand. Signs also
    hold for ``around`` moments before and after: a vehicle that moves aside may cross a little
    earlier or later.
    """
    moments, count = strands.ratio.shape
    first, second = segment_pairs(count)
    signs = np.zeros((moments, len(first)), dtype=np.int8)
    vehicles = np.zeros((moments, count + 1, count), dtype=np.int8)
    crossings = find_crossings(strands, first, second)
    for crossing, sign in zip(crossings, required_signs(crossings, count), strict=True):
        signs[crossing.begin : crossing.end + 1, crossing.pair] = sign
        for passing in crossing.passings:
            near = slice(max(passing.moment - around, 0), passing.moment + around + 1)
            vehicles[near, passing.vehicle, passing.strand] = sign * crossing.sign_of(passing)
    for pair in np.unique([crossing.pair for crossing in crossings]).astype(np.intp):
        signs[:, pair] = _extended(signs[:, pair], around)
    return CrossingSigns(signs, vehicles)


def _extended(signs: Signs, around: int) -> Signs:
    """Return signs (s,) with zeros replaced by the sign of the nearest moment within ``around``."""
    nonzero = np.flatnonzero(signs)
    moments = np.arange(len(signs))
    after = np.minimum(np.searchsorted(nonzero, moments), len(nonzero) - 1)
    before = np.maximum(after - 1, 0)
    earlier = np.abs(nonzero[before] - moments) < np.abs(nonzero[after] - moments)
    nearest = nonzero[np.where(earlier, before, after)]
    extended: Signs = signs[nearest] * (np.abs(nearest - moments) <= around)
    return extended


def free_signs(moments: int, count: int) -> CrossingSigns:
    """Return the signs of ``count`` strands that may pass on any side of each other."""
    pairs = len(segment_pairs(count)[0])
    strands = np.zeros((moments, pairs), dtype=np.int8)
    return CrossingSigns(strands, np.zeros((moments, count + 1, count), dtype=np.int8))
