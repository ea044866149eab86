"""Statics of the spans of a cable between grips: catenaries, partly on the floor.

With the horizontal distance ``h`` and the rise ``v`` between the ends, the length ``L`` and
``z = h/2a``: ``sinh z / z = √(L² − v²)/h``; the horizontal tension is ``w a``; the ends carry
``w (L ∓ v coth z)/2`` (Routh, "Analytical Statics", ch. X; Irvine, "Cable Structures", 1981).
A span that would hang below the floor lies on it, drawn towards both ends without friction.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sitl.cable import span_statics

Array = NDArray[np.float64]
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
