"""What a segment's states cost, one by one; compiled.

A state is where the segment's two vehicles are, and over which edges. See
:mod:`swarm.folding.lattice` for what costs.
"""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from swarm.folding.end_sensitivity import PIECES, interpolate, point_movement, sag_response
from swarm.folding.margins import Margins
from swarm.folding.soft_constraints import margin_cost, vehicle_cost
from swarm.folding.vehicle_clearance import rotor_disc_cost
from swarm.geometry import catenary_kernel
from swarm.geometry.catenary_shape import drop_at
from swarm.geometry.distance import point_distance
from swarm.jit import compiled

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.intp]
Signs = npt.NDArray[np.int8]

BLOCKED = 1e4
"""Cost of states in which the segment would be over-stretched or its vehicles out of order."""

_TOUCH = 0.125
"""Share of a segment's length around its own edges' corners where edges next to these touch it."""


class Surfaces(NamedTuple):
    """Surfaces between what passes over and under each of e edges: heights over the edge's course.

    ``corners`` (e + 1, 3) are the edges'. ``half_angle`` and ``lifted`` (e,) describe the strands
    that will finally hang along them. ``side`` (e, e) is 1 where traffic on the first passes over
    the second, −1 where under; ``above`` (e,) is the side on which everything passes an edge whose
    relation is not given. ``gaps`` (e, m) are half the heights to the strands that an edge crosses,
    at ``fractions`` (e, m) of its span; of both the first ``crossed`` (e,) count.
    """

    corners: Floats
    half_angle: Floats
    lifted: Floats
    side: Signs
    above: Signs
    fractions: Floats
    gaps: Floats
    crossed: Ints


class VehicleLattice(NamedTuple):
    """Where one vehicle may be: k places (k, 3), and of each progress, station and edge (k,).

    At a corner ``edge`` is the one after it, ``edge_before`` the one before. Edges up to ``busy``
    (k,) have been reached by the leader.
    """

    places: Floats
    progress: Floats
    station: Floats
    edge: Ints
    edge_before: Ints
    busy: Ints

    def since(self, first: int) -> "VehicleLattice":
        """The lattice without what comes before its ``first`` place."""
        return VehicleLattice(
            self.places[first:],
            self.progress[first:],
            self.station[first:],
            self.edge[first:],
            self.edge_before[first:],
            self.busy[first:],
        )


@compiled
def fill_costs(
    ahead: VehicleLattice,
    behind: VehicleLattice,
    length: float,
    between: Surfaces,
    margins: Margins,
    cost: Floats,
) -> None:
    """Write the cost (a, b) of every state of a segment of some length."""
    points = np.empty((PIECES + 1, 3))
    for a in range(len(ahead.progress)):
        for b in range(len(behind.progress)):
            rear, front = behind.places[b], ahead.places[a]
            chord = point_distance(rear, front)
            station = ahead.station[a] - behind.station[b]
            if (
                chord + 2.0 * margins.tracking > margins.max_chord_ratio * length + 1e-6
                or ahead.progress[a] - behind.progress[b] <= 0.4 * margins.vehicle
                or not 0.0 < station < 2.2 * length
            ):
                cost[a, b] = BLOCKED
                continue
            edges = behind.edge[b], ahead.edge_before[a], ahead.busy[a]
            found = _alone(rear, front, chord, length, margins, points)
            found += _passing(rear, front, chord, length, edges, between, margins)
            found += _at_corners(rear, front, edges, between.corners, margins)
            cost[a, b] = min(found, 0.1 * BLOCKED)


@compiled
def _alone(
    rear: Floats, front: Floats, chord: float, length: float, margins: Margins, points: Floats
) -> float:
    """Cost of the segment by itself: near taut, in its vehicles' discs, these near each other."""
    ratio = chord / length
    over = (ratio + 2.0 * margins.tracking / length) / margins.max_chord_ratio
    cost = 3e-2 * (ratio - margins.chord_ratio) ** 2
    cost += 0.5 * max(over - 0.98, 0.0) + 200.0 * max(over - 0.995, 0.0)
    cost += vehicle_cost(rear, front, margins)
    if abs(rear[2] - front[2]) > margins.grip_offset - 1.5 * margins.tracking:
        catenary_kernel.strand_polygon(rear, front, max(length, chord * 1.001 + 1e-9), points)
        cost += rotor_disc_cost(rear, points, 0.0, margins)
        cost += rotor_disc_cost(front, points, 0.0, margins)
    return cost


@compiled
def _passing(
    rear: Floats,
    front: Floats,
    chord: float,
    length: float,
    edges: tuple[int, int, int],
    between: Surfaces,
    margins: Margins,
) -> float:
    """Cost of not keeping to the right sides of edges' surfaces by a margin."""
    behind, ahead, busy = edges
    corners, cost, hung = between.corners, 0.0, False
    angle = turn = parameter = lifted = 0.0
    own_x, own_y = front[0] - rear[0], front[1] - rear[1]
    for edge in range(min(busy, len(corners) - 2) + 1):
        if edge in (behind, ahead):
            continue
        x, y = corners[edge, 0] - rear[0], corners[edge, 1] - rear[1]
        along_x = corners[edge + 1, 0] - corners[edge, 0]
        along_y = corners[edge + 1, 1] - corners[edge, 1]
        area = own_x * along_y - own_y * along_x
        if abs(area) < 1e-12:
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
        side = _side(edge, behind, ahead, between)
        if side == 0:
            continue
        if not hung:
            enough = max(length, chord * 1.001 + 1e-9)
            strand = catenary_kernel.solve_catenary(rear, front, enough, 1e-6)
            parameter = strand.parameter
            angle, turn = math.asinh(strand.slope), strand.span / parameter
            lifted, hung = sag_response(chord / length), True
        ahead_of = 0.5 * turn * share
        up = 2.0 * parameter * math.sinh(ahead_of) * math.sinh(angle + ahead_of)
        steep = math.sinh(angle + 2.0 * ahead_of)
        fraction = min(max(fraction, 0.0), 1.0)
        apart = side * (rear[2] + up - _surface(edge, fraction, side, span, between))
        error = point_movement(lifted, share, 1.0) + point_movement(
            between.lifted[edge], fraction, 1.0
        )
        needed = 0.5 * margins.cable + 0.5 * margins.tracking * error
        unit = margins.cable + 2.0 * margins.tracking
        cost += margin_cost((apart / math.sqrt(1.0 + steep * steep) - needed) / unit)
    return cost


@compiled
def _side(edge: int, behind: int, ahead: int, between: Surfaces) -> int:
    """On which side of an edge's surface a segment passes: 1 over it, −1 under it."""
    side = between.side[ahead, edge] if ahead >= 0 else 0
    if side == 0 and behind >= 0:
        side = between.side[behind, edge]
    return side if side != 0 else between.above[edge]


@compiled
def _surface(edge: int, fraction: float, side: int, span: float, between: Surfaces) -> float:
    """Height of the surface over (side 1) or under (−1) an edge at a fraction of it."""
    x = between.half_angle[edge]
    drop = span * drop_at(x, fraction, 0.0)
    count = between.crossed[edge]
    gap = 0.0
    if count:
        gap = interpolate(fraction, between.fractions[edge, :count], between.gaps[edge, :count])
    return float(between.corners[edge, 2] - drop + side * gap)


@compiled
def _at_corners(
    rear: Floats, front: Floats, edges: tuple[int, int, int], corners: Floats, margins: Margins
) -> float:
    """Cost of coming near corners, where others rest or change level."""
    behind, ahead, busy = edges
    needed = margins.vehicle_cable + margins.radius + 2.5 * margins.tracking
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
def accumulate_costs(cost: Floats, first: int, off_pace: float, best: Floats) -> None:
    """Write what the cheapest way costs (a, b) from state (0, ``first``) to every other.

    Every step moves one of the two vehicles, which costs ``off_pace`` more, or both by one place.
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
