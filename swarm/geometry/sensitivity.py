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

from functools import cache
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from swarm.geometry.catenary import solve_catenaries
from swarm.geometry.catenary_kernel import max_elevation_sine
from swarm.jit import compiled, inner
from swarm.signatures import Floats1, Floats2, Floats5, Ints1

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
_OVERLAP = 0.08
"""Radians beyond a class whose samples count for it: more than the distance of two samples."""
_DEPTH = 6
"""Halvings of a strand: the smallest pieces are a 64th of it."""
FINEST = 2**_DEPTH
"""Number of the smallest pieces, and the heap number of the first one."""
_INFLATION = 1.02
"""Covers elevations between the samples; the tests check it adversarially."""


class EndMovement(NamedTuple):
    """Which ends of a strand move (BOTH_ENDS, FAR_END or NEAR_END), and bounds of how far, metres.

    ``size`` of each end, ``relative`` of one end relative to the other.
    """

    ends: int
    size: float
    relative: float


@inner
def error_of_ends(ends: int, size: float) -> EndMovement:
    """Return the movement of ends by up to ``size`` metres in any directions."""
    return EndMovement(ends, size, 2.0 * size if ends == BOTH_ENDS else size)


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


@cache
def sensitivity_tables() -> Sensitivity:
    """Return the tables; computed once, in about 0.2 s."""
    bins = _bin(LARGEST_RATIO + 1e-9) + 1
    upper = -np.expm1(-_STEP * np.arange(1, bins + 1))
    nearly_vertical = [89.0, 89.8, 89.96, 89.99, 89.999]
    elevation = np.radians(np.concatenate([np.arange(0.0, 90.0, 4.0), nearly_vertical]))
    fractions = np.linspace(0.0, 1.0, 2**_DEPTH + 1)
    start, end = _jacobian_norms(upper[:, None], elevation[None, :], fractions)
    # A descending chord is the same strand from its other end.
    both = start + end
    far = np.maximum(end, start[..., ::-1])
    both = np.maximum(both, both[..., ::-1])
    kinds = np.stack([both, far, far[..., ::-1]])  # (kind, direction, bin, elevation, fraction)
    kinds = np.maximum.accumulate(kinds, axis=2) * _INFLATION
    by_class = np.stack(
        [kinds[:, :, :, elevation <= steepest + _OVERLAP].max(axis=3) for steepest in _CLASSES]
    )
    norm = _over_pieces(by_class)
    width = np.diff(np.concatenate([[0.0], upper]))
    integral = np.zeros_like(norm)
    integral[..., 1:, :] = np.cumsum(norm * width[:, None], axis=-2)[..., :-1, :]
    columns = [table[:, :, direction] for direction in (0, 1) for table in (norm, integral)]
    return Sensitivity(np.ascontiguousarray(np.stack(columns, axis=-1).swapaxes(2, 3)))


def _over_pieces(by_fraction: Floats) -> Floats:
    """Return the largest value over every dyadic piece and its neighbours, in heap order."""
    cells = np.maximum(by_fraction[..., :-1], by_fraction[..., 1:])
    wider = cells.copy()
    wider[..., 1:] = np.maximum(wider[..., 1:], cells[..., :-1])
    wider[..., :-1] = np.maximum(wider[..., :-1], cells[..., 1:])
    count = wider.shape[-1]
    heap = np.zeros((*wider.shape[:-1], 2 * count))
    heap[..., count:] = wider
    for piece in range(count - 1, 0, -1):
        heap[..., piece] = np.maximum(heap[..., 2 * piece], heap[..., 2 * piece + 1])
    return heap


def _jacobian_norms(ratio: Floats, elevation: Floats, fractions: Floats) -> tuple[Floats, Floats]:
    """Return the norms of A and B, each (2, …, k): of the horizontal rows and of the vertical one.

    The strand has length 1 and parameters (a, s), a the catenary's, s = sinh θ₀ the slope at its
    start: sinh θ = s + f/a, x = a(θ − θ₀), z = a(cosh θ − cosh θ₀). Both x(f) and the end x(1) are
    differentiated by (a, s), and B = ∂x(f) (∂x(1))⁻¹ in the strand's plane. Across it, both turn
    about the start: B = x(f) / x(1).
    """
    ratio, elevation = np.broadcast_arrays(ratio, elevation)
    end = np.stack(
        [ratio * np.cos(elevation), np.zeros_like(ratio), ratio * np.sin(elevation)], axis=-1
    )
    strand = solve_catenaries(np.zeros(3), end, np.ones_like(ratio))
    a, slope = strand.parameter[..., None], strand.slope[..., None]
    first, last = np.arcsinh(slope), np.arcsinh(slope + 1.0 / a)
    turned = np.arcsinh(slope + fractions / a)

    def by_parameters(theta: Floats, fraction: npt.ArrayLike) -> tuple[Floats, ...]:
        share = np.asarray(fraction) / a
        return (
            (theta - first) - share / np.cosh(theta),
            a * (1.0 / np.cosh(theta) - 1.0 / np.cosh(first)),
            np.cosh(theta) - np.cosh(first) - np.tanh(theta) * share,
            a * (np.tanh(theta) - np.tanh(first)),
        )

    x_a, x_s, z_a, z_s = by_parameters(turned, fractions)
    w_a, w_s, v_a, v_s = by_parameters(last, 1.0)
    determinant = w_a * v_s - w_s * v_a
    b_xw, b_xv = (x_a * v_s - x_s * v_a) / determinant, (x_s * w_a - x_a * w_s) / determinant
    b_zw, b_zv = (z_a * v_s - z_s * v_a) / determinant, (z_s * w_a - z_a * w_s) / determinant
    across = (turned - first) / (last - first)
    return (
        np.stack(
            [np.maximum(np.hypot(1.0 - b_xw, b_xv), 1.0 - across), np.hypot(b_zw, 1.0 - b_zv)]
        ),
        np.stack([np.maximum(np.hypot(b_xw, b_xv), across), np.hypot(b_zw, b_zv)]),
    )
