"""Linear response of a strand to movements of its ends: exact first order, bounded remainder.

Near the nominal shape this is much sharper than :mod:`.sensitivity`, which covers the worst of all
shapes. In the strand's plane, with the unit normal ν and the tension T per weight of a metre
(Routh, *Statics*, § 443; the cable turns by ν·δF/T where forces change by δF),

    K(s) = ∫₀ˢ ν νᵀ / T,    B(s) = K(s) K(ℓ)⁻¹,    A = 1 − B,

and across the plane B is the share of the span. K is elementary in θ, sinh θ the slope:
K₁₁ = [θ − tanh θ], K₂₂ = [tanh θ], K₁₂ = [sech θ]. The remainder is at most ½·G²·M when the ends
move by G relative to each other; M·span is tabulated. It is much smaller near a grip than
elsewhere.
"""

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt

from swarm.geometry.catenary import Catenaries
from swarm.geometry.catenary_kernel import Catenary, max_elevation_sine, min_elevation_sine
from swarm.geometry.sensitivity import (
    BOTH_ENDS,
    FAR_END,
    LARGEST_RATIO,
    EndMovement,
    find_class,
    response_between,
    share_of,
)
from swarm.geometry.shape_tables import Nodes, bounds_over_cells, kept, nodes_of
from swarm.jit import compiled, inner
from swarm.signatures import Floats2, Floats3, Ints1
from swarm.threads import once

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.intp]
Numbers = TypeVar("Numbers", float, Floats)

_BANDS = np.array([0.0, 20.0, 40.0, 60.0, 70.0, 76.0, 80.0, 84.0, 88.0])
"""Bands of chord elevation, in degrees; narrow where second derivatives grow, near the vertical."""
_SINES = np.sin(np.radians(_BANDS[1:]))
_BINS = 48
"""Bins of the chord ratio, equally wide in log(1 − ratio): 1 − ratio falls by 13 % in each."""
_STEPS = 2
"""Steps of the movement for which the table of second derivatives is read."""
_PARTS = 16
"""Parts of a strand with a table entry each."""
_SHORTEST_SPAN = 0.05
"""Share of the length below which a span is too short for the table."""
_TURNED, _TILTED = np.radians(10.0), np.radians(15.0)
"""Steps between directions: smaller ones would change the table by 5 % at most."""
_DIRECTIONS = np.array(
    [
        (math.cos(tilt) * math.cos(turn), math.cos(tilt) * math.sin(turn), math.sin(tilt))
        for tilt in np.arange(0.0, 0.5 * np.pi + 1e-9, _TILTED)
        for turn in np.arange(0.0, np.pi - 1e-9, _TURNED)
    ]
)
"""Directions of movement along the heading, upward and across. Opposite ones, and those mirrored in
the strand's plane, bend it alike."""
_BETWEEN_DIRECTIONS = 0.5 * math.hypot(_TURNED, _TILTED)
"""Largest angle η between any direction and these. In the worst direction d, the second derivative
along itself is M w, and mixed ones have no part along w; so in the nearest of these directions
it is at least M (cos² η − sin² η) = M cos 2η."""
DEGENERATE = 1e-12
"""Determinant of K(ℓ) below which the response is not computed."""
_COLUMNS = float(_BINS / np.log1p(-LARGEST_RATIO))


@dataclass(frozen=True, eq=False)
class LinearResponse:
    """First-order response of points of strands, and the bound of the remainder; all (b,).

    ``at_point`` is the largest movement along a direction per metre of movement of the ends;
    ``per_arc`` the largest change of that per metre of cable; ``curvature`` is M, per metre.
    ``known`` is false where the strand is too steep or its span too short for a bound.
    """

    at_point: Floats
    per_arc: Floats
    curvature: Floats
    known: npt.NDArray[np.bool_]

    def movement(self, size: Floats, relative: Floats) -> Floats:
        """Return a bound (b,) of the movement of the points when the ends move by ``size``.

        ``relative`` (b,) bounds the movement of one end relative to the other. Infinite where
        not ``known``.
        """
        bound = _movement(self.at_point, self.curvature, size, relative)
        return np.where(self.known, bound, np.inf)


def _movement(at_point: Numbers, curvature: Numbers, size: Numbers, relative: Numbers) -> Numbers:
    """As :meth:`LinearResponse.movement`, where known: the first order and the remainder."""
    return at_point * size + 0.5 * curvature * relative * relative


movement = inner(_movement)
"""The same for one strand, compiled."""


def linear_response(
    strands: Catenaries,
    fraction: Floats,
    ends: Ints,
    normal: Floats,
    piece: tuple[Floats, Floats],
    stretch: Floats,
) -> LinearResponse:
    """Return the response of strands (b,) at fractions (b,) along unit vectors (b, 3).

    ``ends`` (b,) are BOTH_ENDS, FAR_END or NEAR_END: the ends that move. ``per_arc`` holds between
    the two fractions ``piece``. ``stretch`` (b,) bounds the movement of one end relative to the
    other, in metres.
    """
    up = -np.einsum("bi,bi->b", normal, strands.down)
    along = np.einsum("bi,bi->b", normal, strands.heading)
    found = np.empty((3, len(up)))
    _responses(
        np.stack([strands.length, strands.parameter, strands.slope, strands.span, strands.rise]),
        np.stack([along, up, fraction, *piece, stretch]), ends, curvature_table(), found,
    )  # fmt: skip
    known = np.isfinite(found[0])
    at_point, per_arc, curvature = np.where(known, found, 0.0)
    return LinearResponse(at_point, per_arc, curvature, known)


@compiled
def _responses(
    strands: Floats2, points: Floats2, ends: Ints1, table: Floats3, found: Floats2
) -> None:
    """Write :func:`strand_response` (3, b) of strands (5, b).

    ``points`` (6, b) holds the two parts of normals, fractions, begins and ends of pieces, and
    stretches.
    """
    for k in range(len(ends)):
        length, parameter, slope, span, rise = strands[:, k]
        along, up, fraction, begin, end, stretch = points[:, k]
        strand = Catenary(length, parameter, slope, span, rise)
        moved = EndMovement(ends[k], np.inf, stretch, stretch)
        point = point_response(strand, (along, up), fraction)
        found[0, k], found[1, k], found[2, k] = strand_response(
            strand, point, (begin, end), moved, table
        )


class PointResponse(NamedTuple):
    """Movement of one point of a strand along a unit vector n, to first order in its ends.

    Per metre of the end it is (``ahead``, ``up``) along the strand's heading and upward, and
    ``share`` of the part of n across both; per metre of the start n less these. ``by_start`` and
    ``by_end`` are the largest movements per metre of one end. ``trace`` and ``determinant`` are
    those of K(ℓ); where the determinant is below DEGENERATE nothing here is meaningful.
    """

    ahead: float
    up: float
    share: float
    by_start: float
    by_end: float
    trace: float
    determinant: float


@inner
def point_response(strand: Catenary, normal: tuple[float, float], fraction: float) -> PointResponse:
    """Return the first-order response of the point at a fraction of the arc.

    ``normal`` holds the parts of a unit vector along the strand's heading and upward.
    """
    along, up = normal
    across = 1.0 - up * up - along * along
    turn = strand.length / strand.parameter
    # Slopes, and by them the angles' hyperbolic functions: sinh θ, 1 / cosh θ and tanh θ.
    low, high = strand.slope, strand.slope + turn
    at = strand.slope + fraction * turn
    sech_low, sech_high = 1.0 / np.sqrt(1.0 + low * low), 1.0 / np.sqrt(1.0 + high * high)
    sech_at = 1.0 / np.sqrt(1.0 + at * at)
    first, whole, part = np.arcsinh(low), np.arcsinh(high), np.arcsinh(at)
    whole, part = whole - first, part - first
    level, cross = high * sech_high - low * sech_low, sech_high - sech_low
    level_part, cross_part = at * sech_at - low * sech_low, sech_at - sech_low
    bent, bent_part = whole - level, part - level_part
    determinant = bent * level - cross * cross
    # q = K(ℓ)⁻¹ K(s) n, the transposed response of the point in the plane.
    pulled, raised = bent_part * along + cross_part * up, cross_part * along + level_part * up
    by_along = (level * pulled - cross * raised) / determinant
    by_up = (bent * raised - cross * pulled) / determinant
    share = part / whole
    aside = max(across, 0.0)
    by_end = np.sqrt(by_along**2 + by_up**2 + share**2 * aside)
    by_start = np.sqrt((along - by_along) ** 2 + (up - by_up) ** 2 + (1.0 - share) ** 2 * aside)
    return PointResponse(by_along, by_up, share, by_start, by_end, bent + level, determinant)


@inner
def strand_response(
    strand: Catenary,
    point: PointResponse,
    piece: tuple[float, float],
    moved: EndMovement,
    table: Floats,
) -> tuple[float, float, float]:
    """Return :func:`linear_response` of one strand: at the point, per arc, and curvature.

    ``table`` is :func:`curvature_table`. All are infinite where the response is not known.
    """
    at_point, per_arc = first_order(strand, point, piece, moved.ends)
    bent = curvature(strand, piece, moved, table)
    if np.isfinite(at_point + bent):
        return at_point, per_arc, bent
    return np.inf, np.inf, np.inf


@inner
def first_order(
    strand: Catenary, point: PointResponse, piece: tuple[float, float], ends: int
) -> tuple[float, float]:
    """Return the first order of :func:`strand_response`: at the point, and per arc.

    Infinite where the response is not known.
    """
    at_point = response_to(point, ends)
    trace, determinant = point.trace, point.determinant
    softest = 0.5 * (trace + np.sqrt(max(trace * trace - 4.0 * determinant, 0.0)))
    flattest = _flattest(strand, piece)
    per_arc = max(
        softest / determinant / (strand.parameter * flattest), 1.0 / (strand.span * flattest)
    )
    if determinant > DEGENERATE and np.isfinite(at_point + per_arc):
        return at_point, per_arc
    return np.inf, np.inf


@inner
def response_to(point: PointResponse, ends: int) -> float:
    """Return the largest movement of a point per metre of the ends that move, in first order."""
    if ends == BOTH_ENDS:
        return point.by_start + point.by_end
    return point.by_end if ends == FAR_END else point.by_start


@inner
def beyond_interpolation(strand: Catenary, per_arc: float, piece: tuple[float, float]) -> float:
    """Return how far the response B within a piece is at most from its interpolation between ends.

    It is A² / 8 |B″| for a piece with the arc A; ``per_arc`` is that of :func:`first_order`. With
    T = a cosh θ and the unit tangent τ, K″ = −(τ νᵀ + ν τᵀ) / (a² cosh³ θ) − ν νᵀ tanh θ / T², of
    which the norm is at most 2 / (√3 T²); across the plane, T² times it is below 1.
    """
    arc = strand.length * (piece[1] - piece[0])
    largest = 2.0 / math.sqrt(3.0) / (strand.parameter * _flattest(strand, piece))
    return largest * per_arc * arc * arc / 8.0


@inner
def _flattest(strand: Catenary, piece: tuple[float, float]) -> float:
    """Return the smallest cosh θ of a piece."""
    turn = strand.length / strand.parameter
    begin, end = strand.slope + piece[0] * turn, strand.slope + piece[1] * turn
    lowest = 0.0 if begin * end <= 0.0 else min(abs(begin), abs(end))
    return math.sqrt(1.0 + lowest * lowest)


@inner
def curvature(
    strand: Catenary, piece: tuple[float, float], moved: EndMovement, table: Floats
) -> float:
    """Return an upper bound of M of a piece while its ends move relative to each other.

    The remainder is ∫(1 − t)·G²·M(t) over the movement, t from 0 to 1: the first steps weigh most,
    when the strand is not yet as taut as at the end.
    """
    stretch = moved.relative
    if strand.span - stretch <= _SHORTEST_SPAN * strand.length:
        return np.inf
    first = find_class(min_elevation_sine(strand.rise, strand.span, stretch), _SINES)
    last = find_class(max_elevation_sine(strand.rise, strand.span, stretch), _SINES)
    if last >= len(_SINES):
        return np.inf
    chord = np.sqrt(strand.span * strand.span + strand.rise * strand.rise)
    mean = 0.0
    for step in range(_STEPS):
        share = (step + 1) / _STEPS
        reach, longer = stretch * share, moved.longer * share
        ratio, narrowest = (chord + longer) / strand.length, strand.span - reach
        if not ratio < LARGEST_RATIO:
            return np.inf
        column = min(int(np.floor(np.log1p(-ratio) * _COLUMNS)), _BINS - 1)
        largest = 0.0
        for band in range(first, last + 1):
            # Counted from the lower end; of a nearly level strand either end may be the lower one.
            if strand.rise >= -reach:
                here = _largest(table[band, column], piece[0], piece[1])
                largest = max(largest, here)
            if strand.rise <= reach:
                here = _largest(table[band, column], 1.0 - piece[1], 1.0 - piece[0])
                largest = max(largest, here)
        mean += (2 * (_STEPS - step) - 1) / _STEPS**2 * largest / narrowest
    return float(mean)


@inner
def _largest(parts: Floats, begin: float, end: float) -> float:
    """Return the largest value of the parts of a strand that a piece overlaps."""
    first = max(int(begin * _PARTS - 1e-9), 0)
    last = min(int(end * _PARTS + 1e-9), _PARTS - 1)
    largest = 0.0
    for part in range(first, last + 1):
        largest = max(largest, parts[part])
    return float(largest)


@once
def curvature_table() -> Floats:
    """Return the largest second derivative times span up to a bin's ratio: (band, bin, part).

    Bands are of elevations; parts of a strand are counted from the lower end.
    """
    return kept(__file__, "curvature", _curvatures)


def _curvatures() -> Floats:
    """Return :func:`curvature_table`."""
    edges = -np.expm1(np.log1p(-LARGEST_RATIO) * np.arange(1, _BINS + 1) / _BINS)
    below = _SHORTEST_SPAN * np.array([1.0, 1.4, 2.0])
    slopes = np.tan(
        np.radians(np.concatenate([np.arange(0.0, 60.0, 5.0), np.arange(60.0, 89.0, 2.0)]))
    )
    nodes = nodes_of(np.concatenate([below, edges]), np.arcsinh(slopes), 6 * _PARTS)
    second = np.empty(nodes.angle.shape)
    _write_second(nodes, _DIRECTIONS, np.empty((len(_DIRECTIONS), 6)), second)
    cells = bounds_over_cells(nodes, second / np.cos(2.0 * _BETWEEN_DIRECTIONS), _PARTS)
    # Shorter spans are not looked up.
    widest = nodes.ratio[1:, None] / np.cosh(nodes.steepness[:-1])
    cells[widest < _SHORTEST_SPAN] = 0.0
    cells = np.maximum.accumulate(cells, axis=0)[len(below) - 1 :]
    at = np.degrees(np.arctan(slopes))[:-1] + 1e-6  # a band begins at a node
    bands = [cells[:, (low < at) & (at < high)].max(axis=1) for low, high in pairwise(_BANDS)]
    return np.stack(bands)


@compiled
def _write_second(nodes: Nodes, directions: Floats2, turns: Floats2, found: Floats3) -> None:
    """Write |∂²x/∂p²(d, d)| times span at all nodes, the largest of unit directions d (k, 3).

    With the end force F = (H, V) over the weight of a metre, x(s) = ∫ τ(F + V s′) ds′ and
    ∂x/∂F = K(s). Its second derivative along δ = K(ℓ)⁻¹ d is the integral Q(s) of
    −(2 (τ·δ) Pδ + |Pδ|² τ) / T², P = 1 − τ τᵀ, so that ∂²x/∂p²(d, d) = Q(s) − B(s) Q(ℓ).
    Directions are along the heading, upward and across; ``turns`` (k, 6) is memory for δ and Q(ℓ).
    """
    for i in range(nodes.angle.shape[0]):
        for j in range(nodes.angle.shape[1]):
            angle = nodes.angle[i, j]
            first, turned = angle[0], angle[-1] - angle[0]
            response = response_between(first, angle[-1])
            bent, level, cross = response
            determinant = bent * level - cross * cross
            whole = _curving(first, angle[-1])
            for d in range(len(directions)):
                ahead, up = directions[d, 0], directions[d, 1]
                pulled = (level * ahead - cross * up) / determinant
                raised = (bent * up - cross * ahead) / determinant
                aside = directions[d, 2] / turned
                turns[d, 0], turns[d, 1], turns[d, 2] = pulled, raised, aside
                turns[d, 3], turns[d, 4], turns[d, 5] = _curved(whole, pulled, raised, aside)
            for k in range(len(angle)):
                xx, xz, zx, zz = share_of(response_between(first, angle[k]), response)
                share = (angle[k] - first) / turned
                part = _curving(first, angle[k])
                largest = 0.0
                for d in range(len(directions)):
                    x, z, y = _curved(part, turns[d, 0], turns[d, 1], turns[d, 2])
                    x -= xx * turns[d, 3] + xz * turns[d, 4]
                    z -= zx * turns[d, 3] + zz * turns[d, 4]
                    y -= share * turns[d, 5]
                    largest = max(largest, x * x + y * y + z * z)
                found[i, j, k] = turned * math.sqrt(largest)


@inner
def _curving(first: float, last: float) -> tuple[float, float, float, float, float, float]:
    """Return ∫ sech⁴, sech³ tanh, sech² tanh², sech tanh³, sech² and sech tanh between angles."""
    low, high = 1.0 / np.cosh(first), 1.0 / np.cosh(last)
    rise, drop = np.tanh(first), np.tanh(last)
    _, level, cross = response_between(first, last)
    cubes = level * (rise * rise + rise * drop + drop * drop) / 3.0
    other = cross * (low * low + low * high + high * high) / 3.0
    return level - cubes, -other, cubes, other - cross, level, -cross


@inner
def _curved(
    integrals: tuple[float, float, float, float, float, float], p: float, q: float, aside: float
) -> tuple[float, float, float]:
    """Return Q along the heading, upward and across, for a change (p, q, aside) of the force."""
    flat, flat_up, level_up, up, level, cross = integrals
    across = aside * aside
    x = level_up * (3.0 * p * p - 2.0 * q * q) + (2.0 * up - 4.0 * flat_up) * p * q
    z = flat_up * (3.0 * q * q - 2.0 * p * p) + (2.0 * flat - 4.0 * level_up) * p * q
    x += flat * q * q + level * across
    z += up * p * p + cross * across
    return -x, -z, -2.0 * aside * (p * level + q * cross)
