"""What a flight leaves behind for judging it: measured and asked positions over time."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Trace:
    """What a flight's record says of n vehicles at k instants, in the mission's frame.

    ``time`` (k,) is the ground station's clock in seconds, increasing; ``mission_time`` (k,) the
    mission clock at that instant (it waits at gates and may run back). ``position`` and
    ``setpoint`` (k, n, 3) are grip points in ENU metres: position as the vehicle reported it,
    interpolated to ``time``, setpoint as it was sent; NaN where nothing is known (yet).
    ``phase`` (k,) are the names of the plan's phases, empty where the flight was in none of them
    (before the start, or landing out of turn).
    """

    time: Floats
    mission_time: Floats
    position: Floats
    setpoint: Floats
    phase: tuple[str, ...]
