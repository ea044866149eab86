"""The vehicles of a world that real autopilots control: rigid bodies beside the emulated ones."""

import numpy as np
from numpy.typing import NDArray

from sitl.physics import rigid
from sitl.physics.dynamics import STEP, Bodies
from sitl.physics.geodesy import GRAVITY

Array = NDArray[np.float64]

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
        self.frame = rigid.Frame(
            mass=mass,
            radius=bodies.radius[self.rows],
            offset=bodies.grip_offset[self.rows],
            motor=bodies.thrust_limit[self.rows] * mass / rigid.MOTORS,
            drag=bodies.drag[self.rows],
        )
        self.state = np.zeros((len(rows), rigid.COLUMNS))
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

    def advance(self, command: Array, force: Array, bodies: Bodies) -> None:
        """Advance by one of `SUBSTEPS`.

        ``command`` (k, 4) are motor commands between 0 and 1, ``force`` (k, 3) the cable's forces
        on the grip points in newtons, ENU; air and health of the motors are those of ``bodies``.
        Of a tumbling vehicle the first motor gives no thrust, the others all of theirs.
        """
        rows = self.rows
        outside = np.hstack([force, bodies.wind[rows] + bodies.downwash[rows]])
        lost = bodies.tumbling[rows]
        health = np.where(lost, 1.0, bodies.health[rows])
        wanted = rigid.thrusts(command, self.frame.motor * health)
        wanted[lost, 0] = 0.0
        self.measured = rigid.step(
            self.state, self.frame, wanted, outside, self.floor, STEP / SUBSTEPS
        )

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
