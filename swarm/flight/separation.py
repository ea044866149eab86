"""Separation of the remaining vehicles after one vehicle has failed: it falls, or drifts.

Computed with the plan, for every moment and every vehicle. After the release of the cable, the
remaining vehicles move radially away from the failed vehicle: first all of them as far and as fast
as they can, then each in proportion to its distance from there, and up. Therefore no distance
between them decreases, and no vehicle comes below the failed one. Where obstacles or the fence are
in the way, they climb or move less, or, inside the fence, move farther.
"""

from dataclasses import dataclass
from itertools import chain, product

import numpy as np
import numpy.typing as npt

from swarm.certification.contingency_windows import UP, clear_below
from swarm.certification.limits import inside_fence_by
from swarm.geometry.motion import Motion, concatenate, leg
from swarm.geometry.solids import grown, obstacles_of, planes_between
from swarm.mission import Mission
from swarm.planning import Plan

Floats = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

STEP = 0.5
"""Seconds of mission time between the computed moments; vehicles move by about 1 m meanwhile."""
MOST_SPREAD = 4.0
"""Largest ratio of distances after and before a separation: limits the area that is flown over."""
_SPREADS = 13
"""Spreads that are tried where obstacles or the fence are in the way, down to 1 and up to
MOST_SPREAD: twelfths of the way."""
AWAY = 3.0
"""Metres by which all move away from a failed vehicle at first. Without a position it drifts at
0.4 m/s (the emulator's mean), by 2 m until PX4's dead reckoning ends and it lands, after 5 s."""
SHARE_OF_SPEED = 0.5
"""Share of the vehicles' largest speed and acceleration that the rest of a separation uses."""


@dataclass(frozen=True, eq=False)
class Separations:
    """Separations at the moments ``times`` (k,) of a plan, for the failure of every vehicle j.

    ``spread`` (k, n) is the factor by which distances from vehicle j grow, at most MOST_SPREAD;
    ``below`` (k, n) whether another vehicle is below j, within reach of its fall.
    """

    times: Floats
    spread: Floats
    below: Flags

    def at(self, time: float, failed: int) -> float:
        """Return the spread for a mission time: the larger of the two neighbouring moments'."""
        after = min(int(np.searchsorted(self.times, time)), len(self.times) - 1)
        before = max(after - 1, 0)
        return float(max(self.spread[before, failed], self.spread[after, failed]))


def separations(plan: Plan) -> Separations:
    """Return the separations of a plan for all moments at which the cable is off the floor."""
    n = plan.vehicles
    held = [phase for phase in plan.phases if phase.cable in {"lifting", "aloft"}]
    if not held:
        return Separations(np.zeros(1), np.ones((1, n)), np.zeros((1, n), bool))
    start, end = held[0].start, held[-1].end
    times = np.append(np.arange(start, end, STEP), end)
    position = plan.motion.at(times)[0]
    step = position[:, None, :, :2] - position[:, :, None, :2]
    horizontal = np.hypot(step[..., 0], step[..., 1])
    others = ~np.eye(n, dtype=bool)
    # entry [·, j, i]: failed vehicle j, remaining vehicle i
    vehicles = plan.mission.vehicles
    reach = 2.0 * (vehicles.radius + vehicles.tracking)
    lower = position[:, None, :, 2] < position[:, :, None, 2]
    below = np.any((horizontal < reach) & lower & others, axis=2)
    nearest = np.maximum(_smallest_distances(horizontal, others), 1e-3)
    spread = np.clip(solo_landing_distance(plan.mission) / nearest, 1.0, MOST_SPREAD)
    return Separations(times, spread, below)


def solo_landing_distance(mission: Mission) -> float:
    """Return the horizontal distance in metres at which vehicles land independently."""
    return 1.5 * (mission.clearance.vehicle + 2.0 * mission.vehicles.tracking)


def spread_here(start: Floats, mission: Mission) -> float:
    """Return the factor by which distances of vehicles at ``start`` (n, 3) grow, all alike."""
    nearest = max(_smallest_distance(start), 1e-3)
    return float(np.clip(solo_landing_distance(mission) / nearest, 1.0, MOST_SPREAD))


def separation_motion(
    start: Floats, centre: Floats, away: float, spread: float, mission: Mission, follows: Flags
) -> Motion:
    """Return the motion (n vehicles) from rest at ``start`` (n, 3) apart and up, ENU metres.

    ``centre`` (3,) is the position of the failed vehicle, from which all others move ``away`` (m),
    and then by what their distances from it grow with the factor ``spread``. Where the ways of
    vehicles that follow setpoints, ``follows`` (n,), or their descents would be too near an
    obstacle, or the ways the fence, they move by less than ``spread``, or by more, or without
    climbing, or by less than ``away`` first. Where no descent is clear, only the ways are; where
    no way is, all stay at ``start``. Only those that follow climb.
    """
    nearer = np.linspace(spread, 1.0, _SPREADS)
    farther = np.linspace(spread, MOST_SPREAD, _SPREADS)[1:]
    outward = (start - centre) * (1.0, 1.0, 0.0)
    distance = np.linalg.norm(outward, axis=1, keepdims=True)
    direction = np.divide(outward, distance, out=np.zeros_like(outward), where=distance > 0.0)
    choices = ((True, nearer), (True, farther), (False, nearer))
    moves = (
        product((d,), dict.fromkeys((away, 0.5 * away, 0.0)), (UP, 0.0), s) for d, s in choices
    )
    for descends, first, up, tried in chain(*moves):
        aside = start + first * direction
        end = aside + (tried - 1.0) * outward
        end[follows, 2] += up
        ways = np.stack([start, aside, end])[:, follows]
        clear = _ways_clear(ways[0], ways[1], mission) and _ways_clear(ways[1], ways[2], mission)
        if clear and (not descends or _can_descend(end[follows], mission)):
            break
    vehicles = mission.vehicles
    speed, thrust = vehicles.max_speed, vehicles.max_acceleration - vehicles.braking_acceleration
    apart = leg(aside, end, SHARE_OF_SPEED * speed, SHARE_OF_SPEED * thrust)
    return concatenate(leg(start, aside, speed, thrust), apart) if first else apart


def _ways_clear(start: Floats, end: Floats, mission: Mission) -> bool:
    """Return whether straight ways (n, 3) keep clear of obstacles, and inside the fence.

    A vehicle that is nearer to the fence than planned comes no nearer.
    """
    vehicles = mission.vehicles
    solids = grown(obstacles_of(mission), vehicles.radius, vehicles.grip_offset)
    ways = np.repeat(np.stack([start, end], axis=1), len(solids), axis=0)
    normal, wall = planes_between(np.tile(solids, (len(start), 1)), ways)
    apart = np.einsum("bki,bi->bk", ways, normal).min(axis=1) - wall
    clear = bool(np.all(apart >= mission.clearance.obstacle + vehicles.tracking))
    if mission.workspace.fence is None:
        return clear
    fence = np.array(mission.workspace.fence)
    inside, at_start = (
        inside_fence_by(np.stack([start, to], axis=1), fence) for to in (end, start)
    )
    return clear and bool(
        np.all(inside >= np.minimum(at_start, vehicles.radius + vehicles.tracking))
    )


def _can_descend(end: Floats, mission: Mission) -> bool:
    """Return whether vehicles (n, 3) that descend touch neither each other nor an obstacle."""
    beside = _smallest_distance(end) >= 2.0 * (mission.vehicles.radius + mission.vehicles.tracking)
    return beside and bool(clear_below(mission, end[None])[0])


def _smallest_distance(position: Floats) -> float:
    """Return the smallest horizontal distance among vehicles (n, 3)."""
    first, second = np.triu_indices(len(position), 1)
    level = np.linalg.norm(position[first, :2] - position[second, :2], axis=1)
    return float(level.min(initial=np.inf))


def _smallest_distances(horizontal: Floats, others: Flags) -> Floats:
    """Smallest horizontal distance (k, n) among the remaining vehicles and to the failed one."""
    k, n, _ = horizontal.shape
    smallest = np.empty((k, n))
    for failed in range(n):
        remaining = np.delete(np.arange(n), failed)
        among = horizontal[:, remaining[:, None], remaining][
            :, others[np.ix_(remaining, remaining)]
        ]
        fall = horizontal[:, failed, remaining]
        smallest[:, failed] = np.concatenate([among, fall], axis=1).min(axis=1, initial=np.inf)
    return smallest
