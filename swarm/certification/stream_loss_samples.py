"""Margins of a team at sampled moments after losses of setpoints; compiled.

A loss of one vehicle moves only that vehicle off the plan: distances of all others are computed
once for each moment of the team. Strands that cannot come nearer than other margins of the same
moment are not computed exactly.
"""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from swarm.certification.monitor import Monitor, RequiredNow
from swarm.certification.team_strands import (
    TeamStrands,
    allocate_strands,
    nearest,
    nearest_of,
    place,
)
from swarm.geometry.distance import point_distance
from swarm.jit import compiled, inner
from swarm.signatures import Floats1, Floats2, Floats3, Floats4, Ints1

Floats = npt.NDArray[np.float64]

_LEVERAGE = 5.0
"""Metres by which strands can approach per metre of an end's movement, and more: a sag grows up to
threefold where the chord shrinks, at the allowed chords."""

_ABOVE = 1e-9
"""Metres above the margin of vehicles and chords up to which strands are compared with it: far more
than rounding."""


class Losses(NamedTuple):
    """Positions after losses at k moments, metres ENU.

    ``position`` (k, n, 3) at the loss, ``moved`` (k, n, 3) how far vehicles without setpoints move,
    and ``descent`` (n,) how far one of them descends. ``team`` (s, k, n, 3) are the planned
    positions of the others after each of the ``shares`` (s,) of the motion.
    """

    position: Floats3
    moved: Floats3
    descent: Floats1
    team: Floats4
    shares: Floats1


class Needed(NamedTuple):
    """Required distances, and the cable's ``diameter``, metres.

    From margins below ``enough`` on, a moment is not computed further.
    """

    required: RequiredNow
    diameter: float
    enough: float


class Memory(NamedTuple):
    """Working memory for one moment of n vehicles.

    ``grips`` (n, 3); ``between`` (n, n) and ``chords`` (n − 1,) are margins of the team, ``least``
    (n,) the smallest of each row of ``between``.
    """

    grips: Floats2
    between: Floats2
    chords: Floats1
    least: Floats1
    strands: TeamStrands


def allocate_memory(monitor: Monitor) -> Memory:
    """Return memory for a team; that of the monitor is used for its strands."""
    n = len(monitor.points) + 1
    strands = allocate_strands(monitor.points)
    return Memory(np.empty((n, 3)), np.empty((n, n)), np.empty(n - 1), np.empty(n), strands)


@compiled
def write_margins(
    losses: Losses, needed: Needed, memory: Memory, margins: Floats1, vehicles: Ints1
) -> None:
    """Write the smallest margins (k,), and the vehicles (k,) without setpoints (0: the team)."""
    for k in range(len(margins)):
        margins[k], vehicles[k] = _team_margin(k, losses, needed, memory), 0
        for share in range(len(losses.shares)):
            if margins[k] < needed.enough:
                break
            apart = _measure(losses.team[share, k], needed, memory)
            for vehicle in range(losses.position.shape[1]):
                margin = _vehicle_margin((k, share, vehicle), apart, losses, needed, memory)
                if margin < margins[k]:
                    margins[k], vehicles[k] = margin, vehicle + 1


@inner
def _team_margin(k: int, losses: Losses, needed: Needed, memory: Memory) -> float:
    """Return the smallest margin after a loss of all setpoints at moment k."""
    position, moved, required = losses.position[k], losses.moved[k], needed.required
    apart = _measure(position, needed, memory)
    smallest = _least(memory, -1)
    if smallest > 0.0 and apart < required.strands:
        smallest = min(smallest, apart - required.strands)
    for share in losses.shares:
        farthest = 0.0
        for i in range(len(position)):
            for axis in range(3):
                memory.grips[i, axis] = position[i, axis] + share * moved[i, axis]
            farthest = max(farthest, point_distance(memory.grips[i], position[i]))
        _measure_vehicles(memory.grips, required, memory)
        margin = _least(memory, -1)
        close = apart - _LEVERAGE * farthest < required.strands
        if margin > 0.0 and close and place(memory.grips, required, memory.strands):
            below = margin + required.strands + needed.diameter + _ABOVE
            below = nearest(memory.grips, -1, required, memory.strands, below)
            margin = min(margin, below - needed.diameter - required.strands)
        smallest = min(smallest, margin)
    return smallest


@inner
def _vehicle_margin(
    which: tuple[int, int, int], apart: float, losses: Losses, needed: Needed, memory: Memory
) -> float:
    """Return the margin of a moment, a share and a vehicle that has lost its setpoints.

    ``memory`` has the margins and distances of the team on the plan, ``apart`` the smallest
    distance of its strands.
    """
    (k, share, vehicle), required = which, needed.required
    team, part, grips = losses.team[share, k], losses.shares[share], memory.grips
    # loops: assignments to slices take the compiler half a second each
    for other in range(len(team)):
        for axis in range(3):
            grips[other, axis] = team[other, axis]
    for axis in range(3):
        moved = part * losses.moved[k, vehicle, axis]
        grips[vehicle, axis] = losses.position[k, vehicle, axis] + moved
    grips[vehicle, 2] -= part * losses.descent[vehicle]
    margin = _least(memory, vehicle)
    for other in range(len(team)):
        if other != vehicle:
            margin = min(margin, _apart(grips, vehicle, other, required))
    for segment in range(max(vehicle - 1, 0), min(vehicle + 1, len(team) - 1)):
        margin = min(margin, _slack(grips, segment, required))
    off = point_distance(grips[vehicle], team[vehicle])
    if margin > 0.0 and apart - _LEVERAGE * off < required.strands:
        below = margin + required.strands + needed.diameter + _ABOVE
        below = nearest(team, vehicle, required, memory.strands, below)
        below = nearest_of(grips, vehicle, required, memory.strands, below)
        margin = min(margin, below - needed.diameter - required.strands)
    return margin


@inner
def _measure(grips: Floats, needed: Needed, memory: Memory) -> float:
    """Write the margins of a team at grip points (n, 3); return the distance of its strands.

    The smallest, surface to surface; NaN where a chord is longer than its strand.
    """
    _measure_vehicles(grips, needed.required, memory)
    if not place(grips, needed.required, memory.strands):
        return float(np.nan)
    middles: float = nearest(grips, -1, needed.required, memory.strands, np.inf)
    return middles - needed.diameter


@inner
def _measure_vehicles(grips: Floats, required: RequiredNow, memory: Memory) -> None:
    """Write the margins between vehicles, and those of chords, at grip points (n, 3)."""
    for i in range(len(grips)):
        memory.least[i] = np.inf
        for j in range(i + 1, len(grips)):
            memory.between[i, j] = _apart(grips, i, j, required)
            memory.least[i] = min(memory.least[i], memory.between[i, j])
    for i in range(len(grips) - 1):
        memory.chords[i] = _slack(grips, i, required)


@inner
def _least(memory: Memory, without: int) -> float:
    """Return the smallest written margin of vehicles and chords, without those of one vehicle."""
    least = np.inf
    for i in range(len(memory.chords)):
        if without not in (i, i + 1):
            least = min(least, memory.chords[i])
    for i in range(len(memory.between)):
        if i != without and memory.least[i] < least:
            for j in range(i + 1, len(memory.between)):
                if j != without:
                    least = min(least, memory.between[i, j])
    return float(least)


@inner
def _apart(grips: Floats, i: int, j: int, required: RequiredNow) -> float:
    """Return the margin between two vehicles, horizontal or vertical."""
    across = math.hypot(grips[i, 0] - grips[j, 0], grips[i, 1] - grips[j, 1])
    across -= required.horizontal
    return float(max(across, abs(grips[i, 2] - grips[j, 2]) - required.vertical))


@inner
def _slack(grips: Floats, segment: int, required: RequiredNow) -> float:
    """Return the margin of a chord."""
    chord = point_distance(grips[segment], grips[segment + 1])
    return float(required.chord[segment] - chord)
