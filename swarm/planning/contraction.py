"""The contraction: vehicles drag the cable over the floor, from its lay line to the fold's line."""

import numpy as np
import numpy.typing as npt

from swarm.geometry.motion import Motion, at_rest, leg
from swarm.mission import Mission
from swarm.planning.phase_motion import TOUCHDOWN_SPEED, usable_acceleration

Floats = npt.NDArray[np.float64]

_RELAXING = (0.4, 0.3, 0.2, 0.1, 0.05)
"""Largest slack of a segment, as a share of which vehicles contract farther than the line and go
back; the largest share that keeps cable and vehicles apart. A vehicle that contracts drags the taut
cable behind it, which friction holds, and has all slack before it: until the cable is off the
floor, it is pulled back. Half of the slack would be the same on both sides; in dry runs, with
segments of 18 m, shares of 0.03, 0.1, 0.2 and 0.4 left errors of 0.13, 0.12, 0.12 and 0.08 m in the
lift."""

_RELAXED = 3.0
"""Seconds of rest after that: without, a vehicle was still 0.1 m off when the lift began."""


def contraction(
    mission: Mission, lengths: Floats, laid: Floats, contracted: Floats, *, relaxed: bool
) -> tuple[Motion, ...]:
    """Return the motion from the laid cable to the contracted line, both (n, 3), over the floor.

    ``lengths`` (n − 1,) are those of the segments. With ``relaxed`` vehicles contract farther and
    go back, so that the cable on the floor does not pull them.
    """
    slow = min(mission.vehicles.max_speed, TOUCHDOWN_SPEED)
    acceleration = usable_acceleration(mission)
    if not relaxed:
        return (leg(laid, contracted, slow, acceleration),)
    beyond = _farther(mission, lengths, laid, contracted)
    return (
        leg(laid, beyond, slow, acceleration),
        leg(beyond, contracted, slow, 0.25 * acceleration),
        at_rest(contracted, _RELAXED),
    )


def _farther(mission: Mission, lengths: Floats, laid: Floats, contracted: Floats) -> Floats:
    """Return where vehicles (n, 3) go before they return to the contracted line."""
    step = contracted - laid
    way = np.linalg.norm(step, axis=1, keepdims=True)
    inwards = step / np.maximum(way, 1e-9)
    slack = float((lengths - np.linalg.norm(np.diff(contracted, axis=0), axis=1)).max())
    for share in _RELAXING:
        beyond: Floats = contracted + np.minimum(share * slack, way) * inwards
        if _apart_on_the_floor(mission, lengths, beyond):
            return beyond
    return contracted


def _apart_on_the_floor(mission: Mission, lengths: Floats, grips: Floats) -> bool:
    """Return whether vehicles and cable keep clear on the floor, with grips (n, 3) on a line.

    Cable on the floor may lie anywhere, so that a slack segment reaches beyond its grips by half
    its slack.
    """
    clearance, tracking = mission.clearance, mission.vehicles.tracking
    chords = np.linalg.norm(np.diff(grips, axis=0), axis=1)
    reach = np.pad(0.5 * (lengths - chords) + tracking, 1)
    before, after = reach[:-2], reach[2:]
    body = mission.vehicles.radius + clearance.vehicle_cable + tracking
    required = np.maximum(np.maximum(before, after) + body, before + after + clearance.cable)
    required = np.maximum(required, clearance.vehicle) + 2.0 * tracking
    return bool((chords >= required).all())
