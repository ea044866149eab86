"""Where the survivors go when one vehicle falls out of the air: worked out with the plan.

A path for every moment and every vehicle that may die. The survivors move level, straight away
from the place where the dead one falls, each as much farther as it already is, and up: that brings
nobody nearer to anybody, and nobody under what falls. It is flown once the cable is let go.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from swarm.mission import Mission
from swarm.planning import Plan
from swarm.trajectory import Motion, leg

Floats = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

STEP = 0.5
"""Seconds of mission time between the moments that are worked out."""
UP = 1.0
"""Metres that the team climbs while it moves apart."""
MOST_SPREAD = 4.0
SHARE_OF_SPEED = 0.5


@dataclass(frozen=True, eq=False)
class Escapes:
    """Ways apart at the moments ``times`` (k,) of a plan.

    ``spread`` (k, n) is how many times farther from vehicle j everybody goes if j dies, at most
    MOST_SPREAD; ``under`` (k, n) whether somebody is then below j, within reach of its fall.
    """

    times: Floats
    spread: Floats
    under: Flags

    def at(self, time: float, dead: int) -> float:
        """Return the spread for a mission time: the larger of the moments around it."""
        after = min(int(np.searchsorted(self.times, time)), len(self.times) - 1)
        before = max(after - 1, 0)
        return float(max(self.spread[before, dead], self.spread[after, dead]))


def escapes(plan: Plan) -> Escapes:
    """Work out the escapes of a plan, for all moments at which the cable is held off the floor."""
    held = [phase for phase in plan.phases if phase.cable in {"lifting", "aloft"}]
    if not held:
        return Escapes(np.zeros(1), np.ones((1, plan.vehicles)), np.zeros((1, plan.vehicles), bool))
    start, end = held[0].start, held[-1].end
    times = np.append(np.arange(start, end, STEP), end)
    place = plan.motion.at(times)[0]
    apart = place[:, None, :, :2] - place[:, :, None, :2]
    level = np.hypot(apart[..., 0], apart[..., 1])
    others = ~np.eye(plan.vehicles, dtype=bool)
    # entry [·, j, i] is of the dead vehicle j and of another, i
    vehicles = plan.mission.vehicles
    reach = 2.0 * (vehicles.radius + vehicles.tracking)
    below = place[:, None, :, 2] < place[:, :, None, 2]
    under = np.any((level < reach) & below & others, axis=2)
    nearest = _nearest_pairs(level, others)
    spread = np.clip(wanted_apart(plan.mission) / np.maximum(nearest, 1e-3), 1.0, MOST_SPREAD)
    return Escapes(times, spread, under)


def wanted_apart(mission: Mission) -> float:
    """Return the level distance in metres that two vehicles should have to go down alone."""
    return 1.5 * (mission.clearance.vehicle + 2.0 * mission.vehicles.tracking)


def escape(start: Floats, centre: Floats, spread: float, mission: Mission) -> Motion:
    """Return the motion (n vehicles) from rest at ``start`` (n, 3) apart and up, ENU metres.

    ``centre`` (3,) is what everybody moves away from: the place of the vehicle that fell.
    """
    end = centre + (start - centre) * spread
    end[:, 2] = start[:, 2] + UP
    vehicles = mission.vehicles
    thrust = vehicles.max_acceleration - vehicles.braking_acceleration
    return leg(start, end, SHARE_OF_SPEED * vehicles.max_speed, SHARE_OF_SPEED * thrust)


def _nearest_pairs(level: Floats, others: Flags) -> Floats:
    """Smallest level distance (k, n) between any two of the survivors, and of them to the fall."""
    k, n, _ = level.shape
    nearest = np.empty((k, n))
    for dead in range(n):
        left = np.delete(np.arange(n), dead)
        among = level[:, left[:, None], left][:, others[np.ix_(left, left)]]
        fall = level[:, dead, left]
        nearest[:, dead] = np.concatenate([among, fall], axis=1).min(axis=1, initial=np.inf)
    return nearest
