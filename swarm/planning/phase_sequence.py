"""From the pads to the ground again: what comes before and after the fold, leg by leg."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from swarm.geometry.motion import Motion, at_rest, concatenate, leg, staggered_leg
from swarm.mission import Mission
from swarm.planning.finishes import finish_phases
from swarm.planning.phase_motion import (
    CARRY_HEIGHT,
    GRAB_HEIGHT,
    TAKEOFF_HEIGHT,
    TOUCHDOWN_SPEED,
    PhaseMotion,
    usable_acceleration,
)
from swarm.planning.plan import Condition, Gate, Phase

Floats = npt.NDArray[np.float64]

LAID_SHARE = 0.99
"""Distance of grasp points on the floor over the cable between them: a stretched cable jerks."""

_STAGGER = 0.6
"""Seconds from one vehicle's descent to the cable to the next one's."""

_TIMEOUTS: dict[Condition, float] = {
    "armed": 60.0,
    "airborne": 20.0,
    "gripped": 60.0,
    "settled": 20.0,
    "released": 20.0,
    "landed": 60.0,
}


@dataclass(frozen=True, eq=False)
class PhaseSequence:
    """The whole motion with its phases and gates."""

    motion: Motion
    phases: tuple[Phase, ...]
    gates: tuple[Gate, ...]


def flight_around_fold(mission: Mission, lengths: Floats, fold: Motion) -> PhaseSequence:
    """Put what the mission asks for before and after a fold.

    Before it: take-off, grab, contraction and lift (or, with a cable that is tied on, take-off and
    lift from the places below the line). After it: the hold and the mission's finish.

    ``lengths`` (n − 1,) of the segments; the fold begins with all vehicles at one height on a
    straight line, in order.
    """
    lifted = fold.at(fold.times[0])[0]
    folded = fold.at(fold.times[-1])[0]
    attached = mission.grab == "attached"
    before = _tied_on(mission, lifted) if attached else _grabbed(mission, lengths, lifted, folded)
    folding = PhaseMotion("fold", fold, "aloft", reversible=True, then="settled")
    hold = PhaseMotion("hold", at_rest(folded, mission.hold_time), "aloft", reversible=True)
    after = finish_phases(mission, lengths, (*before, folding), hold)
    gates = [Gate(0.0, "armed", _TIMEOUTS["armed"])]
    if attached:
        gates.insert(0, Gate(0.0, "gripped", _TIMEOUTS["gripped"]))
    return join_phases((*before, folding, *after), gates)


def flight_without_cable(places: Motion, hold_time: float) -> PhaseSequence:
    """Take off, fly a motion (at rest at its ends) with nothing attached, and land below its end.

    ``hold_time`` in seconds is spent at its end.
    """
    first, last = places.at(places.times[0])[0], places.at(places.times[-1])[0]
    ground = np.array([1.0, 1.0, 0.0])
    slow = TOUCHDOWN_SPEED
    parts = (
        PhaseMotion("takeoff", leg(first * ground, first, slow, 0.5), "free", then="airborne"),
        PhaseMotion("fold", places, "free", reversible=True, then="settled"),
        PhaseMotion("hold", at_rest(last, hold_time), "free", reversible=True),
        PhaseMotion("land", leg(last, last * ground, slow, 0.5), "free", then="landed"),
    )
    return join_phases(parts, [Gate(0.0, "armed", _TIMEOUTS["armed"])])


def join_phases(parts: tuple[PhaseMotion, ...], gates: list[Gate]) -> PhaseSequence:
    """Put parts one after the other, with the gates that they end in behind the given ones."""
    phases, gates, clock = [], list(gates), 0.0
    for part in parts:
        end = clock + float(part.motion.times[-1] - part.motion.times[0])
        phases.append(Phase(part.name, clock, end, part.cable, part.reversible))
        if part.then is not None:
            gates.append(Gate(end, part.then, _TIMEOUTS[part.then], part.inner))
        clock = end
    return PhaseSequence(concatenate(*(part.motion for part in parts)), tuple(phases), tuple(gates))


def _grabbed(
    mission: Mission, lengths: Floats, lifted: Floats, folded: Floats
) -> tuple[PhaseMotion, ...]:
    """From pads beside the cable, grab it off the floor, pull in on the floor, and lift."""
    vehicles = mission.vehicles
    speed, push = vehicles.max_speed, usable_acceleration(mission)
    slow = min(speed, TOUCHDOWN_SPEED)
    contracted = lifted * [1.0, 1.0, 0.0]
    grasp = _laid_out(contracted, lengths)
    heading = (grasp[-1] - grasp[0]) / np.linalg.norm(grasp[-1] - grasp[0])
    aside = np.array([-heading[1], heading[0], 0.0])
    side = -1.0 if float(np.mean((folded - contracted[-1]) @ aside)) > 0.0 else 1.0
    pads = grasp + 1.5 * mission.clearance.vehicle * side * aside
    up, low, carried = (
        np.array([0.0, 0.0, height]) for height in (TAKEOFF_HEIGHT, GRAB_HEIGHT, CARRY_HEIGHT)
    )
    order = _STAGGER * np.arange(len(pads), dtype=float)
    return (
        PhaseMotion(
            "takeoff",
            concatenate(
                leg(pads, pads + up, slow, 0.5 * push), leg(pads + up, grasp + up, speed, push)
            ),
            "floor",
            then="airborne",
        ),
        PhaseMotion(
            "grab",
            staggered_leg(grasp + up, grasp + low, order, slow, push),
            "floor",
            then="gripped",
        ),
        PhaseMotion(
            "contract",
            concatenate(
                leg(grasp + low, grasp + carried, slow, 0.25 * push),
                leg(grasp + carried, contracted + carried, slow, push),
            ),
            "floor",
            then="settled",
        ),
        PhaseMotion(
            "lift",
            leg(contracted + carried, lifted, 0.5 * speed, 0.5 * push),
            "lifting",
            then="settled",
        ),
    )


def _tied_on(mission: Mission, lifted: Floats) -> tuple[PhaseMotion, ...]:
    """Straight up with the cable from places below the line, to which it was brought by hand."""
    speed, push = mission.vehicles.max_speed, usable_acceleration(mission)
    ground = lifted * [1.0, 1.0, 0.0]
    hover = lifted.copy()
    hover[:, 2] = np.minimum(0.5 * lifted[:, 2], TAKEOFF_HEIGHT)
    slow = min(speed, TOUCHDOWN_SPEED)
    return (
        PhaseMotion("takeoff", leg(ground, hover, slow, 0.5 * push), "lifting", then="airborne"),
        PhaseMotion("lift", leg(hover, lifted, 0.5 * speed, 0.5 * push), "lifting", then="settled"),
    )


def _laid_out(contracted: Floats, lengths: Floats) -> Floats:
    """Grasp points on the floor: almost the full length, about the contracted line's middle."""
    heading = (contracted[-1] - contracted[0]) / np.linalg.norm(contracted[-1] - contracted[0])
    along = np.concatenate([[0.0], np.cumsum(LAID_SHARE * lengths)])
    middle = 0.5 * (contracted[0] + contracted[-1])
    placed: Floats = middle + (along - 0.5 * along[-1])[:, None] * heading
    return placed
