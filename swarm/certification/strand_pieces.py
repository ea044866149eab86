"""Pieces of strands at an instant: their chords, and bounds of their movement around it; compiled.

The movement of a piece is that of its grip points within the interval of time and the tracking
radius, multiplied by the sensitivity of the strand. It is counted in a frame that moves with the
team, since motion that all share changes no distance.

In wind the effective gravity leans, and with it all strands. A point moves by the first order,
which is exact and may cancel between two strands, and a bounded remainder. There are more
coordinates then, so the movement in time is counted in the same way, too.
"""

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from swarm.certification.branch_and_bound import EnclosureArrays
from swarm.certification.minima import Intervals
from swarm.certification.motion_bounds import BoundedMotion, Grip, Instant, MotionTables
from swarm.geometry.catenary import (
    SMALLEST_HALF_ANGLE,
    VERTICAL,
    Catenary,
    arc_start,
    max_elevation_sine,
    offset_from,
    solve,
)
from swarm.geometry.distance import Vector, cross, difference, dot, moved, size, times
from swarm.geometry.sensitivity import (
    FAR_END,
    LARGEST_RATIO,
    NEAR_END,
    EndMovement,
    PointResponse,
    Sensitivity,
    beyond_interpolation,
    curvature,
    curvature_table,
    elevation_class,
    finest_piece,
    first_order,
    movement,
    movement_bound,
    point_response,
    ratio_range,
    response_to,
    sensitivity_tables,
)
from swarm.jit import inner
from swarm.signatures import Floats1, Floats3, Floats4, contiguous

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.intp]

BIN = 0.5
"""Seconds of mission time over which the tube is constant."""

LEAVES = 8
"""Equal parts of a strand with a radius of their own."""


@dataclass(frozen=True, eq=False)
class TubeRadii:
    """Radii in metres, constant over BIN seconds from ``start``.

    ``pieces`` (k, n − 1, 16) is the radius of each dyadic piece by its heap number, in each of k
    intervals; ``_most`` (levels, k, n − 1, 16) the largest of 1, 2, 4, … intervals from each on,
    ``_least`` (k, n − 1, 16) the smallest radius of the parts of a piece.
    """

    start: float
    pieces: Floats = field(repr=False)
    _most: Floats = field(repr=False)
    _least: Floats = field(repr=False)

    @staticmethod
    def of_leaves(start: float, leaves: Floats) -> "TubeRadii":
        """Return the radii of all pieces from those (k, n − 1, 8) of the finest."""
        pieces, least = np.zeros((2, *leaves.shape[:2], 2 * LEAVES))
        pieces[:, :, LEAVES:] = least[:, :, LEAVES:] = leaves
        for number in range(LEAVES - 1, 0, -1):
            parts = slice(2 * number, 2 * number + 2)
            pieces[:, :, number] = pieces[:, :, parts].max(axis=2)
            least[:, :, number] = least[:, :, parts].min(axis=2)
        return TubeRadii(start, pieces, _range_maxima(pieces), least)

    @property
    def whole(self) -> Floats:
        """The radii (k, n − 1) of whole strands, metres."""
        return np.asarray(self.pieces[:, :, 1])

    @property
    def largest(self) -> float:
        """The largest radius of all."""
        return float(self.whole.max())

    def strands(self, time: float) -> Floats:
        """Return the radii (n − 1,) of whole strands at a mission time."""
        radii: Floats = self.whole[self._bins(np.array(time))]
        return radii

    @property
    def tables(self) -> "TubeTables":
        """The radii for compiled code."""
        return TubeTables(self.start, self.pieces, self._most, self._least)

    def _bins(self, time: Floats) -> Ints:
        number = np.floor((time - self.start) / BIN).astype(np.intp)
        bins: Ints = np.minimum(np.maximum(number, 0), len(self.pieces) - 1)
        return bins


class TubeTables(NamedTuple):
    """Radii as of :class:`TubeRadii`: of pieces, the ``most`` in runs of intervals, the ``least``.

    Empty where strands do not swing.
    """

    start: float
    pieces: Floats3
    most: Floats4
    least: Floats3

    @staticmethod
    def none() -> "TubeTables":
        """Return the tables of strands that do not swing."""
        return TubeTables(0.0, np.empty((0, 0, 0)), np.empty((0, 0, 0, 0)), np.empty((0, 0, 0)))


class Radii(NamedTuple):
    """Radii of a piece: the ``most`` in an interval of time, that ``now`` at its middle.

    ``least`` is the smallest of the parts of the piece at the middle.
    """

    most: float
    now: float
    least: float


@inner
def radii_over(tube: TubeTables, segment: int, number: int, interval: tuple[float, float]) -> Radii:
    """Return bounds of the radii of a piece with a heap number, in an interval of time.

    ``interval`` is its middle and its half width, seconds.
    """
    if len(tube.pieces) == 0:
        return Radii(0.0, 0.0, 0.0)
    time, half = interval
    first, last = _bin(tube, time - half), _bin(tube, time + half)
    level, count = 0, 1
    while 2 * count <= last - first + 1:
        level, count = level + 1, 2 * count
    while number >= 2 * LEAVES:
        number //= 2
    most = max(
        tube.most[level, first, segment, number],
        tube.most[level, last - count + 1, segment, number],
    )
    middle = _bin(tube, time)
    return Radii(most, tube.pieces[middle, segment, number], tube.least[middle, segment, number])


@inner
def _bin(tube: TubeTables, time: float) -> int:
    """Return the interval of the tube in which a time lies; the nearest one outside of all."""
    return min(max(int(np.floor((time - tube.start) / BIN)), 0), len(tube.pieces) - 1)


def _range_maxima(values: Floats) -> Floats:
    """Return the maxima over 1, 2, 4, … entries from each one on, padded with the last."""
    maxima, size = [values], 1
    while 2 * size <= len(values):
        before = maxima[-1]
        shifted = np.concatenate([before[size:], np.repeat(before[-1:], size, axis=0)])
        maxima.append(np.maximum(before, shifted))
        size *= 2
    return np.stack(maxima)


class CableTables(NamedTuple):
    """A :class:`HeldCable` for compiled code, with the tables of what strands do."""

    motion: MotionTables
    lengths: Floats1
    tracking: float
    tilt: float
    tube: TubeTables
    curvature: Floats3
    sensitivity: Sensitivity


@dataclass(frozen=True, eq=False)
class HeldCable:
    """A cable held by a moving team: n grip points and n − 1 segments.

    ``lengths`` (n − 1,) of the segments, metres; ``tracking`` the tracking radius around every
    setpoint, metres; ``tilt`` the largest tilt of the effective gravity, of any heading, the same
    for all segments (:func:`.air.wind_tilt`); ``tube`` bounds how far the cable swings from its
    catenaries (None: it is quasi-static).
    """

    motion: BoundedMotion
    lengths: Floats
    tracking: float
    tilt: float = 0.0
    tube: TubeRadii | None = None

    @property
    def tilts(self) -> Intervals:
        """Intervals of both parts of the tilt, east and north; none in still air."""
        return ((-self.tilt, self.tilt),) * 2 if self.tilt > 0.0 else ()

    @cached_property
    def tables(self) -> CableTables:
        """The cable for compiled code."""
        return CableTables(
            self.motion.tables,
            contiguous(self.lengths),
            self.tracking,
            self.tilt,
            TubeTables.none() if self.tube is None else self.tube.tables,
            curvature_table(),
            sensitivity_tables(),
        )


class Gravity(NamedTuple):
    """Effective gravities in a box, shared by all strands: one, and how far others lean from it.

    ``down`` is the unit vector of the one. ``angle`` bounds the angle between it and another,
    radians; ``east`` and ``north`` the parts of the tilt's change, for :func:`lean`. The angle is
    −1 where there is no gravity at all.
    """

    down: Vector
    angle: float
    east: float
    north: float


@inner
def gravity_in(cable: CableTables, middle: Floats, half: Floats) -> Gravity:
    """Return the gravities in a box, whose coordinates begin with time and both parts of the tilt.

    The tilt is the horizontal part over the vertical one, and lies in a disc. With v = (tilt, −1),
    before and after a change Δ of the tilt, v × v' = v × Δ: so sin angle ≤ |Δ| / |v'|, and
    θ·g = (angle / sin angle) (g × v/|v|)·Δ/|v'|.
    """
    if cable.tilt == 0.0:
        return Gravity((0.0, 0.0, -1.0), 0.0, 0.0, 0.0)
    west, east = middle[1] - half[1], middle[1] + half[1]
    south, north = middle[2] - half[2], middle[2] + half[2]
    aside, ahead = max(west, -east, 0.0), max(south, -north, 0.0)
    least = aside * aside + ahead * ahead
    square = cable.tilt * cable.tilt
    if least >= square:
        return Gravity((0.0, 0.0, -1.0), -1.0, 0.0, 0.0)
    reach, reach_ahead = math.sqrt(square - ahead * ahead), math.sqrt(square - aside * aside)
    west, east = max(west, -reach), min(east, reach)
    south, north = max(south, -reach_ahead), min(north, reach_ahead)
    x, y = 0.5 * (west + east), 0.5 * (south + north)
    outside = max(math.hypot(x, y) / cable.tilt, 1.0)
    x, y = x / outside, y / outside
    # A hair wider than the disc, for the rounding of its border.
    hair = 1e-12 * cable.tilt
    wide, deep = max(east - x, x - west) + hair, max(north - y, y - south) + hair
    shortest = math.sqrt(1.0 + least)
    # The disc ends before the corners of its box.
    change = min(math.hypot(wide, deep), math.hypot(x, y) + cable.tilt + hair)
    sine = change / shortest
    length = math.sqrt(1.0 + x * x + y * y)
    down = x / length, y / length, -1.0 / length
    if sine >= 1.0:
        return Gravity(down, np.inf, np.inf, np.inf)
    angle = math.asin(sine)
    per_tilt = angle / sine / shortest
    return Gravity(down, angle, per_tilt * wide, per_tilt * deep)


class Part(NamedTuple):
    """A dyadic interval of fractions of a strand, of which only that from ``low`` to ``high``
    counts."""

    middle: float
    half: float
    low: float
    high: float


@inner
def counted(part: Part) -> tuple[float, float]:
    """Return the interval of fractions that counts; its end is not above its begin if none does."""
    return (
        min(max(part.middle - part.half, part.low), part.high),
        min(max(part.middle + part.half, part.low), part.high),
    )


class Displacement(NamedTuple):
    """Displacement of the grip points of a piece, in a frame with velocity ``frame``.

    ``ends`` tells which ends move (BOTH_ENDS, FAR_END, NEAR_END); ``tracking`` is the displacement
    by tracking errors, metres; ``deviation`` that of the frame itself from uniform motion.
    """

    frame: Vector
    ends: int
    tracking: float
    deviation: float


class Strand(NamedTuple):
    """A hanging strand: its start, the horizontal unit vector to its end, and its catenary.

    Horizontal is across ``down``, its gravity. ``arc`` is :func:`.catenary.arc_start` of its
    slope.
    """

    start: Vector
    down: Vector
    heading: Vector
    catenary: Catenary
    arc: tuple[float, float, float]


class _EndMotion(NamedTuple):
    """Bounds of the movement of grip points, metres.

    ``total`` within interval and tracking radius, ``tracking`` within the tracking radius alone;
    ``longer`` and ``longer_tracking`` of the ends relative to each other, and ``relative`` with
    their turn in other gravities, which leaves the chord as long as it is. ``ends`` tells which
    ends move. ``drifts`` is how far start and end move with their velocities at the middle instant,
    in half of the interval, and ``beside`` bounds their movement beside that.
    """

    ends: int
    drifts: tuple[Vector, Vector]
    beside: float
    total: float
    tracking: float
    longer: float
    longer_tracking: float
    relative: float


class HeldStrand(NamedTuple):
    """The strand of a ``segment`` at an instant, with the movement of its grip points."""

    segment: int
    strand: Strand
    end_motion: _EndMotion


class Piece(NamedTuple):
    """A piece of a strand, from ``begin`` to ``end``, at the middle instant.

    ``near`` and ``far`` are the ends of its chord; ``bow`` is the largest distance of the piece
    from its chord; ``swing`` the radii of the tube around it; ``number`` its heap number.
    """

    strand: Strand
    begin: float
    end: float
    number: int
    near: Vector
    far: Vector
    bow: float
    end_motion: _EndMotion
    swing: Radii


class Movement(NamedTuple):
    """Bounds of the movement of a piece along a normal.

    ``piece`` by its ends; ``linear`` that of one point by its linear response, with ``at_point`` in
    first order and ``bent`` beyond it. The point is at a ``fraction`` of the strand, and ``up`` is
    the part of the normal against the gravity. ``drifting`` is another bound of that by the ends,
    and ``leaning`` the movement by other gravities; both only of several gravities.
    """

    piece: float
    linear: float
    at_point: float
    bent: float
    fraction: float
    up: float
    drifting: "Drifting"
    leaning: "Leaning"


class Drifting(NamedTuple):
    """The movement of a piece along a normal while its ends move with their velocities.

    In first order, in half of the interval: of the point and of both ends of the piece. It may
    cancel with that of another strand; between the ends it is linear. ``beside`` bounds all other
    movement of the piece by its ends, and ``beyond`` what the point's drift is beyond first order.
    """

    at_point: float
    at_begin: float
    at_end: float
    beside: float
    beyond: float


class Leaning(NamedTuple):
    """Bounds of the movement along a normal by other gravities.

    Of any point of a piece either ``most``; or the product of its moment and the turn, which may
    cancel with that of another strand, and ``beyond`` it. Moments are those of the point of the
    first order and of both ends; between the ends the sum of place and product is at most
    ``bowed`` from its linear interpolation, apart from the bow of the piece.
    """

    most: float
    beyond: float
    bowed: float
    moment: Vector
    at_begin: Vector
    at_end: Vector


@inner
def strand_between(
    cable: CableTables, segment: int, ends: tuple[Vector, Vector], down: Vector
) -> Strand:
    """Return the strand of a segment between two points, in a gravity.

    Over-stretched segments are drawn with a length that reaches: the taut check refuses them.
    """
    start, end = ends
    across = difference(end, start)
    length = max(cable.lengths[segment], size(across) / LARGEST_RATIO)
    rise = -dot(across, down)
    level = moved(across, rise, down)
    span = math.sqrt(dot(level, level))
    wide = max(span, VERTICAL * length)
    _, parameter, slope = solve(wide, rise, length, SMALLEST_HALF_ANGLE)
    heading = level[0] / wide, level[1] / wide, level[2] / wide
    catenary = Catenary(length, parameter, slope, span, rise)
    return Strand(start, down, heading, catenary, arc_start(slope))


@inner
def strand_point(strand: Strand, fraction: float) -> Vector:
    """Return the point of a strand at a fraction of its arc."""
    catenary, heading, down = strand.catenary, strand.heading, strand.down
    turning = catenary.length / catenary.parameter
    angle, height = offset_from(strand.arc, fraction, turning)
    a, length = catenary.parameter, -catenary.length
    ahead = a * heading[0], a * heading[1], a * heading[2]
    up = length * down[0], length * down[1], length * down[2]
    return moved(moved(strand.start, angle, ahead), height, up)


@inner
def held_strand(
    cable: CableTables,
    segment: int,
    grips: tuple[Grip, Grip],
    instant: Instant,
    displacement: Displacement,
    gravity: Gravity,
) -> HeldStrand:
    """Return the strand of a segment with bounds of the movement of its grip points."""
    strand = strand_between(cable, segment, (grips[0].place, grips[1].place), gravity.down)
    turned = gravity.angle * math.hypot(strand.catenary.span, strand.catenary.rise)
    motion = _end_motion(grips, instant.half, displacement, (2.0 * cable.tracking, turned))
    return HeldStrand(segment, strand, motion)


@inner
def held_piece(cable: CableTables, held: HeldStrand, instant: Instant, part: Part) -> Piece:
    """Return a piece of a strand."""
    strand = held.strand
    begin, end = counted(part)
    near, far = strand_point(strand, begin), strand_point(strand, end)
    across, arc = size(difference(far, near)), strand.catenary.length * (end - begin)
    number = int(np.rint((1.0 + part.middle - part.half) / (2.0 * part.half)))
    return Piece(
        strand,
        begin,
        end,
        number,
        near,
        far,
        0.5 * math.sqrt(max(arc * arc - across * across, 0.0)),
        held.end_motion,
        radii_over(cable.tube, held.segment, number, (instant.time, instant.half)),
    )


@inner
def _end_motion(
    grips: tuple[Grip, Grip],
    half: float,
    displacement: Displacement,
    by: tuple[float, float],
) -> _EndMotion:
    """Return the movement of both grip points.

    ``by`` is that relative to each other by tracking errors and by a turn, metres.
    """
    (ball, turned), (first, last) = by, grips
    ends, frame = displacement.ends, displacement.frame
    velocities = difference(first.velocity, frame), difference(last.velocity, frame)
    total = beside = 0.0
    if ends != FAR_END:
        total, beside = size(velocities[0]) * half + first.deviation, first.deviation
    if ends != NEAR_END:
        total = max(total, size(velocities[1]) * half + last.deviation)
        beside = max(beside, last.deviation)
    apart = size(difference(last.velocity, first.velocity))
    longer = apart * half + first.deviation + last.deviation + ball
    return _EndMotion(
        ends,
        (times(half, velocities[0]), times(half, velocities[1])),
        beside + displacement.deviation + displacement.tracking,
        total + displacement.deviation + displacement.tracking,
        displacement.tracking, longer, ball, longer + turned,
    )  # fmt: skip


@inner
def piece_movement(
    cable: CableTables,
    piece: Piece,
    normal: Vector,
    along: float,
    gravity: Gravity,
    largest: float,
) -> Movement:
    """Return bounds of the movement of a piece along a unit vector.

    ``along`` is the fraction of the chord at which the point of the first order lies. Movement by
    the ends is the smaller of two: by the sensitivity of all shapes, ``largest``, and by the
    strand's own linear response, which changes with the gravity. So is that by the gravity.

    In several gravities, that by the ends has a second bound: of the ends' drift, which is exact in
    first order, and then of their movement beside it, by either of the two.
    """
    strand, motion, part = piece.strand.catenary, piece.end_motion, (piece.begin, piece.end)
    longer, total = motion.longer, motion.total
    up, fraction = -dot(normal, piece.strand.down), part[0] + along * (part[1] - part[0])
    plane = dot(normal, piece.strand.heading), up
    response = point_response(strand, plane, fraction)
    begin = point_response(strand, plane, part[0])
    end = point_response(strand, plane, part[1])
    at_point, per_arc = first_order(strand, response, part, motion.ends)
    bowed = beyond_interpolation(strand, per_arc, part)
    moving = EndMovement(motion.ends, total, motion.relative, longer)
    bent = curvature(strand, part, moving, cable.curvature)
    of_piece, linear = largest, np.inf
    drifting, leaning = Drifting(0.0, 0.0, 0.0, np.inf, np.inf), no_leaning()
    at_ends = max(response_to(begin, motion.ends), response_to(end, motion.ends), at_point)
    if np.isfinite(at_point + bent):
        linear = movement(at_point, bent, total, longer)
        if gravity.angle > 0.0:
            linear += gravity.angle * _response_per_angle(piece) * longer
        of_piece = min(of_piece, linear + (at_ends - at_point) * total + bowed * longer)
    if gravity.angle > 0.0:
        most = largest_lean(piece, gravity)
        leaning = Leaning(most, np.inf, np.inf, leaning.moment, leaning.moment, leaning.moment)
        if at_point < np.inf:
            chord = math.hypot(strand.span, strand.rise)
            leaning = Leaning(
                most,
                0.5 * gravity.angle * gravity.angle * _per_square(piece),
                gravity.angle * (piece.bow + chord * bowed),
                _moment(piece.strand, normal, response, fraction),
                _moment(piece.strand, normal, begin, part[0]),
                _moment(piece.strand, normal, end, part[1]),
            )
            relative, grown = _drift_of_chord(piece)
            moving = EndMovement(motion.ends, total, relative + motion.relative - longer, grown)
            beyond = curvature(strand, part, moving, cable.curvature)
            if beyond < np.inf:
                beyond = movement(0.0, beyond, 0.0, relative)
                beyond += gravity.angle * _response_per_angle(piece) * relative
            after = motion.beside, longer - relative, grown
            beside = _of_all_shapes(cable, piece, up, piece.number, after, gravity)
            beside += beyond + bowed * relative
            by_response = linear - at_point * total + at_ends * motion.beside + bowed * longer
            drifting = Drifting(
                _drift_along(piece, normal, response),
                _drift_along(piece, normal, begin),
                _drift_along(piece, normal, end),
                min(beside, by_response),
                beyond,
            )
    return Movement(of_piece, linear, at_point, bent, fraction, up, drifting, leaning)


@inner
def no_movement() -> Movement:
    """Return the movement of what rests."""
    no = Drifting(0.0, 0.0, 0.0, 0.0, 0.0)
    return Movement(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, no, no_leaning())


@inner
def no_leaning() -> Leaning:
    """Return the leaning in a single gravity."""
    no = 0.0, 0.0, 0.0
    return Leaning(0.0, 0.0, 0.0, no, no, no)


@inner
def _drift_of_chord(piece: Piece) -> tuple[float, float]:
    """Return how far the ends drift relative to each other, and how much that adds to the chord.

    With the chord c and the drift Δ, |c + Δ| ≤ |c| + (c·Δ + ½Δ²) / |c|.
    """
    strand, drifts = piece.strand, piece.end_motion.drifts
    drift, span, rise = difference(drifts[1], drifts[0]), strand.catenary.span, strand.catenary.rise
    along = abs(span * dot(drift, strand.heading) - rise * dot(drift, strand.down))
    relative, chord = size(drift), math.hypot(span, rise)
    return relative, min(relative, (along + 0.5 * relative * relative) / max(chord, 1e-9))


@inner
def point_movement(
    cable: CableTables, piece: Piece, gravity: Gravity, moves: Movement, drifts: bool
) -> tuple[float, float, float]:
    """Return bounds of the movement of the single point by the ends, which tell what to divide.

    In all gravities of the box, in the one alone, and there by tracking errors alone. Where it
    ``drifts``, the first two are those beside the first order of its drift.
    """
    strand, motion, part = piece.strand.catenary, piece.end_motion, (piece.begin, piece.end)
    longer, total, ball = motion.longer, motion.total, motion.longer_tracking
    still, finest = Gravity(gravity.down, 0.0, 0.0, 0.0), finest_piece(piece.number, moves.fraction)
    up, at_point, bent = moves.up, moves.at_point, moves.bent
    by, beyond, after = total, 0.0, (total, longer, 0.0)
    if drifts:
        relative, grown = _drift_of_chord(piece)
        by, beyond = motion.beside, moves.drifting.beyond
        after = by, longer - relative, grown
    calm = beyond + _of_all_shapes(cable, piece, up, finest, after, still)
    by_tracking = _of_all_shapes(cable, piece, up, finest, (motion.tracking, ball, 0.0), still)
    if gravity.angle > 0.0:
        moving = EndMovement(motion.ends, total, longer, longer)
        bent = curvature(strand, part, moving, cable.curvature)
    if np.isfinite(at_point + bent):
        calm = min(calm, movement(at_point, bent, by, longer))
        by_tracking = min(by_tracking, movement(at_point, bent, motion.tracking, ball))
    if gravity.angle == 0.0:
        return calm, calm, by_tracking
    point = beyond + _of_all_shapes(cable, piece, up, finest, after, gravity)
    if moves.linear < np.inf:
        point = min(point, moves.linear - at_point * (total - by))
    # More than the angle can cause is due to time: ends that move little stay in their tables.
    most = 2.0 * gravity.angle * (by + _response_per_angle(piece) * longer)
    return point, max(calm, point - most), by_tracking


class Apart(NamedTuple):
    """Distance of two pieces along a normal, but for their bows, less what their ends move them.

    ``distance`` counts tilts and, where they count, drifts; all other movement ``by_ends`` has to
    be subtracted. Parts by which it is less than that of the chords: by the ``drift``, −1 where the
    movement by the ends counts as a whole, both parts of the tilt, and the ``size`` of the pieces.
    """

    distance: float
    by_ends: float
    drift: float
    east: float
    north: float
    size: float


@inner
def apart_moving(
    gravity: Gravity,
    pieces: tuple[Movement, Movement],
    ends: tuple[float, float],
    other_ends: tuple[float, float],
) -> Apart:
    """Return how far two pieces that move and lean are apart along a normal at least.

    ``ends`` and ``other_ends`` are the places along it of both ends of each chord. Place, drift and
    lean of a point are nearly linear between the ends of its piece, so their sum is least at ends.
    """
    (moves, other_moves), whole = pieces, gravity.east + gravity.north
    (drifts, other_drifts), (lean, other_lean) = (
        (moves.drifting, other_moves.drifting), (moves.leaning, other_moves.leaning),
    )  # fmt: skip
    chords = min(ends[0], ends[1]) - max(other_ends[0], other_ends[1])
    by_ends, most = moves.piece + other_moves.piece, lean.most + other_lean.most
    beyond = lean.beyond + other_lean.beyond
    if not beyond < np.inf or whole == 0.0:
        share = gravity.east / whole if whole > 0.0 else 0.0
        return Apart(chords - most, by_ends, -1.0, most * share, most * (1.0 - share), 0.0)
    leaning = drifting = both = np.inf
    for k in range(2):
        moment = lean.at_begin if k == 0 else lean.at_end
        here = drifts.at_begin if k == 0 else drifts.at_end
        for m in range(2):
            opposed = other_lean.at_begin if m == 0 else other_lean.at_end
            along = abs(here - (other_drifts.at_begin if m == 0 else other_drifts.at_end))
            by_east, by_north = _leaned(gravity, difference(moment, opposed))
            leaning = min(leaning, ends[k] - other_ends[m] - by_east - by_north)
            drifting = min(drifting, ends[k] - other_ends[m] - along)
            both = min(both, ends[k] - other_ends[m] - by_east - by_north - along)
    bowed, drift = beyond + lean.bowed + other_lean.bowed, -1.0
    leans, distance = leaning - bowed > chords - most, max(chords - most, leaning - bowed)
    beside, drifted = drifts.beside + other_drifts.beside, max(drifting - most, both - bowed)
    if drifted - beside > distance - by_ends:
        leans, distance, by_ends = both - bowed > drifting - most, drifted, beside
        drift = abs(drifts.at_point - other_drifts.at_point)
    east, north = _leaned(gravity, difference(lean.moment, other_lean.moment))
    by_tilt = east + north + beyond
    share = 1.0 if leans or by_tilt <= most else most / by_tilt
    east = share * (east + beyond * gravity.east / whole)
    north = share * (north + beyond * gravity.north / whole)
    by_size = max(chords - east - north - max(drift, 0.0) - distance, 0.0)
    return Apart(distance, by_ends, drift, east, north, by_size)


@inner
def _leaned(gravity: Gravity, moment: Vector) -> tuple[float, float]:
    """Return the largest products of a moment and a turn, by both parts of the tilt.

    A vector g has the largest product with a turn |g × down|, part by part of the tilt.
    """
    turning = cross(moment, gravity.down)
    return abs(turning[0]) * gravity.east, abs(turning[1]) * gravity.north


_PER_ANGLE, _PER_SQUARE = 1.02, (1.3, 0.68)
"""Largest changes of points per radian of the gravity, and of second order.

With ρ = chord / ℓ, b = ½√(ℓ² − chord²), the farthest that a point can be from its chord, and its
elevation ε, they are these multiples of b / cos ε and of b / cos² ε. Measured for 14 ratios to
0.995, 10 elevations and 9 directions, and enlarged by 2 to 10 %; tests search for more.
"""

_RESPONSE_PER_ANGLE = (0.45, 0.15)
"""The same of responses to ends, as multiples of 1 / cos ε."""


@inner
def _per_angle(piece: Piece) -> float:
    """Return a bound of the movement of a strand's points per radian of its gravity, metres."""
    bow, cosine = _bow_and_cosine(piece)
    strand = piece.strand.catenary
    # Near the vertical: a straight leg from either grip.
    leg = 0.5 * (strand.length + math.hypot(strand.span, strand.rise))
    return _PER_ANGLE * min(bow / max(cosine, 1e-9), leg)


@inner
def _per_square(piece: Piece) -> float:
    """Return a bound of the second derivative of points by the angle of the gravity, metres."""
    (bow, cosine), (whole, taut) = _bow_and_cosine(piece), _PER_SQUARE
    # Slack strands that are steep change less than taut ones.
    growth = min(1.0 / max(cosine, 1e-9), max(0.5 * taut * piece.strand.catenary.length / bow, 1.0))
    return whole * bow * growth / max(cosine, 1e-9)


@inner
def _response_per_angle(piece: Piece) -> float:
    """Return a bound of how much the response to one end changes per radian of the gravity."""
    strand, (bow, cosine) = piece.strand.catenary, _bow_and_cosine(piece)
    chord, (taut, slack) = math.hypot(strand.span, strand.rise), _RESPONSE_PER_ANGLE
    length = strand.length
    return (taut * 0.5 * length / bow + slack * length / chord) / max(cosine, 1e-9)


@inner
def _bow_and_cosine(piece: Piece) -> tuple[float, float]:
    """Return ½√(ℓ² − chord²), and the smallest cosine of the chord's elevation, of a strand."""
    strand = piece.strand.catenary
    square = strand.span * strand.span + strand.rise * strand.rise
    turned = piece.end_motion.relative - piece.end_motion.longer
    sine = max_elevation_sine(strand.rise, strand.span, turned)
    bow = 0.5 * math.sqrt(max(strand.length * strand.length - square, 0.0))
    return bow, math.sqrt(max(1.0 - sine * sine, 0.0))


@inner
def _moment(strand: Strand, normal: Vector, response: PointResponse, fraction: float) -> Vector:
    """Return g: a small turn of the gravity by a vector θ moves a point x by θ·g along a normal n.

    The strand turns, and its ends p and q turn back: with B the derivative of x by q, and the chord
    v = q − p, g = (x − p) × n − v × Bᵀn.
    """
    by_end = _transposed(strand, normal, response)
    chord = moved(times(-strand.catenary.rise, strand.down), strand.catenary.span, strand.heading)
    along = difference(strand_point(strand, fraction), strand.start)
    return difference(cross(along, normal), cross(chord, by_end))


@inner
def _transposed(strand: Strand, normal: Vector, response: PointResponse) -> Vector:
    """Return Bᵀn: a point moves along a normal n by its product with the movement of the end."""
    level, up, share = dot(normal, strand.heading), -dot(normal, strand.down), response.share
    by_end = moved(times(share, normal), response.ahead - share * level, strand.heading)
    return moved(by_end, share * up - response.up, strand.down)


@inner
def _drift_along(piece: Piece, normal: Vector, response: PointResponse) -> float:
    """Return how far a point moves along a normal, in first order, while both ends drift."""
    start, end = piece.end_motion.drifts
    by_end = _transposed(piece.strand, normal, response)
    return dot(normal, start) + dot(by_end, difference(end, start))


@inner
def largest_movement(cable: CableTables, piece: Piece, normal: Vector, gravity: Gravity) -> float:
    """Return a bound of a piece's movement by its ends, by the sensitivity of all shapes alone.

    It is not below that of :func:`piece_movement`, and takes a fraction of its time.
    """
    motion, up = piece.end_motion, -dot(normal, piece.strand.down)
    moved_by = motion.total, motion.longer, 0.0
    return _of_all_shapes(cable, piece, up, piece.number, moved_by, gravity)


@inner
def largest_lean(piece: Piece, gravity: Gravity) -> float:
    """Return a bound of a piece's movement by other gravities, in any direction."""
    return 0.0 if gravity.angle == 0.0 else gravity.angle * _per_angle(piece)


@inner
def kept_from_plane(
    cable: CableTables,
    piece: Piece,
    normal: Vector,
    here: float,
    gravity: Gravity,
) -> tuple[float, float, tuple[float, float, float, float]]:
    """Return bounds of how far a piece reaches along a unit vector at least, from 0, in wind.

    The lower bound of all its points, the reach about where its chord has the fraction ``here``,
    and what time, both parts of the tilt, and the piece's size add to the uncertainty.
    """
    largest, swing = largest_movement(cable, piece, normal, gravity), piece.swing
    moves = piece_movement(cable, piece, normal, here, gravity, largest)
    near, far = dot(piece.near, normal), dot(piece.far, normal)
    apart = apart_moving(gravity, (moves, no_movement()), (near, far), (0.0, 0.0))
    drifts, east, north = apart.drift >= 0.0, apart.east, apart.north
    point, calm, by_tracking = point_movement(cable, piece, gravity, moves, drifts)
    low = apart.distance - piece.bow - apart.by_ends - swing.most
    high = near + here * (far - near) + piece.bow - by_tracking - swing.least
    in_time = max(apart.drift, 0.0) + calm - by_tracking + (swing.most - swing.now)
    rest = point - calm
    size = max(high - low - in_time - east - north - rest, 0.0)
    return low, high, (in_time, east + 0.5 * rest, north + 0.5 * rest, size)


@inner
def _of_all_shapes(
    cable: CableTables,
    piece: Piece,
    up: float,
    number: int,
    moved_by: tuple[float, float, float],
    gravity: Gravity,
) -> float:
    """Return a bound of the movement of the piece with a heap number, within the given piece.

    The ends move by a size, their chord grows by another, and has grown by a third before; ``up``
    is the part of a unit vector against the effective gravity.
    """
    (by, longer, grown), strand, motion = moved_by, piece.strand.catenary, piece.end_motion
    chord = math.hypot(strand.span, strand.rise)
    turned = motion.longer + gravity.angle * chord
    steep, ratio = max_elevation_sine(strand.rise, strand.span, turned), chord / strand.length
    level, rising = movement_bound(
        cable.sensitivity, elevation_class(steep), piece.end_motion.ends, number,
        ratio_range(ratio + grown / strand.length, longer / strand.length),
    )  # fmt: skip
    upright = min(abs(up), 1.0)
    across = min(math.sqrt(1.0 - upright * upright) + gravity.angle, 1.0)
    return (across * level + min(upright + gravity.angle, 1.0) * rising) * by


@inner
def is_bounded(gravity: Gravity) -> bool:
    """Return whether there are gravities in a box, and their angles are bounded."""
    return 0.0 <= gravity.angle < np.inf


@inner
def write_unbounded(gravity: Gravity, b: int, bounds: EnclosureArrays) -> None:
    """Write that a box has to be halved, unless there is no gravity in it at all."""
    if gravity.angle >= 0.0:
        bounds.low[b] = -np.inf
        bounds.widths[b, 1] = bounds.widths[b, 2] = np.inf
