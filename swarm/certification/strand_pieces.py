"""Pieces of strands at an instant: their chords, and bounds of their movement around it; compiled.

The movement of a piece is that of its grip points within the interval of time and the tracking
radius, multiplied by the sensitivity of the strand. It is counted in a frame that moves with the
team, since motion that all share changes no distance.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from swarm.certification.motion_bounds import BoundedMotion, Grip, Instant, MotionTables
from swarm.certification.tube_radii import Radii, TubeRadii, TubeTables, radii_over
from swarm.geometry.catenary_kernel import (
    Catenary,
    arc_start,
    max_elevation_sine,
    offset_from,
    solve,
)
from swarm.geometry.catenary_shape import SMALLEST_HALF_ANGLE, VERTICAL
from swarm.geometry.linear_response import (
    curvature_table,
    movement,
    movement_difference,
    strand_response,
)
from swarm.geometry.sensitivity import (
    BOTH_ENDS,
    FAR_END,
    LARGEST_RATIO,
    EndMovement,
    Sensitivity,
    elevation_class,
    finest_piece,
    movement_bound,
    ratio_range,
    sensitivity_tables,
)
from swarm.geometry.vectors import Vector, difference, dot, moved, size
from swarm.jit import inner
from swarm.signatures import Floats1, Floats3, contiguous

Floats = npt.NDArray[np.float64]


class CableTables(NamedTuple):
    """A :class:`HeldCable` for compiled code, with the tables of what strands do."""

    motion: MotionTables
    lengths: Floats1
    tracking: float
    down: tuple[float, float, float]
    tube: TubeTables
    curvature: Floats3
    sensitivity: Sensitivity


@dataclass(frozen=True, eq=False)
class HeldCable:
    """A cable held by a moving team: n grip points and n − 1 segments.

    ``lengths`` (n − 1,) of the segments, metres; ``tracking`` the tracking radius around every
    setpoint, metres; ``down`` the unit vector of the effective gravity; ``tube`` bounds how far the
    cable swings from its catenaries (None: it is quasi-static).
    """

    motion: BoundedMotion
    lengths: Floats
    tracking: float
    down: tuple[float, float, float] = (0.0, 0.0, -1.0)
    tube: TubeRadii | None = None

    @cached_property
    def tables(self) -> CableTables:
        """The cable for compiled code."""
        east, north, up = (np.asarray(self.down) / np.linalg.norm(self.down)).tolist()
        return CableTables(
            self.motion.tables,
            contiguous(self.lengths),
            self.tracking,
            (east, north, up),
            TubeTables.none() if self.tube is None else self.tube.tables,
            curvature_table(),
            sensitivity_tables(),
        )


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

    ``arc`` is :func:`.catenary_kernel.arc_start` of its slope.
    """

    start: Vector
    heading: Vector
    catenary: Catenary
    arc: tuple[float, float, float]


class _EndMotion(NamedTuple):
    """Bounds of the movement of grip points, metres.

    ``total`` within interval and tracking radius, ``tracking`` within the tracking radius alone;
    ``relative`` and ``relative_tracking`` of the ends relative to each other. ``ends`` tells which
    ends move.
    """

    ends: int
    total: float
    tracking: float
    relative: float
    relative_tracking: float


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
    """Bounds of the movement along a normal.

    ``piece`` of any point of the piece; ``point`` of one point, and ``tracking`` of that point by
    tracking errors alone.
    """

    piece: float
    point: float
    tracking: float


@inner
def strand_between(cable: CableTables, segment: int, start: Vector, end: Vector) -> Strand:
    """Return the strand of a segment between two points.

    Over-stretched segments are drawn with a length that reaches: the taut check refuses them.
    """
    across, down = difference(end, start), cable.down
    length = max(cable.lengths[segment], size(across) / LARGEST_RATIO)
    rise = -dot(across, down)
    level = moved(across, rise, down)
    span = math.sqrt(dot(level, level))
    wide = max(span, VERTICAL * length)
    _, parameter, slope = solve(wide, rise, length, SMALLEST_HALF_ANGLE)
    heading = level[0] / wide, level[1] / wide, level[2] / wide
    catenary = Catenary(length, parameter, slope, span, rise)
    return Strand(start, heading, catenary, arc_start(slope))


@inner
def strand_point(strand: Strand, down: Vector, fraction: float) -> Vector:
    """Return the point of a strand at a fraction of its arc."""
    catenary, heading = strand.catenary, strand.heading
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
) -> HeldStrand:
    """Return the strand of a segment with bounds of the movement of its grip points."""
    strand = strand_between(cable, segment, grips[0].place, grips[1].place)
    motion = _end_motion(grips, instant.half, displacement, 2.0 * cable.tracking)
    return HeldStrand(segment, strand, motion)


@inner
def held_piece(cable: CableTables, held: HeldStrand, instant: Instant, part: Part) -> Piece:
    """Return a piece of a strand."""
    strand = held.strand
    begin, end = counted(part)
    near, far = strand_point(strand, cable.down, begin), strand_point(strand, cable.down, end)
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
def _drift(grip: Grip, half: float, frame: Vector) -> float:
    """Bound the movement of a grip point within ``half`` seconds, in a frame with a velocity."""
    return size(difference(grip.velocity, frame)) * half + grip.deviation


@inner
def _end_motion(
    grips: tuple[Grip, Grip], half: float, displacement: Displacement, ball: float
) -> _EndMotion:
    """Return the movement of both grip points; ``ball`` is that by tracking errors, metres."""
    first, last = grips
    ends, frame = displacement.ends, displacement.frame
    if ends == BOTH_ENDS:
        drifted = max(_drift(first, half, frame), _drift(last, half, frame))
    else:
        drifted = _drift(last if ends == FAR_END else first, half, frame)
    apart = size(difference(last.velocity, first.velocity))
    relative = apart * half + first.deviation + last.deviation
    total = drifted + displacement.deviation + displacement.tracking
    return _EndMotion(ends, total, displacement.tracking, relative + ball, ball)


@inner
def piece_movement(
    cable: CableTables, piece: Piece, normal: Vector, along: float, largest: float
) -> Movement:
    """Return bounds of the movement of a piece along a unit vector.

    ``along`` is the fraction of the chord at which the single point lies. Its bounds separate the
    uncertainty of the piece's size from that of the interval. Each bound is the smaller of two: by
    the sensitivity of all shapes, for the piece the :func:`largest_movement`, and by the strand's
    own linear response.
    """
    strand, motion, begin, end = piece.strand.catenary, piece.end_motion, piece.begin, piece.end
    relative, total = motion.relative, motion.total
    up, fraction = -dot(normal, cable.down), begin + along * (end - begin)
    at_point, per_arc, curvature = strand_response(
        strand, (dot(normal, piece.strand.heading), up), fraction, (begin, end),
        EndMovement(motion.ends, total, relative), cable.curvature,
    )  # fmt: skip
    finest, ball = finest_piece(piece.number, fraction), motion.relative_tracking
    of_piece = largest
    of_point = _of_all_shapes(cable, piece, up, finest, (total, relative))
    by_tracking = _of_all_shapes(cable, piece, up, finest, (motion.tracking, ball))
    if at_point < np.inf:
        arc = strand.length * max(fraction - begin, end - fraction)
        linear = movement(at_point, curvature, total, relative)
        of_piece = min(of_piece, linear + movement_difference(per_arc, arc, relative))
        of_point = min(of_point, linear)
        by_tracking = min(by_tracking, movement(at_point, curvature, motion.tracking, ball))
    return Movement(of_piece, of_point, by_tracking)


@inner
def largest_movement(cable: CableTables, piece: Piece, normal: Vector) -> float:
    """Return a bound of a piece's movement by the sensitivity of all shapes alone.

    It is not below that of :func:`piece_movement`, and takes a fraction of its time.
    """
    motion = piece.end_motion
    up, moved_by = -dot(normal, cable.down), (motion.total, motion.relative)
    return _of_all_shapes(cable, piece, up, piece.number, moved_by)


@inner
def _of_all_shapes(
    cable: CableTables, piece: Piece, up: float, number: int, moved_by: tuple[float, float]
) -> float:
    """Return a bound of the movement of the piece with a heap number, within the given piece.

    The ends move by a size, and relative to each other; ``up`` is the part of a unit vector against
    the effective gravity.
    """
    (by, apart), strand = moved_by, piece.strand.catenary
    steep = max_elevation_sine(strand.rise, strand.span, piece.end_motion.relative)
    ratio = math.hypot(strand.span, strand.rise) / strand.length
    level, rising = movement_bound(
        cable.sensitivity, elevation_class(steep), piece.end_motion.ends, number,
        ratio_range(ratio, apart / strand.length),
    )  # fmt: skip
    upright = min(abs(up), 1.0)
    return (math.sqrt(1.0 - upright * upright) * level + upright * rising) * by
