"""Certified bounds of the distances of vehicles: from each other, and from the cable.

A vehicle is modelled as a cone: the rotor disc at the height of the vehicle's centre, and the hull
of the disc and the grip point straight below. Other segments keep their distance from the cone; its
own segments, which begin at the tip, keep out of the disc.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from swarm.certification.branch_and_bound import Boxes, Enclosure
from swarm.certification.motion_bounds import BoundedMotion, TeamStates
from swarm.certification.strand_pieces import Displacement, HeldCable, Selection, pieces
from swarm.certification.strands import unit
from swarm.geometry.distance import norms, point_segment
from swarm.geometry.sensitivity import BOTH_ENDS, FAR_END, NEAR_END

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.intp]

_PROJECTIONS = 6
"""Alternating projections between chord and body. Any direction gives a true bound; more
projections sharpen it, and the search halves boxes where it is not sharp enough."""


@dataclass(frozen=True, eq=False)
class VehiclePairs:
    """Distances of vehicles, less ``horizontal`` or less ``vertical``: the larger margin counts.

    ``pairs`` (q, 2) of vehicles; ``tracking`` displaces both.
    """

    motion: BoundedMotion
    pairs: Ints
    tracking: float
    horizontal: float
    vertical: float

    def __call__(self, boxes: Boxes) -> Enclosure:
        """Enclose the margin in each box."""
        time, half, instant = boxes.instants()
        team = TeamStates.at(self.motion, time, half)
        first, second = self.pairs[boxes.group].T
        step = team.position[instant, second] - team.position[instant, first]
        approach = team.drift(instant, first, team.velocity[instant, second])
        approach += team.deviation[instant, second]
        high = np.maximum(
            np.hypot(step[:, 0], step[:, 1]) - self.horizontal,
            np.abs(step[:, 2]) - self.vertical,
        )
        high -= 2.0 * self.tracking
        middle = 0.5 * (team.position[instant, second] + team.position[instant, first])
        return Enclosure.over_time(high, approach, middle)


@dataclass(frozen=True, eq=False)
class VehicleStrands:
    """Distances of vehicles and strands: from the cone, or for own segments from the disc.

    ``pairs`` (q, 2) of a vehicle and a segment; ``required`` (q,) is the required distance of the
    strand's surface from the vehicle.
    """

    cable: HeldCable
    pairs: Ints
    body: "Body"
    diameter: float
    required: Floats

    def __call__(self, boxes: Boxes) -> Enclosure:
        """Enclose the margin in each box; coordinates are time and the strand's fraction."""
        time, half, instant = boxes.instants()
        team = TeamStates.at(self.cable.motion, time, half)
        vehicle, segment = self.pairs[boxes.group].T
        own_start, own_end = segment == vehicle, segment == vehicle - 1
        own = own_start | own_end
        tracking = self.cable.tracking
        strand = pieces(
            team,
            self.cable,
            Selection.unlimited(instant, segment, boxes.middle[:, 1], boxes.half[:, 1]),
            Displacement(
                team.velocity[instant, vehicle],
                np.where(own_start, FAR_END, np.where(own_end, NEAR_END, BOTH_ENDS)),
                np.where(own, 2.0 * tracking, tracking),
                team.deviation[instant, vehicle],
            ),
        )
        grip = team.position[instant, vehicle]
        tip = np.where(own, self.body.grip_offset, 0.0)
        at_strand, along, at_body = self.body.closest(strand.ends - grip[:, None], tip)
        normal = unit(at_strand - at_body)
        reach = np.minimum(*np.einsum("bki,bi->kb", strand.ends - grip[:, None], normal))
        moved = strand.movement(along, normal)
        shift = np.where(own, 0.0, tracking) + 0.5 * self.diameter + self.required[boxes.group]
        low = reach - self.body.support(normal, tip) - strand.bow - moved.piece - shift
        low -= strand.swing.most
        distance = norms(at_strand - at_body)
        high = distance + strand.bow - moved.tracking - shift - strand.swing.least
        in_time = moved.point - moved.tracking + strand.swing.in_time
        size = high - low - in_time
        # Surfaces are never nearer than touching, also where an over-stretched strand is bounded
        # poorly.
        touching = -0.5 * self.diameter - self.required[boxes.group]
        return Enclosure(
            np.maximum(low, np.minimum(high, touching)),
            high,
            np.stack([in_time, size], axis=1),
            grip + at_strand,
        )


@dataclass(frozen=True)
class Body:
    """The cone below a rotor disc, its tip at the origin; metres."""

    radius: float
    grip_offset: float

    def closest(self, chord: Floats, tip: Floats) -> tuple[Floats, Floats, Floats]:
        """Return nearly closest points of chords (b, 2, 3) and of the body, by projections.

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
        """Return the points (b, 3) of the bodies that are closest to the given points (b, 3)."""
        out = np.hypot(point[:, 0], point[:, 1])
        rim = np.array([self.radius, self.grip_offset])
        flat = np.stack([out, point[:, 2]], axis=-1)
        top = np.stack([np.minimum(out, self.radius), np.full_like(out, self.grip_offset)], axis=-1)
        lowest = np.stack([np.zeros_like(tip), tip], axis=-1)
        slant = rim - lowest
        share = np.einsum("bi,bi->b", flat - lowest, slant) / np.einsum("bi,bi->b", slant, slant)
        side = lowest + np.clip(share, 0.0, 1.0)[:, None] * slant
        nearer_top = norms(flat - top) <= norms(flat - side)
        closest = np.where(nearer_top[:, None], top, side)
        inside = (flat[:, 1] <= self.grip_offset) & (
            slant[:, 0] * (flat[:, 1] - tip) >= slant[:, 1] * out
        )
        inside &= (flat[:, 1] >= tip) & (out <= self.radius)
        closest = np.where(inside[:, None], flat, closest)
        ratio = closest[:, 0] / np.maximum(out, 1e-12)
        return np.stack([point[:, 0] * ratio, point[:, 1] * ratio, closest[:, 1]], axis=-1)

    def support(self, normal: Floats, tip: Floats) -> Floats:
        """Return the support function (b,) of the bodies in directions (b, 3)."""
        across = np.hypot(normal[:, 0], normal[:, 1])
        disc = self.radius * across + self.grip_offset * normal[:, 2]
        reach: Floats = np.maximum(disc, tip * normal[:, 2])
        return reach


def vehicle_segments(vehicles: int) -> tuple[Ints, Ints]:
    """Return pairs (q, 2) of vehicles with others' segments, and with their own."""
    vehicle, segment = np.divmod(np.arange(vehicles * (vehicles - 1)), vehicles - 1)
    pairs = np.stack([vehicle, segment], axis=1)
    own = (segment == vehicle) | (segment == vehicle - 1)
    return pairs[~own], pairs[own]
