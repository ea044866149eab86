"""Each vehicle's progress along γ: who is where, stage by stage of the fold.

Each segment gets a way of its own through its possible states, clear of all that others may do; the
ways are chained from the leader back along the cable. The lattice of progress is smoothed by a
B-spline. Then the whole team is looked at, and vehicles that still miss their margins are planned
again, with everybody else as they are, by a shortest path over (stage, progress).
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.interpolate import BSpline
from scipy.ndimage import gaussian_filter1d

from swarm.fold.clear import (
    Margins,
    Strands,
    body_cost,
    chord_cost,
    heights_over,
    near_bodies,
    near_strands,
    neighbour_cost,
    rotor_cost,
    strand_cost,
    strands,
    vehicle_cost,
)
from swarm.fold.lanes import Ways, found_ways, ways_along
from swarm.fold.layout import Hanging
from swarm.fold.meeting import Timeline, meeting_cost
from swarm.fold.passage import joined, walked
from swarm.fold.path import FoldPath, Guide

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.intp]

_FASTEST = 3
"""A vehicle may advance by up to this many lattice steps in one stage."""

_WIDTHS = (4.0, 2.0, 1.0)
"""Stages over which a vehicle's progress is evened out, widest first, if that does no harm."""


@dataclass(frozen=True, eq=False)
class Schedule:
    """Progress of n vehicles over a common stage variable, C² and monotone.

    ``splines`` maps stages 0…``last`` to progress (…, n); ``missed`` (n,) is how much each
    vehicle's motion misses the margins, 0 where it keeps them all, and ``worst`` how much it does
    at the worst moment.
    """

    splines: BSpline
    last: float
    missed: Floats
    worst: float
    team: "_Team"

    @property
    def cost(self) -> float:
        """How much the whole motion misses its margins."""
        return float(self.missed.sum())

    def progress(self, stage: Floats, derivative: int = 0) -> Floats:
        """Progress (…, n) of every vehicle at stages (…,), or a derivative by stage."""
        values: Floats = self.splines(stage, nu=derivative)
        return values


_TRIES = 12
"""How often lanes are moved for a segment's sake."""


def schedule(
    layout: Hanging,
    guide: Guide,
    margins: Margins,
    step: float,
    *,
    tries: int = _TRIES,
    report: Callable[[float], None] | None = None,
) -> Schedule:
    """Plan every vehicle's progress, and its lanes.

    ``step`` is the lattice's step in metres of progress: what a vehicle flies in a stage at most.
    ``tries`` is how often lanes are moved; ``report`` is told the share that is done.
    """
    rough = found_ways(layout, guide, margins, _ROUGH * step, tries, report)
    found = ways_along(rough.path, layout, margins, step)
    team = _Team(found.path, layout.lengths, margins, step)
    met: dict[int, set[int]] = {}
    for _ in range(_ROUNDS):
        team.take(_led_apart(found, met, layout.lengths, margins, step))
        more = team.meetings()
        fresh = {i: others - met.get(i, set()) for i, others in more.items()}
        if not any(fresh.values()):
            break
        for i, others in fresh.items():
            met.setdefault(i, set()).update(others)
    return team.result()


_ROUGH = 1.4
"""Lanes are chosen on a lattice that is so much coarser."""

_ROUNDS = 4
"""How often segments that met are led apart."""


def _led_apart(
    found: Ways, met: dict[int, set[int]], lengths: Floats, margins: Margins, step: float
) -> Floats:
    """Progress (ticks, n) of all vehicles, with ways that look at the segments they have met."""
    ways = list(found.ways)
    ticks: Floats = ways[-1].table.ahead[:, None]
    for segment in range(len(ways) - 1, -1, -1):
        table = ways[segment].table
        if met.get(segment):
            timeline = Timeline(segment + 1, ticks)
            extra = meeting_cost(
                table, segment, met[segment], found.path, lengths, timeline, margins
            )
            beside = (
                ways[segment - 1] if segment else None,
                ways[segment + 1] if segment + 1 < len(ways) else None,
            )
            spacing = margins.spacing * lengths[segment]
            ways[segment] = walked(table, spacing, margins, beside, extra)
        ticks = joined(ticks, ways[segment], step)
    return ticks


def improved(plan: Schedule, margins: Margins | None = None, rounds: int = 3) -> Schedule:
    """Replan the vehicles that miss their margins, worst first, some rounds long.

    ``margins`` replace those of the plan, where its certificate has asked for more.
    """
    team = plan.team
    if margins is not None:
        team.margins = margins
        team.judge()
    for _ in range(rounds):
        before = float(team.missed.sum())
        troubled = [int(i) for i in np.argsort(-team.missed) if team.missed[i] > _TROUBLE]
        if not troubled:
            break
        for i in troubled:
            team.move(i, team.planned(i))
        team.judge()
        if team.missed.sum() > 0.6 * before:
            break
    return team.result()


_COMFORT = 0.05
"""What a half stage may cost while all margins are kept."""

_THROUGH = 1e3
"""Cost of passing through another strand."""

_TROUBLE = 0.05
"""Missed margins above this make a vehicle be planned again."""


class _Team:
    """The motion planned so far: control points, and places and strands at every half stage."""

    def __init__(self, path: FoldPath, lengths: Floats, margins: Margins, step: float) -> None:
        self.path, self.lengths, self.margins, self.step = path, lengths, margins, step
        self.stops = path.stops
        # Strands that are farther from each other do not pass through within a stage.
        self.near = 3.0 * step
        self.missed = np.zeros(len(self.stops))
        self.worst = np.inf

    def take(self, ticks: Floats) -> None:
        """Move as in a plan (ticks, n) on the lattice, evened out if that does no harm."""
        count = len(self.stops)
        self.begin = ticks[0]
        self.flying = int(np.argmax(ticks[:, -1] >= ticks[-1, -1] - 1e-9))
        self.stages = len(ticks) + 2 * round(_WIDTHS[0])
        rest = np.repeat(ticks[-1:], self.stages - len(ticks), axis=0)
        self.controls: dict[int, Floats] = {}
        self.places = np.full((count, 2 * self.stages - 1, 3), np.inf)
        self.strands = Strands.nowhere(count - 1, 2 * self.stages - 1)
        self.hanging: set[int] = set()
        lattices = np.concatenate([ticks, rest]).T
        self._even(lattices, 0.0)
        least = float(self.missed.sum())
        for width in _WIDTHS:
            self._even(lattices, width)
            if self.missed.sum() <= 1.05 * least + 0.04:
                return
        self._even(lattices, 0.0)

    def _even(self, lattices: Floats, width: float) -> None:
        for vehicle, lattice in enumerate(lattices):
            self.move(vehicle, _evened(lattice, width) if width else lattice)
        self.judge()

    def meetings(self) -> dict[int, set[int]]:
        """Segments, and those ahead of them that they or their vehicles come too near."""
        found: dict[int, set[int]] = {}
        count = len(self.lengths)
        for one in range(count):
            for other in range(one + 1, count):
                cost, passes = self._met(one, other)
                if passes or cost.max() > _TROUBLE:
                    found.setdefault(one, set()).add(other)
        return found

    def move(self, vehicle: int, controls: Floats) -> None:
        """Let a vehicle move by these control points."""
        self.controls[vehicle] = controls
        self.places[vehicle] = self.path.at(vehicle, _at_half_stages(controls))[0]
        for segment in (vehicle - 1, vehicle):
            if segment in self.controls and segment + 1 in self.controls:
                self.strands[segment] = strands(
                    self.places[segment], self.places[segment + 1], self.lengths[segment]
                )
                self.hanging.add(segment)

    def judge(self) -> None:
        """Say how much every vehicle misses its margins, with all planned."""
        cost = np.zeros((len(self.stops), 2 * self.stages - 1))
        through = np.zeros(len(self.stops))
        count, margins = len(self.lengths), self.margins
        for one in range(count):
            own = self.strands[one]
            alone = chord_cost(own, margins)
            for end in (one, one + 1):
                alone += rotor_cost(self.places[end], own, margins)
            cost[[one, one + 1]] += alone
            for other in range(one + 1, count):
                met, passes = self._met(one, other)
                who = sorted({one, one + 1, other, other + 1})
                cost[who] += met
                through[who] += _THROUGH * passes
        for one in range(count + 1):
            for other in range(one + 1, count + 1):
                near = vehicle_cost(self.places[one], self.places[[other]], margins)
                cost[[one, other]] += near
        self.missed = np.maximum(cost - _COMFORT, 0.0).sum(axis=1) + through
        self.worst = max(float(cost.max()), float(through.max()))

    def _met(self, one: int, other: int) -> tuple[Floats, int]:
        """Cost (half stages,) of two segments near each other, and how often they pass through."""
        first, second, margins = self.strands[one], self.strands[other], self.margins
        if other == one + 1:
            return neighbour_cost(first, second, margins), 0
        cost = np.zeros(2 * self.stages - 1)
        _, row = near_strands(first, second[None], margins)
        if len(row):
            cost[row] += strand_cost(first[row], second[row], margins)
        for vehicles, strand in (((one, one + 1), second), ((other, other + 1), first)):
            for vehicle in vehicles:
                place = self.places[vehicle]
                _, row = near_bodies(place[None], strand, margins)
                if len(row):
                    cost[row] += body_cost(place[row], strand[row], margins)
        over = heights_over(first, second)
        through = (over[1:] * over[:-1] < 0.0) & (np.abs(np.diff(over)) < 0.5 * self.near)
        return cost, int(np.count_nonzero(through))

    def _total(self, vehicle: int, every: Ints, controls: Floats) -> float:
        cost = self.costs(vehicle, every, _at_half_stages(controls)).sum()
        return float(cost) + _THROUGH * self._passes(vehicle, every, controls)

    def _passes(self, vehicle: int, every: Ints, controls: Floats) -> int:
        """How often a vehicle's strands pass through others between one half stage and the next."""
        place = self.path.at(vehicle, _at_half_stages(controls))[0]
        count = 0
        for number, strand in self._own(vehicle, every, place).items():
            for j in self.hanging - {vehicle, vehicle - 1, number - 1, number + 1}:
                over = heights_over(strand, self.strands[j])
                jump = np.abs(over[1:] - over[:-1])
                through = (over[1:] * over[:-1] < 0.0) & (jump < 0.5 * self.near)
                count += int(np.count_nonzero(through))
        return count

    def planned(self, vehicle: int) -> Floats:
        """Find control points for a vehicle, with everybody else as they are."""
        lattice, chosen = self._swept(vehicle)
        rough = lattice[chosen]
        every = np.arange(2 * self.stages - 1)
        best, least = rough, self._total(vehicle, every, rough)
        if vehicle in self.controls:
            before = self._total(vehicle, every, self.controls[vehicle])
            if before <= least:
                best, least = self.controls[vehicle], before
        for width in _WIDTHS:
            smooth = _evened(rough, width)
            cost = self._total(vehicle, every, smooth)
            if cost <= 1.05 * least + 0.04:
                return smooth
        return best

    def _swept(self, vehicle: int) -> tuple[Floats, Ints]:
        """Shortest path over (stage, progress): the lattice and the index chosen at each stage."""
        begin, stop = self.begin[vehicle], self.stops[vehicle]
        count = int(np.ceil((stop - begin) / self.step)) + 1
        lattice: Floats = stop - self.step * np.arange(count - 1.0, -1.0, -1.0)
        lattice[0] = begin
        stage, place = np.nonzero(self._worth_trying(vehicle, lattice))
        cost = np.full((2 * self.stages - 1, count), 1e3)
        cost[stage, place] = self.costs(vehicle, stage, lattice[place])
        passing = self._sides(vehicle, stage, place, lattice)
        late = np.full(count, 1e-2)
        late[-1] = 0.0

        best = np.full(count, np.inf)
        best[0] = 0.0
        came = np.zeros((self.stages, count), dtype=np.int8)
        pace = 5e-4 * (np.arange(_FASTEST + 1.0) - 1.0) ** 2
        options = np.empty((_FASTEST + 1, count))
        every = np.arange(count)
        for k in range(2, 2 * self.stages - 1, 2):
            for s in range(_FASTEST + 1):
                left = count - s
                # Half way, between two places of the lattice where the advance is odd.
                low, high = cost[k - 1, s // 2 :][:left], cost[k - 1, (s + 1) // 2 :][:left]
                options[s, :s] = np.inf
                options[s, s:] = best[:left] + pace[s] + 0.5 * (low + high)
                if passing is not None:
                    before, after = passing[:, k - 2, :left], passing[:, k, s:]
                    between = passing[:, k - 1, s // 2 :][:, :left]
                    through = np.any((before * between < 0) | (between * after < 0), axis=0)
                    options[s, s:] += _THROUGH * through
            options[0, -1] -= pace[0]
            came[k // 2] = np.argmin(options, axis=0)
            best = options[came[k // 2], every] + cost[k]
            if k > 2 * self.flying:
                best += late
        chosen = np.empty(self.stages, dtype=np.intp)
        chosen[-1] = count - 1
        for k in range(self.stages - 1, 0, -1):
            chosen[k - 1] = chosen[k] - came[k, chosen[k]]
        return lattice, chosen

    def _worth_trying(self, vehicle: int, lattice: Floats) -> npt.NDArray[np.bool_]:
        """Which states (half stage, progress) have chords that the cable spans, in order."""
        places = self.path.at(vehicle, lattice)[0]
        station = self.path.station(lattice)
        worth = np.ones((2 * self.stages - 1, len(lattice)), dtype=bool)
        for other, segment in ((vehicle + 1, vehicle), (vehicle - 1, vehicle - 1)):
            if other not in self.controls:
                continue
            length = self.lengths[segment]
            progress = _at_half_stages(self.controls[other])
            ahead = np.sign(other - vehicle)
            spacing = ahead * (progress[:, None] - lattice[None, :])
            apart = ahead * (self.path.station(progress)[:, None] - station[None, :])
            chord = np.linalg.norm(self.places[other][:, None] - places[None], axis=2)
            worth &= (spacing >= 0.3 * length) & (apart <= 1.5 * length) & (chord <= length)
        return worth

    def _own(self, vehicle: int, stage: Ints, place: Floats) -> dict[int, Strands]:
        """Strands that a vehicle at a place would hold at half stages, by segment."""
        own: dict[int, Strands] = {}
        if vehicle + 1 in self.controls:
            ahead = self.places[vehicle + 1, stage]
            own[vehicle] = strands(place, ahead, self.lengths[vehicle])
        if vehicle - 1 in self.controls:
            behind = self.places[vehicle - 1, stage]
            own[vehicle - 1] = strands(behind, place, self.lengths[vehicle - 1])
        return own

    def _sides(
        self, vehicle: int, stage: Ints, place: Ints, lattice: Floats
    ) -> npt.NDArray[np.int8] | None:
        """Over or under which strands own ones pass, by state: (pairs, half stages, progress)."""
        own = self._own(vehicle, stage, self.path.at(vehicle, lattice[place])[0])
        found = []
        for number, strand in own.items():
            for j in self.hanging - {vehicle, vehicle - 1, number - 1, number + 1}:
                over = heights_over(strand, self.strands[j, stage])
                over[np.abs(over) > self.near] = 0.0
                if over.min(initial=0.0) < 0.0 < over.max(initial=0.0):
                    full = np.zeros((2 * self.stages - 1, len(lattice)), dtype=np.int8)
                    full[stage, place] = np.sign(over)
                    found.append(full)
        return np.stack(found) if found else None

    def costs(self, vehicle: int, stage: Ints, progress: Floats) -> Floats:
        """Cost (b,) of a vehicle's being at some progress at half stages, others as they are."""
        margins = self.margins
        place = self.path.at(vehicle, progress)[0]
        own = self._own(vehicle, stage, place)
        apart = sorted(self.hanging - {vehicle, vehicle - 1})
        others = self.strands[_rows(apart), stage]
        cost = np.zeros(len(stage))
        for number, strand in own.items():
            far = vehicle + 1 if number == vehicle else vehicle - 1
            cost += chord_cost(strand, margins) + rotor_cost(place, strand, margins)
            cost += rotor_cost(self.places[far, stage], strand, margins)
            for k, j in enumerate(apart):
                if j == number + 1:
                    cost += neighbour_cost(strand, others[k], margins)
                elif j == number - 1:
                    cost += neighbour_cost(others[k], strand, margins)
            free = np.array([abs(j - number) > 1 for j in apart], dtype=bool)
            which, row = near_strands(strand, others[free], margins)
            found = strand_cost(strand[row], others[free][which, row], margins)
            cost += np.bincount(row, found, len(stage))
            bodies = [j for j in self.controls if j not in {vehicle, number, number + 1}]
            places = self.places[_rows(bodies), stage]
            which, row = near_bodies(places, strand, margins)
            found = body_cost(places[which, row], strand[row], margins)
            cost += np.bincount(row, found, len(stage))
        if len(own) == 2:
            cost += neighbour_cost(own[vehicle - 1], own[vehicle], margins)
        team = [j for j in self.controls if j != vehicle]
        cost += vehicle_cost(place, self.places[_rows(team), stage], margins)
        which, row = near_bodies(place, others, margins)
        found = body_cost(place[row], others[which, row], margins)
        return cost + np.bincount(row, found, len(stage))

    def result(self) -> Schedule:
        """Everybody's progress, up to the stage at which all rest."""
        controls = np.stack([self.controls[i] for i in range(len(self.stops))], axis=1)
        controls = np.concatenate([controls, np.repeat(controls[-1:], _REST, axis=0)])
        settled = np.all(controls >= self.stops - 1e-9, axis=1)
        used = min(len(controls), int(np.argmax(settled)) + _REST)
        return Schedule(_spline(controls[:used]), float(used - 1), self.missed, self.worst, self)


_REST = 4
"""Stages at the end in which the spline comes to rest."""


def _rows(which: list[int]) -> Ints:
    """Indices as a column, to pick rows and columns of an array at once."""
    return np.array(which, dtype=np.intp)[:, None]


def _extended(controls: Floats) -> Floats:
    """Control points with a straight run before and a rest after, for the spline's borders."""
    before = controls[:1] + np.arange(-2.0, 0.0)[:, None] * (controls[1:2] - controls[:1])
    return np.concatenate([before, controls, np.repeat(controls[-1:], 2, axis=0)])


def _spline(controls: Floats) -> BSpline:
    extended = _extended(controls)
    return BSpline(np.arange(len(extended) + 6.0) - 5.0, extended, 5)


def _at_stages(controls: Floats) -> Floats:
    """Values of the spline at the stages themselves: a quintic B-spline's weights."""
    extended = _extended(controls[:, None])[:, 0]
    values: Floats = np.convolve(extended, np.array([1.0, 26.0, 66.0, 26.0, 1.0]) / 120.0, "valid")
    return values


def _at_half_stages(controls: Floats) -> Floats:
    """Values of the spline at the stages and half way between them."""
    extended = _extended(controls[:, None])[:, 0]
    values = np.empty(2 * len(controls) - 1)
    values[::2] = _at_stages(controls)
    between = np.array([1.0, 237.0, 1682.0, 1682.0, 237.0, 1.0]) / 3840.0
    values[1::2] = np.convolve(extended, between, "valid")[: len(controls) - 1]
    return values


def _evened(controls: Floats, width: float) -> Floats:
    """Progress evened out over some stages, from the same begin to the same rest, monotone."""
    margin = int(4 * width) + 1
    before = controls[0] - (controls[1] - controls[0]) * np.arange(margin, 0, -1)
    after = np.full(margin, controls[-1])
    padded = np.concatenate([before, controls, after])
    even: Floats = gaussian_filter1d(padded, width)[margin:-margin]
    even = np.maximum.accumulate(even)
    even += (controls[0] - even[0]) * np.maximum(1.0 - np.arange(len(even)) / margin, 0.0)
    reached = np.flatnonzero(controls >= controls[-1] - 1e-9)
    if len(reached):
        rest = min(int(reached[0]) + margin, len(even) - 1)
        even[rest:] = controls[-1]
    result: Floats = np.maximum.accumulate(np.minimum(even, controls[-1]))
    return result


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
