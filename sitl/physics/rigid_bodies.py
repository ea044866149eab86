"""The vehicles of a world that real autopilots control: rigid bodies with four motors.

Frames: world ENU; body FLU (forward, left, up). State of one vehicle, `COLUMNS` numbers: position
and velocity of the centre (m, m/s), attitude (quaternion w, x, y, z, body to world), body rates
(rad/s), thrusts of the motors (N). Motors are in the order of PX4 and of ArduPilot for a quadrotor
X: front right, rear left (both turn counter-clockwise seen from above), front left, rear right.
"""

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sitl.physics.dynamics import STEP, Bodies
from sitl.physics.geodesy import GRAVITY
from swarm.jit import allocates, compiled, inner
from swarm.signatures import Floats1, Floats2

Array = NDArray[np.float64]

MOTORS = 4
COLUMNS = 17
"""Columns of the state: position 0-2, velocity 3-5, attitude 6-9, rates 10-12, thrusts 13-16."""

_LAG = 0.03
"""Time constant of a motor with its propeller, seconds; 0.02 to 0.05 s are usual at 0.5 m."""
_TORQUE = 0.016
"""Reaction torque of a propeller over its thrust, metres; 0.01 to 0.02 m are usual at 10 inches."""
_RATE_DRAG = 0.02
"""Torque of the air against rotation over the body rate, N m s."""
_GYRATION = (0.36, 0.36, 0.48)
"""Radii of gyration over the radius of the disc: 0.012 and 0.022 kg m² at 1.5 kg and 0.25 m."""
_GRIPPER = 0.1
"""Mass of the gripper at the end of the dropper, part of the vehicle's mass, kg; at most a tenth.

Without it, that end would have 0.03 kg of inertia against a pull from the side, less than a strand
has, and steps that exchange forces with the cable would not be stable."""
SAG = 0.003
"""Metres by which the weight of a vehicle compresses its legs. They are critically damped: one that
touches down at 0.6 m/s stops within 0.05 s, with at most 8 g. Accelerometers measure that: the
estimate of a PX4 that was stopped without it sank on, by 0.35 m/s, on the ground. Grips are closed
at half the diameter of the cable above the floor: legs must not touch it there."""
_STIFFNESS, _DAMPING = GRAVITY / SAG, 2.0 * math.sqrt(GRAVITY / SAG)
"""Of the legs, over the mass: 1/s² and 1/s."""
_FRICTION = 0.7
"""Friction of the legs over the force that presses them; 0.5 to 0.9 are usual of rubber."""
_LEVELLING = 0.05
"""Time constant in which legs level a vehicle that stands on them, seconds: as they are damped."""
_ARM = 0.7
"""Distance of a motor from the centre over the radius of the vehicle's disc."""
_CURVE = 0.65
"""Share of the square in thrust over command: ArduPilot's MOT_THST_EXPO, of usual propellers."""


class Frame(NamedTuple):
    """Constants of vehicles, each (n,): kg, m, m, N of one motor, 1/s.

    ``offset`` is the length of the dropper, and of the legs; ``drag`` is per mass and speed.
    """

    mass: Floats1
    radius: Floats1
    offset: Floats1
    motor: Floats1
    drag: Floats1


def thrusts(command: Array, largest: Array) -> Array:
    """Return the thrusts (n, 4) in newtons for motor commands (n, 4) between 0 and 1.

    ``largest`` (n,) are the motors' full thrusts.
    """
    u = np.clip(command, 0.0, 1.0)
    thrust: Array = largest[:, None] * ((1.0 - _CURVE) * u + _CURVE * u * u)
    return thrust


@compiled
@allocates
def step(
    state: Floats2, frame: Frame, wanted: Floats2, outside: Floats2, floor: float, interval: float
) -> Array:
    """Advance ``state`` (n, COLUMNS) by ``interval`` seconds, in place.

    ``wanted`` (n, 4) are thrusts that the motors approach, newtons. ``outside`` (n, 6) are the
    cable's force at the grip point (N, ENU) and the velocity of the air (m/s, ENU). Returns the
    specific forces (n, 3) in body axes that accelerometers measure, m/s².
    """
    measured = np.empty((len(state), 3))
    rotation = np.empty((3, 3))
    total = np.empty(3)
    for i in range(len(state)):
        body = state[i]
        for k in range(4):
            body[13 + k] += (wanted[i, k] - body[13 + k]) * (1.0 - math.exp(-interval / _LAG))
        _rotation(body, rotation)
        lift = body[13] + body[14] + body[15] + body[16]
        for k in range(3):
            air = frame.drag[i] * (outside[i, 3 + k] - body[3 + k])
            total[k] = (rotation[k, 2] * lift + outside[i, k]) / frame.mass[i] + air
        sunk = floor + frame.offset[i] - body[2]
        pressed = 0.0
        if sunk >= 0.0:
            pressed = max(_STIFFNESS * sunk - _DAMPING * body[5], 0.0)
        total[2] += pressed
        for k in range(3):
            body[3 + k] += interval * (total[k] - (GRAVITY if k == 2 else 0.0))
        _spin(body, rotation, frame, i, outside[i], interval)
        if pressed > 0.0:
            _rub(body, total, pressed, interval)
            _level(body, rotation, frame, i, pressed * interval)
        for k in range(3):
            body[k] += interval * body[3 + k]
        _turn(body, interval)
        for k in range(3):
            measured[i, k] = (
                rotation[0, k] * total[0] + rotation[1, k] * total[1] + rotation[2, k] * total[2]
            )
    return measured


@inner
def _rotation(body: Array, rotation: Array) -> None:
    """Write the rotation matrix (3, 3), body to world, of one vehicle's attitude."""
    w, x, y, z = body[6], body[7], body[8], body[9]
    rotation[0, 0], rotation[0, 1] = 1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z)
    rotation[0, 2], rotation[1, 0] = 2.0 * (x * z + w * y), 2.0 * (x * y + w * z)
    rotation[1, 1], rotation[1, 2] = 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)
    rotation[2, 0], rotation[2, 1] = 2.0 * (x * z - w * y), 2.0 * (y * z + w * x)
    rotation[2, 2] = 1.0 - 2.0 * (x * x + y * y)


@inner
def _inertia(frame: Frame, i: int) -> tuple[float, float, float]:
    """Return the moments of inertia of vehicle ``i`` about its axes, kg m²."""
    scale = frame.mass[i] * frame.radius[i] ** 2
    gripper = min(_GRIPPER, 0.1 * frame.mass[i]) * frame.offset[i] ** 2
    about_x, about_y = scale * _GYRATION[0] ** 2 + gripper, scale * _GYRATION[1] ** 2 + gripper
    return about_x, about_y, scale * _GYRATION[2] ** 2


@inner
def _spin(
    body: Array, rotation: Array, frame: Frame, i: int, outside: Array, interval: float
) -> None:
    """Advance the rates of vehicle ``i``: Euler's equations, body axes.

    The cable pulls at the end of a stiff dropper below the centre.
    """
    arm = _ARM * frame.radius[i] * math.sqrt(0.5)
    first, second, third, fourth = body[13], body[14], body[15], body[16]
    ahead = rotation[0, 0] * outside[0] + rotation[1, 0] * outside[1] + rotation[2, 0] * outside[2]
    left = rotation[0, 1] * outside[0] + rotation[1, 1] * outside[1] + rotation[2, 1] * outside[2]
    p, q, r = body[10], body[11], body[12]
    inertia_x, inertia_y, inertia_z = _inertia(frame, i)
    torque_x = arm * (second + third - first - fourth) + frame.offset[i] * left - _RATE_DRAG * p
    torque_y = arm * (second + fourth - first - third) - frame.offset[i] * ahead - _RATE_DRAG * q
    torque_z = _TORQUE * (third + fourth - first - second) - _RATE_DRAG * r
    body[10] += interval * (torque_x + (inertia_y - inertia_z) * q * r) / inertia_x
    body[11] += interval * (torque_y + (inertia_z - inertia_x) * r * p) / inertia_y
    body[12] += interval * (torque_z + (inertia_x - inertia_y) * p * q) / inertia_z


@inner
def _turn(body: Array, interval: float) -> None:
    """Advance the attitude of one vehicle by its rates."""
    p, q, r = 0.5 * interval * body[10], 0.5 * interval * body[11], 0.5 * interval * body[12]
    w, x, y, z = body[6], body[7], body[8], body[9]
    body[6] = w - p * x - q * y - r * z
    body[7] = x + p * w + r * y - q * z
    body[8] = y + q * w - r * x + p * z
    body[9] = z + r * w + q * x - p * y
    norm = math.sqrt(body[6] ** 2 + body[7] ** 2 + body[8] ** 2 + body[9] ** 2)
    for k in range(6, 10):
        body[k] /= norm


@inner
def _rub(body: Array, total: Array, pressed: float, interval: float) -> None:
    """Slow one vehicle on the floor by friction, at most to rest; add it to what is measured.

    ``total`` (3,) are the forces over the mass, and ``pressed`` that of the floor, m/s².
    """
    slip = math.hypot(body[3], body[4])
    stopped = min(1.0, _FRICTION * pressed * interval / slip) if slip > 0.0 else 0.0
    for k in range(2):
        total[k] -= stopped * body[3 + k] / interval
        body[3 + k] *= 1.0 - stopped


@inner
def _level(body: Array, rotation: Array, frame: Frame, i: int, impulse: float) -> None:
    """Turn the rates of vehicle ``i`` to those that level it on its legs, heading kept.

    The legs stand as far from the centre as the motors: their torque is at most what presses them
    times that arm, or its friction about the vertical. ``impulse`` is of the pressing force over
    the mass, m/s. A vehicle that was levelled at once, by 0.3 rad, took the end of its dropper with
    it, at 60 m/s, and the cable all others.
    """
    torque = impulse * frame.mass[i] * _ARM * frame.radius[i]
    inertia_x, inertia_y, inertia_z = _inertia(frame, i)
    roll = -rotation[2, 1] / _LEVELLING - body[10]
    pitch = rotation[2, 0] / _LEVELLING - body[11]
    body[10] += min(max(roll, -torque / inertia_x), torque / inertia_x)
    body[11] += min(max(pitch, -torque / inertia_y), torque / inertia_y)
    yaw = _FRICTION * torque / inertia_z
    body[12] -= min(max(body[12], -yaw), yaw)


def in_body(attitude: Array, vector: Array) -> Array:
    """Return a world vector (3,) in the axes of a body with a quaternion (w, x, y, z)."""
    axis = -attitude[1:]
    turned: Array = vector + 2.0 * np.cross(axis, np.cross(axis, vector) + attitude[0] * vector)
    return turned


Pose = tuple[Array, Array]
"""Position (3,) of the centre and attitude (w, x, y, z)."""

SUBSTEPS = 8
"""Steps of rigid bodies in one of the world: 400 Hz, the loop of a multicopter's autopilot."""
_LEAST_THRUST = 1.0
"""Thrust per mass (m/s²) from which on the emulator takes its direction for the body's axis."""


class RigidBodies:
    """State of the vehicles with the indices ``rows`` of the world's ``bodies``.

    `place` writes their state into the world's, so that contacts, wash and truth are the same for
    all vehicles.
    """

    def __init__(self, bodies: Bodies, rows: list[int]) -> None:
        self.rows = np.array(rows, dtype=int)
        bodies.outside[self.rows] = True
        self.floor = bodies.floor
        mass = bodies.mass[self.rows]
        self.frame = Frame(
            mass=mass,
            radius=bodies.radius[self.rows],
            offset=bodies.grip_offset[self.rows],
            motor=bodies.thrust_limit[self.rows] * mass / MOTORS,
            drag=bodies.drag[self.rows],
        )
        self.state = np.zeros((len(rows), COLUMNS))
        self.state[:, 0:3] = bodies.position[self.rows]
        yaw = bodies.yaw[self.rows]
        self.state[:, 6], self.state[:, 9] = np.cos(0.5 * yaw), np.sin(0.5 * yaw)
        self.measured = np.tile([0.0, 0.0, GRAVITY], (len(rows), 1))

    def grip_points(self) -> Array:
        """Return the grip points (k, 3), at the ends of stiff droppers."""
        points: Array = self.state[:, 0:3] - self.frame.offset[:, None] * self._axes()
        return points

    def _axes(self) -> Array:
        """Return the bodies' vertical axes in the world (k, 3)."""
        w, x, y, z = self.state[:, 6:10].T
        return np.column_stack(
            [2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)]
        )

    def advance(
        self, command: Array, force: Array, bodies: Bodies, held: Mapping[int, Pose]
    ) -> None:
        """Advance by one of `SUBSTEPS`.

        ``command`` (k, 4) are motor commands between 0 and 1, ``force`` (k, 3) the cable's forces
        on the grip points in newtons, ENU; air and health of the motors are those of ``bodies``.
        Of a tumbling vehicle the first motor gives no thrust, the others all of theirs. ``held``
        are the poses at the end of the step of vehicles in a person's hands, by their indices.
        """
        rows = self.rows
        outside = np.hstack([force, bodies.wind[rows] + bodies.downwash[rows]])
        lost = bodies.tumbling[rows]
        health = np.where(lost, 1.0, bodies.health[rows])
        wanted = thrusts(command, self.frame.motor * health)
        wanted[lost, 0] = 0.0
        before = self.state.copy() if held else self.state
        self.measured = step(self.state, self.frame, wanted, outside, self.floor, STEP / SUBSTEPS)
        for index, pose in held.items():
            for row in np.flatnonzero(rows == index).tolist():
                self._carry(row, before[row], *pose)

    def _carry(self, row: int, before: Array, position: Array, attitude: Array) -> None:
        """Take a vehicle from a state to the pose at the end of a step, as hands do."""
        interval, body = STEP / SUBSTEPS, self.state[row]
        velocity: Array = (position - before[0:3]) / interval
        force: Array = (velocity - before[3:6]) / interval
        force[2] += GRAVITY
        w, x, y, z = before[6:10]
        # the vector part of the rotation from one attitude to the next: half its small angle
        turned = np.array([[-x, w, z, -y], [-y, -z, w, x], [-z, y, -x, w]]) @ attitude
        body[0:3], body[3:6], body[6:10] = position, velocity, attitude
        body[10:13] = 2.0 * turned / interval
        self.measured[row] = in_body(attitude, force)

    def place(self, bodies: Bodies) -> None:
        """Write positions, velocities, thrusts and flags into ``bodies``."""
        rows, state = self.rows, self.state
        bodies.position[rows], bodies.velocity[rows] = state[:, 0:3], state[:, 3:6]
        w, x, y, z = state[:, 6:10].T
        lift = state[:, 13:17].sum(axis=1) / self.frame.mass
        bodies.thrust[rows] = np.maximum(lift, _LEAST_THRUST)[:, None] * self._axes()
        bodies.yaw[rows] = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
        bodies.landed[rows] = state[:, 2] <= self.floor + self.frame.offset + 1e-6
        bodies.armed[rows] = lift > _LEAST_THRUST
