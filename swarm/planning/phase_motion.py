"""The motion of one phase, and the heights and speeds that all phases share."""

from dataclasses import dataclass

from swarm.geometry.motion import Motion, reverse
from swarm.mission import Mission
from swarm.planning.plan import CableState, Condition, PhaseName

TAKEOFF_HEIGHT = 2.0
"""Height of the grip points after take-off, before they move above the cable, metres."""

GRAB_HEIGHT = 0.02
"""Height of the grip points when they grip, metres: higher, a grip pulls the laid cable inward."""

CARRY_HEIGHT = 0.1
"""Height of the grip points while the line contracts, metres: landing legs clear the floor."""

TOUCHDOWN_SPEED, DESCENT_SPEED = 0.7, 1.0
"""Speeds of descent near the floor and above it, m/s. Autopilots descend more slowly than they
climb (PX4: at most 1.5 m/s)."""


@dataclass(frozen=True, eq=False)
class PhaseMotion:
    """A phase before it has a place in time: its motion, cable state and the gate at its end.

    ``gate`` is None where the next phase follows without a gate. With ``inner`` the gate is for all
    vehicles but the first and the last.
    """

    name: PhaseName
    motion: Motion
    cable: CableState
    reversible: bool = False
    gate: Condition | None = None
    inner: bool = False


def reversed_phase(
    phase: PhaseMotion, name: PhaseName, *, gate: Condition | None = None, reversible: bool = False
) -> PhaseMotion:
    """Return the phase flown backwards, under another name and with another gate."""
    return PhaseMotion(name, reverse(phase.motion), phase.cable, reversible, gate)


def usable_acceleration(mission: Mission) -> float:
    """Return the acceleration for plans, m/s²: the largest one less the reserve for braking."""
    return mission.vehicles.max_acceleration - mission.vehicles.braking_acceleration
