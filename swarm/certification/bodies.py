"""Certified bounds of the distances of vehicles: from each other, and from the cable.

A vehicle is modelled as a cone: the rotor disc at the height of the vehicle's centre, and the hull
of the disc and the grip point straight below. Other segments keep their distance from the cone; its
own segments, which begin at the tip, keep out of the disc.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from swarm.certification.branch_and_bound import Boxes, Enclosure
from swarm.certification.motion_bounds import BoundedMotion, TeamStates
from swarm.certification.strand_pieces import Displacement, HeldCable, Selection, pieces
from swarm.certification.strands import unit
from swarm.geometry.distance import norms
from swarm.geometry.sensitivity import BOTH_ENDS, FAR_END, NEAR_END
from swarm.jit import compiled
from swarm.signatures import Floats1, Floats2, Floats3

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
        found = np.empty((len(chord), 7))
        _write_closest(np.ascontiguousarray(chord), _plain(tip), self._cone, found)
        return found[:, :3], np.ascontiguousarray(found[:, 3]), found[:, 4:]

    def projected(self, point: Floats, tip: Floats) -> Floats:
        """Return the points (b, 3) of the bodies that are closest to the given points (b, 3)."""
        found = np.empty((len(point), 3))
        _write_projected(np.ascontiguousarray(point), _plain(tip), self._cone, found)
        return found

    @property
    def _cone(self) -> "_Cone":
        return _Cone(self.radius, self.grip_offset)

    def support(self, normal: Floats, tip: Floats) -> Floats:
        """Return the support function (b,) of the bodies in directions (b, 3)."""
        across = np.hypot(normal[:, 0], normal[:, 1])
        disc = self.radius * across + self.grip_offset * normal[:, 2]
        reach: Floats = np.maximum(disc, tip * normal[:, 2])
        return reach


class _Cone(NamedTuple):
    """Radius of the rotor disc, and its height above the grip point, metres."""

    radius: float
    height: float


@compiled
def _write_closest(chord: Floats3, tip: Floats1, cone: _Cone, found: Floats2) -> None:
    """Write the chord's point, its fraction and the body's point (b, 7) for chords (b, 2, 3)."""
    for b in range(len(found)):
        at_strand, at_body = found[b, :3], found[b, 4:]
        at_body[0], at_body[1], at_body[2] = 0.0, 0.0, cone.height
        for _ in range(_PROJECTIONS):
            square = ahead = 0.0
            for axis in range(3):
                step = chord[b, 1, axis] - chord[b, 0, axis]
                square += step * step
                ahead += step * (at_body[axis] - chord[b, 0, axis])
            along = 0.0
            if square > 0.0:
                along = min(max(ahead / square, 0.0), 1.0)
            for axis in range(3):
                step = chord[b, 1, axis] - chord[b, 0, axis]
                at_strand[axis] = chord[b, 0, axis] + along * step
            found[b, 3] = along
            _project(at_strand, tip[b], cone, at_body)


@compiled
def _write_projected(point: Floats2, tip: Floats1, cone: _Cone, found: Floats2) -> None:
    """Write the points (b, 3) of bodies that are closest to points (b, 3)."""
    for b in range(len(found)):
        _project(point[b], tip[b], cone, found[b])


@compiled
def _project(point: Floats, tip: float, cone: _Cone, found: Floats) -> None:
    """Write the point (3,) of a body that is closest to a point, in the plane of its axis."""
    out, up = math.hypot(point[0], point[1]), point[2]
    rise = cone.height - tip
    share = out * cone.radius + (up - tip) * rise
    share = min(max(share / (cone.radius * cone.radius + rise * rise), 0.0), 1.0)
    side_out, side_up = share * cone.radius, tip + share * rise
    top_out = min(out, cone.radius)
    from_top = np.sqrt((out - top_out) ** 2 + (up - cone.height) ** 2)
    from_side = np.sqrt((out - side_out) ** 2 + (up - side_up) ** 2)
    at_out, at_up = (top_out, cone.height) if from_top <= from_side else (side_out, side_up)
    if tip <= up <= cone.height and out <= cone.radius and cone.radius * (up - tip) >= rise * out:
        at_out, at_up = out, up
    ratio = at_out / max(out, 1e-12)
    found[0], found[1], found[2] = point[0] * ratio, point[1] * ratio, at_up


def _plain(array: Floats) -> Floats:
    return np.require(array, requirements=["C", "W"])


def vehicle_segments(vehicles: int) -> tuple[Ints, Ints]:
    """Return pairs (q, 2) of vehicles with others' segments, and with their own."""
    vehicle, segment = np.divmod(np.arange(vehicles * (vehicles - 1)), vehicles - 1)
    pairs = np.stack([vehicle, segment], axis=1)
    own = (segment == vehicle) | (segment == vehicle - 1)
    return pairs[~own], pairs[own]
