"""The certificate's distances on measured positions, now and a moment ahead.

The certificate promises clearances while everybody stays in the tracking ball. The monitor looks
at what really is: where it expects less than what the mission asks for, the clock slows down.
"""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from swarm.certification.limits import TAUT
from swarm.geometry.catenary_kernel import max_drop_below_ends, sample_strand
from swarm.geometry.distance import polyline_distance
from swarm.jit import compiled
from swarm.planning import CableState, Plan

Floats = npt.NDArray[np.float64]

LOOKAHEAD = 1.5
"""Seconds ahead at which conflicts are looked for."""
SLOWING_MARGIN = 0.1
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
    def clock_rate(self) -> float:
        """Return the rate at which the clock may run, 0…1."""
        return min(1.0, max(0.0, self.margin / SLOWING_MARGIN))


class Monitor:
    """Distances of one plan's team."""

    def __init__(self, plan: Plan) -> None:
        n = plan.vehicles
        self._lengths = plan.layout.lengths
        self._diameter = plan.mission.cable.diameter
        self._asked = plan.mission.clearance
        self._pairs = np.triu_indices(n, 1)
        first, second = np.triu_indices(max(n - 1, 0), 2)
        self._strands = np.ascontiguousarray(np.stack([first, second], axis=1))
        self._matters = (
            plan.mission.clearance.cable + plan.mission.cable.diameter + 1.5 * SLOWING_MARGIN
        )
        self._longest = TAUT * self._lengths
        self._spacing = float(self._lengths.max(initial=0.0)) / _POINTS
        self._room = np.zeros((len(self._lengths), _POINTS + 1, 3))

    def clearances(self, moments: Floats, cable: CableState) -> list[Clearances]:
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

    def clock_rate(self, moments: Floats, cable: CableState) -> float:
        """The rate at which the clock may run, 0…1, as the margins at the moments (k, n, 3) allow.

        As from :meth:`look`, which knows more of strands that are far apart.
        """
        asked = self._asked
        margin = _margin(
            moments, (asked.vehicle, asked.downwash, asked.cable, self._diameter),
            cable == "aloft", self._longest, self._lengths, self._strands, self._matters,
            self._spacing, self._room,
        )  # fmt: skip
        return min(1.0, max(0.0, margin / SLOWING_MARGIN))

    def _between_strands(self, moments: Floats, far: float) -> Floats:
        """Smallest distances (k,) between strands, or lower bounds of what is far apart."""
        distance = np.empty(len(moments))
        for moment, grips in enumerate(moments):
            distance[moment] = _strands_apart(
                grips, self._lengths, self._strands, self._matters, far, self._spacing, self._room
            )
        return distance - self._diameter


@compiled
def _margin(
    moments: Floats, asked: tuple[float, float, float, float], aloft: bool, longest: Floats,
    lengths: Floats, strands: npt.NDArray[np.intp], matters: float, spacing: float, room: Floats,
) -> float:  # fmt: skip
    """What is least left at the moments (k, n, 3) of the distances asked for: of vehicles, level
    and upright, and of strands, as thick as is said last."""
    margin = _least_apart(moments, asked[0], asked[1])
    if aloft:
        margin = min(margin, _least_slack(moments, longest))
        if margin > 0.0:
            for grips in moments:
                apart = _strands_apart(grips, lengths, strands, matters, 0.0, spacing, room)
                margin = min(margin, apart - asked[3] - asked[2])
    return margin


@compiled
def _least_apart(moments: Floats, level: float, upright: float) -> float:
    """What is least left of the distances, ``level`` or ``upright``, of vehicles (k, n, 3)."""
    least = np.inf
    for grips in moments:
        for i in range(len(grips)):
            for j in range(i + 1, len(grips)):
                across = math.hypot(grips[i, 0] - grips[j, 0], grips[i, 1] - grips[j, 1]) - level
                least = min(least, max(across, abs(grips[i, 2] - grips[j, 2]) - upright))
    return least


@compiled
def _least_slack(moments: Floats, longest: Floats) -> float:
    """By how much chords between neighbours (k, n, 3) are shorter than ``longest``, at least."""
    least = np.inf
    for grips in moments:
        for i in range(len(longest)):
            step = grips[i + 1] - grips[i]
            least = min(least, longest[i] - math.sqrt(np.sum(step * step)))
    return least


@compiled
def _strands_apart(
    grips: Floats, lengths: Floats, pairs: npt.NDArray[np.intp], matters: float, far: float,
    spacing: float, points: Floats,
) -> float:  # fmt: skip
    """Smallest distance of the strands' ``pairs`` (p, 2) between grips (n, 3), of their middles.

    That of boxes that contain them, by points where boxes come within ``far`` of what matters,
    exactly where points come close. ``points`` (n − 1, k, 3) is room for the strands' points.
    """
    sketched = np.zeros(len(lengths), np.bool_)
    least = np.inf
    for pair in range(len(pairs)):
        one, other = pairs[pair]
        apart = _boxes_apart(
            grips[one], grips[one + 1], lengths[one], grips[other], grips[other + 1], lengths[other]
        )
        if apart < matters + far:
            for strand in (one, other):
                if not sketched[strand]:
                    sample_strand(grips[strand], grips[strand + 1], lengths[strand], points[strand])
                    sketched[strand] = True
            apart = _points_apart(points[one], points[other], spacing)
            if apart < matters:
                apart = polyline_distance(points[one], points[other], np.inf)[0]
        least = min(least, apart)
    return least


@compiled
def _boxes_apart(
    start: Floats, end: Floats, length: float, other_start: Floats, other_end: Floats,
    other_length: float,
) -> float:  # fmt: skip
    """Distance of the upright boxes that contain two strands."""
    square = 0.0
    for k in range(3):
        low, high = min(start[k], end[k]), max(start[k], end[k])
        other_low, other_high = min(other_start[k], other_end[k]), max(other_start[k], other_end[k])
        if k == 2:
            low -= max_drop_below_ends(start, end, length)
            other_low -= max_drop_below_ends(other_start, other_end, other_length)
        square += max(low - other_high, other_low - high, 0.0) ** 2
    return math.sqrt(square)


@compiled
def _points_apart(first: Floats, second: Floats, spacing: float) -> float:
    """A lower bound of the distance of strands given by their points (k, 3).

    Where two straight lines are closest, their samples are off by half a spacing each, both at
    right angles to the shortest distance.
    """
    square = np.inf
    for i in range(len(first)):
        for j in range(len(second)):
            apart = 0.0
            for k in range(3):
                apart += (first[i, k] - second[j, k]) ** 2
            square = min(square, apart)
    return math.sqrt(max(square - 0.5 * spacing**2, 0.0)) - _BOWED
