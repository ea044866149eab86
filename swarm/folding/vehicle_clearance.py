"""How much vehicles miss the distances that they should keep from strands and each other; compiled.

As in :mod:`swarm.folding.strand_clearance`, functions add to what every moment misses, and to its
slopes.
"""

import numpy as np
import numpy.typing as npt

from swarm.folding.end_sensitivity import PIECES, add_to_ends, point_movement, sag_response
from swarm.folding.margins import Margins
from swarm.folding.strand_clearance import PREFERRED, height_at_span
from swarm.geometry.distance import Box, boxes_closer
from swarm.jit import compiled

Floats = npt.NDArray[np.float64]

_STEP = 1e-4
"""Metres; step of the differences that stand for derivatives of the distance from a cone."""

_VEHICLES_APART, _VEHICLE_WEIGHT = 0.06, 5.0
"""Share beyond their distance that vehicles should keep, and weight of what they miss of it."""

_JETS, _FAR_BELOW, _WASH_WEIGHT = 2.2, 8.0, 0.5
"""Half-widths of jets that vehicles keep out of, metres below which jets do not count, and weight
of being on the axis of one.
"""


@compiled
def penalize_strands_at_vehicles(
    places: Floats,
    points: Floats,
    middle: Floats,
    reach: Floats,
    ratio: Floats,
    sides: npt.NDArray[np.int8],
    more: Floats,
    margins: Margins,
    missed: Floats,
    slopes: Floats,
) -> None:
    """Vehicles at places (s, n, 3) and strands that others hold; ``sides`` (s, n, n − 1)."""
    most = margins.vehicle_cable * (1.0 + PREFERRED) + (2.0 * PREFERRED + 3.2) * margins.tracking
    centre = np.empty(3)
    size = np.array([margins.radius, margins.radius, 0.5 * margins.grip_offset])
    for s in range(len(places)):
        for vehicle in range(places.shape[1]):
            centre[:] = places[s, vehicle]
            centre[2] += 0.5 * margins.grip_offset
            for segment in range(ratio.shape[1]):
                if segment in (vehicle, vehicle - 1):
                    continue
                box = Box(middle[s, segment], reach[s, segment])
                if boxes_closer(Box(centre, size), box, most + more[s]):
                    missed[s] += _body(
                        places[s], vehicle, points[s, segment], segment, ratio[s, segment],
                        sides[s, vehicle, segment], more[s], margins, slopes[s],
                    )  # fmt: skip


@compiled
def _body(
    places: Floats,
    vehicle: int,
    strand: Floats,
    segment: int,
    ratio: float,
    side: int,
    more: float,
    margins: Margins,
    slopes: Floats,
) -> float:
    """Square of what one vehicle misses to one strand."""
    unit = margins.vehicle_cable + 2.0 * margins.tracking
    place, lifted = places[vehicle], sag_response(ratio)
    apart, at, lowest = np.empty(3), 0.0, np.inf
    for k in range(PIECES):
        here = k + _nearest(strand[k], strand[k + 1], place, 0.5 * margins.grip_offset)
        _apart(strand, here, place, apart)
        level = np.sqrt(apart[0] ** 2 + apart[1] ** 2)
        error = 1.0 + point_movement(lifted, here / PIECES, 0.7)
        distance = rotor_cone_distance(level, apart[2], margins) - margins.tracking * error
        if distance < lowest:
            lowest, at = distance, here
    short = PREFERRED - (lowest - margins.vehicle_cable - more) / unit
    if short <= 0.0:
        return 0.0
    push = np.zeros(3)
    beside = _beside(strand, place)
    under = height_at_span(strand, beside) - place[2]
    beyond = under if side > 0 else margins.grip_offset - under
    if side != 0 and beyond > 0.0 and 0.0 < beside < 1.0:
        # The vehicle is on the wrong side of the strand: over it (side 1) or under it (−1).
        short = PREFERRED + (margins.vehicle_cable + beyond) / unit
        push[2] = -side * short / unit
    else:
        _apart(strand, at, place, apart)
        _away(apart, margins, push)
        push *= -short / unit
    for axis in range(3):
        slopes[vehicle, axis] += push[axis]
    push *= -1.0
    add_to_ends(slopes, segment, at / PIECES, lifted, strand, push)
    return short * short


@compiled
def _apart(strand: Floats, at: float, place: Floats, found: Floats) -> None:
    """Write where a strand is, from a vehicle's place: index of the piece plus fraction of it."""
    piece = min(int(at), len(strand) - 2)
    share = at - piece
    for axis in range(3):
        on = strand[piece, axis] + share * (strand[piece + 1, axis] - strand[piece, axis])
        found[axis] = on - place[axis]


@compiled
def _nearest(begin: Floats, end: Floats, place: Floats, higher: float) -> float:
    """Share of a piece at which it is nearest to so much over a vehicle's place."""
    x, y, z = end[0] - begin[0], end[1] - begin[1], end[2] - begin[2]
    along = x * (place[0] - begin[0]) + y * (place[1] - begin[1])
    along += z * (place[2] + higher - begin[2])
    return float(min(max(along / max(x * x + y * y + z * z, 1e-18), 0.0), 1.0))


@compiled
def _beside(strand: Floats, place: Floats) -> float:
    """Share of a strand's span at which it is nearest to a vehicle's place in plan view."""
    x, y = strand[-1, 0] - strand[0, 0], strand[-1, 1] - strand[0, 1]
    along = x * (place[0] - strand[0, 0]) + y * (place[1] - strand[0, 1])
    return float(min(max(along / max(x * x + y * y, 1e-18), 0.0), 1.0))


@compiled
def _away(apart: Floats, margins: Margins, found: Floats) -> None:
    """Write by how much the distance from a cone grows with the cone's place (3,)."""
    distance = rotor_cone_distance(np.sqrt(apart[0] ** 2 + apart[1] ** 2), apart[2], margins)
    for axis in range(3):
        apart[axis] -= _STEP
        moved = rotor_cone_distance(np.sqrt(apart[0] ** 2 + apart[1] ** 2), apart[2], margins)
        apart[axis] += _STEP
        found[axis] = (moved - distance) / _STEP


@compiled
def rotor_cone_distance(level: float, above: float, margins: Margins) -> float:
    """Distance from the cone over a vehicle's rotor disc, whose tip is the grip point.

    Of a point so far aside of, and above, the grip point.
    """
    radius, height = margins.radius, margins.grip_offset
    if above <= height and level * height <= above * radius:
        return 0.0
    disc = np.hypot(max(level - radius, 0.0), above - height)
    share = (level * radius + above * height) / max(radius**2 + height**2, 1e-12)
    share = min(max(share, 0.0), 1.0)
    return float(min(disc, np.hypot(level - share * radius, above - share * height)))


@compiled
def penalize_vehicles(
    places: Floats, more: Floats, margins: Margins, missed: Floats, slopes: Floats
) -> None:
    """Vehicles next to others, or in the wash of others right below."""
    for s in range(len(places)):
        beside = margins.vehicle + 2.0 * margins.tracking + more[s]
        under = margins.downwash + 2.0 * margins.tracking + more[s]
        for i in range(places.shape[1]):
            for j in range(i + 1, places.shape[1]):
                x, y = places[s, i, 0] - places[s, j, 0], places[s, i, 1] - places[s, j, 1]
                rise = places[s, i, 2] - places[s, j, 2]
                level = np.sqrt(x * x + y * y)
                aside, above = level / beside, abs(rise) / under
                short = _VEHICLE_WEIGHT * (1.0 + _VEHICLES_APART - max(aside, above))
                if short <= 0.0:
                    continue
                missed[s] += short * short
                if aside >= above:
                    push = -short * _VEHICLE_WEIGHT / (max(level, 1e-6) * beside)
                    slopes[s, i, 0] += push * x
                    slopes[s, i, 1] += push * y
                    slopes[s, j, 0] -= push * x
                    slopes[s, j, 1] -= push * y
                else:
                    push = -np.sign(rise) * short * _VEHICLE_WEIGHT / under
                    slopes[s, i, 2] += push
                    slopes[s, j, 2] -= push


@compiled
def penalize_downwash(places: Floats, margins: Margins, missed: Floats, slopes: Floats) -> None:
    """Vehicles in the jets of others above them, which would make them sink: only a wish.

    A jet's half-width is 0.7 of the rotors' radius, and a tenth of the distance wider below.
    """
    for s in range(len(places)):
        for i in range(places.shape[1]):
            for j in range(places.shape[1]):
                rise = places[s, i, 2] - places[s, j, 2]
                if not 0.0 < rise < _FAR_BELOW:
                    continue
                x, y = places[s, i, 0] - places[s, j, 0], places[s, i, 1] - places[s, j, 1]
                level = np.sqrt(x * x + y * y)
                size = _JETS * (0.7 * margins.radius + 0.1 * rise)
                if level >= size:
                    continue
                short = _WASH_WEIGHT * (1.0 - level / size)
                missed[s] += short * short
                push = -short * _WASH_WEIGHT / (max(level, 1e-3) * size)
                slopes[s, i, 0] += push * x
                slopes[s, i, 1] += push * y
                slopes[s, j, 0] -= push * x
                slopes[s, j, 1] -= push * y


@compiled
def rotor_disc_cost(place: Floats, strand: Floats, wider: float, margins: Margins) -> float:
    """What it costs that a vehicle's own strand enters its rotor disc, ``wider`` by metres."""
    lowest = margins.grip_offset - 1.5 * margins.tracking
    # No strand is anywhere higher than its ends are.
    if max(strand[0, 2], strand[-1, 2]) - place[2] <= lowest:
        return 0.0
    radius = margins.radius + wider + 1.5 * margins.tracking
    inside, apart = 0.0, np.empty(3)
    for k in range(2 * PIECES + 1):
        _apart(strand, 0.5 * k, place, apart)
        if apart[2] > lowest:
            aside = radius - np.sqrt(apart[0] ** 2 + apart[1] ** 2)
            inside = max(inside, min(aside, apart[2] - lowest))
    return 10.0 * inside / (margins.radius + margins.tracking)


@compiled
def rotor_disc_costs(
    places: Floats, strands: Floats, wider: Floats, margins: Margins, found: Floats
) -> None:
    """Write what :func:`rotor_disc_cost` gives for places (k, 3), strands (k, p, 3), wider (k,)."""
    for k in range(len(places)):
        found[k] = rotor_disc_cost(places[k], strands[k], wider[k], margins)
