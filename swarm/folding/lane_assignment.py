"""Lanes for every vehicle, and the way of every segment along them."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from swarm.folding.lattice import LatticePath, cheapest_path, segment_costs
from swarm.folding.layout import KnotLayout
from swarm.folding.margins import Margins
from swarm.folding.path import FoldPath, Guide, last_lane
from swarm.geometry.catenary import solve_catenaries
from swarm.geometry.chain import crossing_fractions

Floats = npt.NDArray[np.float64]

_LOOP = 0.34
"""Height of lanes over the corners as a share of the longest segment, so that its loops pass."""

_PLAY = 0.05
"""Metres that chords on the floor keep beyond what is asked, for what evens them out."""

_FINE = 0.05
"""Cost of a state while all margins are kept."""


@dataclass(frozen=True, eq=False)
class LaneAssignment:
    """Paths of all vehicles, and the way of every segment along them."""

    path: FoldPath
    ways: tuple[LatticePath, ...]


def assign_lanes(layout: KnotLayout, guide: Guide, margins: Margins, step: float) -> LaneAssignment:
    """Find a way for every segment, with lanes for every vehicle.

    ``step`` is that of the lattice of progress, in metres. Lanes over corners are at least so high
    that slack loops of a vehicle's segments pass; its last lane is as low as its segment needs it.
    Lanes under strands are no higher than these sag: that much is flown, not given way by.
    """
    path, ways = _finding(layout, guide, margins, step)
    return LaneAssignment(path, tuple(ways))


def assignment_cost(
    layout: KnotLayout, guide: Guide, margins: Margins, step: float, enough: float = np.inf
) -> float:
    """How much the ways that :func:`assign_lanes` finds miss their margins, in all.

    Where they miss more than ``enough``, something more than that: the rest is not found.
    """
    missed = 0.0
    for way in _finding(layout, guide, margins, step)[1]:
        missed += float(np.maximum(way.cost - _FINE, 0.0).sum())
        if missed > enough:
            break
    return missed


def _finding(
    layout: KnotLayout, guide: Guide, margins: Margins, step: float
) -> tuple[FoldPath, Iterator[LatticePath]]:
    """Paths of all vehicles, and one segment's way after the other."""
    lanes = np.repeat(layout.lanes[:, None], len(layout.corners), axis=1)
    lanes = np.maximum(lanes, np.where(lanes > 0.0, _loop_room(layout), -np.inf))
    lanes = np.minimum(lanes, np.where(lanes < 0.0, _below_sags(layout), np.inf))
    for edge, length in enumerate(layout.lengths):
        taut = margins.max_chord_ratio * length - 2.0 * margins.tracking
        span = float(guide.stations[edge + 1] - guide.stations[edge])
        lane = float(lanes[edge, edge + 1])
        lanes[edge, edge + 1] = last_lane(lane, span, guide.slope, float(taut))
    path = FoldPath(guide, lanes)
    tables = segment_costs(layout, path, margins, step)
    chords = initial_chords(layout.lengths, np.diff(path.stops), margins, step)
    return path, map(cheapest_path, tables, chords)


def initial_chords(lengths: Floats, stops: Floats, margins: Margins, step: float) -> Floats:
    """Chords (n − 1,) to begin with, on lattices of ``step`` that end ``stops`` (n − 1,) apart.

    The preferred ones, or longer: on the floor a segment reaches beyond its ends by half of what
    its chord is shorter, and those before and after a short one must not reach each other.
    """
    chords = stops + step * np.round((margins.chord_ratio * lengths - stops) / step)
    longest = margins.max_chord_ratio * lengths - 2.0 * margins.tracking - _PLAY
    apart = margins.cable + 2.0 * margins.tracking + _PLAY
    middle = 1
    while middle < len(lengths) - 1:
        around = [middle - 1, middle + 1]
        loose = lengths[around] - chords[around]
        wider = [
            each
            for each in (*np.take(around, np.argsort(-loose)), middle)
            if chords[each] + step <= longest[each]
        ]
        if 0.5 * loose.sum() + apart <= chords[middle] or not wider:
            middle += 1
        else:
            chords[wider[0]] += step
    return chords


def _below_sags(layout: KnotLayout) -> Floats:
    """Height (n − 1, 1) of the lowest of the strands that in the end hang over each edge."""
    height = np.full((len(layout.lengths), 1), np.inf)
    if layout.crossings:
        over, under = np.array(layout.crossings, dtype=np.intp).T
        at = crossing_fractions(layout.corners, layout.crossings)[:, 0]
        strand = solve_catenaries(
            layout.corners[over], layout.corners[over + 1], layout.lengths[over]
        )
        np.minimum.at(height[:, 0], under, strand.at_span(at)[:, 2])
    return height


def _loop_room(layout: KnotLayout) -> Floats:
    """Height (1, n) that lets the longer segment of each vehicle hang in a loop over others."""
    lengths = layout.lengths
    held = np.maximum(np.append(lengths, 0.0), np.insert(lengths, 0, 0.0))
    room: Floats = _LOOP * held[None]
    return room
