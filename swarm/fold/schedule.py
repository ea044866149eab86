"""Each vehicle's progress along γ: who is where, stage by stage of the fold.

The leader flies ahead; then, one after the other back along the cable, each vehicle gets the
progress that keeps the segment between it and the vehicle ahead clear of everything that is already
planned. That is a shortest path over (stage, progress), found by sweeps of dynamic programming;
its lattice is smoothed by a B-spline, and the next vehicle sees the smoothed motion.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.interpolate import BSpline

from swarm.cable.catenary import hang
from swarm.cable.distance import polyline_polyline
from swarm.fold.path import FoldPath

Floats = npt.NDArray[np.float64]

TAUT = 0.985
"""Largest chord of a held segment aloft, as a share of its cable."""

_STEPS = 4
"""A vehicle may advance by up to this many lattice steps in one stage."""


@dataclass(frozen=True)
class Margins:
    """Distances in metres that the schedule aims at between the nominal motions of things.

    They hold the required clearances and what tracking errors may eat of them. ``tracking`` is the
    radius of the tracking ball, ``radius`` and ``grip_offset`` describe the vehicle.
    """

    cable: float
    vehicle: float
    downwash: float
    vehicle_cable: float
    tracking: float
    radius: float
    grip_offset: float
    spacing: float
    """Preferred chord of a segment in motion, as a share of its length."""


@dataclass(frozen=True, eq=False)
class Schedule:
    """Progress of n vehicles over a common stage variable, C² and monotone.

    ``splines`` maps stages 0…``last`` to progress (…, n); ``cost`` is how much the planned motion
    misses the margins, 0 where it keeps them all.
    """

    splines: BSpline
    last: float
    cost: float

    def progress(self, stage: Floats, derivative: int = 0) -> Floats:
        """Progress (…, n) of every vehicle at stages (…,), or a derivative by stage."""
        values: Floats = self.splines(stage, nu=derivative)
        return values


def schedule(
    path: FoldPath,
    lengths: Floats,
    margins: Margins,
    step: float,
    report: Callable[[float], None] | None = None,
) -> Schedule:
    """Plan every vehicle's progress, from the leader (the last) back to the first.

    ``lengths`` (n − 1,) of the segments; ``step`` is the lattice's step in metres of progress. A
    stage is a step of the leader.
    """
    stops = path.stops
    count = len(stops)
    begin = np.zeros(count)
    begin[-1] = stops[0]
    for i in range(count - 2, -1, -1):
        begin[i] = begin[i + 1] - margins.spacing * lengths[i]
    leading = begin[-1] + step * np.arange(int(np.ceil((stops[-1] - begin[-1]) / step)) + 1)
    leading = np.minimum(leading, stops[-1])
    extra = int(np.ceil((2.5 * lengths.max()) / step))
    stages = len(leading) + extra
    controls = np.empty((stages, count))
    controls[:, -1] = np.concatenate([leading, np.full(extra, stops[-1])])
    team = _Team(path, lengths, margins)
    team.add(count - 1, _smooth(controls[:, -1]))
    total = 0.0
    for i in range(count - 2, -1, -1):
        controls[:, i], cost = _follow(team, i, begin[i], stops[i], step)
        team.add(i, _smooth(controls[:, i]))
        total += cost
        if report:
            report((count - 1 - i) / (count - 1))
    settled = np.all(controls >= stops - 1e-9, axis=1)
    used = min(stages, int(np.argmax(settled)) + 4) if settled.any() else stages
    return Schedule(_spline(controls[:used]), float(used - 1), total)


def _extended(controls: Floats) -> Floats:
    """Control points with a straight run before and a rest after, for the spline's borders."""
    before = controls[:1] + np.arange(-2, 0)[:, None] * (controls[1:2] - controls[:1])
    return np.concatenate([before, controls, np.repeat(controls[-1:], 2, axis=0)])


def _spline(controls: Floats) -> BSpline:
    extended = _extended(controls)
    knots = np.arange(len(extended) + 6) - 5.0 + 0.0
    return BSpline(knots - 0.0, extended, 5)


def _smooth(controls: Floats) -> Floats:
    """Values of the spline at the stages themselves."""
    values: Floats = _spline(controls[:, None])(np.arange(len(controls), dtype=float))[:, 0]
    return values


class _Team:
    """The motion planned so far: places of vehicles and strands at every stage."""

    def __init__(self, path: FoldPath, lengths: Floats, margins: Margins) -> None:
        self.path, self.lengths, self.margins = path, lengths, margins
        self.progress: dict[int, Floats] = {}
        self.places: dict[int, Floats] = {}
        self.strands: dict[int, Floats] = {}
        self.middle: dict[int, Floats] = {}
        self.reach: dict[int, Floats] = {}

    def add(self, vehicle: int, progress: Floats) -> None:
        self.progress[vehicle] = progress
        self.places[vehicle] = self.path.at(vehicle, progress)[0]
        if vehicle + 1 in self.places:
            start, end = self.places[vehicle], self.places[vehicle + 1]
            points = strand_points(start, end, self.lengths[vehicle])
            self.strands[vehicle] = points
            low, high = points.min(axis=1), points.max(axis=1)
            self.middle[vehicle] = 0.5 * (low + high)
            self.reach[vehicle] = 0.5 * (high - low)


_FRACTIONS = np.linspace(0.0, 1.0, 11)


def strand_points(start: Floats, end: Floats, length: float | Floats) -> Floats:
    """Points (…, 11, 3) of hanging strands; where the chord is too long, of the chord itself."""
    length = np.broadcast_to(length, start.shape[:-1])
    chord = np.linalg.norm(end - start, axis=-1)
    stretched = chord > 0.999 * length
    return hang(start, end, np.where(stretched, chord * 1.001 + 1e-9, length)).points(_FRACTIONS)


def _follow(
    team: _Team, vehicle: int, begin: float, stop: float, step: float
) -> tuple[Floats, float]:
    ahead = team.progress[vehicle + 1]
    length = team.lengths[vehicle]
    count = int(np.ceil((stop - begin) / step)) + 1
    lattice: Floats = stop - step * np.arange(count - 1.0, -1.0, -1.0)
    lattice[0] = begin
    spacing = ahead[:, None] - lattice[None, :]
    apart = team.path.station(ahead)[:, None] - team.path.station(lattice)[None, :]
    places = team.path.at(vehicle, lattice)[0]
    chord: Floats = np.linalg.norm(team.places[vehicle + 1][:, None] - places[None], axis=2)
    inside = (spacing >= 0.3 * length) & (apart <= 1.5 * length) & (chord <= length)
    stage, place = np.nonzero(inside)
    cost = np.full(inside.shape, np.inf)
    cost[stage, place] = _costs(team, vehicle, stage, lattice[place])

    stages = len(ahead)
    best = np.full(count, np.inf)
    best[0] = 0.0
    came = np.zeros((stages, count), dtype=np.int8)
    advance = _advance_costs()
    late = np.zeros(count)
    late[:-1] = 1e-2
    flying = int(np.argmax(team.progress[len(team.lengths)] >= team.path.stops[-1] - 1e-9))
    for k in range(1, stages):
        options = np.full((_STEPS + 1, count), np.inf)
        for s in range(_STEPS + 1):
            options[s, s:] = best[: count - s] + advance[s]
        options[0, -1] = best[-1]
        came[k] = np.argmin(options, axis=0)
        best = options[came[k], np.arange(count)] + cost[k] + (late if k > flying else 0.0)
    chosen = np.empty(stages, dtype=np.intp)
    chosen[-1] = count - 1
    for k in range(stages - 1, 0, -1):
        chosen[k - 1] = chosen[k] - came[k, chosen[k]]
    if not np.isfinite(best[-1]):
        return lattice[chosen], np.inf
    missed = cost[np.arange(stages), chosen].sum()
    return lattice[chosen], float(missed)


def _advance_costs() -> Floats:
    pace = np.arange(_STEPS + 1.0)
    cost: Floats = 2e-4 * (pace - 1.0) ** 2
    return cost


def _costs(team: _Team, i: int, stage: npt.NDArray[np.intp], progress: Floats) -> Floats:
    margins, length = team.margins, team.lengths[i]
    start = team.path.at(i, progress)[0]
    end = team.places[i + 1][stage]
    chord = np.linalg.norm(end - start, axis=1)
    over = (chord + 2.0 * margins.tracking) / (TAUT * length)
    cost: Floats = 3e-2 * (chord / length - margins.spacing) ** 2 + 50.0 * np.maximum(over - 1.0, 0.0)
    cost += 0.3 * np.maximum(over - 0.985, 0.0)
    held = np.flatnonzero(over < 1.0)
    points = strand_points(start[held], end[held], length)
    extra = np.zeros(len(held))
    low, high = points.min(axis=1), points.max(axis=1)
    middle, reach = 0.5 * (low + high), 0.5 * (high - low)
    when = stage[held]
    for j in team.strands:
        wanted = 2.0 * margins.cable
        near = np.all(
            np.abs(team.middle[j][when] - middle) < team.reach[j][when] + reach + wanted, axis=1
        )
        if not near.any():
            continue
        other = team.strands[j][when[near]]
        if j == i + 1:
            distance = np.minimum(
                polyline_polyline(points[near][:, :8], other[:, 1:]).distance,
                polyline_polyline(points[near], other[:, 4:]).distance,
            )
        else:
            distance = polyline_polyline(points[near], other).distance
        extra[near] += _shortfall(distance, margins.cable)
    extra += _bodies(team, i, when, start[held], points)
    cost[held] += extra
    return cost


def _shortfall(distance: Floats, wanted: float) -> Floats:
    """Cost of being closer than wanted (steep), or than twice as much (slight)."""
    short = np.maximum(1.0 - distance / wanted, 0.0)
    slight = np.maximum(2.0 - distance / wanted, 0.0)
    cost: Floats = 5.0 * short + 10.0 * short**2 + 3e-3 * slight**2
    return cost


def _bodies(
    team: _Team, i: int, when: npt.NDArray[np.intp], start: Floats, points: Floats
) -> Floats:
    """Vehicles against vehicles, vehicles against strands, rotors against their own strands."""
    margins = team.margins
    cost: Floats = np.zeros(len(when))
    fine = _refined(points)
    for j, places in team.places.items():
        other = places[when]
        apart = other - start
        level = np.hypot(apart[:, 0], apart[:, 1]) / margins.vehicle
        above = np.abs(apart[:, 2]) / margins.downwash
        cost += _shortfall(np.maximum(level, above), 1.0)
        if j > i + 1:
            cost += _shortfall(_body_distance(other, fine, margins), margins.vehicle_cable)
    for j, strand in team.strands.items():
        if j == i:
            continue
        distance = _body_distance(start, _refined(strand[when]), margins)
        cost += _shortfall(distance, margins.vehicle_cable)
    disc = margins.radius + 2.0 * margins.tracking
    for body in (start, team.places[i + 1][when]):
        apart = fine - body[:, None, :]
        in_disc = disc - np.hypot(apart[..., 0], apart[..., 1])
        at_height = apart[..., 2] - margins.grip_offset + 2.0 * margins.tracking
        inside = np.minimum(in_disc, at_height).max(axis=1)
        cost += 5.0 * np.maximum(inside, 0.0)
    return cost


def _refined(points: Floats) -> Floats:
    between = 0.5 * (points[:, :-1] + points[:, 1:])
    fine = np.empty((len(points), 2 * points.shape[1] - 1, 3))
    fine[:, ::2], fine[:, 1::2] = points, between
    return fine


def _body_distance(place: Floats, points: Floats, margins: Margins) -> Floats:
    """Distance from a vehicle (rotor disc and dropper) to the points of a strand."""
    apart = points - place[:, None, :]
    level = np.hypot(apart[..., 0], apart[..., 1])
    disc = np.hypot(np.maximum(level - margins.radius, 0.0), apart[..., 2] - margins.grip_offset)
    below = np.maximum(-apart[..., 2], 0.0) + np.maximum(apart[..., 2] - margins.grip_offset, 0.0)
    dropper = np.hypot(level, below)
    closest: Floats = np.minimum(disc, dropper).min(axis=1)
    return closest


def team_path(
    path: FoldPath, plan: Schedule, per_stage: int = 8
) -> tuple[Floats, Floats, Floats, Floats]:
    """Return the whole team's path over one parameter: parameter (k,), places and derivatives.

    Places and their two derivatives are (k, n, 3). Over the first two units of the parameter the
    stage eases in from rest, after that the parameter runs one ahead of the stage.
    """
    parameter = np.arange(round((plan.last + 1.0) * per_stage) + 1) / per_stage
    share = np.minimum(parameter / 2.0, 1.0)
    easing = share < 1.0
    # Quintic from rest at 0 to rate 1 at stage 1, over two units of the parameter.
    stage = np.where(easing, 2.0 * (share**3 - 0.5 * share**4), parameter - 1.0)
    rate = np.where(easing, 3.0 * share**2 - 2.0 * share**3, 1.0)
    bend = np.where(easing, (6.0 * share - 6.0 * share**2) / 2.0, 0.0)
    progress, first, second = (plan.progress(stage, k) for k in range(3))
    second = second * rate[:, None] ** 2 + first * bend[:, None]
    first = first * rate[:, None]
    places, slopes, bends = [], [], []
    for i in range(progress.shape[1]):
        place, along, curved = path.at(i, progress[:, i])
        places.append(place)
        slopes.append(along * first[:, i, None])
        bends.append(curved * first[:, i, None] ** 2 + along * second[:, i, None])
    return parameter, np.stack(places, 1), np.stack(slopes, 1), np.stack(bends, 1)
