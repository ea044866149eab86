"""The cable: held at some arc lengths, hanging between them, on the floor, falling, broken.

Between two grips the cable is the catenary of its true length, in the plane of gravity and steady
wind (quasi-static: without its own oscillation); it pulls on both vehicles. A part that would hang
below the floor lies on it, drawn towards both ends without friction. A span whose chord exceeds its
length stretches with the axial stiffness and breaks at the breaking load.

Broad phase of the collision check: whether a rotor can touch the cable.

It is cheap and conservative: it may report a contact that does not exist, but misses none.

Statics of the spans of a cable between grips: catenaries, partly on the floor.

With the horizontal distance ``h`` and the rise ``v`` between the ends, the length ``L`` and
``z = h/2a``: ``sinh z / z = √(L² − v²)/h``; the horizontal tension is ``w a``; the ends carry
``w (L ∓ v coth z)/2`` (Routh, "Analytical Statics", ch. X; Irvine, "Cable Structures", 1981).
A span that would hang below the floor lies on it, drawn towards both ends without friction.
"""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sitl.cable import span_statics
from sitl.cable.grips import SPACING, FreeMotion, caught, nearest_free, slid
from sitl.physics.geodesy import GRAVITY
from sitl.physics.motion import AIR_DENSITY
from sitl.world import CableSpec
from swarm.jit import compiled
from swarm.signatures import Columns2, Floats1, Floats2

Array = NDArray[np.float64]

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


Indices = NDArray[np.intp]

_EMPTY = np.zeros(0)


class SolvedSpans(NamedTuple):
    """The solution of all spans: geometry, catenary, load.

    ``ends`` (2 m, 3) are all starts, then all stops; ``flat`` (m, 3) are the vectors from start to
    stop perpendicular to the weight; ``solution`` (`span_statics.ROWS`, m) has the properties below
    as rows; ``load`` (m,) is the weight per metre, ``length`` (m,) the unstretched length,
    ``elastic`` the elastic force of overstretched spans in newtons.
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
    def distance(self) -> Array:
        """Distances between the ends perpendicular to the weight, metres."""
        distance: Array = self.solution[span_statics.DISTANCE]
        return distance

    @property
    def parameter(self) -> Array:
        """Parameters of the catenaries, metres."""
        parameter: Array = self.solution[span_statics.PARAMETER]
        return parameter

    @property
    def start_arc(self) -> Array:
        """Arc lengths from the lowest points to the starts."""
        arc: Array = self.solution[span_statics.START_ARC]
        return arc

    @property
    def stop_arc(self) -> Array:
        """Arc lengths from the lowest points to the stops."""
        arc: Array = self.solution[span_statics.STOP_ARC]
        return arc

    @property
    def length_used(self) -> Array:
        """Lengths in the catenary formulae: those of overstretched spans include the stretch."""
        used: Array = self.solution[span_statics.USED]
        return used

    @property
    def stretch(self) -> Array:
        """Differences between chord and cable length, metres; negative for slack spans."""
        stretch: Array = self.solution[span_statics.STRETCH]
        return stretch

    @property
    def horizontal_tension(self) -> Array:
        """Horizontal tension in newtons."""
        level: Array = self.load * self.parameter
        return level

    @property
    def tension(self) -> Array:
        """The largest tension of each span in newtons, at its higher end."""
        reach = np.maximum(np.abs(self.start_arc), np.abs(self.stop_arc))
        tension: Array = self.horizontal_tension + self.load * reach + self.elastic
        return tension

    @property
    def chord(self) -> Array:
        """Distances between the ends in metres."""
        chord: Array = np.hypot(self.distance, self.solution[span_statics.RISE])
        return chord


_NO_POINTS = np.zeros((0, 3))
NO_SPANS = SolvedSpans(
    _NO_POINTS, _NO_POINTS, np.zeros((span_statics.ROWS, 0)), _EMPTY, _EMPTY
)  # fmt: skip


class Spans:
    """The spans between neighbouring grips: holders, lengths, loads, samples."""

    def __init__(
        self, spans: Sequence[tuple[int, int, float, float]], arc: Array, floor: float
    ) -> None:
        """``spans`` are (holder, next holder, length, arc of the start), ``arc`` all samples."""
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

    @property
    def samples(self) -> Indices:
        """The samples on spans (k,)."""
        samples: Indices = self.index[0]
        return samples

    @property
    def span_of(self) -> Indices:
        """The span of each of these samples (k,)."""
        spans: Indices = self.index[1]
        return spans

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
        solution = np.empty((span_statics.ROWS, self.count))
        bottom = down, self.floor
        span_statics.solve(ends, self.lengths, bottom, self._parameter, flat, solution)
        return SolvedSpans(ends, flat, solution, self.load, self.lengths)

    def place(self, solved: SolvedSpans, down: Array, target: Array) -> None:
        """Place the samples of solved spans in ``target`` (n, 3) of all samples."""
        span_statics.place_samples(
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


class Rope:
    """State of the cable: grips, breaks, and the positions of its samples.

    ``grips`` are (arc length, holder) in order, ``shape`` (m, 3) the samples at ``arc`` (m,),
    ``solved`` the spans of the last `forces`, ``force_interval`` the steps until the next one.
    """

    def __init__(self, spec: CableSpec, floor: float, wind: Array) -> None:
        self.spec = spec
        self.floor = floor
        points = np.array(spec.points, dtype=float)
        steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
        along = np.concatenate([[0.0], np.cumsum(steps)])
        self.length = float(along[-1])
        count = max(2, int(np.ceil(self.length / SPACING)) + 1)
        self.arc = np.linspace(0.0, self.length, count)
        self.shape = np.column_stack([np.interp(self.arc, along, points[:, i]) for i in range(3)])
        self.falling = np.zeros(count)
        self.grips: list[tuple[float, int]] = []
        self.breaks: list[float] = []
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
        sampled = spans.samples % stride == 0
        span_of = spans.span_of[sampled]
        wash = speed[spans.samples[sampled] // stride]
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

    def grab(self, vehicle: int, grip_point: Array) -> float | None:
        """Close a gripper; return the arc length that it holds, None if no cable is in reach."""
        arc = caught(self.grips, self.arc, self.shape, grip_point)
        if arc is not None:
            self.attach(vehicle, arc)
        return arc

    def attach(self, vehicle: int, arc: float, grip_point: Array | None = None) -> None:
        """Attach the cable to a holder at an arc length; the ``grip_point`` is not needed here."""
        del grip_point
        self.grips = sorted([*self.grips, (arc, vehicle)])
        self._rebuild()

    def release(self, vehicle: int) -> bool:
        """Detach the cable from a holder; return whether it was attached. Free cable falls."""
        kept = [grip for grip in self.grips if grip[1] != vehicle]
        if len(kept) == len(self.grips):
            return False
        before = self._pieces()
        self.grips = kept
        after = self._pieces()
        self._fall(before != after)
        self._rebuild()
        return True

    def slide(self, vehicle: int, distance: float) -> None:
        """Move a grip along the cable, at most to its neighbours, a break or the cable's ends."""
        self.grips = slid(self.grips, vehicle, distance, [0.0, *self.breaks, self.length])
        self._rebuild()

    def nearest_free(self, arc: float) -> float:
        """Return the arc length nearest to ``arc`` that is at least SPACING from all grips."""
        return nearest_free(self.grips, self.arc, arc)

    def position_at(self, arc: float) -> Array:
        """Return the position (3,) of the cable at an arc length."""
        return np.array([np.interp(arc, self.arc, self.shape[:, i]) for i in range(3)])

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
        for (arc, one), (next_arc, other) in itertools.pairwise(self.grips):
            cut = broken[(broken > arc) & (broken < next_arc)]
            if len(cut):
                ends += [(one, arc, float(cut[0])), (other, next_arc, float(cut[-1]))]
            else:
                spans.append((one, other, next_arc - arc, arc))
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
            most = span_statics.end_forces(
                spans.load, self.down, solved.flat, solved.solution, on_ends
            )
            stretch = max(solved.stretch.tolist())
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
        span_statics.add_elastic_forces(
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
            solved.start, solved.stop, solved.length_used, sideways, centre, radius
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
                span_statics.place_loose_end(
                    target, end.samples, end.away, grips[end.vehicle], self.floor
                )
        return target
