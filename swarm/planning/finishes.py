"""The phases after the fold: release, put down, unfold or tighten, and landing."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import scipy

from swarm.geometry.catenary import STANDARD_GRAVITY
from swarm.geometry.motion import Motion, at_rest, concatenate, leg
from swarm.mission import Mission
from swarm.planning.phase_motion import (
    DESCENT_SPEED,
    GRAB_HEIGHT,
    TOUCHDOWN_SPEED,
    PhaseMotion,
    reversed_phase,
    usable_acceleration,
)

Floats = npt.NDArray[np.float64]

PULL_SHARE = 0.5
"""Largest pull of the tightened cable on a vehicle, as a share of its payload."""

MAX_TIGHTENED_SHARE = 0.9
"""Largest distance of the pulled ends over the cable's length: the knot needs the rest."""

TIGHTENING_TIME = 4.0
"""Seconds for which the ends hold the tightened cable."""

_ONE_HEIGHT = 1e-4
"""Metres below which a difference of heights counts as none."""

_CLIMB_OVER = 0.3
"""Metres beyond the downwash clearance that the inner vehicles climb above the ends' paths."""


def finish_phases(
    mission: Mission, lengths: Floats, before: Sequence[PhaseMotion], hold: PhaseMotion
) -> tuple[PhaseMotion, ...]:
    """Return the hold and all phases after it, for the mission's finish.

    ``before`` are the phases up to the fold, included; ``lengths`` (n − 1,) those of the segments.
    """
    folded = hold.motion.at(hold.motion.times[0])[0]
    match mission.finish:
        case "release":
            return _then_release(hold), *_spread_and_land(mission, folded)
        case "hold":
            return _put_down(mission, hold)
        case "unfold":
            return hold, *_unfold(mission, before)
        case "tighten":
            return _then_release(hold, inner=True), *_tighten(mission, lengths, folded)


def _then_release(phase: PhaseMotion, *, inner: bool = False) -> PhaseMotion:
    return replace(phase, gate="released", inner=inner)


def _put_down(mission: Mission, hold: PhaseMotion) -> tuple[PhaseMotion, ...]:
    """Return the hold, a common vertical descent with the knot, and the release on the floor.

    Vehicles at different heights first climb to the height of the highest one, while the cable
    hangs: a descent keeps the shape of the team down to the floor only if all heights are equal.
    """
    hold, folded = _with_equal_heights(mission, hold)
    near, low, ground = folded.copy(), folded.copy(), folded.copy()
    near[:, 2] = np.minimum(1.0, folded[:, 2])
    low[:, 2] = GRAB_HEIGHT
    ground[:, 2] = 0.0
    down = _down(mission, folded, near, low)
    last = leg(low, ground, TOUCHDOWN_SPEED, 0.5)
    if mission.grab == "attached":
        return (
            hold,
            PhaseMotion("descend", down, "landing"),
            PhaseMotion("land", last, "landing", gate="landed"),
        )
    return (
        hold,
        PhaseMotion("descend", down, "landing", gate="released"),
        PhaseMotion("land", last, "free", gate="landed"),
    )


def _with_equal_heights(mission: Mission, hold: PhaseMotion) -> tuple[PhaseMotion, Floats]:
    """Return the hold, with all vehicles at one height at its end, and that position (n, 3)."""
    folded = hold.motion.at(hold.motion.times[0])[0]
    level = folded.copy()
    level[:, 2] = folded[:, 2].max()
    if np.ptp(folded[:, 2]) < _ONE_HEIGHT:
        return hold, folded
    climb = leg(folded, level, DESCENT_SPEED, 0.5 * usable_acceleration(mission))
    motion = concatenate(hold.motion, climb, at_rest(level, mission.hold_time))
    return replace(hold, motion=motion), level


def _unfold(mission: Mission, before: Sequence[PhaseMotion]) -> tuple[PhaseMotion, ...]:
    """Return the flight so far, backwards: fold, lift, contraction, grab and take-off.

    The cable ends where it lay at first, and every vehicle on its pad.
    """
    part: Mapping[str, PhaseMotion] = {phase.name: phase for phase in before}
    reversed_phases = [
        reversed_phase(part["fold"], "unfold", gate="settled", reversible=True),
        reversed_phase(part["lift"], "lower", gate="settled"),
    ]
    if mission.grab == "attached":
        return *reversed_phases, reversed_phase(part["takeoff"], "land", gate="landed")
    return (
        *reversed_phases,
        reversed_phase(part["contract"], "spread", gate="released"),
        reversed_phase(part["grab"], "finish"),
        reversed_phase(part["takeoff"], "land", gate="landed"),
    )


def _tighten(mission: Mission, lengths: Floats, folded: Floats) -> tuple[PhaseMotion, ...]:
    """Return the phases after the inner vehicles have released: tighten, release, and landing.

    The inner vehicles climb. The two end vehicles move apart in opposite directions at their own
    heights, each by half of the increase. Their distance grows until an unknotted cable between
    them, with the floor below, would pull with PULL_SHARE of the payload, or until it is
    MAX_TIGHTENED_SHARE of the length.
    """
    speed, acceleration = mission.vehicles.max_speed, usable_acceleration(mission)
    climb = mission.clearance.downwash + 2.0 * mission.vehicles.tracking + _CLIMB_OVER
    over = folded.copy()
    over[1:-1, 2] += climb
    total = float(lengths.sum())
    weight = mission.cable.mass_per_length * STANDARD_GRAVITY
    pull = PULL_SHARE * mission.vehicles.payload * STANDARD_GRAVITY
    height = float(min(folded[0, 2], folded[-1, 2]))
    reach = max(_span(total, height, pull / weight), _plan_distance(folded[0], folded[-1]))
    between = folded[-1] - folded[0]
    between[2] = 0.0
    heading = between / np.linalg.norm(between)
    pulled, aside = over.copy(), over.copy()
    step = 0.5 * (reach - _plan_distance(folded[0], folded[-1]))
    for end, sign in ((0, -1.0), (-1, 1.0)):
        pulled[end] += sign * step * heading
        aside[end] = pulled[end] + sign * 2.0 * heading
    pulling = concatenate(
        leg(folded, over, speed, acceleration),
        leg(over, pulled, min(speed, DESCENT_SPEED), 0.5 * acceleration),
        at_rest(pulled, TIGHTENING_TIME),
    )
    away = leg(pulled, aside, min(speed, DESCENT_SPEED), 0.5 * acceleration)
    spread, land = _spread_and_land(mission, aside)
    return (
        PhaseMotion("tighten", pulling, "free", gate="released"),
        PhaseMotion("finish", concatenate(away, spread.motion), "free"),
        land,
    )


def _plan_distance(first: Floats, second: Floats) -> float:
    return float(np.hypot(first[0] - second[0], first[1] - second[1]))


def _span(length: float, height: float, pull: float) -> float:
    """Return the span of a hanging cable with a tension of ``pull`` at its ends, metres.

    ``pull`` is in metres of cable (tension over weight per metre). A catenary of parameter a has a
    tension of √(a² + s²) at s metres of cable from its lowest point, and a half span of
    a·asinh(s/a).
    Where the cable reaches the floor, ``height`` below its ends, s is the length off the floor. The
    span is at most MAX_TIGHTENED_SHARE of the length; 0 where the weight of the cable alone pulls
    more.
    """
    hanging = 0.5 * length
    if pull > height and 2.0 * height * pull - height * height < hanging * hanging:
        hanging = math.sqrt(2.0 * height * pull - height * height)
    if pull <= hanging:
        return 0.0
    parameter = math.sqrt(pull * pull - hanging * hanging)
    span = 2.0 * parameter * math.asinh(hanging / parameter) + length - 2.0 * hanging
    return min(span, MAX_TIGHTENED_SHARE * length)


def _spread_and_land(mission: Mission, start: Floats) -> tuple[PhaseMotion, PhaseMotion]:
    """Return the phases in which vehicles spread up and out, fly to landing positions, and land.

    Scaling about the centre brings no two vehicles closer together. The assignment to landing
    positions with the least sum of squared distances keeps straight, simultaneous paths apart by
    the smallest distance over √2 (Turpin et al. 2014, CAPT).
    """
    vehicles, clearance = mission.vehicles, mission.clearance
    speed, acceleration = vehicles.max_speed, usable_acceleration(mission)
    apart = 1.5 * (clearance.vehicle + 2.0 * vehicles.tracking)
    middle = start.mean(axis=0)
    smallest = _smallest_distance(start)
    spread = middle + (start - middle) * max(1.0, apart / smallest)
    spread[:, 2] = start[:, 2] + 1.0
    places = _landing_places(start, spread, apart)
    squared = ((spread[:, None, :2] - places[None, :, :2]) ** 2).sum(axis=2)
    ground = places[scipy.optimize.linear_sum_assignment(squared)[1]]
    above = ground + np.array([0.0, 0.0, float(spread[:, 2].max())])
    away = concatenate(
        leg(start, spread, speed, acceleration), leg(spread, above, speed, acceleration)
    )
    near = ground + np.array([0.0, 0.0, 1.0])
    return (
        PhaseMotion("finish", away, "free"),
        PhaseMotion("land", _down(mission, above, near, ground), "free", gate="landed"),
    )


def _down(mission: Mission, above: Floats, near: Floats, ground: Floats) -> Motion:
    """Return the motion straight down, slower near the ground."""
    speed, acceleration = mission.vehicles.max_speed, usable_acceleration(mission)
    return concatenate(
        leg(above, near, min(speed, DESCENT_SPEED), acceleration),
        leg(near, ground, min(speed, TOUCHDOWN_SPEED), acceleration),
    )


def _smallest_distance(places: Floats) -> float:
    apart = np.linalg.norm(places[:, None, :2] - places[None, :, :2], axis=2)
    return float(apart[np.triu_indices(len(places), 1)].min())


def _landing_places(start: Floats, spread: Floats, apart: float) -> Floats:
    """Return positions (m ≥ n, 3) at z = 0 on a rectangle around the fallen cable."""
    low = np.minimum(start[:, :2].min(axis=0), spread[:, :2].min(axis=0)) - 2.0
    high = np.maximum(start[:, :2].max(axis=0), spread[:, :2].max(axis=0)) + 2.0
    while True:
        counts = np.maximum(((high - low) / apart).astype(int), 1)
        if 2 * counts.sum() >= len(start):
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
