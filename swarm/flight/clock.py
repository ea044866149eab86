"""The mission clock: mission time advances at a rate between −1 and 1 that is C¹ in real time."""

import math
from dataclasses import dataclass

from swarm.planning.clock_limits import (
    BANDWIDTH,
    SMOOTH,
    URGENT_BANDWIDTH,
    ClockLimits,
    moved_on,
)

_CLOSE = 1e-3
"""Rate, and its slope per second, that count as reached: 2 mm/s at the default speed limit."""


@dataclass
class MissionClock:
    """Mission time and its rate.

    The rate's slope is continuous and within ``limits``: setpoints then accelerate for a change of
    rate by no more than plans keep in reserve, and less where nothing is ``urgent``. A ``prompt``
    change, to slow down for errors, begins at once too, and is as slow as ordinary ones.
    """

    limits: ClockLimits
    time: float = 0.0
    rate: float = 0.0
    slope: float = 0.0
    target: float = 0.0
    urgent: bool = False
    prompt: bool = False

    @property
    def steepest(self) -> float:
        """The largest slope of the rate now, 1/s."""
        return self.limits.at(self.time, urgent=self.urgent)

    def set_running(self) -> None:
        """Run at full rate from now on; only for moments at which the plan is at rest."""
        self.rate = self.target = 1.0
        self.slope = 0.0

    def set_stopped(self) -> None:
        """Stand still from now on; only for moments at which the plan is at rest."""
        self.rate = self.target = self.slope = 0.0

    @property
    def stopped(self) -> bool:
        """Whether mission time stands still."""
        return self.rate == 0.0 and self.slope == 0.0

    def advance(self, duration: float, lowest: float, highest: float) -> None:
        """Move on by a short real time, within bounds of mission time."""
        bandwidth = URGENT_BANDWIDTH if self.urgent else BANDWIDTH
        rise = math.inf if self.urgent or self.prompt else SMOOTH
        self.time, self.rate, self.slope = moved_on(
            (self.time, self.rate, self.slope),
            self.target,
            self.steepest,
            bandwidth,
            rise,
            duration,
        )
        if abs(self.target - self.rate) < _CLOSE and abs(self.slope) < _CLOSE:
            self.rate, self.slope = self.target, 0.0
        if not lowest <= self.time <= highest:
            self.time = max(lowest, min(highest, self.time))
            self.set_stopped()
