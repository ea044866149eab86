"""How a strand answers small movements of its ends: exactly to first order, bounded beyond.

Where a strand is near its nominal shape this is much sharper than :mod:`.sensitivity`, which asks
for the worst of all shapes. In the strand's plane, with the unit normal ν and the tension T per
weight of a metre (Routh, *Statics*, § 443; the cable turns by ν·δF/T where forces change by δF),

    K(s) = ∫₀ˢ ν νᵀ / T,    B(s) = K(s) K(ℓ)⁻¹,    A = 1 − B,

and across the plane B is the share of the span. K is elementary in θ, sinh θ the slope:
K₁₁ = [θ − tanh θ], K₂₂ = [tanh θ], K₁₂ = [sech θ]. What is beyond the first order is at most
½·G²·M when the ends move by G relative to each other; M·span is tabulated.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np
import numpy.typing as npt

from swarm.cable.catenary import Catenaries, hang
from swarm.preflight.sensitivity import BOTH_ENDS, FAR_END, LARGEST_RATIO

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.intp]

_INFLATION = 1.1
_CLASSES = np.radians([20.0, 40.0, 60.0, 80.0])
_BINS = 48


@dataclass(frozen=True, eq=False)
class Response:
    """First-order answer of points of strands, and what lies beyond; all (b,).

    ``at_point`` is the largest movement along a direction per metre by which the ends move;
    ``per_arc`` how much that can differ a metre of cable farther on; ``curvature`` is M, per metre.
    ``known`` is false where the strand is too steep or too short a span to say.
    """

    at_point: Floats
    per_arc: Floats
    curvature: Floats
    known: npt.NDArray[np.bool_]

    def movement(self, size: Floats, relative: Floats) -> Floats:
        """Bound the movement (b,) of the points when the ends move by ``size``.

        ``relative`` (b,) bounds how far they move relative to each other. Infinite where unknown.
        """
        bound = self.at_point * size + 0.5 * self.curvature * relative * relative
        return np.where(self.known, bound, np.inf)

    def elsewhere(self, arc: Floats, relative: Floats) -> Floats:
        """How much farther points up to ``arc`` (b,) metres along may move."""
        return np.where(self.known, self.per_arc * arc * relative, np.inf)


def response(
    strands: Catenaries,
    fraction: Floats,
    ends: Ints,
    normal: Floats,
    piece: tuple[Floats, Floats],
    stretch: Floats,
    sine: Floats,
) -> Response:
    """Return the response of strands (b,) at fractions (b,) along unit vectors (b, 3).

    ``ends`` says which ends move; ``piece`` gives the fractions between which ``per_arc`` must
    hold. ``stretch`` (b,) is how far the ends may move relative to each other and ``sine`` (b,) the
    largest |rise| / chord on the way.
    """
    up = -np.einsum("bi,bi->b", normal, strands.down)
    along = np.einsum("bi,bi->b", normal, strands.heading)
    across = np.sqrt(np.maximum(1.0 - up * up - along * along, 0.0))
    turn = strands.length / strands.parameter
    first, last, here, begin, end = (
        np.arcsinh(strands.slope + share * turn) for share in (0.0, 1.0, fraction, *piece)
    )
    whole, part = _stiffness(first, last), _stiffness(first, here)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        determinant = whole[0] * whole[2] - whole[1] ** 2
        # q = K(ℓ)⁻¹ K(s) n, the transposed response of the point in the plane.
        pulled = part[0] * along + part[1] * up, part[1] * along + part[2] * up
        in_plane = (
            (whole[2] * pulled[0] - whole[1] * pulled[1]) / determinant,
            (whole[0] * pulled[1] - whole[1] * pulled[0]) / determinant,
        )
        share = (here - first) / (last - first)
        by_end = np.sqrt(in_plane[0] ** 2 + in_plane[1] ** 2 + (share * across) ** 2)
        by_start = np.sqrt(
            (along - in_plane[0]) ** 2 + (up - in_plane[1]) ** 2 + ((1.0 - share) * across) ** 2
        )
        trace = whole[0] + whole[2]
        softest = 0.5 * (trace + np.sqrt(np.maximum(trace**2 - 4.0 * determinant, 0.0)))
        lowest = np.where(begin * end <= 0.0, 0.0, np.minimum(np.abs(begin), np.abs(end)))
        flattest = np.cosh(np.minimum(lowest, 300.0))
        per_arc = np.maximum(
            softest / determinant / (strands.parameter * flattest), 1.0 / (strands.span * flattest)
        )
        curvature = _curvature(strands, stretch, sine)
        answer = np.where(
            ends == BOTH_ENDS, by_start + by_end, np.where(ends == FAR_END, by_end, by_start)
        )
    known = (determinant > 1e-12) & np.isfinite(answer + per_arc + curvature)
    return Response(
        np.where(known, answer, 0.0),
        np.where(known, per_arc, 0.0),
        np.where(known, curvature, 0.0),
        known,
    )


def _stiffness(first: Floats, last: Floats) -> tuple[Floats, Floats, Floats]:
    """K₁₁, K₁₂, K₂₂ between two angles."""
    level = np.tanh(last) - np.tanh(first)
    cross = 1.0 / np.cosh(np.clip(last, -300.0, 300.0)) - 1.0 / np.cosh(np.clip(first, -300, 300))
    return (last - first) - level, cross, level


def _curvature(strands: Catenaries, stretch: Floats, sine: Floats) -> Floats:
    """Upper bound of M while the ends move by up to ``stretch`` relative to each other."""
    chord = np.hypot(strands.span, strands.rise)
    ratio = (chord + stretch) / strands.length
    narrowest = strands.span - stretch
    steepness = np.searchsorted(np.sin(_CLASSES), sine)
    column = np.minimum(_column(np.minimum(ratio, LARGEST_RATIO)), _BINS - 1)
    table = curvatures()
    bound = table[np.minimum(steepness, len(_CLASSES) - 1), column] / narrowest
    possible = (
        (narrowest > 0.05 * strands.length) & (steepness < len(_CLASSES)) & (ratio < LARGEST_RATIO)
    )
    return np.where(possible, bound, np.inf)


def _column(ratio: Floats) -> Ints:
    column: Ints = np.floor(np.log1p(-ratio) / np.log1p(-LARGEST_RATIO) * _BINS).astype(np.intp)
    return column


@cache
def curvatures() -> Floats:
    """Largest second derivative times span over ratios up to a bin's end: (elevation class, bin).

    By central differences over all fractions and directions, for strands of length 1.
    """
    upper = -np.expm1(np.log1p(-LARGEST_RATIO) * np.arange(1, _BINS + 1) / _BINS)
    elevation = np.radians([0.0, 10.0, 20.0, 30.0, 40.0, 50.0, 60.0, 70.0, 80.0])
    ratio, steep = np.meshgrid(upper, elevation, indexing="ij")
    end = np.stack([ratio * np.cos(steep), 0.0 * ratio, ratio * np.sin(steep)], axis=-1)
    angle = np.linspace(0.0, np.pi, 12, endpoint=False)
    in_plane = np.stack([np.cos(angle), 0.0 * angle, np.sin(angle)], axis=-1)
    sideways = [[0.0, 1.0, 0.0], [0.7071, 0.7071, 0.0], [0.0, 0.7071, 0.7071]]
    ways = np.concatenate([in_plane, sideways])
    step = 1e-3 * np.minimum(1.0 - ratio, np.minimum(0.3, ratio * np.cos(steep)))[..., None]
    fractions = np.linspace(0.0, 1.0, 33)[1:-1]
    largest = np.zeros_like(ratio)
    still = hang(np.zeros(3), end, 1.0).points(fractions)
    for way in ways:
        ahead = hang(np.zeros(3), end + step * way, 1.0).points(fractions)
        back = hang(np.zeros(3), end - step * way, 1.0).points(fractions)
        second = (ahead - 2.0 * still + back) / step[..., None] ** 2
        largest = np.maximum(largest, np.linalg.norm(second, axis=-1).max(axis=-1))
    scaled = np.maximum.accumulate(_INFLATION * largest * end[..., 0], axis=0)
    return np.stack([scaled[:, elevation <= most + 0.01].max(axis=1) for most in _CLASSES])
