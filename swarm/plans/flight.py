"""From the pads to the ground again: everything around the fold, leg by leg."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.optimize import linear_sum_assignment

from swarm.mission import Mission
from swarm.plans.plan import Gate, Phase
from swarm.trajectory import Motion, at_rest, followed, leg, staggered

Floats = npt.NDArray[np.float64]

TAKEOFF_HEIGHT = 2.0
"""Grip points rise this high before they go to stand over the cable, metres."""

GRAB_HEIGHT = 0.02
"""Grip points grab at this height, metres: higher up, each grip would draw the laid cable in."""

CARRY_HEIGHT = 0.1
"""Grip points pull in at this height, metres: legs on the floor would stick."""

SETTLING_TIME = 4.0
"""A hanging strand swings for a while after a stop; the hold lasts this long, seconds."""

LAID_SHARE = 0.99
"""Distance of grasp points on the floor over the cable between them: a stretched cable jerks."""

_STAGGER = 1.5
_TOUCHDOWN_SPEED = 0.7
_DESCENT_SPEED = 1.0
"""Autopilots come down more slowly than they climb (PX4: 1.5 m/s, with some to spare here)."""


@dataclass(frozen=True, eq=False)
class Flight:
    """The whole motion with its phases and gates."""

    motion: Motion
    phases: tuple[Phase, ...]
    gates: tuple[Gate, ...]


def whole_flight(mission: Mission, lengths: Floats, fold: Motion) -> Flight:
    """Put take-off, grab, contraction and lift before a fold, hold, release and landing after it.

    ``lengths`` (n − 1,) of the segments; the fold begins with all vehicles at one height on a
    straight line, in order.
    """
    vehicles, clearance = mission.vehicles, mission.clearance
    speed = vehicles.max_speed
    thrust = vehicles.max_acceleration - vehicles.braking_acceleration
    lifted = fold.at(fold.times[0])[0]
    folded = fold.at(fold.times[-1])[0]
    contracted = lifted * [1.0, 1.0, 0.0]
    grasp = _laid_out(contracted, lengths)
    heading = (grasp[-1] - grasp[0]) / np.linalg.norm(grasp[-1] - grasp[0])
    aside = np.array([-heading[1], heading[0], 0.0])
    side = -1.0 if float(np.mean((folded - contracted[-1]) @ aside)) > 0.0 else 1.0
    pads = grasp + 1.5 * clearance.vehicle * side * aside
    up = np.array([0.0, 0.0, TAKEOFF_HEIGHT])
    low = np.array([0.0, 0.0, GRAB_HEIGHT])
    carried = np.array([0.0, 0.0, CARRY_HEIGHT])
    order = _STAGGER * np.arange(len(pads), dtype=float)

    takeoff = followed(
        leg(pads, pads + up, min(speed, _TOUCHDOWN_SPEED), 0.5 * thrust),
        leg(pads + up, grasp + up, speed, thrust),
    )
    grab = staggered(grasp + up, grasp + low, order, min(speed, _TOUCHDOWN_SPEED), thrust)
    contract = followed(
        leg(grasp + low, grasp + carried, min(speed, _TOUCHDOWN_SPEED), 0.25 * thrust),
        leg(grasp + carried, contracted + carried, min(speed, _TOUCHDOWN_SPEED), thrust),
    )
    lift = leg(contracted + carried, lifted, 0.5 * speed, 0.5 * thrust)
    hold = at_rest(folded, SETTLING_TIME)
    finish, land = _release(mission, folded)

    parts: list[tuple[str, Motion, str, bool]] = [
        ("takeoff", takeoff, "floor", False),
        ("grab", grab, "floor", False),
        ("contract", contract, "floor", False),
        ("lift", lift, "lifting", False),
        ("fold", fold, "aloft", True),
        ("hold", hold, "aloft", True),
        ("finish", finish, "free", False),
        ("land", land, "free", False),
    ]
    phases, clock = [], 0.0
    for name, part, cable, reversible in parts:
        end = clock + float(part.times[-1] - part.times[0])
        phases.append(Phase(name, clock, end, cable, reversible))  # type: ignore[arg-type]
        clock = end
    at = {phase.name: phase for phase in phases}
    gates = (
        Gate(0.0, "armed", 60.0),
        Gate(at["takeoff"].end, "airborne", 20.0),
        Gate(at["grab"].end, "gripped", 60.0),
        Gate(at["contract"].end, "settled", 20.0),
        Gate(at["lift"].end, "settled", 20.0),
        Gate(at["fold"].end, "settled", 20.0),
        Gate(at["finish"].start, "released", 20.0),
        Gate(clock, "landed", 60.0),
    )
    return Flight(followed(*(part for _, part, _, _ in parts)), tuple(phases), gates)


def _laid_out(contracted: Floats, lengths: Floats) -> Floats:
    """Grasp points on the floor: almost the full length, about the contracted line's middle."""
    heading = (contracted[-1] - contracted[0]) / np.linalg.norm(contracted[-1] - contracted[0])
    along = np.concatenate([[0.0], np.cumsum(LAID_SHARE * lengths)])
    middle = 0.5 * (contracted[0] + contracted[-1])
    placed: Floats = middle + (along - 0.5 * along[-1])[:, None] * heading
    return placed


def _release(mission: Mission, folded: Floats) -> tuple[Motion, Motion]:
    """Spread out and up from the released knot, go to places around it, and land there.

    Scaling about the middle brings nobody closer together. From there the assignment of least
    squared distances to the places keeps straight, simultaneous ways apart by the smallest
    distance over √2 (Turpin et al. 2014, CAPT).
    """
    vehicles, clearance = mission.vehicles, mission.clearance
    speed = vehicles.max_speed
    thrust = vehicles.max_acceleration - vehicles.braking_acceleration
    apart = 1.5 * (clearance.vehicle + 2.0 * vehicles.tracking)
    middle = folded.mean(axis=0)
    smallest = _smallest_distance(folded)
    spread = middle + (folded - middle) * max(1.0, apart / smallest)
    spread[:, 2] = folded[:, 2] + 1.0
    places = _landing_places(folded, spread, apart)
    chosen = linear_sum_assignment(((spread[:, None, :2] - places[None, :, :2]) ** 2).sum(axis=2))[
        1
    ]
    ground = places[chosen]
    above = ground + np.array([0.0, 0.0, spread[0, 2]])
    finish = followed(leg(folded, spread, speed, thrust), leg(spread, above, speed, thrust))
    near = ground + np.array([0.0, 0.0, 1.0])
    land = followed(
        leg(above, near, min(speed, _DESCENT_SPEED), thrust),
        leg(near, ground, min(speed, _TOUCHDOWN_SPEED), thrust),
    )
    return finish, land


def _smallest_distance(places: Floats) -> float:
    apart = np.linalg.norm(places[:, None, :2] - places[None, :, :2], axis=2)
    return float(apart[np.triu_indices(len(places), 1)].min())


def _landing_places(folded: Floats, spread: Floats, apart: float) -> Floats:
    """Places on a rectangle around the knot, clear of the fallen cable: (m ≥ n, 3) at z = 0."""
    low = np.minimum(folded[:, :2].min(axis=0), spread[:, :2].min(axis=0)) - 2.0
    high = np.maximum(folded[:, :2].max(axis=0), spread[:, :2].max(axis=0)) + 2.0
    while True:
        counts = np.maximum(((high - low) / apart).astype(int), 1)
        if 2 * counts.sum() >= len(folded):
            break
        low, high = low - 0.5, high + 0.5
    x = low[0] + (high - low)[0] * np.arange(counts[0]) / counts[0]
    y = low[1] + (high - low)[1] * np.arange(counts[1]) / counts[1]
    ring = np.concatenate(
        [
            np.stack([x, np.full(len(x), low[1])], 1),
            np.stack([np.full(len(y), high[0]), y], 1),
            np.stack([high[0] + low[0] - x, np.full(len(x), high[1])], 1),
            np.stack([np.full(len(y), low[0]), high[1] + low[1] - y], 1),
        ]
    )
    return np.concatenate([ring, np.zeros((len(ring), 1))], axis=1)
