"""Lower bounds of distances of vehicles: from each other, and from the cable.

A vehicle is the cone over its rotor disc: the disc of its radius at the height of its centre, and
everything between it and the grip point straight below. Other segments keep their distance from
that; its own segments, which begin at its tip, keep out of the disc.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from swarm.certification.branch_and_bound import Boxes, Enclosure
from swarm.certification.motion_bounds import Course
from swarm.certification.strands import HeldCable, Team, pieces, unit
from swarm.geometry.distance import point_segment
from swarm.geometry.sensitivity import BOTH_ENDS, FAR_END, NEAR_END

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.intp]

_PROJECTIONS = 6


@dataclass(frozen=True, eq=False)
class VehiclePairs:
    """Vehicles apart: horizontally by ``horizontal`` or vertically by ``vertical``, less that.

    ``pairs`` (q, 2); ``tracking`` displaces both.
    """

    course: Course
    pairs: Ints
    tracking: float
    horizontal: float
    vertical: float

    def __call__(self, boxes: Boxes) -> Enclosure:
        """Enclose the margin in each box: the better of the two."""
        time, half, when = boxes.instants()
        team = Team.at(self.course, time, half)
        first, second = self.pairs[boxes.pair].T
        apart = team.position[when, second] - team.position[when, first]
        approach = team.drift(when, first, team.velocity[when, second]) + team.swerve[when, second]
        high = np.maximum(
            np.hypot(apart[:, 0], apart[:, 1]) - self.horizontal,
            np.abs(apart[:, 2]) - self.vertical,
        )
        high -= 2.0 * self.tracking
        nothing = np.zeros_like(high)
        middle = 0.5 * (team.position[when, second] + team.position[when, first])
        return Enclosure(
            high - approach, high, np.stack([approach, nothing, nothing], axis=1), middle
        )


@dataclass(frozen=True, eq=False)
class VehicleStrands:
    """Vehicles and segments: distance from the cone, or for its own segments from the disc.

    ``pairs`` (q, 2) of a vehicle and a segment; ``required`` (q,) what the strand's surface keeps
    from the vehicle.
    """

    cable: HeldCable
    pairs: Ints
    body: "Body"
    diameter: float
    required: Floats

    def __call__(self, boxes: Boxes) -> Enclosure:
        """Enclose the margin in each box. The first thing is the vehicle, which has no pieces."""
        time, half, when = boxes.instants()
        team = Team.at(self.cable.course, time, half)
        vehicle, segment = self.pairs[boxes.pair].T
        own_start, own_end = segment == vehicle, segment == vehicle - 1
        own = own_start | own_end
        tracking = self.cable.tracking
        strand = pieces(
            team,
            self.cable,
            when,
            segment,
            boxes.second,
            team.velocity[when, vehicle],
            np.where(own_start, FAR_END, np.where(own_end, NEAR_END, BOTH_ENDS)),
            np.where(own, 2.0 * tracking, tracking),
            team.swerve[when, vehicle],
            np.broadcast_to(np.array([0.0, 1.0]), (len(boxes), 2)),
        )
        grip = team.position[when, vehicle]
        tip = np.where(own, self.body.grip_offset, 0.0)
        at_strand, along, at_body = self.body.closest(strand.ends - grip[:, None], tip)
        normal = unit(at_strand - at_body)
        reach = np.einsum("bki,bi->bk", strand.ends - grip[:, None], normal).min(axis=1)
        moved = strand.movement(along, normal)
        shift = np.where(own, 0.0, tracking) + 0.5 * self.diameter + self.required[boxes.pair]
        low = reach - self.body.support(normal, tip) - strand.bow - moved[0] - shift
        distance = np.linalg.norm(at_strand - at_body, axis=-1)
        high = distance + strand.bow - moved[2] - shift
        size = high - low - (moved[1] - moved[2])
        # No surface is nearer than touching, however poorly a strand beyond its length is bounded.
        touching = -0.5 * self.diameter - self.required[boxes.pair]
        return Enclosure(
            np.maximum(low, np.minimum(high, touching)),
            high,
            np.stack([moved[1] - moved[2], np.zeros_like(size), size], axis=1),
            grip + at_strand,
        )


@dataclass(frozen=True)
class Body:
    """The cone over a rotor disc, its tip at the origin; metres."""

    radius: float
    grip_offset: float

    def closest(self, chord: Floats, tip: Floats) -> tuple[Floats, Floats, Floats]:
        """Points of chords (b, 2, 3) and of the body that are nearly closest, by projections.

        ``tip`` (b,) is the height of the body's lowest point: 0, or the grip offset for the disc
        alone. Returns the chords' points (b, 3), their fractions (b,), the body's points (b, 3).
        """
        at_body = np.broadcast_to(np.array([0.0, 0.0, self.grip_offset]), (len(chord), 3))
        for _ in range(_PROJECTIONS):
            along = point_segment(at_body, chord).second
            at_strand = chord[:, 0] + along[:, None] * (chord[:, 1] - chord[:, 0])
            at_body = self.projected(at_strand, tip)
        return at_strand, along, at_body

    def projected(self, point: Floats, tip: Floats) -> Floats:
        """Points (b, 3) of the bodies that are closest to the given ones."""
        out = np.hypot(point[:, 0], point[:, 1])
        rim = np.array([self.radius, self.grip_offset])
        flat = np.stack([out, point[:, 2]], axis=-1)
        top = np.stack([np.minimum(out, self.radius), np.full_like(out, self.grip_offset)], axis=-1)
        lowest = np.stack([np.zeros_like(tip), tip], axis=-1)
        slant = rim - lowest
        share = np.einsum("bi,bi->b", flat - lowest, slant) / np.einsum("bi,bi->b", slant, slant)
        side = lowest + np.clip(share, 0.0, 1.0)[:, None] * slant
        nearer_top = np.linalg.norm(flat - top, axis=-1) <= np.linalg.norm(flat - side, axis=-1)
        closest = np.where(nearer_top[:, None], top, side)
        inside = (flat[:, 1] <= self.grip_offset) & (
            slant[:, 0] * (flat[:, 1] - tip) >= slant[:, 1] * out
        )
        inside &= (flat[:, 1] >= tip) & (out <= self.radius)
        closest = np.where(inside[:, None], flat, closest)
        ratio = closest[:, 0] / np.maximum(out, 1e-12)
        return np.stack([point[:, 0] * ratio, point[:, 1] * ratio, closest[:, 1]], axis=-1)

    def support(self, normal: Floats, tip: Floats) -> Floats:
        """How far the bodies reach in the direction of the unit vectors (b, 3)."""
        across = np.hypot(normal[:, 0], normal[:, 1])
        disc = self.radius * across + self.grip_offset * normal[:, 2]
        reach: Floats = np.maximum(disc, tip * normal[:, 2])
        return reach


def vehicle_segments(vehicles: int) -> tuple[Ints, Ints]:
    """Return pairs (q, 2) of a vehicle and another's segment, and of a vehicle and its own."""
    vehicle, segment = np.divmod(np.arange(vehicles * (vehicles - 1)), vehicles - 1)
    pairs = np.stack([vehicle, segment], axis=1)
    own = (segment == vehicle) | (segment == vehicle - 1)
    return pairs[~own], pairs[own]
