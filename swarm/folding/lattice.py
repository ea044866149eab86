"""Lattice of the possible motions of one segment along γ, independent of all others.

The state of a segment is the progress of its two vehicles. Between each pair of edges that cross,
half way between their final strands, lies a *surface*: traffic on the upper edge stays above it,
traffic on the lower edge below. A segment that stays on its side of all surfaces, and at a distance
from the corners where others rest and change level, meets no other segment that does the same. So
every segment is a problem of its own, planar and fast to solve.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from swarm.folding.lattice_states import (
    Surfaces,
    VehicleLattice,
    accumulate_costs,
    fill_costs,
    segment_of,
)
from swarm.folding.layout import KnotLayout
from swarm.folding.margins import Margins, PenaltyModel
from swarm.folding.path import FoldPath
from swarm.geometry.catenary import Catenaries, solve_catenaries
from swarm.geometry.chain import crossing_fractions, crossing_gaps
from swarm.geometry.sensitivity import BOTH_ENDS, FINEST, sensitivity_tables

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.intp]

_OFF_PACE = 0.01
"""Cost of a step in which only one of the two vehicles moves: small beside that of any miss."""


@dataclass(frozen=True, eq=False)
class SegmentCosts:
    """Costs (a, b) of a segment's states: the vehicle ahead at a, the vehicle behind at b.

    ``ahead`` (a,) and ``behind`` (b,) are progress in metres.
    """

    ahead: Floats
    behind: Floats
    cost: Floats


def separating_surfaces(layout: KnotLayout, tracking: float) -> Surfaces:
    """Return the surfaces half way between the strands that cross in a layout.

    The ends of the strands have tracking errors of up to ``tracking`` metres.
    """
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
        response=_vertical_response(final, tracking),
        side=side,
        above=-np.sign(layout.lanes).astype(np.int8),
        fractions=np.take_along_axis(fractions, order, axis=1),
        gaps=np.take_along_axis(gaps, order, axis=1),
        crossed=crossed,
    )


def _vertical_response(strands: Catenaries, tracking: float) -> Floats:
    """Return the vertical movement (e, FINEST) of strands' points per metre of both ends."""
    shares = (np.arange(FINEST) + 0.5) / FINEST
    angle, turn = np.arcsinh(strands.slope), strands.span / strands.parameter
    slope = np.sinh(angle[:, None] + turn[:, None] * shares)
    arc = (slope - strands.slope[:, None]) * (strands.parameter / strands.length)[:, None]
    piece = FINEST + np.clip((arc * FINEST).astype(np.intp), 0, FINEST - 1)
    chord = np.hypot(strands.span, strands.rise)
    sine = np.abs(strands.rise) / chord
    _, rising = sensitivity_tables().largest(
        (chord / strands.length)[:, None], (2.0 * tracking / strands.length)[:, None],
        sine[:, None], BOTH_ENDS, piece,
    )  # fmt: skip
    return rising


def segment_costs(
    layout: KnotLayout, path: FoldPath, margins: Margins, step: float
) -> Iterator[SegmentCosts]:
    """Yield the costs of the states of each segment, on lattices of ``step`` metres to its goal."""
    surfaces = separating_surfaces(layout, margins.tracking)
    model = PenaltyModel(margins, sensitivity_tables())
    behind = _lattice(0, layout, path, margins, step)
    for segment, length in enumerate(layout.lengths):
        following = _lattice(segment + 1, layout, path, margins, step)
        begin = int(np.searchsorted(following.progress, -2.0 * step, side="right"))
        ahead = following.since(begin)
        cost = np.empty((len(ahead.progress), len(behind.progress)))
        fill_costs(ahead, behind, segment_of(float(length)), surfaces, model, cost)
        yield SegmentCosts(ahead.progress, behind.progress, cost)
        behind = following


def _lattice(
    vehicle: int, layout: KnotLayout, path: FoldPath, margins: Margins, step: float
) -> VehicleLattice:
    """Return the places of a vehicle: from behind the first corner to its own corner.

    It begins three lengths of its segment and a step before the first corner.
    """
    own = layout.lengths[vehicle : vehicle + 1].sum()
    before, stop = step + 3.0 * own, path.stops[vehicle]
    count = int(np.ceil((stop + before) / step)) + 1
    progress = stop - step * np.arange(count - 1.0, -1.0, -1.0)
    station = path.station(progress)
    lead = margins.chord_ratio * layout.lengths[vehicle:].sum()
    leader = path.station(np.minimum(progress + lead, path.stops[-1]))
    return VehicleLattice(
        positions=path.places(vehicle, progress),
        progress=progress,
        station=station,
        edge=_edge(path, station),
        edge_before=_edge(path, station - 1e-6 * step),
        busy=_edge(path, leader - 1e-6 * step),
    )


def _edge(path: FoldPath, station: Floats) -> Ints:
    """Return the edge (k,) of each station; −1 on the run-in."""
    edges = np.searchsorted(path.stations, station, side="right") - 1
    clipped: Ints = np.clip(edges, -1, len(path.stations) - 2)
    return clipped


@dataclass(frozen=True, eq=False)
class LatticePath:
    """A path through a segment's states: indices (m,) of ``ahead`` and ``behind``, step by step.

    ``cost`` (m,) are the costs of its states.
    """

    costs: SegmentCosts
    ahead: Ints
    behind: Ints
    cost: Floats


def cheapest_path(costs: SegmentCosts, chord: float) -> LatticePath:
    """Return the cheapest path from the run-in to the goal.

    Every step moves one of the vehicles, or both, by one place of the lattice. At the start the
    vehicle ahead is at its first place, the vehicle behind nearest to ``chord`` metres behind it.
    """
    first = int(np.argmin(np.abs(costs.ahead[0] - chord - costs.behind)))
    best = np.empty_like(costs.cost)
    accumulate_costs(costs.cost, first, _OFF_PACE, best)
    ahead, behind = _backtrack(best, first)
    return LatticePath(costs, ahead, behind, costs.cost[ahead, behind])


def _backtrack(best: Floats, first: int) -> tuple[Ints, Ints]:
    """Return the indices of the cheapest path, from the accumulated costs (a, b)."""
    b, a = best.shape[0] - 1, best.shape[1] - 1
    ahead, behind = [b], [a]
    while b > 0 or a > first:
        # The path came from the cheapest of the places before: the step's own cost is the same,
        # but for the small cost of a step of one vehicle.
        both = best[b - 1, a - 1] if b and a else np.inf
        front = best[b - 1, a] + _OFF_PACE if b else np.inf
        rear = best[b, a - 1] + _OFF_PACE if a else np.inf
        if both <= front and both <= rear:
            b, a = b - 1, a - 1
        elif front <= rear:
            b -= 1
        else:
            a -= 1
        ahead.append(b)
        behind.append(a)
    return np.array(ahead[::-1], dtype=np.intp), np.array(behind[::-1], dtype=np.intp)


def append_follower(ticks: Floats, path: LatticePath, step: float) -> Floats:
    """Return progress (m, k + 1): one more vehicle behind those with progress (m, k)."""
    costs, ahead, behind = path.costs, path.ahead, path.behind
    place = np.round((ticks[:, 0] - costs.ahead[0]) / step).astype(np.intp)
    wanted = np.bincount(ahead, minlength=len(costs.ahead))
    here = np.maximum(place, 0)
    present = np.bincount(here[place >= 0], minlength=len(costs.ahead))
    leaving = np.append(place[1:] != place[:-1], True) & (place >= 0)
    repeats = np.ones(len(place), dtype=np.intp)
    repeats[leaving] += np.maximum(wanted - present, 0)[place[leaving]]
    ticks, place = np.repeat(ticks, repeats, axis=0), np.repeat(place, repeats)
    begins = np.concatenate([[0], np.flatnonzero(place[1:] != place[:-1]) + 1])
    since = np.arange(len(place)) - np.repeat(begins, np.diff(np.append(begins, len(place))))
    here = np.maximum(place, 0)
    stay = np.bincount(here[place >= 0], minlength=len(costs.ahead))
    first = np.searchsorted(ahead, here)
    state = first + since * wanted[here] // np.maximum(stay[here], 1)
    progress = np.where(
        place >= 0,
        costs.behind[behind[np.minimum(state, len(behind) - 1)]],
        costs.behind[behind[0]] + place * step,
    )
    return np.concatenate([progress[:, None], ticks], axis=1)
