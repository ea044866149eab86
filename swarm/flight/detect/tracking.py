"""Large tracking errors in flights that measure them, as a hop does."""

import numpy as np

from swarm.flight.failures import Failure, FailureKind, Finding
from swarm.flight.observation import Expected, Observation


class TrackingDetector:
    """Detects a vehicle too far from its setpoint, or too near to another one.

    Too far is the flight's ``limit``, too near the mission's ``clearance`` between vehicles, level.
    The plan's distances do not answer this: errors here may be larger than it allows for.
    """

    def __init__(self, limit: float | None, clearance: float) -> None:
        self._limit, self._clearance = limit, clearance

    def detect(self, seen: Observation, expected: Expected) -> list[Finding]:
        """Return the largest error or the nearest pair beyond the limits, if there is one."""
        if self._limit is None or expected.may_land.all():
            return []
        return self._errors(seen, expected, self._limit) or self._distances(seen)

    def _errors(self, seen: Observation, expected: Expected, limit: float) -> list[Finding]:
        error = np.where(expected.streaming & np.isfinite(seen.error), seen.error, 0.0)
        worst = int(np.argmax(error))
        if error[worst] <= limit:
            return []
        words = f"{seen.names[worst]} is {error[worst]:.2f} m from its setpoint, "
        words += f"more than the limit of {limit:g} m"
        return [Failure(FailureKind.TRACKING_ERROR, words, worst)]

    def _distances(self, seen: Observation) -> list[Finding]:
        first, second = np.triu_indices(len(seen.names), 1)
        level = seen.position[:, :2]
        apart = np.linalg.norm(level[first] - level[second], axis=1)
        near = np.flatnonzero(apart < self._clearance)
        if not len(near):
            return []
        pair = near[np.argmin(apart[near])]
        one, other = int(first[pair]), int(second[pair])
        words = f"{seen.names[one]} and {seen.names[other]} are {apart[pair]:.2f} m apart, "
        words += f"less than the required {self._clearance:g} m"
        return [Failure(FailureKind.TRACKING_ERROR, words, one)]
