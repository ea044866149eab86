"""Missed margins of vehicles: to strands of others, to each other, in jets, to their own strands.

As in :mod:`swarm.folding.strand_clearance`, functions named ``penalize_…`` add to a penalty;
compiled.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from swarm.folding.end_response import add_to, add_to_ends, arc_fraction, point_movement
from swarm.folding.margins import Margins, Penalty, PenaltyModel, Team
from swarm.folding.outlines import PIECES, height_at_span, point_at
from swarm.folding.strand_clearance import PREFERRED
from swarm.geometry.distance import Vector, times
from swarm.geometry.sensitivity import BOTH_ENDS, error_of_ends
from swarm.jit import compiled, inner
from swarm.signatures import Floats1, Floats2, Floats3, Signs3

Floats = npt.NDArray[np.float64]

_STEP = 1e-4
"""Metres; step of the differences for derivatives of the distance from a cone."""

_VEHICLES_APART, _VEHICLE_WEIGHT = 0.06, 5.0
"""Share beyond their distance that vehicles prefer, and weight of a missed share."""

_JETS, _FAR_BELOW, _WASH_WEIGHT = 2.2, 14.0, 0.5
"""Half-widths of jets that vehicles avoid, metres below which jets do not count, and weight of a
position on the axis of a jet. At 8.3 m below another a vehicle of a searched motion sank by 0.28 m;
in grids none is so far below."""

DISC_ERRORS = 1.5
"""Tracking errors by which a rotor disc is larger and lower for the vehicle's own strands."""

_DISC_WEIGHT = 10.0
"""Weight of metres inside a rotor disc, over the disc's radius."""


class Meeting(NamedTuple):
    """A vehicle and the segment of others that it may meet.

    ``sign`` is 1 where the vehicle must pass over the strand, −1 under, 0 where free; ``extra`` are
    the metres required beyond the margin. Beyond ``limit`` metres it misses no margin.
    """

    vehicle: int
    segment: int
    sign: int
    extra: float
    limit: float


@compiled
def penalize_strands_at_vehicles(
    team: Team, signs: Signs3, extra: Floats1, model: PenaltyModel, penalty: Penalty
) -> None:
    """Add the missed margins of vehicles (s, n) to strands that others hold.

    ``signs`` (s, n, n − 1) are as in :class:`swarm.folding.crossing_constraints.CrossingSigns`.
    """
    margins, positions = model.margins, team.positions
    wanted = preferred_meeting(margins)
    for s in range(len(positions)):
        boxes, response, gradient = team.boxes[s], team.response[s], penalty.gradient[s]
        for vehicle in range(positions.shape[1]):
            for segment in range(len(response)):
                if segment in (vehicle, vehicle - 1):
                    continue
                limit = wanted + extra[s] + margins.tracking * response[segment, 0]
                if body_closer(positions[s, vehicle], margins, boxes[segment], limit):
                    sign = signs[s, vehicle, segment]
                    meeting = Meeting(vehicle, segment, sign, extra[s], limit)
                    penalty.missed[s] += penalize_meeting(
                        positions[s, vehicle], team.points[s, segment], team.shapes[s, segment],
                        meeting, model, gradient,
                    )  # fmt: skip


@inner
def preferred_meeting(margins: Margins) -> float:
    """Return the distance that a vehicle should have from a strand that does not move."""
    unit = margins.vehicle_cable + 2.0 * margins.tracking
    return margins.vehicle_cable + PREFERRED * unit + margins.tracking


@inner
def body_closer(position: Floats, margins: Margins, box: Floats, limit: float) -> bool:
    """Return whether a vehicle's rotor disc and grip may be closer to a strand than ``limit``.

    The gap of the box around them and that of the strand, (2, 3), is below it along every axis.
    """
    higher = 0.5 * margins.grip_offset
    for axis in range(3):
        middle, half = (
            (position[axis], margins.radius) if axis < 2 else (position[2] + higher, higher)
        )
        if abs(middle - box[0, axis]) - half - box[1, axis] >= limit:
            return False
    return True


@inner
def penalize_meeting(
    position: Floats,
    strand: Floats,
    shape: Floats,
    meeting: Meeting,
    model: PenaltyModel,
    gradient: Floats,
) -> float:
    """Return the square of a vehicle's missed margin to a strand; add to the gradient (n, 3)."""
    margins = model.margins
    unit = margins.vehicle_cable + 2.0 * margins.tracking
    place, lowest = 0.0, np.inf
    for k in range(PIECES):
        here = k + _nearest(strand[k], strand[k + 1], position, 0.5 * margins.grip_offset)
        distance = _from_cone(_offset(strand, here, position), margins)
        if distance < lowest:
            lowest, place = distance, here
    if lowest >= meeting.limit:
        return 0.0
    fraction = arc_fraction(shape, place / PIECES)
    away = _cone_derivative(_offset(strand, place, position), margins)
    moved = error_of_ends(BOTH_ENDS, margins.tracking)
    error = point_movement(shape, fraction, away[2], moved, model.tables) + margins.tracking
    short = PREFERRED - (lowest - error - margins.vehicle_cable - meeting.extra) / unit
    if short <= 0.0:
        return 0.0
    sign, share = meeting.sign, _nearest_span(strand, position)
    under = height_at_span(strand, share) - position[2]
    beyond = under if sign > 0 else margins.grip_offset - under
    if sign != 0 and beyond > 0.0 and 0.0 < share < 1.0:
        # The vehicle is on the wrong side of the strand: under it (sign 1) or over it (−1).
        short = PREFERRED + (margins.vehicle_cable + beyond) / unit
        away = 0.0, 0.0, float(sign)
    push = times(short / unit, away)
    add_to(gradient, meeting.vehicle, push, -1.0)
    add_to_ends(gradient, meeting.segment, strand, shape, fraction, push)
    return short * short


@inner
def _offset(strand: Floats, place: float, position: Floats) -> Vector:
    """Return the vector from a vehicle's position to a place on an outline."""
    on = point_at(strand, place)
    return on[0] - position[0], on[1] - position[1], on[2] - position[2]


@inner
def _nearest(begin: Floats, end: Floats, position: Floats, higher: float) -> float:
    """Return the share of an edge that is nearest to a point ``higher`` above a position."""
    x, y, z = end[0] - begin[0], end[1] - begin[1], end[2] - begin[2]
    along = x * (position[0] - begin[0]) + y * (position[1] - begin[1])
    along += z * (position[2] + higher - begin[2])
    return float(min(max(along / max(x * x + y * y + z * z, 1e-18), 0.0), 1.0))


@inner
def _nearest_span(strand: Floats, position: Floats) -> float:
    """Return the share of a strand's span that is nearest to a position in plan view."""
    x, y = strand[-1, 0] - strand[0, 0], strand[-1, 1] - strand[0, 1]
    along = x * (position[0] - strand[0, 0]) + y * (position[1] - strand[0, 1])
    return float(min(max(along / max(x * x + y * y, 1e-18), 0.0), 1.0))


@inner
def _cone_derivative(apart: Vector, margins: Margins) -> Vector:
    """Return the derivative of the distance from a cone by the position of the cone."""
    (x, y, z), distance = apart, _from_cone(apart, margins)
    return (
        (_from_cone((x - _STEP, y, z), margins) - distance) / _STEP,
        (_from_cone((x, y - _STEP, z), margins) - distance) / _STEP,
        (_from_cone((x, y, z - _STEP), margins) - distance) / _STEP,
    )


@inner
def _from_cone(apart: Vector, margins: Margins) -> float:
    """Return the distance of a point from a cone; ``apart`` leads to it from the cone's tip."""
    level = np.sqrt(apart[0] ** 2 + apart[1] ** 2)
    return rotor_cone_distance(level, apart[2], margins)


@inner
def rotor_cone_distance(level: float, above: float, margins: Margins) -> float:
    """Return the distance of a point from the cone of a vehicle: rotor disc, and tip at the grip.

    The point is ``level`` metres aside of the grip point and ``above`` metres above it.
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
    positions: Floats3, extra: Floats1, margins: Margins, penalty: Penalty
) -> None:
    """Add the missed margins of vehicles (s, n, 3) beside each other, and right below others."""
    for s in range(len(positions)):
        beside, under = _required(margins, extra[s])
        gradient = penalty.gradient[s]
        for i in range(positions.shape[1]):
            for j in range(i + 1, positions.shape[1]):
                x = positions[s, i, 0] - positions[s, j, 0]
                y = positions[s, i, 1] - positions[s, j, 1]
                rise = positions[s, i, 2] - positions[s, j, 2]
                level = np.sqrt(x * x + y * y)
                aside, above = level / beside, abs(rise) / under
                short = _short_of(max(aside, above))
                if short <= 0.0:
                    continue
                penalty.missed[s] += short * short
                if aside >= above:
                    push = -short * _VEHICLE_WEIGHT / (max(level, 1e-6) * beside)
                    gradient[i, 0] += push * x
                    gradient[i, 1] += push * y
                    gradient[j, 0] -= push * x
                    gradient[j, 1] -= push * y
                else:
                    push = -np.sign(rise) * short * _VEHICLE_WEIGHT / under
                    gradient[i, 2] += push
                    gradient[j, 2] -= push


@inner
def missed_by_pair(first: Floats, second: Floats, margins: Margins) -> float:
    """Return what :func:`penalize_vehicles` and :func:`penalize_downwash` add for two vehicles."""
    beside, under = _required(margins, 0.0)
    x, y, rise = first[0] - second[0], first[1] - second[1], abs(first[2] - second[2])
    level = np.sqrt(x * x + y * y)
    short, wash = max(_short_of(max(level / beside, rise / under)), 0.0), 0.0
    if 0.0 < rise < _FAR_BELOW:
        wash = _WASH_WEIGHT * max(1.0 - level / _jet(rise, margins), 0.0)
    return float(short * short + wash * wash)


@inner
def _required(margins: Margins, extra: float) -> tuple[float, float]:
    """Return the distances of two vehicles that are required, beside and below each other."""
    beside = margins.vehicle + 2.0 * margins.tracking + extra
    return beside, margins.downwash + 2.0 * margins.tracking + extra


@inner
def _short_of(apart: float) -> float:
    """Return the missed margin of vehicles, for their distance over the required one."""
    return _VEHICLE_WEIGHT * (1.0 + _VEHICLES_APART - apart)


@inner
def _jet(rise: float, margins: Margins) -> float:
    """Return the distance from a jet's axis that vehicles avoid, ``rise`` metres below."""
    return _JETS * (0.7 * margins.radius + 0.1 * rise)


@compiled
def penalize_downwash(
    positions: Floats3, extra: Floats1, margins: Margins, penalty: Penalty
) -> None:
    """Add the cost of vehicles (s, n, 3) in the jets of others above, which make them sink.

    This is a preference, not a margin. A jet's half-width is 0.7 of the rotors' radius, and grows
    by a tenth of the distance below. ``extra`` (s,) are metres by which jets count as wider: they
    push by as much more. Relative to the wider jets instead, they pushed those near the axis less.
    """
    for s in range(len(positions)):
        gradient = penalty.gradient[s]
        for i in range(positions.shape[1]):
            for j in range(positions.shape[1]):
                rise = positions[s, i, 2] - positions[s, j, 2]
                if not 0.0 < rise < _FAR_BELOW:
                    continue
                x = positions[s, i, 0] - positions[s, j, 0]
                y = positions[s, i, 1] - positions[s, j, 1]
                level = np.sqrt(x * x + y * y)
                size = _jet(rise, margins)
                if level >= size + extra[s]:
                    continue
                short = _WASH_WEIGHT * ((size + extra[s]) / size - level / size)
                penalty.missed[s] += short * short
                push = -short * _WASH_WEIGHT / (max(level, 1e-3) * size)
                gradient[i, 0] += push * x
                gradient[i, 1] += push * y
                gradient[j, 0] -= push * x
                gradient[j, 1] -= push * y


@inner
def rotor_disc_cost(position: Floats, strand: Floats, wider: float, margins: Margins) -> float:
    """Return the cost of a vehicle's own strand in its rotor disc, made ``wider`` by metres."""
    lowest = margins.grip_offset - DISC_ERRORS * margins.tracking
    # No point of a strand is higher than its higher end.
    if max(strand[0, 2], strand[-1, 2]) - position[2] <= lowest:
        return 0.0
    radius = margins.radius + wider + DISC_ERRORS * margins.tracking
    inside = 0.0
    for k in range(2 * PIECES + 1):
        apart = _offset(strand, 0.5 * k, position)
        if apart[2] > lowest:
            aside = radius - np.sqrt(apart[0] ** 2 + apart[1] ** 2)
            inside = max(inside, min(aside, apart[2] - lowest))
    return _DISC_WEIGHT * inside / (margins.radius + margins.tracking)


@compiled
def rotor_disc_costs(
    positions: Floats2, strands: Floats3, wider: Floats1, margins: Margins, costs: Floats1
) -> None:
    """Write :func:`rotor_disc_cost` for positions (k, 3), strands (k, p, 3) and ``wider`` (k,)."""
    for k in range(len(positions)):
        costs[k] = rotor_disc_cost(positions[k], strands[k], wider[k], margins)
