"""Costs of the states of a segment on its lattice; compiled.

A state is the places of the segment's two vehicles, and the edges over which they are. See
:mod:`swarm.folding.lattice`.
"""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from swarm.folding.margins import Margins, PenaltyModel
from swarm.folding.outlines import PIECES, reachable_length
from swarm.folding.soft_constraints import margin_cost, vehicle_cost
from swarm.folding.vehicle_clearance import DISC_ERRORS, rotor_disc_cost
from swarm.geometry.catenary import (
    Catenary,
    drop_at,
    solve_catenary,
    strand_polygon,
)
from swarm.geometry.distance import point_distance
from swarm.geometry.sensitivity import BOTH_ENDS, FINEST, chord_response, error_of_ends
from swarm.jit import compiled, inner
from swarm.signatures import Floats1, Floats2, Ints1, Signs1, Signs2

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.intp]
Signs = npt.NDArray[np.int8]

BLOCKED = 1e4
"""Cost of states in which the segment is over-stretched or its vehicles are out of order."""

_TOUCH = 0.125
"""Share of a segment's length around a corner within which adjacent edges do not count as
crossed."""

_CHORD_COST = 3e-2
"""Cost of the squared difference of the chord ratio from the preferred one."""

_TAUT_FROM, _TAUT_COST = 0.98, 0.5
"""Share of the largest chord, tracking errors included, from which a chord costs, and how much."""

_STRAIGHT_FROM, _STRAIGHT_COST = 0.995, 200.0
"""The same where little is left: it costs as much as missed margins."""

_ROUNDING = 1e-6
"""Metres by which a chord may exceed the largest one: rounding."""

_CLOSEST_PROGRESS = 0.4
"""Smallest difference of progress of the two vehicles, over their distance."""

_LONGEST_STATION = 2.2
"""Largest difference of station of the two vehicles, over the length of the segment."""

_PARALLEL = 1e-12
"""Square metres of the plan-view parallelogram of chord and edge below which they are parallel."""

_CORNER_ERRORS = 2.5
"""Tracking errors in the distance from corners: of the segment, and of the vehicle there."""


class Surfaces(NamedTuple):
    """Surfaces between strands that pass over and under each of e edges, as heights over an edge.

    ``corners`` (e + 1, 3) are those of the edges. ``half_angle`` (e,) is that of the final strands
    along them, ``response`` (e, FINEST) the vertical movement of their points, at equal shares of
    the span, per metre of both ends. ``side`` (e, e) is 1 where traffic on the first edge passes
    over the second, −1 where under; ``above`` (e,) is the side of all traffic whose relation is not
    given. ``gaps`` (e, m) are half the heights to the strands that an edge crosses, at
    ``fractions`` (e, m) of its span; the first ``crossed`` (e,) of both are used.
    """

    corners: Floats2
    half_angle: Floats1
    response: Floats2
    side: Signs2
    above: Signs1
    fractions: Floats2
    gaps: Floats2
    crossed: Ints1


class VehicleLattice(NamedTuple):
    """The k places of one vehicle: positions (k, 3), progress, station and edge (k,).

    At a corner ``edge`` is the edge after it, ``edge_before`` the edge before. The leader has
    reached the edges up to ``busy`` (k,).
    """

    positions: Floats2
    progress: Floats1
    station: Floats1
    edge: Ints1
    edge_before: Ints1
    busy: Ints1

    def since(self, first: int) -> "VehicleLattice":
        """Return the lattice from its place ``first`` on."""
        return VehicleLattice(
            self.positions[first:],
            self.progress[first:],
            self.station[first:],
            self.edge[first:],
            self.edge_before[first:],
            self.busy[first:],
        )


class _Extent(NamedTuple):
    """Chord and length of a segment in one state, metres."""

    chord: float
    length: float


class Segment(NamedTuple):
    """Length of a segment in metres, and memory for its outline (PIECES + 1, 3)."""

    length: float
    points: Floats2


def segment_of(length: float) -> Segment:
    """Return a segment with memory, which one computation may use at a time."""
    return Segment(length, np.empty((PIECES + 1, 3)))


@compiled
def fill_costs(
    ahead: VehicleLattice,
    behind: VehicleLattice,
    segment: Segment,
    surfaces: Surfaces,
    model: PenaltyModel,
    cost: Floats2,
) -> None:
    """Write the costs (a, b) of all states of a segment."""
    (length, points), margins = segment, model.margins
    for a in range(len(ahead.progress)):
        for b in range(len(behind.progress)):
            rear, front = behind.positions[b], ahead.positions[a]
            chord = point_distance(rear, front)
            station = ahead.station[a] - behind.station[b]
            progress = ahead.progress[a] - behind.progress[b]
            if (
                chord + 2.0 * margins.tracking > margins.max_chord_ratio * length + _ROUNDING
                or progress <= _CLOSEST_PROGRESS * margins.vehicle
                or not 0.0 < station < _LONGEST_STATION * length
            ):
                cost[a, b] = BLOCKED
                continue
            edges = behind.edge[b], ahead.edge_before[a], ahead.busy[a]
            extent = _Extent(chord, length)
            total = _own_cost(rear, front, extent, margins, points)
            total += _surface_cost(rear, front, extent, edges, surfaces, model)
            total += _corner_cost(rear, front, edges, surfaces.corners, margins)
            cost[a, b] = min(total, 0.1 * BLOCKED)


@inner
def _own_cost(
    rear: Floats, front: Floats, extent: _Extent, margins: Margins, points: Floats
) -> float:
    """Return the cost of the segment alone: chord, distance of its vehicles, their rotor discs."""
    chord, length = extent.chord, extent.length
    ratio = chord / length
    over = (ratio + 2.0 * margins.tracking / length) / margins.max_chord_ratio
    cost = _CHORD_COST * (ratio - margins.chord_ratio) ** 2
    taut = _TAUT_COST * max(over - _TAUT_FROM, 0.0)
    cost += taut + _STRAIGHT_COST * max(over - _STRAIGHT_FROM, 0.0)
    cost += vehicle_cost(rear, front, margins)
    if abs(rear[2] - front[2]) > margins.grip_offset - DISC_ERRORS * margins.tracking:
        strand_polygon(rear, front, reachable_length(length, chord), points)
        cost += rotor_disc_cost(rear, points, 0.0, margins)
        cost += rotor_disc_cost(front, points, 0.0, margins)
    return cost


@inner
def _surface_cost(
    rear: Floats,
    front: Floats,
    extent: _Extent,
    edges: tuple[int, int, int],
    surfaces: Surfaces,
    model: PenaltyModel,
) -> float:
    """Return the cost of distances from the surfaces of edges below the margin."""
    chord, length, margins = extent.chord, extent.length, model.margins
    moved = error_of_ends(BOTH_ENDS, margins.tracking)
    behind, ahead, busy = edges
    corners, cost, solved = surfaces.corners, 0.0, False
    angle = turn = 0.0
    strand = Catenary(length, 0.0, 0.0, 0.0, 0.0)
    own_x, own_y = front[0] - rear[0], front[1] - rear[1]
    for edge in range(min(busy, len(corners) - 2) + 1):
        if edge in (behind, ahead):
            continue
        x, y = corners[edge, 0] - rear[0], corners[edge, 1] - rear[1]
        along_x = corners[edge + 1, 0] - corners[edge, 0]
        along_y = corners[edge + 1, 1] - corners[edge, 1]
        area = own_x * along_y - own_y * along_x
        if abs(area) < _PARALLEL:
            continue
        share = x * along_y - y * along_x
        if share * area <= 0.0 or abs(share) >= abs(area):
            continue
        share /= area
        fraction = (x * own_y - y * own_x) / area
        span = math.sqrt(along_x * along_x + along_y * along_y)
        beyond, touch = margins.cable / span, _TOUCH * length / span
        # The edges before and after touch this one at corners; that is no crossing.
        least = touch if edge == ahead + 1 else -beyond
        most = 1.0 - touch if edge == behind - 1 else 1.0 + beyond
        if not least < fraction < most:
            continue
        side = _side(edge, behind, ahead, surfaces)
        if side == 0:
            continue
        if not solved:
            enough = reachable_length(length, chord)
            strand = solve_catenary(rear, front, enough)
            angle, turn = math.asinh(strand.slope), strand.span / strand.parameter
            solved = True
        half_turn = 0.5 * turn * share
        up = 2.0 * strand.parameter * math.sinh(half_turn) * math.sinh(angle + half_turn)
        slope = math.sinh(angle + 2.0 * half_turn)
        fraction = min(max(fraction, 0.0), 1.0)
        apart = side * (rear[2] + up - _surface_height(edge, fraction, side, span, surfaces))
        arc = (slope - strand.slope) * strand.parameter / strand.length
        piece = FINEST + min(max(int(arc * FINEST), 0), FINEST - 1)
        error = chord_response(strand.rise, strand.span, strand.length, moved, piece, model.tables)[
            1
        ]
        error += surfaces.response[edge, min(int(fraction * FINEST), FINEST - 1)]
        needed = 0.5 * margins.cable + 0.5 * margins.tracking * error
        unit = margins.cable + 2.0 * margins.tracking
        cost += margin_cost((apart / math.sqrt(1.0 + slope * slope) - needed) / unit)
    return cost


@inner
def _side(edge: int, behind: int, ahead: int, surfaces: Surfaces) -> int:
    """Return the side on which a segment passes an edge's surface: 1 over, −1 under."""
    side = surfaces.side[ahead, edge] if ahead >= 0 else 0
    if side == 0 and behind >= 0:
        side = surfaces.side[behind, edge]
    return side if side != 0 else surfaces.above[edge]


@inner
def _surface_height(
    edge: int, fraction: float, side: int, span: float, surfaces: Surfaces
) -> float:
    """Return the height of the surface over (side 1) or under (−1) an edge at a fraction of it."""
    x = surfaces.half_angle[edge]
    drop = span * drop_at(x, fraction, 0.0)
    count = surfaces.crossed[edge]
    gap = 0.0
    if count:
        gap = _interpolate(fraction, surfaces.fractions[edge, :count], surfaces.gaps[edge, :count])
    return float(surfaces.corners[edge, 2] - drop + side * gap)


@inner
def _interpolate(at: float, places: Floats, values: Floats) -> float:
    """Return the linear interpolation of values at increasing places (k,), constant outside.

    As ``np.interp``, which creates arrays even for one number.
    """
    if not at > places[0]:
        return float(values[0])
    for k in range(len(places) - 1):
        if at < places[k + 1]:
            slope = (values[k + 1] - values[k]) / (places[k + 1] - places[k])
            return float(slope * (at - places[k]) + values[k])
    return float(values[-1])


@inner
def _corner_cost(
    rear: Floats, front: Floats, edges: tuple[int, int, int], corners: Floats, margins: Margins
) -> float:
    """Return the cost of a short distance from corners, where others rest or change level."""
    behind, ahead, busy = edges
    needed = margins.vehicle_cable + margins.radius + _CORNER_ERRORS * margins.tracking
    unit, cost = margins.cable + 2.0 * margins.tracking, 0.0
    own_x, own_y = front[0] - rear[0], front[1] - rear[1]
    square = max(own_x * own_x + own_y * own_y, 1e-9)
    for number in range(min(busy + 1, len(corners) - 1) + 1):
        if behind <= number <= ahead + 1:
            continue
        x, y = corners[number, 0] - rear[0], corners[number, 1] - rear[1]
        share = min(max((x * own_x + y * own_y) / square, 0.0), 1.0)
        x, y = x - share * own_x, y - share * own_y
        if x * x + y * y < (needed + unit) ** 2:
            cost += margin_cost((math.sqrt(x * x + y * y) - needed) / unit)
    return cost


@compiled
def accumulate_costs(cost: Floats2, first: int, off_pace: float, best: Floats2) -> None:
    """Write the cost (a, b) of the cheapest path from state (0, ``first``) to every other state.

    Every step moves both vehicles by one place, or one of them, which costs ``off_pace`` more.
    """
    for a in range(cost.shape[0]):
        for b in range(cost.shape[1]):
            if a == 0 and b <= first:
                best[a, b] = cost[a, b] if b == first else np.inf
                continue
            least = best[a - 1, b] + off_pace if a else np.inf
            if b:
                least = min(least, best[a, b - 1] + off_pace)
            if a and b:
                least = min(least, best[a - 1, b - 1])
            best[a, b] = least + cost[a, b]
