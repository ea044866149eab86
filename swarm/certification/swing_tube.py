"""The tube of the swinging cable: how far each part of a strand gets from its catenary.

The lumped masses are simulated along the planned motion, and again from an ordinary stop of the
mission clock begun every half second; urgent stops, after failures, are not in it. Vehicles are
exactly on their trajectories, the air is still, and the cable is at rest when it comes aloft. The
tube contains all these strays, and bounds of what lies between the simulated moments and of the
error of the model.
"""

from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from swarm.certification.cable_spans import cable_spans
from swarm.geometry.catenary import solve_catenaries
from swarm.geometry.lumped_mass import at_rest, cable_model, swing_on, swing_on_each
from swarm.planning import Plan, digest
from swarm.planning.clock_limits import BANDWIDTH, ORDINARY

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.intp]

STEP = 0.02
"""Seconds of a step of the simulation: strays of shaped default missions differ by less than 0.5 mm
from those with half of it."""

EVERY = 5
"""Steps between compared moments: 0.1 s."""

BIN = 0.5
"""Seconds of mission time over which the tube is constant, and between the moments of stops."""

STOPPING = 6.0
"""Seconds of a simulated stop: the clock stands after 4 s, and strays are largest in the two
seconds after."""

BETWEEN_SAMPLES = 0.05
"""Share by which a stray can be larger between compared moments: ω²h²/8 for h = 0.1 s and a period
of 1 s, shorter than the first lateral mode of strands with a sag of 0.3 m."""

BETWEEN_STOPS = 0.005
"""Metres by which the stray after a stop can exceed those after the stops before and after it:
measured for stops every 0.25 s in the default overhand and figure-eight, with fold.swing."""

MODEL_ERROR = 0.006
"""Metres by which a finer chain strays farther: 2 mm with 96 links and 2.5 ms in the default
missions with fold.swing, 6 mm in the overhand without."""

_STOPS = 8
"""Stops that are simulated together, which bounds the memory."""

_LEAVES = 8
"""Equal parts of a strand with a radius of their own; dyadic pieces of them have heap numbers."""


@dataclass(frozen=True, eq=False)
class SwingTube:
    """Radii of the tube in metres, constant over BIN seconds from ``start``.

    ``planned`` and ``stopped`` (k, n − 1) are the simulated strays in the planned motion and after
    stops, ``radius`` (k, n − 1, 16) the radius of each dyadic piece by its heap number (1: the
    whole strand; finest: eighths).
    """

    start: float
    planned: Floats
    stopped: Floats
    radius: Floats
    _most: Floats = field(repr=False)
    _least: Floats = field(repr=False)

    @property
    def times(self) -> Floats:
        """Middles (k,) of the intervals, mission time in seconds."""
        return np.asarray(self.start + BIN * (np.arange(len(self.radius)) + 0.5))

    @property
    def largest(self) -> float:
        """The largest radius of all."""
        return float(self.radius[:, :, 1].max())

    def strands(self, time: float) -> Floats:
        """Return the radii (n − 1,) of whole strands at a mission time."""
        found: Floats = self.radius[self._bins(np.array(time)), :, 1]
        return found

    def at(self, segment: int, time: float, fraction: float) -> float:
        """Return the radius of a segment at a mission time and a fraction of its length."""
        leaf = _LEAVES + min(int(fraction * _LEAVES), _LEAVES - 1)
        return float(self.radius[self._bins(np.array(time)), segment, leaf])

    def over(self, segment: Ints, time: Floats, half: Floats, number: Ints) -> "Radii":
        """Return bounds of the radii (b,) of pieces of segments during ``time`` ± ``half``."""
        first, last = self._bins(time - half), self._bins(time + half)
        level = np.frexp(last - first + 1)[1] - 1
        piece = _coarser(number)
        size = np.left_shift(1, level)
        most = np.maximum(
            self._most[level, first, segment, piece],
            self._most[level, last - size + 1, segment, piece],
        )
        middle = self._bins(time)
        return Radii(most, self.radius[middle, segment, piece], self._least[middle, segment, piece])

    def _bins(self, time: Floats) -> Ints:
        number = np.floor((time - self.start) / BIN).astype(np.intp)
        found: Ints = np.clip(number, 0, len(self.radius) - 1)
        return found


@dataclass(frozen=True, eq=False)
class Radii:
    """Radii (b,) of pieces: the ``most`` in an interval of time, that ``now`` at its middle.

    ``least`` is the smallest of the parts of the piece at the middle.
    """

    most: Floats
    now: Floats
    least: Floats

    @property
    def in_time(self) -> Floats:
        """The part of the uncertainty that the interval causes."""
        return self.most - self.now

    @property
    def in_piece(self) -> Floats:
        """The part of the uncertainty that the size of the piece causes."""
        return self.now - self.least

    @staticmethod
    def none(count: int) -> "Radii":
        """Return the radii of strands without swing."""
        zero = np.zeros(count)
        return Radii(zero, zero, zero)


def swing_tube(plan: Plan) -> SwingTube | None:
    """Return the tube of a plan's cable from the beginning of the fold to the end of its flight.

    None for a plan without a fold of cable, and where a chord exceeds its cable, which the checks
    of lengths report.
    """
    return _tube_of(_Named(digest(plan), plan))


@dataclass(frozen=True)
class _Named:
    digest: str
    plan: Plan = field(compare=False)


@lru_cache(maxsize=4)
def _tube_of(named: _Named) -> SwingTube | None:
    """Every call of the certificate's search needs the tube; its plan is told by its digest."""
    plan = named.plan
    span = _aloft(plan)
    if span is None:
        return None
    cable, lengths = plan.mission.cable, plan.layout.lengths
    model = replace(cable_model(cable.mass_per_length, cable.diameter), step=STEP)
    time = np.arange(span[0], span[1] + STEP, STEP)
    ends = plan.motion.at(np.minimum(time, span[1]))[0]
    if (np.linalg.norm(np.diff(ends, axis=1), axis=2) > lengths).any():
        return None
    states = swing_on(at_rest(ends[0], lengths, model), ends, lengths, model, EVERY)
    count = int(np.ceil((span[1] - span[0]) / BIN))
    planned, stopped = np.zeros((2, count, len(lengths), model.links + 1))
    _collect(planned, _strays(states[:, 1], ends[::EVERY], lengths), time[::EVERY] - span[0])
    reached = stop_ramp(plan)
    firsts = np.arange(0, len(time) - 1, round(BIN / STEP))
    for some in np.split(firsts, np.arange(_STOPS, len(firsts), _STOPS)):
        at = np.minimum(time[some, None] + reached, span[1])
        moved = plan.motion.at(at.ravel())[0].reshape(*at.shape, -1, 3)
        swung = swing_on_each(states[some // EVERY], moved, lengths, model, EVERY)[:, :, 1]
        for one, ends_of, when in zip(swung, moved[:, ::EVERY], at[:, ::EVERY], strict=True):
            _collect(stopped, _strays(one, ends_of, lengths), when - span[0])
    return _tube(span[0], planned, stopped)


def stop_ramp(plan: Plan) -> Floats:
    """Return the mission time (k,) since the beginning of a stop, every STEP seconds.

    An ordinary stop: the clock's rate approaches 0 with its bandwidth, by at most ORDINARY and the
    braking reserve over the largest speed, from the full rate.
    """
    vehicles = plan.mission.vehicles
    steepest = min(ORDINARY, vehicles.braking_acceleration / vehicles.max_speed)
    rate, slope, reached = 1.0, 0.0, [0.0]
    for _ in range(round(STOPPING / STEP)):
        wanted = max(-steepest, -BANDWIDTH * rate)
        after = slope + min(1.0, 4.0 * BANDWIDTH * STEP) * (wanted - slope)
        change = 0.5 * (slope + after) * STEP
        reached.append(reached[-1] + (rate + 0.5 * change) * STEP)
        rate, slope = rate + change, after
    return np.array(reached)


def _aloft(plan: Plan) -> tuple[float, float] | None:
    """Return the first and last time of the cable aloft, where the plan folds it."""
    spans = cable_spans(plan)
    folds = any(phase.name == "fold" for phase in plan.phases)
    if not folds or spans.problems or not spans.aloft:
        return None
    return spans.aloft[0][0], spans.aloft[-1][1]


def _strays(joints: Floats, ends: Floats, lengths: Floats) -> Floats:
    """Return the distances (k, n − 1, links + 1) of joints from their catenaries, metres."""
    fractions = np.linspace(0.0, 1.0, joints.shape[2])
    still = solve_catenaries(ends[:, :-1], ends[:, 1:], lengths)
    found: Floats = np.nan_to_num(still.distances(fractions, joints), nan=np.inf)
    return found


def _collect(most: Floats, strays: Floats, since: Floats) -> None:
    """Keep the largest strays in each interval of mission time; ``since`` (k,) increases."""
    which = np.minimum((since / BIN).astype(np.intp), len(most) - 1)
    first = np.flatnonzero(np.diff(which, prepend=-1))
    most[which[first]] = np.maximum(most[which[first]], np.maximum.reduceat(strays, first))


def _tube(start: float, planned: Floats, stopped: Floats) -> SwingTube:
    """Return the tube of the largest strays (k, n − 1, links + 1) in each interval.

    A stop between two simulated ones passes through each mission time at most half an interval from
    where one of them does: the intervals before and after count, too.
    """
    most = np.maximum(planned, stopped)
    wide = np.pad(most, ((1, 1), (0, 0), (0, 0)), mode="edge")
    most = np.maximum(most, np.maximum(wide[:-2], wide[2:]))
    links = (most.shape[2] - 1) // _LEAVES
    leaves = [most[:, :, k * links : (k + 1) * links + 1].max(axis=2) for k in range(_LEAVES)]
    radius, least = np.zeros((2, *most.shape[:2], 2 * _LEAVES))
    radius[:, :, _LEAVES:] = (1.0 + BETWEEN_SAMPLES) * np.stack(leaves, axis=2)
    radius[:, :, _LEAVES:] += BETWEEN_STOPS + MODEL_ERROR
    least[:, :, _LEAVES:] = radius[:, :, _LEAVES:]
    for number in range(_LEAVES - 1, 0, -1):
        parts = slice(2 * number, 2 * number + 2)
        radius[:, :, number] = radius[:, :, parts].max(axis=2)
        least[:, :, number] = least[:, :, parts].min(axis=2)
    return SwingTube(
        start, planned.max(axis=2), stopped.max(axis=2), radius, _range_maxima(radius), least
    )


def _range_maxima(values: Floats) -> Floats:
    """Return the maxima over 1, 2, 4, … entries from each one on, padded with the last."""
    found, size = [values], 1
    while 2 * size <= len(values):
        before = found[-1]
        shifted = np.concatenate([before[size:], np.repeat(before[-1:], size, axis=0)])
        found.append(np.maximum(before, shifted))
        size *= 2
    return np.stack(found)


def _coarser(number: Ints) -> Ints:
    """Return the heap numbers of the eighths that contain finer pieces."""
    depth = np.frexp(number)[1] - 4
    found: Ints = np.right_shift(number, np.maximum(depth, 0))
    return found
