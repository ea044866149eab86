"""Batteries that run down, and position estimates that get worse."""

import numpy as np

from swarm.flight.detect.latch import Latch
from swarm.flight.failures import Failure, FailureKind, Finding
from swarm.flight.observation import Expected, Observation

BATTERY_LOW, BATTERY_CRITICAL = 0.2, 0.1
"""Shares of charge; above those at which autopilots act alone, so that the team decides."""


class HealthDetector:
    """Detects low batteries and lost positions; ``gps`` says whether vehicles need a GPS fix."""

    def __init__(self, reported: Latch, *, gps: bool) -> None:
        self._reported, self._gps = reported, gps

    def detect(self, seen: Observation, expected: Expected) -> list[Finding]:
        """Return the failures of batteries and positions at this tick."""
        suspect = (seen.battery <= BATTERY_LOW) | ~seen.located | seen.poor_fix
        found: list[Finding] = []
        for k in np.flatnonzero(suspect & expected.armed & ~expected.may_land).tolist():
            battery, name = float(seen.battery[k]), seen.names[k]
            words = f"{name} has a battery charge of {battery:.0%}"
            if battery <= BATTERY_CRITICAL and self._first(FailureKind.BATTERY_CRITICAL, k):
                found.append(Failure(FailureKind.BATTERY_CRITICAL, words, k))
            elif battery <= BATTERY_LOW and self._first(FailureKind.BATTERY_LOW, k):
                found.append(Failure(FailureKind.BATTERY_LOW, words, k))
            if not seen.located[k] and self._first(FailureKind.POSITION_LOST, k):
                words = f"{name} has no position estimate"
                found.append(Failure(FailureKind.POSITION_LOST, words, k))
            if seen.poor_fix[k] and self._gps and self._first(FailureKind.FIX_LOST, k):
                words = f"{name} has lost its GPS fix"
                found.append(Failure(FailureKind.FIX_LOST, words, k))
        return found

    def _first(self, kind: FailureKind, k: int) -> bool:
        return self._reported.first(kind, k)
