"""Silent vehicles: a lost link, in one direction or both, or a vehicle that has fallen."""

import math

import numpy as np

from swarm.flight.detect.latch import Latch
from swarm.flight.failures import Failure, FailureKind, Finding, Recovery
from swarm.flight.observation import Expected, Observation
from swarm.flight.router import answer_limit
from swarm.mission.fleet import Limits

MODE_VALID = 1.5
"""Seconds after its report for which a mode is taken for the vehicle's."""
FALLEN_SILENCE = 0.5
"""Seconds of silence after which a vehicle whose neighbour is pulled down has fallen."""
PULLED_DOWN = 0.3
"""Metres by which that neighbour is below its setpoint."""
PULLED_ASIDE = math.radians(30.0)
"""Or its tilt, which the pull turns first: six real vehicles beside a stopped one went from 20 to
40° to 60 to 130° within 0.1 s. Against a wind of 8 m/s a vehicle leans by 22°."""

_ENDED = frozenset({FailureKind.SILENT, FailureKind.LOST, FailureKind.ALL_LOST})


class LinkDetector:
    """Detects vehicles that fall silent, and reports those that are received again."""

    def __init__(self, limits: Limits, reported: Latch) -> None:
        self._limits, self._reported = limits, reported
        self._silent: set[int] = set()
        self._shortest = min(FALLEN_SILENCE, limits.silence, limits.lost or limits.silence)
        self._unanswered = answer_limit(limits)

    def detect(self, seen: Observation, expected: Expected) -> list[Finding]:
        """Return the failures and recoveries of the links at this tick."""
        heard = seen.now - float(seen.heard_at.min()) <= self._shortest
        answered = seen.now - float(seen.asked_at.min()) <= self._unanswered
        if not self._silent and heard and answered:
            return []
        limits, found = self._limits, list[Finding]()
        lost = [
            k
            for k in range(len(seen.names))
            if seen.silent_for(k) > (limits.lost or limits.silence)
        ]
        all_lost = len(lost) == len(seen.names)
        for k, name in enumerate(seen.names):
            found += self._silence(seen, k)
            if k in lost and not all_lost and self._reported.first(FailureKind.LOST, k):
                words = f"no packets for {limits.lost:g} s: {name}"
                found.append(Failure(FailureKind.LOST, words, k))
            if seen.silent_for(k) > FALLEN_SILENCE and neighbour_pulled_down(seen, expected, k):
                found += fallen_silent(seen, self._reported, k)
        if all_lost and self._reported.first(FailureKind.ALL_LOST, 0):
            words = f"no packets of any vehicle for {limits.lost:g} s"
            found.append(Failure(FailureKind.ALL_LOST, words))
        return found

    def _silence(self, seen: Observation, k: int) -> list[Finding]:
        """Return that a vehicle falls silent or does not answer, or that it is received again."""
        name, words = seen.names[k], ""
        if seen.silent_for(k) > self._limits.silence:
            words = f"{name} has been silent for {self._limits.silence:g} s"
        elif seen.unanswered_for(k) > self._unanswered:
            words = f"{name} has not answered for {self._limits.silence:g} s: it may not receive"
        silent = bool(words)
        if silent and k not in self._silent:
            self._silent.add(k)
            return [Failure(FailureKind.SILENT, words, k)]
        # after a gap it may land by itself: its mode must be known first
        if silent or k not in self._silent or not mode_valid(seen, k):
            return []
        self._silent.discard(k)
        self._reported.forget(FailureKind.LOST, k)
        self._reported.forget(FailureKind.ALL_LOST, 0)
        return [Recovery(_ENDED, f"{name} is received again", "link", k)]


def mode_valid(seen: Observation, k: int) -> bool:
    """Return whether a vehicle has reported its mode recently."""
    return seen.now - float(seen.mode_at[k]) <= MODE_VALID


def neighbours(seen: Observation, k: int) -> list[int]:
    """Return the vehicles next to a vehicle along the cable."""
    return [j for j in (k - 1, k + 1) if 0 <= j < len(seen.names)]


def neighbour_pulled_down(seen: Observation, expected: Expected, k: int) -> bool:
    """Return whether a neighbour along the cable is well below its setpoint, or tilted far."""
    if expected.cable != "aloft" or not expected.armed[k]:
        return False
    below = expected.setpoint[:, 2] - seen.position[:, 2]
    tilt = np.abs(seen.attitude[:, :2]).max(axis=1)
    return any(
        (below[j] > PULLED_DOWN or tilt[j] > PULLED_ASIDE)
        and expected.streaming[j]
        and seen.now - seen.position_at[j] <= FALLEN_SILENCE
        for j in neighbours(seen, k)
    )


def fallen_silent(seen: Observation, reported: Latch, k: int) -> list[Finding]:
    """Return, once, that a silent vehicle has fallen."""
    if not reported.first(FailureKind.FALLEN_SILENT, k):
        return []
    words = f"{seen.names[k]} is silent and a neighbour is pulled down: it has fallen"
    return [Failure(FailureKind.FALLEN_SILENT, words, k)]
