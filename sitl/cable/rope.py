"""The cable: held at some arc lengths, hanging between them, on the floor, falling, broken.

Between two grips the cable is the catenary of its true length, in the plane of gravity and steady
wind (quasi-static: without its own oscillation); it pulls on both vehicles. A part that would hang
below the floor lies on it, drawn towards both ends without friction. A span whose chord exceeds its
length stretches with the axial stiffness and breaks at the breaking load.
"""

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sitl.cable import broad_phase, span_statics
from sitl.cable.grips import SPACING, FreeMotion, caught, nearest_free, slid
from sitl.cable.spans import NO_SPANS, SolvedSpans, Spans
from sitl.physics.geodesy import GRAVITY
from sitl.physics.motion import AIR_DENSITY
from sitl.world import CableSpec

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

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
                if grip is None or broad_phase.end_reachable(
                    grip, end.length, self.floor, centre, radius
                ):
                    return True
        return broad_phase.spans_reachable(
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
