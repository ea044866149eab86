"""One cable in the world: lying, held at some arc lengths, hanging in between, falling, broken.

Between two grips the cable is the catenary of its true length, in the plane of gravity and steady
wind (quasi-static: its own swing is left out); it pulls on both vehicles. Where it would hang below
the floor it lies there, drawn towards both ends without friction. Beyond a chord that its
length allows, it stretches with its axial stiffness and snaps at its breaking load.

With ``h``, ``v`` the level and upward distance between the ends, ``L`` the length and
``z = h/2a``: ``sinh z / z = √(L² − v²)/h``; level tension ``w a``; the ends carry
``w (L ∓ v coth z)/2`` (Routh, "Analytical Statics", ch. X; Irvine, "Cable Structures", 1981).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sitl.dynamics import AIR_DENSITY, GRAVITY
from sitl.world import CableSpec

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

REACH = 0.15
SPACING = 0.1
_CYLINDER_DRAG = 1.1
_TAUT = 0.03
_DAMPING_RATIO = 0.1
_NODE_MASS = 1.5
_FALL = 9.0
_TABLE_Z = np.geomspace(_TAUT, 40.0, 3000)
_TABLE_RATIO = np.log(np.sinh(_TABLE_Z) / _TABLE_Z - 1.0)
_TABLE_LOG_Z = np.log(_TABLE_Z)
_TAUT_RATIO = float(np.sinh(_TAUT) / _TAUT)


@dataclass
class Spans:
    """What the last call of `Rope.pull` found about each span between two grips."""

    tension: Array
    chord: Array
    length: Array


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
        self.spans = Spans(np.zeros(0), np.zeros(0), np.zeros(0))
        self.set_wind(wind)
        self._arrange()

    def set_wind(self, wind: Array) -> None:
        """Take a steady wind (m/s, ENU): it tilts the weight of each metre of cable."""
        drag = 0.5 * AIR_DENSITY * _CYLINDER_DRAG * self.spec.diameter
        load = np.array([0.0, 0.0, -GRAVITY * self.spec.mass_per_length])
        load = load + drag * np.linalg.norm(wind) * np.asarray(wind)
        self.weight = float(np.linalg.norm(load))
        self.down = load / self.weight

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
        spans, ends = [], []
        for (arc, one), (next_arc, other) in zip(self.grips, self.grips[1:], strict=False):
            cut = broken[(broken > arc) & (broken < next_arc)] if len(broken) else broken
            if len(cut):
                ends += [(one, float(cut[0] - arc)), (other, float(next_arc - cut[-1]))]
            else:
                spans.append((one, other, next_arc - arc, arc))
        if self.grips:
            first, last = self.grips[0], self.grips[-1]
            low = max([0.0, *(b for b in self.breaks if b < first[0])])
            high = min([self.length, *(b for b in self.breaks if b > last[0])])
            ends += [(first[1], first[0] - low), (last[1], high - last[0])]
        self.starts: Indices = np.array([s[0] for s in spans], dtype=np.intp)
        self.stops: Indices = np.array([s[1] for s in spans], dtype=np.intp)
        self.lengths = np.array([s[2] for s in spans])
        self.span_arcs = np.array([s[3] for s in spans])
        self.end_vehicles: Indices = np.array([e[0] for e in ends], dtype=np.intp)
        self.end_lengths = np.array([e[1] for e in ends])
        self._parameter = np.full(len(spans), 1.0)

    def pull(self, grips: Array, velocity: Array) -> Array:
        """Force of the cable on every vehicle (newtons, ENU, (n, 3)).

        ``grips`` and ``velocity`` are all vehicles' grip points and velocities (n, 3).
        """
        force = np.zeros_like(grips)
        if not self.grips:
            self.spans = Spans(np.zeros(0), np.zeros(0), np.zeros(0))
            return force
        if len(self.starts):
            on_start, on_stop = self._hang(grips, velocity)
            force[self.starts] += on_start
            force[self.stops] += on_stop
        height = np.maximum(grips[self.end_vehicles, 2] - self.floor, 0.0)
        hanging = np.minimum(height, self.end_lengths) * self.weight
        np.add.at(force, self.end_vehicles, hanging[:, None] * self.down)
        return force

    def _hang(self, grips: Array, velocity: Array) -> tuple[Array, Array]:
        start, stop = grips[self.starts], grips[self.stops]
        chord = stop - start
        upward = -(chord @ self.down)
        level = chord + upward[:, None] * self.down
        across = np.sqrt(np.einsum("ij,ij->i", level, level))
        across = np.maximum(across, 1e-4)
        direction = level / across[:, None]
        shortest = np.sqrt(upward**2 + (across * _TAUT_RATIO) ** 2)
        length = np.maximum(self.lengths, shortest)
        ratio = np.sqrt(np.maximum(length**2 - upward**2, across**2)) / across
        z = np.exp(np.interp(np.log(np.maximum(ratio - 1.0, 1e-9)), _TABLE_RATIO, _TABLE_LOG_Z))
        half = 0.5 / z
        tension = self.weight * across * half
        tilt = upward / np.tanh(z)
        low, high = 0.5 * (length - tilt), 0.5 * (length + tilt)
        self._state = (start, across, direction, upward, across * half, low, length)
        resting = self._resting(start, stop, across, half * across, low, high)
        if resting.any():
            tension, low, high = self._on_floor(start, stop, across, tension, low, high, resting)
        self._rests = resting
        down = self.weight * self.down
        on_start = tension[:, None] * direction + low[:, None] * down
        on_stop = -tension[:, None] * direction + high[:, None] * down
        total = tension + self.weight * np.maximum(np.abs(low), np.abs(high))
        stretch = shortest - self.lengths
        if (stretch > 0).any():
            total += self._stretch(chord, stretch, velocity, on_start, on_stop)
        distance = np.sqrt(across**2 + upward**2)
        self.spans = Spans(total, distance, self.lengths)
        if (total > self.spec.breaking_load).any():
            self._snap(int(np.argmax(total)))
        return on_start, on_stop

    def _stretch(
        self, chord: Array, stretch: Array, velocity: Array, on_start: Array, on_stop: Array
    ) -> Array:
        """Add the elastic pull of over-stretched spans in place; return it."""
        reach = np.sqrt(np.einsum("ij,ij->i", chord, chord))
        along = chord / np.maximum(reach, 1e-9)[:, None]
        stiffness = self.spec.stiffness / np.maximum(self.lengths, 0.2)
        opening = np.einsum("ij,ij->i", velocity[self.stops] - velocity[self.starts], along)
        damping = 2 * _DAMPING_RATIO * np.sqrt(stiffness * _NODE_MASS)
        pull = np.where(stretch > 0, np.maximum(stiffness * stretch + damping * opening, 0.0), 0.0)
        on_start += pull[:, None] * along
        on_stop -= pull[:, None] * along
        return pull

    def _resting(
        self, start: Array, stop: Array, across: Array, a: Array, low: Array, high: Array
    ) -> NDArray[np.bool_]:
        """Which spans would hang below the floor at their lowest point."""
        drop = np.sqrt(low**2 + a**2) - a
        lowest = np.where(
            (low > 0) & (high > 0), start[:, 2] - drop, np.minimum(start[:, 2], stop[:, 2])
        )
        below: NDArray[np.bool_] = lowest < self.floor - 1e-9
        return below & (across > 1e-3)

    def _on_floor(
        self,
        start: Array,
        stop: Array,
        across: Array,
        tension: Array,
        low: Array,
        high: Array,
        resting: NDArray[np.bool_],
    ) -> tuple[Array, Array, Array]:
        """Two half catenaries that come down to the floor, and what lies straight between them.

        ``L − h = Σ (s_i − x_i)`` with ``s = √(H² + 2Ha)``, ``x = a acosh(1 + H/a)`` fixes ``a``;
        Newton in ``log a`` from the last step's root.
        """
        heights = np.maximum(np.stack([start[:, 2], stop[:, 2]]) - self.floor, 1e-6)
        slack = np.maximum(self.lengths - across, 0.0)
        hangs = slack >= heights.sum(axis=0) * 0.999
        a = np.clip(self._parameter, 1e-4, 1e4)
        for _ in range(6):
            arcs = np.sqrt(heights**2 + 2 * heights * a)
            angle = np.arccosh(1 + heights / a)
            value = (arcs - a * angle).sum(axis=0)
            slope = (2 * heights / arcs - angle).sum(axis=0) * a
            wanted = np.log(np.maximum(slack, 1e-9)) - np.log(np.maximum(value, 1e-12))
            update = wanted * value / np.minimum(slope, -1e-12)
            a = np.clip(a * np.exp(np.clip(update, -1.5, 1.5)), 1e-4, 1e4)
        a = np.where(hangs, 1e-4, a)
        self._parameter = np.where(resting, a, 1.0)
        arcs = np.where(hangs, heights, np.sqrt(heights**2 + 2 * heights * a))
        self._floor_state = (a, arcs)
        tension = np.where(resting, self.weight * a, tension)
        low = np.where(resting, arcs[0], low)
        high = np.where(resting, arcs[1], high)
        return tension, low, high

    def _snap(self, span: int) -> None:
        """Break the cable where it is pulled hardest: just beside one of the two grips."""
        at = float(self.span_arcs[span])
        before = self._pieces()
        self.breaks = sorted([*self.breaks, at + min(0.05, 0.5 * float(self.lengths[span]))])
        self._fall(before != self._pieces())
        self._arrange()

    def follow(self, grips: Array, interval: float) -> Array:
        """Move the samples to where the cable is now; return them (m, 3).

        What was let go falls towards its new shape no faster than a thing falls; the rest is where
        statics puts it.
        """
        target = self._target(grips)
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

    def _target(self, grips: Array) -> Array:
        """Where every sample would be at rest (m, 3)."""
        target = self.shape.copy()
        target[:, 2] = self.floor
        if not self.grips:
            return target
        for span in range(len(self.starts)):
            low = self.span_arcs[span]
            high = low + self.lengths[span]
            inside = (self.arc >= low) & (self.arc <= high)
            target[inside] = self._span_points(span, grips, self.arc[inside] - low)
        for arc, vehicle in (self.grips[0], self.grips[-1]):
            self._end_points(target, grips[vehicle], arc, first=arc == self.grips[0][0])
        return target

    def _span_points(self, span: int, grips: Array, along: Array) -> Array:
        start, stop = grips[self.starts[span]], grips[self.stops[span]]
        length = float(self.lengths[span])
        chord = stop - start
        upward = float(-(chord @ self.down))
        level = chord + upward * self.down
        across = max(float(np.linalg.norm(level)), 1e-4)
        direction = level / across
        used = max(length, float(np.hypot(upward, across * _TAUT_RATIO)))
        ratio = np.sqrt(max(used**2 - upward**2, across**2)) / across
        z = np.exp(np.interp(np.log(max(ratio - 1.0, 1e-9)), _TABLE_RATIO, _TABLE_LOG_Z))
        a = across / (2 * z)
        low = 0.5 * (used - upward / np.tanh(z))
        s = along * (used / length) - low
        sideways = a * (np.arcsinh(s / a) + np.arcsinh(low / a))
        drop = np.sqrt(low**2 + a**2) - np.sqrt(s**2 + a**2)
        points: Array = start + sideways[:, None] * direction + drop[:, None] * self.down
        if points[:, 2].min() < self.floor:
            return self._lying_points(start, stop, length, along)
        return points

    def _lying_points(self, start: Array, stop: Array, length: float, along: Array) -> Array:
        flat = np.array([*(stop - start)[:2], 0.0])
        across = max(float(np.linalg.norm(flat)), 1e-4)
        direction = flat / across
        heights = np.maximum(np.array([start[2], stop[2]]) - self.floor, 1e-6)
        slack = max(length - across, 0.0)
        if slack >= heights.sum() * 0.999:
            a, arcs, reach = 1e-4, heights, np.zeros(2)
        else:
            a = _floor_parameter(heights, slack)
            arcs = np.sqrt(heights**2 + 2 * heights * a)
            reach = a * np.arccosh(1 + heights / a)
        points = np.empty((len(along), 3))
        lying = max(length - arcs.sum(), 1e-9)
        ground = max(across - reach.sum(), 0.0)
        x = reach[0] + np.clip((along - arcs[0]) / lying, 0, 1) * ground
        z = np.full(len(along), self.floor)
        for end, distance in ((0, along), (1, length - along)):
            hanging = distance < arcs[end]
            s = np.maximum(arcs[end] - distance[hanging], 0.0)
            z[hanging] = self.floor + np.sqrt(s**2 + a**2) - a
            out = a * np.arcsinh(s / a)
            x[hanging] = reach[0] - out if end == 0 else across - reach[1] + out
        points[:] = start + x[:, None] * direction
        points[:, 2] = z
        return points

    def _end_points(self, target: Array, grip: Array, arc: float, first: bool) -> None:
        """A loose end hangs straight down from its grip; what reaches the floor lies in its line."""
        inside = self.arc < arc if first else self.arc > arc
        if not inside.any():
            return
        away = np.abs(self.arc[inside] - arc)
        height = max(float(grip[2]) - self.floor, 0.0)
        hanging = away <= height
        places = target[inside]
        tip = places[0] if first else places[-1]
        flat = np.array([tip[0] - grip[0], tip[1] - grip[1], 0.0])
        size = float(np.linalg.norm(flat))
        direction = flat / size if size > 1e-6 else np.zeros(3)
        moved = np.array(grip) + np.maximum(away - height, 0.0)[:, None] * direction
        moved[:, 2] = np.where(hanging, grip[2] - away, self.floor)
        target[inside] = moved


def _floor_parameter(heights: Array, slack: float) -> float:
    """Catenary parameter of a span that lies on the floor in its middle, by bisection in log a."""
    low, high = np.log(1e-4), np.log(1e4)
    for _ in range(50):
        middle = 0.5 * (low + high)
        a = np.exp(middle)
        value = float(
            (np.sqrt(heights**2 + 2 * heights * a) - a * np.arccosh(1 + heights / a)).sum()
        )
        if value > slack:
            low = middle
        else:
            high = middle
    return float(np.exp(0.5 * (low + high)))
