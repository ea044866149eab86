"""Missed margins of a team of which some vehicles move together and all others rest; compiled.

Only the moved vehicles and their strands are compared with the others: the rest does not change.
The terms are those of :meth:`swarm.folding.penalty.TeamGeometry.penalty`, preferences included,
where no strand is required on one side of another.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from swarm.folding.chord_clearance import missed_chord
from swarm.folding.end_response import write_largest_response
from swarm.folding.margins import Penalty, PenaltyModel
from swarm.folding.neighbour_clearance import (
    Chain,
    Junction,
    JunctionMemory,
    junction_memory,
    penalize_junction,
)
from swarm.folding.outlines import PIECES, write_outline
from swarm.folding.strand_clearance import StrandPair, penalize_pair, preferred_distance
from swarm.folding.vehicle_clearance import (
    Meeting,
    body_closer,
    missed_by_pair,
    penalize_meeting,
    preferred_meeting,
    rotor_disc_cost,
)
from swarm.geometry.distance import bounding_boxes, boxes_closer, point_distance
from swarm.jit import compiled, inner
from swarm.signatures import Floats1, Floats2, Floats3

Floats = npt.NDArray[np.float64]


class Group(NamedTuple):
    """Vehicles ``first`` … ``last`` − 1, which move together, without a rotation."""

    first: int
    last: int


class TeamState(NamedTuple):
    """Positions (n, 3) of a team at one moment, and what follows from them for its strands.

    ``lengths`` (n − 1,) are those of the segments, ``ratio`` (n − 1,) their chords over them.
    ``points``, ``boxes``, ``shapes`` and ``response`` are as in
    :class:`swarm.folding.margins.Team`, without its first dimension. ``unused`` takes derivatives,
    which count for nothing here, and with ``memory`` is working memory.
    """

    positions: Floats2
    lengths: Floats1
    ratio: Floats1
    points: Floats3
    boxes: Floats3
    shapes: Floats2
    response: Floats2
    unused: Penalty
    memory: JunctionMemory


def team_state(positions: Floats, lengths: Floats) -> TeamState:
    """Return the state of a team at positions (n, 3); :func:`update` makes it complete."""
    count = len(lengths)
    return TeamState(
        positions.copy(),
        lengths,
        np.zeros(count),
        np.zeros((count, PIECES + 1, 3)),
        np.zeros((count, 2, 3)),
        np.zeros((count, 5)),
        np.zeros((count, 2)),
        Penalty(np.zeros(1), np.zeros((1, *positions.shape))),
        junction_memory(),
    )


@compiled
def update(team: TeamState, first: int, last: int, model: PenaltyModel) -> None:
    """Make strands ``first`` … ``last`` − 1 agree with the positions."""
    first, last = max(first, 0), min(last, len(team.lengths))
    for i in range(first, last):
        start, end = team.positions[i], team.positions[i + 1]
        write_outline(start, end, team.lengths[i], team.points[i], team.shapes[i])
        team.ratio[i] = point_distance(start, end) / team.lengths[i]
        tracking = model.margins.tracking
        write_largest_response(team.shapes[i], tracking, model.tables, team.response[i])
    bounding_boxes(team.points[first:last], team.boxes[first:last])


@compiled
def missed_by(team: TeamState, group: Group, enough: float, model: PenaltyModel) -> float:
    """Return the missed margins of moved vehicles and their strands, squared and summed.

    It stops where they are more than ``enough``: the quickest terms come first.
    """
    missed, margins = 0.0, model.margins
    for vehicle in range(group.first, group.last):
        for other in range(len(team.positions)):
            if not group.first <= other < group.last:
                missed += missed_by_pair(team.positions[vehicle], team.positions[other], margins)
    for i in _stretched(team, group):
        if i >= 0:
            missed += max(missed_chord(team.ratio[i], team.lengths[i], 0.0, margins), 0.0) ** 2
    if missed > enough:
        return missed
    for i in _stretched(team, group):
        if i >= 0:
            for end in (i, i + 1):
                cost = rotor_disc_cost(team.positions[end], team.points[i], 0.0, margins)
                missed += cost * cost
    if missed <= enough:
        missed += _missed_between_strands(team, group, model)
    if missed <= enough:
        missed += _missed_at_vehicles(team, group, model)
    if missed <= enough:
        missed += _missed_at_junctions(team, group, model)
    return missed


@inner
def _stretched(team: TeamState, group: Group) -> tuple[int, int]:
    """Return the strands before and after moved vehicles, −1 where there is none."""
    return group.first - 1, group.last - 1 if group.last <= len(team.lengths) else -1


@inner
def _is_carried(strand: int, group: Group) -> bool:
    """Return whether a strand moves with both its ends."""
    return group.first <= strand < group.last - 1


@inner
def _is_moved(strand: int, group: Group) -> bool:
    """Return whether a strand moves."""
    return group.first - 1 <= strand < group.last


@inner
def _missed_between_strands(team: TeamState, group: Group, model: PenaltyModel) -> float:
    """Return what moved strands miss to those that share no vehicle with them."""
    missed, margins = 0.0, model.margins
    wanted = preferred_distance(margins)
    for i in range(len(team.lengths)):
        for j in range(i + 2, len(team.lengths)):
            if not (_is_moved(i, group) or _is_moved(j, group)):
                continue
            if _is_carried(i, group) and _is_carried(j, group):
                continue
            limit = wanted + margins.tracking * (team.response[i, 0] + team.response[j, 0])
            if boxes_closer(team.boxes, i, team.boxes, j, limit):
                pair = StrandPair(i, j, 0, 0.0, limit)
                missed += penalize_pair(
                    team.points, team.shapes, pair, model, team.unused.gradient[0]
                )
    return missed


@inner
def _missed_at_vehicles(team: TeamState, group: Group, model: PenaltyModel) -> float:
    """Return what moved vehicles miss to the strands of others, and others to moved strands."""
    missed, margins = 0.0, model.margins
    wanted = preferred_meeting(margins)
    for i in range(len(team.positions)):
        moved = group.first <= i < group.last
        for j in range(len(team.lengths)):
            if j in (i, i - 1) or not (moved or _is_moved(j, group)):
                continue
            if moved and _is_carried(j, group):
                continue
            limit = wanted + margins.tracking * team.response[j, 0]
            if body_closer(team.positions[i], margins, team.boxes[j], limit):
                missed += penalize_meeting(
                    team.positions[i], team.points[j], team.shapes[j],
                    Meeting(i, j, 0, 0.0, limit), model,
                    team.unused.gradient[0],
                )  # fmt: skip
    return missed


@inner
def _missed_at_junctions(team: TeamState, group: Group, model: PenaltyModel) -> float:
    """Return what moved strands miss to the next one."""
    chain = Chain(team.points, team.shapes, team.response)
    team.unused.missed[0] = 0.0
    for i in range(max(group.first - 2, 0), min(group.last, len(team.lengths) - 1)):
        if not (_is_carried(i, group) and _is_carried(i + 1, group)):
            penalize_junction(chain, Junction(i, 0.0, team.memory), model, team.unused)
    return float(team.unused.missed[0])
