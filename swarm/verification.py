"""Verification of a flight: the implied knot, the smallest distances and the tracking errors.

All follow from reported positions and the quasi-static cable model. Only an observation, by a
person or a camera, shows whether the cable is tied.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from swarm.certification.assessment import Tightest
from swarm.certification.bodies import Body, vehicle_segments
from swarm.certification.clearances import segment_name, vehicle_name
from swarm.certification.topology import cable_curve, layout_code, ties_planned_knot
from swarm.errors import SwarmError
from swarm.flight.trace import Trace
from swarm.geometry.catenary import solve_catenaries
from swarm.geometry.distance import polyline_polyline
from swarm.knots.curve import curve_gauss
from swarm.knots.gauss import same_code
from swarm.knots.invariants import identify_curve
from swarm.planning import Plan

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.intp]
Chirality = Literal["left", "right", "none"]

COARSE_STEP = 0.2
"""Seconds between the samples of the first search; near the smallest distance all are searched."""

_PIECES = 24
"""Pieces of a sampled strand: 13 cm of one of 3 m."""
_FIRST = 64
"""Number of pairs with the lowest bounds, which are measured first."""
_TAUT = 0.9999
"""Chord over length beyond which reported ends are too far apart: counted, and drawn as nearly
straight. Positions err by centimetres, so that 3 m of cable seem longer than they are."""


@dataclass(frozen=True)
class TrackingStatistics:
    """Statistics of the tracking error of a vehicle in a phase, metres.

    ``vehicle`` counts from 1; 0 means all vehicles. ``phase`` is "" for all phases. ``p999`` is the
    99.9th percentile.
    """

    phase: str
    vehicle: int
    rms: float
    p999: float
    largest: float


@dataclass(frozen=True)
class Verification:
    """The implied knot, the smallest distances and the tracking errors of a flight.

    ``knot``, ``chirality`` and ``gauss`` are of the modelled cable at the last reported positions
    of the hold; "unknown" and "" without such positions. ``as_planned`` is true if the knot is that
    of the plan (:func:`swarm.certification.topology.ties_planned_knot`). ``cable``, ``vehicle``
    and ``vehicle_cable`` are the smallest distances at reported positions in fold and hold, with
    mission times; None without positions, or without two such bodies. ``max_chord_ratio`` is the
    largest ratio of chord to length of a segment in fold and hold.
    """

    knot: str
    chirality: Chirality
    gauss: str
    as_planned: bool
    cable: Tightest | None
    vehicle: Tightest | None
    vehicle_cable: Tightest | None
    max_chord_ratio: float | None
    tracking: tuple[TrackingStatistics, ...]
    notes: tuple[str, ...] = ()


def verify_trace(plan: Plan, trace: Trace) -> Verification:
    """Return the knot that a trace implies, its smallest distances and its tracking errors."""
    phase = np.array(trace.phase, dtype=str)
    known = np.isfinite(trace.position).all(axis=(1, 2))
    knot, chirality, gauss, as_planned, notes = _knot(
        plan, trace.position[known & (phase == "hold")]
    )
    folding = known & np.isin(phase, ["fold", "hold"])
    cable = vehicle = vehicle_cable = None
    max_chord_ratio = None
    if folding.any():
        place, time = trace.position[folding], trace.mission_time[folding]
        vehicle = _closest_vehicles(plan, place, time)
        if len(plan.layout.lengths):
            chords = np.linalg.norm(np.diff(place, axis=1), axis=-1) / plan.layout.lengths
            max_chord_ratio = float(chords.max())
            cable = _closest_strands(plan, place, time)
            vehicle_cable = _closest_vehicle_to_cable(plan, place, time)
    return Verification(
        knot=knot,
        chirality=chirality,
        gauss=gauss,
        as_planned=as_planned,
        cable=cable,
        vehicle=vehicle,
        vehicle_cable=vehicle_cable,
        max_chord_ratio=max_chord_ratio,
        tracking=tracking_errors(trace),
        notes=notes,
    )


def closest_pairs(plan: Plan, position: Floats, *, cable: bool) -> tuple[Tightest, ...]:
    """Return the smallest distances of grip points (n, 3) at one moment: of vehicles and, with
    cable aloft, of strands that share no vehicle, and of vehicles and cable.

    None where the position of a vehicle is not known.
    """
    if not np.isfinite(position).all():
        return ()
    place, time = position[None], np.zeros(1)
    found = [_closest_vehicles(plan, place, time)]
    if cable and len(plan.layout.lengths):
        found += [_closest_strands(plan, place, time), _closest_vehicle_to_cable(plan, place, time)]
    return tuple(one for one in found if one is not None)


def _knot(plan: Plan, held: Floats) -> tuple[str, Chirality, str, bool, tuple[str, ...]]:
    if not len(held):
        return "unknown", "none", "", False, ("no positions were reported in the hold",)
    grip_points, lengths = held[-1], plan.layout.lengths
    if not len(lengths):
        return "0_1", "none", "", True, ()
    chords = np.linalg.norm(np.diff(grip_points, axis=0), axis=-1)
    notes = tuple(
        f"the reported ends of {segment_name(int(i))} are {chords[i] / lengths[i]:.1%} of its "
        "length apart"
        for i in np.flatnonzero(chords > _TAUT * lengths)
    )
    curve = cable_curve(grip_points, np.maximum(lengths, chords / _TAUT))
    try:
        code, found = curve_gauss(curve), identify_curve(curve)
        as_planned = ties_planned_knot(plan, found, code)
        if as_planned and not same_code(code, layout_code(plan.layout)):
            notes += ("it is the planned knot, with other crossings in plan view than planned",)
    except SwarmError as error:
        return "unknown", "none", "", False, (*notes, str(error))
    chirality: Chirality = found.chirality  # type: ignore[assignment]
    return found.name, chirality, code.signed_text(), as_planned, notes


def tracking_errors(trace: Trace) -> tuple[TrackingStatistics, ...]:
    """Return statistics per phase and vehicle, per phase, per vehicle, and of the whole flight."""
    error = np.linalg.norm(trace.position - trace.setpoint, axis=-1)
    phase = np.array(trace.phase, dtype=str)
    found = []
    for name in ["", *dict.fromkeys(trace.phase)]:
        rows = error[phase != ""] if name == "" else error[phase == name]
        for vehicle in range(error.shape[1] + 1):
            chosen = rows if vehicle == 0 else rows[:, vehicle - 1]
            values = chosen[np.isfinite(chosen)]
            if len(values):
                rms = float(np.sqrt(np.mean(values**2)))
                p999 = float(np.quantile(values, 0.999))
                found.append(TrackingStatistics(name, vehicle, rms, p999, float(values.max())))
    return tuple(found)


def _strands(plan: Plan, place: Floats) -> Floats:
    """Return polylines (k, n − 1, m, 3) of the cable at positions (k, n, 3)."""
    start, end = place[:, :-1], place[:, 1:]
    chord = np.linalg.norm(end - start, axis=-1)
    strands = solve_catenaries(start, end, np.maximum(plan.layout.lengths, chord / _TAUT))
    return strands.points(np.linspace(0.0, 1.0, _PIECES + 1))


def _thinned(time: Floats) -> Ints:
    """Return indices of samples about COARSE_STEP apart; mission time may stop or run backwards."""
    moved = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(time)))])
    _, first = np.unique(np.floor(moved / COARSE_STEP), return_index=True)
    return np.union1d(first, [len(time) - 1])


def _around(index: int, chosen: Ints) -> Ints:
    """Return the indices of all samples between the neighbours of a chosen sample."""
    at = int(np.searchsorted(chosen, index))
    return np.arange(chosen[max(at - 1, 0)], chosen[min(at + 1, len(chosen) - 1)] + 1)


def _closest_strands(plan: Plan, place: Floats, time: Floats) -> Tightest | None:
    pairs = np.stack(np.triu_indices(plan.vehicles - 1, 2), axis=1)
    if not len(pairs):
        return None
    chosen = _thinned(time)
    for _ in range(2):
        worst, instant, pair = closest_strands(_strands(plan, place[chosen]), pairs)
        index = int(chosen[instant])
        chosen = _around(index, chosen) if len(chosen) > 1 else chosen
    first, second = (int(segment) for segment in pairs[pair])
    surface = max(worst - plan.mission.cable.diameter, 0.0)
    between = (segment_name(first), segment_name(second))
    return Tightest(surface, plan.mission.clearance.cable, float(time[index]), between)


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


def _closest_vehicles(plan: Plan, place: Floats, time: Floats) -> Tightest | None:
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


def _closest_vehicle_to_cable(plan: Plan, place: Floats, time: Floats) -> Tightest | None:
    others, _ = vehicle_segments(plan.vehicles)
    if not len(others):
        return None
    chosen = _thinned(time)
    for _ in range(2):
        strands = _strands(plan, place[chosen])
        grip = place[chosen][:, others[:, 0]]
        worst, instant, pair = _closest_bodies(plan, strands[:, others[:, 1]] - grip[:, :, None])
        index = int(chosen[instant])
        chosen = _around(index, chosen) if len(chosen) > 1 else chosen
    vehicle, segment = (int(number) for number in others[pair])
    surface = max(worst - 0.5 * plan.mission.cable.diameter, 0.0)
    between = (vehicle_name(vehicle), segment_name(segment))
    return Tightest(surface, plan.mission.clearance.vehicle_cable, float(time[index]), between)


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
