"""Goals and limits that an autopilot gives to its position controller in autonomous modes.

Each function writes one vehicle's values into `sitl.physics.dynamics.Bodies`.
"""

import math
from typing import Any

import numpy as np

from sitl.protocol.vehicle import Vehicle

_BRAKING = 3.0


def limits(v: Vehicle, speed: float, climb: float, descend: float) -> None:
    """Set the speed limits of the position controller (m/s)."""
    b, i = v.bodies, v.index
    b.speed_limit[i] = min(speed, v.spec.max_speed)
    b.climb_limit[i] = climb
    b.descend_limit[i] = descend
    b.refresh()


def set_speed(v: Vehicle, speed: float) -> None:
    """Set the horizontal speed limit (m/s), as MAV_CMD_DO_CHANGE_SPEED does."""
    if math.isfinite(speed) and speed > 0:
        v.bodies.speed_limit[v.index] = min(speed, v.spec.max_speed)
        v.bodies.refresh()


def gains(
    v: Vehicle,
    position: tuple[float, float],
    velocity: tuple[float, float],
    integral: tuple[float, float],
) -> None:
    """Set the controller's gains, each (horizontal, vertical), clipped to stable values."""
    b, i = v.bodies, v.index
    for gain, (horizontal, vertical), most in (
        (b.position_gain, position, 5.0),
        (b.velocity_gain, velocity, 15.0),
        (b.integral_gain, integral, 10.0),
    ):
        gain[i] = np.clip((horizontal, horizontal, vertical), 0.0, most)
    b.refresh()


def hold(v: Vehicle) -> None:
    """Brake, then hold position."""
    velocity = v.bodies.velocity[v.index]
    speed = float(np.linalg.norm(velocity))
    go(v, v.estimated() + velocity * max(0.3, speed / (2 * _BRAKING)))


def go(v: Vehicle, place: Any) -> None:
    """Fly to a position of the centre (estimated, world ENU) within the limits, and hold it."""
    v.bodies.set_goal(v.index, (*place, *[0.0] * 6))


def descend(v: Vehicle, rate: float, *, steer: bool) -> None:
    """Descend at ``rate`` (m/s) above the goal; without ``steer`` level, drifting with the wind."""
    b, i = v.bodies, v.index
    goal = (*b.goal_position[i], 0.0, 0.0, -rate, 0.0, 0.0, 0.0)
    if steer:
        b.set_goal(i, goal, (1.0, 1.0, 0.0))
    else:
        b.set_goal(i, goal, (0.0, 0.0, 0.0), (0.0, 0.0, 1.0))


def idle(v: Vehicle) -> None:
    """Stand on the ground without lift."""
    go(v, v.estimated())
    v.bodies.may_lift[v.index] = False
