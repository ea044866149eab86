"""Certified bounds of the distances of vehicles: from each other, and from the cable.

A vehicle is modelled as a cone: the rotor disc at the height of the vehicle's centre, and the hull
of the disc and the grip point straight below. Other segments keep their distance from the cone; its
own segments, which begin at the tip, keep out of the disc.
"""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from swarm.certification.branch_and_bound import (
    BoxArrays,
    Boxes,
    Enclosure,
    EnclosureArrays,
    Evaluator,
    same_in,
)
from swarm.certification.motion_bounds import (
    BoundedMotion,
    Grip,
    Instant,
    TeamStates,
    ends_at,
    grip_at,
    instant_at,
    over_time,
)
from swarm.certification.strand_pieces import (
    CableTables,
    Displacement,
    Gravity,
    HeldCable,
    HeldStrand,
    Part,
    Piece,
    apart_moving,
    gravity_in,
    held_piece,
    held_strand,
    is_bounded,
    largest_lean,
    largest_movement,
    no_movement,
    piece_movement,
    point_movement,
    write_unbounded,
)
from swarm.geometry.distance import Vector, difference, dot, moved, size, unit
from swarm.geometry.sensitivity import BOTH_ENDS, FAR_END, NEAR_END
from swarm.jit import compiled, inner
from swarm.signatures import Floats1, Floats2, Floats3, Ints2, contiguous

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.intp]

_PROJECTIONS = 6
"""Alternating projections between chord and body. Any direction gives a true bound; more
projections sharpen it, and the search halves boxes where it is not sharp enough."""

_CLOSE, _MOST_PROJECTIONS = 1e-3, 50
"""Metres between both bounds of a single distance, and projections for it at most."""


class Body(NamedTuple):
    """The cone below a rotor disc, its tip at the origin; metres."""

    radius: float
    grip_offset: float

    def closest(self, chord: Floats, tip: Floats) -> tuple[Floats, Floats]:
        """Return nearly closest points of chords (b, 2, 3) and of the body, by projections.

        ``tip`` (b,) is the height of the body's lowest point: 0, or the grip offset for the disc
        alone. Returns the chords' points and the body's points, each (b, 3).
        """
        points = np.empty((len(chord), 2, 3))
        _write_closest(contiguous(chord), contiguous(tip), self, points)
        return points[:, 0], points[:, 1]

    def projected(self, point: Floats, tip: Floats) -> Floats:
        """Return the points (b, 3) of the bodies that are closest to the given points (b, 3)."""
        points = np.empty((len(point), 3))
        _write_projected(contiguous(point), contiguous(tip), self, points)
        return points


class _Kept(NamedTuple):
    """Pairs (q, 2) of a vehicle and a segment, their required distances, and the diameter."""

    pairs: Ints2
    required: Floats1
    diameter: float


def vehicles_apart(
    motion: BoundedMotion, pairs: Ints, tracking: float, horizontal: float, vertical: float
) -> Evaluator:
    """Bound the distances of vehicles, less ``horizontal`` or less ``vertical``: the larger counts.

    ``pairs`` (q, 2) of vehicles; ``tracking`` displaces both.
    """

    def margin(team: TeamStates, instant: Ints, group: Ints) -> tuple[Floats, Floats, Floats]:
        first, second = pairs[group].T
        place, other = team.position[instant, first], team.position[instant, second]
        step = other - place
        approach = team.drift(instant, first, team.velocity[instant, second])
        approach += team.deviation[instant, second]
        high = np.maximum(
            np.hypot(step[:, 0], step[:, 1]) - horizontal, np.abs(step[:, 2]) - vertical
        )
        return high - 2.0 * tracking, approach, 0.5 * (other + place)

    return over_time(motion, margin)


def vehicles_and_strands(
    cable: HeldCable, pairs: Ints, body: Body, diameter: float, required: float
) -> Evaluator:
    """Bound the distances of vehicles and strands: from the cone, or for own segments the disc.

    ``pairs`` (q, 2) of a vehicle and a segment; ``required`` is the required distance of the
    strand's surface from the vehicle. Coordinates are time, in wind tilt, and a fraction.
    """
    kept = _Kept(contiguous(pairs), np.full(len(pairs), required), diameter)

    def evaluate(boxes: Boxes) -> Enclosure:
        bounds = Enclosure.not_found(boxes)
        _write_margins(cable.tables, kept, body, boxes.arrays(), bounds.arrays())
        return bounds

    return evaluate


@compiled
def _write_margins(
    cable: CableTables, kept: _Kept, body: Body, boxes: BoxArrays, bounds: EnclosureArrays
) -> None:
    """Write the margins of vehicles and pieces of strands in boxes."""
    known, k = -1, boxes.middle.shape[1] - 1
    for b in range(len(boxes.group)):
        middle, half = boxes.middle[b], boxes.half[b]
        if known < 0 or not same_in(boxes, known, b, k):
            known, instant = b, instant_at(cable.motion, middle[0], half[0])
            gravity = gravity_in(cable, middle, half)
            if is_bounded(gravity):
                grip, held = _held(cable, kept.pairs[boxes.group[b]], instant, gravity)
        if not is_bounded(gravity):
            write_unbounded(gravity, b, bounds)
            continue
        piece = held_piece(cable, held, instant, Part(middle[k], half[k], 0.0, 1.0))
        limits = 0.5 * kept.diameter, kept.required[boxes.group[b]], boxes.enough
        _write_margin(cable, piece, (grip, body), limits, gravity, b, bounds)


@inner
def _held(
    cable: CableTables, pair: Ints, instant: Instant, gravity: Gravity
) -> tuple[Grip, HeldStrand]:
    """Return a vehicle's grip point and a strand, by their numbers (2,), at an instant."""
    vehicle, segment = pair
    grip, ends = grip_at(cable.motion, instant, vehicle), BOTH_ENDS
    if segment == vehicle:
        ends = FAR_END
    elif segment == vehicle - 1:
        ends = NEAR_END
    tracking = cable.tracking if ends == BOTH_ENDS else 2.0 * cable.tracking
    displacement = Displacement(grip.velocity, ends, tracking, grip.deviation)
    grips = ends_at(cable.motion, instant, segment)
    return grip, held_strand(cable, segment, grips, instant, displacement, gravity)


@inner
def _write_margin(
    cable: CableTables,
    piece: Piece,
    vehicle: tuple[Grip, Body],
    limits: tuple[float, float, float],
    gravity: Gravity,
    b: int,
    bounds: EnclosureArrays,
) -> None:
    """Write the margin of a vehicle and a piece of a strand.

    ``limits`` are two distances whose sum is required, and the margin that is enough.
    """
    radius, required, enough = limits
    (grip, body), own = vehicle, piece.end_motion.ends != BOTH_ENDS
    tip = body.grip_offset if own else 0.0
    near, far = difference(piece.near, grip.place), difference(piece.far, grip.place)
    along, at_strand, at_body = _closest(near, far, body, tip)
    apart = difference(at_strand, at_body)
    normal = unit(apart)
    reach = min(dot(near, normal), dot(far, normal))
    shift = (0.0 if own else cable.tracking) + radius + required
    swing = piece.swing
    kept_apart = reach - _support(body, normal, tip) - piece.bow - shift - swing.most
    largest = largest_movement(cable, piece, normal, gravity)
    bounds.low[b] = kept_apart - largest - largest_lean(piece, gravity)
    if bounds.low[b] >= enough:
        return
    moves = piece_movement(cable, piece, normal, along, gravity, largest)
    kept = apart_moving(
        gravity, (moves, no_movement()), (dot(near, normal), dot(far, normal)), (0.0, 0.0)
    )
    drifts, east, north = kept.drift >= 0.0, kept.east, kept.north
    point, calm, by_tracking = point_movement(cable, piece, gravity, moves, drifts)
    low = (
        kept.distance - _support(body, normal, tip) - piece.bow - kept.by_ends - shift - swing.most
    )
    high = size(apart) + piece.bow - by_tracking - shift - swing.least
    in_time, rest = max(kept.drift, 0.0) + calm - by_tracking + (swing.most - swing.now), 0.0
    k = bounds.widths.shape[1] - 1
    if k > 1:
        rest = point - calm
        bounds.widths[b, 1], bounds.widths[b, 2] = east + 0.5 * rest, north + 0.5 * rest
    bounds.widths[b, 0] = in_time
    bounds.widths[b, k] = high - low - in_time - east - north - rest
    touching = -radius - required
    # Surfaces are never nearer than touching, also where an over-stretched strand is bounded poorly
    bounds.low[b], bounds.high[b] = max(low, min(high, touching)), high
    for axis in range(3):
        bounds.place[b, axis] = grip.place[axis] + at_strand[axis]


@inner
def _closest(near: Vector, far: Vector, body: Body, tip: float) -> tuple[float, Vector, Vector]:
    """Return nearly closest points of a chord and of a body, by projections.

    The fraction of the chord, the point on the chord, and that on the body.
    """
    along, at_strand, at_body = _nearer(near, far, body, tip, (0.0, 0.0, body.grip_offset))
    for _ in range(_PROJECTIONS - 1):
        along, at_strand, at_body = _nearer(near, far, body, tip, at_body)
    return along, at_strand, at_body


@inner
def _nearer(
    near: Vector, far: Vector, body: Body, tip: float, at_body: Vector
) -> tuple[float, Vector, Vector]:
    """Return the closest point of a chord to one of a body, and the body's closest to that.

    As :func:`_closest`.
    """
    (x, y, z), (east, north, up) = near, difference(far, near)
    square = east * east + north * north + up * up
    ahead = east * (at_body[0] - x) + north * (at_body[1] - y) + up * (at_body[2] - z)
    along = min(max(ahead / square, 0.0), 1.0) if square > 0.0 else 0.0
    at_strand = moved(near, along, (east, north, up))
    return along, at_strand, _project(at_strand, tip, body)


@inner
def body_distance(
    near: Vector, far: Vector, body: Body, tip: float, enough: float
) -> tuple[float, float]:
    """Return bounds of the distance of a chord from a body, from below and from above.

    They are less than a millimetre apart, or the lower one is ``enough``, or after many projections
    touching bodies are still told apart by less than that.
    """
    at_body, low, high = (0.0, 0.0, body.grip_offset), 0.0, np.inf
    for _ in range(_MOST_PROJECTIONS):
        _, at_strand, at_body = _nearer(near, far, body, tip, at_body)
        apart = difference(at_strand, at_body)
        normal, high = unit(apart), size(apart)
        low = max(low, min(dot(near, normal), dot(far, normal)) - _support(body, normal, tip))
        if low >= enough or high - low < _CLOSE:
            break
    return low, high


@inner
def _support(body: Body, normal: Vector, tip: float) -> float:
    """Return the support function of a body in a direction."""
    disc = body.radius * math.hypot(normal[0], normal[1]) + body.grip_offset * normal[2]
    return max(disc, tip * normal[2])


@compiled
def _write_closest(chord: Floats3, tip: Floats1, body: Body, points: Floats3) -> None:
    """Write the points of :func:`_closest` on chords (b, 2, 3) and on bodies (b, 2, 3)."""
    for b in range(len(points)):
        near = chord[b, 0, 0], chord[b, 0, 1], chord[b, 0, 2]
        far = chord[b, 1, 0], chord[b, 1, 1], chord[b, 1, 2]
        _, at_strand, at_body = _closest(near, far, body, tip[b])
        for axis in range(3):
            points[b, 0, axis], points[b, 1, axis] = at_strand[axis], at_body[axis]


@compiled
def _write_projected(point: Floats2, tip: Floats1, body: Body, points: Floats2) -> None:
    """Write the points (b, 3) of bodies that are closest to points (b, 3)."""
    for b in range(len(points)):
        here = point[b, 0], point[b, 1], point[b, 2]
        points[b, 0], points[b, 1], points[b, 2] = _project(here, tip[b], body)


@inner
def _project(point: Vector, tip: float, body: Body) -> Vector:
    """Return the point of a body that is closest to a point, in the plane of its axis."""
    out, up = math.hypot(point[0], point[1]), point[2]
    rise = body.grip_offset - tip
    share = out * body.radius + (up - tip) * rise
    share = min(max(share / (body.radius * body.radius + rise * rise), 0.0), 1.0)
    side_out, side_up = share * body.radius, tip + share * rise
    top_out, top_up = min(out, body.radius), body.grip_offset
    from_top = np.sqrt((out - top_out) ** 2 + (up - top_up) ** 2)
    from_side = np.sqrt((out - side_out) ** 2 + (up - side_up) ** 2)
    at_out, at_up = (top_out, top_up) if from_top <= from_side else (side_out, side_up)
    if tip <= up <= top_up and out <= body.radius and body.radius * (up - tip) >= rise * out:
        at_out, at_up = out, up
    ratio = at_out / max(out, 1e-12)
    return point[0] * ratio, point[1] * ratio, at_up


def vehicle_segments(vehicles: int) -> tuple[Ints, Ints]:
    """Return pairs (q, 2) of vehicles with others' segments, and with their own."""
    vehicle, segment = np.divmod(np.arange(vehicles * (vehicles - 1)), vehicles - 1)
    pairs = np.stack([vehicle, segment], axis=1)
    own = (segment == vehicle) | (segment == vehicle - 1)
    return pairs[~own], pairs[own]
