"""The air around vehicles and cable: wind on strands, and the jets below rotors.

Estimates with their sources; how a vehicle answers is that of an autopilot's usual gains.
"""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.linalg import expm

from swarm.geometry.catenary import STANDARD_GRAVITY
from swarm.mission import Mission
from swarm.planning import Plan

Floats = npt.NDArray[np.float64]
Place = tuple[float, float, float]

AIR_DENSITY = 1.225
DRAG_COEFFICIENT = 1.1
"""Of a cylinder across the flow, at the Reynolds numbers of a cable (Hoerner 1965, p. 3-9)."""

_JET_DECAY = 6.2
"""A round turbulent jet's axial speed is 6.2 of its diameter over the distance (Pope 2000, 5.1)."""

_JET_WIDENING = 0.1
"""Its half-width grows by this share of the distance (the same); so does the air below quadrotors
(Bauersfeld et al. 2024, "Robotics meets Fluid Dynamics")."""

STEP = 0.1
LEAST_SINKING = 0.01
"""Metres; less is not worth a word."""
_ANSWER = (2.0, 6.0, 4.0)
"""An autopilot's vertical error for a disturbing acceleration, as a transfer function: with PX4's
defaults MPC_Z_P 1, MPC_Z_VEL_P_ACC 4 and MPC_Z_VEL_I_ACC 2 it is s / (s³ + 4s² + 6s + 2)."""


def wind_down(plan: Plan, speed: float, heading: float) -> Place:
    """Return the unit vector of a cable's effective gravity in a steady wind.

    ``speed`` in m/s blows towards ``heading`` (radians from east to north). The drag is that of
    strands across the wind, ½ρ·c·d·v² per metre, and so an upper bound for the others.
    """
    cable = plan.mission.cable
    drag = 0.5 * AIR_DENSITY * DRAG_COEFFICIENT * cable.diameter * speed * speed
    weight = cable.mass_per_length * STANDARD_GRAVITY
    size = math.hypot(drag, weight)
    return (drag / size * math.cos(heading), drag / size * math.sin(heading), -weight / size)


def induced_speed(mission: Mission) -> float:
    """Speed of the air through a hovering vehicle's rotors, √(T / 2ρA), m/s (momentum theory)."""
    vehicles = mission.vehicles
    area = math.pi * vehicles.radius**2
    return math.sqrt(vehicles.mass * STANDARD_GRAVITY / (2.0 * AIR_DENSITY * area))


def jet_speed(mission: Mission, below: Floats, aside: Floats) -> Floats:
    """Downward speed of the air (…,), m/s, in the jet of a hovering vehicle.

    ``below`` (…,) metres under its rotors, ``aside`` (…,) from their axis. Momentum theory: far
    below a disc of radius R the jet has twice the induced speed and the radius R/√2; beyond about
    six diameters it decays and widens like a round turbulent jet, with a Gaussian profile.
    """
    radius = mission.vehicles.radius / math.sqrt(2.0)
    depth = np.maximum(below, 0.0)
    decay = np.minimum(1.0, _JET_DECAY * 2.0 * radius / np.maximum(depth, 1e-9))
    width = jet_width(mission, depth)
    speed = 2.0 * induced_speed(mission) * decay * np.exp(-0.5 * (aside / width) ** 2)
    blown: Floats = np.where(below > 0.0, speed, 0.0)
    return blown


def jet_width(mission: Mission, below: Floats) -> Floats:
    """Radius (…,) of a vehicle's jet at metres under its rotors."""
    width: Floats = mission.vehicles.radius / math.sqrt(2.0) + _JET_WIDENING * below
    return width


@dataclass(frozen=True)
class Sinking:
    """How far a vehicle sinks in others' jets: metres, who, under whom, air speed (m/s), when."""

    depth: float
    vehicle: int
    above: int
    below: float
    speed: float
    time: float


def deepest_sinking(plan: Plan) -> Sinking | None:
    """Return the largest error that downwash alone makes while the cable is held off the floor.

    Air that comes down through a rotor at speed w takes w / 2v of its thrust at the same power, v
    the induced speed (Leishman 2006, 2.13, for a slow climb; at most half of it here). The
    autopilot answers with _ANSWER. The largest speed counts where
    several jets meet. None where nobody passes below anybody.
    """
    held = [phase for phase in plan.phases if phase.cable in {"lifting", "aloft"}]
    if not held or plan.vehicles < 2:
        return None
    time = np.arange(held[0].start, held[-1].end, STEP)
    place = plan.motion.at(time)[0]
    speeds = np.empty(place.shape[:2])
    sources = np.empty(place.shape[:2], dtype=np.intp)
    for vehicle in range(plan.vehicles):
        step = place - place[:, vehicle : vehicle + 1]
        blown = jet_speed(plan.mission, step[..., 2], np.hypot(step[..., 0], step[..., 1]))
        sources[:, vehicle] = blown.argmax(axis=1)
        speeds[:, vehicle] = blown.max(axis=1)
    lost = np.minimum(0.5, speeds / (2.0 * induced_speed(plan.mission))) * STANDARD_GRAVITY
    depth = _error(lost)
    instant, who = np.unravel_index(np.argmax(depth), depth.shape)
    if depth[instant, who] < LEAST_SINKING:
        return None
    # The air is strongest a little before the vehicle is lowest.
    before = slice(max(0, int(instant) - int(1.5 / STEP)), int(instant) + 1)
    worst = before.start + int(np.argmax(speeds[before, who]))
    above = int(sources[worst, who])
    return Sinking(
        depth=float(depth[instant, who]),
        vehicle=int(who),
        above=above,
        below=float(place[worst, above, 2] - place[worst, who, 2]),
        speed=float(speeds[worst, who]),
        time=float(time[worst]),
    )


def _error(disturbance: Floats) -> Floats:
    """Vertical errors (k, n), metres, for accelerations (k, n) that last a STEP each."""
    # States are 1, s and s² over the polynomial, and the disturbance, which is held for a step.
    rates = np.diag(np.ones(3), 1)
    rates[2, :3] = -np.array(_ANSWER)
    held = expm(STEP * rates)[:3]
    state, error = np.zeros((3, disturbance.shape[1])), np.empty_like(disturbance)
    for k, now in enumerate(disturbance):
        state = held @ np.vstack([state, now])
        error[k] = state[1]
    return error
