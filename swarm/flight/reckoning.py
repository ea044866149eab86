"""What is reckoned for the whole team at every tick, compiled: loops over a handful of vehicles.

As array operations the same would cost ten times as much. Everything is of grip points, mission
ENU, SI.
"""

import math

import numpy as np
import numpy.typing as npt

from swarm.compiled import compiled

Floats = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]


@compiled
def measured(
    reported: Floats, velocity: Floats, age: Floats, lift: Floats, setpoint: Floats,
    setpoint_velocity: Floats, streaming: Flags, limits: tuple[float, float, float],
) -> tuple[Floats, Floats]:  # fmt: skip
    """Where the grip points (n, 3) are now, and how far (n,) from where setpoints have led.

    Centres were ``reported`` ``age`` (n,) seconds ago, ``lift`` (3,) above the grips. Setpoints are
    the last tick's; nothing is known (NaN) of those who do not get any, or are silent. ``limits``
    in seconds: for how long reports are carried on with their velocity, from when on a vehicle is
    silent, and how long ago the last tick was.
    """
    freshest, silence, elapsed = limits
    position, error = np.empty(reported.shape), np.full(len(reported), np.nan)
    for i in range(len(reported)):
        carried, square = min(age[i], freshest), 0.0
        for k in range(3):
            position[i, k] = reported[i, k] - lift[k] + velocity[i, k] * carried
            led = setpoint[i, k] + setpoint_velocity[i, k] * elapsed
            square += (position[i, k] - led) ** 2
        if streaming[i] and age[i] <= silence:
            error[i] = math.sqrt(square)
    return position, error


@compiled
def sampled(coefficients: Floats, u: float, rate: float, slope: float) -> Floats:
    """Position, velocity and acceleration (3, m) of a piece of quintics (6, m), at ``u`` in it.

    ``rate`` is how fast time passes there, and ``slope`` how fast the rate grows, in 1/s.
    """
    orders, count = coefficients.shape
    states = np.empty((3, count))
    for j in range(count):
        place = speed = growth = 0.0
        for k in range(orders - 1, -1, -1):
            growth = growth * u + speed
            speed = speed * u + place
            place = place * u + coefficients[k, j]
        states[0, j] = place
        states[1, j] = rate * speed
        states[2, j] = rate * rate * 2.0 * growth + slope * speed
    return states


@compiled
def aimed(
    position: Floats, velocity: Floats, acceleration: Floats, lead: float, lift: Floats,
    relief: Floats,
) -> Floats:  # fmt: skip
    """Setpoints (n, 3, 3) of centres: positions ``lead`` seconds ahead, velocities, accelerations.

    ``lift`` (3,) from grip point to centre; ``relief`` (n, 3) is subtracted from accelerations.
    """
    states = np.empty((len(position), 3, 3))
    for i in range(len(position)):
        for k in range(3):
            ahead = velocity[i, k] + 0.5 * lead * acceleration[i, k]
            states[i, 0, k] = position[i, k] + lead * ahead + lift[k]
            states[i, 1, k] = velocity[i, k]
            states[i, 2, k] = acceleration[i, k] - relief[i, k]
    return states


@compiled
def moves_as_told(
    step: Floats, told: Floats, streaming: Flags, before: Floats, velocity: Floats,
    last: Floats, reported: Floats, limits: tuple[float, float, float, float],
) -> bool:  # fmt: skip
    """Whether nobody sinks faster than told, jumps, or has not been heard for too long.

    ``step`` (n,) are the seconds between the last report (place and velocity (n, 3) then) and this;
    ``told`` (n, 3) the velocities of setpoints. ``limits``: the longest step in seconds, how fast
    those may sink that are not streamed to, by how much anybody may beyond what was told, in m/s,
    and the largest jump along an axis in metres.
    """
    longest, sinking, too_much, jump = limits
    for i in range(len(step)):
        if not step[i] <= longest:
            return False
        down = min(told[i, 2], 0.0) if streaming[i] else -sinking
        if down - velocity[i, 2] > too_much:
            return False
        for k in range(3):
            middle = 0.5 * step[i] * (before[i, k] + velocity[i, k])
            if not abs(reported[i, k] - last[i, k] - middle) <= jump:
                return False
    return True
