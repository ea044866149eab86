"""Certified bounds of the distances between strands.

For a box (two strands, an interval of time, a piece of each) both pieces at the middle instant lie
near their chords. A unit vector n that separates the chords also separates the displaced pieces,
less their movement along n: the bow of each piece over its chord, the movement of its grip points
and by other gravities (:mod:`.strand_pieces`), and the radius of the tube in which it swings
(:mod:`.swing_tube`).
"""

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
from swarm.certification.motion_bounds import Grip, Instant, ends_at, grip_at, instant_at
from swarm.certification.strand_pieces import (
    CableTables,
    Displacement,
    Gravity,
    HeldCable,
    HeldStrand,
    Part,
    Piece,
    apart_moving,
    counted,
    gravity_in,
    held_piece,
    held_strand,
    is_bounded,
    largest_lean,
    largest_movement,
    piece_movement,
    point_movement,
    write_unbounded,
)
from swarm.geometry.distance import Vector, difference, dot, moved, segment_distance, unit
from swarm.geometry.sensitivity import BOTH_ENDS, FAR_END, NEAR_END
from swarm.jit import compiled, inner
from swarm.signatures import Floats3, Ints2, contiguous

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.intp]


class _Pairs(NamedTuple):
    """Pairs (q, 2) of segments, and the fractions (q, 2, 2) between which each is compared."""

    segments: Ints2
    parts: Floats3


def strands_apart(cable: HeldCable, pairs: Ints, parts: Floats, required: float) -> Evaluator:
    """Bound the distances of strands' middles, less the required distance.

    ``pairs`` (q, 2) of segments, first < second; ``parts`` (q, 2, 2) the fractions between which
    each is compared. The frame of neighbours is their shared grip: in it, tracking errors displace
    the other ends by up to twice the tracking radius. Coordinates are time, in wind tilt, and
    fractions.
    """
    compared = _Pairs(contiguous(pairs), contiguous(parts))

    def evaluate(boxes: Boxes) -> Enclosure:
        bounds = Enclosure.not_found(boxes)
        tables, chords = cable.tables, np.empty((2, 2, 3))
        _write_margins(tables, compared, required, boxes.arrays(), chords, bounds.arrays())
        return bounds

    return evaluate


@compiled
def _write_margins(
    cable: CableTables, pairs: _Pairs, required: float, boxes: BoxArrays, chords: Floats3,
    bounds: EnclosureArrays,
) -> None:  # fmt: skip
    """Write the margins of pairs in the boxes whose pieces count.

    Half of the time goes into the strands at an instant, which boxes one after the other share.
    """
    known, k = -1, boxes.middle.shape[1] - 2
    for b in range(len(boxes.group)):
        middle, half, parts = boxes.middle[b], boxes.half[b], pairs.parts[boxes.group[b]]
        part = Part(middle[k], half[k], parts[0, 0], parts[0, 1])
        other_part = Part(middle[k + 1], half[k + 1], parts[1, 0], parts[1, 1])
        (begin, end), (other_begin, other_end) = counted(part), counted(other_part)
        if begin >= end or other_begin >= other_end:
            continue
        if known < 0 or not same_in(boxes, known, b, k):
            known, instant = b, instant_at(cable.motion, middle[0], half[0])
            gravity = gravity_in(cable, middle, half)
            if is_bounded(gravity):
                pair = pairs.segments[boxes.group[b]]
                held, other_held = _held_pair(cable, pair, instant, gravity)
        if not is_bounded(gravity):
            write_unbounded(gravity, b, bounds)
            continue
        piece = held_piece(cable, held, instant, part)
        other = held_piece(cable, other_held, instant, other_part)
        limits = required, boxes.enough
        _write_margin(cable, (piece, other), limits, gravity, chords, b, bounds)


@inner
def _held_pair(
    cable: CableTables, pair: Ints, instant: Instant, gravity: Gravity
) -> tuple[HeldStrand, HeldStrand]:
    """Return the strands of two segments (2,) at an instant."""
    first, second = pair
    grips = ends_at(cable.motion, instant, first)
    ends, other_ends = BOTH_ENDS, BOTH_ENDS
    if second == first + 1:
        ends, other_ends = NEAR_END, FAR_END
        others = grips[1], grip_at(cable.motion, instant, second + 1)
    else:
        others = ends_at(cable.motion, instant, second)
    moves = _displacement(cable.tracking, grips, others, ends)
    other_moves = _displacement(cable.tracking, grips, others, other_ends)
    return (
        held_strand(cable, first, grips, instant, moves, gravity),
        held_strand(cable, second, others, instant, other_moves, gravity),
    )


@inner
def _displacement(
    tracking: float, grips: tuple[Grip, Grip], others: tuple[Grip, Grip], ends: int
) -> Displacement:
    """Return the displacement of a strand of two; ``ends`` are those that neighbours do not share.

    BOTH_ENDS for strands that are no neighbours.
    """
    if ends == BOTH_ENDS:
        return Displacement(_mean_velocity(grips, others), BOTH_ENDS, tracking, 0.0)
    # The shared grip rests in its frame, but the frame itself deviates from uniform motion.
    shared = others[0]
    return Displacement(shared.velocity, ends, 2.0 * tracking, shared.deviation)


@inner
def _mean_velocity(grips: tuple[Grip, Grip], others: tuple[Grip, Grip]) -> Vector:
    """Return the mean of four velocities."""
    u, v = grips[0].velocity, grips[1].velocity
    w, x = others[0].velocity, others[1].velocity
    return (
        0.25 * (u[0] + v[0]) + 0.25 * (w[0] + x[0]),
        0.25 * (u[1] + v[1]) + 0.25 * (w[1] + x[1]),
        0.25 * (u[2] + v[2]) + 0.25 * (w[2] + x[2]),
    )


@inner
def _write_margin(
    cable: CableTables,
    pieces: tuple[Piece, Piece],
    limits: tuple[float, float],
    gravity: Gravity,
    chords: Floats,
    b: int,
    bounds: EnclosureArrays,
) -> None:
    """Write the margin of two pieces; ``chords`` (2, 2, 3) is memory.

    ``limits`` are the required distance, and the margin that is enough.
    """
    (piece, other), (required, enough) = pieces, limits
    for axis in range(3):
        chords[0, 0, axis], chords[0, 1, axis] = piece.near[axis], piece.far[axis]
        chords[1, 0, axis], chords[1, 1, axis] = other.near[axis], other.far[axis]
    square, here, there = segment_distance(chords[0], 0, chords[1], 0)
    at_piece = moved(piece.near, here, difference(piece.far, piece.near))
    at_other = moved(other.near, there, difference(other.far, other.near))
    # Any unit vector gives a true bound: rounding in the closest points does no harm.
    normal = unit(difference(at_piece, at_other))
    ends = dot(piece.near, normal), dot(piece.far, normal)
    other_ends = dot(other.near, normal), dot(other.far, normal)
    swing, swing_other, bows = piece.swing, other.swing, piece.bow + other.bow
    chords_apart = min(ends[0], ends[1]) - max(other_ends[0], other_ends[1]) - bows
    largest = largest_movement(cable, piece, normal, gravity)
    largest_other = largest_movement(cable, other, normal, gravity)
    most = largest + largest_other + swing.most + swing_other.most
    most += largest_lean(piece, gravity) + largest_lean(other, gravity)
    bounds.low[b] = chords_apart - most - required
    if bounds.low[b] >= enough:
        return
    moves = piece_movement(cable, piece, normal, here, gravity, largest)
    moves_other = piece_movement(cable, other, normal, there, gravity, largest_other)
    apart = apart_moving(gravity, (moves, moves_other), ends, other_ends)
    most = apart.by_ends + swing.most + swing_other.most
    bounds.low[b] = apart.distance - bows - most - required
    if bounds.low[b] >= enough:
        return
    drifts, size, other_size = apart.drift >= 0.0, moves.piece, moves_other.piece
    if drifts:
        size, other_size = moves.drifting.beside, moves_other.drifting.beside
    point, calm, by_tracking = point_movement(cable, piece, gravity, moves, drifts)
    other_point, other_calm, other_by_tracking = point_movement(
        cable, other, gravity, moves_other, drifts
    )
    least = by_tracking + other_by_tracking + swing.least + swing_other.least
    bounds.high[b] = np.sqrt(square) + bows - least - required
    in_time = max(apart.drift, 0.0) + calm - by_tracking + other_calm - other_by_tracking
    bounds.widths[b, 0] = in_time + (swing.most - swing.now) + (swing_other.most - swing_other.now)
    k = bounds.widths.shape[1] - 2
    if k > 1:
        rest = point - calm + other_point - other_calm
        bounds.widths[b, 1], bounds.widths[b, 2] = apart.east + 0.5 * rest, apart.north + 0.5 * rest
    bounds.widths[b, k] = 2.0 * piece.bow + size - point + (swing.now - swing.least)
    bounds.widths[b, k + 1] = (
        2.0 * other.bow + other_size - other_point
        + (swing_other.now - swing_other.least)
    )  # fmt: skip
    length, other_length = piece.end - piece.begin, other.end - other.begin
    length *= piece.strand.catenary.length
    other_length *= other.strand.catenary.length
    bounds.widths[b, k] += apart.size * length / (length + other_length)
    bounds.widths[b, k + 1] += apart.size * other_length / (length + other_length)
    for axis in range(3):
        bounds.place[b, axis] = 0.5 * (at_piece[axis] + at_other[axis])
