"""The live monitor's view of a flight: the distances between vehicles and strands, and the rate of
the mission clock that they permit."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt

from swarm.certification.monitor import Clearances, Monitor
from swarm.planning import CableState

Floats = npt.NDArray[np.float64]


@dataclass
class Sample:
    """Positions at one moment and a moment ahead.

    ``moments`` (2, n, 3) are grip points, mission ENU; ``strays`` (n − 1,) how far the strands
    swing from their catenaries, where that is estimated. Clearances are computed where they are
    read; the clock mostly needs a bound of the strands' distances alone.
    """

    monitor: Monitor
    moments: Floats
    cable: CableState
    strays: Floats | None = None

    @cached_property
    def clearances(self) -> Clearances:
        """Distances now; the margin is the smaller of now and ahead."""
        here, ahead = self.monitor.clearances(self.moments, self.cable)
        return min(here, replace(here, margin=ahead.margin, kind=ahead.kind), key=_margin)

    @cached_property
    def pace(self) -> float:
        """The largest permitted rate of the clock, 0…1."""
        pace = self.monitor.clock_rate(self.moments, self.cable)
        if self.strays is None:
            return pace
        return min(pace, self.monitor.swinging_rate(self.moments, self.strays))


def _margin(clearances: Clearances) -> float:
    return clearances.margin


@dataclass(frozen=True)
class Monitored:
    """The latest sample (None: nothing to monitor), and the time of the next."""

    sample: Sample | None = None
    next_at: float = 0.0
