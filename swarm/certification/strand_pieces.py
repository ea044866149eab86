"""Pieces of strands at an instant: their chords, and bounds of their movement around it.

The movement of a piece is that of its grip points within the interval of time and the tracking
radius, multiplied by the sensitivity of the strand. It is counted in a frame that moves with the
team, since motion that all share changes no distance.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from swarm.certification.motion_bounds import BoundedMotion, TeamStates
from swarm.certification.tube_radii import Radii, TubeRadii
from swarm.geometry.catenary import Catenaries, solve_catenaries
from swarm.geometry.catenary_kernel import Catenary, max_elevation_sine
from swarm.geometry.distance import norms
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
from swarm.jit import compiled
from swarm.signatures import Floats1, Floats2, Floats3, Ints1

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.intp]


_FEW = 64
"""Strands below which solving all takes less time than finding the distinct ones."""


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


@dataclass(frozen=True, eq=False)
class Selection:
    """Pieces (b,) of segments at instants, by indices.

    ``middle`` and ``half`` (b,) are the dyadic interval of fractions of each piece. Only the part
    of it within ``limits`` (b, 2) counts.
    """

    instant: Ints
    segment: Ints
    middle: Floats
    half: Floats
    limits: Floats

    @staticmethod
    def whole(instant: Ints, segment: Ints) -> "Selection":
        """Return the selection of whole strands."""
        half = np.full(len(segment), 0.5)
        return Selection.unlimited(instant, segment, half, half)

    @staticmethod
    def unlimited(instant: Ints, segment: Ints, middle: Floats, half: Floats) -> "Selection":
        """Return the selection of pieces that count completely."""
        limits = np.broadcast_to(np.array([0.0, 1.0]), (len(segment), 2))
        return Selection(instant, segment, middle, half, limits)


@dataclass(frozen=True, eq=False)
class Displacement:
    """Displacement of the grip points of pieces (b,), in a frame for each.

    ``frame`` (b, 3) is the frame's velocity; ``ends`` (b,) which ends move (BOTH_ENDS, FAR_END,
    NEAR_END); ``tracking`` (b,) the displacement by tracking errors, metres; ``deviation`` (b,) the
    frame's own deviation from uniform motion.
    """

    frame: Floats
    ends: Ints
    tracking: Floats
    deviation: Floats

    @staticmethod
    def of_both_ends(frame: Floats, tracking: float) -> "Displacement":
        """Return the displacement of both ends in frames (b, 3) of uniform motion."""
        count = len(frame)
        return Displacement(
            frame, np.full(count, BOTH_ENDS), np.full(count, tracking), np.zeros(count)
        )


class _Shapes(NamedTuple):
    """Figures (b,) of strands and their pieces; ``number`` is the piece's heap number."""

    length: Floats1
    parameter: Floats1
    slope: Floats1
    span: Floats1
    rise: Floats1
    ratio: Floats1
    begin: Floats1
    end: Floats1
    number: Ints1


class _EndMotion(NamedTuple):
    """Bounds (b,) of the movement of grip points.

    ``total`` within interval and tracking radius, ``tracking`` within the tracking radius alone;
    ``relative`` and ``relative_tracking`` of the ends relative to each other. ``ends`` tells which
    ends move.
    """

    total: Floats1
    tracking: Floats1
    relative: Floats1
    relative_tracking: Floats1
    ends: Ints1


class _Direction(NamedTuple):
    """Normals' components (b,) along the heading and up, and the fraction of a point's chord."""

    ahead: Floats1
    up: Floats1
    along: Floats1


class _Tables(NamedTuple):
    """Tables of largest second derivatives, and of the sensitivity of all shapes."""

    curvature: Floats3
    sensitivity: Sensitivity


class Movement(NamedTuple):
    """Bounds (b,) of the movement along a normal.

    ``piece`` of any point of the piece; ``point`` of one point, and ``tracking`` of that point by
    tracking errors alone.
    """

    piece: Floats
    point: Floats
    tracking: Floats


@dataclass(frozen=True, eq=False)
class Pieces:
    """A piece of a strand for each box (b,).

    ``ends`` (b, 2, 3) of its chord at the middle instant; ``bow`` (b,) the largest distance of the
    piece from its chord; ``swing`` the radii of the tube around it.
    """

    strands: Catenaries
    ends: Floats
    bow: Floats
    shapes: _Shapes
    end_motion: _EndMotion
    swing: Radii

    def movement(self, along: Floats, normal: Floats) -> Movement:
        """Return bounds of the movement along unit vectors ``normal`` (b, 3).

        ``along`` (b,) is the fraction of the chord at which the single point lies. Its bounds
        separate the uncertainty of the piece's size from that of the interval. Each bound is the
        smaller of two: by the sensitivity of all shapes, and by the strand's own linear response.
        """
        strands = self.strands
        up = -np.einsum("bi,bi->b", normal, strands.down)
        ahead = np.einsum("bi,bi->b", normal, strands.heading)
        found = np.empty((3, len(along)))
        direction = _Direction(ahead, up, along)
        _write_movement(
            self.shapes,
            self.end_motion,
            direction,
            _Tables(curvature_table(), sensitivity_tables()),
            found,
        )
        return Movement(found[0], found[1], found[2])


@compiled
def _write_movement(
    shapes: _Shapes,
    motion: _EndMotion,
    direction: _Direction,
    tables: _Tables,
    found: Floats2,
) -> None:
    """Write :class:`Movement` of pieces into ``found`` (3, b)."""
    for k in range(len(shapes.length)):
        length, begin, end = shapes.length[k], shapes.begin[k], shapes.end[k]
        ends, relative = motion.ends[k], motion.relative[k]
        fraction = begin + direction.along[k] * (end - begin)
        strand = Catenary(
            length, shapes.parameter[k], shapes.slope[k], shapes.span[k], shapes.rise[k]
        )
        at_point, per_arc, curvature = strand_response(
            strand, (direction.ahead[k], direction.up[k]), fraction, (begin, end),
            EndMovement(ends, motion.total[k], relative), tables.curvature,
        )  # fmt: skip
        upright = min(abs(direction.up[k]), 1.0)
        across = np.sqrt(1.0 - upright * upright)
        steep = elevation_class(max_elevation_sine(shapes.rise[k], shapes.span[k], relative))
        point = finest_piece(shapes.number[k], fraction)
        ratios = ratio_range(shapes.ratio[k], relative / length)
        ratios_tracking = ratio_range(shapes.ratio[k], motion.relative_tracking[k] / length)
        for which in range(3):
            size = motion.total[k] if which < 2 else motion.tracking[k]
            apart = relative if which < 2 else motion.relative_tracking[k]
            level, rising = movement_bound(
                tables.sensitivity, steep, ends,
                shapes.number[k] if which == 0 else point, ratios if which < 2 else ratios_tracking,
            )  # fmt: skip
            worst = (across * level + upright * rising) * size
            if at_point < np.inf:
                bound = movement(at_point, curvature, size, apart)
                if which == 0:
                    arc = length * max(fraction - begin, end - fraction)
                    bound += movement_difference(per_arc, arc, relative)
                worst = min(worst, bound)
            found[which, k] = worst


def pieces(
    team: TeamStates, cable: HeldCable, selection: Selection, displacement: Displacement
) -> Pieces:
    """Return the selected pieces with bounds of the movement of their grip points."""
    instant, segment = selection.instant, selection.segment
    strands = _strands(team, cable, instant, segment)
    edges = np.stack([selection.middle - selection.half, selection.middle + selection.half])
    edges = np.minimum(np.maximum(edges, selection.limits[:, 0]), selection.limits[:, 1])
    begin, end = edges
    ends = np.stack([*strands.points_at(edges)], axis=1)
    across = norms(ends[:, 1] - ends[:, 0])
    arc = strands.length * (end - begin)
    number = _heap_number(selection.middle, selection.half)
    swing = Radii.none(len(segment))
    if cable.tube is not None:
        swing = cable.tube.over(segment, team.time[instant], team.half[instant], number)
    return Pieces(
        strands=strands,
        ends=ends,
        bow=0.5 * np.sqrt(np.maximum(arc * arc - across * across, 0.0)),
        shapes=_Shapes(
            length=strands.length,
            parameter=strands.parameter,
            slope=strands.slope,
            span=strands.span,
            rise=strands.rise,
            ratio=np.hypot(strands.span, strands.rise) / strands.length,
            begin=begin,
            end=end,
            number=number,
        ),
        end_motion=_end_motion(team, selection, displacement, cable.tracking),
        swing=swing,
    )


def _heap_number(middle: Floats, half: Floats) -> Ints:
    """Numbers (b,) of dyadic intervals in the binary heap of pieces; 1 is the whole strand."""
    return np.rint((1.0 + middle - half) / (2.0 * half)).astype(np.intp)


def _strands(team: TeamStates, cable: HeldCable, instant: Ints, segment: Ints) -> Catenaries:
    """The strands (b,) of segments at instants; of many each catenary is computed once.

    Over-stretched segments are drawn with a length that reaches: the taut check refuses them.
    """
    if len(segment) < _FEW:
        return _solved(team, cable, instant, segment)
    count = len(cable.lengths)
    distinct, index = np.unique(instant * count + segment, return_inverse=True)
    return _taken(_solved(team, cable, distinct // count, distinct % count), index)


def _solved(team: TeamStates, cable: HeldCable, instant: Ints, segment: Ints) -> Catenaries:
    start, end = team.position[instant, segment], team.position[instant, segment + 1]
    length = np.maximum(cable.lengths[segment], norms(end - start) / LARGEST_RATIO)
    return solve_catenaries(start, end, length, down=cable.down)


def _taken(strands: Catenaries, where: Ints) -> Catenaries:
    names = (
        "start", "end", "length", "down", "heading", "span", "rise", "half_angle", "parameter",
        "slope",
    )  # fmt: skip
    return replace(strands, **{name: getattr(strands, name)[where] for name in names})


def _end_motion(
    team: TeamStates, selection: Selection, displacement: Displacement, tracking: float
) -> _EndMotion:
    instant, first, last = selection.instant, selection.segment, selection.segment + 1
    ends = displacement.ends
    drift_first, drift_last = (
        team.drift(instant, vehicle, displacement.frame) for vehicle in (first, last)
    )
    drift = np.where(
        ends == BOTH_ENDS, np.maximum(drift_first, drift_last),
        np.where(ends == FAR_END, drift_last, drift_first),
    )  # fmt: skip
    apart = norms(team.velocity[instant, last] - team.velocity[instant, first])
    deviation = team.deviation
    relative = apart * team.half[instant] + deviation[instant, first] + deviation[instant, last]
    ball = 2.0 * tracking
    return _EndMotion(
        total=drift + displacement.deviation + displacement.tracking,
        tracking=displacement.tracking,
        relative=relative + ball,
        relative_tracking=np.full_like(relative, ball),
        ends=ends,
    )
