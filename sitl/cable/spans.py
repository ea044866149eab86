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

from sitl.cable import span_statics

Array = NDArray[np.float64]
Indices = NDArray[np.intp]
Flags = NDArray[np.bool_]

_EMPTY = np.zeros(0)


class Hung(NamedTuple):
    """Every span between two grips, solved: geometry, catenary, load (arrays over spans).

    ``flat`` is the vector from start to stop perpendicular to the weight, ``figures`` are the rows
    that `sitl.cable.span_statics.solve` computes, ``elastic`` is the elastic force of overstretched
    spans in newtons; ``resting`` marks spans that lie on the floor (None: no span).
    """

    start: Array
    stop: Array
    flat: Array
    figures: Array
    resting: Flags | None
    load: Array
    length: Array
    elastic: Array | float = 0.0

    @property
    def across(self) -> Array:
        """Level distances of the ends, at right angles to the weight."""
        across: Array = self.figures[span_statics.ACROSS]
        return across

    @property
    def a(self) -> Array:
        """The catenaries' parameters."""
        a: Array = self.figures[span_statics.A]
        return a

    @property
    def low(self) -> Array:
        """Arc lengths from the lowest points to the starts."""
        low: Array = self.figures[span_statics.LOW]
        return low

    @property
    def high(self) -> Array:
        """Arc lengths from the lowest points to the stops."""
        high: Array = self.figures[span_statics.HIGH]
        return high

    @property
    def length_used(self) -> Array:
        """Lengths, over-stretched spans as long as they are."""
        used: Array = self.figures[span_statics.USED]
        return used

    @property
    def stretch(self) -> Array:
        """By how much chords are longer than their cable."""
        stretch: Array = self.figures[span_statics.STRETCH]
        return stretch

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
        chord: Array = np.hypot(self.across, self.figures[span_statics.UPWARD])
        return chord


_NOWHERE = np.zeros((0, 3))
NOTHING = Hung(
    _NOWHERE, _NOWHERE, _NOWHERE, np.zeros((span_statics.FIGURES, 0)), None, _EMPTY, _EMPTY
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
        flat = np.empty((self.count, 3))
        figures = np.empty((span_statics.FIGURES, self.count))
        resting = np.empty(self.count, dtype=np.bool_)
        rests = span_statics.hang(
            start, stop, self.lengths, down, self.floor, still, self._parameter, flat, figures,
            resting,
        )  # fmt: skip
        return Hung(start, stop, flat, figures, resting if rests else None, self.load, self.lengths)

    def place(self, hung: Hung, down: Array, target: Array) -> None:
        """Put the samples of solved spans where they are, into ``target`` (m, 3) of all samples."""
        resting = np.zeros(self.count, np.bool_) if hung.resting is None else hung.resting
        span_statics.points(
            self.span_of, self._along, self.lengths, hung.start, hung.flat, hung.figures, resting,
            self.floor, down, target, self.samples,
        )  # fmt: skip
