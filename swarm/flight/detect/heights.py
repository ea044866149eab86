"""Drifting barometers: each vehicle's height against its GPS, compared with the other vehicles."""

import math
from statistics import median

import numpy as np
import numpy.typing as npt

from swarm.flight.detect.latch import Latch
from swarm.flight.failures import Failure, FailureKind, Finding
from swarm.flight.observation import Expected, Observation

Floats = npt.NDArray[np.float64]

HEIGHT_DRIFT = (0.3, 1.0)
"""Metres by which one vehicle's height may drift against its GPS compared with the others': with
receivers that report a good accuracy while the cable is aloft, and otherwise. A receiver never
permits less than its own accuracy."""
LARGEST_STEP = 0.4
"""Metres by which a height is corrected at once, so that the team need not follow a step."""
_ACCURACIES = 5.0
"""Multiple of the receivers' stated vertical accuracy that a drift must exceed."""
_INTERVAL = 1.0
"""Seconds between comparisons: heights drift over minutes."""


class HeightDetector:
    """Detects heights that drift; remembers the differences with which the comparison began.

    ``reference`` (n,) in metres; it begins anew when the cable is aloft: the gate on the levelled
    line has judged the differences before that. A drift that is reported counts as a jump of the
    reported height, and becomes part of the reference: it may go on during a landing of half a
    minute.
    """

    def __init__(self, n: int, reported: Latch) -> None:
        self._reported = reported
        self.reference: Floats = np.full(n, np.nan)
        self._next, self._aloft = 0.0, False

    def detect(self, seen: Observation, expected: Expected) -> list[Finding]:
        """Return the vehicles whose heights have drifted, once a second."""
        if seen.now < self._next:
            return []
        self._next = seen.now + _INTERVAL
        drift = self._drift(seen, expected)
        if np.count_nonzero(np.isnan(drift)) or len(drift) < 3:
            return []
        middle = median(drift.tolist())
        accuracies = seen.height_accuracy.tolist()
        stated = [accuracy for accuracy in accuracies if not math.isnan(accuracy)]
        accuracies = [math.inf if math.isnan(accuracy) else accuracy for accuracy in accuracies]
        least, most = HEIGHT_DRIFT
        least = least if self._aloft else most
        most, usual = max(most, *stated) if stated else most, median(accuracies)
        found: list[Finding] = []
        for k, by in enumerate(drift.tolist()):
            off = by - middle
            allowed = min(max(_ACCURACIES * max(accuracies[k], usual), least), most)
            # an ArduCopter that has landed and disarmed sets its height anew; a PX4 on the ground
            # drifted by 1.2 m before it had detected that: the team can only land, and does
            flies = expected.armed[k] and seen.armed[k] and not expected.may_land[k]
            if flies and abs(off) > allowed:
                step = math.copysign(min(abs(off), LARGEST_STEP), off)
                words = f"{seen.names[k]}'s height has drifted by {off:+.1f} m"
                jump = np.array([0.0, 0.0, -step])
                known = not self._reported.first(FailureKind.HEIGHT_DRIFT, k)
                found.append(Failure(FailureKind.HEIGHT_DRIFT, words, k, jump, known))
        return found

    def follow_frame(self, k: int, jump: Floats, kind: FailureKind) -> None:
        """Follow a frame that moved: a drift becomes part of the reference, and after a jump of the
        position, which its satellite receiver may share, the vehicle is compared anew."""
        drifted = kind is FailureKind.HEIGHT_DRIFT
        self.reference[k] = self.reference[k] - jump[2] if drifted else np.nan

    def _drift(self, seen: Observation, expected: Expected) -> Floats:
        begun = expected.cable == "aloft" and not expected.waiting and not expected.holds
        if begun and not self._aloft:
            self.reference[:], self._aloft = np.nan, True
        fresh = np.isnan(self.reference)
        self.reference[fresh] = seen.height_gap[fresh]
        return seen.height_gap - self.reference
