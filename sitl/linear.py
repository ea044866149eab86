"""One step of flight as one linear map: what `sitl.dynamics` computes where no limit is in reach.

Per vehicle and axis the next position, velocity, thrust, thrust rate and integral are linear in the
present ones and in what is wanted (place, speed, acceleration), in the estimator's offset, and in
the accelerations from air and cable; gravity is an input too.
A batch of nine then costs one small product instead of some forty array operations.
"""

import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

POSITION, VELOCITY, THRUST, THRUST_RATE, INTEGRAL = range(5)
PLACE, SPEED, ACCELERATION, OFFSET, AIR, PUSH, WEIGHT = range(5, 12)
STATES, INPUTS = 5, 12
WITHIN = 1.0 / math.sqrt(2.0)


def linear_map(
    *,
    gain: Array,
    rate_gain: Array,
    integral_gain: Array,
    drag: Array,
    step: float,
    frequency: float,
    damping: float,
    speed: float,
    reach: float,
) -> Array:
    """Return the map (n, 3, 7, 12) from state and inputs to the next state and two limit checks.

    Gains (n, 3) are those of `Bodies`, ``drag`` (n, 1) in 1/s. The sixth row is the velocity asked
    for over ``speed``, the seventh the acceleration asked for over ``reach``, both so that absolute
    values up to one are within every limit, along the diagonal too.
    """
    count = len(gain)
    one = np.zeros((INPUTS, INPUTS, count, 3))
    one[range(INPUTS), range(INPUTS)] = 1.0
    goal = gain * (one[PLACE] - one[OFFSET] - one[POSITION]) + one[SPEED]
    miss = goal - one[VELOCITY]
    wanted = rate_gain * miss + one[INTEGRAL] + one[ACCELERATION]
    command = wanted + one[WEIGHT] - one[THRUST]
    rate = (1.0 - 2.0 * step * damping * frequency) * one[THRUST_RATE]
    rate = rate + step * frequency**2 * command
    thrust = one[THRUST] + step * rate
    velocity = one[VELOCITY] + step * (one[AIR] + one[PUSH] - drag * one[VELOCITY] + thrust)
    position = one[POSITION] + step * velocity
    integral = one[INTEGRAL] + integral_gain * miss
    checks = (goal / (WITHIN * speed), wanted / (WITHIN * reach))
    rows = np.stack([position, velocity, thrust, rate, integral, *checks])
    return np.ascontiguousarray(rows.transpose(2, 3, 0, 1))


def twice(found: Array) -> Array:
    """Return the map (n, 3, 14, 12) to what follows after one step, and after two of them.

    Nothing but the state changes in between.
    """
    second = np.matmul(found[..., :STATES], found[..., :STATES, :])
    second[..., STATES:] += found[..., STATES:]
    return np.concatenate([found, second], axis=-2)


def apply(found: Array, now: Array) -> Array:
    """Apply a map from `twice` to what is now ((n, 3, 12, 1)): (n, 3, 2, 7)."""
    result: Array = np.matmul(found, now).reshape(*now.shape[:2], 2, -1)
    return result
