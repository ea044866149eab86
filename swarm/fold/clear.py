"""How much the things of a team miss the distances that they should keep: costs for the planner.

Quick and sampled, for choosing among many motions; what holds for certain is said by the
certificate alone. All distances are between nominal places, so each asks for what tracking errors
may eat on top of the clearance. A strand answers its ends the more, the tauter it is.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from swarm.cable.catenary import hang
from swarm.cable.distance import polyline_polyline

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.intp]
Index = Any

PIECES = 6
"""A strand is handled as this many chords."""

_RATIOS = np.array([0.0, 0.3, 0.5, 0.7, 0.8, 0.85, 0.9, 0.93, 0.95, 0.97, 1.0])
_LIFTS = np.array([0.1, 0.15, 0.25, 0.5, 0.75, 1.0, 1.55, 2.3, 3.6, 5.0, 8.0])
"""What the middle of a level strand moves vertically per metre of both ends, over one, by ratio."""


@dataclass(frozen=True)
class Margins:
    """Clearances in metres, and what else the distances of a team depend on.

    ``cable`` counts from axis to axis of two strands, ``vehicle`` and ``downwash`` between
    vehicles, ``vehicle_cable`` from a vehicle to a strand's axis. ``tracking`` is the radius of the
    tracking ball; ``radius`` and ``grip_offset`` describe the vehicle. ``hand`` is how much
    cable on either side of a vehicle need not keep apart from the neighbouring segment's.
    ``spacing`` is the preferred chord of a segment in motion, as a share of its length, and
    ``taut`` the largest one, less what two tracking errors add. Neighbouring segments keep
    ``beside`` metres more than others.
    """

    cable: float
    vehicle: float
    downwash: float
    vehicle_cable: float
    tracking: float
    radius: float
    grip_offset: float
    hand: float = 0.0
    spacing: float = 0.85
    taut: float = 0.985
    beside: float = 0.0


@dataclass(frozen=True, eq=False)
class Strands:
    """Hanging strands: points (…, PIECES + 1, 3), their boxes, chord per length and length (…,)."""

    points: Floats
    middle: Floats
    reach: Floats
    ratio: Floats
    length: Floats

    def __getitem__(self, which: Index) -> "Strands":
        return Strands(
            self.points[which],
            self.middle[which],
            self.reach[which],
            self.ratio[which],
            self.length[which],
        )

    def flat(self) -> "Strands":
        """All strands in one row."""
        return Strands(
            self.points.reshape(-1, *self.points.shape[-2:]),
            self.middle.reshape(-1, 3),
            self.reach.reshape(-1, 3),
            self.ratio.reshape(-1),
            self.length.reshape(-1),
        )


def together(one: Strands, other: Strands) -> Strands:
    """Two rows of strands as one."""
    return Strands(
        np.concatenate([one.points, other.points]),
        np.concatenate([one.middle, other.middle]),
        np.concatenate([one.reach, other.reach]),
        np.concatenate([one.ratio, other.ratio]),
        np.concatenate([one.length, other.length]),
    )


def strands(start: Floats, end: Floats, length: npt.ArrayLike) -> Strands:
    """Hang strands of given lengths between ends (…, 3); over-stretched ones are straight."""
    chord = np.linalg.norm(end - start, axis=-1)
    length = np.broadcast_to(np.asarray(length, dtype=np.float64), chord.shape)
    enough = np.maximum(length, chord * 1.001 + 1e-9)
    points = hang(start, end, enough).points(np.linspace(0.0, 1.0, PIECES + 1))
    low, high = points.min(axis=-2), points.max(axis=-2)
    return Strands(points, 0.5 * (low + high), 0.5 * (high - low), chord / length, length)


def strand_cost(one: Strands, other: Strands, margins: Margins) -> Floats:
    """Cost (b,) of strands being too close to others, pair by pair; they do not share a vehicle."""
    unit = margins.cable + 2.0 * margins.tracking
    return shortfall(_margin(one, other, margins) / unit)


def heights_over(one: Strands, other: Strands) -> Floats:
    """How high (b,) strands pass over others where they cross in plan view, 0 where they do not."""
    here, there = meeting(one, other)
    gap_over = np.zeros(len(here))
    which = np.flatnonzero((here > 0.0) & (here < 1.0) & (there > 0.0) & (there < 1.0))
    if len(which):
        above = _height_at(one.points[which], here[which])
        gap_over[which] = above - _height_at(other.points[which], there[which])
    return gap_over


def meeting(one: Strands, other: Strands) -> tuple[Floats, Floats]:
    """Where strands (b) and others meet in plan view, as shares (b,) of their spans, 0…1 within.

    A strand hangs in a vertical plane, so from above both are straight.
    """
    p, q = one.points[:, 0, :2], other.points[:, 0, :2]
    return shares(p, one.points[:, -1, :2] - p, q, other.points[:, -1, :2] - q)


def shares(p: Floats, u: Floats, q: Floats, w: Floats) -> tuple[Floats, Floats]:
    """Shares (b,) of u (b, 2) and w at which lines from p along u and from q along w meet.

    Where they are parallel they meet at infinity.
    """
    area = _cross(u, w)
    parallel = np.abs(area) < 1e-12
    area = np.where(parallel, 1.0, area)
    here, there = _cross(q - p, w) / area, _cross(q - p, u) / area
    return np.where(parallel, np.inf, here), np.where(parallel, np.inf, there)


def _cross(one: Floats, other: Floats) -> Floats:
    product: Floats = one[..., 0] * other[..., 1] - one[..., 1] * other[..., 0]
    return product


def _height_at(points: Floats, share: Floats) -> Floats:
    """Height of strands at shares (b,) of their spans in plan view."""
    span = points[:, -1, :2] - points[:, 0, :2]
    along = np.einsum("bkx,bx->bk", points[:, :, :2] - points[:, :1, :2], span)
    along /= np.maximum(along[:, -1:], 1e-12)
    piece = np.clip((along <= share[:, None]).sum(axis=1) - 1, 0, points.shape[1] - 2)
    row = np.arange(len(points))
    before, after = along[row, piece], along[row, piece + 1]
    part = (share - before) / np.maximum(after - before, 1e-12)
    height: Floats = points[row, piece, 2] * (1.0 - part) + points[row, piece + 1, 2] * part
    return height


def diverging(
    before: Strands, after: Strands, margins: Margins, free_before: Floats, free_after: Floats
) -> npt.NDArray[np.bool_]:
    """Whether strands (…, m) leave their vehicle to opposite sides, and far enough after the hand.

    Each lies in a vertical plane and only gets farther from the vehicle in plan view; so where the
    headings are at right angles or more, neither comes nearer to the other than it is to the
    vehicle. ``free_before`` and ``free_after`` (m,) are the shares that are not in the hand.
    """
    at = after.points[..., 0, :2]
    back, ahead = before.points[..., 0, :2] - at, after.points[..., -1, :2] - at
    opposite = np.einsum("...x,...x->...", back, ahead) <= 0.0
    one, two = _point(before.points, free_before), _point(after.points, 1.0 - free_after)
    near = np.minimum(
        np.linalg.norm(one[..., :2] - at, axis=-1), np.linalg.norm(two[..., :2] - at, axis=-1)
    )
    enough = 1.3 * margins.cable + margins.beside + 2.6 * margins.tracking
    found: npt.NDArray[np.bool_] = opposite & (near > enough)
    return found


def _point(points: Floats, share: Floats) -> Floats:
    """Points (…, m, 3) of strands at a share of each (m,)."""
    piece = np.minimum((share * PIECES).astype(np.intp), PIECES - 1)
    rest = (share * PIECES - piece)[:, None]
    row = np.arange(len(share))
    found: Floats = (
        points[..., row, piece, :] * (1.0 - rest) + points[..., row, piece + 1, :] * rest
    )
    return found


def cut(points: Floats, shares: Floats) -> Floats:
    """Points (q, k, 3) of strands (q) at shares (q, k) of their length."""
    piece = np.minimum((shares * PIECES).astype(np.intp), PIECES - 1)
    rest = (shares * PIECES - piece)[..., None]
    row = np.arange(len(points))[:, None]
    found: Floats = points[row, piece] * (1.0 - rest) + points[row, piece + 1] * rest
    return found


def _margin(one: Strands, other: Strands, margins: Margins) -> Floats:
    """Distance (b,) of strands, less what they should keep."""
    found = closest(one.points, other.points)
    error = movement(one.ratio, found.here / PIECES, found.upright)
    error += movement(other.ratio, found.there / PIECES, found.upright)
    return found.distance - margins.cable - margins.tracking * error


@dataclass(frozen=True, eq=False)
class Closest:
    """Distances (q,), unit vectors (q, 3) from second to first, and pieces where these are.

    ``upright`` (q,) is how much of these vectors is vertical; all of it where things touch.
    """

    distance: Floats
    normal: Floats
    upright: Floats
    here: Floats
    there: Floats


def closest(one: Floats, other: Floats) -> Closest:
    """Where polylines (q, k, 3) are closest to others, pair by pair."""
    found = polyline_polyline(one, other)
    apart = _point_at(one, found.first) - _point_at(other, found.second)
    normal = apart / np.maximum(found.distance, 1e-6)[:, None]
    upright = np.where(found.distance > 1e-3, np.minimum(np.abs(normal[:, 2]), 1.0), 1.0)
    return Closest(found.distance, normal, upright, found.first, found.second)


def _point_at(points: Floats, place: Floats) -> Floats:
    """Points (q, 3) of polylines (q, k, 3) at places: index of the piece plus fraction along it."""
    piece = np.minimum(place.astype(np.intp), points.shape[1] - 2)
    row = np.arange(len(points))
    share = (place - piece)[:, None]
    found: Floats = (1.0 - share) * points[row, piece] + share * points[row, piece + 1]
    return found


def lift(ratio: Floats) -> Floats:
    """How far the middle of a level strand moves vertically per metre of both its ends."""
    moved: Floats = 1.0 + np.interp(ratio, _RATIOS, _LIFTS)
    return moved


def movement(ratio: Floats, fraction: Floats, upright: Floats) -> Floats:
    """Movement of a strand's point per metre of its ends, along a direction this much upright."""
    bulge = 4.0 * fraction * (1.0 - fraction)
    vertical = 1.0 + (lift(ratio) - 1.0) * bulge
    level = 1.0 + 0.45 * bulge
    return _along(level, vertical, upright)


def _along(level: Floats, vertical: Floats, upright: Floats) -> Floats:
    moved: Floats = level * np.sqrt(1.0 - upright**2) + vertical * upright
    return moved


_FROM_GRIP = np.array([0.0, 0.1, 0.17, 0.25, 0.5, 0.75, 1.0])
_FAR_LEVEL = np.array([0.0, 0.3, 0.44, 0.55, 0.84, 1.0, 1.02])
_FAR_STEEP = np.array([0.3, 0.6, 0.7, 0.75, 0.95, 1.02, 1.02])


def far_movement(strand: Strands, fraction: Floats, upright: Floats, tracking: float) -> Floats:
    """As :func:`movement` where only the far end moves, but twice as far; ``fraction`` is from
    the grip that rests. Strands between ends far above each other swing more.
    """
    rise = np.abs(strand.points[:, -1, 2] - strand.points[:, 0, 2])
    chord = strand.ratio * strand.length
    sine = (rise + 2.0 * tracking) / np.maximum(chord - 2.0 * tracking, 1e-9)
    steep = np.clip((np.arcsin(np.minimum(sine, 1.0)) - 1.05) / 0.52, 0.0, 1.0)
    level = np.interp(fraction, _FROM_GRIP, _FAR_LEVEL)
    level += steep * (np.interp(fraction, _FROM_GRIP, _FAR_STEEP) - level)
    level *= np.minimum(0.4 + 0.75 * strand.ratio, 1.0)
    vertical = np.minimum(1.05, level * (0.5 + 1.5 * strand.ratio**2))
    vertical *= np.maximum(1.0, 0.5 * lift(strand.ratio))
    return 2.0 * _along(level, vertical, upright)


def shortfall(margin: Floats) -> Floats:
    """Cost of margins in units of what is wanted: steep below 0, slight below 1."""
    short = np.maximum(-margin, 0.0)
    slight = np.maximum(1.0 - margin, 0.0)
    cost: Floats = 5.0 * short + 10.0 * short**2 + 5e-3 * slight**2
    return cost


def vehicle_cost(one: Floats, others: Floats, margins: Margins) -> Floats:
    """Cost (b,) of vehicles at (b, 3) being too close to others (j, b, 3)."""
    apart = one - others
    error = 2.0 * margins.tracking
    level = np.hypot(apart[..., 0], apart[..., 1]) / (margins.vehicle + error)
    above = np.abs(apart[..., 2]) / (margins.downwash + error)
    cost: Floats = shortfall(2.0 * (np.maximum(level, above) - 1.0) + 0.2).sum(axis=0)
    return cost


def rotor_cost(
    place: Floats, strand: Strands, margins: Margins, wider: float | Floats = 0.0
) -> Floats:
    """Cost (b,) of a vehicle's own strand entering its rotor disc, which is ``wider`` by metres."""
    lowest = margins.grip_offset - 1.5 * margins.tracking
    cost = np.zeros(len(place))
    high = np.flatnonzero(strand.middle[:, 2] + strand.reach[:, 2] - place[:, 2] > lowest)
    if not len(high):
        return cost
    apart = refined(strand.points[high]) - place[high, None, :]
    in_disc = (
        margins.radius
        + np.broadcast_to(wider, len(place))[high, None]
        + 1.5 * margins.tracking
        - np.hypot(apart[..., 0], apart[..., 1])
    )
    inside = np.minimum(in_disc, apart[..., 2] - lowest).max(axis=1)
    cost[high] = 10.0 * np.maximum(inside, 0.0) / (margins.radius + margins.tracking)
    return cost


def chord_cost(strand: Strands, margins: Margins) -> Floats:
    """Cost (b,) of chords that come near taut (steep) or stray from the preferred share."""
    over = (strand.ratio + 2.0 * margins.tracking / strand.length) / margins.taut
    cost: Floats = (
        3e-2 * (strand.ratio - margins.spacing) ** 2
        + 0.5 * np.maximum(over - 0.98, 0.0)
        + 200.0 * np.maximum(over - 0.995, 0.0)
    )
    return cost


def refined(points: Floats) -> Floats:
    """Polylines (q, k, 3) with the middles of their pieces: (q, 2k − 1, 3)."""
    between = 0.5 * (points[:, :-1] + points[:, 1:])
    fine = np.empty((len(points), 2 * points.shape[1] - 1, 3))
    fine[:, ::2], fine[:, 1::2] = points, between
    return fine


def body_distance(place: Floats, points: Floats, margins: Margins) -> Floats:
    """Distances (q, k) from the cone over a vehicle's rotor disc, whose tip is the grip point."""
    apart = points - place[:, None, :]
    level, above = np.hypot(apart[..., 0], apart[..., 1]), apart[..., 2]
    radius, height = margins.radius, margins.grip_offset
    disc = np.hypot(np.maximum(level - radius, 0.0), above - height)
    side = radius**2 + height**2
    share = np.clip((level * radius + above * height) / max(side, 1e-12), 0.0, 1.0)
    flank = np.hypot(level - share * radius, above - share * height)
    inside = (above <= height) & (level * height <= above * radius)
    closest: Floats = np.where(inside, 0.0, np.minimum(disc, flank))
    return closest
