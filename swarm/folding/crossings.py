"""Crossings of a team's strands in plan view during the fold, and the signs they must have.

In plan view, the points at which a cable crosses itself move along it. As long as no strand passes
through another, a crossing that moves past a vehicle to the next segment keeps its sign; two
crossings that appear or disappear together, where a vehicle moves across a strand, have the same
sign. Crossings that are connected so are one *thread*. A thread that lasts to the end of the motion
is a crossing of the knot, and has the sign of that crossing.
"""

from collections import defaultdict
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from swarm.folding.outlines import Outlines, crossing_heights, height_at_span, plan_crossing

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.intp]

_TOGETHER = 4
"""Moments within which crossings end and begin as the same vehicle moves across a strand."""


@dataclass(frozen=True)
class Passing:
    """A vehicle that moves across a strand in plan view at a moment, ``height`` metres above it."""

    moment: int
    vehicle: int
    strand: int
    height: float


@dataclass(frozen=True)
class Crossing:
    """Two strands that cross between two moments; the first comes first along the cable.

    It begins and ends with its ``passings``; a crossing that lasts to the end of the motion has
    only the first. ``height`` is the height of the first over the second: the final one, or the sum
    over moments.
    """

    pair: int
    first: int
    second: int
    begin: int
    end: int
    passings: tuple[Passing, ...]
    height: float

    @property
    def lasts(self) -> bool:
        """Whether the crossing lasts to the end of the motion."""
        return len(self.passings) == 1

    def sign_of(self, passing: Passing) -> int:
        """Return the sign of the crossing if the vehicle passes over the strand: 1 or −1."""
        return 1 if passing.strand == self.second else -1


def find_crossings(strands: Outlines, first: Ints, second: Ints) -> list[Crossing]:
    """Return all crossings of pairs (p,) of strands (s, n − 1), which share no vehicles."""
    crossings: list[Crossing] = []
    heights = np.empty(len(strands.ratio))
    for pair, (strand, other) in enumerate(zip(first.tolist(), second.tolist(), strict=True)):
        crossing_heights(
            np.ascontiguousarray(strands.points[:, strand]),
            np.ascontiguousarray(strands.points[:, other]),
            heights,
        )
        edges = np.flatnonzero(np.diff(heights != 0.0, prepend=False, append=False))
        for begin, end in zip(edges[::2].tolist(), (edges[1::2] - 1).tolist(), strict=True):
            lasts = end == len(heights) - 1
            moments = (begin,) if lasts else (begin, end)
            crossings.append(
                Crossing(
                    pair, strand, other, begin, end,
                    tuple(_passing(strands, moment, strand, other) for moment in moments),
                    float(heights[-1] if lasts else heights[begin : end + 1].sum()),
                )
            )  # fmt: skip
    return crossings


def required_signs(crossings: list[Crossing], segments: int) -> list[int]:
    """Return the sign of every crossing: 1 where the first strand must be over the second."""
    signs = [0] * len(crossings)
    neighbours = _connections(crossings, segments)
    for k in range(len(crossings)):
        if signs[k] == 0:
            thread = _thread(k, neighbours)
            sign = _thread_sign([(crossings[member], factor) for member, factor in thread.items()])
            for member, factor in thread.items():
                signs[member] = sign * factor
    return signs


def _passing(strands: Outlines, moment: int, first: int, second: int) -> Passing:
    """Return the passing of a vehicle with which two strands begin or cease to cross."""
    points = strands.points[moment]
    here, there = plan_crossing(points[first], points[second])
    ends = [(here, first, 0), (1.0 - here, first, 1), (there, second, 0), (1.0 - there, second, 1)]
    _, segment, end = min(ends)
    strand, share = (second, there) if segment == first else (first, here)
    height = float(points[segment, -end, 2]) - height_at_span(points[strand], share)
    return Passing(moment, segment + end, strand, height)


def _connections(crossings: list[Crossing], segments: int) -> list[list[tuple[int, int]]]:
    """Return the neighbours of every crossing in its thread, with the products of signs."""
    meets: dict[tuple[int, int], list[tuple[int, int, Passing]]] = defaultdict(list)
    for k, crossing in enumerate(crossings):
        for passing in crossing.passings:
            own = crossing.first if passing.strand == crossing.second else crossing.second
            meets[passing.vehicle, passing.strand].append((k, own, passing))
    neighbours: list[list[tuple[int, int]]] = [[] for _ in crossings]
    for (vehicle, _), several in meets.items():
        if not 0 < vehicle < segments:
            continue
        for i, (k, own, passing) in enumerate(several):
            for other, other_own, next_passing in several[i + 1 :]:
                together = abs(passing.moment - next_passing.moment) <= _TOGETHER
                if together and other_own != own:
                    factor = crossings[k].sign_of(passing) * crossings[other].sign_of(next_passing)
                    neighbours[k].append((other, factor))
                    neighbours[other].append((k, factor))
    return neighbours


def _thread(start: int, neighbours: list[list[tuple[int, int]]]) -> dict[int, int]:
    """Return the crossings of a thread, each with its sign relative to ``start``."""
    thread, waiting = {start: 1}, [start]
    while waiting:
        k = waiting.pop()
        for other, factor in neighbours[k]:
            if other not in thread:
                thread[other] = thread[k] * factor
                waiting.append(other)
    return thread


def _thread_sign(thread: list[tuple[Crossing, int]]) -> int:
    """Return the sign of a thread: the final one, else the majority of its vehicles' passings."""
    last = [np.sign(crossing.height) * factor for crossing, factor in thread if crossing.lasts]
    passed = [
        np.sign(passing.height) * crossing.sign_of(passing) * factor
        for crossing, factor in thread
        for passing in crossing.passings
    ]
    mean = sum(crossing.height * factor for crossing, factor in thread)
    for votes in (sum(last), sum(passed), mean):
        if votes:
            return int(np.sign(votes))
    return 1
