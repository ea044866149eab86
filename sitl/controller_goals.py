"""What an autopilot asks of its controller in the modes that fly by themselves.

Each function writes one vehicle's goals into the batch (`sitl.dynamics.Bodies`).
"""

from typing import Any

import numpy as np

from sitl.vehicle import Vehicle

_BRAKING = 3.0


def limits(v: Vehicle, speed: float, climb: float, descend: float) -> None:
    """Set the speed limits of the position controller (m/s)."""
    b, i = v.bodies, v.index
    b.speed_limit[i] = min(speed, v.spec.max_speed)
    b.climb_limit[i] = climb
    b.descend_limit[i] = descend
    b.touch()


def gains(
    v: Vehicle,
    position: tuple[float, float],
    velocity: tuple[float, float],
    integral: tuple[float, float],
) -> None:
    """Set the controller's gains, each (horizontal, vertical), as far as its step can take them."""
    b, i = v.bodies, v.index
    for gain, (level, upright), most in (
        (b.position_gain, position, 5.0),
        (b.velocity_gain, velocity, 15.0),
        (b.integral_gain, integral, 10.0),
    ):
        gain[i] = np.clip((level, level, upright), 0.0, most)
    b.touch()


def hold(v: Vehicle) -> None:
    """Brake and stay where that ends."""
    velocity = v.bodies.velocity[v.index]
    speed = float(np.linalg.norm(velocity))
    go(v, v.estimated() + velocity * max(0.3, speed / (2 * _BRAKING)))


def go(v: Vehicle, place: Any) -> None:
    """Fly to a place (estimated world ENU of the centre) within the limits, and stay."""
    v.bodies.aim(v.index, (*place, *[0.0] * 6))


def sink(v: Vehicle, rate: float, *, steer: bool) -> None:
    """Go down at ``rate`` (m/s): over the goal's place, or level and drifting (``steer`` off)."""
    b, i = v.bodies, v.index
    goal = (*b.goal_position[i], 0.0, 0.0, -rate, 0.0, 0.0, 0.0)
    if steer:
        b.aim(i, goal, (1.0, 1.0, 0.0))
    else:
        b.aim(i, goal, (0.0, 0.0, 0.0), (0.0, 0.0, 1.0))


def idle(v: Vehicle) -> None:
    """Ask for nothing: stand."""
    go(v, v.estimated())
    v.bodies.may_lift[v.index] = False
