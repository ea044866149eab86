"""Taking off, standing and landing: thrust ramps, the land detector, and yaw."""

import numpy as np
from numpy.typing import NDArray

from sitl.physics.dynamics import Bodies
from swarm.jit import compiled

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

_YAW_RATE = 1.0
_SETTLED = 2.0
_SLOW = np.array([1.5, 1.5, 0.25])
_DESCENDING = -0.25
_CLIMBING = 0.25
_LOW_THRUST = 0.7 * 9.80665
_TUMBLE_RATE = 5.0


def supervise(b: Bodies, interval: float) -> None:
    """Take-off ramp, land detector and yaw, every ``interval`` seconds (call at 25 Hz)."""
    if b.settled and _nothing_to_do(
        b.advance, b.goal_yaw, b.yaw, b.marks, b.contact, b.velocity_goal, b.velocity
    ):
        return
    if b.advance.tobytes() != b.nothing:
        b.goal_position += (interval * b.advance)[:, None] * b.goal_velocity
    if b.goal_yaw.tobytes() != b.yaw.tobytes():
        _turn(b, interval)
    aloft = b.settled and b.marks.tobytes() == b.cruising
    if not aloft:
        b.tumble += interval * _TUMBLE_RATE * (b.tumbling & ~b.crashed)
        _lift(b, interval)
        up = (b.lifting > _SETTLED) & (b.share >= 1.0)
        b.settled = np.count_nonzero(up) == b.count
    down = b.velocity_goal[:, 2] < _DESCENDING
    if not aloft or np.count_nonzero(down) or b.contact.tobytes() != b.nothing:
        _detect_landing(b, down, interval)
        b.settled = b.settled and b.contact.tobytes() == b.nothing


@compiled
def _nothing_to_do(
    advance: Array, goal_yaw: Array, yaw: Array, marks: Flags, contact: Array, goal: Array,
    velocity: Array,
) -> bool:  # fmt: skip
    """Whether all fly, look where they should, and nobody comes down without getting lower."""
    for i in range(len(yaw)):
        flies = marks[0, i] and not (marks[1, i] or marks[2, i])
        still = advance[i] == 0.0 and contact[i] == 0.0 and yaw[i] == goal_yaw[i]
        slow = True
        for k in range(3):
            slow = slow and abs(velocity[i, k]) < _SLOW[k]
        if not (flies and still) or (slow and goal[i, 2] < _DESCENDING):
            return False
    return True


def _turn(b: Bodies, interval: float) -> None:
    turn = (b.goal_yaw - b.yaw + np.pi) % (2 * np.pi) - np.pi
    turn[abs(turn) < 1e-6] = 0.0
    b.yaw_rate = np.clip(2.0 * turn, -_YAW_RATE, _YAW_RATE) * ~b.landed
    b.yaw += interval * b.yaw_rate
    done = turn == 0.0
    b.yaw[done] = b.goal_yaw[done]


def _lift(b: Bodies, interval: float) -> None:
    """Share of full thrust that each vehicle may use: 0 standing, ramping up on take-off."""
    b.armed_for = np.where(b.armed, b.armed_for + interval, 0.0)
    ready = b.armed & b.may_lift & (b.armed_for > b.spool_time)
    climbing = (b.velocity_goal[:, 2] > _CLIMBING) | (b.goal_acceleration[:, 2] > 1.0)
    started = ready & b.landed & (climbing | (b.lifting > 0))
    started &= ~b.fooled
    b.lifting = np.where(started | ~b.landed, b.lifting + interval, 0.0)
    share = np.minimum(b.lifting / b.ramp_time, 1.0)
    share = np.where(b.contact > b.cut_time, np.minimum(share, 0.1), share)
    b.share = share * b.armed


def _detect_landing(b: Bodies, down: Flags, interval: float) -> None:
    """Both autopilots' idea of a landing: told to go ``down``, and not going anywhere.

    It is an inference, not a sensor. A vehicle that hangs on its neighbours' cable while told
    to descend fulfils it, and its thrust is cut (PX4 #11683, #15718).
    """
    candidate = down & b.armed & (b.lifting > 1.0)
    candidate &= ~b.landed
    if np.count_nonzero(candidate):
        candidate &= (np.abs(b.velocity) < _SLOW).all(axis=1)
        candidate &= b.thrust[:, 2] < _LOW_THRUST
    if np.count_nonzero(candidate):
        b.contact = np.where(candidate, b.contact + interval, 0.0)
    else:
        b.contact = np.zeros(b.count)
    landed = b.contact > b.land_time
    if np.count_nonzero(b.landed):
        left = b.position[:, 2] > b.floor + b.grip_offset + 0.05
        lifted = left & b.armed & ~b.fooled
        landed |= b.landed & ~lifted
    if landed.tobytes() != b.landed.tobytes():
        b.landed[:] = landed
        b.landings += 1
