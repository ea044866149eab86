"""What one segment may do on its way along γ, whatever the others do.

The state of a segment is the progress of the two vehicles that hold it. Between each pair of edges
that cross, half way between their final strands, lies a *surface*: traffic on the upper edge keeps
above, traffic on the lower edge below. A segment that everywhere keeps its side of the surfaces,
and its distance from the corners where others rest and change level, meets no other that does
(NOTES, finding 4: but with margins for both sides). So every segment is a problem of its own,
planar and quick.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from swarm.folding.end_sensitivity import sag_responses
from swarm.folding.lattice_states import Surfaces, VehicleLattice, accumulate_costs, fill_costs
from swarm.folding.layout import KnotLayout
from swarm.folding.margins import Margins
from swarm.folding.path import FoldPath
from swarm.geometry.catenary import solve_catenaries
from swarm.geometry.chain import crossing_fractions, crossing_gaps

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class SegmentCosts:
    """Costs (a, b) of a segment's states: vehicle ahead at a, vehicle behind at b.

    ``ahead`` (a,) and ``behind`` (b,) are progress in metres.
    """

    ahead: Floats
    behind: Floats
    cost: Floats


def separating_surfaces(layout: KnotLayout) -> Surfaces:
    """Surfaces half way between the strands that cross in a layout."""
    corners, count = layout.corners, len(layout.lengths)
    final = solve_catenaries(corners[:-1], corners[1:], layout.lengths)
    side = np.zeros((count, count), dtype=np.int8)
    for over, under in layout.crossings:
        side[over, under], side[under, over] = 1, -1
    crossed = np.zeros(count, dtype=np.intp)
    fractions = np.full((count, len(layout.crossings)), np.inf)
    gaps = np.zeros(fractions.shape)
    if layout.crossings:
        places = crossing_fractions(corners, layout.crossings)
        heights = crossing_gaps(corners, layout.lengths, layout.crossings)
        for pair, fraction, gap in zip(layout.crossings, places, heights, strict=True):
            for edge, at in zip(pair, fraction, strict=True):
                fractions[edge, crossed[edge]], gaps[edge, crossed[edge]] = at, 0.5 * gap
                crossed[edge] += 1
    order = np.argsort(fractions, axis=1, kind="stable")
    return Surfaces(
        corners=corners,
        half_angle=final.half_angle,
        lifted=sag_responses(final.span / layout.lengths),
        side=side,
        above=-np.sign(layout.lanes).astype(np.int8),
        fractions=np.take_along_axis(fractions, order, axis=1),
        gaps=np.take_along_axis(gaps, order, axis=1),
        crossed=crossed,
    )


def segment_costs(
    layout: KnotLayout, path: FoldPath, margins: Margins, step: float
) -> Iterator[SegmentCosts]:
    """Cost of every state of each segment, on lattices of ``step`` metres that end in its goal."""
    between = separating_surfaces(layout)
    behind = _lattice(0, layout, path, margins, step)
    for segment, length in enumerate(layout.lengths):
        following = _lattice(segment + 1, layout, path, margins, step)
        begin = int(np.searchsorted(following.progress, -2.0 * step, side="right"))
        ahead = following.since(begin)
        cost = np.empty((len(ahead.progress), len(behind.progress)))
        fill_costs(ahead, behind, float(length), between, margins, cost)
        yield SegmentCosts(ahead.progress, behind.progress, cost)
        behind = following


def _lattice(
    vehicle: int, layout: KnotLayout, path: FoldPath, margins: Margins, step: float
) -> VehicleLattice:
    """Where a vehicle may be: from far enough behind the first corner to where it stops."""
    own = layout.lengths[vehicle : vehicle + 1].sum()
    before, stop = step + 3.0 * own, path.stops[vehicle]
    count = int(np.ceil((stop + before) / step)) + 1
    progress = stop - step * np.arange(count - 1.0, -1.0, -1.0)
    station = path.station(progress)
    lead = margins.chord_ratio * layout.lengths[vehicle:].sum()
    leader = path.station(np.minimum(progress + lead, path.stops[-1]))
    return VehicleLattice(
        places=path.at(vehicle, progress)[0],
        progress=progress,
        station=station,
        edge=_edge(path, station),
        edge_before=_edge(path, station - 1e-6 * step),
        busy=_edge(path, leader - 1e-6 * step),
    )


def _edge(path: FoldPath, station: Floats) -> Ints:
    """The edge (k,) over which a station lies; −1 on the run-in."""
    edges = np.searchsorted(path.stations, station, side="right") - 1
    found: Ints = np.clip(edges, -1, len(path.stations) - 2)
    return found


_OFF_PACE = 0.01
"""Cost of a step in which only one of the two vehicles moves, next to a metre of margin."""


@dataclass(frozen=True, eq=False)
class LatticePath:
    """A way through a passage: indices (m,) of ``ahead`` and ``behind``, one step after another.

    ``cost`` (m,) is what its states cost.
    """

    table: SegmentCosts
    ahead: Ints
    behind: Ints
    cost: Floats


def cheapest_path(table: SegmentCosts, spacing: float) -> LatticePath:
    """Cheapest way from the run-in to the goal.

    Every step moves one of the vehicles, or both, by one place of the lattice. It begins with the
    vehicle ahead at its first place and the one behind nearest to ``spacing`` metres behind.
    """
    first = int(np.argmin(np.abs(table.ahead[0] - spacing - table.behind)))
    best = np.empty_like(table.cost)
    accumulate_costs(table.cost, first, _OFF_PACE, best)
    ahead, behind = _traced(best, first)
    return LatticePath(table, ahead, behind, table.cost[ahead, behind])


def _traced(best: Floats, first: int) -> tuple[Ints, Ints]:
    b, a = best.shape[0] - 1, best.shape[1] - 1
    ahead, behind = [b], [a]
    while b > 0 or a > first:
        # The cheapest of the places before is where the way came from, since the step's own cost
        # is the same; only a step of one vehicle costs a little more.
        both = best[b - 1, a - 1] if b and a else np.inf
        one = best[b - 1, a] + _OFF_PACE if b else np.inf
        other = best[b, a - 1] + _OFF_PACE if a else np.inf
        if both <= one and both <= other:
            b, a = b - 1, a - 1
        elif one <= other:
            b -= 1
        else:
            a -= 1
        ahead.append(b)
        behind.append(a)
    return np.array(ahead[::-1], dtype=np.intp), np.array(behind[::-1], dtype=np.intp)


def append_follower(ticks: Floats, way: LatticePath, step: float) -> Floats:
    """Progress (m, k + 1) of one vehicle more, behind those whose progress (m, k) is known."""
    table, ahead, behind = way.table, way.ahead, way.behind
    place = np.round((ticks[:, 0] - table.ahead[0]) / step).astype(np.intp)
    wanted = np.bincount(ahead, minlength=len(table.ahead))
    here = np.maximum(place, 0)
    present = np.bincount(here[place >= 0], minlength=len(table.ahead))
    leaving = np.append(place[1:] != place[:-1], True) & (place >= 0)
    repeats = np.ones(len(place), dtype=np.intp)
    repeats[leaving] += np.maximum(wanted - present, 0)[place[leaving]]
    ticks, place = np.repeat(ticks, repeats, axis=0), np.repeat(place, repeats)
    begins = np.concatenate([[0], np.flatnonzero(place[1:] != place[:-1]) + 1])
    since = np.arange(len(place)) - np.repeat(begins, np.diff(np.append(begins, len(place))))
    here = np.maximum(place, 0)
    stay = np.bincount(here[place >= 0], minlength=len(table.ahead))
    first = np.searchsorted(ahead, here)
    state = first + since * wanted[here] // np.maximum(stay[here], 1)
    progress = np.where(
        place >= 0,
        table.behind[behind[np.minimum(state, len(behind) - 1)]],
        table.behind[behind[0]] + place * step,
    )
    return np.concatenate([progress[:, None], ticks], axis=1)
