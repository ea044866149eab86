"""The parts that a flight is put together from, and the heights and speeds that they share."""

from dataclasses import dataclass

from swarm.geometry.motion import Motion, reverse
from swarm.mission import Mission
from swarm.planning.plan import CableState, Condition, PhaseName

TAKEOFF_HEIGHT = 2.0
"""Grip points rise this high before they go to stand over the cable, metres."""

GRAB_HEIGHT = 0.02
"""Grip points grab at this height, metres: higher up, each grip would draw the laid cable in."""

CARRY_HEIGHT = 0.1
"""Grip points pull in at this height, metres: legs on the floor would stick."""

TOUCHDOWN_SPEED = 0.7
DESCENT_SPEED = 1.0
"""Autopilots come down more slowly than they climb (PX4: 1.5 m/s, with some to spare here)."""


@dataclass(frozen=True, eq=False)
class PhaseMotion:
    """A phase-to-be: its motion, what it assumes of the cable, and the gate at its end, if any.

    ``inner`` says that the gate is one of all vehicles but the first and the last.
    """

    name: PhaseName
    motion: Motion
    cable: CableState
    reversible: bool = False
    then: Condition | None = None
    inner: bool = False


def reversed_phase(
    part: PhaseMotion, name: PhaseName, *, then: Condition | None = None, reversible: bool = False
) -> PhaseMotion:
    """The part flown backwards, under another name."""
    return PhaseMotion(name, reverse(part.motion), part.cable, reversible, then)


def usable_acceleration(mission: Mission) -> float:
    """Acceleration that plans may use: what braking along the path needs is kept, m/s²."""
    return mission.vehicles.max_acceleration - mission.vehicles.braking_acceleration
