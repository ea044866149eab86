"""Missed margins of whole teams at many moments, with the derivative by all positions."""

from dataclasses import dataclass, fields

import numpy as np
import numpy.typing as npt

from swarm.folding.crossing_constraints import CrossingSigns
from swarm.folding.end_response import write_largest_responses
from swarm.folding.margins import Margins, Penalty, PenaltyModel, Team
from swarm.folding.neighbour_clearance import MarginCache, empty_margin_cache, penalize_neighbours
from swarm.folding.outlines import Outlines, outline_strands
from swarm.folding.strand_clearance import penalize_strands
from swarm.folding.vehicle_clearance import (
    penalize_downwash,
    penalize_strands_at_vehicles,
    penalize_vehicles,
    rotor_disc_costs,
)
from swarm.geometry.sensitivity import sensitivity_tables

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.intp]

_STEP = 1e-4
"""Metres; step of the differences for derivatives that are not written out."""

_PREFERRED_CHORD, _CHORD_WEIGHT = 0.985, 4.0
"""Share of the largest chord that the optimizer prefers to keep, and weight of metres beyond."""


@dataclass(frozen=True, eq=False)
class ExtraMargins:
    """Metres (s,) that moments must keep beyond the margins, each named after its check."""

    cable: Floats
    neighbour: Floats
    vehicle: Floats
    vehicle_cable: Floats
    rotor_disc: Floats
    chord: Floats

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
        margins, strands = self.margins, self.outlines(positions)
        model = PenaltyModel(margins, sensitivity_tables())
        response = np.empty((*strands.ratio.shape, 2))
        write_largest_responses(strands.shapes, margins.tracking, model.tables, response)
        team = Team(positions, strands.points, strands.boxes, strands.shapes, response)
        total = Penalty(np.zeros(len(positions)), np.zeros(positions.shape))
        penalize_strands(team, signs.strands, extra.cable, model, total)
        penalize_neighbours(team, extra.neighbour, model, cache, total)
        penalize_strands_at_vehicles(team, signs.vehicles, extra.vehicle_cable, model, total)
        penalize_vehicles(positions, extra.vehicle, margins, total)
        if preferences:
            penalize_downwash(positions, margins, total)
        self._penalize_chords(positions, strands, extra.chord, total)
        for end in (0, 1):
            self._penalize_discs(positions, strands, end, extra.rotor_disc, total)
        return total

    def _penalize_chords(
        self, positions: Floats, strands: Outlines, extra: Floats, total: Penalty
    ) -> None:
        """Add the cost of chords that are close to the largest one."""
        margins, lengths = self.margins, self.lengths
        unit = (margins.cable + 2.0 * margins.tracking) / _CHORD_WEIGHT
        longer = 2.0 * margins.tracking + extra[:, None]
        over = (strands.ratio + longer / lengths) / margins.max_chord_ratio - _PREFERRED_CHORD
        moment, segment = np.nonzero(over > 0.0)
        along = positions[moment, segment + 1] - positions[moment, segment]
        along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-9)
        short = over[moment, segment] * lengths[segment] / unit
        pull = (short / (unit * margins.max_chord_ratio))[:, None] * along
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
