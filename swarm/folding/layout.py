"""Layout of the knot: corners, sags, segment lengths and lanes from a diagram and the limits."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from swarm.errors import Refused
from swarm.geometry.catenary import solve_catenaries
from swarm.geometry.chain import minimum_sags, plan_crossings, segment_lengths

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class LayoutParameters:
    """The free parameters of a layout, in metres.

    ``cell`` scales the corners; ``gap`` is the height between strands at their crossings;
    ``minimum_sag`` is the smallest sag of a segment, ``slack`` its smallest sag as a share of its
    span. With its ends ``chord_margin`` farther apart than its corners, a segment's chord is still
    shorter than ``max_chord_ratio`` of its length. Lanes are heights over or under the corners.
    Levels change from ``slope`` before a corner to ``slope`` after it; turns reach as far as
    ``rounding``. Given sags are used as they are; with ``two_sags`` all under strands have the
    same. ``length`` is the cable's length if the layout must use all of it: then the other lengths
    that scale with the cell are only a start.
    """

    cell: float
    gap: float
    minimum_sag: float
    slack: float
    lane_over: float
    lane_under: float
    slope: float
    rounding: float
    chord_margin: float
    max_chord_ratio: float
    sag_over: float | None = None
    sag_under: float | None = None
    two_sags: bool = False
    length: float | None = None

    def scaled(self, factor: float) -> "LayoutParameters":
        """Return the parameters with the cell, and all that scales with it, times a factor."""
        return replace(
            self,
            cell=factor * self.cell,
            minimum_sag=factor * self.minimum_sag,
            lane_over=factor * self.lane_over,
            lane_under=factor * self.lane_under,
            slope=factor * self.slope,
            rounding=factor * self.rounding,
        )


@dataclass(frozen=True, eq=False)
class KnotLayout:
    """The folded knot: at height 0 while it is folded, at its own height in a plan.

    ``corners`` (n, 3) are the final positions of the grip points in order along the cable, metres
    (ENU in a plan). ``sags`` and ``lengths`` (n − 1,) belong to the segments. ``lanes`` (n − 1,)
    are heights of the path above (negative: below) the corners. ``crossings`` are pairs (over,
    under) of segments. ``cell`` is the cell width of the grid, 0 for a layout without a grid.
    """

    corners: Floats
    sags: Floats
    lengths: Floats
    lanes: Floats
    crossings: tuple[tuple[int, int], ...]
    cell: float


def lay_out(
    corners: npt.ArrayLike, crossings: Sequence[tuple[int, int]], parameters: LayoutParameters
) -> KnotLayout:
    """Return the layout of a diagram: ``corners`` (n, 2) in cells, crossings as (over, under).

    The first edge points along +x, with the first corner at the origin. Lanes of edges without
    crossings are interpolated between the edges before and after them.

    Raises :class:`swarm.errors.Refused` where no sags separate the crossings.
    """
    plan = np.asarray(corners, dtype=np.float64)
    first = (plan[1] - plan[0]) / np.linalg.norm(plan[1] - plan[0])
    turn = np.array([[first[0], first[1]], [-first[1], first[0]]])
    flat = ((plan - plan[0]) @ turn.T) * parameters.cell
    placed = np.concatenate([flat, np.zeros((len(flat), 1))], axis=1)
    pairs = np.asarray(crossings, dtype=np.intp).reshape(-1, 2)
    spans = np.linalg.norm(np.diff(flat, axis=0), axis=1)
    least = np.maximum(parameters.minimum_sag, parameters.slack * spans)
    slackest = solve_catenaries(
        np.zeros(3),
        spans[:, None] * np.eye(3)[0],
        (spans + parameters.chord_margin) / parameters.max_chord_ratio,
    )
    least = np.maximum(least, slackest.sag())
    over, under = np.setdiff1d(pairs[:, 0], pairs[:, 1]), np.unique(pairs[:, 1])
    if parameters.sag_over is not None:
        least[:] = parameters.sag_over
    sags = minimum_sags(
        placed, pairs, parameters.gap, minimum_sag=least, one_each=not parameters.two_sags
    )
    if parameters.sag_over is not None:
        sags[over] = parameters.sag_over
    if parameters.sag_under is not None:
        sags[under] = parameters.sag_under
    lanes = _lanes(len(placed) - 1, pairs, parameters)
    lengths = segment_lengths(placed, sags)
    return KnotLayout(
        placed, sags, lengths, lanes, tuple((int(a), int(b)) for a, b in pairs), parameters.cell
    )


def lay_out_corners(corners: npt.ArrayLike, sags: npt.ArrayLike, cell: float = 0.0) -> KnotLayout:
    """Return the layout of given corners (n, 2) and sags (n − 1,) of the segments, in metres.

    Where two segments cross, the segment with the smaller sag passes over. Lanes are 0; ``cell`` is
    only recorded. Raises :class:`swarm.errors.Refused` where crossing segments have equal sags.
    """
    plan = np.asarray(corners, dtype=np.float64)
    placed = np.concatenate([plan, np.zeros((len(plan), 1))], axis=1)
    depth = np.asarray(sags, dtype=np.float64)
    pairs = plan_crossings(placed).segments
    for first, second in pairs:
        if depth[first] == depth[second]:
            raise Refused(
                f"segments {first + 1} and {second + 1} cross and both sag {depth[first]:g} m: "
                "which passes over is not defined"
            )
    deeper = depth[pairs[:, 0]] > depth[pairs[:, 1]]
    over_under = np.where(deeper[:, None], pairs[:, ::-1], pairs)
    return KnotLayout(
        corners=placed,
        sags=depth,
        lengths=segment_lengths(placed, depth),
        lanes=np.zeros(len(depth)),
        crossings=tuple((int(a), int(b)) for a, b in over_under),
        cell=cell,
    )


def _lanes(count: int, pairs: npt.NDArray[np.intp], parameters: LayoutParameters) -> Floats:
    """Return the lane (count,) of every edge, interpolated between edges that cross others."""
    lanes = np.zeros(count)
    if not len(pairs):
        return lanes
    lanes[pairs[:, 0]] = parameters.lane_over
    lanes[pairs[:, 1]] = -parameters.lane_under
    crossing = np.unique(pairs)
    between: Floats = np.interp(np.arange(count), crossing, lanes[crossing])
    return between
