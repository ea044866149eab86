"""Distances at given positions: of vehicles, of the cable between them, and of both."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import numpy.typing as npt

from swarm.certification.bodies import Body, vehicle_segments
from swarm.certification.cable_spans import exempt_length, exempt_lengths
from swarm.certification.limits import inside_fence_by
from swarm.geometry.catenary import solve_catenaries
from swarm.geometry.distance import polyline_polyline
from swarm.geometry.solids import obstacles_of, planes_between
from swarm.mission import Mission
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


def beside_obstacles(
    mission: Mission, name: Callable[[int], str], count: int
) -> list[tuple[str, str]]:
    """Return the names of each of the first objects of a kind and each obstacle."""
    obstacles = [f"obstacle {obstacle.name}" for obstacle in mission.workspace.obstacles]
    return [(name(i), obstacle) for i in range(count) for obstacle in obstacles]


@dataclass(frozen=True, eq=False)
class Samples:
    """Where a plan's team was: grip points ``place`` (k, n, 3) at mission times ``time`` (k,).

    The cable hangs in catenaries between them; or it is known: ``shapes`` (k, n − 1, m, 3).
    """

    plan: Plan
    place: Floats
    time: Floats
    shapes: Floats | None = field(default=None, repr=False)

    def taken(self, where: Ints) -> "Samples":
        """Return some of the samples."""
        shapes = None if self.shapes is None else self.shapes[where]
        return Samples(self.plan, self.place[where], self.time[where], shapes)

    @cached_property
    def strands(self) -> Floats:
        """Polylines (k, n − 1, m, 3) of the cable, their points at equal arc lengths."""
        return _strands(self.plan, self.place) if self.shapes is None else self.shapes

    @cached_property
    def coarse(self) -> tuple[Ints, "Samples"]:
        """The numbers of the samples of a first search, and these; all where shapes are known."""
        if self.shapes is not None:
            return np.arange(len(self.time)), self
        chosen = _thinned(self.time)
        return chosen, self.taken(chosen)

    def closest(
        self,
        measured: Callable[["Samples"], tuple[float, int, int]],
        names: Sequence[tuple[str, str]],
        required: float,
        beyond: float,
        least: float = 0.0,
    ) -> Tightest | None:
        """Return the smallest distance, less ``beyond``, of pairs with ``names``; None without any.

        ``measured`` returns it, its sample and its pair. Of modelled cable it is asked for few
        samples, then for those near the smallest. Surfaces are no nearer than ``least``.
        """
        if not names or not len(self.plan.layout.lengths):
            return None
        worst, index, pair = _closest_in_time(measured, self)
        distance = max(worst - beyond, least)
        return Tightest(distance, required, float(self.time[index]), names[pair])


def closest_vehicles(samples: Samples) -> Tightest | None:
    """Return the smallest distance of vehicles; None without two vehicles.

    Horizontally, of those that are not apart in height.
    """
    plan, place = samples.plan, samples.place
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
    return Tightest(distance, clearance.vehicle, float(samples.time[instant]), between)


def closest_segments(samples: Samples) -> Tightest | None:
    """Return the smallest distance of segments that share no vehicle, surface to surface."""
    mission = samples.plan.mission
    pairs = np.stack(np.triu_indices(samples.plan.vehicles - 1, 2), axis=1)
    return samples.closest(
        lambda some: closest_strands(some.strands, pairs),
        [(segment_name(i), segment_name(j)) for i, j in pairs.tolist()],
        mission.clearance.cable,
        mission.cable.diameter,
    )


def closest_neighbours(samples: Samples) -> Tightest | None:
    """Return the smallest distance of segments that share a vehicle, beyond the exempt length."""
    plan, mission = samples.plan, samples.plan.mission
    lengths, count = plan.layout.lengths, max(plan.vehicles - 2, 0)
    near = exempt_lengths(lengths, exempt_length(plan))
    first, whole = np.arange(count), plan.vehicles - 1
    # each is compared with the whole of the other; their parts are numbered after all strands
    pairs = np.concatenate([
        np.stack([whole + first, first + 1], axis=1),
        np.stack([first, whole + count + first], axis=1),
    ])  # fmt: skip

    def measured(some: Samples) -> tuple[float, int, int]:
        strands = some.strands
        before = _part(strands[:, :-1], np.zeros(count), 1.0 - near / lengths[:-1])
        after = _part(strands[:, 1:], near / lengths[1:], np.ones(count))
        return closest_strands(np.concatenate([strands, before, after], axis=1), pairs)

    names = [(segment_name(i), segment_name(i + 1)) for i in range(count)] * 2
    return samples.closest(measured, names, mission.clearance.cable, mission.cable.diameter)


def _part(strands: Floats, begin: Floats, end: Floats) -> Floats:
    """Return the parts (k, q, m, 3) of polylines between fractions (q,), of as many points."""
    count = strands.shape[2] - 1
    at = count * (begin[:, None] + np.linspace(0.0, 1.0, count + 1) * (end - begin)[:, None])
    piece = np.minimum(at.astype(np.intp), count - 1)
    row = np.arange(len(begin))[:, None]
    start, stop = strands[:, row, piece], strands[:, row, piece + 1]
    parts: Floats = start + (at - piece)[..., None] * (stop - start)
    return parts


def closest_vehicle_and_segment(samples: Samples) -> Tightest | None:
    """Return the smallest distance of a vehicle and a segment that it does not hold, or None.

    From the cable's surface.
    """
    return _vehicle_and_segment(samples, own=False)


def closest_rotor_disc(samples: Samples) -> Tightest | None:
    """Return the smallest distance of a vehicle's rotor disc and a segment that it holds."""
    return _vehicle_and_segment(samples, own=True)


def _vehicle_and_segment(samples: Samples, *, own: bool) -> Tightest | None:
    mission = samples.plan.mission
    body = Body(mission.vehicles.radius, mission.vehicles.grip_offset)
    pairs = vehicle_segments(samples.plan.vehicles)[1 if own else 0]
    tip = body.grip_offset if own else 0.0

    def measured(some: Samples) -> tuple[float, int, int]:
        grip = some.place[:, pairs[:, 0]]
        return _closest_bodies(body, tip, some.strands[:, pairs[:, 1]] - grip[:, :, None])

    names = [(vehicle_name(i), segment_name(j)) for i, j in pairs.tolist()]
    radius = 0.5 * mission.cable.diameter
    if own:  # cable whose middle is in the disc is within it, not only at it
        return samples.closest(measured, names, 0.0, radius, least=-radius)
    return samples.closest(measured, names, mission.clearance.vehicle_cable, radius)


def closest_to_floor(samples: Samples) -> Tightest | None:
    """Return the smallest height of the cable over the floor; None without cable."""

    def heights(strands: Floats) -> Floats:
        lowest: Floats = strands[..., 2].min(axis=2)
        return lowest

    required = samples.plan.mission.clearance.floor
    return _smallest_of_strands(samples, heights, "the floor", required)


def closest_to_fence(samples: Samples) -> Tightest | None:
    """Return the smallest distance of the cable from the fence, negative outside, or None."""
    fence = samples.plan.mission.workspace.fence
    if fence is None:
        return None
    sides = np.array(fence)
    return _smallest_of_strands(samples, lambda lines: inside_fence_by(lines, sides), "the fence")


def closest_to_obstacles(samples: Samples) -> Tightest | None:
    """Return the smallest distance of the cable from an obstacle, negative inside, or None."""
    mission, solids = samples.plan.mission, obstacles_of(samples.plan.mission)

    def measured(some: Samples) -> tuple[float, int, int]:
        strands = some.strands
        chords = np.stack([strands[:, :, :-1], strands[:, :, 1:]], axis=-2)
        shape, ends = chords.shape[:3], chords.reshape(-1, 2, 3)
        apart = np.empty((*shape[:2], len(solids)))
        for k, solid in enumerate(solids):
            normal, wall = planes_between(np.tile(solid, (len(ends), 1)), ends)
            beside = np.einsum("bki,bi->bk", ends, normal).min(axis=1) - wall
            apart[:, :, k] = beside.reshape(shape).min(axis=2)
        every = apart.reshape(len(apart), -1)
        instant, pair = np.unravel_index(np.argmin(every), every.shape)
        return float(every[instant, pair]), int(instant), int(pair)

    names = beside_obstacles(mission, segment_name, samples.plan.vehicles - 1)
    radius = 0.5 * mission.cable.diameter
    return samples.closest(measured, names, mission.clearance.obstacle, radius, least=-np.inf)


def _smallest_of_strands(
    samples: Samples, distances: Callable[[Floats], Floats], other: str, required: float = 0.0
) -> Tightest | None:
    """Return the smallest of the distances (k, n − 1) of polylines (k, n − 1, m, 3)."""

    def measured(some: Samples) -> tuple[float, int, int]:
        every = distances(some.strands)
        instant, segment = np.unravel_index(np.argmin(every), every.shape)
        return float(every[instant, segment]), int(instant), int(segment)

    names = [(segment_name(i), other) for i in range(samples.plan.vehicles - 1)]
    radius = 0.5 * samples.plan.mission.cable.diameter
    return samples.closest(measured, names, required, radius, least=-np.inf)


def _closest_in_time(
    closest: Callable[[Samples], tuple[float, int, int]], samples: Samples
) -> tuple[float, int, int]:
    """Return the smallest distance, its sample, and its pair: among few samples, then near them.

    Among all where the cable's shapes are known.
    """
    chosen, coarse = samples.coarse
    worst, instant, pair = closest(coarse)
    if samples.shapes is not None or len(chosen) == 1:
        return worst, int(chosen[instant]), pair
    near = _around(int(chosen[instant]), chosen)
    worst, instant, pair = closest(samples.taken(near))
    return worst, int(near[instant]), pair


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
    first, second = pairs.T
    gap = np.maximum(low[:, first] - high[:, second], low[:, second] - high[:, first])

    def measured(instant: Ints, pair: Ints) -> Floats:
        both = strands[instant, first[pair]], strands[instant, second[pair]]
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


def _closest_bodies(body: Body, tip: float, strands: Floats) -> tuple[float, int, int]:
    """Return the smallest distance of bodies at the origin to polylines (k, q, m, 3), with indices.

    ``tip`` is the height of their lowest point, :meth:`.Body.closest`. Pieces that the
    distances of their ends exclude are not measured.
    """
    least = np.array([-body.radius, -body.radius, tip])
    most = np.array([body.radius, body.radius, body.grip_offset])
    gap = np.maximum(strands.min(axis=2) - most, least - strands.max(axis=2))

    def measured(instant: Ints, pair: Ints) -> Floats:
        return _to_body(body, tip, strands[instant, pair])

    return _smallest(np.linalg.norm(np.maximum(gap, 0.0), axis=-1), measured)


def _to_body(body: Body, tip: float, strands: Floats) -> Floats:
    """Return distances (b,) between a body at the origin and polylines (b, m, 3)."""
    points = strands.reshape(-1, 3)
    off = np.linalg.norm(points - body.projected(points, np.full(len(points), tip)), axis=-1)
    off = off.reshape(strands.shape[:-1])
    pieces = np.stack([strands[:, :-1], strands[:, 1:]], axis=-2)
    half = 0.5 * np.linalg.norm(pieces[..., 1, :] - pieces[..., 0, :], axis=-1)
    # A point of a piece is within half its length of one of its ends.
    nearer = np.minimum(off[:, :-1], off[:, 1:]) - half <= off.min(axis=1)[:, None]
    strand, piece = np.nonzero(nearer)
    chords = pieces[strand, piece]
    at_strand, at_body = body.closest(chords, np.full(len(chords), tip))
    distance = np.linalg.norm(at_strand - at_body, axis=-1)
    closest: Floats = np.minimum.reduceat(
        distance, np.searchsorted(strand, np.arange(len(strands)))
    )
    return closest
