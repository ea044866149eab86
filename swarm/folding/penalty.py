"""How much a team misses its margins, and where its vehicles should move to miss them less.

As :mod:`swarm.folding.soft_constraints` measures, but for whole teams at many moments at once, and
with the derivative by all places.
"""

from dataclasses import dataclass, fields

import numpy as np
import numpy.typing as npt

from swarm.folding import strand_clearance, vehicle_clearance
from swarm.folding.crossing_constraints import CrossingSigns
from swarm.folding.margins import Margins
from swarm.folding.soft_constraints import Outlines, outline_strands

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.intp]

_STEP = 1e-4
"""Metres; step of the differences that stand for derivatives where these are not written out."""

_TAUT, _TAUT_WEIGHT = 0.985, 4.0
"""Share of the tautest chord allowed that is wanted, and weight of metres beyond."""


@dataclass(frozen=True, eq=False)
class ExtraMargins:
    """Metres (s,) that moments should keep beyond what margins ask for everywhere."""

    cable: Floats
    neighbour: Floats
    vehicle: Floats
    vehicle_cable: Floats
    rotor_disc: Floats
    chord: Floats

    def __getitem__(self, moments: Ints | slice) -> "ExtraMargins":
        return ExtraMargins(*(getattr(self, each.name)[moments] for each in fields(self)))

    @property
    def asked(self) -> npt.NDArray[np.bool_]:
        """Moments (s,) of which anything is asked."""
        every = np.stack([getattr(self, each.name) for each in fields(self)])
        return np.asarray((every > 0.0).any(axis=0))


def no_extra_margins(moments: int) -> ExtraMargins:
    """No more than the margins everywhere."""
    return ExtraMargins(*np.zeros((len(fields(ExtraMargins)), moments)))


@dataclass(frozen=True, eq=False)
class Penalty:
    """What is missed (s,) of margins at every moment, in units, squared and summed.

    ``slopes`` (s, n, 3) is half its derivative by all places.
    """

    missed: Floats
    slopes: Floats


@dataclass(frozen=True, eq=False)
class TeamGeometry:
    """n vehicles, the lengths (n − 1,) of cable between them, and the margins they should keep."""

    lengths: Floats
    margins: Margins

    def hung(self, places: Floats) -> Outlines:
        """The team's strands (s, n − 1) with vehicles at places (s, n, 3)."""
        return outline_strands(places[:, :-1], places[:, 1:], self.lengths)

    def strain(
        self,
        places: Floats,
        sides: CrossingSigns,
        more: ExtraMargins | None = None,
        *,
        wishes: bool = True,
        calm: strand_clearance.MarginCache | None = None,
    ) -> Penalty:
        """Missed margins at places (s, n, 3); ``sides`` of s moments as from :func:`sides_of`.

        ``more`` is asked of them beyond the margins. ``wishes`` asks for what a team should do, but
        need not, too: to keep out of jets. ``calm`` is what is known of these moments from places
        near these, and is noted for others near them.
        """
        more = more or no_extra_margins(len(places))
        calm = calm or strand_clearance.empty_margin_cache(len(places), len(self.lengths))
        margins, hung = self.margins, self.hung(places)
        found = Penalty(np.zeros(len(places)), np.zeros(places.shape))
        add = found.missed, found.slopes
        points, middle, reach, ratio = hung.points, hung.middle, hung.reach, hung.ratio
        strand_clearance.penalize_strands(
            points, middle, reach, ratio, sides.strands, more.cable, margins, *add
        )
        strand_clearance.penalize_neighbours(
            points, ratio, self.lengths, more.neighbour, margins, calm, *add
        )
        vehicle_clearance.penalize_strands_at_vehicles(
            places, points, middle, reach, ratio, sides.bodies, more.vehicle_cable, margins, *add
        )
        vehicle_clearance.penalize_vehicles(places, more.vehicle, margins, *add)
        if wishes:
            vehicle_clearance.penalize_downwash(places, margins, *add)
        self._chords(places, hung, more.chord, found)
        for end in (0, 1):
            self._discs(places, hung, end, more.rotor_disc, found)
        return found

    def _chords(self, places: Floats, hung: Outlines, more: Floats, found: Penalty) -> None:
        """Chords that come near taut."""
        margins, lengths = self.margins, self.lengths
        unit = (margins.cable + 2.0 * margins.tracking) / _TAUT_WEIGHT
        play = 2.0 * margins.tracking + more[:, None]
        over = (hung.ratio + play / lengths) / margins.max_chord_ratio - _TAUT
        moment, segment = np.nonzero(over > 0.0)
        along = places[moment, segment + 1] - places[moment, segment]
        along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-9)
        short = over[moment, segment] * lengths[segment] / unit
        pull = (short / (unit * margins.max_chord_ratio))[:, None] * along
        np.add.at(found.missed, moment, short**2)
        np.add.at(found.slopes, (moment, segment), -pull)
        np.add.at(found.slopes, (moment, segment + 1), pull)

    def _discs(
        self, places: Floats, hung: Outlines, end: int, more: Floats, found: Penalty
    ) -> None:
        """Strands that enter the rotor disc of the vehicle at their end 0 or 1."""
        count = len(self.lengths)
        cost = np.empty(hung.ratio.size)
        at = np.ascontiguousarray(places[:, end : end + count]).reshape(-1, 3)
        wider = np.repeat(more, count)
        vehicle_clearance.rotor_disc_costs(
            at, hung.points.reshape(-1, *hung.points.shape[2:]), wider, self.margins, cost
        )
        entered = np.flatnonzero(cost)
        if not len(entered):
            return
        (moment, segment), cost = np.divmod(entered, count), cost[entered]
        ends = np.stack([places[moment, segment], places[moment, segment + 1]], axis=1)
        np.add.at(found.missed, moment, cost**2)
        after = np.empty(len(cost))
        for vehicle, axis in np.ndindex(2, 3):
            moved = ends.copy()
            moved[:, vehicle, axis] += _STEP
            held = outline_strands(moved[:, 0], moved[:, 1], self.lengths[segment]).points
            vehicle_clearance.rotor_disc_costs(
                moved[:, end].copy(), held, more[moment], self.margins, after
            )
            slope = cost * (after - cost) / _STEP
            np.add.at(found.slopes, (moment, segment + vehicle, axis), slope)
