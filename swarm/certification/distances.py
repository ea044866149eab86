"""Distances at given positions: the closest two vehicles, strands, or vehicle and strand."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from swarm.certification.bodies import Body, vehicle_segments
from swarm.geometry.catenary import solve_catenaries
from swarm.geometry.distance import polyline_polyline
from swarm.planning import Plan

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.intp]

COARSE_STEP = 0.2
"""Seconds between the samples of the first search; near the smallest distance all are searched."""

TAUT = 0.9999
"""Chord over length beyond which reported ends are too far apart: counted, and drawn as nearly
straight. Positions err by centimetres, so that 3 m of cable seem longer than they are."""

_PIECES = 24
"""Pieces of a sampled strand: 13 cm of one of 3 m."""
_FIRST = 64
"""Number of pairs with the lowest bounds, which are measured first."""


@dataclass(frozen=True)
class Tightest:
    """The tightest moment of one kind of clearance.

    ``distance`` is the certified lower bound in metres, for every displacement within the tracking
    radius, or the measured distance; ``between`` names the two objects ("segment 3", "vehicle 5").
    """

    distance: float
    required: float
    time: float
    between: tuple[str, str]


def segment_name(index: int) -> str:
    """Return the name of a segment, counted from 1 along the cable."""
    return f"segment {index + 1}"


def vehicle_name(index: int) -> str:
    """Return the name of a vehicle, counted from 1 along the cable."""
    return f"vehicle {index + 1}"


def closest_vehicles(plan: Plan, place: Floats, time: Floats) -> Tightest | None:
    """Return the smallest distance of vehicles at grip points (k, n, 3) and mission times (k,).

    Horizontally, of those that are not apart in height; None without two vehicles.
    """
    clearance = plan.mission.clearance
    first, second = np.triu_indices(plan.vehicles, 1)
    if not len(first):
        return None
    apart = place[:, second] - place[:, first]
    margin = np.maximum(
        np.hypot(apart[..., 0], apart[..., 1]) - clearance.vehicle,
        np.abs(apart[..., 2]) - clearance.downwash,
    )
    instant, pair = np.unravel_index(np.argmin(margin), margin.shape)
    between = (vehicle_name(int(first[pair])), vehicle_name(int(second[pair])))
    distance = max(float(margin[instant, pair]) + clearance.vehicle, 0.0)
    return Tightest(distance, clearance.vehicle, float(time[instant]), between)


def closest_segments(plan: Plan, place: Floats, time: Floats) -> Tightest | None:
    """Return the smallest distance of segments that share no vehicle, surface to surface.

    At grip points (k, n, 3) and mission times (k,); None without two such segments.
    """
    pairs = np.stack(np.triu_indices(plan.vehicles - 1, 2), axis=1)

    def closest(place: Floats) -> tuple[float, int, int]:
        return closest_strands(_strands(plan, place), pairs)

    if not len(pairs) or not len(plan.layout.lengths):
        return None
    worst, index, pair = _closest_in_time(closest, place, time)
    first, second = (int(segment) for segment in pairs[pair])
    surface = max(worst - plan.mission.cable.diameter, 0.0)
    between = (segment_name(first), segment_name(second))
    return Tightest(surface, plan.mission.clearance.cable, float(time[index]), between)


def closest_vehicle_and_segment(plan: Plan, place: Floats, time: Floats) -> Tightest | None:
    """Return the smallest distance of a vehicle and a segment that it does not hold, or None.

    At grip points (k, n, 3) and mission times (k,), from the cable's surface.
    """
    others, _ = vehicle_segments(plan.vehicles)

    def closest(place: Floats) -> tuple[float, int, int]:
        strands, grip = _strands(plan, place), place[:, others[:, 0]]
        return _closest_bodies(plan, strands[:, others[:, 1]] - grip[:, :, None])

    if not len(others) or not len(plan.layout.lengths):
        return None
    worst, index, pair = _closest_in_time(closest, place, time)
    vehicle, segment = (int(number) for number in others[pair])
    surface = max(worst - 0.5 * plan.mission.cable.diameter, 0.0)
    between = (vehicle_name(vehicle), segment_name(segment))
    return Tightest(surface, plan.mission.clearance.vehicle_cable, float(time[index]), between)


def _closest_in_time(
    closest: Callable[[Floats], tuple[float, int, int]], place: Floats, time: Floats
) -> tuple[float, int, int]:
    """Return the smallest distance, its sample, and its pair: among few samples, then near them."""
    chosen = _thinned(time)
    for _ in range(2):
        worst, instant, pair = closest(place[chosen])
        index = int(chosen[instant])
        chosen = _around(index, chosen) if len(chosen) > 1 else chosen
    return worst, index, pair


def _thinned(time: Floats) -> Ints:
    """Return indices of samples about COARSE_STEP apart; mission time may stop or run backwards."""
    moved = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(time)))])
    _, first = np.unique(np.floor(moved / COARSE_STEP), return_index=True)
    return np.union1d(first, [len(time) - 1])


def _around(index: int, chosen: Ints) -> Ints:
    """Return the indices of all samples between the neighbours of a chosen sample."""
    at = int(np.searchsorted(chosen, index))
    return np.arange(chosen[max(at - 1, 0)], chosen[min(at + 1, len(chosen) - 1)] + 1)


def _strands(plan: Plan, place: Floats) -> Floats:
    """Return polylines (k, n − 1, m, 3) of the cable at positions (k, n, 3)."""
    start, end = place[:, :-1], place[:, 1:]
    chord = np.linalg.norm(end - start, axis=-1)
    strands = solve_catenaries(start, end, np.maximum(plan.layout.lengths, chord / TAUT))
    return strands.points(np.linspace(0.0, 1.0, _PIECES + 1))


def closest_strands(strands: Floats, pairs: Ints) -> tuple[float, int, int]:
    """Return the smallest distance between pairs (p, 2) of polylines (k, s, m, 3) at k instants.

    Returns the distance, the index of its instant and the index of its pair.
    """
    low, high = strands.min(axis=2), strands.max(axis=2)
    one, other = pairs.T
    gap = np.maximum(low[:, one] - high[:, other], low[:, other] - high[:, one])

    def measured(instant: Ints, pair: Ints) -> Floats:
        both = strands[instant, one[pair]], strands[instant, other[pair]]
        return polyline_polyline(*both).distance

    return _smallest(np.linalg.norm(np.maximum(gap, 0.0), axis=-1), measured)


def _smallest(bound: Floats, measured: Callable[[Ints, Ints], Floats]) -> tuple[float, int, int]:
    """Return the smallest of (k, p) values and its two indices, given lower bounds of the values.

    The values with the lowest bounds are measured first, then those with a bound below the
    smallest measured value.
    """
    order = np.argsort(bound, axis=None, kind="stable")
    few, rest = order[:_FIRST], order[_FIRST:]
    values = measured(*np.unravel_index(few, bound.shape))
    likely = rest[bound.flat[rest] <= values.min()]
    if len(likely):
        values = np.concatenate([values, measured(*np.unravel_index(likely, bound.shape))])
    # of equal values the first in time, as if all were measured
    measured_ones = np.concatenate([few, likely])
    best = measured_ones[values == values.min()].min()
    instant, number = np.unravel_index(best, bound.shape)
    return float(values.min()), int(instant), int(number)


def _closest_bodies(plan: Plan, strands: Floats) -> tuple[float, int, int]:
    """Return the smallest distance of bodies at the origin to polylines (k, q, m, 3), with indices.

    Pieces that the distances of their ends exclude are not measured.
    """
    body = Body(plan.mission.vehicles.radius, plan.mission.vehicles.grip_offset)
    least = np.array([-body.radius, -body.radius, 0.0])
    most = np.array([body.radius, body.radius, body.grip_offset])
    gap = np.maximum(strands.min(axis=2) - most, least - strands.max(axis=2))

    def measured(instant: Ints, pair: Ints) -> Floats:
        return _to_body(body, strands[instant, pair])

    return _smallest(np.linalg.norm(np.maximum(gap, 0.0), axis=-1), measured)


def _to_body(body: Body, strands: Floats) -> Floats:
    """Return distances (b,) between a body at the origin and polylines (b, m, 3)."""
    points = strands.reshape(-1, 3)
    off = np.linalg.norm(points - body.projected(points, np.zeros(len(points))), axis=-1)
    off = off.reshape(strands.shape[:-1])
    pieces = np.stack([strands[:, :-1], strands[:, 1:]], axis=-2)
    half = 0.5 * np.linalg.norm(pieces[..., 1, :] - pieces[..., 0, :], axis=-1)
    # A point of a piece is within half its length of one of its ends.
    nearer = np.minimum(off[:, :-1], off[:, 1:]) - half <= off.min(axis=1)[:, None]
    strand, piece = np.nonzero(nearer)
    chords = pieces[strand, piece]
    at_strand, at_body = body.closest(chords, np.zeros(len(chords)))
    distance = np.linalg.norm(at_strand - at_body, axis=-1)
    closest: Floats = np.minimum.reduceat(
        distance, np.searchsorted(strand, np.arange(len(strands)))
    )
    return closest
