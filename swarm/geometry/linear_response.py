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

from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from typing import NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt

from swarm.geometry.catenary import Catenaries, solve_catenaries
from swarm.geometry.catenary_kernel import Catenary, max_elevation_sine, min_elevation_sine
from swarm.geometry.sensitivity import (
    BOTH_ENDS,
    FAR_END,
    LARGEST_RATIO,
    EndMovement,
    find_class,
)
from swarm.jit import compiled, inner
from swarm.signatures import Floats2, Floats3, Ints1

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.intp]
Numbers = TypeVar("Numbers", float, Floats)

_INFLATION = 1.1
"""Covers second derivatives between the samples of elevation and direction; the tests check it."""
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

    def movement_difference(self, arc: Floats, relative: Floats) -> Floats:
        """Return a bound (b,) of the extra movement of points up to ``arc`` (b,) metres away."""
        return np.where(self.known, _movement_difference(self.per_arc, arc, relative), np.inf)


def _movement(at_point: Numbers, curvature: Numbers, size: Numbers, relative: Numbers) -> Numbers:
    """As :meth:`LinearResponse.movement`, where known: the first order and the remainder."""
    return at_point * size + 0.5 * curvature * relative * relative


def _movement_difference(per_arc: Numbers, arc: Numbers, relative: Numbers) -> Numbers:
    """As :meth:`LinearResponse.movement_difference`, where known."""
    return per_arc * arc * relative


movement, movement_difference = inner(_movement), inner(_movement_difference)
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
        moved = EndMovement(ends[k], np.inf, stretch)
        found[0, k], found[1, k], found[2, k] = strand_response(
            strand, (along, up), fraction, (begin, end), moved, table
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
    normal: tuple[float, float],
    fraction: float,
    piece: tuple[float, float],
    moved: EndMovement,
    table: Floats,
) -> tuple[float, float, float]:
    """Return :func:`linear_response` of one strand: at the point, per arc, and curvature.

    ``normal`` holds the parts of a unit vector along the strand's heading and upward, ``table`` is
    :func:`curvature_table`. All are infinite where the response is not known.
    """
    turn = strand.length / strand.parameter
    point = point_response(strand, normal, fraction)
    at_point = point.by_end if moved.ends == FAR_END else point.by_start
    if moved.ends == BOTH_ENDS:
        at_point = point.by_start + point.by_end
    trace, determinant = point.trace, point.determinant
    softest = 0.5 * (trace + np.sqrt(max(trace * trace - 4.0 * determinant, 0.0)))
    begin, end = strand.slope + piece[0] * turn, strand.slope + piece[1] * turn
    lowest = 0.0 if begin * end <= 0.0 else min(abs(begin), abs(end))
    flattest = np.sqrt(1.0 + lowest * lowest)
    per_arc = max(
        softest / determinant / (strand.parameter * flattest), 1.0 / (strand.span * flattest)
    )
    curvature = _curvature(strand, piece, moved.relative, table)
    if determinant > DEGENERATE and np.isfinite(at_point + per_arc + curvature):
        return at_point, per_arc, curvature
    return np.inf, np.inf, np.inf


@inner
def _curvature(
    strand: Catenary, piece: tuple[float, float], stretch: float, table: Floats
) -> float:
    """Return an upper bound of M of a piece while one end moves by ``stretch`` to the other.

    The remainder is ∫(1 − t)·G²·M(t) over the movement, t from 0 to 1: the first steps weigh most,
    when the strand is not yet as taut as at the end.
    """
    if strand.span - stretch <= _SHORTEST_SPAN * strand.length:
        return np.inf
    first = find_class(min_elevation_sine(strand.rise, strand.span, stretch), _SINES)
    last = find_class(max_elevation_sine(strand.rise, strand.span, stretch), _SINES)
    if last >= len(_SINES):
        return np.inf
    chord = np.sqrt(strand.span * strand.span + strand.rise * strand.rise)
    mean = 0.0
    for step in range(_STEPS):
        reach = stretch * (step + 1) / _STEPS
        ratio, narrowest = (chord + reach) / strand.length, strand.span - reach
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


@cache
def curvature_table() -> Floats:
    """Return the largest second derivative times span up to a bin's ratio: (band, bin, part).

    Bands are of elevations; parts of a strand are counted from the lower end, and each includes its
    neighbours. By central differences over fractions and directions, for strands of length 1.
    """
    upper = -np.expm1(np.log1p(-LARGEST_RATIO) * np.arange(1, _BINS + 1) / _BINS)
    degrees = np.concatenate([np.arange(0.0, 60.0, 4.0), np.arange(60.0, 89.0, 2.0)])
    ratio, steep = np.meshgrid(upper, np.radians(degrees), indexing="ij")
    end = np.stack([ratio * np.cos(steep), 0.0 * ratio, ratio * np.sin(steep)], axis=-1)
    angle = np.linspace(0.0, np.pi, 12, endpoint=False)
    in_plane = np.stack([np.cos(angle), 0.0 * angle, np.sin(angle)], axis=-1)
    sideways = [[0.0, 1.0, 0.0], [0.7071, 0.7071, 0.0], [0.0, 0.7071, 0.7071]]
    directions = np.concatenate([in_plane, sideways])
    step = 1e-3 * np.minimum(1.0 - ratio, np.minimum(0.3, ratio * np.cos(steep)))[..., None]
    fractions = np.linspace(0.0, 1.0, 4 * _PARTS + 1)
    largest = np.zeros((*ratio.shape, len(fractions)))
    still = solve_catenaries(np.zeros(3), end, 1.0).points(fractions)
    for direction in directions:
        ahead = solve_catenaries(np.zeros(3), end + step * direction, 1.0).points(fractions)
        back = solve_catenaries(np.zeros(3), end - step * direction, 1.0).points(fractions)
        second = (ahead - 2.0 * still + back) / step[..., None] ** 2
        largest = np.maximum(largest, np.linalg.norm(second, axis=-1))
    around = np.pad(largest, ((0, 0), (0, 0), (2, 2)))
    parts = np.lib.stride_tricks.sliding_window_view(around, 9, axis=-1)[..., ::4, :].max(axis=-1)
    scaled = np.maximum.accumulate(_INFLATION * parts * end[..., :1], axis=0)
    bands = [
        scaled[:, (low <= degrees) & (degrees <= high)].max(axis=1)
        for low, high in pairwise(_BANDS)
    ]
    return np.stack(bands)
