"""Grippers that have lost the cable without reporting it, from the vehicles' attitudes.

A vehicle leans against a sideways pull. Over a window its impulse is m·Δv = ∫(thrust + pull), so
attitudes and velocities give the pull, and the cable model predicts it. Where a gripper opens, its
vehicle loses its pull and its neighbours share a strand of the length of both: a pattern over three
vehicles, computed for each vehicle and compared with the residual. Wind pushes all vehicles alike
and fits no pattern; a constant error of a sensor or of the model becomes part of the bias. The drag
of the vehicles is the largest of all forces that the model lacks: it is fitted in flight as a force
against the velocity, and setpoints compensate for it too (:mod:`swarm.flight.streams`). The
horizontal parts are enough, and forces within the team cancel in them.
"""

import math
from collections import deque
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from swarm.flight.failures import FailureKind, Finding, Latch
from swarm.flight.load import TAUT, end_forces
from swarm.flight.observation import Expected, Observation
from swarm.geometry.catenary import STANDARD_GRAVITY
from swarm.jit import allocates, compiled, inner
from swarm.planning import Plan
from swarm.signatures import Columns2, Floats1, Floats2, Floats3

Floats = npt.NDArray[np.float64]

INTERVAL = 0.25
"""Seconds between two samples."""
WINDOW = 4
"""Samples over which an impulse is balanced: a second. Attitudes and velocities then leave 0.015 N
RMS of each axis in a dry run of the overhand, 0.03 N with five vehicles."""
DRAG_TIME = 30.0
"""Seconds in which the fitted drag forgets."""
DRAG_PRIOR = 0.5
"""(m/s)² of motion, summed over vehicles and samples, with which a drag of 0 is weighted: that of
nine vehicles at 0.1 m/s in a second and a half."""
MOST_DRAG = 0.6
"""Largest fitted drag per mass, 1/s. That of a quadrotor was identified as 0.54 1/s along one axis
and 0.39 1/s along the other (Faessler, Franchi and Scaramuzza 2018)."""
BIAS_TIME = 20.0
"""Seconds in which a lasting residual becomes part of the bias."""
MIN_SHARE, MAX_SHARE = 0.5, 3.0
"""Shares of a pattern in the residual between which it counts; about 0 without a slip, about 1 with
one. Up to 2.7 were measured for a second while the joined strand falls into its place; a caught
strand reaches more."""
NOISE_FORCE, LEAST_EXPLAINED = 0.2, 0.17
"""Newtons; a slip that changes the team's horizontal loads by less is not distinct from noise; and
the residual that a pattern must explain: all of it is less in 99 of 100 samples without a slip."""
MIN_FIT, MIN_WEAK_FIT = 0.6, 0.4
"""Shares of the residual that the pattern must explain: for a clear match, and for a weak one,
where the pattern is no stronger than a model error of 0.2 N all over the team."""
MAX_WEAK_SHARE = 1.6
"""Share of a pattern beyond which a weak match does not count."""
MAX_NET_FORCE = 0.8
"""Net force on the three vehicles per residual force, beyond which something other than the cable
pulls: a caught strand pulls its two vehicles the same way, with a ratio above 1. The model error of
the vehicles farther away is subtracted: weak slips differ by little more."""
SCORE_NEEDED, CLEAR_SCORE, WEAK_SCORE = 4, 2, 1
"""The sum of scores of successive samples that match the same vehicle's pattern, and the score of
each match. Whole flights without a slip have no match, not even a weak one."""
EXCITED_SCORE = 8
"""The sum of scores that is needed where changes of the clock's rate excite the cable. With delays
of 300 ms the clock slows down to 0, and up to 0.3 again, every 1.3 s. Matches without a slip then
reached 6: they end with the swing, within a second."""
EXCITING_RATE, EXCITING_CHANGE = 0.5, 0.2
"""Rate below which, and change by which, the clock excites the cable. Before 12 slips of 0.3 N or
more it was 0.7 at least, with changes of 0.2 at most."""
_RATES, _SLOWED_BY_SLIP = 15, 3
"""Samples of the rate that are kept, nearly 4 s, and the last ones of them, which a slip itself may
have slowed before it matches."""
_OLDEST = 0.6
"""Seconds of age up to which the oldest position may be used."""


class GripSlipDetector:
    """Compares the cable's horizontal pull on n vehicles, from attitudes, with the cable model.

    ``enabled`` is false where no cable is carried, or vehicles do not follow the plan's pace.
    """

    def __init__(self, plan: Plan, reported: Latch, *, enabled: bool) -> None:
        self._reported, self._enabled = reported, enabled
        lengths = plan.layout.lengths
        self._lengths = {1: lengths, 2: lengths[:-1] + lengths[1:]}
        self._weight = plan.mission.cable.mass_per_length
        self._mass = plan.mission.vehicles.mass
        self._samples: deque[_Sample] = deque(maxlen=WINDOW + 1)
        self._bias: Floats | None = None
        self._moved = self._dragged = 0.0
        self._suspect, self._score = -1, 0
        self._rates: deque[float] = deque(maxlen=_RATES)
        self._next = 0.0

    def detect(self, seen: Observation, expected: Expected) -> list[Finding]:
        """Return the vehicle whose gripper has lost the cable without reporting it."""
        if seen.now < self._next:
            return []
        self._next = seen.now + INTERVAL
        self._rates.append(expected.rate)
        if not (self._enabled and self._comparable(seen, expected)):
            self.reset()
            return []
        at = seen.measured.at
        grips = seen.position - (seen.now - at)[:, None] * seen.velocity
        k = self.evaluate(at, seen.attitude, seen.velocity, grips)
        if k is None:
            return []
        words = f"{seen.names[k]} leans as after a slip of the cable"
        return self._reported.once(FailureKind.GRIP_SLIP, k, words)

    def _comparable(self, seen: Observation, expected: Expected) -> bool:
        """Return whether attitudes show the pull of a cable that all vehicles hold aloft."""
        held = bool(seen.gripped.all()) and len(seen.names) > 2 and expected.cable == "aloft"
        if not (held and expected.streaming.all()):
            return False
        oldest = seen.now - min(seen.measured.at.tolist())
        return oldest <= _OLDEST and bool(np.isfinite(seen.attitude).all())

    def reset(self) -> None:
        """Begin again: the loads were not comparable."""
        self._samples.clear()
        self._bias = None
        self._score = 0

    def evaluate(self, at: Floats, attitude: Floats, velocity: Floats, grips: Floats) -> int | None:
        """Return the vehicle whose gripper has lost the cable; None where none has.

        ``at`` (n,) are the times at which ``velocity`` and ``grips`` (n, 3), mission ENU, were
        measured; ``attitude`` (n, 3), roll, pitch, yaw of NED in radians, is taken as of then.
        """
        held = self._held(grips)
        force = thrust(attitude, held.pull, self._mass)
        if not (np.isfinite(force).all() and np.isfinite(velocity).all()):
            # NaN would stay in the fit of the drag, and so in all setpoints
            self.reset()
            return None
        if self._samples and float((at - self._samples[-1].at[:, 0]).max()) > 2.0 * INTERVAL:
            # a force that changes by 1.5 N and back in a gap is not seen: an error of 0.5 N
            self._samples.clear()
            self._score = 0
        self._samples.append(_Sample(at[:, None].copy(), velocity[:, :2].copy(), force))
        if len(self._samples) <= WINDOW:
            return None
        times, speeds, forces = zip(*self._samples, strict=True)
        time = times[-1] - times[0]
        # Without the first sample, a force that changes by 0.6 N in 0.25 s would lead by 0.08 N;
        # as of the time of reading, one of 1.5 N by 0.45 N where delays grow by 0.3 s.
        moving, mean = (np.trapezoid(each, times, axis=0) / time for each in (speeds, forces))
        residual = self._mass * (speeds[-1] - speeds[0]) / time - mean
        before = residual + self._drag * moving if self._bias is None else self._bias
        residual = self._without_drag(residual, moving, before)
        self._bias = before + (residual - before) * (INTERVAL / BIAS_TIME)
        who, score = self._match(residual - self._bias, held)
        self._score = self._score + score if who == self._suspect else score
        self._suspect = -1 if who is None else who
        return who if self._score >= score_needed(self._rates) else None

    @property
    def drag(self) -> float:
        """The fitted drag of a vehicle per its mass, 1/s, at most MOST_DRAG.

        0 until vehicles have moved relative to each other with the cable aloft. Setpoints of
        vehicles whose drag the fleet file does not state compensate for it.
        """
        return min(self._drag / self._mass, MOST_DRAG)

    @property
    def _drag(self) -> float:
        """The fitted drag of a vehicle, N·s/m."""
        return max(self._dragged / (self._moved + DRAG_PRIOR), 0.0)

    def _without_drag(self, residual: Floats, moving: Floats, bias: Floats) -> Floats:
        """Return the residual (n, 2) without drag; fit that to it and to the velocities.

        Wind adds the same force everywhere, and the bias is known: both are left out of the fit.
        """
        speed = moving - moving.mean(axis=0)
        force = residual - bias
        force -= force.mean(axis=0)
        remembered = 1.0 - INTERVAL / DRAG_TIME
        self._moved = remembered * self._moved + float(np.sum(speed * speed))
        self._dragged = remembered * self._dragged - float(np.sum(force * speed))
        free: Floats = residual + self._drag * moving
        return free

    def detectable(self, grips: Floats) -> npt.NDArray[np.bool_]:
        """Return for which vehicles (n,) a slip changes the pulls enough to be detected."""
        patterns = self._patterns(self._held(grips))
        enough: npt.NDArray[np.bool_] = np.linalg.norm(patterns, axis=(1, 2)) > NOISE_FORCE
        return enough

    def _held(self, grips: Floats) -> "_Held":
        above = np.maximum(grips, [-np.inf, -np.inf, 0.0])
        return _Held(above, *_pulls(above, 1, self._lengths[1], self._weight))

    def _match(self, residual: Floats, held: "_Held") -> tuple[int | None, int]:
        """Return the vehicle whose pattern explains the residual (n, 2) best, and the score.

        None and 0 where no pattern does. Patterns are computed only where one could fit: the
        vehicle's own pull is part of it.
        """
        if not _could_fit(residual, held.pull):
            return None, 0
        return match(residual, residual - residual.mean(axis=0), self._patterns(held))

    def _patterns(self, held: "_Held") -> Floats:
        """Return the changes of the horizontal pulls (n, n, 2) where the vehicle of the first index
        slips; the cable between its neighbours is one strand then, or hangs."""
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


class _Sample(NamedTuple):
    """What vehicles showed at a time of reading: times (n, 1) of measurement, velocities and forces
    (n, 2)."""

    at: Floats
    velocity: Floats
    force: Floats


class _Held(NamedTuple):
    """Grip points not below the floor, the strands' forces on their ends, and the pulls (n, 3)."""

    above: Floats
    on_first: Floats
    on_last: Floats
    pull: Floats


@compiled
@allocates
def _could_fit(residual: Floats2, pull: Floats2) -> bool:
    """Return whether any vehicle's pattern could explain enough of the residual (n, 2).

    The vehicle's own pull (n, 3) is part of its pattern, which covers it and its neighbours.
    """
    count = len(residual)
    squared = np.zeros(count)
    for axis in range(2):
        mean = 0.0
        for k in range(count):
            mean += residual[k, axis] / count
        for k in range(count):
            squared[k] += (residual[k, axis] - mean) ** 2
    total = 0.0
    for k in range(count):
        total += squared[k]
    total *= MIN_WEAK_FIT
    for k in range(count):
        around = 0.0
        for j in range(max(k - 1, 0), min(k + 2, count)):
            around += squared[j]
        own = pull[k, 0] ** 2 + pull[k, 1] ** 2
        if around > (1.0 - 1e-9) * max(MIN_SHARE**2 * max(own, NOISE_FORCE**2), total):
            return True
    return False


def score_needed(rates: Iterable[float]) -> int:
    """Return the sum of scores with which a slip counts, after these rates of the clock.

    The rates are one for each sample. The last ones do not count: a slip itself slows the clock.
    """
    before = list(rates)[:-_SLOWED_BY_SLIP]
    excited = (
        bool(before) and min(before) < EXCITING_RATE and max(before) - min(before) > EXCITING_CHANGE
    )
    return EXCITED_SCORE if excited else SCORE_NEEDED


def match(residual: Floats, centred: Floats, patterns: Floats) -> tuple[int | None, int]:
    """Return the vehicle whose pattern matches the residual (n, 2), and the score; None, 0: none.

    ``centred`` is the residual without its mean. A net force from outside the cable is no match.
    """
    k, score = _best_fit(centred, patterns)
    if k < 0:
        return None, 0
    near = np.abs(np.arange(len(residual)) - k) <= 1
    own = residual[near] - (residual[~near].mean(axis=0) if not near.all() else 0.0)
    net = float(np.linalg.norm(own.sum(axis=0))) - _sum_error(residual[~near], len(own))
    if net >= MAX_NET_FORCE * float(np.linalg.norm(own)):
        return None, 0
    return k, score


@compiled
@allocates
def _best_fit(centred: Floats2, patterns: Floats3) -> tuple[int, int]:
    """Return the vehicle whose pattern fits the centred residual (n, 2) best, and the score.

    -1 and 0 where none fits.
    """
    total = np.sum(centred * centred)
    best, clear, weak, weakly = -1, 0.0, -1, 0.0
    for k in range(len(patterns)):
        pattern = patterns[k]
        norm, along = np.sum(pattern * pattern), np.sum(pattern * centred)
        if not (norm > NOISE_FORCE**2 and along > MIN_SHARE * norm):
            continue
        explained = along * along / norm
        if along > MAX_SHARE * norm or explained < LEAST_EXPLAINED**2:
            continue
        if explained > MIN_FIT * total and explained > clear:
            best, clear = k, explained
        if (
            explained > MIN_WEAK_FIT * total
            and along < MAX_WEAK_SHARE * norm
            and explained > weakly
        ):
            weak, weakly = k, explained
    if best >= 0:
        return best, CLEAR_SCORE
    return (weak, WEAK_SCORE) if weak >= 0 else (-1, 0)


def _sum_error(residual: Floats, count: int) -> float:
    """Return the usual error of the sum of ``count`` vehicles' differences from a mean.

    The mean is of the other vehicles' residuals (n, 2), whose pull is as modelled. 0 where there
    are fewer than two.
    """
    others = len(residual)
    if others < 2:
        return 0.0
    spread = float(np.sum((residual - residual.mean(axis=0)) ** 2)) / (others - 1)
    return math.sqrt(spread * (count + count * count / others))


@compiled
@allocates
def _pulls(
    above: Floats2, every: int, lengths: Floats1, mass_per_length: float
) -> tuple[Floats, Floats, Floats]:
    """Return the forces on both ends of the strands from each of n vehicles to the next (``every``
    1) or to the next but one (2), and their sums (n, 3); newtons, ENU."""
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
@allocates
def thrust(attitude: Columns2, pull: Floats2, mass: float) -> Floats:
    """Return the horizontal forces (n, 2), east and north, of the thrusts that carry vehicle and
    cable, plus the cable's pulls (n, 3); newtons.

    ``attitude`` (n, 3) as for :func:`lean`.
    """
    force = np.empty((len(pull), 2))
    for i in range(len(pull)):
        lift = mass * (STANDARD_GRAVITY - pull[i, 2] / mass)
        east, north = lean(attitude[i, 0], attitude[i, 1], attitude[i, 2])
        force[i, 0], force[i, 1] = lift * east + pull[i, 0], lift * north + pull[i, 1]
    return force


@inner
def lean(roll: float, pitch: float, yaw: float) -> tuple[float, float]:
    """Return the horizontal part of the thrust per vertical part, east and north.

    Angles of NED in radians; NaN where the thrust is nearly horizontal.
    """
    upward = math.cos(roll) * math.cos(pitch)
    if abs(upward) < 0.1:
        return math.nan, math.nan
    across, along = math.sin(roll), math.cos(roll) * math.sin(pitch)
    east = across * math.cos(yaw) - along * math.sin(yaw)
    north = -along * math.cos(yaw) - across * math.sin(yaw)
    return east / upward, north / upward
