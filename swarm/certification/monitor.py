"""The certificate's distances at measured positions, now and a moment ahead.

The certificate holds while all vehicles stay within the tracking radius. The monitor computes the
real distances: where it expects less than the required ones, the mission clock slows down.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from swarm.certification.coarse_distance import box_distance, squared_point_distance
from swarm.geometry.catenary import MAX_CHORD_RATIO
from swarm.geometry.catenary_kernel import sample_strand
from swarm.geometry.distance import point_distance, polyline_distance
from swarm.jit import allocates, compiled, inner
from swarm.planning import CableState, Plan
from swarm.signatures import Floats1, Floats2, Floats3, Ints2

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.intp]
Flags = npt.NDArray[np.bool_]

LOOKAHEAD = 1.5
"""Seconds ahead at which conflicts are detected: about the longest stop along the path of plans of
the default mission (1.6 s)."""
SLOWING_MARGIN = 0.1
"""Metres of margin below which the clock slows, to a standstill at none: the default tracking
radius."""
SLOWEST = 0.3
"""Smallest rate of the clock for the swing: a stop would swing the strands anew."""
_PIECES = 20
"""Pieces of a sampled strand: 15 cm of a strand of 3 m."""
_BOW = 0.02
"""Largest distance in metres of a strand from the line between two of its points: that of 15 cm at
a radius of curvature of 14 cm."""
FAR = 0.5
"""Metres beyond the distances that slow the clock from which a lower bound is enough."""


@dataclass(frozen=True)
class Clearances:
    """Smallest distances at one moment, and the smallest margin to the required ones, metres.

    ``cable`` between strands that share no vehicle, surface to surface (infinite where no cable
    hangs; a lower bound where they are far apart); ``vehicle`` horizontally between vehicles that
    are not apart in height; ``chord`` the largest ratio of chord to length.
    """

    cable: float
    vehicle: float
    chord: float
    margin: float

    @property
    def clock_rate(self) -> float:
        """Return the allowed clock rate, 0…1."""
        return _clock_rate(self.margin)


class RequiredNow(NamedTuple):
    """Required distances in metres of a team at one moment.

    Of vehicles ``horizontal`` or ``vertical``; of strands' middles ``strands``; ``chord`` (n − 1,)
    the longest chords. Strands nearer than ``near`` are computed exactly. ``pairs`` (p, 2) of
    strands are compared; ``lengths`` (n − 1,) are those of the segments, ``spacing`` the largest
    distance of sampled points.
    """

    horizontal: float
    vertical: float
    strands: float
    near: float
    chord: Floats1
    pairs: Ints2
    lengths: Floats1
    spacing: float


class Monitor:
    """Distances of a plan's team at given positions."""

    def __init__(self, plan: Plan) -> None:
        n, clearance = plan.vehicles, plan.mission.clearance
        self._lengths = plan.layout.lengths
        self._diameter = plan.mission.cable.diameter
        self._clearance = clearance
        self._vehicle_pairs = np.triu_indices(n, 1)
        self.required = RequiredNow(
            horizontal=clearance.vehicle,
            vertical=clearance.downwash,
            strands=clearance.cable,
            near=clearance.cable + self._diameter + 1.5 * SLOWING_MARGIN,
            chord=MAX_CHORD_RATIO * self._lengths,
            pairs=np.ascontiguousarray(np.stack(np.triu_indices(max(n - 1, 0), 2), axis=1)),
            lengths=self._lengths,
            spacing=float(self._lengths.max(initial=0.0)) / _PIECES,
        )
        self.points = np.zeros((len(self._lengths), _PIECES + 1, 3))

    def clearances(self, moments: Floats, cable: CableState) -> list[Clearances]:
        """Return the clearances of grip points (k, n, 3), mission ENU, at each of k moments."""
        first, second = self._vehicle_pairs
        between = moments[:, first] - moments[:, second]
        horizontal = np.hypot(between[:, :, 0], between[:, :, 1])
        vertical = np.abs(between[:, :, 2])
        margins = np.maximum(
            horizontal - self._clearance.vehicle, vertical - self._clearance.downwash
        )
        level = vertical < self._clearance.downwash
        vehicle = np.where(level, horizontal, np.inf).min(axis=1, initial=np.inf)
        margin = margins.min(axis=1, initial=np.inf)
        if cable != "aloft":
            return [
                Clearances(np.inf, float(v), 0.0, float(m))
                for v, m in zip(vehicle, margin, strict=True)
            ]
        step = moments[:, 1:] - moments[:, :-1]
        chord = np.sqrt(np.einsum("kij,kij->ki", step, step))
        ratio = (chord / self._lengths).max(axis=1, initial=0.0)
        slack = MAX_CHORD_RATIO * self._lengths - chord
        margin = np.minimum(margin, slack.min(axis=1, initial=np.inf))
        strands = np.full(len(moments), np.nan)
        fits = ratio < 1.0
        if fits.any():
            strands[fits] = [
                _strand_distance(grips, self.required, FAR, self.points) - self._diameter
                for grips in moments[fits]
            ]
            margin = np.fmin(margin, strands - self._clearance.cable)
        return [
            Clearances(float(s), float(v), float(r), float(m))
            for s, v, r, m in zip(strands, vehicle, ratio, margin, strict=True)
        ]

    def clock_rate(self, moments: Floats, cable: CableState) -> float:
        """Return the allowed clock rate, 0…1, for the margins at the moments (k, n, 3).

        As from :meth:`clearances`, without distances of strands that are far apart.
        """
        aloft = cable == "aloft"
        return _clock_rate(_margin(moments, aloft, self.required, self._diameter, self.points))

    def swinging_rate(self, moments: Floats, strays: Floats) -> float:
        """Return the allowed clock rate, SLOWEST…1, for strands that swing.

        Each strand may be up to its stray (n − 1,), in metres, nearer to the others than its
        catenary at the moments (k, n, 3).
        """
        near = self.required.near + 2.0 * float(strays.max(initial=0.0))
        required = self.required._replace(near=near)
        least = swinging_distance(moments, strays, required, self.points)
        margin = least - self._diameter - required.strands
        return max(SLOWEST, _clock_rate(margin))


def _clock_rate(margin: float) -> float:
    return min(1.0, max(0.0, margin / SLOWING_MARGIN))


@compiled
def _margin(
    moments: Floats3, aloft: bool, required: RequiredNow, diameter: float, points: Floats3
) -> float:
    """Smallest margin at the moments (k, n, 3): of vehicles, and of chords and strands aloft."""
    margin = _vehicle_margin(moments, required)
    if aloft:
        margin = min(margin, _chord_margin(moments, required.chord))
        if margin > 0.0:
            for k in range(len(moments)):
                distance = _strand_distance(moments[k], required, 0.0, points)
                margin = min(margin, distance - diameter - required.strands)
    return margin


@inner
def _vehicle_margin(moments: Floats, required: RequiredNow) -> float:
    """Smallest margin between vehicles at the moments (k, n, 3), horizontal or vertical."""
    least = np.inf
    for k in range(len(moments)):
        grips = moments[k]
        for i in range(len(grips)):
            for j in range(i + 1, len(grips)):
                across = math.hypot(grips[i, 0] - grips[j, 0], grips[i, 1] - grips[j, 1])
                across -= required.horizontal
                least = min(least, max(across, abs(grips[i, 2] - grips[j, 2]) - required.vertical))
    return least


@inner
def _chord_margin(moments: Floats, longest: Floats) -> float:
    """Smallest margin of chords to ``longest`` (n − 1,) at the moments (k, n, 3)."""
    least = np.inf
    for k in range(len(moments)):
        for i in range(len(longest)):
            least = min(least, longest[i] - point_distance(moments[k, i], moments[k, i + 1]))
    return least


@compiled
@allocates
def swinging_distance(
    moments: Floats3, strays: Floats1, required: RequiredNow, points: Floats3
) -> float:
    """Smallest distance of strands at the moments (k, n, 3), less the strays (n − 1,) of both.

    As :func:`pair_distance`; ``points`` (n − 1, k, 3) is working memory.
    """
    least = np.inf
    for k in range(len(moments)):
        sampled = np.zeros(len(required.lengths), np.bool_)
        for pair in range(len(required.pairs)):
            one, other = required.pairs[pair, 0], required.pairs[pair, 1]
            apart = pair_distance(moments[k], (one, other), required, 0.0, (points, sampled))
            least = min(least, apart - strays[one] - strays[other])
    return least


@compiled
@allocates
def _strand_distance(grips: Floats2, required: RequiredNow, far: float, points: Floats3) -> float:
    """Smallest distance between the middles of strands at grip points (n, 3).

    As :func:`pair_distance`; ``points`` (n − 1, k, 3) is working memory.
    """
    sampled = np.zeros(len(required.lengths), np.bool_)
    least = np.inf
    for pair in range(len(required.pairs)):
        strands = required.pairs[pair, 0], required.pairs[pair, 1]
        least = min(least, pair_distance(grips, strands, required, far, (points, sampled)))
    return least


@inner
def pair_distance(
    grips: Floats,
    pair: tuple[int, int],
    required: RequiredNow,
    far: float,
    memory: tuple[Floats, Flags],
) -> float:
    """Distance between the middles of two strands at grip points (n, 3).

    Of boxes that contain the strands; of points where boxes come within ``far`` of ``near``;
    exactly where points come closer than ``near``. ``memory`` are the points (n − 1, k, 3) of the
    strands, and which of them are sampled (n − 1,).
    """
    apart = box_distance(grips, required.lengths, pair, (0.0, 0.0), np.inf)
    if apart < required.near + far:
        apart = sampled_distance(grips, pair, required, memory)
    return apart


@inner
def sampled_distance(
    grips: Floats, pair: tuple[int, int], required: RequiredNow, memory: tuple[Floats, Flags]
) -> float:
    """Distance of two strands by their points, as in :func:`pair_distance`."""
    points, sampled = memory
    for strand in pair:
        if not sampled[strand]:
            length = required.lengths[strand]
            sample_strand(grips[strand], grips[strand + 1], length, points[strand])
            sampled[strand] = True
    square = squared_point_distance(points[pair[0]], points[pair[1]])
    apart = least_between(square, required.spacing)
    if apart < required.near:
        apart = polyline_distance(points[pair[0]], points[pair[1]], np.inf)[0]
    return float(apart)


@inner
def least_between(square: float, spacing: float) -> float:
    """Lower bound of two strands' distance by the squared distance of their points.

    Where two straight lines are closest, their samples are off by up to half a spacing each, both
    at right angles to the shortest distance.
    """
    return math.sqrt(max(square - 0.5 * spacing**2, 0.0)) - _BOW
