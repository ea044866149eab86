"""What an autopilot asks of its controller in the modes that fly by themselves.

Each function writes one vehicle's goals into the batch (`sitl.dynamics.Bodies`).
"""

from typing import Any

import numpy as np

from sitl.vehicle import Vehicle

_BRAKING = 3.0


def _clear(v: Vehicle) -> None:
    b, i = v.bodies, v.index
    b.goal_velocity[i] = 0.0
    b.goal_acceleration[i] = 0.0
    b.position_axes[i] = 1.0
    b.velocity_axes[i] = 1.0


def limits(v: Vehicle, speed: float, climb: float, descend: float) -> None:
    """Set the speed limits of the position controller (m/s)."""
    b, i = v.bodies, v.index
    b.speed_limit[i] = min(speed, v.spec.max_speed)
    b.climb_limit[i] = climb
    b.descend_limit[i] = descend


def hold(v: Vehicle) -> None:
    """Brake and stay where that ends."""
    _clear(v)
    b, i = v.bodies, v.index
    velocity = b.velocity[i]
    speed = float(np.linalg.norm(velocity))
    b.goal_position[i] = v.estimated() + velocity * max(0.3, speed / (2 * _BRAKING))


def go(v: Vehicle, place: Any) -> None:
    """Fly to a place (estimated world ENU of the centre) within the limits, and stay."""
    _clear(v)
    v.bodies.goal_position[v.index] = place


def sink(v: Vehicle, rate: float, *, steer: bool) -> None:
    """Go down at ``rate`` (m/s): over the present place, or level and drifting (``steer`` off)."""
    b, i = v.bodies, v.index
    if b.position_axes[i, 2] or not steer:
        hold(v)
    b.position_axes[i, 2] = 0.0
    b.goal_velocity[i] = (0.0, 0.0, -rate)
    if not steer:
        b.position_axes[i] = 0.0
        b.velocity_axes[i] = (0.0, 0.0, 1.0)


def idle(v: Vehicle) -> None:
    """Ask for nothing: stand."""
    _clear(v)
    b, i = v.bodies, v.index
    b.goal_position[i] = v.estimated()
    b.may_lift[i] = False
