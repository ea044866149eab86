"""Segments that would meet on their ways, looked at together.

Surfaces keep segments apart that pass each other's edges. Two that both cut corners can still meet.
Where they do, the one behind is led again, past where the one ahead is at that moment: a state of
a segment tells the place of the vehicle ahead, and with it the moments at which it may be there.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from swarm.fold.clear import (
    Margins,
    Strands,
    body_cost,
    near_bodies,
    near_strands,
    neighbour_cost,
    strand_cost,
    strands,
)
from swarm.fold.passage import BLOCKED, Passage
from swarm.fold.path import FoldPath

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Timeline:
    """Where vehicles are at every tick: ``progress`` (m, k) of vehicles ``first``, first + 1, …"""

    first: int
    progress: Floats

    def place(self, path: FoldPath, vehicle: int) -> Floats:
        """Places (m, 3) of a vehicle."""
        return path.at(vehicle, self.progress[:, vehicle - self.first])[0]


def meeting_cost(
    table: Passage,
    segment: int,
    others: set[int],
    path: FoldPath,
    lengths: Floats,
    timeline: Timeline,
    margins: Margins,
) -> Floats:
    """Cost (a, b) of a segment's states of coming near other segments ahead, at the same time."""
    step = float(table.ahead[1] - table.ahead[0])
    where = np.round((timeline.progress[:, 0] - table.ahead[0]) / step).astype(np.intp)
    possible = np.argwhere(table.cost < 0.1 * BLOCKED)
    ticks = np.flatnonzero(where >= 0)
    # Every possible state, at every tick at which the vehicle ahead is there.
    row = np.searchsorted(possible[:, 0], where[ticks])
    many = np.searchsorted(possible[:, 0], where[ticks], side="right") - row
    tick = np.repeat(ticks, many)
    state = np.repeat(row, many) + np.arange(many.sum()) - np.repeat(np.cumsum(many) - many, many)
    rear = path.at(segment, table.behind)[0][possible[state, 1]]
    front = path.at(segment + 1, table.ahead)[0][possible[state, 0]]
    own = strands(rear, front, lengths[segment])
    found = np.zeros(len(state))
    for other in others:
        ends = timeline.place(path, other), timeline.place(path, other + 1)
        hung = strands(*ends, lengths[other])
        found += _between(own, (rear, front), hung, ends, tick, other == segment + 1, margins)
    cost = np.zeros_like(table.cost)
    np.maximum.at(cost, (possible[state, 0], possible[state, 1]), found)
    return cost


def _between(
    own: Strands,
    own_ends: tuple[Floats, Floats],
    other: Strands,
    other_ends: tuple[Floats, Floats],
    tick: Ints,
    neighbours: bool,
    margins: Margins,
) -> Floats:
    """Cost (k,) of segments and another one at ticks (k,)."""
    if neighbours:
        return neighbour_cost(own, other[tick], margins)
    cost = np.zeros(len(tick))
    close = np.flatnonzero(_boxes_near(own, other, tick, margins))
    one, two = own[close], other[tick[close]]
    _, row = near_strands(one, two[None], margins)
    np.add.at(cost, close[row], strand_cost(one[row], two[row], margins))
    for end in own_ends:
        _, row = near_bodies(end[close][None], two, margins)
        np.add.at(cost, close[row], body_cost(end[close[row]], two[row], margins))
    for end in other_ends:
        places = end[tick[close]]
        _, row = near_bodies(places[None], one, margins)
        np.add.at(cost, close[row], body_cost(places[row], one[row], margins))
    return cost


def _boxes_near(
    own: Strands, other: Strands, tick: Ints, margins: Margins
) -> npt.NDArray[np.bool_]:
    """Whether boxes around strands are near each other at all, generously."""
    reach = 2.0 * (margins.cable + margins.vehicle_cable) + 8.0 * margins.tracking
    reach += margins.radius + margins.grip_offset
    gap = np.abs(own.middle - other.middle[tick]) - own.reach - other.reach[tick]
    near: npt.NDArray[np.bool_] = gap.max(axis=1) < reach
    return near
