"""What follows the fold: release, put down, unfold or tighten, and everybody on the ground."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt
from scipy.optimize import linear_sum_assignment

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
"""Share of a vehicle's payload that tightening may ask of it."""

MAX_TIGHTENED_SHARE = 0.9
"""Largest share of the cable's length to which its ends are pulled apart: the knot keeps some."""

TIGHTENING_TIME = 4.0
"""Seconds for which the ends stay pulled apart."""

_ONE_HEIGHT = 1e-4
"""Metres by which heights may differ that are one."""

_CLIMB_OVER = 0.3
"""Metres beyond the downwash clearance by which the inner vehicles climb over the ends' ways."""


def finish_phases(
    mission: Mission, lengths: Floats, before: Sequence[PhaseMotion], hold: PhaseMotion
) -> tuple[PhaseMotion, ...]:
    """Return the hold and everything after it, for the mission's finish.

    ``before`` are the parts up to and with the fold, ``lengths`` (n − 1,) of the segments.
    """
    folded = hold.motion.at(hold.motion.times[0])[0]
    match mission.finish:
        case "release":
            return _let_go(hold), *_spread_and_land(mission, folded)
        case "hold":
            return _put_down(mission, hold)
        case "unfold":
            return hold, *_unfold(mission, before)
        case "tighten":
            return _let_go(hold, inner=True), *_tighten(mission, lengths, folded)


def _let_go(part: PhaseMotion, *, inner: bool = False) -> PhaseMotion:
    return PhaseMotion(part.name, part.motion, part.cable, part.reversible, "released", inner)


def _put_down(mission: Mission, hold: PhaseMotion) -> tuple[PhaseMotion, ...]:
    """Hold, all straight down together with the knot, let go of it on the floor, and stay there.

    Vehicles at different heights first climb to that of the highest, while the cable hangs: only a
    team at one height comes down to the floor as it is.
    """
    hold, folded = _levelled(mission, hold)
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
            PhaseMotion("land", last, "landing", then="landed"),
        )
    return (
        hold,
        PhaseMotion("descend", down, "landing", then="released"),
        PhaseMotion("land", last, "free", then="landed"),
    )


def _levelled(mission: Mission, hold: PhaseMotion) -> tuple[PhaseMotion, Floats]:
    """The hold, with all at one height at its end, and where that is (n, 3)."""
    folded = hold.motion.at(hold.motion.times[0])[0]
    level = folded.copy()
    level[:, 2] = folded[:, 2].max()
    if np.ptp(folded[:, 2]) < _ONE_HEIGHT:
        return hold, folded
    climb = leg(folded, level, DESCENT_SPEED, 0.5 * usable_acceleration(mission))
    motion = concatenate(hold.motion, climb, at_rest(level, mission.hold_time))
    return replace(hold, motion=motion), level


def _unfold(mission: Mission, before: Sequence[PhaseMotion]) -> tuple[PhaseMotion, ...]:
    """The flight so far, backwards: fold, lift, contraction, grab and take-off, whichever it had.

    The cable ends as it lay, and everybody on its pad.
    """
    part: Mapping[str, PhaseMotion] = {made.name: made for made in before}
    undo = [
        reversed_phase(part["fold"], "unfold", then="settled", reversible=True),
        reversed_phase(part["lift"], "lower", then="settled"),
    ]
    if mission.grab == "attached":
        return *undo, reversed_phase(part["takeoff"], "land", then="landed")
    return (
        *undo,
        reversed_phase(part["contract"], "spread", then="released"),
        reversed_phase(part["grab"], "finish"),
        reversed_phase(part["takeoff"], "land", then="landed"),
    )


def _tighten(mission: Mission, lengths: Floats, folded: Floats) -> tuple[PhaseMotion, ...]:
    """The inner vehicles have let go and climb; the ends pull apart, let go, and all land.

    The ends go opposite ways, straight, at their height, and share what room they need. How far:
    until a cable without a knot between them, the floor below, would pull with PULL_SHARE of the
    payload, or MOST_TIGHTENED of its length.
    """
    speed, push = mission.vehicles.max_speed, usable_acceleration(mission)
    climb = mission.clearance.downwash + 2.0 * mission.vehicles.tracking + _CLIMB_OVER
    over = folded.copy()
    over[1:-1, 2] += climb
    total = float(lengths.sum())
    weight = mission.cable.mass_per_length * STANDARD_GRAVITY
    pull = PULL_SHARE * mission.vehicles.payload * STANDARD_GRAVITY
    height = float(min(folded[0, 2], folded[-1, 2]))
    reach = max(_span(total, height, pull / weight), _apart(folded[0], folded[-1]))
    apart = folded[-1] - folded[0]
    apart[2] = 0.0
    heading = apart / np.linalg.norm(apart)
    pulled, aside = over.copy(), over.copy()
    step = 0.5 * (reach - _apart(folded[0], folded[-1]))
    for end, sign in ((0, -1.0), (-1, 1.0)):
        pulled[end] += sign * step * heading
        aside[end] = pulled[end] + sign * 2.0 * heading
    pulling = concatenate(
        leg(folded, over, speed, push),
        leg(over, pulled, min(speed, DESCENT_SPEED), 0.5 * push),
        at_rest(pulled, TIGHTENING_TIME),
    )
    away = leg(pulled, aside, min(speed, DESCENT_SPEED), 0.5 * push)
    spread, land = _spread_and_land(mission, aside)
    return (
        PhaseMotion("tighten", pulling, "free", then="released"),
        PhaseMotion("finish", concatenate(away, spread.motion), "free"),
        land,
    )


def _apart(one: Floats, other: Floats) -> float:
    return float(np.hypot(one[0] - other[0], one[1] - other[1]))


def _span(length: float, height: float, pull: float) -> float:
    """Distance of the ends of a cable at which it pulls at each with ``pull`` metres of itself.

    A catenary of parameter a has its ends √(a² + s²) over its directrix after s metres from its
    lowest point, and that is the tension there, in metres of cable; its half span is a·asinh(s/a).
    Where the cable reaches the floor, ``height`` below its ends, s is what hangs off the floor.
    At most MOST_TIGHTENED of the length; 0 where the cable alone pulls more.
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
    """Spread out and up from the released knot, go to places around it, and land there.

    Scaling about the middle brings nobody closer together. From there the assignment of least
    squared distances to the places keeps straight, simultaneous ways apart by the smallest
    distance over √2 (Turpin et al. 2014, CAPT).
    """
    vehicles, clearance = mission.vehicles, mission.clearance
    speed, push = vehicles.max_speed, usable_acceleration(mission)
    apart = 1.5 * (clearance.vehicle + 2.0 * vehicles.tracking)
    middle = start.mean(axis=0)
    smallest = _smallest_distance(start)
    spread = middle + (start - middle) * max(1.0, apart / smallest)
    spread[:, 2] = start[:, 2] + 1.0
    places = _landing_places(start, spread, apart)
    squared = ((spread[:, None, :2] - places[None, :, :2]) ** 2).sum(axis=2)
    ground = places[linear_sum_assignment(squared)[1]]
    above = ground + np.array([0.0, 0.0, float(spread[:, 2].max())])
    away = concatenate(leg(start, spread, speed, push), leg(spread, above, speed, push))
    near = ground + np.array([0.0, 0.0, 1.0])
    return (
        PhaseMotion("finish", away, "free"),
        PhaseMotion("land", _down(mission, above, near, ground), "free", then="landed"),
    )


def _down(mission: Mission, above: Floats, near: Floats, ground: Floats) -> Motion:
    """Straight down, and slower near the ground."""
    speed, push = mission.vehicles.max_speed, usable_acceleration(mission)
    return concatenate(
        leg(above, near, min(speed, DESCENT_SPEED), push),
        leg(near, ground, min(speed, TOUCHDOWN_SPEED), push),
    )


def _smallest_distance(places: Floats) -> float:
    apart = np.linalg.norm(places[:, None, :2] - places[None, :, :2], axis=2)
    return float(apart[np.triu_indices(len(places), 1)].min())


def _landing_places(start: Floats, spread: Floats, apart: float) -> Floats:
    """Places on a rectangle around the knot, clear of the fallen cable: (m ≥ n, 3) at z = 0."""
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
