"""One cable in the world: lying, held at some arc lengths, hanging in between, falling, broken.

Between two grips the cable is the catenary of its true length, in the plane of gravity and steady
wind (quasi-static: its own swing is left out); it pulls on both vehicles. Where it would hang below
the floor it lies there, drawn towards both ends without friction. Beyond a chord that its
length allows, it stretches with its axial stiffness and snaps at its breaking load.
"""

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sitl.cable import broad_phase, span_statics
from sitl.cable.spans import NOTHING, Hung, Spans
from sitl.physics.geodesy import GRAVITY
from sitl.physics.motion import AIR_DENSITY
from sitl.world import CableSpec

Array = NDArray[np.float64]
Indices = NDArray[np.intp]
Flags = NDArray[np.bool_]

REACH = 0.15
SPACING = 0.1
_CYLINDER_DRAG = 1.1
_DAMPING_RATIO = 0.1
_NODE_MASS = 1.5
_STIFFEST = 1500.0
_NEARLY, _TIGHT = 0.03, 0.2
_FALL = 9.0


@dataclass(frozen=True)
class End:
    """A loose end: who holds it, how long it is, its samples from the grip to the tip.

    ``away`` is how far along the cable each sample is from the grip.
    """

    vehicle: int
    length: float
    samples: Indices
    away: Array


class Rope:
    """The cable's state: who holds it where, where it is broken, and where its samples are."""

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
        self.spans = NOTHING
        self._set = Spans([], self.arc, floor)
        self._ends: list[End] = []
        self.set_wind(wind)
        self._arrange()

    def set_wind(self, wind: Array) -> None:
        """Take a steady wind (m/s, ENU): it tilts the weight of each metre of cable."""
        drag = 0.5 * AIR_DENSITY * _CYLINDER_DRAG * self.spec.diameter
        load = np.array([0.0, 0.0, -GRAVITY * self.spec.mass_per_length])
        load = load + drag * np.linalg.norm(wind) * np.asarray(wind)
        self.weight = float(np.linalg.norm(load))
        self._set.bear(self.weight)
        self._still = not np.any(wind)
        self.down = load / self.weight

    def set_wash(self, speed: Array, stride: int = 1) -> None:
        """Take every vehicle's downwash at each ``stride``-th sample: it loads the spans below.

        ``speed`` (m, n) is in m/s.

        The drag of each sample, averaged over its span, adds to the span's weight; as a uniform
        load it leaves the catenary's shape as it is and pulls harder on both ends. The wash of the
        two that hold a span is left out: it meets the cable only close to their grips.
        """
        held = self._set
        if not held.count:
            return
        sampled = held.samples % stride == 0
        span_of = held.span_of[sampled]
        felt = speed[held.samples[sampled] // stride]
        if not np.count_nonzero(felt):
            held.bear(self.weight)
            return
        rows = np.arange(len(felt))
        for holders in (held.starts, held.stops):
            own = holders[span_of]
            vehicles = own < felt.shape[1]
            felt[rows[vehicles], own[vehicles]] = 0.0
        fastest = felt.max(axis=1)
        drag = 0.5 * AIR_DENSITY * _CYLINDER_DRAG * self.spec.diameter * fastest**2
        count = np.bincount(span_of, minlength=held.count)
        total = np.bincount(span_of, weights=drag, minlength=held.count)
        held.bear(self.weight + total / np.maximum(count, 1))

    def grab(self, vehicle: int, grip_point: Array) -> float | None:
        """Close a gripper: return the arc length that it holds now, None if nothing is in reach."""
        gaps = np.linalg.norm(self.shape - grip_point, axis=1)
        taken = [arc for arc, _ in self.grips]
        for arc in taken:
            gaps[np.abs(self.arc - arc) < 0.5 * SPACING] = np.inf
        nearest = int(np.argmin(gaps))
        if gaps[nearest] > REACH + SPACING:
            return None
        best, place = np.inf, 0.0
        for first in (nearest - 1, nearest):
            if 0 <= first < len(self.arc) - 1:
                start, end = self.shape[first], self.shape[first + 1]
                step = end - start
                share = float(np.dot(grip_point - start, step) / max(np.dot(step, step), 1e-12))
                share = min(1.0, max(0.0, share))
                gap = float(np.linalg.norm(start + share * step - grip_point))
                if gap < best:
                    best = gap
                    place = float(self.arc[first] + share * (self.arc[first + 1] - self.arc[first]))
        if best > REACH or any(abs(place - arc) < 1e-3 for arc in taken):
            return None
        self.tie(vehicle, place)
        return place

    def tie(self, vehicle: int, arc: float) -> None:
        """Hold the cable at an arc length with a vehicle."""
        self.grips = sorted([*self.grips, (arc, vehicle)])
        self._arrange()

    def release(self, vehicle: int) -> bool:
        """Open a gripper; tell whether it held anything. What it held begins to fall."""
        kept = [grip for grip in self.grips if grip[1] != vehicle]
        if len(kept) == len(self.grips):
            return False
        before = self._pieces()
        self.grips = kept
        after = self._pieces()
        self._fall(before != after)
        self._arrange()
        return True

    def slide(self, vehicle: int, distance: float) -> None:
        """Move a grip along the cable, no further than to its neighbours or the cable's ends."""
        at = [holder for _, holder in self.grips].index(vehicle)
        bounds = [0.0, *self.breaks, *(arc for arc, _ in self.grips), self.length]
        arc = self.grips[at][0]
        low = max((b + SPACING for b in bounds if b < arc), default=0.0)
        high = min((b - SPACING for b in bounds if b > arc), default=self.length)
        self.grips[at] = (min(max(arc + distance, min(low, arc)), max(high, arc)), vehicle)
        self._arrange()

    def free_near(self, arc: float) -> float:
        """Return the free arc length nearest to a wanted one, off all grips by some space."""
        held = np.array([grip for grip, _ in self.grips])
        free = np.abs(self.arc[:, None] - held[None, :]) >= SPACING - 1e-9
        open_to = self.arc[free.all(axis=1)]
        return float(open_to[np.argmin(np.abs(open_to - arc))])

    def place_of(self, arc: float) -> Array:
        """Where the cable is now at an arc length."""
        return np.array([np.interp(arc, self.arc, self.shape[:, i]) for i in range(3)])

    def arc_of(self, vehicle: int) -> float:
        """Arc length at which a vehicle holds the cable, NaN if it does not."""
        for arc, holder in self.grips:
            if holder == vehicle:
                return arc
        return float("nan")

    def _pieces(self) -> Array:
        """For every sample a number that names the pair of grips or breaks around it."""
        marks = sorted([*(arc for arc, _ in self.grips), *self.breaks])
        lower = np.searchsorted(marks, self.arc)
        bounds = np.array([-1.0, *marks, self.length + 1.0])
        named: Array = bounds[lower] * 1e6 + bounds[lower + 1]
        return named

    def _fall(self, samples: NDArray[np.bool_]) -> None:
        self.falling[samples] = np.maximum(self.falling[samples], 1e-6)

    def _arrange(self) -> None:
        """Work out spans and loose ends after a grip, a release or a break."""
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
        self._set = Spans(spans, self.arc, self.floor)
        self._set.bear(self.weight)
        self.patience = 1
        self.spans = NOTHING

    def _end(self, vehicle: int, arc: float, tip: float) -> End:
        low, high = min(arc, tip), max(arc, tip)
        inside = np.nonzero((self.arc >= low) & (self.arc <= high) & (self.arc != arc))[0]
        if tip < arc:
            inside = inside[::-1]
        return End(vehicle, high - low, inside, np.abs(self.arc[inside] - arc))

    def pull(self, grips: Array, velocity: Array) -> Array:
        """Force of the cable on every vehicle (newtons, ENU, (n, 3)).

        ``grips`` and ``velocity`` are all vehicles' grip points and velocities (n, 3).
        """
        self.patience = 5
        held = self._set
        if held.count:
            hung = self.spans = held.hang(grips, self.down, still=self._still)
            load = held.load
            pulls = np.empty((2 * held.count, 3))
            # in slack cable none is more than that at the lowest point and the whole span's weight
            most = span_statics.pulls(load, self.down, hung.flat, hung.figures, pulls)
            slack = max(hung.stretch.tolist())
            if slack > -_TIGHT:
                self.patience = 2
            if slack > -_NEARLY:
                self.patience = 1
                self._stretch(hung, velocity, pulls)
            force = held.onto_holders(pulls, len(grips))
            if self.patience == 1 or most > self.spec.breaking_load:
                self._tear()
        else:
            self.spans = NOTHING
            force = np.zeros_like(grips)
        for end in self._ends:
            hung_length = min(max(float(grips[end.vehicle, 2]) - self.floor, 0.0), end.length)
            force[end.vehicle] += hung_length * self.weight * self.down
        return force

    def _stretch(self, hung: Hung, velocity: Array, pulls: Array) -> None:
        """Add the elastic pull of over-stretched spans to those on starts and stops, in place."""
        held = self._set
        elastic = np.empty(held.count)
        span_statics.stretch(
            hung.start, hung.stop, held.starts, held.stops, held.lengths, hung.figures, velocity,
            (self.spec.stiffness, _STIFFEST, _DAMPING_RATIO, _NODE_MASS), pulls, elastic,
        )  # fmt: skip
        self.spans = hung._replace(elastic=elastic)

    def _tear(self) -> None:
        """Break the cable where it is pulled hardest, if harder than it bears: beside a grip."""
        tension = self.spans.tension
        span = int(np.argmax(tension))
        if tension[span] <= self.spec.breaking_load:
            return
        at = float(self._set.arcs[span])
        before = self._pieces()
        self.breaks = sorted([*self.breaks, at + min(0.05, 0.5 * float(self._set.lengths[span]))])
        self._fall(before != self._pieces())
        self._arrange()

    @property
    def loose(self) -> bool:
        """Whether anything is not where statics alone puts it: falling, or just let go."""
        return (
            bool(np.count_nonzero(self.falling)) or self.spans.figures.shape[1] != self._set.count
        )

    def within_reach(self, centre: Array, radius: Array) -> bool:
        """Whether a disc at any of the centres (n, 3) could touch a span or a loose end.

        It may warn in vain, never keep silent; cable that falls is always looked at closely.
        """
        if self.loose:
            return True
        if not self._set.count:
            return bool(self.grips)
        hung, sideways = self.spans, float(np.hypot(self.down[0], self.down[1]))
        for end in self._ends:
            if end.length > SPACING:
                grip = self._grip_of(end.vehicle)
                if grip is None or broad_phase.of_end(grip, end.length, self.floor, centre, radius):
                    return True
        return broad_phase.of_spans(
            hung.start, hung.stop, hung.length_used, sideways, centre, radius
        )

    def _grip_of(self, vehicle: int) -> Array | None:
        """Where a holder was when the spans were solved, None if it holds no span."""
        at_start = np.nonzero(self._set.starts == vehicle)[0]
        if len(at_start):
            grip: Array = self.spans.start[at_start[0]]
            return grip
        at_stop = np.nonzero(self._set.stops == vehicle)[0]
        return self.spans.stop[at_stop[0]] if len(at_stop) else None

    def follow(self, grips: Array, interval: float, *, solved: bool = False) -> Array:
        """Move the samples to where the cable is now; return them (m, 3).

        What was let go falls towards its new shape no faster than a thing falls; the rest is where
        statics puts it. ``solved`` takes the spans as the last `pull` found them.
        """
        target = self._target(grips, solved=solved)
        loose = self.falling > 0
        if loose.any():
            speed = np.minimum(self.falling + GRAVITY * interval, _FALL)
            gap = target - self.shape
            distance = np.linalg.norm(gap, axis=1)
            most = speed * interval
            share = np.where(loose & (distance > most), most / np.maximum(distance, 1e-9), 1.0)
            self.shape = self.shape + share[:, None] * gap
            self.falling = np.where(loose & (share < 1.0), speed, 0.0)
        else:
            self.shape = target
        return self.shape

    def _target(self, grips: Array, *, solved: bool) -> Array:
        """Where every sample would be at rest (m, 3)."""
        target = self.shape.copy()
        target[:, 2] = self.floor
        held = self._set
        if held.count:
            fresh = solved and self.spans.figures.shape[1] == held.count
            hung = self.spans if fresh else held.hang(grips, self.down, still=self._still)
            held.place(hung, self.down, target)
        for end in self._ends:
            if len(end.samples):
                span_statics.end(target, end.samples, end.away, grips[end.vehicle], self.floor)
        return target
