"""The ground station itself: gaps in its own stream of setpoints."""

from swarm.flight.detect.standstill import SLOW_FROM
from swarm.flight.failures import Failure, FailureKind, Finding, HoldCause, Recovery
from swarm.flight.observation import Expected, Observation
from swarm.flight.parameters import STREAM_LOSS_TIME

STALLED = HoldCause(FailureKind.STATION_STALLED)
AFTER_STALL = 1.0
"""Seconds of setpoints after which vehicles that still get them have answered: mode and position
come more often, and a vehicle that has left offboard mode has reported it."""


class StationDetector:
    """Detects that the ground station did not run, and that the team follows again after that."""

    def __init__(self) -> None:
        self._since = 0.0

    def stalled(self, now: float, elapsed: float) -> list[Finding]:
        """Return a gap of ``elapsed`` seconds in the setpoints after which all vehicles stop.

        It precedes what the vehicles report: they may have stopped for it.
        """
        if elapsed <= STREAM_LOSS_TIME:
            return []
        self._since = now
        words = f"the ground station stood still for {elapsed:.1f} s and sent no setpoint"
        return [Failure(FailureKind.STATION_STALLED, words)]

    def detect(self, seen: Observation, expected: Expected) -> list[Finding]:
        """Return that all vehicles get setpoints, and follow them again."""
        if STALLED not in expected.holds or seen.now - self._since < AFTER_STALL:
            return []
        follow = expected.streaming & (seen.error <= SLOW_FROM * expected.allowed_error)
        if not follow.all():
            return []
        ended = frozenset({FailureKind.STATION_STALLED})
        return [Recovery(ended, "all vehicles follow the setpoints again", "hold")]
