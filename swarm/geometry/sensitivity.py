"""Response of a strand to movements of its ends: bounds over all shapes, and of one shape.

A point x(f) of a catenary, f a share of its arc length, depends on both ends p₀, p₁ with the
Jacobians A(f) = ∂x/∂p₀ and B(f) = ∂x/∂p₁, A + B = 1. They depend on the chord as a share ρ of the
length, on the chord's elevation, and on f; close to taut they grow like 1/√(1 − ρ).

**Over all shapes.** Ends that move by up to D along straight lines move a point by at most D times
the mean of ‖A‖ + ‖B‖ along the movement, and during it ρ grows at most linearly to ρ + 2D/ℓ. So the
tables hold, for every ρ and for dyadic pieces of the strand, the largest norm over all chords that
are not longer and not steeper, and its integral over ρ. Horizontal and vertical movement have
separate tables, since a strand that gets tauter rises.

**Of one shape**, which is much sharper near it: exact first order, bounded remainder. In the
strand's plane, with the unit normal ν and the tension T per weight of a metre (Routh, *Statics*,
§ 443; the cable turns by ν·δF/T where forces change by δF),

    K(s) = ∫₀ˢ ν νᵀ / T,    B(s) = K(s) K(ℓ)⁻¹,    A = 1 − B,

and across the plane B is the share of the span. K is elementary in θ, sinh θ the slope:
K₁₁ = [θ − tanh θ], K₂₂ = [tanh θ], K₁₂ = [sech θ]. The remainder is at most ½·G²·M when the ends
move by G relative to each other; M·span is tabulated. It is much smaller near a grip than
elsewhere.

**Tables** are upper bounds of figures from their values at nodes: chord ratio, elevation, and point
on the strand. Between the nodes of a cell a figure is at most the largest at its corners and, for
each coordinate, h²/8 times the largest second derivative (h the step), the remainder of linear
interpolation. The second derivatives are divided differences at the corners, twice: that they do
not change by more within a step is what the tests search for exceptions of. The coordinates of the
nodes make figures smooth everywhere: log(ρ / (1 − ρ)) for the ratio ρ; for the elevation of the
chord its steepness, arsinh of its slope; and for the point the mean of its shares of the length, of
the inclination by which the strand turns, and of θ. So the steps are small in a bend and beside it,
too, however narrow it is.
"""

import hashlib
import io
import math
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt

from swarm.errors import InputError
from swarm.files import read_bytes, write_bytes
from swarm.geometry.catenary import (
    SMALLEST_HALF_ANGLE,
    Catenaries,
    Catenary,
    max_elevation_sine,
    min_elevation_sine,
    solve,
)
from swarm.jit import cache, compiled, inner, key
from swarm.signatures import Floats1, Floats2, Floats3, Floats5, Ints1
from swarm.threads import once

Floats = npt.NDArray[np.float64]


_LARGEST_TABLE = 2**26
"""Bytes of a table that is read: those of the sensitivity are 13 MB."""


def kept(name: str, compute: Callable[[], Floats]) -> Floats:
    """Return a computed table that depends on these sources alone, from the user's cache.

    It is kept as this file's machine code is, for the same sources, compiler and processor, and as
    that computed where it is not kept or cannot be. Its digest shows what was damaged since.
    """
    try:
        path = cache() / key(__file__) / f"{name}.table"
    except OSError:  # the file has changed
        return compute()
    with suppress(InputError):
        digest, _, contents = read_bytes(path, _LARGEST_TABLE).partition(b"\n")
        if digest == hashlib.sha256(contents).hexdigest().encode():
            table: Floats = np.load(io.BytesIO(contents), allow_pickle=False)
            return table
    table, written = compute(), io.BytesIO()
    np.save(written, table)
    contents = written.getvalue()
    with suppress(InputError, OSError):  # where the cache is not writable
        path.parent.mkdir(parents=True, exist_ok=True)
        write_bytes(path, hashlib.sha256(contents).hexdigest().encode() + b"\n" + contents)
    return table


class Nodes(NamedTuple):
    """Points of strands of length 1, by chord ratio, steepness and point: angle θ and fraction.

    ``ratio`` (r,), ``steepness`` (e,), ``angle`` and ``fraction`` (r, e, p); the first and the last
    angle are those of the ends.
    """

    ratio: Floats1
    steepness: Floats1
    angle: Floats3
    fraction: Floats3


def nodes_of(ratio: Floats, steepness: Floats, steps: int) -> Nodes:
    """Return nodes for increasing chord ratios and steepnesses, with ``steps`` along a strand."""
    nodes = Nodes(ratio, steepness, *np.empty((2, len(ratio), len(steepness), steps + 1)))
    _place_nodes(nodes)
    return nodes


@compiled
def _place_nodes(nodes: Nodes) -> None:
    """Write angles and fractions: Newton's method from one point to the next."""
    steps = nodes.angle.shape[2] - 1
    for i in range(len(nodes.ratio)):
        for j in range(len(nodes.steepness)):
            span = nodes.ratio[i] / np.cosh(nodes.steepness[j])
            rise = nodes.ratio[i] * np.tanh(nodes.steepness[j])
            half, a, slope = solve(span, rise, 1.0, SMALLEST_HALF_ANGLE)
            first = np.arcsinh(slope)
            angle, fraction = nodes.angle[i, j], nodes.fraction[i, j]
            level, turned = np.arcsin(np.tanh(first)), np.arcsin(np.tanh(first + 2.0 * half))
            theta, sinh = first, np.sinh(first)
            for k in range(1, steps):
                for _ in range(3):
                    inclined = (np.arcsin(np.tanh(theta)) - level) / (turned - level)
                    shares = 0.5 * (theta - first) / half + a * (sinh - slope) + inclined
                    cosh = np.cosh(theta)
                    rate = 0.5 / half + a * cosh + 1.0 / (cosh * (turned - level))
                    theta += (3.0 * k / steps - shares) / rate
                    sinh = np.sinh(theta)
                angle[k], fraction[k] = theta, a * (sinh - slope)
            angle[0], fraction[0] = first, 0.0
            angle[steps], fraction[steps] = first + 2.0 * half, 1.0


def bounds_over_cells(nodes: Nodes, figure: Floats, parts: int) -> Floats:
    """Return upper bounds (r − 1, e − 1, parts) of a figure between adjacent nodes.

    ``figure`` (r, e, p) holds its values at the nodes; ``parts`` is the number of equal
    parts of the strand.
    """
    rows, columns, points = figure.shape
    ratio = np.log(nodes.ratio / (1.0 - nodes.ratio))
    by_ratio, by_steepness, by_point = (
        _remainder(figure, at, axis)
        for axis, at in enumerate((ratio, nodes.steepness, np.arange(float(points))))
    )
    bounds = np.zeros((rows - 1, columns - 1, parts))
    _write_parts(figure, by_ratio, by_steepness, by_point, nodes.fraction, bounds)
    return bounds


def _remainder(figure: Floats, at: Floats, axis: int) -> Floats:
    """Return the remainder of interpolation in every step along an axis, with nodes ``at``."""
    count, shape = len(at), list(figure.shape)
    shape[axis] -= 1
    errors = np.empty(shape)
    inside = int(np.prod(shape[axis + 1 :]))
    _write_remainder(
        figure.reshape(-1, count, inside), np.diff(at), errors.reshape(-1, count - 1, inside)
    )
    return errors


@compiled
def _write_remainder(figure: Floats3, width: Floats1, errors: Floats3) -> None:
    """Write the remainder in every step along the second axis, of steps with widths.

    The second derivative in a step is the larger of those at both of its nodes; the first and the
    last node have that of their neighbour.
    """
    last = len(width) - 1
    for i in range(figure.shape[0]):
        for j in range(1, last + 1):
            for k in range(figure.shape[2]):
                after = (figure[i, j + 1, k] - figure[i, j, k]) / width[j]
                before = (figure[i, j, k] - figure[i, j - 1, k]) / width[j - 1]
                errors[i, j, k] = abs(2.0 * (after - before) / (width[j - 1] + width[j]))
        for k in range(figure.shape[2]):
            errors[i, 0, k] = errors[i, 1, k]
        # errors[j] is the second derivative at node j, and then the remainder of the step after it.
        for j in range(last + 1):
            factor = 2.0 * width[j] ** 2 / 8.0
            for k in range(figure.shape[2]):
                errors[i, j, k] = factor * max(errors[i, j, k], errors[i, min(j + 1, last), k])


@compiled
def _write_parts(
    figure: Floats3, by_ratio: Floats3, by_steepness: Floats3, by_point: Floats3,
    fraction: Floats3, bounds: Floats3,
) -> None:  # fmt: skip
    """Write the largest bounds (r − 1, e − 1, parts) of the cells that reach into each part.

    The bound of a cell is the largest figure at its corners and, for each coordinate, the largest
    remainder at the four edges along it.
    """
    parts = bounds.shape[2]
    for i in range(bounds.shape[0]):
        for j in range(bounds.shape[1]):
            for k in range(figure.shape[2] - 1):
                most = ratio = steepness = point = end = 0.0
                begin = 1.0
                for a in (i, i + 1):
                    for b in (j, j + 1):
                        point = max(point, by_point[a, b, k])
                        begin = min(begin, fraction[a, b, k])
                        end = max(end, fraction[a, b, k + 1])
                        for c in (k, k + 1):
                            most = max(most, figure[a, b, c])
                for c in (k, k + 1):
                    for b in (j, j + 1):
                        ratio = max(ratio, by_ratio[i, b, c])
                    for a in (i, i + 1):
                        steepness = max(steepness, by_steepness[a, j, c])
                bound = most + ratio + steepness + point
                first = min(int(begin * parts), parts - 1)
                last = min(max(int(np.ceil(end * parts)) - 1, first), parts - 1)
                for part in range(first, last + 1):
                    bounds[i, j, part] = max(bounds[i, j, part], bound)


Ints = npt.NDArray[np.intp]

BOTH_ENDS, FAR_END, NEAR_END = 0, 1, 2
"""The ends that move: both by up to D, only the end (start fixed), only the start (end fixed)."""


LARGEST_RATIO = 0.999
"""A chord beyond this share of the length counts as taut; nothing is certified there."""

_STEP = 0.04
"""Width of a bin in −log(1 − ratio), in which a norm like 1/√(1 − ratio) grows by 2 %."""
_RATIOS = -np.expm1(-_STEP * np.arange(np.ceil(-np.log1p(-LARGEST_RATIO - 1e-9) / _STEP) + 1.0))
"""Lower ends of the bins of ratios."""
_FIRST_BINS = np.searchsorted(_RATIOS, np.arange(4096) / 4096, side="right") - 1
"""Bins in which equal shares of the ratios from 0 to 1 begin: a logarithm takes longer."""
_CLASSES = np.radians([20.0, 40.0, 60.0, 70.0, 80.0, 90.0])
"""Upper ends of the classes of chord elevation; narrow near the vertical, where norms grow."""
_SINES = np.sin(_CLASSES[:-1])
_STEEPNESS = np.concatenate([
    np.arcsinh(np.tan(np.radians(np.arange(0.0, 90.0, 5.0)))),
    [3.8, 4.7, 6.3, 8.0, 9.5, 11.0, 13.0, 16.0, 20.0, 26.0, 35.0, 50.0, 75.0, 120.0, 185.0],
])  # fmt: skip
"""Steepness of the nodes: elevations up to 85°, and up to a span of :data:`.VERTICAL`."""
_POINTS = 160
"""Steps of the nodes along a strand, two and a half for each of the smallest pieces."""
_NEARLY_ONE_PLACE = np.array([1e-12, 1e-10, 1e-8, 1e-6, 1e-5, 1e-4, 1e-3, 3e-3, 0.01, 0.02])
"""Ratios of nodes below the upper end of the first bin. Nearer ends hang as one."""
_DEPTH = 6
"""Halvings of a strand: the smallest pieces are a 64th of it."""
FINEST = 2**_DEPTH
"""Number of the smallest pieces, and the heap number of the first one."""


class EndMovement(NamedTuple):
    """Which ends of a strand move (BOTH_ENDS, FAR_END or NEAR_END), and bounds of how far, metres.

    ``size`` of each end, ``relative`` of one end relative to the other, ``longer`` of the chord's
    growth, which is not more.
    """

    ends: int
    size: float
    relative: float
    longer: float


@inner
def error_of_ends(ends: int, size: float) -> EndMovement:
    """Return the movement of ends by up to ``size`` metres in any directions."""
    relative = 2.0 * size if ends == BOTH_ENDS else size
    return EndMovement(ends, size, relative, relative)


class Sensitivity(NamedTuple):
    """Table of norms and of their integrals over the chord ratio.

    ``bounds`` has the axes (elevation class, moving ends, piece, ratio bin, 4); a piece is the
    number of a node in the binary heap of dyadic pieces. The four are norm and integral of the
    horizontal movement, and those of the vertical one: what one bound needs is close together in
    memory, because the table is larger than fast caches.
    """

    bounds: Floats5

    def largest(
        self,
        ratio: Floats,
        reach: Floats,
        sine: Floats,
        ends: npt.ArrayLike,
        piece: npt.ArrayLike,
    ) -> tuple[Floats, Floats]:
        """Return mean norms, horizontal and vertical, each (…,): movement per metre of D.

        ``ratio`` is chord / length at the nominal ends, ``reach`` the largest growth of that ratio
        during the movement, ``sine`` the largest |rise| / chord (1 if in doubt), ``ends`` one of
        BOTH_ENDS, FAR_END, NEAR_END, ``piece`` heap numbers of pieces (1 is the whole strand).
        """
        shape = np.broadcast_shapes(*map(np.shape, (ratio, reach, sine, ends, piece)))
        ratio, reach, sine = (
            np.broadcast_to(each, shape).flatten() for each in (ratio, reach, sine)
        )
        moving, part = (np.broadcast_to(each, shape).astype(np.int64) for each in (ends, piece))
        norms = np.empty((2, len(ratio)))
        _write_bounds(self, ratio, reach, sine, moving.flatten(), part.flatten(), norms)
        across, up = norms.reshape(2, *shape)
        return across, up


@compiled
def _write_bounds(
    tables: Sensitivity, ratio: Floats1, reach: Floats1, sine: Floats1, ends: Ints1, piece: Ints1,
    norms: Floats2,
) -> None:  # fmt: skip
    """Write :meth:`Sensitivity.largest` of k strands, norms (2, k)."""
    for k in range(len(ratio)):
        steep, ratios = elevation_class(sine[k]), ratio_range(ratio[k], reach[k])
        norms[0, k], norms[1, k] = movement_bound(tables, steep, ends[k], piece[k], ratios)


class RatioRange(NamedTuple):
    """Smallest and largest chord ratio during a movement, and the bins of the tables for both."""

    low: float
    high: float
    low_bin: int
    high_bin: int


@inner
def ratio_range(ratio: float, reach: float) -> RatioRange:
    """Return the range of a chord ratio that grows from ``ratio`` by at most ``reach``."""
    low = min(max(ratio, 0.0), LARGEST_RATIO)
    high = min(max(ratio + max(reach, 1e-9), 1e-9), LARGEST_RATIO + 1e-9)
    return RatioRange(low, high, _bin(low), _bin(high))


@inner
def elevation_class(sine: float) -> int:
    """Return the elevation class of a chord whose sine of elevation is at most ``sine``."""
    return find_class(sine, _SINES)


@inner
def find_class(sine: float, sines: Floats) -> int:
    """Return the first of increasing classes that includes a sine, or their number."""
    index = 0
    while index < len(sines) and sines[index] < sine:
        index += 1
    return index


@inner
def _tabulated(piece: int) -> int:
    """Return the smallest piece in the tables that contains a piece."""
    while piece >= 2 * FINEST:
        piece //= 2
    return piece


@inner
def finest_piece(piece: int, fraction: float) -> int:
    """Return the smallest piece in the tables that contains a point, within a given piece.

    Table entries of two neighbours may differ much: for a point at the end of the given piece, the
    neighbour inside that piece counts.
    """
    first = last = _tabulated(piece)
    while first < FINEST:
        first, last = 2 * first, 2 * last + 1
    point: int = min(max(FINEST + int(fraction * FINEST), first), last)
    return point


@inner
def movement_bound(
    tables: Sensitivity, steep: int, ends: int, piece: int, ratios: RatioRange
) -> tuple[float, float]:
    """Return :meth:`Sensitivity.largest` of one strand; ``steep`` is its elevation class."""
    bounds = tables.bounds[steep, ends, _tabulated(piece)]
    return _mean(bounds, 0, ratios), _mean(bounds, 2, ratios)


@inner
def chord_response(
    rise: float, span: float, length: float, moved: EndMovement, piece: int, tables: Sensitivity
) -> tuple[float, float]:
    """Return :meth:`Sensitivity.largest` of a strand with a chord of ``rise`` and ``span``."""
    steep, ratios = chord_range(rise, span, length, moved.relative)
    return movement_bound(tables, steep, moved.ends, piece, ratios)


@inner
def chord_range(rise: float, span: float, length: float, relative: float) -> tuple[int, RatioRange]:
    """Return the elevation class and the ratios of a chord of ``rise`` and ``span``.

    Its ends move by up to ``relative`` metres, relative to each other.
    """
    ratio = np.sqrt(span * span + rise * rise) / length
    steep = elevation_class(max_elevation_sine(rise, span, relative))
    return steep, ratio_range(ratio, relative / length)


@inner
def _mean(bounds: Floats, norm: int, ratios: RatioRange) -> float:
    """Return the mean norm over a range of ratios; ``bounds`` (bins, 4) are those of a piece.

    ``norm`` is the column of the norm, before that of its integral.
    """
    low, high = ratios.low_bin, ratios.high_bin
    at_high = float(bounds[high, norm])
    if low == high:
        return at_high
    to_low = bounds[low, norm + 1] + bounds[low, norm] * (ratios.low - _RATIOS[low])
    to_high = bounds[high, norm + 1] + at_high * (ratios.high - _RATIOS[high])
    mean = float((to_high - to_low) / max(ratios.high - ratios.low, 1e-12))
    return min(mean, at_high)


@compiled
def _bin(ratio: float) -> int:
    """Return the bin of a ratio, from 0 on."""
    index: int = _FIRST_BINS[int(ratio * len(_FIRST_BINS))]
    while index + 1 < len(_RATIOS) and _RATIOS[index + 1] <= ratio:
        index += 1
    return index


@once
def sensitivity_tables() -> Sensitivity:
    """Return the tables; computed once, in about half a second."""
    return Sensitivity(kept("sensitivity", _bounds))


def _bounds() -> Floats:
    """Return :attr:`Sensitivity.bounds`."""
    bins = _bin(LARGEST_RATIO + 1e-9) + 1
    edges = -np.expm1(-_STEP * np.arange(1, bins + 1))
    nodes = nodes_of(np.concatenate([_NEARLY_ONE_PLACE, edges]), _STEEPNESS, _POINTS)
    norms = np.empty((2, 2, *nodes.angle.shape))
    _write_norms(nodes, norms)

    def bounds(figure: Floats) -> Floats:
        return bounds_over_cells(nodes, figure, FINEST)

    start, end, both = (
        np.stack([bounds(figure) for figure in (*norms[:, 0], *norms[:, 1], *norms.sum(axis=1))])
        .reshape(3, 2, len(nodes.ratio) - 1, len(nodes.steepness) - 1, FINEST)
    )  # fmt: skip
    # A descending chord is the same strand from its other end.
    both = np.maximum(both, both[..., ::-1])
    far = np.maximum(end, start[..., ::-1])
    kinds = np.stack([both, far, far[..., ::-1]])  # (kind, direction, bin, steepness, piece)
    most = np.append(np.arcsinh(np.tan(_CLASSES[:-1])), np.inf) - 1e-9  # a class begins at a node
    by_class = np.stack([kinds[..., _STEEPNESS[:-1] < each, :].max(axis=3) for each in most])
    by_class = np.maximum.accumulate(by_class, axis=3)[:, :, :, len(_NEARLY_ONE_PLACE) - 1 :]
    norm = _over_pieces(by_class)
    width = np.diff(np.concatenate([[0.0], edges]))
    integral = np.zeros_like(norm)
    integral[..., 1:, :] = np.cumsum(norm * width[:, None], axis=-2)[..., :-1, :]
    columns = [table[:, :, direction] for direction in (0, 1) for table in (norm, integral)]
    return np.ascontiguousarray(np.stack(columns, axis=-1).swapaxes(2, 3))


def _over_pieces(finest: Floats) -> Floats:
    """Return the largest value over every dyadic piece, in heap order, from the finest ones."""
    count = finest.shape[-1]
    heap = np.zeros((*finest.shape[:-1], 2 * count))
    heap[..., count:] = finest
    for piece in range(count - 1, 0, -1):
        heap[..., piece] = np.maximum(heap[..., 2 * piece], heap[..., 2 * piece + 1])
    return heap


@compiled
def _write_norms(nodes: Nodes, norms: Floats5) -> None:
    """Write the norms of A and B at all nodes: of the horizontal rows and of the vertical one.

    ``norms`` has the axes (direction, end, ratio, elevation, point). In the strand's plane
    B = K(s) K(ℓ)⁻¹ (see above); across it, both turn about the start.
    """
    for i in range(nodes.angle.shape[0]):
        for j in range(nodes.angle.shape[1]):
            angle = nodes.angle[i, j]
            whole = response_between(angle[0], angle[-1])
            for k in range(len(angle)):
                xx, xz, zx, zz = share_of(response_between(angle[0], angle[k]), whole)
                across = (angle[k] - angle[0]) / (angle[-1] - angle[0])
                norms[0, 0, i, j, k] = max(math.hypot(1.0 - xx, xz), 1.0 - across)
                norms[1, 0, i, j, k] = math.hypot(zx, 1.0 - zz)
                norms[0, 1, i, j, k] = max(math.hypot(xx, xz), across)
                norms[1, 1, i, j, k] = math.hypot(zx, zz)


@inner
def share_of(
    part: tuple[float, float, float], whole: tuple[float, float, float]
) -> tuple[float, float, float, float]:
    """Return B = K(s) K(ℓ)⁻¹ by rows, from K of the part up to s and of the whole strand."""
    bent, level, cross = whole
    determinant = bent * level - cross * cross
    return (
        (part[0] * level - part[2] * cross) / determinant,
        (part[2] * bent - part[0] * cross) / determinant,
        (part[2] * level - part[1] * cross) / determinant,
        (part[1] * bent - part[2] * cross) / determinant,
    )


@inner
def response_between(first: float, last: float) -> tuple[float, float, float]:
    """Return K₁₁, K₂₂ and K₁₂ of the part of a strand between two angles, without cancellation."""
    turned, inverse = last - first, 1.0 / (np.cosh(first) * np.cosh(last))
    level = np.sinh(turned) * inverse
    cross = -2.0 * np.sinh(0.5 * (last + first)) * np.sinh(0.5 * turned) * inverse
    return turned - level, level, cross


Numbers = TypeVar("Numbers", float, Floats)

_BANDS = np.array([0.0, 20.0, 40.0, 60.0, 70.0, 76.0, 80.0, 84.0, 88.0])
"""Bands of chord elevation, in degrees; narrow where second derivatives grow, near the vertical."""
_BAND_SINES = np.sin(np.radians(_BANDS[1:]))
_BINS = 48
"""Bins of the chord ratio, equally wide in log(1 − ratio): 1 − ratio falls by 13 % in each."""
_MOVEMENT_STEPS = 2
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
    responses = np.empty((3, len(up)))
    _responses(
        np.stack([strands.length, strands.parameter, strands.slope, strands.span, strands.rise]),
        np.stack([along, up, fraction, *piece, stretch]), ends, curvature_table(), responses,
    )  # fmt: skip
    known = np.isfinite(responses[0])
    at_point, per_arc, curvature = np.where(known, responses, 0.0)
    return LinearResponse(at_point, per_arc, curvature, known)


@compiled
def _responses(
    strands: Floats2, points: Floats2, ends: Ints1, table: Floats3, responses: Floats2
) -> None:
    """Write :func:`linear_response` (3, b) of strands (5, b): at the point, per arc, and curvature.

    All are infinite where the response is not known.

    ``points`` (6, b) holds the two parts of normals, fractions, begins and ends of pieces, and
    stretches.
    """
    for k in range(len(ends)):
        length, parameter, slope, span, rise = strands[:, k]
        along, up, fraction, begin, end, stretch = points[:, k]
        strand = Catenary(length, parameter, slope, span, rise)
        moved = EndMovement(ends[k], np.inf, stretch, stretch)
        point = point_response(strand, (along, up), fraction)
        at_point, per_arc = first_order(strand, point, (begin, end), ends[k])
        bent = curvature(strand, (begin, end), moved, table)
        known = np.isfinite(at_point + bent)
        responses[0, k] = at_point if known else np.inf
        responses[1, k] = per_arc if known else np.inf
        responses[2, k] = bent if known else np.inf


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
def first_order(
    strand: Catenary, point: PointResponse, piece: tuple[float, float], ends: int
) -> tuple[float, float]:
    """Return the first order of :func:`linear_response`: at the point, and per arc.

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
    first = find_class(min_elevation_sine(strand.rise, strand.span, stretch), _BAND_SINES)
    last = find_class(max_elevation_sine(strand.rise, strand.span, stretch), _BAND_SINES)
    if last >= len(_BAND_SINES):
        return np.inf
    chord = np.sqrt(strand.span * strand.span + strand.rise * strand.rise)
    mean = 0.0
    for step in range(_MOVEMENT_STEPS):
        share = (step + 1) / _MOVEMENT_STEPS
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
        mean += (2 * (_MOVEMENT_STEPS - step) - 1) / _MOVEMENT_STEPS**2 * largest / narrowest
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
    return kept("curvature", _curvatures)


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
def _write_second(nodes: Nodes, directions: Floats2, turns: Floats2, figure: Floats3) -> None:
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
                figure[i, j, k] = turned * math.sqrt(largest)


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
