"""The certificate's clearances at measured positions, now and a moment ahead.

The certificate holds while all vehicles stay within the tracking radius. The monitor computes the
real distances (:mod:`.team_margins`): where it expects less than the required ones, the mission
clock slows down.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from swarm.certification.kinds import KINDS
from swarm.certification.team_margins import (
    CHORDS,
    PLACES,
    STRANDS,
    Query,
    Required,
    Strands,
    Team,
    allocate_strands,
    allocate_team,
    cable_margins,
    required_of,
    strand_margins,
    vehicle_margins,
)
from swarm.jit import compiled, inner
from swarm.planning import CableState, Plan
from swarm.signatures import Floats3, contiguous

Floats = npt.NDArray[np.float64]

LOOKAHEAD = 1.5
"""Seconds ahead at which conflicts are detected: about the longest stop along the path of plans of
the default mission (1.6 s)."""
SLOWING_MARGIN = 0.1
"""Metres of margin below which the clock slows, to a standstill at none: the default tracking
radius."""
SLOWEST = 0.3
"""Smallest rate of the clock for the swing: a stop would swing the strands anew."""

_NAMES = {kind.place: kind.check for kind in KINDS}
"""Names of the kinds, by their places in arrays of margins."""


@dataclass(frozen=True)
class Clearances:
    """Smallest distances at one moment, and the smallest margin to the required ones, metres.

    ``cable`` between strands that share no vehicle, surface to surface (infinite where no cable
    hangs); ``vehicle`` horizontally between vehicles that are not apart in height; ``chord`` the
    largest ratio of chord to length. ``margin`` is the smallest of all clearances of
    :mod:`.team_margins`, and ``kind`` the name of the one that has it.
    """

    cable: float
    vehicle: float
    chord: float
    margin: float
    kind: str

    @property
    def clock_rate(self) -> float:
        """Return the allowed clock rate, 0…1."""
        return _clock_rate(self.margin)


class Monitor:
    """Distances of a plan's team at given positions."""

    def __init__(self, plan: Plan) -> None:
        self._lengths = plan.layout.lengths
        self._clearance, self._diameter = plan.mission.clearance, plan.mission.cable.diameter
        self._vehicle_pairs = np.triu_indices(plan.vehicles, 1)
        self._required = required_of(plan)
        self._memory = allocate_team(plan.vehicles), allocate_strands(plan.vehicles)

    def clearances(self, moments: Floats, cable: CableState) -> list[Clearances]:
        """Return the clearances of grip points (k, n, 3), mission ENU, at each of k moments."""
        first, second = self._vehicle_pairs
        between = moments[:, first] - moments[:, second]
        level = np.abs(between[:, :, 2]) < self._clearance.downwash
        across = np.hypot(between[:, :, 0], between[:, :, 1])
        vehicle = np.where(level, across, np.inf).min(axis=1, initial=np.inf)
        strands, ratio = np.full(len(moments), np.inf), np.zeros(len(moments))
        low, here = self._margins(moments, cable, np.inf)
        if cable == "aloft":
            chord = np.linalg.norm(np.diff(moments, axis=1), axis=2)
            ratio = (chord / self._lengths).max(axis=1, initial=0.0)
            strands = here[:, STRANDS] + self._clearance.cable
            strands[here[:, CHORDS] < 0.0] = np.nan
        return [
            Clearances(float(s), float(v), float(r), float(m.min()), _NAMES[int(m.argmin())])
            for s, v, r, m in zip(strands, vehicle, ratio, low, strict=True)
        ]

    def clock_rate(self, moments: Floats, cable: CableState) -> float:
        """Return the allowed clock rate, 0…1, for the margins at the moments (k, n, 3).

        As from :meth:`clearances`, without distances that are large.
        """
        return _clock_rate(float(self._margins(moments, cable, SLOWING_MARGIN)[0].min()))

    def swinging_rate(self, moments: Floats, strays: Floats) -> float:
        """Return the allowed clock rate, SLOWEST…1, for strands that swing.

        Each strand may be up to its stray (n − 1,), in metres, nearer to the others that share no
        vehicle with it than its catenary at the moments (k, n, 3).
        """
        team, strands = self._memory
        margins = np.full((2, len(moments), PLACES), SLOWING_MARGIN)
        swinging = team, strands._replace(stray=contiguous(strays))
        _write_strand_margins(contiguous(moments), self._required, swinging, margins)
        return max(SLOWEST, _clock_rate(float(margins[0].min())))

    def _margins(self, moments: Floats, cable: CableState, enough: float) -> tuple[Floats, Floats]:
        """Return margins (k, PLACES) from below, and less exactly; only those below ``enough``."""
        margins = np.empty((2, len(moments), PLACES))
        aloft = cable == "aloft"
        _write_margins(contiguous(moments), aloft, enough, self._required, self._memory, margins)
        return margins[0], margins[1]


def _clock_rate(margin: float) -> float:
    return min(1.0, max(0.0, margin / SLOWING_MARGIN))


@compiled
def _write_margins(
    moments: Floats3, aloft: bool, enough: float, required: Required,
    memory: tuple[Team, Strands], margins: Floats3,
) -> None:  # fmt: skip
    """Write margins (2, k, PLACES) at the moments (k, n, 3): lower bounds, and about."""
    team, strands = memory
    asked = Query(-1, (0.0, 0.0, 0.0), -np.inf, enough)
    for k in range(len(moments)):
        _place(moments[k], team)
        vehicle_margins(asked, team, required, margins[0, k], margins[1, k])
        if aloft:
            cable_margins(asked, team, required, strands, margins[0, k], margins[1, k])


@compiled
def _write_strand_margins(
    moments: Floats3, required: Required, memory: tuple[Team, Strands], margins: Floats3
) -> None:
    """Lower margins (2, k, PLACES) to those of strands that share no vehicle."""
    team, strands = memory
    for k in range(len(moments)):
        _place(moments[k], team)
        asked = Query(-1, (0.0, 0.0, 0.0), -np.inf, SLOWING_MARGIN)
        strand_margins(asked, team, required, strands, margins[0, k], margins[1, k])


@inner
def _place(grips: Floats, team: Team) -> None:
    """Put a team to grip points (n, 3)."""
    for i in range(len(grips)):
        for axis in range(3):
            team.position[i, axis] = grips[i, axis]
