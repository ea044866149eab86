"""Whose gripper has lost the cable: told from how everybody leans.

A vehicle leans against what pulls it sideways: over some time its impulse is m·Δv = ∫(thrust +
pull), so the pull follows from attitudes and velocities alone, and the cable model says what it
should be. Where a gripper opens, its vehicle loses its pull and its neighbours get a strand that is
as long as both of theirs: a pattern over three vehicles that is worked out for each, and looked
for. Wind pushes all alike and fits no pattern; what a sensor or the model has wrong all the time is
learnt as usual. The level parts are enough, and forces within the team cancel out in them.
"""

import math
from collections import deque
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from swarm.flight.detect.latch import Latch
from swarm.flight.failures import Failure, FailureKind, Finding
from swarm.flight.load import TAUT, end_forces
from swarm.flight.observation import Expected, Observation
from swarm.geometry.catenary import STANDARD_GRAVITY
from swarm.jit import compiled
from swarm.planning import Plan

Floats = npt.NDArray[np.float64]

INTERVAL = 0.25
"""Seconds between two looks."""
WINDOW = 6
"""Looks over which an impulse is balanced."""
USUAL_FOR = 20.0
"""Seconds in which a lasting difference becomes usual."""
SHARE = 0.6
"""Share of a pattern from which it counts as seen; without a slip it is about 0, with one about 1.
"""
FAINTEST = 0.2
"""Newtons; a slip that changes the team's level loads by less is not told from noise."""
FITS, HARDLY_FITS = 0.6, 0.4
"""Shares of what differs that the pattern must explain: to be seen, and to be seen faintly, as
where it is no stronger than what the model has wrong by 0.2 N all over the team."""
MOST = 1.6
"""Share of a pattern beyond which something faint is not taken for it."""
FROM_OUTSIDE = 0.8
"""Force from outside the team per force that differs, beyond which something else than the cable
pulls: where a strand is caught, its two vehicles are pulled the same way, and this is above 1. What
the model has wrong of the vehicles farther away is allowed for: faint slips differ by little more.
"""
ENOUGH, CLEARLY, FAINTLY = 4, 2, 1
"""What looks in a row that see the same vehicle's pattern must add up to, and what each counts. In
whole flights without a slip no look sees one even faintly."""
_OLDEST = 0.6
"""Seconds by which the newest position may be old."""


class GripSlipDetector:
    """Compares the cable's level pull on n vehicles, from their attitudes, with the cable model.

    ``enabled`` is false where no cable is carried, or vehicles do not follow the plan's pace.
    """

    def __init__(self, plan: Plan, reported: Latch, *, enabled: bool) -> None:
        self._reported, self._enabled = reported, enabled
        lengths = plan.layout.lengths
        self._lengths = {1: lengths, 2: lengths[:-1] + lengths[1:]}
        self._weight = plan.mission.cable.mass_per_length
        self._mass = plan.mission.vehicles.mass
        self._looks: deque[tuple[float, Floats, Floats]] = deque(maxlen=WINDOW + 1)
        self._usual: Floats | None = None
        self._suspect, self._seen = -1, 0
        self._next = 0.0

    def detect(self, seen: Observation, expected: Expected) -> list[Finding]:
        """Return the vehicle whose gripper has lost the cable without reporting it."""
        if seen.now < self._next:
            return []
        self._next = seen.now + INTERVAL
        if not (self._enabled and self._comparable(seen, expected)):
            self.forget()
            return []
        k = self.look(seen.now, seen.attitude, seen.velocity, seen.position)
        if k is None or not self._reported.first(FailureKind.GRIP_SLIPPED, k):
            return []
        words = f"{seen.names[k]} leans as if its gripper had lost the cable"
        return [Failure(FailureKind.GRIP_SLIPPED, words, k)]

    def _comparable(self, seen: Observation, expected: Expected) -> bool:
        """Return whether attitudes show the pull of a cable that all vehicles hold aloft."""
        held = bool(seen.gripped.all()) and len(seen.names) > 2 and expected.cable == "aloft"
        if not (held and expected.streaming.all()):
            return False
        oldest = seen.now - min(seen.measured.at.tolist())
        return oldest <= _OLDEST and bool(np.isfinite(seen.attitude).all())

    def forget(self) -> None:
        """Begin anew: something keeps the loads from being comparable."""
        self._looks.clear()
        self._usual = None
        self._seen = 0

    def look(self, now: float, attitude: Floats, velocity: Floats, grips: Floats) -> int | None:
        """Return which vehicle's gripper seems to have lost the cable, if one does.

        ``attitude`` (n, 3) roll, pitch, yaw of NED, radians; ``velocity`` and ``grips`` (n, 3),
        mission ENU.
        """
        held = self._held(grips)
        force = thrust(attitude, held.pull, self._mass)
        if self._looks and now - self._looks[-1][0] > 2.0 * INTERVAL:
            self.forget()
        self._looks.append((now, velocity[:, :2].copy(), force))
        if len(self._looks) <= WINDOW:
            return None
        time = now - self._looks[0][0]
        mean = sum([force for _, _, force in self._looks][1:]) / WINDOW
        left = self._mass * (velocity[:, :2] - self._looks[0][1]) / time - mean
        if self._usual is None:
            self._usual = left
        self._usual += (left - self._usual) * (INTERVAL / USUAL_FOR)
        who, counts = self._whose(left - self._usual, held)
        self._seen = self._seen + counts if who == self._suspect else counts
        self._suspect = -1 if who is None else who
        return who if self._seen >= ENOUGH else None

    def shows(self, grips: Floats) -> npt.NDArray[np.bool_]:
        """Return of which vehicles (n,) a slip would change the level pulls enough to be seen."""
        patterns = self._patterns(self._held(grips))
        shown: npt.NDArray[np.bool_] = np.linalg.norm(patterns, axis=(1, 2)) > FAINTEST
        return shown

    def _held(self, grips: Floats) -> "_Held":
        above = np.maximum(grips, [-np.inf, -np.inf, 0.0])
        return _Held(above, *_pulls(above, 1, self._lengths[1], self._weight))

    def _whose(self, left: Floats, held: "_Held") -> tuple[int | None, int]:
        """The vehicle whose pattern explains best what differs (n, 2) from the model, if any does,
        and how much that counts.

        Patterns are only worked out where one could fit: the vehicle's own pull is part of it.
        """
        if not _could_fit(left, held.pull):
            return None, 0
        return _whose(left, left - left.mean(axis=0), self._patterns(held))

    def _patterns(self, held: "_Held") -> Floats:
        """How the level pulls (n, n, 2) change where the vehicle of the first index holds nothing;
        its neighbours' cable is one strand then, or hangs."""
        n = len(held.pull)
        patterns = np.zeros((n, n, 2))
        who, inner = np.arange(n), np.arange(1, n - 1)
        joined_first, joined_last, _ = _pulls(held.above, 2, self._lengths[2], self._weight)
        patterns[who, who] = -held.pull[:, :2]
        patterns[who[1:], who[:-1]] = -held.on_first[:, :2]
        patterns[who[:-1], who[1:]] = -held.on_last[:, :2]
        patterns[inner, inner - 1] += joined_first[:, :2]
        patterns[inner, inner + 1] += joined_last[:, :2]
        return patterns


class _Held(NamedTuple):
    """Grip points off the floor, the strands' forces on their two ends, and the pulls (n, 3)."""

    above: Floats
    on_first: Floats
    on_last: Floats
    pull: Floats


@compiled
def _could_fit(left: Floats, pull: Floats) -> bool:
    """Whether some vehicle's pattern could explain enough of what differs (n, 2) from the model.

    Its own pull (n, 3) is part of its pattern, which lies on it and its neighbours.
    """
    count = len(left)
    squared = np.zeros(count)
    for axis in range(2):
        mean = 0.0
        for k in range(count):
            mean += left[k, axis] / count
        for k in range(count):
            squared[k] += (left[k, axis] - mean) ** 2
    differs = HARDLY_FITS * squared.sum()
    for k in range(count):
        around = squared[max(k - 1, 0) : k + 2].sum()
        own = pull[k, 0] ** 2 + pull[k, 1] ** 2
        if around > (1.0 - 1e-9) * max(SHARE**2 * max(own, FAINTEST**2), differs):
            return True
    return False


def _whose(left: Floats, shared: Floats, patterns: Floats) -> tuple[int | None, int]:
    k, counts = _fitting(shared, patterns)
    if k < 0:
        return None, 0
    near = np.abs(np.arange(len(left)) - k) <= 1
    own = left[near] - (left[~near].mean(axis=0) if not near.all() else 0.0)
    outside = float(np.linalg.norm(own.sum(axis=0))) - _wrong_in_sum(left[~near], len(own))
    if outside >= FROM_OUTSIDE * float(np.linalg.norm(own)):
        return None, 0
    return k, counts


@compiled
def _fitting(shared: Floats, patterns: Floats) -> tuple[int, int]:
    """The vehicle whose pattern fits what differs (n, 2) best, and how much that counts; -1, 0:
    none fits."""
    differs = np.sum(shared * shared)
    best, clear, faint, faintly = -1, 0.0, -1, 0.0
    for k in range(len(patterns)):
        pattern = patterns[k]
        norm, along = np.sum(pattern * pattern), np.sum(pattern * shared)
        if not (norm > FAINTEST**2 and along > SHARE * norm):
            continue
        explained = along * along / max(norm, 1e-9)
        if explained > FITS * differs and explained > clear:
            best, clear = k, explained
        if explained > HARDLY_FITS * differs and along < MOST * norm and explained > faintly:
            faint, faintly = k, explained
    if best >= 0:
        return best, CLEARLY
    return (faint, FAINTLY) if faint >= 0 else (-1, 0)


def _wrong_in_sum(left: Floats, count: int) -> float:
    """By how much the sum of ``count`` vehicles' differences from the mean of the others (n, 2),
    whose pull is as modelled, is wrong as a rule: 0 where there are too few to tell."""
    others = len(left)
    if others < 2:
        return 0.0
    spread = float(np.sum((left - left.mean(axis=0)) ** 2)) / (others - 1)
    return math.sqrt(spread * (count + count * count / others))


@compiled
def _pulls(
    above: Floats, every: int, lengths: Floats, mass_per_length: float
) -> tuple[Floats, Floats, Floats]:
    """Forces on both ends of the strands from each of n vehicles to the next, or the next but one,
    and their sums (n, 3); newtons, ENU."""
    count = len(above) - every
    reaching = np.empty(count)
    for i in range(count):
        square = 0.0
        for k in range(3):
            square += (above[i + every, k] - above[i, k]) ** 2
        reaching[i] = max(lengths[i], math.sqrt(square) / TAUT)
    on_first, on_last = end_forces(above[:count], above[every:], reaching, mass_per_length)
    pull = np.zeros(above.shape)
    for i in range(count):
        for k in range(3):
            pull[i, k] += on_first[i, k]
            pull[i + every, k] += on_last[i, k]
    return on_first, on_last, pull


@compiled
def thrust(attitude: Floats, pull: Floats, mass: float) -> Floats:
    """Return the level forces (n, 2), east and north, of thrusts that carry what they must, and of
    the cable's pulls (n, 3); newtons.

    ``attitude`` (n, 3) as for :func:`lean`.
    """
    force = np.empty((len(pull), 2))
    for i in range(len(pull)):
        bears = mass * (STANDARD_GRAVITY - pull[i, 2] / mass)
        east, north = lean(attitude[i, 0], attitude[i, 1], attitude[i, 2])
        force[i, 0], force[i, 1] = bears * east + pull[i, 0], bears * north + pull[i, 1]
    return force


@compiled
def lean(roll: float, pitch: float, yaw: float) -> tuple[float, float]:
    """Return the level part of the thrust per upward part, east and north.

    Angles of NED in radians; NaN where the thrust hardly points up.
    """
    upward = math.cos(roll) * math.cos(pitch)
    if abs(upward) < 0.1:
        return math.nan, math.nan
    across, along = math.sin(roll), math.cos(roll) * math.sin(pitch)
    east = across * math.cos(yaw) - along * math.sin(yaw)
    north = -along * math.cos(yaw) - across * math.sin(yaw)
    return east / upward, north / upward
