"""What if it stops here: when everybody can hold, land straight down together, or let go.

Looked at every STEP seconds; a moment counts for the time around it.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from swarm.certification.limits import TAUT
from swarm.geometry.chain import polyline
from swarm.planning import Plan

Floats = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

STEP = 0.25
LANDING_SPEED = 0.7
"""m/s; PX4's MPC_LAND_SPEED. With STAGGER it says how uneven a common descent may get."""
STAGGER = 1.0
"""Seconds by which vehicles may begin a common descent before or after another."""
AROUND_ROTORS = 0.1
"""Metres beside a rotor disc within which nothing may come down."""

_POINTS = 24
_PORTION = 64


@dataclass(frozen=True, eq=False)
class ContingencyWindows:
    """What can be done at the moments ``time`` (k,) of a plan.

    ``land`` (k,): all straight down together, up to STAGGER apart; ``release`` (k,): all let go.
    Holding is possible at all of them, where the certificate holds: the team stops along its path.
    """

    time: Floats
    land: Flags
    release: Flags

    def share(self, open_: Flags, start: float, end: float) -> float:
        """Share of the moments from ``start`` to ``end`` at which a window is open."""
        within = (self.time >= start) & (self.time <= end)
        return float(open_[within].mean()) if within.any() else 0.0

    def longest_wait(self, open_: Flags, start: float, end: float) -> float:
        """Largest time, forward or back, to the nearest open moment; infinite if there is none."""
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
        """Whether all can let go at a time: at the moments on both sides of it."""
        return self._open(self.release, time)

    def can_land(self, time: float) -> bool:
        """Whether all can land together at a time: at the moments on both sides of it."""
        return self._open(self.land, time)

    def _open(self, flags: Flags, time: float) -> bool:
        if not len(self.time):
            return False
        after = min(int(np.searchsorted(self.time, time)), len(self.time) - 1)
        return bool(flags[after] and flags[max(after - 1, 0)])


def contingency_windows(plan: Plan, *, whole: bool = False) -> ContingencyWindows:
    """Work out the windows of a plan while its cable is aloft, or of the ``whole`` flight.

    Nothing may hang above a rotor disc, nor beside it by tracking and AROUND_ROTORS: what falls or
    is set down would land on it. To land, vehicles must be apart horizontally besides, and their
    chords must bear that some are LANDING_SPEED·STAGGER lower than others.
    """
    phases = [phase for phase in plan.phases if whole or phase.cable == "aloft"]
    instants = [
        np.linspace(phase.start, phase.end, max(2, int((phase.end - phase.start) / STEP) + 2))
        for phase in phases
    ]
    time = np.unique(np.concatenate(instants)) if instants else np.empty(0)
    release, land = np.ones(len(time), dtype=bool), np.zeros(len(time), dtype=bool)
    hangs = np.zeros(len(time), dtype=bool)
    for phase in phases:
        if phase.cable in {"aloft", "lifting"}:
            hangs |= (time >= phase.start) & (time <= phase.end)
    for begin in range(0, len(time), _PORTION):
        part = slice(begin, begin + _PORTION)
        place, held = plan.motion.at(time[part])[0], hangs[part]
        even = ~held
        if held.any():
            release[part][held] = rotors_clear(plan, place[held])
            even[held] = _uneven(plan, place[held])
        land[part] = release[part] & _apart(plan, place) & even
    return ContingencyWindows(time, land, release)


def rotors_clear(plan: Plan, place: Floats) -> Flags:
    """Whether no cable is above any rotor disc, for grip points (k, n, 3)."""
    vehicles, lengths = plan.mission.vehicles, plan.layout.lengths
    chords = np.linalg.norm(np.diff(place, axis=1), axis=-1)
    cable = polyline(place, np.maximum(lengths, chords / 0.9999), _POINTS)
    reach = vehicles.radius + vehicles.tracking + AROUND_ROTORS
    # A piece's points are this far apart at most, so its middle is nearer than its ends suggest.
    reach += 0.5 * float(lengths.max()) / _POINTS
    aside = np.hypot(
        cable[:, None, :, 0] - place[:, :, None, 0], cable[:, None, :, 1] - place[:, :, None, 1]
    )
    rotors = place[:, :, None, 2] + vehicles.grip_offset - 2.0 * vehicles.tracking
    above = cable[:, None, :, 2] > rotors
    free: Flags = ~np.any((aside < reach) & above, axis=(1, 2))
    return free


def _apart(plan: Plan, place: Floats) -> Flags:
    first, second = np.triu_indices(plan.vehicles, 1)
    apart = place[:, first, :2] - place[:, second, :2]
    needed = plan.mission.clearance.vehicle + 2.0 * plan.mission.vehicles.tracking
    enough: Flags = np.all(np.hypot(apart[..., 0], apart[..., 1]) >= needed, axis=1)
    return enough


def _uneven(plan: Plan, place: Floats) -> Flags:
    step = np.diff(place, axis=1)
    rise = np.abs(step[..., 2]) + LANDING_SPEED * STAGGER
    chord = np.hypot(np.hypot(step[..., 0], step[..., 1]), rise)
    slack = TAUT * plan.layout.lengths - 2.0 * plan.mission.vehicles.tracking
    bearable: Flags = np.all(chord <= slack, axis=1)
    return bearable


@dataclass(frozen=True)
class Stopping:
    """The longest stop along the path, from the planned pace: seconds, metres, and when."""

    time: float
    distance: float
    at_time: float


def longest_stop(plan: Plan) -> Stopping:
    """Return the stop that takes longest with the braking reserve while the cable is aloft.

    The clock slows so that nobody brakes by more than vehicles.braking_acceleration; at that rate
    the fastest vehicle's speed v takes v / b seconds and v² / 2b metres (setpoint acceleration is
    r²a + ṙv).
    """
    aloft = [phase for phase in plan.phases if phase.cable == "aloft"]
    times = np.concatenate([np.arange(phase.start, phase.end, 0.05) for phase in aloft])
    speed = np.linalg.norm(plan.motion.at(times)[1], axis=-1).max(axis=1)
    fastest = int(np.argmax(speed))
    braking = plan.mission.vehicles.braking_acceleration
    largest = float(speed[fastest])
    return Stopping(largest / braking, largest**2 / (2.0 * braking), float(times[fastest]))
