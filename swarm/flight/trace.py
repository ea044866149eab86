"""The flown positions and setpoints over time."""

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Trace:
    """Positions and setpoints of n vehicles at k instants, in the mission's frame.

    ``time`` (k,) is the ground station's clock in seconds, increasing; ``mission_time`` (k,) the
    mission clock at that instant (it waits at gates and may run backwards). ``position`` and
    ``setpoint`` (k, n, 3) are grip points in ENU metres: the reported position,
    interpolated to ``time``, and the sent setpoint; NaN where not known. ``phase`` (k,) are the
    names of the plan's phases, empty outside the plan (before the start, or in a contingency).
    ``stray`` (k, s) is how far each of s strands was estimated from its catenary in metres, NaN
    where it was not; (0, 0) for a trace that has no estimates, as of a .tlog.
    """

    time: Floats
    mission_time: Floats
    position: Floats
    setpoint: Floats
    phase: tuple[str, ...]
    stray: Floats = field(default_factory=lambda: np.empty((0, 0)))
