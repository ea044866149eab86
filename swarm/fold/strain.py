"""How much a team misses its margins, and where its vehicles should move to miss them less.

As :mod:`swarm.fold.clear` measures, but for whole teams at many moments at once, and with the
derivative by all places. A strand's point follows the strand's ends in proportion to how near it is
to each; where they move apart, the sag answers by as much as a tauter strand rises.
"""

from dataclasses import dataclass, field, fields

import numpy as np
import numpy.typing as npt

from swarm.fold.clear import (
    PIECES,
    Margins,
    Strands,
    body_distance,
    closest,
    cut,
    diverging,
    far_movement,
    heights_over,
    lift,
    movement,
    refined,
    rotor_cost,
    strands,
    together,
)
from swarm.fold.sides import Sides, Signs, pairs

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.intp]

_WANTED = 0.25
"""Share of a margin's unit that is wanted beyond the margin."""

_STEP = 1e-4
"""Metres; step of the differences that stand for derivatives where these are not written out."""


@dataclass(frozen=True, eq=False)
class More:
    """Metres (s,) that moments should keep beyond what margins ask for everywhere."""

    cable: Floats
    beside: Floats
    vehicle: Floats
    vehicle_cable: Floats
    disc: Floats
    play: Floats

    def __getitem__(self, moments: Ints) -> "More":
        return More(*(getattr(self, each.name)[moments] for each in fields(self)))

    @property
    def asked(self) -> npt.NDArray[np.bool_]:
        """Moments (s,) of which anything is asked."""
        every = np.stack([getattr(self, each.name) for each in fields(self)])
        return np.asarray((every > 0.0).any(axis=0))


def nothing_more(moments: int) -> More:
    """No more than the margins everywhere."""
    return More(*np.zeros((len(fields(More)), moments)))


@dataclass(frozen=True, eq=False)
class Strain:
    """Margins that are missed: ``short`` (q,) in units, at moments (q,), and who may mend them.

    ``slope`` (q, 4, 3) is how each grows with the places of ``vehicles`` (q, 4).
    """

    moment: Ints
    short: Floats
    vehicles: Ints
    slope: Floats

    def missed(self, moments: int) -> Floats:
        """How much is missed (moments,) at every moment, squared."""
        return _summed(self.moment, self.short**2, moments)

    def slopes(self, shape: tuple[int, ...]) -> Floats:
        """Half the derivative of what is missed in all by the places (s, n, 3) of this shape."""
        row = (self.moment[:, None] * shape[1] + self.vehicles).ravel()
        push = (self.short[:, None, None] * self.slope).reshape(-1, 3)
        size = shape[0] * shape[1]
        sums = [_summed(row, axis, size) for axis in push.T]
        return np.stack(sums, axis=1).reshape(shape)


@dataclass(frozen=True, eq=False)
class Crew:
    """n vehicles, the lengths (n − 1,) of cable between them, and the margins they should keep."""

    lengths: Floats
    margins: Margins

    def hung(self, places: Floats) -> "Hung":
        """The team with its strands at places (s, n, 3)."""
        return Hung(self, places, strands(places[:, :-1], places[:, 1:], self.lengths))

    def strain(
        self, places: Floats, sides: Sides, more: More | None = None, *, wishes: bool = True
    ) -> Strain:
        """Missed margins at places (s, n, 3); ``sides`` of s moments as from :func:`sides_of`.

        ``more`` is asked of them beyond the margins. ``wishes`` asks for what a team should do, but
        need not, too: to keep out of jets.
        """
        more = more or nothing_more(len(places))
        team = self.hung(places)
        found = [
            _apart(team, sides.strands, more.cable),
            _neighbours(team, more.beside),
            _bodies(team, sides.bodies, more.vehicle_cable),
            _chords(team, more.play),
            _rotors(team, 0, more.disc),
            _rotors(team, 1, more.disc),
            _vehicles(team, more.vehicle),
            *([_washes(team)] if wishes else []),
        ]
        return Strain(
            np.concatenate([part.moment for part in found]),
            np.concatenate([part.short for part in found]),
            np.concatenate([part.vehicles for part in found]),
            np.concatenate([part.slope for part in found]),
        )


@dataclass(frozen=True, eq=False)
class Hung:
    """A crew's places (s, n, 3) at s moments, and its strands (s, n − 1)."""

    crew: Crew
    places: Floats
    strands: Strands
    level: Floats = field(init=False)
    """Unit vectors (s, n − 1, 3) along the strands in plan view."""
    along: Floats = field(init=False)
    """Unit vectors (s, n − 1, 3) along the chords."""

    def __post_init__(self) -> None:
        chord = np.diff(self.places, axis=1)
        level = chord * np.array([1.0, 1.0, 0.0])
        object.__setattr__(self, "along", _unit(chord))
        object.__setattr__(self, "level", _unit(level))

    def followed(self, moment: Ints, segment: Ints, share: Floats, push: Floats) -> Floats:
        """What grows by ``push`` (q, 3) with points of strands, with their ends (q, 2, 3)."""
        ratio = self.strands.ratio[moment, segment]
        rises = 2.0 * share * (1.0 - share) * (lift(ratio) - 1.0) * push[:, 2]
        apart = rises[:, None] * self.level[moment, segment]
        rear = (1.0 - share)[:, None] * push - apart
        return np.stack([rear, share[:, None] * push + apart], axis=1)


def _summed(row: Ints, values: Floats, size: int) -> Floats:
    return np.bincount(row, values, size).astype(np.float64, copy=False)


def _apart(team: Hung, sides: Signs, more: Floats) -> Strain:
    """Strands that do not share a vehicle."""
    margins, hung = team.crew.margins, team.strands
    unit = margins.cable + 2.0 * margins.tracking
    first, second = pairs(len(team.crew.lengths))
    moves = margins.tracking * lift(hung.ratio)
    near = np.ones((len(team.places), len(first)), dtype=bool)
    most = margins.cable + _WANTED * unit + more[:, None] + moves[:, first] + moves[:, second]
    for axis in range(3):
        gap = np.abs(hung.middle[:, first, axis] - hung.middle[:, second, axis])
        near &= gap - hung.reach[:, first, axis] - hung.reach[:, second, axis] < most
    moment, p = np.nonzero(near)
    one, other = hung[moment, first[p]], hung[moment, second[p]]
    found = closest(one.points, other.points)
    flip = _wrong_side(one, other, sides[moment, p])
    error = movement(one.ratio, found.here / PIECES, found.upright)
    error += movement(other.ratio, found.there / PIECES, found.upright)
    distance = np.where(flip, -found.distance, found.distance)
    normal = np.where(flip, -1.0, 1.0)[:, None] * found.normal
    short = _WANTED - (distance - margins.cable - more[moment] - margins.tracking * error) / unit
    k = np.flatnonzero(short > 0.0)
    push = -normal[k] / unit
    return _between(
        team, moment[k], short[k], push,
        (first[p[k]], found.here[k] / PIECES), (second[p[k]], found.there[k] / PIECES),
    )  # fmt: skip


def _between(
    team: Hung,
    moment: Ints,
    short: Floats,
    push: Floats,
    one: tuple[Ints, Floats],
    other: tuple[Ints, Floats],
) -> Strain:
    """Strain between points of two strands each, given by segment and share."""
    ends = [one[0], one[0] + 1, other[0], other[0] + 1]
    slope = [team.followed(moment, *one, push), team.followed(moment, *other, -push)]
    return Strain(moment, short, np.stack(ends, axis=1), np.concatenate(slope, axis=1))


def _wrong_side(one: Strands, other: Strands, side: Signs) -> npt.NDArray[np.bool_]:
    wrong = np.zeros(len(side), dtype=bool)
    k = np.flatnonzero(side)
    wrong[k] = heights_over(one[k], other[k]) * side[k] < 0.0
    return wrong


def _neighbours(team: Hung, more: Floats) -> Strain:
    """Strands that meet at a vehicle, beyond its hand."""
    margins, hung, lengths = team.crew.margins, team.strands, team.crew.lengths
    unit = margins.cable + 2.0 * margins.tracking
    free = np.maximum(0.5, 1.0 - margins.hand / lengths)
    before, after = hung[:, :-1], hung[:, 1:]
    apart = diverging(before, after, margins, free[:-1], free[1:]) & (more == 0.0)[:, None]
    moment, number = np.nonzero(~apart)
    one, two = hung[moment, number], hung[moment, number + 1]
    # The free part of each against all of the other: the first ends at the vehicle, the second
    # begins there.
    shares = np.concatenate(
        [
            np.minimum(_SHARES, free[number, None]),
            np.maximum(_SHARES, 1.0 - free[number + 1, None]),
        ]
    )
    strand, other = together(one, two), together(two, one)
    points = cut(strand.points, shares)
    reach = margins.cable + _WANTED * unit + 4.0 * margins.tracking + np.tile(more[moment], 2)
    near = _boxes_near(points, other, reach)
    moment, own = np.tile(moment, 2)[near], np.concatenate([number, number + 1])[near]
    next_ = np.concatenate([number + 1, number])[near]
    strand, other, points, shares = strand[near], other[near], points[near], shares[near]
    found = closest(points, other.points)
    here = _share_at(shares, found.here)
    there = found.there / PIECES
    shared = (next_ > own).astype(np.float64)
    error = far_movement(strand, np.abs(here - shared), found.upright, margins.tracking)
    error += far_movement(other, np.abs(there - 1.0 + shared), found.upright, margins.tracking)
    spare = found.distance - margins.cable - margins.tracking * error
    spare -= margins.beside + more[moment]
    short = _WANTED - spare / unit
    k = np.flatnonzero(short > 0.0)
    return _between(
        team, moment[k], short[k], -found.normal[k] / unit,
        (own[k], here[k]), (next_[k], there[k]),
    )  # fmt: skip


_SHARES = np.arange(PIECES + 1) / PIECES


def _share_at(shares: Floats, place: Floats) -> Floats:
    piece = np.minimum(place.astype(np.intp), PIECES - 1)
    row = np.arange(len(shares))
    begin = shares[row, piece]
    found: Floats = begin + (place - piece) * (shares[row, piece + 1] - begin)
    return found


def _boxes_near(points: Floats, other: Strands, reach: Floats) -> npt.NDArray[np.bool_]:
    low, high = points.min(axis=1), points.max(axis=1)
    gap = np.abs(0.5 * (low + high) - other.middle) - 0.5 * (high - low) - other.reach
    near: npt.NDArray[np.bool_] = gap.max(axis=1) < reach
    return near


def _bodies(team: Hung, sides: Signs, more: Floats) -> Strain:
    """Vehicles and strands that others hold."""
    margins, hung, places = team.crew.margins, team.strands, team.places
    unit = margins.vehicle_cable + 2.0 * margins.tracking
    reach = margins.vehicle_cable + _WANTED * unit + 3.2 * margins.tracking
    centre = places + np.array([0.0, 0.0, 0.5 * margins.grip_offset])
    size = np.array([margins.radius, margins.radius, 0.5 * margins.grip_offset]) + reach
    size = size[:, None, None, None] + more[:, None, None]
    vehicles, segments = np.arange(places.shape[1]), np.arange(len(team.crew.lengths))
    others = (vehicles[:, None] != segments) & (vehicles[:, None] != segments + 1)
    near = np.repeat(others[None], len(places), axis=0)
    for axis in range(3):
        gap = np.abs(centre[:, :, None, axis] - hung.middle[:, None, :, axis])
        near &= gap - hung.reach[:, None, :, axis] < size[axis]
    moment, vehicle, segment = np.nonzero(near)
    points = refined(hung.points[moment, segment])
    share = np.linspace(0.0, 1.0, points.shape[1])
    error = 1.0 + movement(hung.ratio[moment, segment][:, None], share, np.array(0.7))
    distance = body_distance(places[moment, vehicle], points, margins) - margins.tracking * error
    nearest = np.argmin(distance, axis=1)
    row = np.arange(len(moment))
    short = _WANTED - (distance[row, nearest] - margins.vehicle_cable - more[moment]) / unit
    k = np.flatnonzero(short > 0.0)
    point, place = points[k, nearest[k]][:, None], places[moment[k], vehicle[k]]
    at = body_distance(place, point, margins)[:, 0]
    moved = [body_distance(place + step, point, margins)[:, 0] for step in _STEP * np.eye(3)]
    push = -(np.stack(moved, axis=1) - at[:, None]) / (_STEP * unit)
    side = sides[moment[k], vehicle[k], segment[k]]
    beyond, wrong = _beyond(points[k], place, side, margins)
    short[k] = np.where(wrong, _WANTED + (margins.vehicle_cable + beyond) / unit, short[k])
    push[wrong] = -side[wrong, None] / unit * np.array([0.0, 0.0, 1.0])
    ends = team.followed(moment[k], segment[k], share[nearest[k]], -push)
    who = np.stack([vehicle[k], segment[k], segment[k] + 1, vehicle[k]], axis=1)
    nothing = np.zeros_like(push)[:, None]
    slope = np.concatenate([push[:, None], ends, nothing], axis=1)
    return Strain(moment[k], short[k], who, slope)


def _beyond(
    points: Floats, place: Floats, side: Signs, margins: Margins
) -> tuple[Floats, npt.NDArray[np.bool_]]:
    """Height (q,) by which vehicles at ``place`` (q, 3) miss the right side of strands, and where.

    They pass over (side 1) or under (−1) where strands (q, k, 3) are nearest in plan view.
    """
    apart = points - place[:, None]
    level = np.hypot(apart[..., 0], apart[..., 1])
    nearest, row = np.argmin(level, axis=1), np.arange(len(apart))
    above = apart[row, nearest, 2]
    beyond = np.where(side > 0, above, margins.grip_offset - above)
    inside = (nearest > 0) & (nearest < points.shape[1] - 1)
    return beyond, (side != 0) & inside & (beyond > 0.0)


_TAUT, _TAUT_WEIGHT = 0.985, 4.0
"""Share of the tautest chord allowed that is wanted, and weight of metres beyond."""


def _chords(team: Hung, more: Floats) -> Strain:
    """Chords that come near taut."""
    margins, lengths = team.crew.margins, team.crew.lengths
    unit = (margins.cable + 2.0 * margins.tracking) / _TAUT_WEIGHT
    play = 2.0 * margins.tracking + more[:, None]
    over = (team.strands.ratio + play / lengths) / margins.taut
    over -= _TAUT
    moment, segment = np.nonzero(over > 0.0)
    pull = team.along[moment, segment] / (unit * margins.taut)
    short = over[moment, segment] * lengths[segment] / unit
    return _held(moment, short, segment, np.stack([-pull, pull], axis=1))


def _held(moment: Ints, short: Floats, segment: Ints, slope: Floats) -> Strain:
    """Strain of segments that only their own vehicles can mend; ``slope`` (q, 2, 3)."""
    who = np.stack([segment, segment + 1, segment, segment + 1], axis=1)
    return Strain(moment, short, who, np.concatenate([slope, np.zeros_like(slope)], axis=1))


def _rotors(team: Hung, end: int, more: Floats) -> Strain:
    """Strands that enter the rotor disc of the vehicle at their end 0 or 1."""
    margins, lengths = team.crew.margins, team.crew.lengths
    count = len(lengths)
    every = team.strands.flat()
    wider = np.repeat(more, count)
    cost = rotor_cost(team.places[:, end : end + count].reshape(-1, 3), every, margins, wider)
    moment, segment = np.divmod(np.flatnonzero(cost), count)
    cost = cost[cost != 0.0]
    ends = np.stack([team.places[moment, segment], team.places[moment, segment + 1]], axis=1)
    slope = np.zeros((len(cost), 2, 3))
    for vehicle, axis in np.ndindex(2, 3) if len(cost) else ():
        moved = ends.copy()
        moved[:, vehicle, axis] += _STEP
        held = strands(moved[:, 0], moved[:, 1], lengths[segment])
        after = rotor_cost(moved[:, end], held, margins, more[moment])
        slope[:, vehicle, axis] = (after - cost) / _STEP
    return _held(moment, cost, segment, slope)


def _vehicles(team: Hung, more: Floats) -> Strain:
    """Vehicles next to others, or in the wash of others."""
    margins, places = team.crew.margins, team.places
    first, second = np.triu_indices(places.shape[1], 1)
    apart = places[:, first] - places[:, second]
    size = np.array([margins.vehicle, margins.downwash]) + 2.0 * margins.tracking
    size = size + more[:, None, None]
    level = np.hypot(apart[..., 0], apart[..., 1])
    share = np.stack([level, np.abs(apart[..., 2])], axis=-1) / size
    short = _VEHICLE_WEIGHT * (1.0 + _VEHICLES_APART - share.max(axis=-1))
    moment, p = np.nonzero(short > 0.0)
    short, apart, level = short[moment, p], apart[moment, p], level[moment, p]
    aside = np.argmax(share[moment, p], axis=-1) == 0
    beside, under = size[moment, 0].T
    push = -_VEHICLE_WEIGHT * apart / (np.maximum(level, 1e-6) * beside)[:, None]
    push[:, 2] = 0.0
    up = (_VEHICLE_WEIGHT / under)[~aside, None] * np.array([0.0, 0.0, 1.0])
    push[~aside] = -np.sign(apart[~aside, 2:]) * up
    who = np.stack([first[p], second[p], first[p], second[p]], axis=1)
    slope = np.stack([push, -push, np.zeros_like(push), np.zeros_like(push)], axis=1)
    return Strain(moment, short, who, slope)


_VEHICLES_APART, _VEHICLE_WEIGHT = 0.06, 5.0
"""Share beyond their distance that vehicles should keep, and weight of what they miss of it."""


def _washes(team: Hung) -> Strain:
    """Vehicles in the jets of others above them, which would make them sink: only a wish.

    A jet's half-width is 0.7 of the rotors' radius, and a tenth of the distance wider below.
    """
    places = team.places
    above, under = np.nonzero(~np.eye(places.shape[1], dtype=bool))
    apart = places[:, above] - places[:, under]
    level = np.hypot(apart[..., 0], apart[..., 1])
    size = _JETS * (0.7 * team.crew.margins.radius + 0.1 * apart[..., 2])
    blown = (apart[..., 2] > 0.0) & (apart[..., 2] < _FAR_BELOW) & (level < size)
    moment, p = np.nonzero(blown)
    apart, level, size = apart[moment, p], level[moment, p], size[moment, p]
    push = -_WASH_WEIGHT * apart / (np.maximum(level, 1e-3) * size)[:, None]
    push[:, 2] = 0.0
    who = np.stack([above[p], under[p], above[p], under[p]], axis=1)
    slope = np.stack([push, -push, np.zeros_like(push), np.zeros_like(push)], axis=1)
    return Strain(moment, _WASH_WEIGHT * (1.0 - level / size), who, slope)


_JETS, _FAR_BELOW, _WASH_WEIGHT = 2.2, 8.0, 0.5
"""Half-widths of jets that vehicles keep out of, metres below which jets do not count, and weight
of being on the axis of one.
"""


def _unit(vectors: Floats) -> Floats:
    size = np.linalg.norm(vectors, axis=-1, keepdims=True)
    unit: Floats = vectors / np.maximum(size, 1e-9)
    return unit
