"""Who passes over whom while a team folds: what must not change while its vehicles give way."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from swarm.fold.clear import Strands, meeting
from swarm.fold.tangles import heights_over

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.intp]
Signs = npt.NDArray[np.int8]


@dataclass(frozen=True, eq=False)
class Sides:
    """Who is to pass over whom: 1 where the first passes over the second, −1 under, 0 where free.

    ``strands`` (s, pairs) are of two strands, in the order of :func:`pairs`; ``bodies``
    (s, n, n − 1) of vehicles and strands.
    """

    strands: Signs
    bodies: Signs

    def __getitem__(self, moments: Ints) -> "Sides":
        return Sides(self.strands[moments], self.bodies[moments])


def pairs(count: int) -> tuple[Ints, Ints]:
    """All pairs (p,) and (p,) of ``count`` segments that do not share a vehicle."""
    first, second = np.triu_indices(count, 2)
    return first, second


def sides_of(hung: Strands, around: int) -> Sides:
    """Which of strands (s, n − 1) are to pass over others, and which vehicles over which strands.

    Over a time in which two strands cross in plan view one of them is over the other. If that time
    ends with the motion, it is the one that is over at the end; else the one that mostly is. The
    vehicle whose passing begins or ends that time passes on its strand's side. All that counts
    for ``around`` moments before and after, too: who gives way may cross a little sooner or later.
    """
    moments, count = hung.ratio.shape
    first, second = pairs(count)
    found = np.zeros((moments, len(first)), dtype=np.int8)
    bodies = np.zeros((moments, count + 1, count), dtype=np.int8)
    over = np.empty(moments)
    for p, (one, other) in enumerate(zip(first, second, strict=True)):
        heights_over(hung.points[:, one], hung.points[:, other], over)
        crossing = over != 0.0
        if not crossing.any():
            continue
        edges = np.diff(crossing, prepend=False)
        number = np.cumsum(edges) * crossing
        mostly = np.bincount(number, over)
        if crossing[-1]:
            mostly[number[-1]] = over[-1]
        found[:, p] = _longer(np.sign(mostly[number]) * crossing, around)
        begins = np.flatnonzero(edges & crossing)
        ends = np.flatnonzero(np.diff(crossing, append=crossing[-1]) & crossing)
        for moment in np.concatenate([begins, ends]):
            side = found[moment, p]
            vehicle, strand = _passing(hung, moment, one, other)
            near = slice(max(moment - around, 0), moment + around + 1)
            bodies[near, vehicle, strand] = side if strand == other else -side
    return Sides(found, bodies)


def _longer(sides: Floats, around: int) -> Floats:
    """Sides (s,), where there are none taken from the nearest moment that is at most so far."""
    known = np.flatnonzero(sides)
    moments = np.arange(len(sides))
    after = np.minimum(np.searchsorted(known, moments), len(known) - 1)
    before = np.maximum(after - 1, 0)
    nearer = np.abs(known[before] - moments) < np.abs(known[after] - moments)
    nearest = known[np.where(nearer, before, after)]
    found: Floats = sides[nearest] * (np.abs(nearest - moments) <= around)
    return found


def _passing(hung: Strands, moment: int, one: int, other: int) -> tuple[int, int]:
    """The vehicle that just passes a strand, where two begin or cease to cross, and the strand."""
    pair = hung[moment : moment + 1, one], hung[moment : moment + 1, other]
    here, there = (float(share[0]) for share in meeting(*pair))
    ends = [(here, one, other), (1.0 - here, one + 1, other)]
    ends += [(there, other, one), (1.0 - there, other + 1, one)]
    _, vehicle, strand = min(ends)
    return vehicle, strand
