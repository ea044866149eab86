"""What the cable pulls on every vehicle, so that the setpoints can carry it.

An autopilot holds its place against a steady pull only as well as its integrator does: with the
usual gains a newton on a vehicle of 1.5 kg moves it by some tenths of a metre for seconds. The pull
is known in the cable model, so it goes into the acceleration setpoint as feed-forward.
"""

import numpy as np
import numpy.typing as npt

from swarm.cable.catenary import STANDARD_GRAVITY
from swarm.cable.floor import rest_on_floor
from swarm.cable.shape import half_angle_for_stretch
from swarm.plans import Plan

Floats = npt.NDArray[np.float64]

STEP = 0.5
"""Seconds of mission time between the moments at which a plan's pull is worked out."""

_VERTICAL = 1e-6
"""Span over length below which a strand counts as hanging straight down and up again."""
_NEARLY_ON_FLOOR = 1e-18
"""Metres of height that stand for none at all."""
_NEWTON, _SETTLED = 60, 1e-9
TAUT = 0.99
"""Chords nearer to taut count as this share: a pull without bound is no use as feed-forward."""


def cable_pull(grip_points: Floats, lengths: Floats, mass_per_length: float) -> Floats:
    """Return the force (…, n, 3) in newtons, ENU, of a held cable on its n vehicles.

    ``grip_points`` (…, n, 3) in metres above the floor at z = 0, ``lengths`` (n − 1,) of the
    segments between them. Parts that reach the floor lie on it and pull with what is lifted.
    """
    above = np.maximum(grip_points, [-np.inf, -np.inf, 0.0])
    start, end = above[..., :-1, :], above[..., 1:, :]
    chords = np.linalg.norm(end - start, axis=-1)
    strands = rest_on_floor(start, end, np.maximum(lengths, chords / TAUT))
    on_start, on_end = strands.end_forces(mass_per_length)
    pull = np.zeros_like(above)
    pull[..., :-1, :] += on_start
    pull[..., 1:, :] += on_end
    return pull


def end_forces(
    start: Floats, end: Floats, lengths: Floats, mass_per_length: float
) -> tuple[Floats, Floats]:
    """Return the forces (n, 3) of n strands on their starts and ends; newtons, ENU.

    ``start`` and ``end`` (n, 3) in metres above the floor at z = 0, no farther apart than
    ``lengths`` (n,). What :func:`swarm.cable.floor.rest_on_floor` has, quickly enough for flight.
    """
    across = end - start
    rise = across[:, 2]
    square = across[:, 0] ** 2 + across[:, 1] ** 2
    span = np.maximum(np.sqrt(square), _VERTICAL * lengths)
    excess = np.maximum(lengths**2 - square - rise**2, 0.0)
    half_angle = np.maximum(half_angle_for_stretch(0.5 * np.log1p(excess / span**2)), _VERTICAL)
    level = np.sqrt(excess + span**2)
    sinh = half_angle * (level / span)
    slope = (rise * np.sqrt(1.0 + sinh**2) - lengths * sinh) / level
    parameter = span / (2.0 * half_angle)
    end_slope = slope + lengths / parameter
    turns = (slope < 0.0) & (end_slope > 0.0)
    lowest = start[:, 2] - np.where(turns, parameter * (np.sqrt(1.0 + slope**2) - 1.0), 0.0)
    horizontal = STANDARD_GRAVITY * mass_per_length * parameter
    on_start = across * (horizontal / span)[:, None]
    on_end = -on_start
    on_start[:, 2] = horizontal * slope
    on_end[:, 2] = -horizontal * end_slope
    low = np.flatnonzero(lowest < 0.0)
    if len(low):
        heights = np.maximum(np.stack([start[low, 2], end[low, 2]]), _NEARLY_ON_FLOOR)
        lying, lifted = _on_floor(heights, lengths[low] - np.sqrt(square[low]))
        weight = STANDARD_GRAVITY * mass_per_length
        on_start[low] = across[low] * (weight * lying / span[low])[:, None]
        on_end[low] = -on_start[low]
        on_start[low, 2], on_end[low, 2] = -weight * lifted
    return on_start, on_end


def _on_floor(heights: Floats, surplus: Floats) -> tuple[Floats, Floats]:
    """Return parameters (n,) and lifted lengths (2, n) of strands that partly lie on the floor.

    ``heights`` (2, n) of the ends, ``surplus`` (n,) of cable over span. From height h a branch of
    parameter a comes down over an arc s = √(h² + 2ah) and a reach a·arcosh(1 + h/a); both branches'
    s − reach are the surplus. Newton in log a against its logarithm; 0 where cable lies loose.
    """
    loose = surplus >= heights[0] + heights[1]
    target = np.log(np.where(loose, 0.5 * (heights[0] + heights[1]), surplus))
    log_a = np.log(heights[0] + heights[1])
    for _ in range(_NEWTON):
        a = np.exp(log_a)
        arc = np.sqrt(heights * (heights + 2.0 * a))
        angle = 2.0 * np.arcsinh(np.sqrt(0.5 * heights / a))
        square = np.minimum(angle * angle, 1.0)
        # sinh θ − θ of a small θ by its series, where the difference would cancel
        series = 1 + square / 42 * (1 + square / 72 * (1 + square / 110))
        series = a * angle * (square / 6) * (1 + square / 20 * series)
        left = np.add.reduce(np.where(angle < 1.0, series, arc - a * angle))
        slope = np.add.reduce(2.0 * heights / arc - angle) * a
        step = np.clip((target - np.log(left)) * left / slope, -2.0, 2.0)
        log_a += step
        if np.count_nonzero(np.abs(step) > _SETTLED) == 0:
            break
    a = np.where(loose, 0.0, np.exp(log_a))
    return a, np.sqrt(heights * (heights + 2.0 * a))


class PlannedPull:
    """The cable's pull along a plan, worked out once while everybody holds it."""

    def __init__(self, plan: Plan) -> None:
        at = {gate.condition: gate.time for gate in reversed(plan.gates)}
        self._start = at.get("gripped", 0.0)
        held = max(at.get("released", plan.duration) - self._start, STEP)
        times = self._start + np.arange(0.0, held + 2.0 * STEP, STEP)
        grips = plan.motion.at(times)[0]
        self._pull = cable_pull(grips, plan.layout.lengths, plan.mission.cable.mass_per_length)
        self._change = np.diff(self._pull, axis=0)

    def at(self, time: float) -> Floats:
        """Return the pull (n, 3) in newtons, ENU, at a mission time, everybody holding on."""
        place = min(max((time - self._start) / STEP, 0.0), len(self._pull) - 1.001)
        before = int(place)
        pull: Floats = self._change[before] * (place - before)
        pull += self._pull[before]
        return pull
