"""Compiled steps of all vehicles: controller, thrust, drag, the floor; gusts and downwash.

`sitl.physics.dynamics` and `sitl.physics.wind` explain the model. The loops run over vehicles and
axes: for nine vehicles, some forty small array operations would take ten times as long.
"""

import math

import numpy as np
from numpy.typing import NDArray

from sitl.physics.geodesy import GRAVITY
from swarm.jit import compiled

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

POSITION, VELOCITY, THRUST, THRUST_RATE, INTEGRAL = range(5)
PLACE, SPEED, ACCELERATION, OFFSET, AIR, PUSH = range(5, 11)
LANES = 11
"""What there is of each vehicle and axis: its state, what is wanted, and what acts on it."""

GAIN, RATE_GAIN, INTEGRAL_GAIN = 0, 3, 6
DRAG, FASTEST, CLIMB, DESCEND, REACH, TILT, THRUST_LIMIT, HEALTH, STAND = range(9, 18)
TUNINGS = 18
"""What a vehicle's motion is tuned with: gains of three axes each, drag (1/s), limits in SI units
(tilt as its tangent), health of the motors, height of the centre when it stands."""

_FREQUENCY, _DAMPING = 14.0, 0.9
_IDLE = 0.08 * GRAVITY
_UPRIGHT = 0.5
_CRASH_SPEED = 3.0
_WASHED, _LOWEST, _HIGHEST = 4.0, 0.1, 10.0
AIR_DENSITY = 1.2


@compiled
def advance(
    now: Array, tuned: Array, share: Array, crashed: Flags, step: float, goal: Array, hard: Flags
) -> bool:
    """Advance states ``now`` (n, 3, LANES) by ``step`` seconds, in place.

    ``tuned`` (n, TUNINGS), ``share`` (n,) of full thrust that may be used. Velocities that the
    position controllers ask for go to ``goal`` (n, 3), who has just come down hard to ``hard``
    (n,); returns whether anybody has.
    """
    anybody = False
    for i in range(len(now)):
        body, own = now[i], tuned[i]
        level = 0.0
        for k in range(3):
            off = body[k, PLACE] - body[k, POSITION] - body[k, OFFSET]
            goal[i, k] = own[GAIN + k] * off + body[k, SPEED]
        level = math.hypot(goal[i, 0], goal[i, 1])
        if level > own[FASTEST]:
            goal[i, 0] *= own[FASTEST] / level
            goal[i, 1] *= own[FASTEST] / level
        goal[i, 2] = min(max(goal[i, 2], -own[DESCEND]), own[CLIMB])

        east, north, up = 0.0, 0.0, 0.0
        miss_east = goal[i, 0] - body[0, VELOCITY]
        miss_north = goal[i, 1] - body[1, VELOCITY]
        miss_up = goal[i, 2] - body[2, VELOCITY]
        east = own[RATE_GAIN] * miss_east + body[0, ACCELERATION] + body[0, INTEGRAL]
        north = own[RATE_GAIN + 1] * miss_north + body[1, ACCELERATION] + body[1, INTEGRAL]
        up = own[RATE_GAIN + 2] * miss_up + body[2, ACCELERATION] + body[2, INTEGRAL] + GRAVITY
        reach = math.hypot(east, north)
        if reach > own[REACH]:
            east *= own[REACH] / reach
            north *= own[REACH] / reach
            miss_east = miss_north = 0.0
        ceiling = share[i] * own[THRUST_LIMIT]
        up = min(max(up, min(_IDLE, ceiling)), ceiling)
        reach, limit = math.hypot(east, north), own[TILT] * up + 1e-9
        if reach > limit:
            east *= limit / reach
            north *= limit / reach
        if share[i] < 1.0:
            body[0, INTEGRAL] = body[1, INTEGRAL] = body[2, INTEGRAL] = 0.0
        body[0, INTEGRAL] += own[INTEGRAL_GAIN] * miss_east
        body[1, INTEGRAL] += own[INTEGRAL_GAIN + 1] * miss_north
        body[2, INTEGRAL] += own[INTEGRAL_GAIN + 2] * miss_up

        for k in range(3):
            wanted = own[HEALTH] * (east if k == 0 else north if k == 1 else up)
            s = body[k]
            s[THRUST_RATE] *= 1.0 - 2.0 * step * _DAMPING * _FREQUENCY
            s[THRUST_RATE] += step * _FREQUENCY**2 * (wanted - s[THRUST])
            s[THRUST] += step * s[THRUST_RATE]
            s[VELOCITY] += step * (s[AIR] - own[DRAG] * s[VELOCITY] + s[THRUST] + s[PUSH])
            s[POSITION] += step * s[VELOCITY]

        hard[i] = False
        if body[2, POSITION] <= own[STAND]:
            hard[i] = body[2, VELOCITY] < -_CRASH_SPEED and not crashed[i]
            anybody = anybody or hard[i]
            _stand(body, own[STAND])
    return anybody


@compiled
def _stand(body: Array, height: float) -> None:
    """Keep one vehicle's legs above the floor, with friction."""
    body[2, POSITION] = height
    body[2, VELOCITY] = max(body[2, VELOCITY], 0.0)
    still = body[2, THRUST] < GRAVITY
    body[0, VELOCITY] *= 0.0 if still else 0.5
    body[1, VELOCITY] *= 0.0 if still else 0.5


@compiled
def grips(now: Array, offset: Array, points: Array) -> None:
    """Where the grip points are, into ``points`` (n, 3): a stiff dropper along the body's own down
    axis."""
    for i in range(len(now)):
        body = now[i]
        length = math.sqrt(body[0, THRUST] ** 2 + body[1, THRUST] ** 2 + body[2, THRUST] ** 2)
        for k in range(3):
            points[i, k] = body[k, POSITION]
            if length >= 1.0:
                points[i, k] -= body[k, THRUST] * (offset[i] / length)
        if length < 1.0:
            points[i, 2] -= offset[i]


@compiled
def breathe(
    now: Array, fresh: Array, keeps: tuple[float, float], interval: float,
    most: tuple[float, float, float], noise: Array, sigma: Array, bias: Array, drift: Array,
    gust: Array, steady: Array, wind: Array, wash: Array, drag: Array, mass: Array, radius: Array,
    apart: Array,
) -> None:  # fmt: skip
    """Advance all that changes slowly by ``interval`` seconds, in place.

    Estimators' ``noise`` (n, 3) of deviation ``sigma``, and their ``bias``, which has a ``drift``
    in m/s; ``gust`` (n + 1, 3) on the ``steady`` wind; downwash; and what these do to ``now``.
    ``fresh`` (2 n + 1, 3) are normal numbers for noise and gusts, ``keeps`` the shares that these
    keep of themselves. ``most``: the largest integral, the gusts' intensity and the factor of
    downwash on vehicles.
    """
    count, (keep, gust_keep), (integral, intensity, factor) = len(now), keeps, most
    for i in range(count):
        for k in range(3):
            drawn = fresh[i, k] * (math.sqrt(1.0 - keep**2) * sigma[i, k])
            noise[i, k] = keep * noise[i, k] + drawn
            bias[i, k] += interval * drift[i, k]
            now[i, k, INTEGRAL] = min(max(now[i, k, INTEGRAL], -integral), integral)
    if intensity > 0.0:
        _gusts(gust, fresh[count:], gust_keep, intensity)
        _winds(steady, gust, wind)
    felt = _downwash(now, mass, radius, apart)
    for i in range(count):
        wash[i, 2] = -factor * felt[i]
    renew_air(now, bias, noise, drag, wind, wash)


@compiled
def renew_air(now: Array, bias: Array, noise: Array, drag: Array, wind: Array, wash: Array) -> None:
    """Put offsets of estimators, and what air and gravity do at rest, into ``now``."""
    for i in range(len(now)):
        for k in range(3):
            now[i, k, OFFSET] = bias[i, k] + noise[i, k]
            now[i, k, AIR] = drag[i] * (wind[i, k] + wash[i, k])
        now[i, 2, AIR] -= GRAVITY


@compiled
def _gusts(gust: Array, fresh: Array, keep: float, intensity: float) -> None:
    """Advance gusts (m, 3), in place; see `sitl.physics.wind.gust_keeps`."""
    for i in range(len(gust)):
        for k in range(3):
            share = 1.0 if k < 2 else _UPRIGHT
            drawn = math.sqrt(1.0 - keep * keep) * intensity * share * fresh[i, k]
            gust[i, k] = keep * gust[i, k] + drawn


@compiled
def _winds(steady: Array, gust: Array, wind: Array) -> None:
    """Put the wind at every vehicle into ``wind`` (n, 3): the first gust is common to all."""
    for i in range(len(wind)):
        for k in range(3):
            wind[i, k] = steady[i, k] + 0.8 * gust[0, k] + 0.6 * gust[i + 1, k]


@compiled
def _downwash(now: Array, mass: Array, radius: Array, apart: Array) -> Array:
    """Downward air speed (n,) at every vehicle from those above it, as `sitl.physics.wind.jets`.

    Level distances squared go to ``apart`` (n, n).
    """
    count = len(now)
    felt = np.zeros(count)
    near = False
    for i in range(count):
        for j in range(count):
            east = now[i, 0, POSITION] - now[j, 0, POSITION]
            north = now[i, 1, POSITION] - now[j, 1, POSITION]
            apart[i, j] = east * east + north * north
            near = near or (i != j and apart[i, j] < _WASHED)
    if not near:
        return felt
    for j in range(count):
        lift = max(now[j, 2, THRUST], 0.0) * mass[j]
        jet = 2.0 * math.sqrt(lift / (2.0 * AIR_DENSITY * math.pi)) / radius[j]
        for i in range(count):
            below = now[j, 2, POSITION] - now[i, 2, POSITION]
            if _LOWEST < below < _HIGHEST:
                core = 0.7 * radius[j]
                width = core + 0.1 * below
                speed = jet * (core / width) * math.exp(-apart[i, j] / (2.0 * width**2))
                felt[i] = max(felt[i], speed)
    return felt


@compiled
def said(
    now: Array, tumbling: Flags, tumble: Array, yaw: Array, yaw_rate: Array, frames: Array,
    rows: NDArray[np.float32],
) -> None:  # fmt: skip
    """What LOCAL_POSITION_NED and ATTITUDE say after the time, as it lies on the wire, into
    ``rows`` (n, 12), whose rates of roll and pitch stay as they are.

    ``yaw`` and ``yaw_rate`` (n,) are counter-clockwise from east; ``frames`` (n, 5) are where
    estimators' frames start, and what they make of a metre east and north. Attitudes are those that
    point the thrust where it points.
    """
    for i in range(len(now)):
        body, row = now[i], rows[i]
        east = body[0, POSITION] + body[0, OFFSET] - frames[i, 0]
        north = body[1, POSITION] + body[1, OFFSET] - frames[i, 1]
        row[0], row[1] = north * frames[i, 4], east * frames[i, 3]
        row[2] = frames[i, 2] - (body[2, POSITION] + body[2, OFFSET])
        row[3], row[4], row[5] = body[1, VELOCITY], body[0, VELOCITY], -body[2, VELOCITY]
        roll, pitch, turned = _attitude(body, tumbling[i], tumble[i], 0.5 * math.pi - yaw[i])
        row[6], row[7], row[8], row[11] = roll, pitch, turned, -yaw_rate[i]


@compiled
def _attitude(body: Array, tumbles: bool, tumble: float, yaw: float) -> tuple[float, float, float]:
    """Roll, pitch and yaw (NED, radians) of one vehicle."""
    if tumbles:
        return _wrap(tumble), _wrap(0.3 * tumble), _wrap(yaw + tumble)
    upward = body[2, THRUST]
    if upward < 1.0:
        return 0.0, 0.0, _wrap(yaw)
    cos, sin = math.cos(yaw), math.sin(yaw)
    forward = body[1, THRUST] * cos + body[0, THRUST] * sin
    right = -body[1, THRUST] * sin + body[0, THRUST] * cos
    pitch = -math.atan2(forward, upward)
    return math.atan2(right * math.cos(pitch), upward), pitch, _wrap(yaw)


@compiled
def tilts(now: Array, tumbling: Flags, tumble: Array) -> Array:
    """By how much everybody's thrust leans (n,), radians from upright."""
    leans = np.zeros(len(now))
    for i in range(len(now)):
        body = now[i]
        level = math.hypot(body[0, THRUST], body[1, THRUST])
        if tumbling[i]:
            leans[i] = abs(_wrap(tumble[i]))
        elif math.hypot(level, body[2, THRUST]) > 1.0:
            leans[i] = math.atan2(level, body[2, THRUST])
    return leans


@compiled
def _wrap(angle: float) -> float:
    return (angle + math.pi) % (2.0 * math.pi) - math.pi
