"""Falls and position jumps: reported motion against the commanded one, report by report."""

import math

import numpy as np
import numpy.typing as npt

from swarm.flight import estimation
from swarm.flight.detect.latch import Latch
from swarm.flight.detect.links import (
    FALLEN_SILENCE,
    fallen_silent,
    mode_valid,
    neighbours,
)
from swarm.flight.estimation import Measured
from swarm.flight.failures import Failure, FailureKind, Finding
from swarm.flight.observation import Expected, Observation

Floats = npt.NDArray[np.float64]

SINKING = 1.0
"""m/s by which a vehicle may descend faster than commanded."""
FALLING, FALLING_SINKING = 5.0, 0.4
"""m/s² downwards, between two reports, that no vehicle with thrust shows: half of a free fall; and
m/s of sinking that it has reached after 0.08 s, so that noise between two reports is none."""
TURNED_OVER = math.radians(60.0)
"""Roll or pitch; PX4's own failure detector uses the same angle (FD_FAIL_R)."""
RECOVERY = 1.5
"""Seconds within which a vehicle that a lost neighbour or a caught strand pulled must recover after
its release. A PX4 that was tilted to 50° did so within 0.5 s; grippers open within as much again,
and its own link may be late by 0.5 s."""
UNHEARD = 0.2
"""Seconds of silence after which a neighbour may be the vehicle that falls: five reports and more
are missing. Whether it is received again is known after FALLEN_SILENCE."""
JUMP = 0.5
"""Metres between a reported position and the one that the report before predicts."""
LONGEST_STEP = 0.5
"""Seconds between reports up to which a jump can be distinguished from flight."""
_CALM = LONGEST_STEP, SINKING, FALLING_SINKING, 0.5 * JUMP, TURNED_OVER
"""Motion within these limits is no failure (`estimation.new_reports`). Beyond them it is examined,
and may still be none."""


class MotionDetector:
    """Detects vehicles that fall, and positions that jump; remembers each vehicle's last report.

    A vehicle that a lost neighbour pulls by the cable, or that lets go of cable that may have held
    it up, is judged by whether it recovers. Without ``cable`` none is pulled.
    """

    def __init__(self, n: int, reported: Latch, *, cable: bool) -> None:
        self._reported, self._carries_cable = reported, cable
        self._last = Measured.of(n)
        self._step = np.zeros(n)
        self._disturbed: dict[int, tuple[float, bool, bool]] = {}

    def detect(self, seen: Observation, expected: Expected) -> list[Finding]:
        """Return the failures of motion at this tick."""
        now, last = seen.measured, self._last
        new, calm = estimation.new_reports(
            seen.table, seen.rows, (now, last), (expected.velocity, expected.streaming), _CALM,
            self._step,
        )  # fmt: skip
        if not new:
            return []
        found: list[Finding] = []
        if calm:
            self._disturbed.clear()
        else:
            for k in range(len(seen.names)):
                if expected.armed[k] and not expected.may_land[k] and now.at[k] > last.at[k]:
                    found += self._examine(seen, expected, k)
        estimation.keep_reports(now, last, self._step)
        return found

    def follow_frame(self, k: int, jump: Floats) -> None:
        """Follow a frame that moved: the next report is compared in it."""
        self._last.reported[k] -= jump

    def _examine(self, seen: Observation, expected: Expected, k: int) -> list[Finding]:
        last = self._last
        step = float(self._step[k])
        before, up = last.velocity[k], float(seen.velocity[k, 2])
        commanded = min(0.0, float(expected.velocity[k, 2])) if expected.streaming[k] else -SINKING
        if not mode_valid(seen, k):
            commanded = -math.inf
        sinking = commanded - up
        falls = step > 0.04 and (before[2] - up) / step > FALLING and sinking > FALLING_SINKING
        tilt = max(abs(float(seen.attitude[k, 0])), abs(float(seen.attitude[k, 1])))
        if sinking > SINKING or falls or tilt > TURNED_OVER:
            return self._fallen(seen, expected, k, tilt, falls=falls)
        self._disturbed.pop(k, None)
        if step > LONGEST_STEP or k in expected.fallen:
            return []
        predicted = last.reported[k] + 0.5 * step * (before + seen.velocity[k])
        jump = seen.measured.reported[k] - predicted
        size = float(np.linalg.norm(jump))
        if size <= JUMP:
            return []
        words = f"{seen.names[k]}'s position jumped by {size:.1f} m: its frame moved"
        known = not self._reported.first(FailureKind.POSITION_JUMP, k)
        return [Failure(FailureKind.POSITION_JUMP, words, k, jump, known)]

    def _fallen(
        self, seen: Observation, expected: Expected, k: int, tilt: float, *, falls: bool
    ) -> list[Finding]:
        """Return which vehicle has fallen: this one, or a silent neighbour that pulls it.

        A vehicle that sinks without other signs of a fall may do so in a mode of its own choice,
        which must be reported first.
        """
        since, cabled = self._note(seen, k)
        if (cabled or k in expected.opening) and expected.cable in {"lifting", "aloft"}:
            near = neighbours(seen, k)
            silent = [j for j in near if seen.silent_for(j) > UNHEARD and j not in expected.fallen]
            for j in silent:
                if seen.silent_for(j) > FALLEN_SILENCE and (
                    found := fallen_silent(seen, self._reported, j)
                ):
                    return found
            earlier = [j for j in near if j in self._disturbed and self._disturbed[j][0] < since]
            lost = silent or earlier or not expected.fallen.isdisjoint(near)
            pulled = lost or k in expected.opening
            if pulled and seen.now - since <= RECOVERY:
                return []
        turned_over = tilt > TURNED_OVER
        if not (falls or turned_over) and seen.mode_at[k] <= since:
            return []
        if not self._reported.first(FailureKind.FALLING, k):
            return []
        sinking = f"descending at {-float(seen.velocity[k, 2]):.1f} m/s"
        what = "falls" if expected.streaming[k] or falls or turned_over else "leaves the team"
        how = "turned over" if turned_over else sinking
        return [Failure(FailureKind.FALLING, f"{seen.names[k]} {what}: {how}", k)]

    def _note(self, seen: Observation, k: int) -> tuple[float, bool]:
        """Return since when a vehicle moves as if it fell, and whether it held the cable then.

        The time begins anew when it lets the cable go.
        """
        held = bool(seen.gripped[k])
        since, before, cabled = self._disturbed.get(k, (seen.now, held, held))
        since = seen.now if before and not held else since
        self._disturbed[k] = since, held, cabled
        return since, cabled and self._carries_cable
