"""Where a team's strands cross in plan view while it folds, and which of them must be over.

From above a cable passes over itself at points that move along it. As long as no strands pass
through each other, one that moves past a vehicle, on to the next segment, keeps its side; two that
appear or disappear together, where a vehicle moves across a strand, have the same. Crossings that
are joined so are one *thread*. A thread that lasts to the end of the motion is a crossing of the
knot, and its side is known: that of the end.
"""

from collections import defaultdict
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from swarm.folding.soft_constraints import Outlines
from swarm.folding.strand_clearance import crossing_heights, height_at_span, plan_crossing

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.intp]

_TOGETHER = 4
"""Moments within which crossings end and begin as the same vehicle moves across a strand."""


@dataclass(frozen=True)
class Passing:
    """A vehicle that moves across a strand in plan view, at a moment, so much over it."""

    moment: int
    vehicle: int
    strand: int
    over: float


@dataclass(frozen=True)
class Crossing:
    """Two strands that cross from a moment to another, the first before the second in the cable.

    ``passings`` are those with which it begins and ends; it has no end that ends with the motion.
    ``over`` is how high the first is over the second, summed up over moments, or in the end.
    """

    pair: int
    first: int
    second: int
    begin: int
    end: int
    passings: tuple[Passing, ...]
    over: float

    @property
    def lasts(self) -> bool:
        """Whether it ends with the motion."""
        return len(self.passings) == 1

    def as_passed(self, passing: Passing) -> int:
        """1 where the first is over if the vehicle passes over the strand, else −1."""
        return 1 if passing.strand == self.second else -1


def find_crossings(hung: Outlines, first: Ints, second: Ints) -> list[Crossing]:
    """All crossings of pairs (p,) of strands (s, n − 1), which do not share vehicles."""
    found: list[Crossing] = []
    over = np.empty(len(hung.ratio))
    for pair, (one, other) in enumerate(zip(first.tolist(), second.tolist(), strict=True)):
        crossing_heights(hung.points[:, one], hung.points[:, other], over)
        edges = np.flatnonzero(np.diff(over != 0.0, prepend=False, append=False))
        for begin, end in zip(edges[::2].tolist(), (edges[1::2] - 1).tolist(), strict=True):
            lasts = end == len(over) - 1
            moments = (begin,) if lasts else (begin, end)
            found.append(
                Crossing(
                    pair, one, other, begin, end,
                    tuple(_passing(hung, moment, one, other) for moment in moments),
                    float(over[-1] if lasts else over[begin : end + 1].sum()),
                )
            )  # fmt: skip
    return found


def required_signs(found: list[Crossing], segments: int) -> list[int]:
    """Of every crossing, whether the first strand is to be over the second: 1, or −1."""
    sides = [0] * len(found)
    joined = _joined(found, segments)
    for k in range(len(found)):
        if sides[k] == 0:
            thread = _thread(k, joined)
            side = _side([(found[member], turned) for member, turned in thread.items()])
            for member, turned in thread.items():
                sides[member] = side * turned
    return sides


def _passing(hung: Outlines, moment: int, one: int, other: int) -> Passing:
    """The vehicle that just passes a strand, where two begin or cease to cross."""
    points = hung.points[moment]
    here, there = plan_crossing(points[one], points[other])
    ends = [(here, one, 0), (1.0 - here, one, 1), (there, other, 0), (1.0 - there, other, 1)]
    _, segment, end = min(ends)
    strand, share = (other, there) if segment == one else (one, here)
    height = float(points[segment, -end, 2]) - height_at_span(points[strand], share)
    return Passing(moment, segment + end, strand, height)


def _joined(found: list[Crossing], segments: int) -> list[list[tuple[int, int]]]:
    """Of every crossing those of the same thread next to it; with −1 where the sides differ."""
    meets: dict[tuple[int, int], list[tuple[int, int, Passing]]] = defaultdict(list)
    for k, each in enumerate(found):
        for passing in each.passings:
            own = each.first if passing.strand == each.second else each.second
            meets[passing.vehicle, passing.strand].append((k, own, passing))
    joined: list[list[tuple[int, int]]] = [[] for _ in found]
    for (vehicle, _), several in meets.items():
        if not 0 < vehicle < segments:
            continue
        for i, (k, own, passing) in enumerate(several):
            for other, beside, next_passing in several[i + 1 :]:
                together = abs(passing.moment - next_passing.moment) <= _TOGETHER
                if together and beside != own:
                    turned = found[k].as_passed(passing) * found[other].as_passed(next_passing)
                    joined[k].append((other, turned))
                    joined[other].append((k, turned))
    return joined


def _thread(start: int, joined: list[list[tuple[int, int]]]) -> dict[int, int]:
    """The crossings of a thread, and whether their sides are that of the one to start with."""
    thread, waiting = {start: 1}, [start]
    while waiting:
        k = waiting.pop()
        for other, turned in joined[k]:
            if other not in thread:
                thread[other] = thread[k] * turned
                waiting.append(other)
    return thread


def _side(thread: list[tuple[Crossing, int]]) -> int:
    """The side of a thread: that of the end, else that on which most of its vehicles pass."""
    last = [np.sign(each.over) * turned for each, turned in thread if each.lasts]
    passed = [
        np.sign(passing.over) * each.as_passed(passing) * turned
        for each, turned in thread
        for passing in each.passings
    ]
    mostly = sum(each.over * turned for each, turned in thread)
    for votes in (sum(last), sum(passed), mostly):
        if votes:
            return int(np.sign(votes))
    return 1
