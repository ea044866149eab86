"""The cable: held at some arc lengths, hanging between them, on the floor, falling, broken.

Between two grips the cable is the catenary of its true length, in the plane of gravity and steady
wind (quasi-static: without its own oscillation); it pulls on both vehicles. A part that would hang
below the floor lies on it, drawn towards both ends without friction. A span whose chord exceeds its
length stretches with the axial stiffness and breaks at the breaking load.

Statics of a span: with the horizontal distance ``h`` and the rise ``v`` between the ends, the
length ``L`` and ``z = h/2a``: ``sinh z / z = √(L² − v²)/h``; the horizontal tension is ``w a``; the
ends carry ``w (L ∓ v coth z)/2`` (Routh, "Analytical Statics", ch. X; Irvine, "Cable Structures",
1981). The compiled loops run over spans: for eight spans, some sixty small array operations would
take twenty times as long.
"""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sitl.cable.grips import SPACING, Cable, FreeMotion
from sitl.physics.dynamics import Array
from sitl.physics.geodesy import GRAVITY
from sitl.physics.motion import AIR_DENSITY
from sitl.world import CableSpec
from swarm.jit import allocates, compiled, inner
from swarm.signatures import Columns2, Floats1, Floats2, Ints1, Ints2

Indices = NDArray[np.intp]

_ROTOR_HEIGHT = 0.2
_DRIFT = 0.5
"""Metres by which a grip may have moved since the spans were solved."""


@compiled
def spans_reachable(
    start: Floats2,
    stop: Floats2,
    length: Floats1,
    sideways: float,
    centre: Columns2,
    radius: Floats1,
) -> bool:
    """Return whether a disc at a centre (n, 3) can touch a span from start to stop (m, 3).

    A span of at most ``length`` (m,) hangs below its higher end. In plan it departs from its chord
    by at most the drift of its length in a steady wind: ``sideways`` is the level part of the
    direction of its weight.
    """
    for j in range(len(start)):
        top = max(start[j, 2], stop[j, 2]) + _ROTOR_HEIGHT
        east, north = stop[j, 0] - start[j, 0], stop[j, 1] - start[j, 1]
        rise = stop[j, 2] - start[j, 2]
        squared = max(east * east + north * north, 1e-8)
        for i in range(len(centre)):
            if centre[i, 2] >= top:
                continue
            away_east, away_north = centre[i, 0] - start[j, 0], centre[i, 1] - start[j, 1]
            share = (away_east * east + away_north * north) / squared
            share = min(max(share, 0.0), 1.0)
            away_east -= share * east
            away_north -= share * north
            beside = radius[i] + sideways * length[j]
            if away_east * away_east + away_north * away_north >= beside * beside:
                continue
            # highest point of the chord, and so of the span, above the disc
            height = start[j, 2] + share * rise + beside * abs(rise) / math.sqrt(squared)
            if centre[i, 2] < height + _ROTOR_HEIGHT:
                return True
    return False


def end_reachable(grip: Array, length: float, floor: float, centre: Array, radius: Array) -> bool:
    """Return whether a disc at any of the centres (n, 3) can touch a loose end.

    The end hangs vertically below its grip (3,); a part near the floor may lie anywhere.
    """
    below = centre[:, 2] < grip[2] + _ROTOR_HEIGHT
    if float(grip[2]) - length >= floor + _DRIFT:
        away = np.hypot(centre[:, 0] - grip[0], centre[:, 1] - grip[1])
        below &= away < radius + _DRIFT
    return bool(np.count_nonzero(below))


TAUT, FLAT = 0.03, 0.01
LEAST, MOST = 1e-4, 1e4
TABLE_Z = np.geomspace(TAUT, 40.0, 3000)
TABLE_RATIO = np.log(np.sinh(TABLE_Z) / TABLE_Z - 1.0)
TABLE_LOG_Z = np.log(TABLE_Z)
TAUT_RATIO = float(np.sinh(TAUT) / TAUT)
_CONVERGED, _ITERATIONS = 1e-6, 12

DISTANCE, RISE, PARAMETER, START_ARC, STOP_ARC, USED, STRETCH, LENGTH, RESTING = range(9)
ROWS = 9
"""Rows of a solution (ROWS, m); `SolvedSpans` explains them."""


@compiled
def _solve(
    ends: Floats2, lengths: Floats1, bottom: tuple[Floats1, float], guess: Floats1, flat: Floats2,
    solution: Floats2,
) -> None:  # fmt: skip
    """Solve the catenaries of m spans; write ``flat`` (m, 3) and ``solution`` (ROWS, m).

    ``ends`` (2 m, 3) are all starts, then all stops; ``bottom`` is the direction (3,) of the
    weight, and the height of the floor; ``guess`` (m,) are the parameters of the last solution on
    the floor, updated here.
    """
    down, floor = bottom
    count = len(lengths)
    still = down[0] == 0.0 and down[1] == 0.0
    for i in range(count):
        start, stop = ends[i], ends[count + i]
        for k in range(3):
            flat[i, k] = stop[k] - start[k]
        if still:
            rise = flat[i, 2]
            flat[i, 2] = 0.0
        else:
            rise = -(flat[i, 0] * down[0] + flat[i, 1] * down[1] + flat[i, 2] * down[2])
            for k in range(3):
                flat[i, k] += rise * down[k]
        distance = math.sqrt(flat[i, 0] ** 2 + flat[i, 1] ** 2 + flat[i, 2] ** 2)
        distance = max(distance, 1e-4)
        shortest = math.hypot(rise, distance * TAUT_RATIO)
        length = max(lengths[i], shortest)
        ratio = math.sqrt(length * length - rise * rise) / distance
        z = math.exp(_log_z(math.log(ratio - 1.0)))
        a = 0.5 * distance / z
        tilt = rise / math.tanh(z)
        start_arc, stop_arc = 0.5 * (length - tilt), 0.5 * (length + tilt)
        lowest = min(start[2], stop[2])
        if start_arc > 0.0 and stop_arc > 0.0:
            lowest = start[2] - (math.hypot(start_arc, a) - a)
        resting = lowest < floor - 1e-9
        if resting:
            first = max(start[2] - floor, 1e-6)
            last = max(stop[2] - floor, 1e-6)
            slack = max(lengths[i] - distance, (TAUT_RATIO - 1.0) * distance)
            a, start_arc, stop_arc = _on_floor(first, last, distance, slack, guess[i])
            if a > LEAST:
                guess[i] = a
        solution[DISTANCE, i], solution[RISE, i], solution[PARAMETER, i] = distance, rise, a
        solution[START_ARC, i], solution[STOP_ARC, i] = start_arc, stop_arc
        solution[USED, i], solution[STRETCH, i] = length, shortest - lengths[i]
        solution[LENGTH, i], solution[RESTING, i] = lengths[i], 1.0 if resting else 0.0


@inner
def _log_z(ratio: float) -> float:
    """Return log z for ``ratio = log(sinh z / z − 1)``, by linear interpolation in the table."""
    low, high = 0, len(TABLE_RATIO) - 1
    if ratio <= TABLE_RATIO[low]:
        return float(TABLE_LOG_Z[low])
    if ratio >= TABLE_RATIO[high]:
        return float(TABLE_LOG_Z[high])
    while high - low > 1:
        middle = (low + high) // 2
        if TABLE_RATIO[middle] <= ratio:
            low = middle
        else:
            high = middle
    slope = (TABLE_LOG_Z[high] - TABLE_LOG_Z[low]) / (TABLE_RATIO[high] - TABLE_RATIO[low])
    return float(slope * (ratio - TABLE_RATIO[low]) + TABLE_LOG_Z[low])


@inner
def _on_floor(
    first: float, last: float, distance: float, slack: float, guess: float
) -> tuple[float, float, float]:
    """Return the parameter and the two hanging arcs of a span that reaches the floor.

    Two half catenaries descend to the floor; ``first`` and ``last`` are the heights of the ends.
    With more slack than the sum of the heights, the ends hang straight down. The parameter of a
    taut span is limited; its elasticity takes the rest of the load, as in the air.
    """
    both = first + last
    if slack >= 0.999 * both or both < FLAT:
        return LEAST, first, last
    a = min(_floor_parameter(first, last, slack, guess), distance / (2.0 * TAUT))
    return a, math.sqrt(first**2 + 2.0 * first * a), math.sqrt(last**2 + 2.0 * last * a)


@inner
def _floor_parameter(first: float, last: float, slack: float, guess: float) -> float:
    """Return the catenary parameter of a span whose two ends descend to the floor.

    ``L − h = Σ (s_i − x_i)`` with ``s = √(H² + 2Ha)``, ``x = a acosh(1 + H/a)`` determines ``a``;
    Newton in ``log a`` against ``log (L − h)``, from the root of the last step.
    """
    a = min(max(guess, LEAST), MOST)
    target = math.log(max(slack, 1e-9))
    for _ in range(_ITERATIONS):
        arc, other = math.sqrt(first * (first + 2.0 * a)), math.sqrt(last * (last + 2.0 * a))
        angle, turn = math.acosh(1.0 + first / a), math.acosh(1.0 + last / a)
        value = max(arc - a * angle + other - a * turn, 1e-12)
        slope = min((2.0 * first / arc - angle + 2.0 * last / other - turn) * a, -1e-12)
        update = (target - math.log(value)) * value / slope
        a = a * math.exp(min(max(update, -1.5), 1.5))
        a = min(max(a, LEAST), MOST)
        if abs(update) < _CONVERGED:
            break
    return a


@compiled
def _end_forces(
    load: Floats1, down: Floats1, flat: Floats2, solution: Floats2, force: Floats2
) -> float:
    """Write the forces on all starts and then all stops, newtons, into ``force`` (2 m, 3).

    ``load`` (m,) is the weight per metre of each span. Returns an upper bound of the tension in a
    slack span: the tension at its lowest point plus its whole weight.
    """
    count, most = len(load), 0.0
    for i in range(count):
        level = load[i] * solution[PARAMETER, i] / solution[DISTANCE, i]
        for k in range(3):
            force[i, k] = load[i] * solution[START_ARC, i] * down[k] + level * flat[i, k]
            force[count + i, k] = load[i] * solution[STOP_ARC, i] * down[k] - level * flat[i, k]
        most = max(most, load[i] * (solution[PARAMETER, i] + solution[USED, i]))
    return most


@compiled
@allocates
def _add_elastic_forces(
    ends: Floats2, holders: Ints1, velocity: Columns2, solution: Floats2,
    constants: tuple[float, float, float, float], forces: tuple[Floats2, Floats1],
) -> None:  # fmt: skip
    """Write the elastic forces of overstretched spans, and add them to the forces on their ends.

    ``forces`` are those on the ends (2 m, 3) and the elastic ones (m,), in newtons. ``holders``
    (2 m,) hold the starts, then the stops; ``velocity`` (n, 3) is of all holders.
    ``constants`` are the axial stiffness of the cable in newtons, the largest stiffness of a span
    in N/m, the damping ratio and the mass at an end in kg.
    """
    (axial, stiffest, ratio, mass), (force, elastic) = constants, forces
    count = len(elastic)
    along = np.empty(3)
    for i in range(count):
        chord = max(math.hypot(solution[DISTANCE, i], solution[RISE, i]), 1e-9)
        opening = 0.0
        for k in range(3):
            along[k] = (ends[count + i, k] - ends[i, k]) / chord
            opening += (velocity[holders[count + i], k] - velocity[holders[i], k]) * along[k]
        stiffness = min(axial / solution[LENGTH, i], stiffest)
        damping = 2 * ratio * math.sqrt(stiffness * mass)
        pull = max(stiffness * solution[STRETCH, i] + damping * opening, 0.0)
        elastic[i] = pull if solution[STRETCH, i] > 0 else 0.0
        for k in range(3):
            force[i, k] += elastic[i] * along[k]
            force[count + i, k] -= elastic[i] * along[k]


@compiled
def _place_loose_end(
    target: Floats2, samples: Ints1, away: Floats1, grip: Floats1, floor: float
) -> None:
    """Place the samples of a loose end vertically below its ``grip`` (3,), in ``target`` (m, 3).

    ``away`` (k,) are the distances of ``samples`` (k,) from the grip along the cable. The part that
    reaches the floor stays at its place, but no sample is farther from the grip than the length of
    cable between them.
    """
    height = max(grip[2] - floor, 0.0)
    for j in range(len(samples)):
        place = target[samples[j]]
        east, north = place[0] - grip[0], place[1] - grip[1]
        reach = max(away[j] - height, 0.0)
        share = min(1.0, reach / max(math.hypot(east, north), 1e-9))
        place[0], place[1] = grip[0] + share * east, grip[1] + share * north
        place[2] = max(grip[2] - away[j], floor)


@compiled
def _place_samples(
    samples: tuple[Ints2, Floats1], ends: Floats2, flat: Floats2, solution: Floats2,
    bottom: tuple[Floats1, float], target: Floats2,
) -> None:  # fmt: skip
    """Place the samples of solved spans in ``target`` (n, 3) of all samples.

    ``samples`` are numbers (2, m) of samples and their spans, and the distances (m,) from the
    spans' starts; ``bottom`` is the direction (3,) of the weight, and the height of the floor.
    """
    (index, along), (down, floor) = samples, bottom
    for m in range(len(along)):
        j, place = index[1, m], target[index[0, m]]
        a, start_arc, distance = (
            solution[PARAMETER, j],
            solution[START_ARC, j],
            solution[DISTANCE, j],
        )
        if solution[RESTING, j] > 0.0:
            sideways, height = _resting_point(along[m], solution[:, j])
            for k in range(3):
                place[k] = ends[j, k] + sideways / distance * flat[j, k]
            place[2] = floor + height
            continue
        s = along[m] * solution[USED, j] / solution[LENGTH, j] - start_arc
        sideways = a * (math.asinh(s / a) + math.asinh(start_arc / a))
        drop = math.hypot(start_arc, a) - math.hypot(s, a)
        for k in range(3):
            place[k] = ends[j, k] + sideways / distance * flat[j, k] + drop * down[k]


@inner
def _resting_point(along: float, span: Array) -> tuple[float, float]:
    """Return distance from the start and height above the floor of a point of a resting span.

    ``span`` (ROWS,) is the solution: down one end, along the floor, up the other end.
    """
    distance, a = span[DISTANCE], span[PARAMETER]
    start_arc, stop_arc, length = span[START_ARC], span[STOP_ARC], span[LENGTH]
    curved = a > LEAST
    first = a * math.asinh(start_arc / a) if curved else 0.0
    last = a * math.asinh(stop_arc / a) if curved else 0.0
    ground = max(distance - first - last, 0.0)
    lies = max(length - start_arc - stop_arc, 1e-9)
    place = first + min(max((along - start_arc) / lies, 0.0), 1.0) * ground
    height = 0.0
    for end in range(2):
        s = start_arc - along if end == 0 else stop_arc - (length - along)
        if s > 0.0:
            height = max(height, math.hypot(s, a) - a if curved else s)
            out = a * math.asinh(s / a) if curved else 0.0
            place = first - out if end == 0 else distance - last + out
    return place, height


_EMPTY = np.zeros(0)


class SolvedSpans(NamedTuple):
    """The solution of all spans: geometry, catenary, load.

    ``ends`` (2 m, 3) are all starts, then all stops; ``flat`` (m, 3) are the vectors from start to
    stop perpendicular to the weight; ``load`` (m,) is the weight per metre, ``length`` (m,) the
    unstretched length, ``elastic`` the elastic force of overstretched spans in newtons.

    ``solution`` (`ROWS`, m) has as rows: the distances of the ends perpendicular to the weight and
    along it, the parameters of the catenaries, the arc lengths from the lowest points to starts and
    stops, the lengths in the formulae of a catenary (those of overstretched spans include the
    stretch), chord less length (negative for slack spans), the lengths, and whether a span rests
    on the floor.
    """

    ends: Array
    flat: Array
    solution: Array
    load: Array
    length: Array
    elastic: Array | float = 0.0

    @property
    def start(self) -> Array:
        """Starts of the spans (m, 3)."""
        return self.ends[: len(self.length)]

    @property
    def stop(self) -> Array:
        """Stops of the spans (m, 3)."""
        return self.ends[len(self.length) :]

    @property
    def tension(self) -> Array:
        """The largest tension of each span in newtons, at its higher end."""
        arcs = np.abs(self.solution[START_ARC]), np.abs(self.solution[STOP_ARC])
        level = self.load * self.solution[PARAMETER]
        tension: Array = level + self.load * np.maximum(*arcs) + self.elastic
        return tension

    @property
    def chord(self) -> Array:
        """Distances between the ends in metres."""
        chord: Array = np.hypot(self.solution[DISTANCE], self.solution[RISE])
        return chord


_NO_POINTS = np.zeros((0, 3))
NO_SPANS = SolvedSpans(
    _NO_POINTS, _NO_POINTS, np.zeros((ROWS, 0)), _EMPTY, _EMPTY
)  # fmt: skip


class Spans:
    """The spans between neighbouring grips: holders, lengths, loads, samples."""

    def __init__(
        self, spans: Sequence[tuple[int, int, float, float]], arc: Array, floor: float
    ) -> None:
        """``spans`` are (holder, next holder, length, arc of the start), ``arc`` all samples.

        ``index`` (2, k) are the samples on spans, and the span of each.
        """
        self.floor = floor
        self.count = len(spans)
        self.starts: Indices = np.array([s[0] for s in spans], dtype=np.intp)
        self.stops: Indices = np.array([s[1] for s in spans], dtype=np.intp)
        self.holders = np.concatenate([self.starts, self.stops])
        self.lengths = np.array([s[2] for s in spans])
        self.arcs = np.array([s[3] for s in spans])
        self._onto = np.zeros((0, 0))
        self.load = _EMPTY
        self._parameter = np.full(len(spans), 1.0)
        self.index: Indices = np.zeros((2, 0), dtype=np.intp)
        self._along = _EMPTY
        if spans:
            number = np.searchsorted(self.arcs, arc, side="right") - 1
            along = arc - self.arcs[number]
            held = (number >= 0) & (along >= 0) & (along <= self.lengths[number])
            self.index = np.stack([np.nonzero(held)[0], number[held]])
            self._along = along[held]

    def sum_over_holders(self, forces: Array, count: int) -> Array:
        """Return the sums (count, 3) of the forces on all starts, then all stops (2 m, 3)."""
        if self._onto.shape[1] != len(forces) or len(self._onto) != count:
            self._onto = np.zeros((count, len(forces)))
            self._onto[self.holders, np.arange(len(forces))] = 1.0
        force: Array = np.dot(self._onto, forces)
        return force

    def set_load(self, load: float | Array) -> None:
        """Set the weight per metre of all spans, or of each (newtons)."""
        self.load = np.full(self.count, load) if np.isscalar(load) else np.asarray(load)

    def solve(self, grips: Array, down: Array) -> SolvedSpans:
        """Return the catenaries of all spans, two halves of one where a span lies on the floor.

        ``grips`` (n, 3) are of all holders, ``down`` (3,) is the direction of the weight.
        """
        ends = grips.take(self.holders, axis=0)
        flat = np.empty((self.count, 3))
        solution = np.empty((ROWS, self.count))
        bottom = down, self.floor
        _solve(ends, self.lengths, bottom, self._parameter, flat, solution)
        return SolvedSpans(ends, flat, solution, self.load, self.lengths)

    def place(self, solved: SolvedSpans, down: Array, target: Array) -> None:
        """Place the samples of solved spans in ``target`` (n, 3) of all samples."""
        _place_samples(
            (self.index, self._along), solved.ends, solved.flat, solved.solution,
            (down, self.floor), target,
        )  # fmt: skip


CYLINDER_DRAG = 1.1
"""Drag coefficient of a cylinder in crossflow."""
_DAMPING_RATIO, _END_MASS, _LARGEST_STIFFNESS = 0.1, 1.5, 1500.0
"""Damping ratio, mass at an end in kg and largest stiffness in N/m of an overstretched span."""
_NEARLY_TAUT, _LITTLE_SLACK = 0.03, 0.2
"""Slack in metres below which forces are computed at every step, and at every second step."""
_FALL_SPEED = 9.0
"""Largest speed of falling cable, m/s."""


@dataclass(frozen=True)
class End:
    """A loose end: its holder, its length, its samples from the grip to the tip.

    ``away`` are the distances of the samples from the grip along the cable.
    """

    vehicle: int
    length: float
    samples: Indices
    away: Array


class Rope(Cable):
    """State of the cable that follows statics.

    ``solved`` are the spans of the last `forces`, ``force_interval`` the steps until the next one.
    """

    def __init__(self, spec: CableSpec, floor: float, wind: Array) -> None:
        super().__init__(spec, floor)
        initial = self.initial.T
        self.shape = np.column_stack([np.interp(self.arc, self.along, axis) for axis in initial])
        self.falling = np.zeros(len(self.arc))
        self.solved = NO_SPANS
        self._spans = Spans([], self.arc, floor)
        self._ends: list[End] = []
        self.set_wind(wind)
        self._rebuild()

    def set_wind(self, wind: Array) -> None:
        """Set the steady wind (m/s, ENU): it tilts the weight of the cable."""
        drag = 0.5 * AIR_DENSITY * CYLINDER_DRAG * self.spec.diameter
        load = np.array([0.0, 0.0, -GRAVITY * self.spec.mass_per_length])
        load = load + drag * np.linalg.norm(wind) * np.asarray(wind)
        self.weight = float(np.linalg.norm(load))
        self._spans.set_load(self.weight)
        self.down = load / self.weight

    def set_wash(self, speed: Array, stride: int = 1) -> None:
        """Set the downwash of each vehicle at every ``stride``-th sample (m, n), m/s.

        The drag of the samples, averaged over a span, adds to the span's weight; as a uniform load
        it keeps the shape of the catenary and increases the forces on both ends. The downwash of
        the two holders of a span is omitted: it meets the cable only close to their grips.
        """
        spans = self._spans
        if not spans.count:
            return
        sampled = spans.index[0] % stride == 0
        samples, span_of = spans.index[:, sampled]
        wash = speed[samples // stride]
        if not np.count_nonzero(wash):
            spans.set_load(self.weight)
            return
        rows = np.arange(len(wash))
        for holders in (spans.starts, spans.stops):
            own = holders[span_of]
            vehicles = own < wash.shape[1]
            wash[rows[vehicles], own[vehicles]] = 0.0
        fastest = wash.max(axis=1)
        drag = 0.5 * AIR_DENSITY * CYLINDER_DRAG * self.spec.diameter * fastest**2
        count = np.bincount(span_of, minlength=spans.count)
        total = np.bincount(span_of, weights=drag, minlength=spans.count)
        spans.set_load(self.weight + total / np.maximum(count, 1))

    def release(self, vehicle: int) -> bool:
        """Detach the cable from a holder; return whether it was attached. Free cable falls."""
        before = self._pieces()
        released = super().release(vehicle)
        self._fall(before != self._pieces())
        return released

    def _pieces(self) -> Array:
        """Return a number for every sample that identifies the grips or breaks around it."""
        marks = sorted([*(arc for arc, _ in self.grips), *self.breaks])
        lower = np.searchsorted(marks, self.arc)
        bounds = np.array([-1.0, *marks, self.length + 1.0])
        pieces: Array = bounds[lower] * 1e6 + bounds[lower + 1]
        return pieces

    def _fall(self, samples: NDArray[np.bool_]) -> None:
        self.falling[samples] = np.maximum(self.falling[samples], 1e-6)

    def _rebuild(self) -> None:
        """Compute spans and loose ends after a grip, a release or a break."""
        broken = np.array(self.breaks)
        spans: list[tuple[int, int, float, float]] = []
        ends: list[tuple[int, float, float]] = []
        for (arc, holder), (next_arc, next_holder) in itertools.pairwise(self.grips):
            cut = broken[(broken > arc) & (broken < next_arc)]
            if len(cut):
                ends += [(holder, arc, float(cut[0])), (next_holder, next_arc, float(cut[-1]))]
            else:
                spans.append((holder, next_holder, next_arc - arc, arc))
        if self.grips:
            first, last = self.grips[0], self.grips[-1]
            low = max([0.0, *(b for b in self.breaks if b < first[0])])
            high = min([self.length, *(b for b in self.breaks if b > last[0])])
            ends += [(first[1], first[0], low), (last[1], last[0], high)]
        self._ends = [self._end(*end) for end in ends if abs(end[2] - end[1]) > 1e-9]
        self._spans = Spans(spans, self.arc, self.floor)
        self._spans.set_load(self.weight)
        self.force_interval = 1
        self.solved = NO_SPANS

    def _end(self, vehicle: int, arc: float, tip: float) -> End:
        low, high = min(arc, tip), max(arc, tip)
        inside = np.nonzero((self.arc >= low) & (self.arc <= high) & (self.arc != arc))[0]
        if tip < arc:
            inside = inside[::-1]
        inside = np.ascontiguousarray(inside)
        return End(vehicle, high - low, inside, np.abs(self.arc[inside] - arc))

    def forces(self, grips: Array, velocity: Array, free: FreeMotion | None = None) -> Array:
        """Return the forces of the cable on all holders, newtons, ENU (n, 3); break an overload.

        ``grips`` and ``velocity`` (n, 3) are the grip points and velocities of all holders; their
        ``free`` motion is not needed here.
        """
        del free
        self.force_interval = 5
        spans = self._spans
        if spans.count:
            solved = self.solved = spans.solve(grips, self.down)
            on_ends = np.empty((2 * spans.count, 3))
            most = _end_forces(spans.load, self.down, solved.flat, solved.solution, on_ends)
            stretch = max(solved.solution[STRETCH].tolist())
            if stretch > -_LITTLE_SLACK:
                self.force_interval = 2
            if stretch > -_NEARLY_TAUT:
                self.force_interval = 1
                self._add_elastic_forces(solved, velocity, on_ends)
            force = spans.sum_over_holders(on_ends, len(grips))
            if self.force_interval == 1 or most > self.spec.breaking_load:
                self._break_overloaded()
        else:
            self.solved = NO_SPANS
            force = np.zeros_like(grips)
        for end in self._ends:
            hanging = min(max(float(grips[end.vehicle, 2]) - self.floor, 0.0), end.length)
            force[end.vehicle] += hanging * self.weight * self.down
        return force

    def _add_elastic_forces(self, solved: SolvedSpans, velocity: Array, on_ends: Array) -> None:
        """Add the elastic forces of overstretched spans to the forces on their ends, in place."""
        spans = self._spans
        elastic = np.empty(spans.count)
        constants = (self.spec.stiffness, _LARGEST_STIFFNESS, _DAMPING_RATIO, _END_MASS)
        _add_elastic_forces(
            solved.ends, spans.holders, velocity, solved.solution, constants, (on_ends, elastic)
        )
        self.solved = solved._replace(elastic=elastic)

    def _break_overloaded(self) -> None:
        """Break the span of largest tension, beside its grip, if it exceeds the breaking load."""
        tension = self.solved.tension
        span = int(np.argmax(tension))
        if tension[span] <= self.spec.breaking_load:
            return
        at = float(self._spans.arcs[span])
        before = self._pieces()
        self.breaks = sorted([*self.breaks, at + min(0.05, 0.5 * float(self._spans.lengths[span]))])
        self._fall(before != self._pieces())
        self._rebuild()

    @property
    def unsettled(self) -> bool:
        """Whether a part falls, or the solved spans are out of date."""
        return bool(np.count_nonzero(self.falling)) or not self._is_solved()

    def _is_solved(self) -> bool:
        """Return whether `solved` has the present spans."""
        return len(self.solved.length) == self._spans.count

    def within_reach(self, centre: Array, radius: Array) -> bool:
        """Return whether a disc at any of the centres (n, 3) can touch a span or a loose end.

        The check is conservative; falling cable is always in reach.
        """
        if self.unsettled:
            return True
        if not self._spans.count:
            return bool(self.grips)
        solved, sideways = self.solved, float(np.hypot(self.down[0], self.down[1]))
        for end in self._ends:
            if end.length > SPACING:
                grip = self._grip_of(end.vehicle)
                if grip is None or end_reachable(grip, end.length, self.floor, centre, radius):
                    return True
        return spans_reachable(
            solved.start, solved.stop, solved.solution[USED], sideways, centre, radius
        )

    def _grip_of(self, vehicle: int) -> Array | None:
        """Return the grip point of a holder in the solved spans, None if it holds no span."""
        at_start = np.nonzero(self._spans.starts == vehicle)[0]
        if len(at_start):
            grip: Array = self.solved.start[at_start[0]]
            return grip
        at_stop = np.nonzero(self._spans.stops == vehicle)[0]
        return self.solved.stop[at_stop[0]] if len(at_stop) else None

    def update(self, grips: Array, interval: float, *, solved: bool = False) -> Array:
        """Update the samples to the present grip points; return them (m, 3).

        Released cable falls towards its new shape with the acceleration of gravity; the rest
        follows statics. ``solved`` uses the spans that the last `forces` solved.
        """
        target = self._target(grips, solved=solved)
        falls = self.falling > 0
        if falls.any():
            speed = np.minimum(self.falling + GRAVITY * interval, _FALL_SPEED)
            gap = target - self.shape
            distance = np.linalg.norm(gap, axis=1)
            most = speed * interval
            share = np.where(falls & (distance > most), most / np.maximum(distance, 1e-9), 1.0)
            self.shape = self.shape + share[:, None] * gap
            self.falling = np.where(falls & (share < 1.0), speed, 0.0)
        else:
            self.shape = target
        return self.shape

    def _target(self, grips: Array, *, solved: bool) -> Array:
        """Return the positions of all samples at rest (m, 3)."""
        target = self.shape.copy()
        target[:, 2] = self.floor
        spans = self._spans
        if spans.count:
            usable = solved and self._is_solved()
            solution = self.solved if usable else spans.solve(grips, self.down)
            spans.place(solution, self.down, target)
        for end in self._ends:
            if len(end.samples):
                _place_loose_end(target, end.samples, end.away, grips[end.vehicle], self.floor)
        return target
