"""Sensitivity of a strand to its ends: tabulated upper bounds of the movement of its points.

A point x(f) of a catenary, f a share of its arc length, depends on both ends p₀, p₁ with the
Jacobians A(f) = ∂x/∂p₀ and B(f) = ∂x/∂p₁, A + B = 1. They depend on the chord as a share ρ of the
length, on the chord's elevation, and on f; close to taut they grow like 1/√(1 − ρ). Ends that move
by up to D along straight lines move a point by at most D times the mean of ‖A‖ + ‖B‖ along the
movement, and during it ρ grows at most linearly to ρ + 2D/ℓ. So the tables hold, for every ρ and
for dyadic pieces of the strand, the largest norm over all chords that are not longer and not
steeper, and its integral over ρ. Horizontal and vertical movement have separate tables, since a
strand that gets tauter rises.
"""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from swarm.geometry.catenary_kernel import max_elevation_sine
from swarm.geometry.shape_tables import Nodes, bounds_over_cells, kept, nodes_of
from swarm.jit import compiled, inner
from swarm.signatures import Floats1, Floats2, Floats5, Ints1
from swarm.threads import once

Floats = npt.NDArray[np.float64]
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
        moves = _Movements(ratio, reach, sine, moving.flatten(), part.flatten())
        found = np.empty((2, len(ratio)))
        _write_bounds(self, moves, found)
        across, up = found.reshape(2, *shape)
        return across, up


class _Movements(NamedTuple):
    """Arguments (k,) of :meth:`Sensitivity.largest`."""

    ratio: Floats1
    reach: Floats1
    sine: Floats1
    ends: Ints1
    piece: Ints1


@compiled
def _write_bounds(tables: Sensitivity, moves: _Movements, found: Floats2) -> None:
    """Write :meth:`Sensitivity.largest` of k strands, found (2, k)."""
    for k in range(len(moves.ratio)):
        steep = elevation_class(moves.sine[k])
        ratios = ratio_range(moves.ratio[k], moves.reach[k])
        found[0, k], found[1, k] = movement_bound(
            tables, steep, moves.ends[k], moves.piece[k], ratios
        )


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
    found = 0
    while found < len(sines) and sines[found] < sine:
        found += 1
    return found


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
    found: int = _FIRST_BINS[int(ratio * len(_FIRST_BINS))]
    while found + 1 < len(_RATIOS) and _RATIOS[found + 1] <= ratio:
        found += 1
    return found


@once
def sensitivity_tables() -> Sensitivity:
    """Return the tables; computed once, in about half a second."""
    return Sensitivity(kept(__file__, "sensitivity", _bounds))


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
    B = K(s) K(ℓ)⁻¹ (:mod:`.linear_response`); across it, both turn about the start.
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
