"""The certificate's distances on measured positions, now and a moment ahead.

The certificate promises clearances while everybody stays in the tracking ball. The monitor looks
at what really is: where it expects less than what the mission asks for, the clock slows down.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from swarm.cable.distance import polyline_polyline
from swarm.cable.sketch import boxes, sketch
from swarm.plans import CableState, Plan
from swarm.preflight.limits import TAUT

Floats = npt.NDArray[np.float64]

AHEAD = 1.5
"""Seconds ahead at which conflicts are looked for."""
CAUTION = 0.1
"""Metres of margin below which the clock slows; without margin it stands still."""
_POINTS = 20
_BOWED = 0.02
"""Metres by which a strand bows between two of its points, at most."""
FAR = 0.5
"""Metres beyond where distances begin to matter from which a bound is enough."""


@dataclass(frozen=True)
class Clearances:
    """Smallest distances in metres at one moment, and what is left of what the mission asks for.

    ``cable`` between strands that share no vehicle, surface to surface (infinite where nothing
    hangs; a lower bound where they are far apart); ``vehicle`` horizontally between vehicles that
    are not apart in height; ``chord`` the largest chord over length. ``margin`` is the smallest of
    what is left, in metres.
    """

    cable: float
    vehicle: float
    chord: float
    margin: float

    @property
    def pace(self) -> float:
        """Return the rate at which the clock may run, 0…1."""
        return min(1.0, max(0.0, self.margin / CAUTION))


class Monitor:
    """Distances of one plan's team."""

    def __init__(self, plan: Plan) -> None:
        n = plan.vehicles
        self._lengths = plan.layout.lengths
        self._diameter = plan.mission.cable.diameter
        self._asked = plan.mission.clearance
        self._pairs = np.triu_indices(n, 1)
        first, second = np.triu_indices(max(n - 1, 0), 2)
        self._strands = np.stack([first, second], axis=1)
        self._matters = plan.mission.clearance.cable + plan.mission.cable.diameter + 1.5 * CAUTION
        self._one, self._other = first.astype(np.intp), second.astype(np.intp)
        self._longest = TAUT * self._lengths
        self._spacing = float(self._lengths.max(initial=0.0)) / _POINTS

    def look(self, moments: Floats, cable: CableState) -> list[Clearances]:
        """Return the clearances of grip points (k, n, 3), mission ENU, at each of k moments."""
        first, second = self._pairs
        between = moments[:, first] - moments[:, second]
        level = np.hypot(between[:, :, 0], between[:, :, 1])
        upright = np.abs(between[:, :, 2])
        left = np.maximum(level - self._asked.vehicle, upright - self._asked.downwash)
        vehicle = np.where(upright < self._asked.downwash, level, np.inf).min(
            axis=1, initial=np.inf
        )
        margin = left.min(axis=1, initial=np.inf)
        if cable != "aloft":
            return [
                Clearances(np.inf, float(v), 0.0, float(m))
                for v, m in zip(vehicle, margin, strict=True)
            ]
        step = moments[:, 1:] - moments[:, :-1]
        chord = np.sqrt(np.einsum("kij,kij->ki", step, step))
        ratio = (chord / self._lengths).max(axis=1)
        margin = np.minimum(margin, (TAUT * self._lengths - chord).min(axis=1))
        strands = np.full(len(moments), np.nan)
        fits = ratio < 1.0
        if fits.any():
            strands[fits] = self._between_strands(moments[fits], FAR)
            margin = np.fmin(margin, strands - self._asked.cable)
        return [
            Clearances(float(s), float(v), float(r), float(m))
            for s, v, r, m in zip(strands, vehicle, ratio, margin, strict=True)
        ]

    def pace(self, moments: Floats, cable: CableState) -> float:
        """The rate at which the clock may run, 0…1, as the margins at the moments (k, n, 3) allow.

        As from :meth:`look`, which knows more of strands that are far apart.
        """
        first, second = self._pairs
        between = moments.take(first, axis=1) - moments.take(second, axis=1)
        level = np.sqrt(between[:, :, 0] ** 2 + between[:, :, 1] ** 2)
        level -= self._asked.vehicle
        upright = np.abs(between[:, :, 2])
        upright -= self._asked.downwash
        margin = float(np.maximum(level, upright).min(initial=np.inf))
        if cable == "aloft":
            start, end = moments[:, :-1], moments[:, 1:]
            step = end - start
            step *= step
            chord = np.sqrt(step[:, :, 0] + step[:, :, 1] + step[:, :, 2])
            margin = min(margin, float((self._longest - chord).min(initial=np.inf)))
            if margin > 0.0:
                strands = self._between_strands(moments, 0.0)
                margin = min(margin, float(strands.min()) - self._asked.cable)
        return min(1.0, max(0.0, margin / CAUTION))

    def _between_strands(self, moments: Floats, far: float) -> Floats:
        """Smallest distances (k,) between strands: those of boxes that contain them, by points
        where boxes come within ``far`` of what matters, exactly where points come close."""
        if not len(self._strands):
            return np.full(len(moments), np.inf)
        first, second = self._one, self._other
        start, end = moments[:, :-1], moments[:, 1:]
        low, high = boxes(start, end, self._lengths)
        gap = np.maximum(
            low.take(first, axis=1) - high.take(second, axis=1),
            low.take(second, axis=1) - high.take(first, axis=1),
        )
        np.maximum(gap, 0.0, out=gap)
        apart = np.sqrt(np.vecdot(gap, gap))
        near = apart < self._matters + far
        if np.count_nonzero(near):
            moment, pair = np.nonzero(near)
            seen, row = np.unique(moment, return_inverse=True)
            points = sketch(start[seen], end[seen], self._lengths, _POINTS)
            apart[near] = self._by_points(points[row, first[pair]], points[row, second[pair]])
        distance: Floats = apart.min(axis=1) - self._diameter
        return distance

    def _by_points(self, first: Floats, second: Floats) -> Floats:
        """Distances (p,) of strands given by their points (p, k, 3): exact where they are close."""
        squares = np.matmul(first, second.transpose(0, 2, 1))
        squares *= -2.0
        squares += np.einsum("pij,pij->pi", first, first)[:, :, None]
        squares += np.einsum("pij,pij->pi", second, second)[:, None, :]
        # where two straight lines are closest, their samples are off by half a spacing each,
        # both at right angles to the shortest distance
        squared = squares.reshape(len(squares), -1).min(axis=1) - 0.5 * self._spacing**2
        apart: Floats = np.sqrt(np.maximum(squared, 0.0)) - _BOWED
        close = apart < self._matters
        if close.any():
            apart[close] = polyline_polyline(first[close], second[close]).distance
        return apart
