"""Contingency windows: the moments at which a team can land together, or release the cable.

Sampled every STEP seconds; a sample stands for the time around it.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from swarm.geometry.catenary import MAX_CHORD_RATIO
from swarm.geometry.chain import polyline
from swarm.geometry.solids import distances, grown, obstacles_of
from swarm.mission import Mission
from swarm.planning import Plan
from swarm.planning.clock_limits import URGENT

Floats = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

STEP = 0.25
"""Seconds between samples; a vehicle at 2 m/s moves by 0.5 m meanwhile, and a window counts as open
between two open samples only."""
LANDING_SPEED = 0.7
"""m/s; PX4's MPC_LAND_SPEED. With STAGGER it bounds the height differences of a common descent."""
STAGGER = 1.0
"""Seconds by which vehicles may begin a common descent at different times."""
AROUND_ROTORS = 0.1
"""Metres beside a rotor disc within which no cable may fall."""

UP = 1.0
"""Metres by which the team climbs while it separates after a release."""

_NEARLY_STRAIGHT = 0.9999
"""Largest ratio of chord to length at which strands are drawn: a straight one has no catenary."""
_PIECES = 24
"""Pieces of a strand: 12 cm of a strand of 3 m; half of that is added to the rotors' reach."""
_BATCH = 64
"""Moments that are computed together, which bounds the memory."""
_STOP_STEP = 0.05
"""Seconds between the samples of the longest stop; speeds change by 5 cm/s meanwhile at 1 m/s²."""


@dataclass(frozen=True, eq=False)
class ContingencyWindows:
    """Open contingencies at the moments ``time`` (k,) of a plan.

    ``land`` (k,): all vehicles can descend vertically together, up to STAGGER apart; ``release``
    (k,): all can release, move apart and land; ``falls`` (k,): no released cable falls on a rotor.
    Holding is possible at all moments of a certified plan: the team stops along its path.
    """

    time: Floats
    land: Flags
    release: Flags
    falls: Flags

    def share(self, open_: Flags, start: float, end: float) -> float:
        """Return the share of the moments from ``start`` to ``end`` at which a window is open."""
        within = (self.time >= start) & (self.time <= end)
        return float(open_[within].mean()) if within.any() else 0.0

    def longest_wait(self, open_: Flags, start: float, end: float) -> float:
        """Return the largest time, forward or backward, to the nearest open moment; or infinity."""
        if not open_.any():
            return float("inf")
        within = self.time[(self.time >= start) & (self.time <= end)]
        moments = self.time[open_]
        after = np.minimum(np.searchsorted(moments, within), len(moments) - 1)
        before = np.maximum(after - 1, 0)
        wait = np.minimum(np.abs(moments[after] - within), np.abs(within - moments[before]))
        return float(wait.max(initial=0.0))

    def nearest(self, open_: Flags, time: float, low: float, high: float) -> float | None:
        """Return the open moment from ``low`` to ``high`` that is nearest to a time."""
        moments = self.time[open_ & (self.time >= low) & (self.time <= high)]
        if not len(moments):
            return None
        return float(moments[np.argmin(np.abs(moments - time))])

    def can_release(self, time: float) -> bool:
        """Whether all vehicles can release, move apart and land, at the moments beside a time."""
        return self._open(self.release, time)

    def may_fall(self, time: float) -> bool:
        """Whether cable that is released at a time falls on no vehicle, as :meth:`can_release`."""
        return self._open(self.falls, time)

    def can_land(self, time: float) -> bool:
        """Whether all vehicles can land together at a time: at the moments on both sides of it."""
        return self._open(self.land, time)

    def _open(self, flags: Flags, time: float) -> bool:
        if not len(self.time):
            return False
        after = min(int(np.searchsorted(self.time, time)), len(self.time) - 1)
        return bool(flags[after] and flags[max(after - 1, 0)])


def contingency_windows(plan: Plan, *, whole: bool = False) -> ContingencyWindows:
    """Return the windows of a plan while its cable is aloft, or of the ``whole`` flight.

    Both need rotors without cable above them (:func:`rotors_clear`), and no obstacle below
    vehicles; for a release, nor up to UP above them. For landing, vehicles must also be apart
    horizontally, chords must allow that some vehicles are LANDING_SPEED·STAGGER lower than others,
    and no obstacle may be below cable.
    """
    phases = [phase for phase in plan.phases if whole or phase.cable == "aloft"]
    instants = [
        np.linspace(phase.start, phase.end, max(2, int(phase.duration / STEP) + 2))
        for phase in phases
    ]
    time = np.unique(np.concatenate(instants)) if instants else np.empty(0)
    falls = np.ones(len(time), dtype=bool)
    release, land = np.zeros((2, len(time)), dtype=bool)
    hangs = np.zeros(len(time), dtype=bool)
    for phase in phases:
        if phase.cable in {"aloft", "lifting"}:
            hangs |= (time >= phase.start) & (time <= phase.end)
    for begin in range(0, len(time), _BATCH):
        part = slice(begin, begin + _BATCH)
        position, held = plan.motion.at(time[part])[0], hangs[part]
        even = ~held
        if held.any():
            falls[part][held] = rotors_clear(plan, position[held])
            even[held] = _chords_allow_stagger(plan, position[held])
            even[held] &= _cable_clear_below(plan, position[held])
        release[part] = falls[part] & clear_below(plan.mission, position, UP)
        even &= clear_below(plan.mission, position)
        land[part] = falls[part] & _vehicles_apart(plan, position) & even
    return ContingencyWindows(time, land, release, falls)


def clear_below(mission: Mission, position: Floats, up: float = 0.0) -> Flags:
    """Return whether no obstacle is near vehicles (k,), below them, or up to a height above them.

    For grip points (k, n, 3), with tracking errors.
    """
    vehicles, solids = mission.vehicles, obstacles_of(mission)
    bodies = grown(solids, vehicles.radius, vehicles.grip_offset + up)
    return _nothing_below(bodies, position, mission.clearance.obstacle + vehicles.tracking)


def _nothing_below(solids: Floats, points: Floats, required: float) -> Flags:
    """Return whether points (k, q, 3) keep a distance from solids (k,), down to the floor."""
    below = solids.copy()
    below[np.isfinite(below[:, 4]), 11] = np.inf  # what is above a solid comes down to it
    ways = points[:, :, None], points[:, :, None] * [1.0, 1.0, 0.0]
    clear: Flags = np.all([distances(below, ends) >= required for ends in ways], axis=(0, 2, 3))
    return clear


def _cable_clear_below(plan: Plan, position: Floats) -> Flags:
    """Return whether no obstacle is near the cable or below it (k,), for grip points (k, n, 3)."""
    mission = plan.mission
    cable, apart = _cable_points(plan, position)
    required = mission.clearance.obstacle + 0.5 * mission.cable.diameter + 0.5 * apart
    return _nothing_below(obstacles_of(mission), cable, required + mission.vehicles.tracking)


def _cable_points(plan: Plan, position: Floats) -> tuple[Floats, float]:
    """Return points (k, m, 3) of the cable, and how far they are apart at most, metres."""
    lengths = plan.layout.lengths
    chords = np.linalg.norm(np.diff(position, axis=1), axis=-1)
    cable = polyline(position, np.maximum(lengths, chords / _NEARLY_STRAIGHT), _PIECES)
    return cable, float(lengths.max(initial=0.0)) / _PIECES


def rotors_clear(plan: Plan, position: Floats) -> Flags:
    """Return whether no cable is above any rotor disc (k,), for grip points (k, n, 3)."""
    clear: Flags = ~np.any(above_rotors(plan, position), axis=(1, 2))
    return clear


def above_rotors(plan: Plan, position: Floats) -> Flags:
    """Return above which rotor discs which strands are (k, n, n − 1), for grip points (k, n, 3).

    Falling cable, or cable that is set down, would land on them. The discs are widened by tracking
    and AROUND_ROTORS.
    """
    vehicles, lengths = plan.mission.vehicles, plan.layout.lengths
    hits = np.zeros((*position.shape[:2], len(lengths)), dtype=bool)
    if not len(lengths):
        return hits
    cable, apart = _cable_points(plan, position)
    reach = vehicles.radius + vehicles.tracking + AROUND_ROTORS
    # The middle between two points is nearer than both.
    reach += 0.5 * apart
    aside = np.hypot(
        cable[:, None, :, 0] - position[:, :, None, 0],
        cable[:, None, :, 1] - position[:, :, None, 1],
    )
    rotors = position[:, :, None, 2] + vehicles.grip_offset - 2.0 * vehicles.tracking
    above = cable[:, None, :, 2] > rotors
    hit = (aside < reach) & above
    for strand in range(len(lengths)):
        hits[..., strand] = hit[..., strand * _PIECES : (strand + 1) * _PIECES + 1].any(axis=-1)
    return hits


def _vehicles_apart(plan: Plan, position: Floats) -> Flags:
    first, second = np.triu_indices(plan.vehicles, 1)
    step = position[:, first, :2] - position[:, second, :2]
    required = plan.mission.clearance.vehicle + 2.0 * plan.mission.vehicles.tracking
    apart: Flags = np.all(np.hypot(step[..., 0], step[..., 1]) >= required, axis=1)
    return apart


def _chords_allow_stagger(plan: Plan, position: Floats) -> Flags:
    step = np.diff(position, axis=1)
    rise = np.abs(step[..., 2]) + LANDING_SPEED * STAGGER
    chord = np.hypot(np.hypot(step[..., 0], step[..., 1]), rise)
    allowed: Flags = np.all(chord <= longest_chords(plan), axis=1)
    return allowed


def longest_chords(plan: Plan) -> Floats:
    """Return the longest chords (n − 1,) of planned ends, metres: less for the tracking of both."""
    longest: Floats = MAX_CHORD_RATIO * plan.layout.lengths - 2.0 * plan.mission.vehicles.tracking
    return longest


@dataclass(frozen=True)
class LongestStop:
    """The longest stop along the path from the planned speed: seconds, metres, mission time."""

    time: float
    distance: float
    at_time: float


def longest_stop(plan: Plan) -> LongestStop:
    """Return the longest stop with the braking reserve while the cable is aloft.

    The clock slows so that no vehicle brakes by more than b = vehicles.braking_acceleration; the
    fastest vehicle's speed v then takes v / b seconds and v² / 2b metres (setpoint acceleration is
    r²a + ṙv). The clock takes at least 1 / URGENT seconds. Stops without urgency are longer.
    """
    aloft = [phase for phase in plan.phases if phase.cable == "aloft"]
    times = np.concatenate([np.arange(phase.start, phase.end, _STOP_STEP) for phase in aloft])
    speed = np.linalg.norm(plan.motion.at(times)[1], axis=-1).max(axis=1)
    fastest = int(np.argmax(speed))
    braking = plan.mission.vehicles.braking_acceleration
    largest = float(speed[fastest])
    seconds = max(largest / braking, 1.0 / URGENT)
    return LongestStop(seconds, 0.5 * largest * seconds, float(times[fastest]))
