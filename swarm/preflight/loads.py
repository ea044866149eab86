"""What the cable asks of every vehicle: its weight, its pull, and what a neighbour's loss adds."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from swarm.cable.catenary import STANDARD_GRAVITY, Catenaries, hang
from swarm.plans import Plan

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
    start, end = place[:, :-1], place[:, 1:]
    length = plan.layout.lengths
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
    return hang(start, end, np.maximum(length, chord / 0.999))


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
