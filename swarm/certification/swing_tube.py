"""The tube of the swinging cable: how far each part of a strand gets from its catenary.

It contains all strays that :mod:`.swing_runs` simulates, and bounds of what lies between the
simulated moments and of the error of the model: in the planned motion, and after ordinary and
urgent stops, rewinds and resumes of the mission clock at any moment.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import lru_cache, partial
from itertools import chain
from typing import Any

import numpy as np
import numpy.typing as npt

from swarm.certification.approaches import (
    ClosePairs,
    close_pairs,
    collect_approaches,
    collect_distances,
    collect_settling,
)
from swarm.certification.compared_pairs import exempt_length
from swarm.certification.swing_runs import (
    EVERY,
    SETTLING,
    STEP,
    aloft,
    planned_swing,
    swings_after,
)
from swarm.planning import Plan, digest
from swarm.threads import side_by_side

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.intp]

BIN = 0.5
"""Seconds of mission time over which the tube is constant."""

BETWEEN_SAMPLES = 0.05
"""Share by which a stray can be larger between compared moments: ω²h²/8 for h = 0.1 s and a period
of 1 s, shorter than the first lateral mode of strands with a sag of 0.3 m."""

BETWEEN_STOPS = 0.005
"""Metres by which the stray after a stop can exceed those after the stops before and after it:
measured for stops every 0.25 s in the default overhand and figure-eight, with fold.swing."""

MODEL_ERROR = 0.006
"""Metres by which a finer chain strays farther: 2 mm with 96 links and 2.5 ms in the default
missions with fold.swing, 6 mm in the overhand without."""

_PLANNED = "planned motion"
"""Name of the motion without a change of the clock's rate, beside those of courses."""

_LAST = round(SETTLING / (EVERY * STEP))
"""Compared moments at the end of a stop that show the amplitudes."""

_LEAVES = 8
"""Equal parts of a strand with a radius of their own; dyadic pieces of them have heap numbers."""


@dataclass(frozen=True, eq=False)
class SwingTube:
    """Radii of the tube in metres, constant over BIN seconds from ``start``.

    ``planned`` (k, n − 1) are the simulated strays in the planned motion, ``changed`` the largest
    stray after each change of the clock's rate, by its name; ``radius`` (k, n − 1, 16) is the
    radius of each dyadic piece by its heap number (1: the whole strand; finest: eighths). ``close``
    are the pairs of strands that are near each other in the middles of the intervals, ``approach``
    (r,) how much nearer they come as both swing, with the same bounds.
    """

    start: float
    planned: Floats = field(repr=False)
    changed: dict[str, float]
    radius: Floats = field(repr=False)
    close: ClosePairs = field(repr=False)
    approach: Floats = field(repr=False)
    _most: Floats = field(repr=False)
    _least: Floats = field(repr=False)

    @property
    def times(self) -> Floats:
        """Middles (k,) of the intervals, mission time in seconds."""
        return np.asarray(self.start + BIN * (np.arange(len(self.radius)) + 0.5))

    @property
    def largest(self) -> float:
        """The largest radius of all."""
        return float(self.radius[:, :, 1].max())

    def strands(self, time: float) -> Floats:
        """Return the radii (n − 1,) of whole strands at a mission time."""
        found: Floats = self.radius[self._bins(np.array(time)), :, 1]
        return found

    def at(self, segment: int, time: float, fraction: float) -> float:
        """Return the radius of a segment at a mission time and a fraction of its length."""
        leaf = _LEAVES + min(int(fraction * _LEAVES), _LEAVES - 1)
        return float(self.radius[self._bins(np.array(time)), segment, leaf])

    def over(self, segment: Ints, time: Floats, half: Floats, number: Ints) -> "Radii":
        """Return bounds of the radii (b,) of pieces of segments during ``time`` ± ``half``."""
        first, last = self._bins(time - half), self._bins(time + half)
        level = np.frexp(last - first + 1)[1] - 1
        piece = _coarser(number)
        size = np.left_shift(1, level)
        most = np.maximum(
            self._most[level, first, segment, piece],
            self._most[level, last - size + 1, segment, piece],
        )
        middle = self._bins(time)
        return Radii(most, self.radius[middle, segment, piece], self._least[middle, segment, piece])

    def _bins(self, time: Floats) -> Ints:
        number = np.floor((time - self.start) / BIN).astype(np.intp)
        found: Ints = np.clip(number, 0, len(self.radius) - 1)
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


def swing_tube(plan: Plan) -> SwingTube | None:
    """Return the tube of a plan's cable from the beginning of the fold to the end of its flight.

    None for a plan without a fold of cable, and where a chord exceeds its cable, which the checks
    of lengths report.
    """
    return _tube_of(_Named(digest(plan), plan))


@dataclass(frozen=True)
class _Named:
    digest: str
    plan: Plan = field(compare=False)


@lru_cache(maxsize=8)
def _tube_of(named: _Named) -> SwingTube | None:
    """Every call of the certificate's search needs the tube; its plan is told by its digest."""
    plan = named.plan
    span = aloft(plan)
    if span is None:
        return None
    count = int(np.ceil((span[1] - span[0]) / BIN))
    middles = np.asarray(span[0] + BIN * (np.arange(count) + 0.5), dtype=np.float64)
    tasks: tuple[Callable[[], Any], ...] = (
        partial(close_pairs, plan, middles, exempt_length(plan)),
        partial(planned_swing, plan, span),
    )
    close, without_stops = side_by_side(lambda task: task(), tasks)
    approach = np.zeros(len(close.bins))
    found: dict[str, Floats] = {}
    for swung in chain([without_stops.swung], swings_after(plan, span, without_stops)):
        bins = np.minimum(((swung.times - span[0]) / BIN).astype(np.intp), count - 1)
        strays = swung.strays.reshape(-1, *swung.strays.shape[2:])
        name = swung.course.name if swung.course else _PLANNED
        most = found.setdefault(name, np.zeros((count, *strays.shape[1:3])))
        collect_distances(bins.ravel(), strays, most)
        collect_approaches(close, bins.ravel(), strays, approach)
        if swung.course is not None and swung.course.target == 0.0:
            for last, strays in zip(bins[:, -1].tolist(), swung.strays[:, -_LAST:], strict=True):
                collect_settling(close, last, strays, approach)
    approach = (1.0 + BETWEEN_SAMPLES) * approach + 2.0 * (BETWEEN_STOPS + MODEL_ERROR)
    return _tube(span[0], found, close, approach)


def _tube(start: float, found: dict[str, Floats], close: ClosePairs, approach: Floats) -> SwingTube:
    """Return the tube of the largest strays (k, n − 1, links + 1) in each interval, by motion.

    A stop between two simulated ones passes through each mission time at most half an interval from
    where one of them does: the intervals before and after count, too.
    """
    most = np.maximum.reduce(list(found.values()))
    wide = np.pad(most, ((1, 1), (0, 0), (0, 0)), mode="edge")
    most = np.maximum(most, np.maximum(wide[:-2], wide[2:]))
    links = (most.shape[2] - 1) // _LEAVES
    leaves = [most[:, :, k * links : (k + 1) * links + 1].max(axis=2) for k in range(_LEAVES)]
    radius, least = np.zeros((2, *most.shape[:2], 2 * _LEAVES))
    radius[:, :, _LEAVES:] = (1.0 + BETWEEN_SAMPLES) * np.stack(leaves, axis=2)
    radius[:, :, _LEAVES:] += BETWEEN_STOPS + MODEL_ERROR
    least[:, :, _LEAVES:] = radius[:, :, _LEAVES:]
    for number in range(_LEAVES - 1, 0, -1):
        parts = slice(2 * number, 2 * number + 2)
        radius[:, :, number] = radius[:, :, parts].max(axis=2)
        least[:, :, number] = least[:, :, parts].min(axis=2)
    planned = found[_PLANNED].max(axis=2)
    changed = {name: float(strays.max()) for name, strays in found.items() if name != _PLANNED}
    return SwingTube(start, planned, changed, radius, close, approach, _range_maxima(radius), least)


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
