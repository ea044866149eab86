"""Statics of the spans of a cable between grips: catenaries, partly on the floor, by table.

With ``h``, ``v`` the level and upward distance between the ends, ``L`` the length and
``z = h/2a``: ``sinh z / z = √(L² − v²)/h``; level tension ``w a``; the ends carry
``w (L ∓ v coth z)/2`` (Routh, "Analytical Statics", ch. X; Irvine, "Cable Structures", 1981).
Where a span would hang below the floor it lies there, drawn towards both ends without friction.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Indices = NDArray[np.intp]
Flags = NDArray[np.bool_]

_TAUT = 0.03
_FLAT = 0.01
_LEAST, _MOST = 1e-4, 1e4
_TABLE_Z = np.geomspace(_TAUT, 40.0, 3000)
_TABLE_RATIO = np.log(np.sinh(_TABLE_Z) / _TABLE_Z - 1.0)
_TABLE_LOG_Z = np.log(_TABLE_Z)
_TAUT_RATIO = float(np.sinh(_TAUT) / _TAUT)


class Hung(NamedTuple):
    """Every span between two grips, solved: geometry, catenary, load (arrays over spans).

    ``flat`` is the step from start to stop at right angles to the weight, ``across`` its length and
    ``upward`` the step against the weight. ``a`` is the catenary's parameter, ``low`` and ``high``
    the arc lengths from its lowest point to start and stop, ``stretch`` by how much the chord is
    longer than the cable, ``elastic`` the newtons that this pulls; ``resting`` tells which
    spans lie on the floor (None: none does).
    """

    start: Array
    stop: Array
    flat: Array
    across: Array
    upward: Array
    a: Array
    low: Array
    high: Array
    length_used: Array
    stretch: Array
    resting: Flags | None
    load: Array
    length: Array
    elastic: Array | float = 0.0

    @property
    def level(self) -> Array:
        """Level tension in newtons."""
        level: Array = self.load * self.a
        return level

    @property
    def tension(self) -> Array:
        """The largest tension along each span in newtons, at its higher end."""
        reach = np.maximum(np.abs(self.low), np.abs(self.high))
        tension: Array = self.level + self.load * reach + self.elastic
        return tension

    @property
    def chord(self) -> Array:
        """Distances of the ends in metres."""
        chord: Array = np.hypot(self.across, self.upward)
        return chord


_EMPTY = np.zeros(0)
NOTHING = Hung(
    _EMPTY, _EMPTY, _EMPTY, _EMPTY, _EMPTY, _EMPTY, _EMPTY, _EMPTY, _EMPTY, _EMPTY, None, _EMPTY,
    _EMPTY,
)  # fmt: skip


class Spans:
    """The spans between neighbouring grips: who holds them, how long they are, their samples."""

    def __init__(
        self, spans: Sequence[tuple[int, int, float, float]], arc: Array, floor: float
    ) -> None:
        """``spans`` are holder, next holder, length and where it begins; ``arc`` all samples."""
        self.floor = floor
        self.count = len(spans)
        self.starts: Indices = np.array([s[0] for s in spans], dtype=np.intp)
        self.stops: Indices = np.array([s[1] for s in spans], dtype=np.intp)
        self._holders = np.concatenate([self.starts, self.stops])
        self.lengths = np.array([s[2] for s in spans])
        self.arcs = np.array([s[3] for s in spans])
        self._onto = np.zeros((0, 0))
        self.load = _EMPTY
        self._longest = float(self.lengths.max()) if spans else 0.0
        self._parameter = np.full(len(spans), 1.0)
        self.samples: Indices = np.zeros(0, dtype=np.intp)
        self.span_of = self.samples
        self._along = _EMPTY
        if spans:
            number = np.searchsorted(self.arcs, arc, side="right") - 1
            along = arc - self.arcs[number]
            held = (number >= 0) & (along >= 0) & (along <= self.lengths[number])
            self.samples = np.nonzero(held)[0]
            self.span_of = number[held]
            self._along = along[held]

    def onto_holders(self, pulls: Array, count: int) -> Array:
        """Sum the forces on all starts and then all stops (2 m, 3) over ``count`` holders."""
        if self._onto.shape[1] != len(pulls) or len(self._onto) != count:
            self._onto = np.zeros((count, len(pulls)))
            self._onto[self._holders, np.arange(len(pulls))] = 1.0
        force: Array = np.dot(self._onto, pulls)
        return force

    def bear(self, load: float | Array) -> None:
        """Set the weight of a metre of each span (newtons)."""
        self.load = np.full(self.count, load) if np.isscalar(load) else np.asarray(load)

    def hang(self, grips: Array, down: Array, *, still: bool) -> Hung:
        """Solve every span's catenary, or its two halves where it lies on the floor.

        ``grips`` (n, 3) of all holders; ``down`` is the direction of the weight, ``still`` says
        that it is vertical.
        """
        ends = grips.take(self._holders, axis=0)
        start, stop = ends[: self.count], ends[self.count :]
        flat = stop - start
        if still:
            upward = flat[:, 2].copy()
            flat[:, 2] = 0.0
            across = np.maximum(np.hypot(flat[:, 0], flat[:, 1]), 1e-4)
        else:
            upward = -(flat @ down)
            flat += upward[:, None] * down
            across = np.maximum(np.sqrt(np.vecdot(flat, flat)), 1e-4)
        shortest = np.hypot(upward, across * _TAUT_RATIO)
        length = np.maximum(self.lengths, shortest)
        ratio = np.sqrt(length * length - upward * upward) / across
        z = np.exp(np.interp(np.log(ratio - 1.0), _TABLE_RATIO, _TABLE_LOG_Z))
        a = 0.5 * across / z
        tilt = upward / np.tanh(z)
        low, high = 0.5 * (length - tilt), 0.5 * (length + tilt)
        resting = None
        if min(ends[:, 2].tolist()) - 0.5 * self._longest < self.floor:
            resting = self._resting(start, stop, a, low, high)
            if resting is not None:
                a, low, high = self._on_floor(start, stop, across, a, low, high, resting)
        return Hung(
            start, stop, flat, across, upward, a, low, high, length, shortest - self.lengths,
            resting, self.load, self.lengths,
        )  # fmt: skip

    def _resting(
        self, start: Array, stop: Array, a: Array, low: Array, high: Array
    ) -> Flags | None:
        """Which spans would hang below the floor at their lowest point, None if none would."""
        lowest = np.minimum(start[:, 2], stop[:, 2])
        bottom = start[:, 2] - (np.hypot(low, a) - a)
        lowest = np.where((low > 0) & (high > 0), bottom, lowest)
        below = lowest < self.floor - 1e-9
        return below if np.count_nonzero(below) else None

    def _on_floor(
        self, start: Array, stop: Array, across: Array, a: Array, low: Array, high: Array,
        resting: Flags,
    ) -> tuple[Array, Array, Array]:  # fmt: skip
        """Two half catenaries that come down to the floor, and what lies straight between them.

        Where there is more slack than the ends are high, the ends just hang down; a taut span is
        left to its elasticity, as one in the air is.
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

    def points(self, hung: Hung, down: Array) -> Array:
        """Where the samples of solved spans are (m, 3)."""
        k = self.span_of
        a, low = hung.a[k], hung.low[k]
        s = self._along * (hung.length_used / self.lengths)[k] - low
        sideways = a * (np.arcsinh(s / a) + np.arcsinh(low / a))
        drop = np.hypot(low, a) - np.hypot(s, a)
        points: Array = hung.start[k] + (sideways / hung.across[k])[:, None] * hung.flat[k]
        points += drop[:, None] * down
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
        points: Array = hung.start[k] + (x / hung.across[k])[:, None] * hung.flat[k]
        points[:, 2] = z
        return points


def _floor_parameter(heights: Array, slack: Array, guess: Array) -> Array:
    """Catenary parameters of spans whose ends come down to the floor.

    ``L − h = Σ (s_i − x_i)`` with ``s = √(H² + 2Ha)``, ``x = a acosh(1 + H/a)`` fixes ``a``; Newton
    in ``log a`` against ``log (L − h)`` from the last step's root.
    """
    a = np.minimum(np.maximum(guess, _LEAST), _MOST)
    target = np.log(np.maximum(slack, 1e-9))
    for _ in range(8):
        arcs = np.sqrt(heights * (heights + 2.0 * a))
        angle = np.arccosh(1.0 + heights / a)
        value = np.maximum(np.add.reduce(arcs - a * angle), 1e-12)
        slope = np.minimum(np.add.reduce(2.0 * heights / arcs - angle) * a, -1e-12)
        update = (target - np.log(value)) * value / slope
        a = a * np.exp(np.minimum(np.maximum(update, -1.5), 1.5))
        a = np.minimum(np.maximum(a, _LEAST), _MOST)
        if max(np.abs(update).tolist()) < 1e-4:
            break
    return a
