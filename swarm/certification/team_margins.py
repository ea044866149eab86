"""Margins of a team's clearances at one moment, and around it; compiled.

The live monitor asks for measured positions, the certificate of stream losses for the positions
after a loss, at samples and in boxes around them. Objects and required distances are those of the
certificate (:mod:`.clearances`); the cable hangs in catenaries.
"""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from swarm.certification.bodies import Body, body_distance
from swarm.certification.cable_spans import exempt_length, exempt_lengths
from swarm.certification.limits import inside_by, sides_of
from swarm.geometry.catenary import (
    MAX_CHORD_RATIO,
    arc_start,
    max_drop_below_ends,
    offset_from,
    sample_strand,
    solve_catenary,
)
from swarm.geometry.distance import Vector, dot, point_distance, segment_distance
from swarm.geometry.sensitivity import (
    BOTH_ENDS,
    FAR_END,
    LARGEST_RATIO,
    NEAR_END,
    Sensitivity,
    chord_range,
    chord_response,
    error_of_ends,
    movement_bound,
    sensitivity_tables,
)
from swarm.geometry.solids import grown, obstacles_of, plane_beside, plane_between
from swarm.jit import inner
from swarm.planning import Plan
from swarm.signatures import Floats1, Floats2, Floats3, contiguous

Floats = npt.NDArray[np.float64]


@inner
def box_distance(
    grips: Floats,
    lengths: Floats,
    pair: tuple[int, int],
    moved: tuple[float, float],
    enough: float,
) -> float:
    """Return the distance of the axis-aligned boxes that contain two strands, metres.

    ``grips`` (n, 3) and ``lengths`` (n − 1,) are the cable's, ``pair`` the segments; the ends of
    each move by up to ``moved``. From ``enough`` on, the result is only a lower bound.
    """
    i, j = pair
    square = 0.0
    for axis in range(3):
        low = min(grips[i, axis], grips[i + 1, axis]) - moved[0]
        high = max(grips[i, axis], grips[i + 1, axis]) + moved[0]
        other_low = min(grips[j, axis], grips[j + 1, axis]) - moved[1]
        other_high = max(grips[j, axis], grips[j + 1, axis]) + moved[1]
        if axis == 2:
            if square >= enough * enough:
                return enough
            low -= max_drop_below_ends(grips[i], grips[i + 1], lengths[i], moved[0])
            other_low -= max_drop_below_ends(grips[j], grips[j + 1], lengths[j], moved[1])
        gap = max(low - other_high, other_low - high, 0.0)
        square += gap * gap
    return float(np.sqrt(square))


@inner
def body_box_distance(
    grips: Floats, lengths: Floats, pair: tuple[int, int], moved: tuple[float, float], body: Body
) -> float:
    """Return the distance of the axis-aligned boxes around a strand and a vehicle's body, metres.

    ``pair`` are the vehicle and the segment; the strand's ends and the vehicle move by up to
    ``moved``.
    """
    k, i = pair
    square, (of_ends, of_body) = 0.0, moved
    for axis in range(3):
        low = min(grips[i, axis], grips[i + 1, axis]) - of_ends
        high = max(grips[i, axis], grips[i + 1, axis]) + of_ends
        aside, above = (body.radius, body.radius) if axis < 2 else (0.0, body.grip_offset)
        if axis == 2:
            low -= max_drop_below_ends(grips[i], grips[i + 1], lengths[i], of_ends)
        beside = low - grips[k, axis] - above, grips[k, axis] - aside - high
        gap = max(beside[0] - of_body, beside[1] - of_body, 0.0)
        square += gap * gap
    return float(np.sqrt(square))


VEHICLES, CEILING, FENCE, CHORDS, STRANDS, NEIGHBOURS, BODIES, DISCS, FLOOR, OBSTACLES = range(10)
"""Kinds of clearances: places in arrays of margins, which the rows of the table name."""
PLACES = OBSTACLES + 1
"""Number of places."""

_PIECES, _BLOCK = 16, 4
"""Pieces of a sampled strand, a power of two (20 cm of a strand of 3 m), and how many are left out
together where they are far away."""


class Required(NamedTuple):
    """Required distances of a plan, metres.

    ``horizontal``, ``vertical``: of vehicles, one of both. ``ceiling``: the greatest height of grip
    points. ``sides`` (m, 2, 3): those of the fence, none without; ``radius`` and ``thin`` what
    vehicles and cable extend to the side. ``chord`` (n − 1,): the longest chords. ``strands``: of
    the middles of strands, of neighbours outside the parts (n − 2, 2) that are ``exempt``.
    ``bodies`` and ``discs``: of the middles of strands from the bodies of other vehicles, and from
    the rotor discs of their own. ``floor``: the least height of strands' middles. ``obstacle``:
    from ``obstacles`` (m, 12), which are also ``grown`` by a vehicle's body. ``lengths`` (n − 1,)
    are those of the segments; ``sensitivity`` has their response to their ends.
    """

    horizontal: float
    vertical: float
    ceiling: float
    sides: Floats3
    radius: float
    thin: float
    chord: Floats1
    strands: float
    exempt: Floats2
    bodies: float
    discs: float
    body: Body
    floor: float
    obstacle: float
    obstacles: Floats2
    grown: Floats2
    lengths: Floats1
    sensitivity: Sensitivity


def required_of(plan: Plan) -> Required:
    """Return the required distances of a plan."""
    mission, lengths = plan.mission, contiguous(plan.layout.lengths)
    clearance, vehicles, thin = mission.clearance, mission.vehicles, 0.5 * mission.cable.diameter
    near = exempt_lengths(lengths, exempt_length(plan))
    obstacles = obstacles_of(mission)
    fence = np.empty((0, 2)) if mission.workspace.fence is None else mission.workspace.fence
    return Required(
        horizontal=clearance.vehicle,
        vertical=clearance.downwash,
        ceiling=mission.workspace.ceiling - vehicles.grip_offset,
        sides=contiguous(sides_of(np.asarray(fence, dtype=np.float64))),
        radius=vehicles.radius,
        thin=thin,
        chord=MAX_CHORD_RATIO * lengths,
        strands=clearance.cable + mission.cable.diameter,
        exempt=contiguous(np.stack([near / lengths[:-1], near / lengths[1:]], axis=1)),
        bodies=clearance.vehicle_cable + thin,
        discs=thin,
        body=Body(vehicles.radius, vehicles.grip_offset),
        floor=clearance.floor + thin,
        obstacle=clearance.obstacle,
        obstacles=obstacles,
        grown=grown(obstacles, vehicles.radius, vehicles.grip_offset),
        lengths=lengths,
        sensitivity=sensitivity_tables(),
    )


class Team(NamedTuple):
    """Grip points (n, 3) in the middle of a box of three coordinates, and around it.

    ``slopes`` (3, n, 3) are their derivatives by the coordinates, and ``spread`` (n,) what else
    they move within the box, metres. ``frame`` (3, 3) are the slopes of a frame in which movements
    are counted, ``moved`` (n,) those in the team's own frame; ``scratch`` (3, 3) is working memory.
    """

    position: Floats2
    slopes: Floats3
    spread: Floats1
    frame: Floats2
    moved: Floats1
    scratch: Floats2


def allocate_team(n: int) -> Team:
    """Return memory for n vehicles, at rest and exactly where they are."""
    spread, moved = np.zeros((2, n))
    frame, scratch = np.zeros((2, 3, 3))
    return Team(np.zeros((n, 3)), np.zeros((3, n, 3)), spread, frame, moved, scratch)


class Strands(NamedTuple):
    """Points (n − 1, k, 3) of the strands at a moment.

    ``bow`` (n − 1, k − 1) are the largest distances of pieces from the lines between their points;
    ``known`` (n − 1, 9) are the grip points of strands, two reaches (:func:`_reach`), negative
    where they are not computed for these, and 1 where the points are. ``stray`` (n − 1,) is how far
    strands swing from their catenaries. ``part`` (k, 3) and ``off`` (2, k − 1) are memory, the
    latter for how far the pieces of two strands may be elsewhere.
    """

    points: Floats3
    bow: Floats2
    known: Floats2
    stray: Floats1
    boxes: Floats2
    part: Floats2
    off: Floats2


def allocate_strands(n: int) -> Strands:
    """Return memory for the strands of n vehicles, which hang still."""
    points, known = np.empty((n - 1, _PIECES + 1, 3)), np.full((n - 1, 9), np.nan)
    stray = np.zeros(n - 1)
    part, off = np.empty((_PIECES + 1, 3)), np.empty((2, _PIECES))
    bow, boxes = np.empty((n - 1, _PIECES)), np.empty((n - 1, 6))
    return Strands(points, bow, known, stray, boxes, part, off)


class Query(NamedTuple):
    """What is asked for: the margins of a vehicle and its segments; of all with ``who`` −1.

    ``half`` are the half widths of the box. Margins from ``enough`` metres on are not computed, and
    no more of them after one below ``smallest``.
    """

    who: int
    half: Vector
    smallest: float
    enough: float


@inner
def vehicle_margins(
    asked: Query, team: Team, required: Required, low: Floats, here: Floats
) -> None:
    """Write lower bounds of the smallest margins of vehicles (PLACES,), and margins ``here``.

    Of vehicles with each other, below the ceiling, within the fence, and beside obstacles.
    """
    for kind in range(PLACES):
        low[kind] = here[kind] = asked.enough
    position = team.position
    for i in range(len(position)):
        for j in range(i + 1, len(position)):
            if asked.who in (-1, i, j):
                x, y = position[j, 0] - position[i, 0], position[j, 1] - position[i, 1]
                z = abs(position[j, 2] - position[i, 2])
                margin = max(math.hypot(x, y) - required.horizontal, z - required.vertical)
                _lower(VEHICLES, margin, _parting(asked.half, team, i, j), low, here)
        if asked.who in (-1, i):
            _rest(team)
            moved = _movement(asked.half, team, i)
            _lower(CEILING, required.ceiling - position[i, 2], moved, low, here)
            if len(required.sides):
                inside = inside_by(position[i], position[i], required.sides, team.scratch)
                _lower(FENCE, inside - required.radius, moved, low, here)
            grip = position[i, 0], position[i, 1], position[i, 2]
            for solid in required.grown:
                apart = plane_beside(solid, grip)[1]
                _lower(OBSTACLES, apart - required.obstacle, moved, low, here)


@inner
def cable_margins(
    asked: Query, team: Team, required: Required, strands: Strands, low: Floats, here: Floats
) -> None:
    """Lower the margins (PLACES,) to those of cable aloft; only of chords where one is too long."""
    position, count, half = team.position, len(required.lengths), asked.half
    for i in range(count):
        if asked.who in (-1, i, i + 1):
            chord = point_distance(position[i], position[i + 1])
            _lower(CHORDS, required.chord[i] - chord, _parting(half, team, i, i + 1), low, here)
    if low[CHORDS] < max(asked.smallest, 0.0):
        return
    strand_margins(asked, team, required, strands, low, here)
    for i in range(count):
        if smallest(low) < asked.smallest:
            return
        own = asked.who in (-1, i, i + 1)
        if own:
            _in_workspace(i, half, team, required, strands, low, here)
        first, last = (0, count + 1) if own else (asked.who, asked.who + 1)
        for k in range(first, last):
            if min(low[BODIES], low[DISCS]) >= asked.smallest:
                if k in (i, i + 1):
                    _disc(k, i, half, team, required, strands, low, here)
                elif _near_body(
                    strands.boxes[i], team.position[k], required.body,
                    team.moved[k], low[BODIES] + required.bodies,
                ):  # fmt: skip
                    _body(k, i, half, team, required, strands, low, here)
        if i + 1 < count and (own or asked.who == i + 2):
            _neighbours(i, half, team, required, strands, low, here)


@inner
def smallest(margins: Floats) -> float:
    """Return the smallest of the margins (PLACES,)."""
    least = np.inf
    for kind in range(PLACES):
        least = min(least, margins[kind])
    return least


@inner
def strand_margins(
    asked: Query, team: Team, required: Required, strands: Strands, low: Floats, here: Floats
) -> None:
    """Lower the margins (PLACES,) to those between strands that share no vehicle."""
    count = len(required.lengths)
    _write_boxes(asked.half, team, required, strands)
    for i in range(count):
        own = asked.who in (-1, i, i + 1)
        first, last = (i + 2, count) if own else (max(i + 2, asked.who - 1), asked.who + 1)
        for j in range(first, min(last, count)):
            enough = low[STRANDS] + required.strands + strands.stray[i] + strands.stray[j]
            if _gap(strands.boxes[i], strands.boxes[j]) >= enough:
                continue
            if low[STRANDS] < asked.smallest:
                return
            _follow(asked.half, team, i, i + 1, j, j + 1)
            moved = _end_movement(asked.half, team, i), _end_movement(asked.half, team, j)
            if box_distance(team.position, required.lengths, (i, j), moved, enough) >= enough:
                continue
            points, (off, other_off) = strands.points, strands.off
            _deviations(i, BOTH_ENDS, moved[0], team, required, strands, off)
            _deviations(j, BOTH_ENDS, moved[1], team, required, strands, other_off)
            limits, every = (required.strands, _arc(i, required), _arc(j, required)), (0, _PIECES)
            parts = every, every
            _between(STRANDS, points[i], points[j], parts, limits, strands.off, low, here)


@inner
def _write_boxes(half: Vector, team: Team, required: Required, strands: Strands) -> None:
    """Write the movements of grip points in the team's frame, and the boxes around strands.

    What is known of strands whose ends are elsewhere now is forgotten.
    """
    for coordinate in range(3):
        for axis in range(3):
            team.frame[coordinate, axis] = 0.0
            if half[coordinate] > 0.0:
                for k in range(len(team.position)):
                    share = team.slopes[coordinate, k, axis] / len(team.position)
                    team.frame[coordinate, axis] += share
    for k in range(len(team.position)):
        team.moved[k] = _movement(half, team, k)
    for i in range(len(required.lengths)):
        box, start, end = strands.boxes[i], team.position[i], team.position[i + 1]
        spare = max(team.moved[i], team.moved[i + 1])
        for axis in range(3):
            box[axis] = min(start[axis], end[axis]) - spare
            box[3 + axis] = max(start[axis], end[axis]) + spare
        box[2] -= max_drop_below_ends(start, end, required.lengths[i], spare)
        same, known = True, strands.known[i]
        for axis in range(3):
            same = same and known[axis] == start[axis] and known[3 + axis] == end[axis]
            known[axis], known[3 + axis] = start[axis], end[axis]
        if not same:
            known[6] = known[7] = known[8] = -1.0


@inner
def _gap(first: Floats, second: Floats) -> float:
    """Return the distance of two boxes (6,)."""
    square = 0.0
    for axis in range(3):
        gap = max(first[axis] - second[3 + axis], second[axis] - first[3 + axis], 0.0)
        square += gap * gap
    return float(np.sqrt(square))


@inner
def _neighbours(
    i: int, half: Vector, team: Team, required: Required, strands: Strands,
    low: Floats, here: Floats,
) -> None:  # fmt: skip
    """Lower the margins to those of two strands with a shared grip, beyond what is exempt."""
    j, points, part, (off, other_off) = i + 1, strands.points, strands.part, strands.off
    moved, other_moved = _parting(half, team, i, j), _parting(half, team, j + 1, j)
    most = _whole(i, NEAR_END, moved, team, required)
    most += _whole(j, FAR_END, other_moved, team, required)
    if _apart_in_plan(i, team, required, strands) >= low[NEIGHBOURS] + required.strands + most:
        return
    _deviations(i, NEAR_END, moved, team, required, strands, off)
    _deviations(j, FAR_END, other_moved, team, required, strands, other_off)
    limits, every = (required.strands, _arc(i, required), _arc(j, required)), (0, _PIECES)
    # the first strand up to what is exempt, and what is exempt with the rest of the second
    end, begin = 1.0 - required.exempt[i, 0], required.exempt[i, 1]
    last, first = int(np.ceil(end * _PIECES)), int(begin * _PIECES)
    _write_part(points[i], 0.0, end, part)
    parts = (0, last), every
    _between(NEIGHBOURS, part, points[j], parts, limits, strands.off, low, here)
    _write_part(points[j], begin, 1.0, part)
    parts = (last - 1, _PIECES), (first, _PIECES)
    _between(NEIGHBOURS, points[i], part, parts, limits, strands.off, low, here)


@inner
def _apart_in_plan(i: int, team: Team, required: Required, strands: Strands) -> float:
    """Return a lower bound of the distance of two strands with a shared grip, in plan view.

    Beyond what is exempt. In plan view both lie straight: what is x metres from the grip is at
    least x sin α from the other, and x where the angle α is obtuse.
    """
    start, grip, end = team.position[i], team.position[i + 1], team.position[i + 2]
    x, y, u, v = start[0] - grip[0], start[1] - grip[1], end[0] - grip[0], end[1] - grip[1]
    spans = math.hypot(x, y) * math.hypot(u, v)
    if spans <= 0.0:
        return 0.0
    share = min(abs(x * v - y * u) / spans, 1.0) if x * u + y * v > 0.0 else 1.0
    near = _reach(i, 7, 1.0 - required.exempt[i, 0], team, required, strands)
    far = _reach(i + 1, 6, required.exempt[i, 1], team, required, strands)
    return share * min(math.hypot(x, y) - near, far)


@inner
def _reach(
    i: int, which: int, fraction: float, team: Team, required: Required, strands: Strands
) -> float:
    """Return how far a point of a strand is from its start in plan view; at a place in ``known``.

    The same point for the same place.
    """
    if strands.known[i, which] < 0.0:
        length = required.lengths[i]
        strand = solve_catenary(team.position[i], team.position[i + 1], length)
        turning = length / strand.parameter
        along = offset_from(arc_start(strand.slope), fraction, turning)[0]
        strands.known[i, which] = strand.parameter * along
    return float(strands.known[i, which])


@inner
def _between(
    kind: int, strand: Floats, other: Floats, parts: tuple[tuple[int, int], tuple[int, int]],
    limits: tuple[float, float, float], off: Floats, low: Floats, here: Floats,
) -> None:  # fmt: skip
    """Lower the margins of a kind to those of two strands, each from one piece to before another.

    ``limits`` are the required distance and the arcs of their pieces, which may be elsewhere by the
    rows of ``off``.
    """
    (apart, arc, other_arc), (part, other_part) = limits, parts
    for p in range(part[0], part[1], _BLOCK):
        p_end = min(p + _BLOCK, part[1])
        for q in range(other_part[0], other_part[1], _BLOCK):
            q_end = min(q + _BLOCK, other_part[1])
            # all of a block is within half of its arc of a point in its middle
            near = low[kind] + apart + 0.5 * _BLOCK * (arc + other_arc)
            near += _most(off[0], p, p_end) + _most(off[1], q, q_end)
            if point_distance(strand[(p + p_end) // 2], other[(q + q_end) // 2]) >= near:
                continue
            for k in range(p, p_end):
                for m in range(q, q_end):
                    moved = off[0, k] + off[1, m]
                    around = low[kind] + apart + moved + 0.5 * (arc + other_arc)
                    if _twice_between(strand, k, other, m) < 4.0 * around * around:
                        distance = np.sqrt(segment_distance(strand, k, other, m)[0])
                        _lower(kind, distance - apart, moved, low, here)


@inner
def _most(off: Floats, begin: int, end: int) -> float:
    """Return the largest of some numbers."""
    most = 0.0
    for k in range(begin, end):
        most = max(most, off[k])
    return most


@inner
def _twice_between(strand: Floats, k: int, other: Floats, m: int) -> float:
    """Return the square of twice the distance of the middles of two pieces."""
    square = 0.0
    for axis in range(3):
        square += (strand[k, axis] + strand[k + 1, axis] - other[m, axis] - other[m + 1, axis]) ** 2
    return float(square)


@inner
def _arc(i: int, required: Required) -> float:
    """Return the length of a piece of a strand, no less than the line between its points."""
    return float(required.lengths[i] / _PIECES)


@inner
def _write_part(points: Floats, begin: float, end: float, part: Floats) -> None:
    """Write the points of a polyline (k, 3) between two shares of it, as many as it has."""
    last = len(points) - 1
    for k in range(last + 1):
        at = min(max(k / last, begin), end) * last
        piece = min(int(at), last - 1)
        for axis in range(3):
            step = points[piece + 1, axis] - points[piece, axis]
            part[k, axis] = points[piece, axis] + (at - piece) * step


@inner
def _body(
    k: int, i: int, half: Vector, team: Team, required: Required, strands: Strands,
    low: Floats, here: Floats,
) -> None:  # fmt: skip
    """Lower the margins to that of a vehicle's body and a strand that it does not hold."""
    _follow(half, team, k, k, i, i + 1)
    of_body, of_ends = _movement(half, team, k), _end_movement(half, team, i)
    moved = of_ends, of_body
    apart = body_box_distance(team.position, required.lengths, (k, i), moved, required.body)
    if apart < low[BODIES] + required.bodies:
        _deviations(i, BOTH_ENDS, of_ends, team, required, strands, strands.off[0])
        limits = required.bodies, of_body, 0.0
        _from_body(BODIES, (k, i), limits, team, required, strands, low, here)


@inner
def _near_body(near: Floats, grip: Floats, body: Body, spare: float, enough: float) -> bool:
    """Return whether a body that moves by ``spare`` comes nearer than ``enough`` to a box (6,)."""
    square = 0.0
    for axis in range(3):
        aside, above = (0.0, body.grip_offset) if axis == 2 else (body.radius, body.radius)
        gap = max(near[axis] - grip[axis] - above, grip[axis] - aside - near[3 + axis]) - spare
        square += max(gap, 0.0) ** 2
    return not square >= enough * enough


@inner
def _disc(
    k: int, i: int, half: Vector, team: Team, required: Required, strands: Strands,
    low: Floats, here: Floats,
) -> None:  # fmt: skip
    """Lower the margins to that of a vehicle's rotor disc and a strand that it holds."""
    offset, radius = required.body.grip_offset, required.body.radius
    other, ends = (i + 1, FAR_END) if k == i else (i, NEAR_END)
    moved, step = _parting(half, team, other, k), _from(team.position[k], team.position[other])
    # a strand hangs below its chord, the rim of the disc is above it
    span, rise = math.hypot(step[0], step[1]), max(step[2], 0.0)
    below = (offset * span - rise * radius) / max(math.hypot(span, rise), 1e-12)
    if below < low[DISCS] + required.discs + _whole(i, ends, moved, team, required):
        _deviations(i, ends, moved, team, required, strands, strands.off[0])
        limits = required.discs, 0.0, offset
        _from_body(DISCS, (k, i), limits, team, required, strands, low, here)


@inner
def _from_body(
    kind: int, pair: tuple[int, int], limits: tuple[float, float, float], team: Team,
    required: Required, strands: Strands, low: Floats, here: Floats,
) -> None:  # fmt: skip
    """Lower the margins of a kind to that of a vehicle and a strand.

    ``limits`` are the required distance, how far the vehicle may move, and the height of its lowest
    point over its grip; the first row of ``strands.off`` says how far the strand's pieces may.
    """
    (apart, moved, tip), (k, i) = limits, pair
    points, grip, body = strands.points[i], team.position[k], required.body
    reach, arc = math.hypot(body.radius, body.grip_offset - tip), _arc(i, required)
    for p in range(_PIECES):
        off = moved + strands.off[0, p]
        enough = low[kind] + apart + off
        near, far = _from(grip, points[p]), _from(grip, points[p + 1])
        x, y, z = near[0] + far[0], near[1] + far[1], near[2] + far[2] - 2.0 * tip
        around = 2.0 * (enough + reach) + arc
        # twice the distance of the piece's middle, and the radii of spheres around both
        if x * x + y * y + z * z < around * around:
            least, most = body_distance(near, far, body, tip, enough)
            low[kind] = min(low[kind], least - apart - off)
            here[kind] = min(here[kind], most - apart)


@inner
def _above_floor(
    i: int,
    half: Vector,
    team: Team,
    required: Required,
    strands: Strands,
    low: Floats,
    here: Floats,
) -> None:
    """Lower the margins to that of a strand above the floor."""
    start, end, length = team.position[i], team.position[i + 1], required.lengths[i]
    _follow(half, team, i, i, i + 1, i + 1)
    for coordinate in range(3):
        team.frame[coordinate, 2] = 0.0  # only a level movement changes no height
    moved = _end_movement(half, team, i)
    lowest = min(start[2], end[2])
    drop = max_drop_below_ends(start, end, length, moved)
    if lowest - moved - drop >= low[FLOOR] + required.floor:
        return
    off = strands.off[0]
    _deviations(i, BOTH_ENDS, moved, team, required, strands, off)
    for p in range(_PIECES):
        lowest = min(strands.points[i, p, 2], strands.points[i, p + 1, 2])
        _lower(FLOOR, lowest - required.floor, off[p], low, here)


@inner
def _in_workspace(
    i: int, half: Vector, team: Team, required: Required, strands: Strands,
    low: Floats, here: Floats,
) -> None:  # fmt: skip
    """Lower the margins to those of a strand above the floor, in the fence, beside obstacles."""
    _above_floor(i, half, team, required, strands, low, here)
    if len(required.sides):
        start, end = team.position[i], team.position[i + 1]
        inside = inside_by(start, end, required.sides, team.scratch)
        _rest(team)
        moved = _end_movement(half, team, i)
        _lower(FENCE, inside - required.thin, moved, low, here)
    for solid in required.obstacles:
        _beside_obstacle(i, solid, half, team, required, strands, low, here)


@inner
def _beside_obstacle(
    i: int, solid: Floats, half: Vector, team: Team, required: Required, strands: Strands,
    low: Floats, here: Floats,
) -> None:  # fmt: skip
    """Lower the margins to that of a strand beside a convex solid."""
    _rest(team)
    moved, apart = _end_movement(half, team, i), required.obstacle + required.thin
    start, end, points = team.position[i], team.position[i + 1], strands.points[i]
    middle = 0.5 * (start[0] + end[0]), 0.5 * (start[1] + end[1]), 0.5 * (start[2] + end[2])
    # All of a strand is within half of its length of the middle between its ends.
    reach = 0.5 * required.lengths[i] + moved + strands.stray[i]
    if plane_beside(solid, middle)[1] - reach >= low[OBSTACLES] + apart:
        return
    _deviations(i, BOTH_ENDS, moved, team, required, strands, strands.off[0])
    for p in range(_PIECES):
        near = points[p, 0], points[p, 1], points[p, 2]
        far = points[p + 1, 0], points[p + 1, 1], points[p + 1, 2]
        _, normal, wall = plane_between(solid, near, far)
        beside = min(dot(normal, near), dot(normal, far)) - wall
        _lower(OBSTACLES, beside - apart, strands.off[0, p], low, here)


@inner
def _whole(i: int, ends: int, moved: float, team: Team, required: Required) -> float:
    """Return how far a strand moves at most when its ends do; infinite where that has no bound."""
    if moved <= 0.0:
        return 0.0
    start, end, length = team.position[i], team.position[i + 1], required.lengths[i]
    rise, span = end[2] - start[2], math.hypot(end[0] - start[0], end[1] - start[1])
    errors = error_of_ends(ends, moved)
    if math.hypot(span, rise) + errors.relative >= LARGEST_RATIO * length:
        return np.inf
    across, up = chord_response(rise, span, length, errors, 1, required.sensitivity)
    return math.hypot(across, up) * moved


@inner
def _deviations(
    i: int, ends: int, moved: float, team: Team, required: Required, strands: Strands, off: Floats
) -> None:
    """Write how far the pieces (k,) of a strand may be from their lines when its ends move.

    By their bow, their swing and their ends; infinite where the chord may be too long for bounds.
    Where both ends move, all pieces count as what moves farthest.
    """
    _sample(i, team, required, strands)
    whole = _whole(i, ends, moved, team, required)
    apart = moved > 0.0 and ends != BOTH_ENDS and whole < np.inf
    start, end, length = team.position[i], team.position[i + 1], required.lengths[i]
    rise, span = end[2] - start[2], math.hypot(end[0] - start[0], end[1] - start[1])
    steep, ratios = chord_range(rise, span, length, moved)
    for p in range(_PIECES):
        off[p] = whole
        if apart:
            bounds = movement_bound(required.sensitivity, steep, ends, _PIECES + p, ratios)
            off[p] = math.hypot(bounds[0], bounds[1]) * moved
        off[p] += strands.bow[i, p] + strands.stray[i]


@inner
def _sample(i: int, team: Team, required: Required, strands: Strands) -> None:
    """Write a strand's points, and the bows of its pieces, once."""
    if strands.known[i, 8] > 0.0:
        return
    strands.known[i, 8] = 1.0
    start, end, points = team.position[i], team.position[i + 1], strands.points[i]
    length = max(required.lengths[i], point_distance(start, end) / LARGEST_RATIO)
    sample_strand(start, end, length, points)
    arc = length / _PIECES
    for p in range(_PIECES):
        line = point_distance(points[p], points[p + 1])
        strands.bow[i, p] = 0.5 * np.sqrt(max(arc * arc - line * line, 0.0))


@inner
def _lower(kind: int, margin: float, moved: float, low: Floats, here: Floats) -> None:
    """Lower the margins of a kind to one, less how far objects may move."""
    low[kind] = min(low[kind], margin - moved)
    here[kind] = min(here[kind], margin)


@inner
def _rest(team: Team) -> None:
    """Count movements in a frame at rest."""
    for coordinate in range(3):
        for axis in range(3):
            team.frame[coordinate, axis] = 0.0


@inner
def _follow(half: Vector, team: Team, a: int, b: int, c: int, d: int) -> None:
    """Count movements in a frame that moves as four grip points do in the mean."""
    for coordinate in range(3):
        if half[coordinate] > 0.0:
            slopes = team.slopes[coordinate]
            for axis in range(3):
                total = slopes[a, axis] + slopes[b, axis] + slopes[c, axis] + slopes[d, axis]
                team.frame[coordinate, axis] = 0.25 * total


@inner
def _parting(half: Vector, team: Team, i: int, j: int) -> float:
    """Largest movement of one grip point relative to another."""
    total = team.spread[i] + team.spread[j]
    for coordinate in range(3):
        if half[coordinate] > 0.0:
            slopes = team.slopes[coordinate]
            total += point_distance(slopes[i], slopes[j]) * half[coordinate]
    return float(total)


@inner
def _end_movement(half: Vector, team: Team, i: int) -> float:
    """Largest movement of an end of a strand in the frame."""
    return max(_movement(half, team, i), _movement(half, team, i + 1))


@inner
def _movement(half: Vector, team: Team, k: int) -> float:
    """Largest movement of a grip point in the frame."""
    total = team.spread[k]
    for coordinate in range(3):
        if half[coordinate] > 0.0:
            apart = point_distance(team.slopes[coordinate, k], team.frame[coordinate])
            total += apart * half[coordinate]
    return float(total)


@inner
def _from(start: Floats, end: Floats) -> Vector:
    """Return the vector from a point to another, each (3,)."""
    return end[0] - start[0], end[1] - start[1], end[2] - start[2]
