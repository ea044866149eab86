"""Take-off ramp, land detector and yaw."""

import numpy as np
from numpy.typing import NDArray

from sitl.physics.dynamics import Bodies
from sitl.physics.geodesy import GRAVITY
from swarm.jit import compiled
from swarm.signatures import Bools2, Columns2, Floats1, Floats2

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

_YAW_RATE = 1.0
_RAMP_OVER = 2.0
"""Seconds of lift after which the take-off ramp is over."""
_SLOW = np.array([1.5, 1.5, 0.25])
_DESCENDING = -0.25
_CLIMBING = 0.25
_LOW_THRUST = 0.7 * GRAVITY
_TUMBLE_RATE = 5.0


def supervise(b: Bodies, interval: float) -> None:
    """Update take-off ramp, land detector and yaw by ``interval`` seconds (call at 25 Hz).

    Vehicles that are moved from outside keep their yaw and whether they stand.
    """
    if b.all_cruising and _unchanged(
        b.goal_moves, (b.goal_yaw, b.yaw), b.status, b.landing_time, b.velocity_goal, b.velocity
    ):
        return
    if b.goal_moves.tobytes() != b.zero_times:
        b.goal_position += (interval * b.goal_moves)[:, None] * b.goal_velocity
    if b.goal_yaw.tobytes() != b.yaw.tobytes():
        _turn(b, interval)
    cruising = b.all_cruising and b.status.tobytes() == b.cruise_status
    if not cruising:
        b.tumble += interval * _TUMBLE_RATE * (b.tumbling & ~b.crashed)
        _lift(b, interval)
        up = (b.lift_time > _RAMP_OVER) & (b.thrust_share >= 1.0)
        b.all_cruising = np.count_nonzero(up) == b.count
    down = b.velocity_goal[:, 2] < _DESCENDING
    if not cruising or np.count_nonzero(down) or b.landing_time.tobytes() != b.zero_times:
        _detect_landing(b, down, interval)
        b.all_cruising = b.all_cruising and b.landing_time.tobytes() == b.zero_times


@compiled
def _unchanged(
    goal_moves: Floats1, yaws: tuple[Floats1, Floats1], status: Bools2, landing_time: Floats1,
    goal: Floats2, velocity: Columns2,
) -> bool:  # fmt: skip
    """Return whether all vehicles fly, have their goal yaw, and meet no condition of a landing.

    ``yaws`` are the goals (n,), and the present ones.
    """
    goal_yaw, yaw = yaws
    for i in range(len(yaw)):
        flies = status[0, i] and not (status[1, i] or status[2, i])
        still = goal_moves[i] == 0.0 and landing_time[i] == 0.0 and yaw[i] == goal_yaw[i]
        slow = True
        for k in range(3):
            slow = slow and abs(velocity[i, k]) < _SLOW[k]
        if not (flies and still) or (slow and goal[i, 2] < _DESCENDING):
            return False
    return True


def _turn(b: Bodies, interval: float) -> None:
    turn = (b.goal_yaw - b.yaw + np.pi) % (2 * np.pi) - np.pi
    turn[(abs(turn) < 1e-6) | b.outside] = 0.0
    b.yaw_rate = np.clip(2.0 * turn, -_YAW_RATE, _YAW_RATE) * ~b.landed
    b.yaw += interval * b.yaw_rate
    done = (turn == 0.0) & ~b.outside
    b.yaw[done] = b.goal_yaw[done]


def _lift(b: Bodies, interval: float) -> None:
    """Update the usable share of full thrust: 0 on the ground, a ramp at take-off."""
    b.armed_time = np.where(b.armed, b.armed_time + interval, 0.0)
    ready = b.armed & b.may_lift & (b.armed_time > b.spool_time)
    climbing = (b.velocity_goal[:, 2] > _CLIMBING) | (b.goal_acceleration[:, 2] > 1.0)
    started = ready & b.landed & (climbing | (b.lift_time > 0))
    started &= ~b.false_landing
    b.lift_time = np.where(started | ~b.landed, b.lift_time + interval, 0.0)
    share = np.minimum(b.lift_time / b.ramp_time, 1.0)
    share = np.where(b.landing_time > b.cut_time, np.minimum(share, 0.1), share)
    b.thrust_share = share * b.armed


def _detect_landing(b: Bodies, down: Flags, interval: float) -> None:
    """Detect landings as both autopilots do: a descent setpoint (``down``) without motion.

    This is an inference, not a sensor. A vehicle that hangs on its neighbours' cable during a
    descent fulfils the condition, and its thrust is cut (PX4 #11683, #15718).
    """
    candidate = down & b.armed & (b.lift_time > 1.0)
    candidate &= ~b.landed
    if np.count_nonzero(candidate):
        candidate &= (np.abs(b.velocity) < _SLOW).all(axis=1)
        candidate &= b.thrust[:, 2] < _LOW_THRUST
    if np.count_nonzero(candidate):
        b.landing_time = np.where(candidate, b.landing_time + interval, 0.0)
    else:
        b.landing_time = np.zeros(b.count)
    landed = b.landing_time > b.land_time
    if np.count_nonzero(b.landed):
        left = b.position[:, 2] > b.floor + b.grip_offset + 0.05
        lifted = left & b.armed & ~b.false_landing
        landed |= b.landed & ~lifted
    landed = np.where(b.outside, b.landed, landed)
    if landed.tobytes() != b.landed.tobytes():
        b.landed[:] = landed
        b.landed_changes += 1
