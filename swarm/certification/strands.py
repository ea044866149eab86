"""Lower bounds of distances that hold for a strand over a time and under every displacement.

For a box (two things, an interval of time, a piece of each) the two pieces at the interval's
middle lie near chords; a unit vector n that separates the chords separates the displaced pieces
too, less what each can move along n. That is: the bow of each piece over its chord, and the
movement of its grip points within the interval and within the tracking ball, multiplied by the
sensitivity of the strand. Movement is measured in a frame that goes along with the team, since what
all share changes no distance.
"""

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from swarm.certification.branch_and_bound import Boxes, Enclosure
from swarm.certification.motion_bounds import Course
from swarm.geometry.catenary import Catenaries, solve_catenaries
from swarm.geometry.catenary_kernel import max_elevation_sine
from swarm.geometry.distance import segment_segment
from swarm.geometry.linear_response import (
    CatenaryFigures,
    curvature_table,
    movement,
    movement_difference,
    strand_response,
)
from swarm.geometry.sensitivity import (
    BOTH_ENDS,
    FAR_END,
    LARGEST_RATIO,
    NEAR_END,
    elevation_class,
    finest_piece,
    movement_bound,
    ratio_range,
    sensitivity_tables,
)
from swarm.jit import compiled

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.intp]


MOST_EXEMPT = 0.5
"""Largest share of the shorter of two neighbours that is exempt at the vehicle that they share."""


@dataclass(frozen=True, eq=False)
class HeldCable:
    """A cable in the hands of a moving team: n grip points and n − 1 segments between them.

    ``tracking`` is the radius of the ball around every setpoint, metres; ``down`` the unit
    vector of the effective gravity.
    """

    course: Course
    lengths: Floats
    tracking: float
    down: tuple[float, float, float] = (0.0, 0.0, -1.0)


@dataclass(frozen=True, eq=False)
class Team:
    """The team at different instants, and what may happen within the half widths around them.

    ``position`` and ``velocity`` (m, n, 3); ``swerve`` (m, n) bounds the distance from uniform
    motion.
    """

    half: Floats
    position: Floats
    velocity: Floats
    swerve: Floats

    @staticmethod
    def at(course: Course, time: Floats, half: Floats) -> "Team":
        """Return the team at times (m,) with half widths (m,)."""
        position, velocity, _ = course.motion.at(time)
        bound = course.acceleration_bound(time - half, time + half)
        return Team(half, position, velocity, 0.5 * bound * (half * half)[:, None])

    def drift(self, when: Ints, who: Ints, reference: Floats) -> Floats:
        """Bound the movement (b,) of grip points in a frame of velocity ``reference`` (b, 3)."""
        speed = np.linalg.norm(self.velocity[when, who] - reference, axis=-1)
        bound: Floats = speed * self.half[when] + self.swerve[when, who]
        return bound


@dataclass(frozen=True, eq=False)
class Pieces:
    """A piece of a strand for each box: its chord at the middle instant, and what it can do.

    ``ends`` (b, 2, 3); ``bow`` (b,) is the largest distance of the piece from its chord; ``loose``
    (b,) how far the strand's grip points move at most within interval and ball, ``still`` within
    the ball alone; ``stretch`` and ``still_stretch`` how far relative to each other.
    """

    strands: Catenaries
    ends: Floats
    bow: Floats
    ratio: Floats
    number: Ints
    begin: Floats
    end: Floats
    moving: Ints
    loose: Floats
    still: Floats
    stretch: Floats
    still_stretch: Floats

    def movement(self, along: Floats, normal: Floats) -> tuple[Floats, Floats, Floats]:
        """How far the piece can move along ``normal``: at all, at ``along``, and in the ball only.

        ``along`` (b,) is a fraction of the chord; the second and third figure are for the point
        there, and so part the doubt that comes from the piece's size from that of the interval.
        Each is the better of two bounds: by the worst shape, and by the strand's own response.
        """
        strands = self.strands
        up = -np.einsum("bi,bi->b", normal, strands.down)
        ahead = np.einsum("bi,bi->b", normal, strands.heading)
        found, tables = np.empty((3, len(along))), sensitivity_tables()
        _moved(
            strands.length, strands.parameter, strands.slope, strands.span, strands.rise,
            ahead, up, along, self.begin, self.end, self.number, self.moving, self.ratio,
            np.stack([self.loose, self.still, self.stretch, self.still_stretch]),
            curvature_table(), tables.norm, tables.integral, found,
        )  # fmt: skip
        return found[0], found[1], found[2]


@compiled
def _moved(
    length: Floats,
    parameter: Floats,
    slope: Floats,
    span: Floats,
    rise: Floats,
    ahead: Floats,
    up: Floats,
    along: Floats,
    begin: Floats,
    end: Floats,
    number: Ints,
    moving: Ints,
    ratio: Floats,
    ways: Floats,
    table: Floats,
    norm: Floats,
    integral: Floats,
    found: Floats,
) -> None:
    """Write :meth:`Pieces.movement` of pieces (3, b), normals being ``ahead`` and ``up``; ``ways``
    (4, b) are how far grips move: loose, still, and both relative to each other."""
    for k in range(len(length)):
        loose, still, stretch, still_stretch = ways[0, k], ways[1, k], ways[2, k], ways[3, k]
        fraction = begin[k] + along[k] * (end[k] - begin[k])
        strand = CatenaryFigures(length[k], parameter[k], slope[k], span[k], rise[k])
        at_point, per_arc, curvature = strand_response(
            strand, (ahead[k], up[k]), fraction, (begin[k], end[k]), moving[k], stretch, table
        )  # fmt: skip
        upright = min(abs(up[k]), 1.0)
        across = np.sqrt(1.0 - upright * upright)
        point = finest_piece(number[k], fraction)
        steep = elevation_class(max_elevation_sine(rise[k], span[k], stretch))
        on_way = ratio_range(ratio[k], stretch / length[k])
        in_ball = ratio_range(ratio[k], still_stretch / length[k])
        for which in range(3):
            way, relative = (loose, stretch) if which < 2 else (still, still_stretch)
            level, rising = movement_bound(
                norm, integral, steep, moving[k], number[k] if which == 0 else point,
                on_way if which < 2 else in_ball,
            )  # fmt: skip
            worst = (across * level + upright * rising) * way
            if at_point < np.inf:
                bound = movement(at_point, curvature, way, relative)
                if which == 0:
                    arc = length[k] * max(fraction - begin[k], end[k] - fraction)
                    bound += movement_difference(per_arc, arc, stretch)
                worst = min(worst, bound)
            found[which, k] = worst


def _taken(strands: Catenaries, where: Ints) -> Catenaries:
    return replace(
        strands,
        **{
            name: getattr(strands, name)[where]
            for name in (
                "start", "end", "length", "down", "heading", "span", "rise",
                "half_angle", "parameter", "slope",
            )
        },
    )  # fmt: skip


def hung(team: Team, cable: HeldCable, when: Ints, segment: Ints) -> tuple[Catenaries, Ints]:
    """Hang the strands that boxes ask for, each once; returns them and the index of each box's.

    Over-stretched strands hang as if their cable reached: the taut rule refuses them anyhow.
    """
    count = len(cable.lengths)
    wanted, which = np.unique(when * count + segment, return_inverse=True)
    instant, number = wanted // count, wanted % count
    start, end = team.position[instant, number], team.position[instant, number + 1]
    chord = np.linalg.norm(end - start, axis=-1)
    length = np.maximum(cable.lengths[number], chord / LARGEST_RATIO)
    return solve_catenaries(start, end, length, down=cable.down), which


def pieces(
    team: Team,
    cable: HeldCable,
    when: Ints,
    segment: Ints,
    number: Ints,
    reference: Floats,
    moving: Ints,
    extra: Floats,
    swerve: Floats,
    part: Floats,
) -> Pieces:
    """Describe pieces ``number`` (b,) of strands ``segment`` (b,) at instants ``when`` (b,).

    ``reference`` (b, 3) is the velocity of the frame in which movement is counted, and ``extra``
    the displacement in that frame that the tracking ball adds to a grip point that moves,
    ``swerve`` what the frame itself may swerve. ``part`` (b, 2) are the fractions between which the
    strand counts: pieces are clipped to it.
    """
    strands, which = hung(team, cable, when, segment)
    level = np.frexp(number)[1] - 1
    width = 0.5**level
    begin = np.clip(number * width - 1.0, part[:, 0], part[:, 1])
    end = np.clip((number + 1) * width - 1.0, part[:, 0], part[:, 1])
    taken = _taken(strands, which)
    ends = np.stack([taken.points_at(begin), taken.points_at(end)], axis=1)
    across = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=-1)
    arc = taken.length * (end - begin)
    chord = np.hypot(taken.span, taken.rise)

    first, last = segment, segment + 1
    drift_first, drift_last = (team.drift(when, who, reference) for who in (first, last))
    apart = np.linalg.norm(team.velocity[when, last] - team.velocity[when, first], axis=-1)
    stretch = apart * team.half[when] + team.swerve[when, first] + team.swerve[when, last]
    drift = np.where(
        moving == BOTH_ENDS, np.maximum(drift_first, drift_last),
        np.where(moving == FAR_END, drift_last, drift_first),
    )  # fmt: skip
    ball = 2.0 * cable.tracking
    return Pieces(
        strands=taken,
        ends=ends,
        bow=0.5 * np.sqrt(np.maximum(arc * arc - across * across, 0.0)),
        ratio=chord / taken.length,
        number=number,
        begin=begin,
        end=end,
        moving=moving,
        loose=drift + swerve + extra,
        still=np.broadcast_to(extra, drift.shape),
        stretch=stretch + ball,
        still_stretch=np.full_like(stretch, ball),
    )


@dataclass(frozen=True, eq=False)
class StrandPairs:
    """Distances of strands, surface to surface, less what is required.

    ``pairs`` (q, 2) of segments, first < second, and ``parts`` (q, 2, 2) the fractions of each
    between which it counts. Neighbours, which meet at the grip of their shared vehicle, are
    displaced in the frame of that grip, by twice the ball at their other ends.
    """

    cable: HeldCable
    pairs: Ints
    parts: Floats
    diameter: float
    required: float

    def __call__(self, boxes: Boxes) -> Enclosure:
        """Enclose the margin in each box."""
        time, half, when = boxes.instants()
        team = Team.at(self.cable.course, time, half)
        first, second = self.pairs[boxes.pair].T
        neighbours = second == first + 1
        velocity = team.velocity
        shared = velocity[when, second]
        mean = 0.25 * (velocity[when, first] + velocity[when, first + 1])
        mean += 0.25 * (shared + velocity[when, second + 1])
        reference = np.where(neighbours[:, None], shared, mean)
        tracking = self.cable.tracking
        # In the frame of the shared grip point that point rests, though it swerves itself.
        extra = np.where(neighbours, 2.0 * tracking, tracking)
        extra_swerve = np.where(neighbours, team.swerve[when, second], 0.0)
        parts = self.parts[boxes.pair]
        a, b = (
            pieces(
                team, self.cable, when, segment, number, reference,
                np.where(neighbours, moving, BOTH_ENDS), extra, extra_swerve, parts[:, side],
            )
            for side, (segment, number, moving) in enumerate(
                ((first, boxes.first, NEAR_END), (second, boxes.second, FAR_END))
            )
        )  # fmt: skip
        found = _apart(a, b, self.diameter + self.required)
        counts = (a.begin < a.end) & (b.begin < b.end)
        return Enclosure(
            np.where(counts, found.low, np.inf),
            np.where(counts, found.high, np.inf),
            found.doubts,
            found.place,
        )


def all_pairs(lengths: Floats, beyond: float) -> tuple[Ints, Floats]:
    """Return all pairs (q, 2) of segments that must keep apart, and the parts (q, 2, 2) that count.

    Of neighbours, each must keep apart from the whole of the other where it is at least ``beyond``
    metres of cable away from the vehicle that they share, or half of the shorter one where that is
    less: two entries per pair.
    """
    first, second = np.triu_indices(len(lengths), 1)
    pairs = np.stack([first, second], axis=1)
    whole = np.tile([0.0, 1.0], (len(pairs), 2, 1))
    neighbours = second == first + 1
    i, j = pairs[neighbours].T
    left, right = whole[neighbours].copy(), whole[neighbours].copy()
    near = np.minimum(beyond, MOST_EXEMPT * np.minimum(lengths[i], lengths[j]))
    left[:, 0, 1] = 1.0 - near / lengths[i]
    right[:, 1, 0] = near / lengths[j]
    return (
        np.concatenate([pairs[~neighbours], pairs[neighbours], pairs[neighbours]]),
        np.concatenate([whole[~neighbours], left, right]),
    )


def _apart(a: Pieces, b: Pieces, required: float) -> Enclosure:
    closest = segment_segment(a.ends, b.ends)
    at_a = a.ends[:, 0] + closest.first[:, None] * (a.ends[:, 1] - a.ends[:, 0])
    at_b = b.ends[:, 0] + closest.second[:, None] * (b.ends[:, 1] - b.ends[:, 0])
    normal = unit(at_a - at_b)
    # Any unit vector gives a true bound, so rounding in the closest points does no harm.
    reach_a = np.einsum("bki,bi->bk", a.ends, normal).min(axis=1)
    reach_b = np.einsum("bki,bi->bk", b.ends, normal).max(axis=1)
    moved_a = a.movement(closest.first, normal)
    moved_b = b.movement(closest.second, normal)
    bows = a.bow + b.bow
    return Enclosure(
        low=reach_a - reach_b - bows - moved_a[0] - moved_b[0] - required,
        high=closest.distance + bows - moved_a[2] - moved_b[2] - required,
        doubts=np.stack(
            [
                moved_a[1] - moved_a[2] + moved_b[1] - moved_b[2],
                2.0 * a.bow + moved_a[0] - moved_a[1],
                2.0 * b.bow + moved_b[0] - moved_b[1],
            ],
            axis=1,
        ),
        place=0.5 * (at_a + at_b),
    )


def unit(vector: Floats) -> Floats:
    """Unit vectors (b, 3); straight up where there is no direction."""
    size = np.linalg.norm(vector, axis=-1, keepdims=True)
    return np.where(size > 1e-12, vector / np.maximum(size, 1e-12), [0.0, 0.0, 1.0])
