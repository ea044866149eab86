"""Response of a team's strands to movements of their vehicles, as the penalty counts it; compiled.

Tracking errors count by the tables by which the certificate and the stream-loss check bound them
(:mod:`swarm.geometry.sensitivity`), derivatives by the strand's linear response. The certificate's
other bound, by the linear response with its remainder, is smaller in oblique directions. Plans with
it need a hundredth less cable, but lost setpoints then slow some of them: of nine knots 6_2 folded
in 153 s instead of 137 s, 7_4 in 221 s instead of 175 s.
"""

import numpy as np
import numpy.typing as npt

from swarm.geometry.catenary import MAX_CHORD_RATIO, Catenary
from swarm.geometry.distance import Vector
from swarm.geometry.sensitivity import (
    BOTH_ENDS,
    DEGENERATE,
    FAR_END,
    EndMovement,
    Sensitivity,
    chord_range,
    chord_response,
    finest_piece,
    movement_bound,
    point_response,
)
from swarm.jit import compiled, inner
from swarm.signatures import Floats3

Floats = npt.NDArray[np.float64]

_REACHES = MAX_CHORD_RATIO - 1e-6
"""Chord over drawn length below which a strand is not over-stretched, but for rounding."""

_NO_SPAN = 1e-9
"""Metres; replaces a smaller span, along which no direction is defined."""


@compiled
def write_largest_responses(
    shapes: Floats3, tracking: float, tables: Sensitivity, responses: Floats3
) -> None:
    """Write the largest movement of any point of strands (s, n − 1), in any direction.

    ``shapes`` (s, n − 1, 5) are their catenaries. ``responses`` (s, n − 1, 2): metres per metre of
    both ends when these move by the tracking error, and of the far end when it moves by twice as
    much.
    """
    for s in range(shapes.shape[0]):
        for i in range(shapes.shape[1]):
            write_largest_response(shapes[s, i], tracking, tables, responses[s, i])


@inner
def write_largest_response(
    shape: Floats, tracking: float, tables: Sensitivity, response: Floats
) -> None:
    """As :func:`write_largest_responses`, for one strand: ``shape`` (5,), ``response`` (2,)."""
    strand, relative = catenary_of(shape), 2.0 * tracking
    steep, ratios = chord_range(strand.rise, strand.span, strand.length, relative)
    response[0] = _size(movement_bound(tables, steep, BOTH_ENDS, 1, ratios))
    response[1] = _size(movement_bound(tables, steep, FAR_END, 1, ratios))


@inner
def catenary_of(shape: Floats) -> Catenary:
    """Return the catenary with fields (5,)."""
    return Catenary(shape[0], shape[1], shape[2], shape[3], shape[4])


@inner
def arc_fraction(shape: Floats, share: float) -> float:
    """Return the fraction of the arc of a strand up to a share of its span."""
    strand = catenary_of(shape)
    slope = np.sinh(np.arcsinh(strand.slope) + share * strand.span / strand.parameter)
    fraction = (slope - strand.slope) * strand.parameter / strand.length
    return float(min(max(fraction, 0.0), 1.0))


@inner
def largest_responses(
    shape: Floats, pieces: tuple[int, int], moved: EndMovement, tables: Sensitivity
) -> tuple[float, float]:
    """Return the largest movements of two pieces of a strand, in any direction, per metre of its
    ends; ``pieces`` are their heap numbers."""
    strand = catenary_of(shape)
    steep, ratios = chord_range(strand.rise, strand.span, strand.length, moved.relative)
    return (
        _size(movement_bound(tables, steep, moved.ends, pieces[0], ratios)),
        _size(movement_bound(tables, steep, moved.ends, pieces[1], ratios)),
    )


@inner
def _size(parts: tuple[float, float]) -> float:
    """Return the size of a vector by its horizontal and its vertical part."""
    return float(np.sqrt(parts[0] * parts[0] + parts[1] * parts[1]))


@inner
def point_movement(
    shape: Floats, fraction: float, upright: float, moved: EndMovement, tables: Sensitivity
) -> float:
    """Return by how many metres a point of a strand moves along a direction, at the most.

    The point is at a fraction of the arc; ``upright`` is the vertical part of the direction's unit
    vector.
    """
    strand, piece = catenary_of(shape), finest_piece(1, fraction)
    level, rising = chord_response(strand.rise, strand.span, strand.length, moved, piece, tables)
    upright = min(abs(upright), 1.0)
    across = np.sqrt(1.0 - upright * upright)
    return float((across * level + upright * rising) * moved.size)


@inner
def add_to_ends(
    gradient: Floats,
    segment: int,
    points: Floats,
    shape: Floats,
    fraction: float,
    push: Vector,
) -> None:
    """Add to the gradient (n, 3) the derivative ``push`` by a point of a segment.

    The point follows the ends by the strand's linear response; where that is not defined, and on
    over-stretched strands, in proportion to its nearness to each.
    """
    strand = catenary_of(shape)
    chord = np.sqrt(strand.span * strand.span + strand.rise * strand.rise)
    along, up = _in_plane(points, push)
    response = point_response(strand, (along, up), fraction)
    ahead, rising, share = response.ahead, response.up, response.share
    if not (chord < _REACHES * strand.length and response.determinant > DEGENERATE):
        ahead, rising, share = fraction * along, fraction * up, fraction
    span = _span(points)
    east, north = (points[-1, 0] - points[0, 0]) / span, (points[-1, 1] - points[0, 1]) / span
    by_end = (
        ahead * east + share * (push[0] - along * east),
        ahead * north + share * (push[1] - along * north),
        rising,
    )
    add_to(gradient, segment, push, 1.0)
    add_to(gradient, segment, by_end, -1.0)
    add_to(gradient, segment + 1, by_end, 1.0)


@inner
def add_to(gradient: Floats, vehicle: int, push: Vector, times: float) -> None:
    """Add ``times`` a vector to the gradient (n, 3) of a vehicle."""
    gradient[vehicle, 0] += times * push[0]
    gradient[vehicle, 1] += times * push[1]
    gradient[vehicle, 2] += times * push[2]


@inner
def _in_plane(points: Floats, vector: Vector) -> tuple[float, float]:
    """Return the parts of a vector along the heading of an outline and upward."""
    level = (points[-1, 0] - points[0, 0]) * vector[0] + (points[-1, 1] - points[0, 1]) * vector[1]
    return level / _span(points), vector[2]


@inner
def _span(points: Floats) -> float:
    """Return the span of an outline, metres."""
    x, y = points[-1, 0] - points[0, 0], points[-1, 1] - points[0, 1]
    return float(max(np.sqrt(x * x + y * y), _NO_SPAN))
