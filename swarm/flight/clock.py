"""The mission clock: mission time advances at a rate between −1 and 1 that is C¹ in real time."""

from dataclasses import dataclass

_BANDWIDTH = 2.0
"""The speed at which the rate approaches its target, per second."""
_CLOSE = 1e-3


@dataclass
class MissionClock:
    """Mission time and its rate.

    The rate's slope is continuous and never beyond ``steepest`` (1/s): setpoints then accelerate by
    at most ``steepest`` × planned speed for a change of rate, which is what plans keep in reserve.
    """

    steepest: float
    time: float = 0.0
    rate: float = 0.0
    slope: float = 0.0
    target: float = 0.0

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
        """Move on by a short real time, within bounds of mission time.

        The slope follows its own target at four times the bandwidth, the critically damped case:
        the rate does not overshoot.
        """
        wanted = _BANDWIDTH * (self.target - self.rate)
        wanted = max(-self.steepest, min(self.steepest, wanted))
        share = min(1.0, 4.0 * _BANDWIDTH * duration)
        slope = self.slope + share * (wanted - self.slope)
        change = 0.5 * (self.slope + slope) * duration
        self.time += (self.rate + 0.5 * change) * duration
        self.rate += change
        self.slope = slope
        if abs(self.target - self.rate) < _CLOSE and abs(self.slope) < _CLOSE:
            self.rate, self.slope = self.target, 0.0
        if not lowest <= self.time <= highest:
            self.time = max(lowest, min(highest, self.time))
            self.set_stopped()
