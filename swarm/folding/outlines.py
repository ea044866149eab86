"""Outlines of strands: polygons of a few edges, with which the planner computes distances."""

from typing import Annotated, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from swarm.geometry.catenary import MAX_CHORD_RATIO, strand_polygon
from swarm.geometry.distance import Vector, bounding_boxes, difference, point_distance
from swarm.jit import compiled, inner
from swarm.signatures import Floats1, Floats2, Floats3, Floats4, record

Floats = npt.NDArray[np.float64]
Index = Any

_NO_CHORD = 1e-9
"""Metres; length of a strand between two ends in one place."""

PIECES = 6
"""Edges of the polygon that stands for a strand."""

_PARALLEL = 1e-12
"""Square metres of the plan-view parallelogram of two strands below which they are parallel."""

_TOUCHING = 1e-3
"""Metres below which the direction between two outlines is not meaningful."""


class Outlines(NamedTuple):
    """Strands as polygons (…, PIECES + 1, 3), their boxes (…, 2, 3), and chord over length (…,).

    ``shapes`` (…, 5) are the fields of their catenaries; over-stretched strands have the length
    that reaches. A *place* on an outline is the index of an edge plus a fraction of that edge.
    """

    points: Floats4
    boxes: Floats4
    ratio: Floats2
    shapes: Floats3

    def take(self, which: Index) -> "Outlines":
        """Return the outlines at an index or slice of the leading dimensions."""
        return Outlines(*(field[which] for field in self))


OutlineRow = Annotated[Outlines, record(Outlines, Floats3, Floats3, Floats1, Floats2)]
"""Outlines with one leading dimension."""


def outline_strands(start: Floats, end: Floats, length: npt.ArrayLike) -> Outlines:
    """Return the outlines of strands of given lengths between ends (…, 3).

    Over-stretched strands are drawn with the length at which they no longer are; see
    :func:`reachable_length`.
    """
    chord = np.linalg.norm(end - start, axis=-1)
    length = np.broadcast_to(np.asarray(length, dtype=np.float64), chord.shape)
    points = np.empty((*chord.shape, PIECES + 1, 3))
    boxes = np.empty((*chord.shape, 2, 3))
    shapes = np.empty((*chord.shape, 5))
    corners = points.reshape(-1, PIECES + 1, 3)
    start, end = (np.ascontiguousarray(each).reshape(-1, 3) for each in (start, end))
    _write_outlines(start, end, length.flatten(), corners, shapes.reshape(-1, 5))
    bounding_boxes(corners, boxes.reshape(-1, 2, 3))
    return Outlines(points, boxes, chord / length, shapes)


@compiled
def _write_outlines(
    start: Floats2, end: Floats2, length: Floats1, points: Floats3, shapes: Floats2
) -> None:
    """Write the outlines (q, k, 3) and catenaries (q, 5) of strands."""
    for q in range(len(length)):
        write_outline(start[q], end[q], length[q], points[q], shapes[q])


@inner
def write_outline(start: Floats, end: Floats, length: float, points: Floats, shape: Floats) -> None:
    """Write the outline (k, 3) and the catenary (5,) of a strand."""
    chord = point_distance(start, end)
    strand = strand_polygon(start, end, reachable_length(length, chord), points)
    for k in range(5):
        shape[k] = strand[k]


@inner
def reachable_length(length: float, chord: float) -> float:
    """Return the length, or that with which a chord has the largest ratio in the air."""
    return max(length, chord / MAX_CHORD_RATIO + _NO_CHORD)


@compiled
def crossing_heights(first: Floats3, second: Floats3, heights: Floats1) -> None:
    """Write :func:`crossing_height` of outlines (q, k, 3) and others, pair by pair."""
    for q in range(len(first)):
        heights[q] = crossing_height(first[q], second[q])


@inner
def crossing_height(first: Floats, second: Floats) -> float:
    """Return the height of a strand over another where they cross in plan view, else 0."""
    here, there = plan_crossing(first, second)
    if not (0.0 < here < 1.0 and 0.0 < there < 1.0):
        return 0.0
    return height_at_span(first, here) - height_at_span(second, there)


@compiled
def plan_crossing(first: Floats2, second: Floats2) -> tuple[float, float]:
    """Return the shares of two spans at which the lines along them cross in plan view.

    A strand lies in a vertical plane, so both are straight in plan view. −1 where parallel.
    """
    u_x, u_y = first[-1, 0] - first[0, 0], first[-1, 1] - first[0, 1]
    w_x, w_y = second[-1, 0] - second[0, 0], second[-1, 1] - second[0, 1]
    apart_x, apart_y = second[0, 0] - first[0, 0], second[0, 1] - first[0, 1]
    area = u_x * w_y - u_y * w_x
    if abs(area) < _PARALLEL:
        return -1.0, -1.0
    return (apart_x * w_y - apart_y * w_x) / area, (apart_x * u_y - apart_y * u_x) / area


@compiled
def height_at_span(points: Floats2, share: float) -> float:
    """Return the height of an outline at a share of its span in plan view."""
    place = share * (len(points) - 1)
    piece = min(int(place), len(points) - 2)
    return float(points[piece, 2] + (place - piece) * (points[piece + 1, 2] - points[piece, 2]))


@inner
def point_at(points: Floats, place: float) -> Vector:
    """Return the point of an outline at a place."""
    piece = min(int(place), len(points) - 2)
    share = place - piece
    return (
        (1.0 - share) * points[piece, 0] + share * points[piece + 1, 0],
        (1.0 - share) * points[piece, 1] + share * points[piece + 1, 1],
        (1.0 - share) * points[piece, 2] + share * points[piece + 1, 2],
    )


@inner
def direction_between(
    first: Floats, here: float, second: Floats, there: float, distance: float
) -> Vector:
    """Return the unit vector from a place on the second outline to a place on the first.

    It is upward where the outlines touch.
    """
    if distance <= _TOUCHING:
        return 0.0, 0.0, 1.0
    apart = difference(point_at(first, here), point_at(second, there))
    return apart[0] / distance, apart[1] / distance, apart[2] / distance
