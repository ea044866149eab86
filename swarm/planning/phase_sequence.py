"""The phases of a flight: take-off, grab, contract and lift, the fold, the hold and the finish."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from swarm.geometry.motion import Motion, at_rest, concatenate, leg, staggered_leg
from swarm.mission import Mission
from swarm.planning.contraction import contraction
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
"""Distance between grip points on the floor over the cable between them; a taut cable jerks."""

PADS_ASIDE = 1.5
"""Distance of pads from the cable on the floor, over the one that vehicles keep from each other."""

_STAGGER = 0.6
"""Seconds between the starts of two neighbours' descents to the cable, from its middle outwards."""

_TIMEOUTS: dict[Condition, float] = {
    "armed": 60.0,
    "airborne": 20.0,
    "gripped": 60.0,
    "settled": 20.0,
    "released": 20.0,
    "landed": 60.0,
}
"""Seconds at each gate: a minute where persons confirm or vehicles must disarm, otherwise several
times what vehicles take."""


@dataclass(frozen=True, eq=False)
class PhaseSequence:
    """A motion divided into phases, with gates between them."""

    motion: Motion
    phases: tuple[Phase, ...]
    gates: tuple[Gate, ...]


def flight_around_fold(
    mission: Mission, lengths: Floats, fold: Motion, *, relaxed: bool = False
) -> PhaseSequence:
    """Return the whole flight around a fold.

    Before the fold: take-off, grab, contract and lift; with a cable that is tied on, take-off and
    lift from the positions below the line. After the fold: the hold and the mission's finish.

    ``lengths`` (n − 1,) are the lengths of the segments, metres. The fold starts with all vehicles
    at one height on a straight line, in order. With ``relaxed`` the contraction ends without pull
    of the cable on the floor, see :func:`swarm.planning.contraction.contraction`. Cable that is
    laid with its slack is not contracted: vehicles only rise from their legs.
    """
    lifted = fold.at(fold.times[0])[0]
    folded = fold.at(fold.times[-1])[0]
    attached = mission.grab == "attached"
    before = (
        _before_fold_attached(mission, lifted)
        if attached
        else _before_fold(mission, lengths, lifted, folded, relaxed=relaxed)
    )
    folding = PhaseMotion("fold", fold, "aloft", reversible=True, gate="settled")
    hold = PhaseMotion("hold", at_rest(folded, mission.hold_time), "aloft", reversible=True)
    after = finish_phases(mission, lengths, (*before, folding), hold)
    gates = [Gate(0.0, "armed", _TIMEOUTS["armed"])]
    if attached:
        gates.insert(0, Gate(0.0, "gripped", _TIMEOUTS["gripped"]))
    return join_phases((*before, folding, *after), gates)


def flight_without_cable(places: Motion, hold_time: float) -> PhaseSequence:
    """Return a flight without cable: take-off, a motion between two rests, hold, and landing.

    The vehicles land straight below the end of the motion, after ``hold_time`` seconds there.
    """
    first, last = places.at(places.times[0])[0], places.at(places.times[-1])[0]
    ground = np.array([1.0, 1.0, 0.0])
    slow = TOUCHDOWN_SPEED
    parts = (
        PhaseMotion("takeoff", leg(first * ground, first, slow, 0.5), "free", gate="airborne"),
        PhaseMotion("fold", places, "free", reversible=True, gate="settled"),
        PhaseMotion("hold", at_rest(last, hold_time), "free", reversible=True),
        PhaseMotion("land", leg(last, last * ground, slow, 0.5), "free", gate="landed"),
    )
    return join_phases(parts, [Gate(0.0, "armed", _TIMEOUTS["armed"])])


def join_phases(motions: tuple[PhaseMotion, ...], gates: list[Gate]) -> PhaseSequence:
    """Return phases one after the other from mission time 0; their gates follow the given ones."""
    phases, gates, start = [], list(gates), 0.0
    for phase in motions:
        end = start + float(phase.motion.times[-1] - phase.motion.times[0])
        phases.append(Phase(phase.name, start, end, phase.cable, phase.reversible))
        if phase.gate is not None:
            gates.append(Gate(end, phase.gate, _TIMEOUTS[phase.gate], phase.inner))
        start = end
    motion = concatenate(*(phase.motion for phase in motions))
    return PhaseSequence(motion, tuple(phases), tuple(gates))


def _before_fold(
    mission: Mission, lengths: Floats, lifted: Floats, folded: Floats, *, relaxed: bool
) -> tuple[PhaseMotion, ...]:
    """Return take-off from pads beside the cable, grab, contraction on the floor, and lift."""
    vehicles = mission.vehicles
    speed, acceleration = vehicles.max_speed, usable_acceleration(mission)
    slow = min(speed, TOUCHDOWN_SPEED)
    contracted = lifted * [1.0, 1.0, 0.0]
    slack = mission.lay == "slack"
    grip = contracted if slack else _grip_points_on_floor(contracted, lengths)
    heading = (grip[-1] - grip[0]) / np.linalg.norm(grip[-1] - grip[0])
    aside = np.array([-heading[1], heading[0], 0.0])
    side = -1.0 if float(np.mean((folded - contracted[-1]) @ aside)) > 0.0 else 1.0
    pads = grip + PADS_ASIDE * mission.clearance.vehicle * side * aside
    up, low, carried = (
        np.array([0.0, 0.0, height]) for height in (TAKEOFF_HEIGHT, GRAB_HEIGHT, CARRY_HEIGHT)
    )
    order = _STAGGER * np.abs(np.arange(len(pads)) - (len(pads) - 1) // 2)
    takeoff = concatenate(
        leg(pads, pads + up, slow, 0.5 * acceleration),
        leg(pads + up, grip + up, speed, acceleration),
    )
    grab = staggered_leg(grip + up, grip + low, order, slow, acceleration)
    rise = leg(grip + low, grip + carried, slow, 0.25 * acceleration)
    inwards = () if slack else contraction(
        mission, lengths, grip + carried, contracted + carried, relaxed=relaxed
    )  # fmt: skip
    lift = leg(contracted + carried, lifted, speed, 0.5 * acceleration)
    return (
        PhaseMotion("takeoff", takeoff, "floor", gate="airborne"),
        PhaseMotion("grab", grab, "floor", gate="gripped"),
        PhaseMotion("contract", concatenate(rise, *inwards), "floor", gate="settled"),
        PhaseMotion("lift", lift, "lifting", gate="settled"),
    )


def _before_fold_attached(mission: Mission, lifted: Floats) -> tuple[PhaseMotion, ...]:
    """Return take-off and lift, straight up with the cable from positions below the line."""
    speed, acceleration = mission.vehicles.max_speed, usable_acceleration(mission)
    ground = lifted * [1.0, 1.0, 0.0]
    hover = lifted.copy()
    hover[:, 2] = np.minimum(0.5 * lifted[:, 2], TAKEOFF_HEIGHT)
    slow = min(speed, TOUCHDOWN_SPEED)
    return (
        PhaseMotion(
            "takeoff", leg(ground, hover, slow, 0.5 * acceleration), "lifting", gate="airborne"
        ),
        PhaseMotion(
            "lift", leg(hover, lifted, 0.5 * speed, 0.5 * acceleration), "lifting", gate="settled"
        ),
    )


def _grip_points_on_floor(contracted: Floats, lengths: Floats) -> Floats:
    """Return grip points (n, 3) on the floor: the cable almost straight, centred on the line."""
    heading = (contracted[-1] - contracted[0]) / np.linalg.norm(contracted[-1] - contracted[0])
    middle = 0.5 * (contracted[0] + contracted[-1])
    placed: Floats = middle + laid_along(lengths)[:, None] * heading
    return placed


def laid_along(lengths: Floats) -> Floats:
    """Return the places (n,) of grip points along cable that is laid straight, from its middle."""
    along = np.concatenate([[0.0], np.cumsum(LAID_SHARE * lengths)])
    placed: Floats = along - 0.5 * along[-1]
    return placed
