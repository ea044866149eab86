"""Teams that are stuck: strands led through each other, which giving way a little does not undo.

One vehicle after another of those that are pushed hardest is moved aside for a while, one way after
another, and all give way from there: basin hopping (Wales and Doye 1997) by a fixed list of hops.
"""

from itertools import product

import numpy as np
import numpy.typing as npt

from swarm.folding.optimizer import RELAXING, ElasticBand

Floats = npt.NDArray[np.float64]

_SPOTS = 4
"""So many moments a team is freed at, at most."""

_FREE = 0.45
"""Units of missed margin up to which a moment does not count as stuck."""

_PUSHED = 2
"""So many vehicles are moved aside, those that are pushed hardest first."""

_HOPS = ((1.7, 4.0, 24), (2.9, 6.0, 32))
"""How far aside, in distances that vehicles keep; over how many stages, as a Gaussian's deviation;
stages before and after in which all may give way."""

_WAYS = np.array([[1.0, 0, 0], [0, 1.0, 0], [0, 0, -1.0], [-1.0, 0, 0], [0, -1.0, 0], [0, 0, 1.0]])


def basin_hopping(band: ElasticBand, offsets: Floats) -> Floats:
    """Offsets (c, n, 3) with which a team is stuck at fewer moments; the same where none is found.

    ``offsets`` (c, n, 3) are what to begin with.
    """
    for _ in range(_SPOTS):
        strain = band.strain(offsets, wishes=False)
        worst = int(strain.missed.argmax())
        if strain.missed[worst] <= _FREE**2:
            break
        pushed = np.linalg.norm(strain.slopes[worst], axis=1)
        found = _hopped(band, offsets, worst // band.density, np.argsort(-pushed)[:_PUSHED])
        if found is None:
            break
        offsets = found
    return offsets


def _hopped(
    band: ElasticBand, offsets: Floats, stage: int, who: npt.NDArray[np.intp]
) -> Floats | None:
    """Offsets with which nobody is stuck about a stage, by moving one of some vehicles aside."""
    margins = band.crew.margins
    apart = margins.vehicle + 2.0 * margins.tracking
    for (far, long, near), way, vehicle in product(_HOPS, _WAYS, who):
        begin, end = stage - near, stage + near
        if begin < 0 or end > len(offsets):
            continue
        bump = np.exp(-0.5 * ((np.arange(begin, end) - stage) / long) ** 2)
        moved = offsets.copy()
        moved[begin:end, vehicle] += far * apart * bump[:, None] * way
        moved = band.relaxed(moved, slice(begin, end), RELAXING)
        moments = slice(begin * band.density, end * band.density)
        if band.strain(moved, moments, wishes=False).missed.max() <= _FREE**2:
            return moved
    return None
