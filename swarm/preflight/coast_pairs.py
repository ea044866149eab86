"""Which pairs of a team come how near after lost setpoints, box by box of a coast; compiled.

Boxes (m,) have a ``case`` (0: all have lost the stream, else that vehicle) and a ``half`` width in
time; their middles have everybody's ``place`` (m, n, 3), how fast they go ``along`` with the time,
and how much else they may move, ``loose`` (m, n). A case touches the pairs which its vehicle holds:
what all others keep among themselves is as certified.
"""

import numpy as np
import numpy.typing as npt

from swarm.compiled import compiled

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.intp]


@compiled
def left_of_pairs(
    case: Ints,
    half: Floats,
    place: Floats,
    along: Floats,
    loose: Floats,
    tautest: Floats,
    beside: float,
    under: float,
    low: Floats,
    here: Floats,
) -> None:
    """Write bounds (m,) of what is left of chords and between vehicles, and what is in the middle.

    Chords may be as long as ``tautest`` (n − 1,); vehicles keep ``beside`` or ``under``, metres.
    """
    for m in range(len(case)):
        low[m] = here[m] = np.inf
        for i in range(place.shape[1]):
            for j in range(i + 1, place.shape[1]):
                if case[m] > 0 and case[m] - 1 != i and case[m] - 1 != j:
                    continue
                x, y = place[m, j, 0] - place[m, i, 0], place[m, j, 1] - place[m, i, 1]
                z, turn = place[m, j, 2] - place[m, i, 2], 0.0
                for axis in range(3):
                    turn += (along[m, j, axis] - along[m, i, axis]) ** 2
                moved = np.sqrt(turn) * half[m] + loose[m, i] + loose[m, j]
                left = max(np.sqrt(x * x + y * y) - beside, abs(z) - under)
                if j == i + 1:
                    left = min(left, tautest[i] - np.sqrt(x * x + y * y + z * z))
                low[m], here[m] = min(low[m], left - moved), min(here[m], left)


@compiled
def near_strands(
    case: Ints,
    half: Floats,
    place: Floats,
    along: Floats,
    loose: Floats,
    lengths: Floats,
    required: float,
) -> tuple[Ints, Ints, Ints, Floats, Floats]:
    """Pairs of strands that share no vehicle and are not shown to keep ``required`` by their boxes.

    Returns their boxes' rows, both strands, and how far each one's ends may move.
    """
    strands = len(lengths)
    near = np.zeros((len(case), strands, strands), dtype=np.bool_)
    for m in range(len(case)):
        lost = case[m] - 1
        for i in range(strands):
            for j in range(i + 2, strands):
                if lost < 0 or lost in (i, i + 1, j, j + 1):
                    first, second = _moved(i, j, along[m], loose[m], half[m])
                    apart = _boxes_apart(place[m], lengths, i, j, first, second)
                    near[m, i, j] = apart < required
    row, one, other = np.nonzero(near)
    moved = np.empty((2, len(row)))
    for k in range(len(row)):
        m = row[k]
        moved[0, k], moved[1, k] = _moved(one[k], other[k], along[m], loose[m], half[m])
    return row, one, other, moved[0], moved[1]


@compiled
def _moved(i: int, j: int, along: Floats, loose: Floats, half: float) -> tuple[float, float]:
    """How far the ends of two strands may move, but for what all four go together."""
    ends = (i, i + 1, j, j + 1)
    size = np.zeros(4)
    for axis in range(3):
        mean = 0.25 * (along[i, axis] + along[i + 1, axis] + along[j, axis] + along[j + 1, axis])
        for k in range(4):
            size[k] += (along[ends[k], axis] - mean) ** 2
    for k in range(4):
        size[k] = np.sqrt(size[k]) * half + loose[ends[k]]
    return max(size[0], size[1]), max(size[2], size[3])


@compiled
def _boxes_apart(
    place: Floats, lengths: Floats, i: int, j: int, moved: float, other_moved: float
) -> float:
    """Distance that two strands keep because of the upright boxes that they cannot leave."""
    below, other_below = _dip(place, lengths, i, moved), _dip(place, lengths, j, other_moved)
    square = 0.0
    for axis in range(3):
        low = min(place[i, axis], place[i + 1, axis]) - moved
        high = max(place[i, axis], place[i + 1, axis]) + moved
        other_low = min(place[j, axis], place[j + 1, axis]) - other_moved
        other_high = max(place[j, axis], place[j + 1, axis]) + other_moved
        if axis == 2:
            low, other_low = low - below, other_low - other_below
        gap = max(low - other_high, other_low - high, 0.0)
        square += gap * gap
    return float(np.sqrt(square))


@compiled
def _dip(place: Floats, lengths: Floats, i: int, moved: float) -> float:
    """How far a strand can come down below its lower end.

    One that comes down by d is at least as long as two straight lines down to there: length² ≥
    span² + (2d + rise)².
    """
    x, y = place[i + 1, 0] - place[i, 0], place[i + 1, 1] - place[i, 1]
    span = max(np.sqrt(x * x + y * y) - 2.0 * moved, 0.0)
    rise = max(abs(place[i + 1, 2] - place[i, 2]) - 2.0 * moved, 0.0)
    return float(max(0.5 * (np.sqrt(max(lengths[i] ** 2 - span**2, 0.0)) - rise), 0.0))
