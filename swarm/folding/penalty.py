"""Missed margins of whole teams at many moments, with the derivative by all positions."""

from dataclasses import dataclass, fields

import numpy as np
import numpy.typing as npt

from swarm.folding.chord_clearance import chord_unit, missed_chords
from swarm.folding.crossing_constraints import CrossingSigns, free_signs
from swarm.folding.end_response import write_largest_responses
from swarm.folding.margins import Margins, Penalty, PenaltyModel, Team
from swarm.folding.neighbour_clearance import (
    MarginCache,
    empty_margin_cache,
    junction_memory,
    penalize_neighbours,
)
from swarm.folding.outlines import Outlines, outline_strands
from swarm.folding.strand_clearance import penalize_strands
from swarm.folding.vehicle_clearance import (
    penalize_downwash,
    penalize_strands_at_vehicles,
    penalize_vehicles,
    rotor_disc_costs,
)
from swarm.geometry.sensitivity import sensitivity_tables
from swarm.threads import side_by_side, usual_threads

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.intp]

_STEP = 1e-4
"""Metres; step of the differences for derivatives that are not written out."""

KEPT = 0.02
"""Missed margins, squared, up to which a team keeps its margins: the penalty of a single pair
begins a quarter of a unit beyond its margin, so that 0.06 is a kept margin. Jets of vehicles above
cost more than this where they make a vehicle sink by about a tracking error."""

_BATCH = 4000
"""Number of teams whose margins are computed at once: their outlines fit a processor's cache."""

_LEAST_TOGETHER = 50
"""Fewest moments for a thread: fewer take little more time than its start."""


@dataclass(frozen=True, eq=False)
class ExtraMargins:
    """Metres (s,) that moments must keep beyond the margins, each named after its check.

    ``jet`` makes the jets of vehicles above wider, which are avoided without a margin.
    """

    cable: Floats
    neighbour: Floats
    vehicle: Floats
    vehicle_cable: Floats
    rotor_disc: Floats
    chord: Floats
    jet: Floats

    def __getitem__(self, moments: Ints | slice) -> "ExtraMargins":
        return ExtraMargins(*(getattr(self, each.name)[moments] for each in fields(self)))

    @property
    def present(self) -> npt.NDArray[np.bool_]:
        """Moments (s,) with an extra margin."""
        every = np.stack([getattr(self, each.name) for each in fields(self)])
        return np.asarray((every > 0.0).any(axis=0))


def no_extra_margins(moments: int) -> ExtraMargins:
    """Return extra margins of 0."""
    return ExtraMargins(*np.zeros((len(fields(ExtraMargins)), moments)))


@dataclass(frozen=True, eq=False)
class TeamGeometry:
    """Lengths (n − 1,) of the cable between n vehicles, and the margins of the team."""

    lengths: Floats
    margins: Margins

    @property
    def model(self) -> PenaltyModel:
        """The margins, with the tables by which strands respond to tracking errors."""
        return PenaltyModel(self.margins, sensitivity_tables())

    def outlines(self, positions: Floats) -> Outlines:
        """Return the team's strands (s, n − 1) with vehicles at positions (s, n, 3)."""
        return outline_strands(positions[:, :-1], positions[:, 1:], self.lengths)

    def penalty(
        self,
        positions: Floats,
        signs: CrossingSigns,
        extra: ExtraMargins | None = None,
        *,
        preferences: bool = True,
        cache: MarginCache | None = None,
    ) -> Penalty:
        """Return the missed margins at positions (s, n, 3).

        ``signs`` are those of the s moments; ``extra`` is required beyond the margins.
        ``preferences`` adds costs that are no margins: of positions in jets. ``cache`` holds spare
        margins of the same moments from positions near these, and is updated.
        """
        extra = extra or no_extra_margins(len(positions))
        cache = cache or empty_margin_cache(len(positions), len(self.lengths))

        def part(some: slice) -> Penalty:
            kept = MarginCache(cache.spare[some], cache.positions[some])
            return self._penalty(positions[some], signs[some], extra[some], kept, preferences)

        parts = _parts(len(positions))
        penalties = list(side_by_side(part, parts, threads=len(parts)))
        return Penalty(*(np.concatenate(each) for each in zip(*penalties, strict=True)))

    def missed(
        self, positions: Floats, signs: CrossingSigns, extra: ExtraMargins
    ) -> tuple[Floats, Floats]:
        """Return the missed margins (s,) of :meth:`penalty`, with preferences and without."""
        without = self.penalty(positions, signs, extra, preferences=False).missed
        jets = Penalty(np.zeros(len(positions)), np.zeros(positions.shape))
        penalize_downwash(positions, extra.jet, self.margins, jets)
        return without + jets.missed, without

    def _penalty(
        self, positions: Floats, signs: CrossingSigns, extra: ExtraMargins, cache: MarginCache,
        preferences: bool,
    ) -> Penalty:  # fmt: skip
        """Return the missed margins as :meth:`penalty` does."""
        model, strands = self.model, self.outlines(positions)
        margins = model.margins
        response = np.empty((*strands.ratio.shape, 2))
        write_largest_responses(strands.shapes, margins.tracking, model.tables, response)
        team = Team(positions, strands.points, strands.boxes, strands.shapes, response)
        total = Penalty(np.zeros(len(positions)), np.zeros(positions.shape))
        penalize_strands(team, signs.strands, extra.cable, model, total)
        penalize_neighbours(team, extra.neighbour, model, cache, junction_memory(), total)
        penalize_strands_at_vehicles(team, signs.vehicles, extra.vehicle_cable, model, total)
        penalize_vehicles(positions, extra.vehicle, margins, total)
        if preferences:
            penalize_downwash(positions, extra.jet, margins, total)
        self._penalize_chords(positions, strands, extra.chord, total)
        for end in (0, 1):
            self._penalize_discs(positions, strands, end, extra.rotor_disc, total)
        return total

    def _penalize_chords(
        self, positions: Floats, strands: Outlines, extra: Floats, total: Penalty
    ) -> None:
        """Add the cost of chords that are close to the largest one."""
        margins = self.margins
        missed = missed_chords(strands.ratio, self.lengths, extra[:, None], margins)
        moment, segment = np.nonzero(missed > 0.0)
        along = positions[moment, segment + 1] - positions[moment, segment]
        along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-9)
        short = missed[moment, segment]
        pull = (short / (chord_unit(margins) * margins.max_chord_ratio))[:, None] * along
        np.add.at(total.missed, moment, short**2)
        np.add.at(total.gradient, (moment, segment), -pull)
        np.add.at(total.gradient, (moment, segment + 1), pull)

    def _penalize_discs(
        self, positions: Floats, strands: Outlines, end: int, extra: Floats, total: Penalty
    ) -> None:
        """Add the cost of strands in the rotor disc of the vehicle at their end 0 or 1."""
        count = len(self.lengths)
        cost = np.empty(strands.ratio.size)
        at = np.ascontiguousarray(positions[:, end : end + count]).reshape(-1, 3)
        wider = np.repeat(extra, count)
        points = strands.points.reshape(-1, *strands.points.shape[2:])
        rotor_disc_costs(at, points, wider, self.margins, cost)
        inside = np.flatnonzero(cost)
        if not len(inside):
            return
        (moment, segment), cost = np.divmod(inside, count), cost[inside]
        ends = np.stack([positions[moment, segment], positions[moment, segment + 1]], axis=1)
        np.add.at(total.missed, moment, cost**2)
        after = np.empty(len(cost))
        for vehicle, axis in np.ndindex(2, 3):
            moved = ends.copy()
            moved[:, vehicle, axis] += _STEP
            held = outline_strands(moved[:, 0], moved[:, 1], self.lengths[segment]).points
            rotor_disc_costs(moved[:, end].copy(), held, extra[moment], self.margins, after)
            slope = cost * (after - cost) / _STEP
            np.add.at(total.gradient, (moment, segment + vehicle, axis), slope)


def _parts(moments: int) -> list[slice]:
    """Return the moments in equal parts to compute side by side."""
    count = max(1, min(usual_threads(), moments // _LEAST_TOGETHER))
    return [slice(k * moments // count, (k + 1) * moments // count) for k in range(count)]


def missed_margins(team: TeamGeometry, positions: Floats) -> Floats:
    """Return the missed margins (s,), squared and summed, of a team at positions (s, n, 3).

    Vehicles in the jets of others count as well. No strand is required on one side of another.
    """
    missed = np.empty(len(positions))
    for begin in range(0, len(positions), _BATCH):
        some = positions[begin : begin + _BATCH]
        signs = free_signs(len(some), len(team.lengths))
        missed[begin : begin + _BATCH] = team.penalty(some, signs).missed
    return missed
