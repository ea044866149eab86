"""What the cable asks of every vehicle: its weight, its pull, and what a neighbour's loss adds."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from swarm.geometry.catenary import STANDARD_GRAVITY, Catenaries, solve_catenaries
from swarm.planning import Plan

Floats = npt.NDArray[np.float64]

STEP = 0.1
"""Seconds between samples. Loads change slowly and have no sign to miss."""


@dataclass(frozen=True, eq=False)
class Loads:
    """Loads at k instants with the cable aloft; newtons.

    ``vertical`` and ``horizontal`` (k, n) are what the cable does to each vehicle at its setpoint;
    ``pull`` (k, n) is the whole force when each segment's ends err apart by the tracking ball;
    ``tension`` (k, n − 1) the largest tension in each segment then.
    """

    time: Floats
    vertical: Floats
    horizontal: Floats
    pull: Floats
    tension: Floats


def loads(plan: Plan) -> Loads:
    """Return the quasi-static loads while the cable is aloft."""
    mission = plan.mission
    instants = [
        np.linspace(phase.start, phase.end, max(2, round((phase.end - phase.start) / STEP) + 1))
        for phase in plan.phases
        if phase.cable == "aloft"
    ]
    time = np.unique(np.concatenate(instants)) if instants else np.empty(0)
    place = plan.motion.at(time)[0]
    length = plan.layout.lengths  # none where no cable is carried
    start, end = place[:, : len(length)], place[:, 1 : len(length) + 1]
    weight = mission.cable.mass_per_length
    at_setpoint = _forces(_hung(start, end, length), weight)
    chord = np.linalg.norm(end - start, axis=-1, keepdims=True)
    away = mission.vehicles.tracking * (end - start) / np.maximum(chord, 1e-9)
    stretched = _hung(start - away, end + away, length)
    _, at_start, at_end = stretched.tension(weight)
    return Loads(
        time=time,
        vertical=-at_setpoint[..., 2],
        horizontal=np.hypot(at_setpoint[..., 0], at_setpoint[..., 1]),
        pull=np.linalg.norm(_forces(stretched, weight), axis=-1),
        tension=np.maximum(at_start, at_end),
    )


def _hung(start: Floats, end: Floats, length: Floats) -> Catenaries:
    """Hang the segments; taut ones as at 0.999 of their length, the taut rule refuses them."""
    chord = np.linalg.norm(end - start, axis=-1)
    return solve_catenaries(start, end, np.maximum(length, chord / 0.999))


def _forces(strands: Catenaries, weight: float) -> Floats:
    """Force (k, n, 3) of the cable on every vehicle."""
    at_start, at_end = strands.end_forces(weight)
    nothing = np.zeros_like(at_start[:, :1])
    force: Floats = np.concatenate([at_start, nothing], axis=1)
    force[:, 1:] += at_end
    return force


def payload_limit(plan: Plan) -> float:
    """Force that a vehicle can carry beside its own weight, newtons."""
    return plan.mission.vehicles.payload * STANDARD_GRAVITY


@dataclass(frozen=True)
class Mishap:
    """The largest pull on a vehicle after another's failure: newtons, who bears it, and when."""

    pull: float
    bearer: int
    cause: int
    time: float


def dead_vehicle(plan: Plan) -> Mishap | None:
    """Largest pull on a neighbour of a vehicle that dies while it holds the cable, aloft.

    It hangs below its neighbours on two straight segments, or below one of them at an end of the
    cable; the cable's own weight on the bearer, at its setpoint, comes on top. Vehicles are indices
    from 0. None where the cable is never aloft.
    """
    found = loads(plan)
    if not len(found.time):
        return None
    place = plan.motion.at(found.time)[0]
    weight = plan.mission.vehicles.mass * STANDARD_GRAVITY
    own = np.hypot(found.vertical, found.horizontal)
    lengths = plan.layout.lengths
    first = own[:, [1, -2]] + weight
    mishaps = [
        Mishap(
            float(first[:, side].max()), bearer, cause, float(found.time[first[:, side].argmax()])
        )
        for side, (bearer, cause) in enumerate(((1, 0), (plan.vehicles - 2, plan.vehicles - 1)))
    ]
    for dead in range(1, plan.vehicles - 1):
        pulls = _two_strings(
            place[:, dead - 1], place[:, dead + 1], lengths[dead - 1], lengths[dead], weight
        )
        for pull, bearer in zip(pulls, (dead - 1, dead + 1), strict=True):
            whole = own[:, bearer] + pull
            at = int(np.argmax(whole))
            mishaps.append(Mishap(float(whole[at]), bearer, dead, float(found.time[at])))
    return max(mishaps, key=lambda mishap: mishap.pull)


def _two_strings(
    one: Floats, other: Floats, first: float, last: float, weight: float
) -> tuple[Floats, Floats]:
    """Pulls (k,) on two supports (k, 3) of a weight on two strings, as it hangs."""
    across = np.maximum(np.hypot(other[:, 0] - one[:, 0], other[:, 1] - one[:, 1]), 1e-6)
    rise = other[:, 2] - one[:, 2]
    chord = np.hypot(across, rise)
    along = (first**2 - last**2 + chord**2) / (2.0 * chord)
    depth = np.sqrt(np.maximum(first**2 - along**2, 0.0))
    x = along * across / chord + depth * rise / chord
    z = along * rise / chord - depth * across / chord
    # Balance: horizontal parts cancel, vertical ones add up to the weight. If it hangs beyond one
    # of the supports, that one alone bears it.
    to_one = np.maximum(-z, 1e-6) / np.maximum(x, 1e-6)
    to_other = np.maximum(rise - z, 1e-6) / np.maximum(across - x, 1e-6)
    horizontal = weight / (to_one + to_other)
    between = (x > 0.0) & (x < across)
    on_one = np.where(between, np.hypot(horizontal, horizontal * to_one), weight * (x <= 0.0))
    on_other = np.where(between, np.hypot(horizontal, horizontal * to_other), weight * (x > 0.0))
    return on_one, on_other


def stuck_gripper(plan: Plan) -> Mishap | None:
    """Largest weight on a vehicle whose gripper alone stays shut at the release.

    Both ends of the cable hang from it, down to the floor at most. None without a release.
    """
    times = [gate.time for gate in plan.gates if gate.condition == "released"]
    if not times:
        return None
    height = np.maximum(plan.motion.at(times[0])[0][:, 2], 0.0)
    before = np.concatenate([[0.0], np.cumsum(plan.layout.lengths)])
    hanging = np.minimum(before, height) + np.minimum(before[-1] - before, height)
    stuck = int(np.argmax(hanging))
    weight = plan.mission.cable.mass_per_length * STANDARD_GRAVITY
    return Mishap(float(hanging[stuck]) * weight, stuck, stuck, times[0])
