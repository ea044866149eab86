"""A mission clock that stands still, in the plan or after it, and holds that last too long."""

import math

import numpy as np

from swarm.flight.failures import Failure, FailureKind, Finding, HoldCause, Recovery
from swarm.flight.observation import Expected, Observation

SLOW_FROM = 0.6
"""Share of the allowed tracking error from which the clock slows; at the full error it stops."""
CALM = 0.5
"""Share of the allowed tracking error within which a vehicle follows undisturbed."""
STOPPED_RATE = 0.02
"""Rate of the clock that counts as none: a minute of flight would last 50 minutes."""
STANDSTILL_TIME = 3.0
"""Seconds for which the clock may stand without a cause that ends by itself."""
STANDSTILL = HoldCause(FailureKind.STANDSTILL)


class StandstillDetector:
    """Detects a clock that a tracking error or a clearance keeps at rest; remembers since when.

    ``enabled`` is false in flights whose clock keeps its rate.
    """

    def __init__(self, *, enabled: bool) -> None:
        self._enabled = enabled
        self._since = 0.0

    def detect(self, seen: Observation, expected: Expected) -> list[Finding]:
        """Return that the clock stands still, or that it no longer has to."""
        if expected.waiting:
            return []
        held = STANDSTILL in expected.holds
        standing = abs(expected.rate) < STOPPED_RATE and not expected.rewinding
        if not (standing or held) or not self._enabled:
            self._since = seen.now
            return []
        worst = seen.largest_error / expected.allowed_error
        off, sample = worst >= SLOW_FROM, expected.monitored
        kept = off or (sample is not None and sample.pace < STOPPED_RATE)
        if held and not kept:
            self._since = seen.now
            ended = frozenset({FailureKind.STANDSTILL})
            return [Recovery(ended, "all vehicles follow again", "hold")]
        if held:
            return []
        if expected.holds or not kept:
            self._since = seen.now
        elif seen.now - self._since > STANDSTILL_TIME:
            return [Failure(FailureKind.STANDSTILL, _cause(seen, expected))]
        return []


class BlockedDetector:
    """Detects that a team outside the plan cannot move on to where it is to land or release."""

    def detect(self, seen: Observation, expected: Expected) -> list[Finding]:
        """Return that the cable is caught, or that errors or clearances keep the clock at rest."""
        if expected.blocked <= STANDSTILL_TIME:
            return []
        kind = FailureKind.SNAGGED if _few_are_off(seen, expected) else FailureKind.STANDSTILL
        return [Failure(kind, _cause(seen, expected))]


class HoldTimeoutDetector:
    """Detects a hold that has lasted for T, ``limit`` in seconds; remembers ``since`` when."""

    def __init__(self, limit: float) -> None:
        self._limit = limit
        self.since: float | None = None

    def detect(self, seen: Observation, expected: Expected) -> list[Finding]:
        """Return that the hold must end: before a battery decides it."""
        if not expected.holds:
            self.since = None
        elif self.since is None:
            self.since = seen.now
        elif seen.now - self.since > self._limit:
            snagged = STANDSTILL in expected.holds and _few_are_off(seen, expected)
            kind = FailureKind.SNAGGED if snagged else FailureKind.HOLD_TIMEOUT
            causes = "; ".join(expected.holds.values())
            return [Failure(kind, f"on hold for {self._limit:g} s: {causes}")]
        return []


def _cause(seen: Observation, expected: Expected) -> str:
    worst = seen.largest_error / expected.allowed_error
    off = worst >= SLOW_FROM
    return _large_errors(seen, expected, worst) if off else _small_clearances(expected)


def _large_errors(seen: Observation, expected: Expected, worst: float) -> str:
    allowed = expected.allowed_error
    off = [
        name
        for name, error in zip(seen.names, seen.error, strict=True)
        if error > SLOW_FROM * allowed
    ]
    return f"{', '.join(off)} cannot follow (errors up to {worst * allowed:.2f} m)"


def _small_clearances(expected: Expected) -> str:
    if expected.monitored is None:
        return "no clearance remains"
    seen = expected.monitored.clearances
    cable = "no slack" if math.isnan(seen.cable) else f"strands {seen.cable:.2f} m apart"
    return (
        f"no clearance remains ({seen.kind}: margin {seen.margin:.2f} m; {cable}, vehicles "
        f"{seen.vehicle:.2f} m apart, chords up to {seen.chord:.0%} of the cable length)"
    )


def _few_are_off(seen: Observation, expected: Expected) -> bool:
    """Return whether one or two vehicles stop the clock and all others follow: wind moves all.

    By then autopilots lean against the caught strand, and have brought the vehicle nearer.
    """
    off = np.nan_to_num(seen.error, nan=0.0) / expected.allowed_error
    far, calm = off >= SLOW_FROM, off < CALM
    return bool(1 <= far.sum() <= 2 and (far | calm).all())
