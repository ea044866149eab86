"""What one segment may do on its way along γ, whatever the others do.

The state of a segment is the progress of the two vehicles that hold it. Between each pair of edges
that cross, half way between their final strands, lies a *surface*: traffic on the upper edge keeps
above, traffic on the lower edge below. A segment that everywhere keeps its side of the surfaces,
and its distance from the corners where others rest and change level, meets no other that does
(NOTES, finding 4: but with margins for both sides). So every segment is a problem of its own,
planar and quick.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from swarm.cable.catenary import Catenaries, hang
from swarm.cable.chain import crossing_fractions, crossing_gaps
from swarm.fold.answer import lift, movement
from swarm.fold.clear import (
    chord_cost,
    rotor_cost,
    shares,
    shortfall,
    strands,
    vehicle_cost,
)
from swarm.fold.layout import Hanging
from swarm.fold.margins import Margins
from swarm.fold.path import FoldPath

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.intp]

BLOCKED = 1e4
"""Cost of states in which the segment would be over-stretched or its vehicles out of order."""


@dataclass(frozen=True, eq=False)
class Passage:
    """Costs (a, b) of a segment's states: vehicle ahead at a, vehicle behind at b.

    ``ahead`` (a,) and ``behind`` (b,) are progress in metres.
    """

    ahead: Floats
    behind: Floats
    cost: Floats


@dataclass(frozen=True, eq=False)
class Surfaces:
    """Between what passes over and under each edge: heights over the edge's course.

    ``side`` (edges, edges) is 1 where traffic on the first passes over the second, −1 where under;
    ``above`` (edges,) is the side on which everything passes an edge whose relation is not given.
    ``gaps`` has, per edge, fractions of its span and half the height to the strand it crosses.
    """

    layout: Hanging
    final: Catenaries
    ratio: Floats
    side: npt.NDArray[np.int8]
    above: npt.NDArray[np.int8]
    gaps: tuple[tuple[Floats, Floats], ...]

    def height(self, edge: int, fraction: Floats, side: Floats) -> Floats:
        """Height (k,) of the surface over (side 1) or under (−1) an edge at fractions of it."""
        return self.strand(edge, fraction) + side * np.interp(fraction, *self.gaps[edge])

    def strand(self, edge: int, fraction: Floats) -> Floats:
        """Height (k,) of the strand that will finally hang over an edge, whose ends are level."""
        x, span = self.final.half_angle[edge], self.final.span[edge]
        drop = np.sinh(x * fraction) * np.sinh(x * (1.0 - fraction)) / x
        lowered: Floats = self.layout.corners[edge, 2] - span * drop
        return lowered


def surfaces(layout: Hanging) -> Surfaces:
    """Surfaces half way between the strands that cross in a layout."""
    corners, count = layout.corners, len(layout.lengths)
    final = hang(corners[:-1], corners[1:], layout.lengths)
    side = np.zeros((count, count), dtype=np.int8)
    for over, under in layout.crossings:
        side[over, under], side[under, over] = 1, -1
    found = Surfaces(
        layout, final, final.span / layout.lengths, side,
        -np.sign(layout.lanes).astype(np.int8), ((np.zeros(1), np.zeros(1)),) * count,
    )  # fmt: skip
    fractions = crossing_fractions(corners, layout.crossings) if layout.crossings else ()
    heights = crossing_gaps(corners, layout.lengths, layout.crossings) if layout.crossings else ()
    gaps: list[list[tuple[float, float]]] = [[] for _ in range(count)]
    for pair, fraction, gap in zip(layout.crossings, fractions, heights, strict=True):
        for edge, at in zip(pair, fraction, strict=True):
            gaps[edge].append((float(at), 0.5 * float(gap)))
    tables = tuple(
        (np.array([f for f, _ in sorted(row)]), np.array([g for _, g in sorted(row)]))
        if row
        else (np.zeros(1), np.zeros(1))
        for row in gaps
    )
    return Surfaces(layout, final, found.ratio, side, found.above, tables)


def passage(
    segment: int, path: FoldPath, between: Surfaces, margins: Margins, step: float
) -> Passage:
    """Cost of every state of a segment, on a lattice of ``step`` metres that ends in its goal."""
    length, stops = between.layout.lengths[segment], path.stops
    behind = _lattice(stops[segment], -3.0 * length - step, step)
    ahead = _lattice(stops[segment + 1], -step, step)
    rear, front = path.at(segment, behind)[0], path.at(segment + 1, ahead)[0]
    rear_station, front_station = path.station(behind), path.station(ahead)
    chord = np.linalg.norm(front[:, None] - rear[None], axis=2)
    possible = (
        (chord + 2.0 * margins.tracking <= margins.taut * length + 1e-6)
        & (ahead[:, None] - behind[None] > 0.4 * margins.vehicle)
        & (front_station[:, None] - rear_station[None] < 2.2 * length)
        & (front_station[:, None] > rear_station[None])
    )
    b, a = np.nonzero(possible)
    lead = ahead[b] + margins.spacing * between.layout.lengths[segment + 1 :].sum()
    states = _States(
        rear=rear[a],
        front=front[b],
        edge_behind=_edge(path, rear_station[a]),
        edge_ahead=_edge(path, front_station[b] - 1e-6 * step),
        busy=_edge(path, path.station(np.minimum(lead, stops[-1])) - 1e-6 * step),
        length=float(length),
    )
    cost = np.full(possible.shape, BLOCKED)
    cost[b, a] = np.minimum(states.cost(path, between, margins), 0.1 * BLOCKED)
    return Passage(ahead, behind, cost)


def _lattice(stop: float, begin: float, step: float) -> Floats:
    count = int(np.ceil((stop - begin) / step)) + 1
    places: Floats = stop - step * np.arange(count - 1.0, -1.0, -1.0)
    return places


def _edge(path: FoldPath, station: Floats) -> Ints:
    """The edge (k,) over which a station lies; −1 on the run-in."""
    edges = np.searchsorted(path.stations, station, side="right") - 1
    found: Ints = np.clip(edges, -1, len(path.stations) - 2)
    return found


@dataclass(frozen=True, eq=False)
class _States:
    """Segments (k,) between vehicles at ``rear`` and ``front``, and the edges these are over.

    Edges up to ``busy`` have been reached by the leader.
    """

    rear: Floats
    front: Floats
    edge_behind: Ints
    edge_ahead: Ints
    busy: Ints
    length: float

    def cost(self, path: FoldPath, between: Surfaces, margins: Margins) -> Floats:
        """What every state costs (k,)."""
        hung = strands(self.rear, self.front, self.length)
        cost = chord_cost(hung, margins)
        cost += rotor_cost(self.rear, hung, margins) + rotor_cost(self.front, hung, margins)
        cost += vehicle_cost(self.rear, self.front[None], margins)
        chord = hung.ratio * self.length
        curve = hang(self.rear, self.front, np.maximum(self.length, chord * 1.001 + 1e-9))
        for edge in range(len(between.gaps)):
            self._pass(edge, curve, hung.ratio, between, margins, cost)
        return cost + self._at_corners(path, margins)

    def _pass(
        self,
        edge: int,
        curve: Catenaries,
        ratio: Floats,
        between: Surfaces,
        margins: Margins,
        cost: Floats,
    ) -> None:
        """Add what it costs not to keep to the right side of an edge's surface by a margin."""
        corners = between.layout.corners[:, :2]
        begin, along = corners[edge], corners[edge + 1] - corners[edge]
        span = float(np.linalg.norm(along))
        there = (self.edge_behind != edge) & (self.edge_ahead != edge) & (edge <= self.busy)
        own = self.front[:, :2] - self.rear[:, :2]
        share, fraction = shares(self.rear[:, :2], own, begin, along)
        beyond = margins.cable / span
        crossing = (
            there & (share > 0.0) & (share < 1.0) & (fraction > -beyond) & (fraction < 1.0 + beyond)
        )
        # The edges before and after touch this one at corners; that is no crossing.
        touch = _TOUCH * self.length / span
        crossing &= ~((edge == self.edge_ahead + 1) & (fraction < touch))
        crossing &= ~((edge == self.edge_behind - 1) & (fraction > 1.0 - touch))
        k = np.flatnonzero(crossing)
        if not len(k):
            return
        side = self._side(edge, k, between)
        fraction = np.clip(fraction[k], 0.0, 1.0)
        height, slope = _height(curve, k, share[k])
        over = side * (height - between.height(edge, fraction, side)) / np.hypot(1.0, slope)
        error = movement(lift(ratio[k]), share[k], 1.0)
        error += movement(np.full(len(k), lift(between.ratio[edge])), fraction, 1.0)
        needed = 0.5 * margins.cable + 0.5 * margins.tracking * error
        unit = margins.cable + 2.0 * margins.tracking
        cost[k] += np.where(side, shortfall((over - needed) / unit), 0.0)

    def _side(self, edge: int, k: Ints, between: Surfaces) -> Floats:
        """On which side (k,) of an edge's surface the segments pass: 1 over it, −1 under it."""
        ahead, behind = self.edge_ahead[k], self.edge_behind[k]
        side = np.where(ahead >= 0, between.side[ahead, edge], 0)
        side = np.where(side == 0, np.where(behind >= 0, between.side[behind, edge], 0), side)
        found: Floats = np.where(side == 0, between.above[edge], side).astype(np.float64)
        return found

    def _at_corners(self, path: FoldPath, margins: Margins) -> Floats:
        """Cost (k,) of coming near corners, where others rest or change level."""
        cost = np.zeros(len(self.rear))
        own = self.front[:, :2] - self.rear[:, :2]
        square = np.maximum(np.einsum("kx,kx->k", own, own), 1e-9)
        needed = margins.vehicle_cable + margins.radius + 2.5 * margins.tracking
        unit = margins.cable + 2.0 * margins.tracking
        for number, corner in enumerate(path.corners[:, :2]):
            others = (number < self.edge_behind) | (number > self.edge_ahead + 1)
            k = np.flatnonzero(others & (number <= self.busy + 1))
            toward = corner - self.rear[k, :2]
            share = np.clip(np.einsum("kx,kx->k", toward, own[k]) / square[k], 0.0, 1.0)
            distance = np.linalg.norm(toward - share[:, None] * own[k], axis=1)
            near = distance < needed + unit
            cost[k[near]] += shortfall((distance[near] - needed) / unit)
        return cost


_TOUCH = 0.125
"""Share of a segment's length around its own edges' corners where edges next to these touch it."""


def _height(curve: Catenaries, k: Ints, share: Floats) -> tuple[Floats, Floats]:
    """Height and slope of strands k at shares of their spans in plan view."""
    turned = curve.half_angle[k] * share
    begin = np.arcsinh(curve.slope[k])
    up = 2.0 * curve.parameter[k] * np.sinh(turned) * np.sinh(begin + turned)
    return curve.start[k, 2] + up, np.sinh(begin + 2.0 * turned)


_OFF_PACE = 0.01
"""Cost of a step in which only one of the two vehicles moves, next to a metre of margin."""


@dataclass(frozen=True, eq=False)
class Way:
    """A way through a passage: indices (m,) of ``ahead`` and ``behind``, one step after another.

    ``cost`` (m,) is what its states cost.
    """

    table: Passage
    ahead: Ints
    behind: Ints
    cost: Floats


def walked(table: Passage, spacing: float) -> Way:
    """Cheapest way from the run-in to the goal.

    Every step moves one of the vehicles, or both, by one place of the lattice. It begins with the
    vehicle ahead at its first place and the one behind nearest to ``spacing`` metres behind.
    """
    cost = table.cost
    rows, columns = cost.shape
    first = int(np.argmin(np.abs(table.ahead[0] - spacing - table.behind)))
    best = np.empty_like(cost)
    for b in range(rows):
        if b:
            enter = best[b - 1] + cost[b] + _OFF_PACE
            enter[1:] = np.minimum(enter[1:], best[b - 1, :-1] + cost[b, 1:])
        else:
            enter = np.full(columns, np.inf)
            enter[first] = cost[0, first]
        walking = np.cumsum(cost[b] + _OFF_PACE)
        best[b] = np.minimum.accumulate(enter - walking) + walking
    ahead, behind = _traced(best, first)
    return Way(table, ahead, behind, cost[ahead, behind])


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


def trailing(ticks: Floats, way: Way, step: float) -> Floats:
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
