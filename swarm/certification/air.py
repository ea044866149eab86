"""The air around vehicles and cable: wind on strands, and the downwash of rotors.

Estimates, each with its source. The response of a vehicle is that of an autopilot with default
gains.
"""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy

from swarm.geometry.catenary import STANDARD_GRAVITY
from swarm.geometry.lumped_mass import AIR_DENSITY, NORMAL_DRAG
from swarm.mission import Mission
from swarm.planning import Plan

Floats = npt.NDArray[np.float64]
Place = tuple[float, float, float]

JET_DECAY = 6.2
"""A round turbulent jet's axial speed is 6.2 of its diameter over the distance (Pope 2000, 5.1)."""

JET_WIDENING = 0.1
"""Its half-width grows by this share of the distance (Pope 2000, 5.1), also below quadrotors
(Bauersfeld et al. 2024, "Robotics meets Fluid Dynamics")."""

STEP = 0.1
"""Seconds between samples: a tenth of the response time of the transfer function."""

LEAST_SINKING = 0.01
"""Metres; a smaller sinking is not reported."""

_DENOMINATOR = (2.0, 6.0, 4.0)
"""Coefficients of the transfer function from a disturbing acceleration to the vertical error: with
PX4's defaults MPC_Z_P 1, MPC_Z_VEL_P_ACC 4 and MPC_Z_VEL_I_ACC 2 it is s / (s³ + 4s² + 6s + 2)."""


def wind_tilt(plan: Plan, speed: float) -> float:
    """Return the tilt of a cable's effective gravity in a steady wind: its drag over its weight.

    ``speed`` in m/s. The drag is that of strands across the wind, ½ρ·c·d·v² per metre. It is the
    tangent of the angle to the vertical.
    """
    cable = plan.mission.cable
    drag = 0.5 * AIR_DENSITY * NORMAL_DRAG * cable.diameter * speed * speed
    return drag / (cable.mass_per_length * STANDARD_GRAVITY)


def wind_down(plan: Plan, speed: float, heading: float) -> Place:
    """Return the unit vector of a cable's effective gravity in a steady wind.

    ``speed`` in m/s blows towards ``heading`` (radians from east to north).
    """
    tilt = wind_tilt(plan, speed)
    size = math.hypot(tilt, 1.0)
    return (tilt / size * math.cos(heading), tilt / size * math.sin(heading), -1.0 / size)


def induced_speed(mission: Mission) -> float:
    """Return the induced speed of a hovering vehicle, √(T / 2ρA), m/s (momentum theory)."""
    vehicles = mission.vehicles
    area = math.pi * vehicles.radius**2
    return math.sqrt(vehicles.mass * STANDARD_GRAVITY / (2.0 * AIR_DENSITY * area))


def jet_speed(mission: Mission, below: Floats, aside: Floats) -> Floats:
    """Return the downward speed of the air (…,), m/s, in the jet of a hovering vehicle.

    ``below`` (…,) metres under its rotors, ``aside`` (…,) from their axis. Momentum theory: far
    below a disc of radius R the jet has twice the induced speed and the radius R/√2; beyond about
    six diameters it decays and widens like a round turbulent jet, with a Gaussian profile.
    """
    radius = mission.vehicles.radius / math.sqrt(2.0)
    depth = np.maximum(below, 0.0)
    decay = np.minimum(1.0, JET_DECAY * 2.0 * radius / np.maximum(depth, 1e-9))
    width = jet_width(mission, depth)
    speed = 2.0 * induced_speed(mission) * decay * np.exp(-0.5 * (aside / width) ** 2)
    blown: Floats = np.where(below > 0.0, speed, 0.0)
    return blown


def jet_width(mission: Mission, below: Floats) -> Floats:
    """Return the radius (…,) of a vehicle's jet at ``below`` metres under its rotors."""
    width: Floats = mission.vehicles.radius / math.sqrt(2.0) + JET_WIDENING * below
    return width


@dataclass(frozen=True)
class Sinking:
    """Sinking of a vehicle in the downwash of another.

    ``depth`` in metres; indices of the ``vehicle`` and of that ``above`` it, by ``below`` metres;
    air ``speed`` in m/s; mission ``time``.
    """

    depth: float
    vehicle: int
    above: int
    below: float
    speed: float
    time: float


def deepest_sinking(plan: Plan) -> Sinking | None:
    """Return the largest vertical error by downwash alone while the cable is off the floor.

    None where no vehicle passes below another. See :func:`sinkings`.
    """
    return max(sinkings(plan, LEAST_SINKING), key=lambda sinking: sinking.depth, default=None)


def sinkings(plan: Plan, least: float) -> list[Sinking]:
    """Return vertical errors by downwash alone of ``least`` metres or more, cable off the floor.

    One for each vehicle and each time in which it is so low. Air that comes down through a rotor at
    speed w reduces its thrust by w / 2v at the same power, v the induced speed (Leishman 2006,
    2.13, for a slow climb); here by at most half. The autopilot responds with _DENOMINATOR.
    Where several jets meet, the largest speed counts.
    """
    held = [phase for phase in plan.phases if phase.cable in {"lifting", "aloft"}]
    if not held or plan.vehicles < 2:
        return []
    time = np.arange(held[0].start, held[-1].end, STEP)
    position = plan.motion.at(time)[0]
    speeds = np.empty(position.shape[:2])
    sources = np.empty(position.shape[:2], dtype=np.intp)
    for k in range(plan.vehicles):
        step = position - position[:, k : k + 1]
        blown = jet_speed(plan.mission, step[..., 2], np.hypot(step[..., 0], step[..., 1]))
        sources[:, k] = blown.argmax(axis=1)
        speeds[:, k] = blown.max(axis=1)
    lost = np.minimum(0.5, speeds / (2.0 * induced_speed(plan.mission))) * STANDARD_GRAVITY
    depth = _error(lost)
    errors = []
    for vehicle, below in enumerate((depth >= least).T):
        changes = np.flatnonzero(np.diff(below, prepend=False, append=False))
        for begin, end in changes.reshape(-1, 2):
            instant = int(begin + np.argmax(depth[begin:end, vehicle]))
            # The air is fastest up to 1.5 s before the vehicle is lowest, by the transfer function.
            before = slice(max(0, instant - int(1.5 / STEP)), instant + 1)
            worst = before.start + int(np.argmax(speeds[before, vehicle]))
            above = int(sources[worst, vehicle])
            errors.append(
                Sinking(
                    depth=float(depth[instant, vehicle]),
                    vehicle=vehicle,
                    above=above,
                    below=float(position[worst, above, 2] - position[worst, vehicle, 2]),
                    speed=float(speeds[worst, vehicle]),
                    time=float(time[worst]),
                )
            )
    return errors


def _error(disturbance: Floats) -> Floats:
    """Vertical errors (k, n), metres, for accelerations (k, n) of a STEP each."""
    held = sinking_step(STEP)
    state, error = np.zeros((3, disturbance.shape[1])), np.empty_like(disturbance)
    for k, now in enumerate(disturbance):
        state = held @ np.vstack([state, now])
        error[k] = state[1]
    return error


def sinking_step(step: float) -> Floats:
    """Return the matrix (3, 4) that advances a vehicle's states by ``step`` seconds.

    The states are 1, s and s² over the denominator; the second is the vertical error, metres. The
    fourth column is for the disturbing acceleration, constant for the step.
    """
    rates = np.diag(np.ones(3), 1)
    rates[2, :3] = -np.array(_DENOMINATOR)
    held: Floats = scipy.linalg.expm(step * rates)[:3]
    return held
