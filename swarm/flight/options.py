"""What could be done at each moment of the flight besides going on: land, release, rewind.

Worked out once from the plan. "Landing" is everybody straight down together: nobody may be above
anybody. "Releasing" drops the cable: no strand may hang above a vehicle.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from swarm.cable.chain import polyline
from swarm.plans import Phase, Plan

Floats = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

STEP = 0.25
"""Seconds of mission time between the moments that are looked at."""
_POINTS = 24
_AROUND_ROTORS = 0.1
_TAUT = 0.9999


@dataclass(frozen=True, eq=False)
class Options:
    """Which ways out are open at the moments ``times`` (k,) of the plan."""

    times: Floats
    can_land: Flags
    can_release: Flags

    def at(self, time: float) -> tuple[bool, bool]:
        """Return whether the team can land, and release, at a mission time.

        Both moments around it must allow it.
        """
        high = min(int(np.searchsorted(self.times, time)), len(self.times) - 1)
        low = max(high - 1, 0)
        return (
            bool(self.can_land[low] and self.can_land[high]),
            bool(self.can_release[low] and self.can_release[high]),
        )

    def nearest(self, flags: Flags, time: float, low: float, high: float) -> float | None:
        """Return the mission time within bounds, nearest to ``time``, at which flags are set."""
        open_at = self.times[flags & (self.times >= low) & (self.times <= high)]
        if not len(open_at):
            return None
        return float(open_at[np.argmin(np.abs(open_at - time))])


def options(plan: Plan) -> Options:
    """Work out the ways out of a plan."""
    times = np.append(np.arange(0.0, plan.duration, STEP), plan.duration)
    position = plan.motion.at(times)[0]
    vehicles, clearance = plan.mission.vehicles, plan.mission.clearance
    can_land = _apart(position) >= clearance.vehicle + 2.0 * vehicles.tracking
    hanging = np.array([plan.phase_at(time).cable in {"lifting", "aloft"} for time in times])
    can_release = np.ones(len(times), dtype=bool)
    can_release[hanging] = _nothing_above(plan, position[hanging])
    return Options(times, can_land, can_release)


def rewind_limit(phase: Phase, gate: float, budget_kept_since: float) -> float | None:
    """Return how far back the clock may run: not through a gate, nor to where errors were large."""
    if not phase.reversible:
        return None
    return max(phase.start, gate, budget_kept_since)


def _apart(position: Floats) -> Floats:
    """Smallest horizontal distance (k,) between any two of n points (k, n, 3)."""
    n = position.shape[1]
    first, second = np.triu_indices(n, 1)
    if not len(first):
        return np.full(len(position), np.inf)
    difference = position[:, first, :2] - position[:, second, :2]
    apart: Floats = np.sqrt(np.einsum("kij,kij->ki", difference, difference).min(axis=1))
    return apart


def _nothing_above(plan: Plan, position: Floats) -> Flags:
    """Whether no cable is above any rotor disc at moments with grip points (k, n, 3)."""
    if not len(position):
        return np.zeros(0, dtype=bool)
    lengths, vehicles = plan.layout.lengths, plan.mission.vehicles
    chords = np.linalg.norm(np.diff(position, axis=1), axis=2)
    fits = np.all(chords < _TAUT * lengths, axis=1)
    free = np.zeros(len(position), dtype=bool)
    reach = vehicles.radius + vehicles.tracking + _AROUND_ROTORS
    for some in np.array_split(np.flatnonzero(fits), max(1, len(position) // 64)):
        cable = polyline(position[some], lengths, _POINTS)
        rotors = position[some]
        aside = np.linalg.norm(cable[:, None, :, :2] - rotors[:, :, None, :2], axis=3)
        above = cable[:, None, :, 2] > rotors[:, :, None, 2] + vehicles.grip_offset
        free[some] = ~np.any((aside < reach) & above, axis=(1, 2))
    return free
