"""One cable in the world: lying, held at some arc lengths, hanging in between, falling, broken.

Between two grips the cable is the catenary of its true length, in the plane of gravity and steady
wind (quasi-static: its own swing is left out); it pulls on both vehicles. Where it would hang below
the floor it lies there, drawn towards both ends without friction. Beyond a chord that its
length allows, it stretches with its axial stiffness and snaps at its breaking load.

With ``h``, ``v`` the level and upward distance between the ends, ``L`` the length and
``z = h/2a``: ``sinh z / z = √(L² − v²)/h``; level tension ``w a``; the ends carry
``w (L ∓ v coth z)/2`` (Routh, "Analytical Statics", ch. X; Irvine, "Cable Structures", 1981).
"""

import itertools
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sitl.dynamics import AIR_DENSITY, GRAVITY
from sitl.world import CableSpec

Array = NDArray[np.float64]
Indices = NDArray[np.intp]
Flags = NDArray[np.bool_]

REACH = 0.15
SPACING = 0.1
_CYLINDER_DRAG = 1.1
_TAUT = 0.03
_DAMPING_RATIO = 0.1
_NODE_MASS = 1.5
_STIFFEST = 1500.0
_NEARLY, _TIGHT = 0.03, 0.2
_FLAT = 0.01
_LEAST, _MOST = 1e-4, 1e4
_FALL = 9.0
_DRIFT = 0.5
_ROTOR_HEIGHT = 0.2
_TABLE_Z = np.geomspace(_TAUT, 40.0, 3000)
_TABLE_RATIO = np.log(np.sinh(_TABLE_Z) / _TABLE_Z - 1.0)
_TABLE_LOG_Z = np.log(_TABLE_Z)
_TAUT_RATIO = float(np.sinh(_TAUT) / _TAUT)


class Hung(NamedTuple):
    """Every span between two grips, solved: geometry, catenary, tension (arrays over spans)."""

    start: Array
    stop: Array
    across: Array
    direction: Array
    a: Array
    low: Array
    high: Array
    length_used: Array
    stretch: Array
    resting: Flags | None
    level: Array
    tension: Array
    chord: Array
    length: Array


@dataclass(frozen=True)
class End:
    """A loose end: who holds it, how long it is, its samples from the grip to the tip."""

    vehicle: int
    length: float
    samples: Indices
    away: Array


_EMPTY = np.zeros(0)
_NONE = Hung(
    _EMPTY, _EMPTY, _EMPTY, _EMPTY, _EMPTY, _EMPTY, _EMPTY, _EMPTY, _EMPTY, None, _EMPTY, _EMPTY,
    _EMPTY, _EMPTY,
)  # fmt: skip


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
        self.spans = _NONE
        self.lengths = _EMPTY
        self.set_wind(wind)
        self._arrange()

    def set_wind(self, wind: Array) -> None:
        """Take a steady wind (m/s, ENU): it tilts the weight of each metre of cable."""
        drag = 0.5 * AIR_DENSITY * _CYLINDER_DRAG * self.spec.diameter
        load = np.array([0.0, 0.0, -GRAVITY * self.spec.mass_per_length])
        load = load + drag * np.linalg.norm(wind) * np.asarray(wind)
        self.weight = float(np.linalg.norm(load))
        self._load = np.full(len(self.lengths), self.weight)
        self._still = not np.any(wind)
        self.down = load / self.weight
        self._sideways = float(np.hypot(self.down[0], self.down[1]))

    def set_wash(self, speed: Array, stride: int = 1) -> None:
        """Take every vehicle's downwash at each ``stride``-th sample: it loads the spans below.

        ``speed`` (m, n) is in m/s.

        The drag of each sample, averaged over its span, adds to the span's weight; as a uniform
        load it leaves the catenary's shape as it is and pulls harder on both ends. The wash of the
        two that hold a span is left out: it meets the cable only close to their grips.
        """
        if not len(self.starts):
            return
        sampled = self._between % stride == 0
        span_of = self._span_of[sampled]
        felt = speed[self._between[sampled] // stride]
        if not felt.any():
            self._load = np.full(len(self.starts), self.weight)
            return
        rows = np.arange(len(felt))
        for holders in (self.starts, self.stops):
            own = holders[span_of]
            vehicles = own < felt.shape[1]
            felt[rows[vehicles], own[vehicles]] = 0.0
        fastest = felt.max(axis=1)
        drag = 0.5 * AIR_DENSITY * _CYLINDER_DRAG * self.spec.diameter * fastest**2
        count = np.bincount(span_of, minlength=len(self.starts))
        total = np.bincount(span_of, weights=drag, minlength=len(self.starts))
        self._load = self.weight + total / np.maximum(count, 1)

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

    def let_go(self, vehicle: int) -> bool:
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
        self.starts: Indices = np.array([s[0] for s in spans], dtype=np.intp)
        self.stops: Indices = np.array([s[1] for s in spans], dtype=np.intp)
        self.lengths = np.array([s[2] for s in spans])
        self.span_arcs = np.array([s[3] for s in spans])
        self._load = np.full(len(spans), self.weight)
        self._longest = float(self.lengths.max()) if spans else 0.0
        self._parameter = np.full(len(spans), 1.0)
        self._between = np.zeros(0, dtype=np.intp)
        if spans:
            number = np.searchsorted(self.span_arcs, self.arc, side="right") - 1
            along = self.arc - self.span_arcs[number]
            held = (number >= 0) & (along >= 0) & (along <= self.lengths[number])
            self._between = np.nonzero(held)[0]
            self._span_of = number[held]
            self._along = along[held]
        self.patience = 1
        self.spans = _NONE

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
        force = np.zeros_like(grips)
        self.patience = 5
        if len(self.starts):
            hung = self._hang(grips)
            self.spans = hung
            weight = self._load[:, None] * self.down
            level = hung.level[:, None] * hung.direction
            on_start = level + hung.low[:, None] * weight
            on_stop = hung.high[:, None] * weight - level
            slack = float(hung.stretch.max())
            if slack > -_TIGHT:
                self.patience = 2
            if slack > -_NEARLY:
                self.patience = 1
                self._stretch(hung, velocity, on_start, on_stop)
            force[self.starts] += on_start
            force[self.stops] += on_stop
            if hung.tension.max() > self.spec.breaking_load:
                self._snap(int(np.argmax(hung.tension)))
        else:
            self.spans = _NONE
        for end in self._ends:
            hanging = min(max(float(grips[end.vehicle, 2]) - self.floor, 0.0), end.length)
            force[end.vehicle] += hanging * self.weight * self.down
        return force

    def _hang(self, grips: Array) -> Hung:
        """Solve every span's catenary, or its two halves where it lies on the floor."""
        start, stop = grips[self.starts], grips[self.stops]
        flat = stop - start
        if self._still:
            upward = flat[:, 2].copy()
            flat[:, 2] = 0.0
            across = np.maximum(np.hypot(flat[:, 0], flat[:, 1]), 1e-4)
        else:
            upward = -(flat @ self.down)
            flat += upward[:, None] * self.down
            across = np.maximum(np.sqrt(np.einsum("ij,ij->i", flat, flat)), 1e-4)
        direction = flat / across[:, None]
        shortest = np.hypot(upward, across * _TAUT_RATIO)
        length = np.maximum(self.lengths, shortest)
        ratio = np.sqrt(length**2 - upward**2) / across
        z = np.exp(np.interp(np.log(ratio - 1.0), _TABLE_RATIO, _TABLE_LOG_Z))
        a = 0.5 * across / z
        tilt = upward / np.tanh(z)
        low, high = 0.5 * (length - tilt), 0.5 * (length + tilt)
        resting = None
        lowest = min(float(start[:, 2].min()), float(stop[:, 2].min()))
        if lowest - 0.5 * self._longest < self.floor:
            resting = self._resting(start, stop, a, low, high)
            if resting is not None:
                a, low, high = self._on_floor(start, stop, across, a, low, high, resting)
        level = self._load * a
        tension = level + self._load * np.maximum(np.abs(low), np.abs(high))
        distance = np.hypot(across, upward)
        return Hung(
            start, stop, across, direction, a, low, high, length, shortest - self.lengths, resting,
            level, tension, distance, self.lengths,
        )  # fmt: skip

    def _stretch(self, hung: Hung, velocity: Array, on_start: Array, on_stop: Array) -> None:
        """Add the elastic pull of over-stretched spans, in place."""
        chord = hung.stop - hung.start
        along = chord / np.maximum(hung.chord, 1e-9)[:, None]
        stiffness = np.minimum(self.spec.stiffness / self.lengths, _STIFFEST)
        opening = np.einsum("ij,ij->i", velocity[self.stops] - velocity[self.starts], along)
        damping = 2 * _DAMPING_RATIO * np.sqrt(stiffness * _NODE_MASS)
        pull = np.maximum(stiffness * hung.stretch + damping * opening, 0.0)
        pull *= hung.stretch > 0
        on_start += pull[:, None] * along
        on_stop -= pull[:, None] * along
        hung.tension[:] += pull

    def _resting(
        self, start: Array, stop: Array, a: Array, low: Array, high: Array
    ) -> Flags | None:
        """Which spans would hang below the floor at their lowest point, None if none would."""
        lowest = np.minimum(start[:, 2], stop[:, 2])
        bottom = start[:, 2] - (np.hypot(low, a) - a)
        lowest = np.where((low > 0) & (high > 0), bottom, lowest)
        below = lowest < self.floor - 1e-9
        return below if below.any() else None

    def _on_floor(
        self, start: Array, stop: Array, across: Array, a: Array, low: Array, high: Array,
        resting: Flags,
    ) -> tuple[Array, Array, Array]:  # fmt: skip
        """Two half catenaries that come down to the floor, and what lies straight between them.

        Where there is more slack than the ends are high, the ends just hang down; a taut span is
        left to its elasticity (`_stretch`), as one in the air is.
        """
        heights = np.maximum(np.stack([start[:, 2], stop[:, 2]]) - self.floor, 1e-6)
        slack = np.maximum(self.lengths - across, (_TAUT_RATIO - 1.0) * across)
        both = heights[0] + heights[1]
        hangs = (slack >= 0.999 * both) | (both < _FLAT)
        sought = np.nonzero(resting & ~hangs)[0]
        guess = np.full(len(a), _LEAST)
        if len(sought):
            most = across[sought] / (2 * _TAUT)
            found = _floor_parameter(heights[:, sought], slack[sought], self._parameter[sought])
            guess[sought] = np.minimum(found, most)
            self._parameter[sought] = guess[sought]
        arcs = np.where(hangs, heights, np.sqrt(heights**2 + 2 * heights * guess))
        return (
            np.where(resting, guess, a),
            np.where(resting, arcs[0], low),
            np.where(resting, arcs[1], high),
        )

    def _snap(self, span: int) -> None:
        """Break the cable where it is pulled hardest: just beside one of the two grips."""
        at = float(self.span_arcs[span])
        before = self._pieces()
        self.breaks = sorted([*self.breaks, at + min(0.05, 0.5 * float(self.lengths[span]))])
        self._fall(before != self._pieces())
        self._arrange()

    @property
    def loose(self) -> bool:
        """Whether anything is not where statics alone puts it: falling, or just let go."""
        return bool(self.falling.any()) or len(self.spans.a) != len(self.starts)

    def within_reach(self, centre: Array, radius: Array) -> bool:
        """Whether a disc at any of the centres (n, 3) could touch a span or a loose end.

        A span hangs below its higher end, and in plan beside its chord by no more than a steady
        wind blows a piece of its length aside; cable that falls is always looked at closely.
        """
        if self.loose:
            return True
        if not len(self.starts):
            return bool(self.grips)
        hung = self.spans
        top = np.maximum(hung.start[:, 2], hung.stop[:, 2]) + _ROTOR_HEIGHT
        near = centre[:, None, 2] < top
        if self._end_within_reach(hung, centre, radius):
            return True
        if not near.any():
            return False
        chord = (hung.stop - hung.start)[:, :2]
        away = centre[:, None, :2] - hung.start[:, :2]
        squared = np.maximum(np.einsum("jk,jk->j", chord, chord), 1e-8)
        level = np.sqrt(squared)
        share = np.einsum("ijk,jk->ij", away, chord) / squared
        share = np.clip(share, 0.0, 1.0)
        away -= share[..., None] * chord
        reach = radius[:, None] + self._sideways * np.maximum(hung.length_used, hung.chord)
        near &= np.einsum("ijk,ijk->ij", away, away) < reach**2
        # above a disc the chord, and so the span, is nowhere higher than this
        rise = hung.stop[:, 2] - hung.start[:, 2]
        chord_height = hung.start[:, 2] + share * rise
        chord_height += reach * (np.abs(rise) / level)
        near &= centre[:, None, 2] < chord_height + _ROTOR_HEIGHT
        return bool(near.any())

    def _end_within_reach(self, hung: Hung, centre: Array, radius: Array) -> bool:
        """Whether a disc could touch a loose end, which hangs straight below its grip.

        What comes near the floor may lie anywhere. Grips have moved since the spans were solved.
        """
        for end in self._ends:
            if end.length <= SPACING:
                continue
            at_start = np.nonzero(self.starts == end.vehicle)[0]
            at_stop = np.nonzero(self.stops == end.vehicle)[0]
            if not len(at_start) and not len(at_stop):
                return True
            grip = hung.start[at_start[0]] if len(at_start) else hung.stop[at_stop[0]]
            below = centre[:, 2] < grip[2] + _ROTOR_HEIGHT
            if float(grip[2]) - end.length < self.floor + _DRIFT:
                if below.any():
                    return True
                continue
            away = np.hypot(centre[:, 0] - grip[0], centre[:, 1] - grip[1])
            if (below & (away < radius + _DRIFT)).any():
                return True
        return False

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
        if len(self.starts):
            fresh = solved and len(self.spans.a) == len(self.starts)
            hung = self.spans if fresh else self._hang(grips)
            target[self._between] = self._span_points(hung)
        for end in self._ends:
            _hang_end(target, grips[end.vehicle], end, self.floor)
        return target

    def _span_points(self, hung: Hung) -> Array:
        k = self._span_of
        a, low = hung.a[k], hung.low[k]
        s = self._along * (hung.length_used / self.lengths)[k] - low
        sideways = a * (np.arcsinh(s / a) + np.arcsinh(low / a))
        drop = np.hypot(low, a) - np.hypot(s, a)
        points: Array = hung.start[k] + sideways[:, None] * hung.direction[k]
        points += drop[:, None] * self.down
        if hung.resting is not None:
            lying = np.nonzero(hung.resting[k])[0]
            points[lying] = self._lying_points(hung, k[lying], self._along[lying])
        return points

    def _lying_points(self, hung: Hung, k: Indices, along: Array) -> Array:
        """Points of spans that rest on the floor: down one end, along the floor, up the other."""
        a, arcs = hung.a[k], (hung.low[k], hung.high[k])
        length = self.lengths[k]
        reach = [a * np.arcsinh(arc / a) * (a > _LEAST) for arc in arcs]
        ground = np.maximum(hung.across[k] - reach[0] - reach[1], 0.0)
        flat = np.maximum(length - arcs[0] - arcs[1], 1e-9)
        x = reach[0] + np.clip((along - arcs[0]) / flat, 0.0, 1.0) * ground
        z = np.full(len(k), self.floor)
        for end, distance in enumerate((along, length - along)):
            s = np.maximum(arcs[end] - distance, 0.0)
            z = np.maximum(z, self.floor + np.where(a > _LEAST, np.hypot(s, a) - a, s))
            out = a * np.arcsinh(s / a) * (a > _LEAST)
            inward = reach[0] - out if end == 0 else hung.across[k] - reach[1] + out
            x = np.where(s > 0, inward, x)
        points: Array = hung.start[k] + x[:, None] * hung.direction[k]
        points[:, 2] = z
        return points


def _floor_parameter(heights: Array, slack: Array, guess: Array) -> Array:
    """Catenary parameters of spans whose ends come down to the floor.

    ``L − h = Σ (s_i − x_i)`` with ``s = √(H² + 2Ha)``, ``x = a acosh(1 + H/a)`` fixes ``a``; Newton
    in ``log a`` against ``log (L − h)`` from the last step's root.
    """
    a = np.clip(guess, _LEAST, _MOST)
    target = np.log(np.maximum(slack, 1e-9))
    for _ in range(8):
        arcs = np.sqrt(heights**2 + 2 * heights * a)
        angle = np.arccosh(1 + heights / a)
        value = np.maximum((arcs - a * angle).sum(axis=0), 1e-12)
        slope = np.minimum((2 * heights / arcs - angle).sum(axis=0) * a, -1e-12)
        update = np.clip((target - np.log(value)) * value / slope, -1.5, 1.5)
        a = np.clip(a * np.exp(update), _LEAST, _MOST)
        if abs(update).max() < 1e-4:
            break
    return a


def _hang_end(target: Array, grip: Array, end: End, floor: float) -> None:
    """A loose end hangs straight down from its grip; the rest lies where it lay, or is drawn along.

    Nothing is farther from the grip than the cable between reaches.
    """
    if not len(end.samples):
        return
    height = max(float(grip[2]) - floor, 0.0)
    apart = target[end.samples] - grip
    distance = np.hypot(apart[:, 0], apart[:, 1])
    reach = np.maximum(end.away - height, 0.0)
    share = np.minimum(1.0, reach / np.maximum(distance, 1e-9))
    points = grip + share[:, None] * apart
    points[:, 2] = np.maximum(grip[2] - end.away, floor)
    target[end.samples] = points
