"""Quasi-static loads of the cable on vehicles, as planned and after a failure."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from swarm.geometry.catenary import STANDARD_GRAVITY, Catenaries, solve_catenaries
from swarm.planning import Plan

Floats = npt.NDArray[np.float64]

STEP = 0.1
"""Seconds between samples. Loads change slowly, and no sign change can be missed."""
_NEARLY_STRAIGHT = 0.999
"""Ratio of chord to length at which taut segments are drawn: the taut check refuses them."""


@dataclass(frozen=True, eq=False)
class Loads:
    """Loads at k instants with the cable aloft; newtons.

    ``vertical`` and ``horizontal`` (k, n) are the components of the cable's force on each vehicle
    at its setpoint. ``force`` (k, n) is the whole force, and ``tension`` (k, n − 1) the largest
    tension of each segment, with the segments' ends displaced outwards by the tracking radius.
    """

    time: Floats
    vertical: Floats
    horizontal: Floats
    force: Floats
    tension: Floats


def loads(plan: Plan) -> Loads:
    """Return the quasi-static loads while the cable is aloft."""
    mission = plan.mission
    instants = [
        np.linspace(phase.start, phase.end, max(2, round(phase.duration / STEP) + 1))
        for phase in plan.phases
        if phase.cable == "aloft"
    ]
    time = np.unique(np.concatenate(instants)) if instants else np.empty(0)
    position = plan.motion.at(time)[0]
    length = plan.layout.lengths  # empty where no cable is carried
    start, end = position[:, : len(length)], position[:, 1 : len(length) + 1]
    mass = mission.cable.mass_per_length
    at_setpoint = _forces(_strands(start, end, length), mass)
    chord = np.linalg.norm(end - start, axis=-1, keepdims=True)
    outwards = mission.vehicles.tracking * (end - start) / np.maximum(chord, 1e-9)
    stretched = _strands(start - outwards, end + outwards, length)
    _, at_start, at_end = stretched.tension(mass)
    return Loads(
        time=time,
        vertical=-at_setpoint[..., 2],
        horizontal=np.hypot(at_setpoint[..., 0], at_setpoint[..., 1]),
        force=np.linalg.norm(_forces(stretched, mass), axis=-1),
        tension=np.maximum(at_start, at_end),
    )


def _strands(start: Floats, end: Floats, length: Floats) -> Catenaries:
    chord = np.linalg.norm(end - start, axis=-1)
    return solve_catenaries(start, end, np.maximum(length, chord / _NEARLY_STRAIGHT))


def _forces(strands: Catenaries, mass_per_length: float) -> Floats:
    """Force (k, n, 3) of the cable on every vehicle."""
    at_start, at_end = strands.end_forces(mass_per_length)
    none = np.zeros_like(at_start[:, :1])
    force: Floats = np.concatenate([at_start, none], axis=1)
    force[:, 1:] += at_end
    return force


def payload_limit(plan: Plan) -> float:
    """Return the force that a vehicle can carry in addition to its own weight, newtons."""
    return plan.mission.vehicles.payload * STANDARD_GRAVITY


@dataclass(frozen=True)
class FailureLoad:
    """The largest force on a vehicle after a failure: newtons, both vehicles, and mission time.

    ``vehicle`` carries the load, ``failed`` causes it; indices from 0.
    """

    force: float
    vehicle: int
    failed: int
    time: float


def failed_vehicle_load(plan: Plan) -> FailureLoad | None:
    """Return the largest force on a neighbour of a vehicle that fails aloft, holding the cable.

    The failed vehicle hangs below its neighbours on two straight segments, or below one of them at
    an end of the cable; the cable's own load on the neighbour, at its setpoint, is added. None
    where the cable is never aloft.
    """
    planned = loads(plan)
    if not len(planned.time):
        return None
    position = plan.motion.at(planned.time)[0]
    weight = plan.mission.vehicles.mass * STANDARD_GRAVITY
    own = np.hypot(planned.vertical, planned.horizontal)
    lengths, last = plan.layout.lengths, plan.vehicles - 1
    failures = [
        _largest(own[:, vehicle] + weight, planned.time, vehicle, failed)
        for vehicle, failed in ((1, 0), (last - 1, last))
    ]
    for failed in range(1, last):
        forces = _two_strings(
            position[:, failed - 1], position[:, failed + 1], lengths[failed - 1], lengths[failed],
            weight,
        )  # fmt: skip
        failures += [
            _largest(own[:, vehicle] + force, planned.time, vehicle, failed)
            for force, vehicle in zip(forces, (failed - 1, failed + 1), strict=True)
        ]
    return max(failures, key=lambda load: load.force)


def _largest(force: Floats, time: Floats, vehicle: int, failed: int) -> FailureLoad:
    at = int(np.argmax(force))
    return FailureLoad(float(force[at]), vehicle, failed, float(time[at]))


def _two_strings(
    start: Floats, end: Floats, first: float, last: float, weight: float
) -> tuple[Floats, Floats]:
    """Forces (k,) on two supports (k, 3) of a weight that hangs on two strings."""
    across = np.maximum(np.hypot(end[:, 0] - start[:, 0], end[:, 1] - start[:, 1]), 1e-6)
    rise = end[:, 2] - start[:, 2]
    chord = np.hypot(across, rise)
    along = (first**2 - last**2 + chord**2) / (2.0 * chord)
    depth = np.sqrt(np.maximum(first**2 - along**2, 0.0))
    x = along * across / chord + depth * rise / chord
    z = along * rise / chord - depth * across / chord
    # Balance: horizontal components cancel, vertical ones add up to the weight. A weight beyond one
    # of the supports is carried by that support alone.
    to_start = np.maximum(-z, 1e-6) / np.maximum(x, 1e-6)
    to_end = np.maximum(rise - z, 1e-6) / np.maximum(across - x, 1e-6)
    horizontal = weight / (to_start + to_end)
    between = (x > 0.0) & (x < across)
    on_start = np.where(between, np.hypot(horizontal, horizontal * to_start), weight * (x <= 0.0))
    on_end = np.where(between, np.hypot(horizontal, horizontal * to_end), weight * (x > 0.0))
    return on_start, on_end


def stuck_gripper_load(plan: Plan) -> FailureLoad | None:
    """Return the largest load on a vehicle whose gripper alone stays closed at the release.

    Both ends of the cable hang from it, at most down to the floor. None without a release.
    """
    times = [gate.time for gate in plan.gates if gate.condition == "released"]
    if not times:
        return None
    height = np.maximum(plan.motion.at(times[0])[0][:, 2], 0.0)
    before = np.concatenate([[0.0], np.cumsum(plan.layout.lengths)])
    hanging = np.minimum(before, height) + np.minimum(before[-1] - before, height)
    stuck = int(np.argmax(hanging))
    weight = plan.mission.cable.mass_per_length * STANDARD_GRAVITY
    return FailureLoad(float(hanging[stuck]) * weight, stuck, stuck, times[0])
