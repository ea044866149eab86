"""Lanes of all vehicles, and the lattice path of every segment along them."""

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
"""Height of lanes over the corners as a share of the longest segment, for its loop to pass: at the
preferred chord of 0.79 of the length a level strand sags by 0.27 of it."""

_SPARE_CHORD = 0.05
"""Metres that chords on the floor keep beyond the margin, since smoothing changes them."""

_NO_MISS = 0.05
"""Cost of a lattice state that misses no margin."""


@dataclass(frozen=True, eq=False)
class LaneAssignment:
    """Paths of all vehicles, and the lattice path of every segment along them."""

    path: FoldPath
    paths: tuple[LatticePath, ...]


def assign_lanes(layout: KnotLayout, guide: Guide, margins: Margins, step: float) -> LaneAssignment:
    """Return lanes for every vehicle and the cheapest lattice path of every segment.

    ``step`` is the step of the lattice of progress, in metres. Lanes over corners are high enough
    for slack loops of a vehicle's segments to pass; its last lane is as low as its segment
    requires. Lanes under strands are no higher than the lowest point of these.
    """
    path, paths = _search(layout, guide, margins, step)
    return LaneAssignment(path, tuple(paths))


def assignment_cost(
    layout: KnotLayout, guide: Guide, margins: Margins, step: float, enough: float = np.inf
) -> float:
    """Return how much the lattice paths of :func:`assign_lanes` miss their margins, in total.

    The search stops at the first total above ``enough``.
    """
    missed = 0.0
    for path in _search(layout, guide, margins, step)[1]:
        missed += float(np.maximum(path.cost - _NO_MISS, 0.0).sum())
        if missed > enough:
            break
    return missed


def _search(
    layout: KnotLayout, guide: Guide, margins: Margins, step: float
) -> tuple[FoldPath, Iterator[LatticePath]]:
    """Return the paths of all vehicles, and an iterator of one segment's path after the other."""
    lanes = np.repeat(layout.lanes[:, None], len(layout.corners), axis=1)
    lanes = np.maximum(lanes, np.where(lanes > 0.0, _loop_heights(layout), -np.inf))
    lanes = np.minimum(lanes, np.where(lanes < 0.0, _heights_below_strands(layout), np.inf))
    for edge, length in enumerate(layout.lengths):
        longest = margins.max_chord_ratio * length - 2.0 * margins.tracking
        span = float(guide.stations[edge + 1] - guide.stations[edge])
        lane = float(lanes[edge, edge + 1])
        lanes[edge, edge + 1] = last_lane(lane, span, guide.slope, float(longest))
    path = FoldPath(guide, lanes)
    costs = segment_costs(layout, path, margins, step)
    chords = initial_chords(layout.lengths, np.diff(path.stops), margins, step)
    return path, map(cheapest_path, costs, chords)


def initial_chords(lengths: Floats, stops: Floats, margins: Margins, step: float) -> Floats:
    """Return the first chords (n − 1,), on lattices of ``step`` that end ``stops`` (n − 1,) apart.

    They are the preferred ones, or longer: on the floor a segment reaches beyond its ends by half
    of the slack of its chord, and the segments before and after a short one must not reach each
    other.
    """
    chords = stops + step * np.round((margins.chord_ratio * lengths - stops) / step)
    longest = margins.max_chord_ratio * lengths - 2.0 * margins.tracking - _SPARE_CHORD
    apart = margins.cable + 2.0 * margins.tracking + _SPARE_CHORD
    middle = 1
    while middle < len(lengths) - 1:
        around = [middle - 1, middle + 1]
        slack = lengths[around] - chords[around]
        wider = [
            segment
            for segment in (*np.take(around, np.argsort(-slack)), middle)
            if chords[segment] + step <= longest[segment]
        ]
        if 0.5 * slack.sum() + apart <= chords[middle] or not wider:
            middle += 1
        else:
            chords[wider[0]] += step
    return chords


def _heights_below_strands(layout: KnotLayout) -> Floats:
    """Return the height (n − 1, 1) of the lowest final strand over each edge."""
    height = np.full((len(layout.lengths), 1), np.inf)
    if layout.crossings:
        over, under = np.array(layout.crossings, dtype=np.intp).T
        at = crossing_fractions(layout.corners, layout.crossings)[:, 0]
        corners, lengths = layout.corners, layout.lengths
        strand = solve_catenaries(corners[over], corners[over + 1], lengths[over])
        np.minimum.at(height[:, 0], under, strand.at_span(at)[:, 2])
    return height


def _loop_heights(layout: KnotLayout) -> Floats:
    """Return the height (1, n) at which the loop of each vehicle's longer segment passes others."""
    lengths = layout.lengths
    longer = np.maximum(np.append(lengths, 0.0), np.insert(lengths, 0, 0.0))
    height: Floats = _LOOP * longer[None]
    return height
