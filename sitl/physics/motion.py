"""Compiled steps of all vehicles: controller, thrust, drag, the floor; gusts and downwash.

`sitl.physics.dynamics` explains the model. The loops run over vehicles and
axes: for nine vehicles, some forty small array operations would take ten times as long.
"""

import math

import numpy as np
from numpy.typing import NDArray

from sitl.physics.geodesy import GRAVITY
from swarm.jit import allocates, compiled, inner
from swarm.signatures import Bools1, Bools2, Columns2, Floats1, Floats2, Floats3, Singles2

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

POSITION, VELOCITY, THRUST, THRUST_RATE, INTEGRAL = range(5)
GOAL_POSITION, GOAL_VELOCITY, GOAL_ACCELERATION, ESTIMATE_ERROR, AIR, EXTERNAL = range(5, 11)
STATE_COLUMNS = 11
"""Columns of ``state`` (n, 3, STATE_COLUMNS): state, goal and accelerations per vehicle and axis.

AIR is the acceleration of gravity and drag on a vehicle at rest, EXTERNAL that of the cable.
"""

NOISE, NOISE_SIGMA, BIAS, DRIFT, STEADY_WIND, WIND, DOWNWASH = range(7)
DISTURBANCE_COLUMNS = 7
"""Columns of ``disturbances`` (n, 3, DISTURBANCE_COLUMNS): estimator errors and moving air."""

POSITION_GAIN, VELOCITY_GAIN, INTEGRAL_GAIN = 0, 3, 6
DRAG, SPEED_LIMIT, CLIMB_LIMIT, DESCENT_LIMIT, ACCELERATION_LIMIT = range(9, 14)
TILT_LIMIT, THRUST_LIMIT, HEALTH, STANDING_HEIGHT, MASS, RADIUS, HEADING_ERROR = range(14, 21)
CONSTANTS = 21
"""Columns of ``constants`` (n, CONSTANTS): gains of three axes each, drag (1/s), limits in SI units
(tilt as its tangent), health of the motors, height of the centre on the ground, mass, radius, error
of the known heading (radians clockwise). A thrust is that in the frame of the known heading."""

_FREQUENCY, _DAMPING = 14.0, 0.9
_IDLE = 0.08 * GRAVITY
_VERTICAL_GUSTS = 0.5
_CRASH_SPEED = 3.0
_WASH_DISTANCE_SQUARED, _WASH_START, _WASH_END = 4.0, 0.1, 10.0
AIR_DENSITY = 1.2
SLOW, DESCENDING = np.array([1.5, 1.5, 0.25]), -0.25
"""Speeds below which a vehicle may have landed; the goal of a descent, m/s."""


@compiled
def step(
    state: Floats3, constants: Floats2, share: Floats1, crashed: Bools1, interval: float,
    reached: tuple[Floats2, Bools1],
) -> bool:  # fmt: skip
    """Advance ``state`` (n, 3, STATE_COLUMNS) by ``interval`` seconds, in place.

    ``share`` (n,) is the usable share of full thrust. The velocity setpoints (n, 3) of the position
    controllers, and hard landings (n,), go to ``reached``; returns whether one occurred.
    """
    goal, hard = reached
    any_hard = False
    for i in range(len(state)):
        body, own = state[i], constants[i]
        for k in range(3):
            error = body[k, GOAL_POSITION] - body[k, POSITION] - body[k, ESTIMATE_ERROR]
            goal[i, k] = own[POSITION_GAIN + k] * error + body[k, GOAL_VELOCITY]
        level = math.hypot(goal[i, 0], goal[i, 1])
        if level > own[SPEED_LIMIT]:
            goal[i, 0] *= own[SPEED_LIMIT] / level
            goal[i, 1] *= own[SPEED_LIMIT] / level
        goal[i, 2] = min(max(goal[i, 2], -own[DESCENT_LIMIT]), own[CLIMB_LIMIT])

        error_east = goal[i, 0] - body[0, VELOCITY]
        error_north = goal[i, 1] - body[1, VELOCITY]
        error_up = goal[i, 2] - body[2, VELOCITY]
        east = own[VELOCITY_GAIN] * error_east + body[0, GOAL_ACCELERATION] + body[0, INTEGRAL]
        north = (
            own[VELOCITY_GAIN + 1] * error_north + body[1, GOAL_ACCELERATION] + body[1, INTEGRAL]
        )
        up = (
            own[VELOCITY_GAIN + 2] * error_up
            + body[2, GOAL_ACCELERATION]
            + body[2, INTEGRAL]
            + GRAVITY
        )
        reach = math.hypot(east, north)
        if reach > own[ACCELERATION_LIMIT]:
            east *= own[ACCELERATION_LIMIT] / reach
            north *= own[ACCELERATION_LIMIT] / reach
            error_east = error_north = 0.0
        ceiling = share[i] * own[THRUST_LIMIT]
        up = min(max(up, min(_IDLE, ceiling)), ceiling)
        reach, limit = math.hypot(east, north), own[TILT_LIMIT] * up + 1e-9
        if reach > limit:
            east *= limit / reach
            north *= limit / reach
        if share[i] < 1.0:
            body[0, INTEGRAL] = body[1, INTEGRAL] = body[2, INTEGRAL] = 0.0
        body[0, INTEGRAL] += own[INTEGRAL_GAIN] * error_east
        body[1, INTEGRAL] += own[INTEGRAL_GAIN + 1] * error_north
        body[2, INTEGRAL] += own[INTEGRAL_GAIN + 2] * error_up

        for k in range(3):
            thrust = own[HEALTH] * (east if k == 0 else north if k == 1 else up)
            s = body[k]
            s[THRUST_RATE] *= 1.0 - 2.0 * interval * _DAMPING * _FREQUENCY
            s[THRUST_RATE] += interval * _FREQUENCY**2 * (thrust - s[THRUST])
            s[THRUST] += interval * s[THRUST_RATE]
            s[VELOCITY] += interval * (s[AIR] - own[DRAG] * s[VELOCITY] + s[THRUST] + s[EXTERNAL])
            s[POSITION] += interval * s[VELOCITY]
        if own[HEADING_ERROR] != 0.0:
            for k in range(2):
                change = interval * _turned(body, own[HEADING_ERROR], k)
                body[k, VELOCITY] += change
                body[k, POSITION] += interval * change

        hard[i] = False
        if body[2, POSITION] <= own[STANDING_HEIGHT]:
            hard[i] = body[2, VELOCITY] < -_CRASH_SPEED and not crashed[i]
            any_hard = any_hard or hard[i]
            _stand(body, own[STANDING_HEIGHT])
    return any_hard


@inner
def _turned(body: Array, error: float, k: int) -> float:
    """Return what an error of the known heading adds to a thrust, along east (0) or north (1).

    A vehicle that takes its heading for one farther to the right pushes farther to the left.
    """
    east, north = body[0, THRUST], body[1, THRUST]
    cos, sin = math.cos(error), math.sin(error)
    return float(east * (cos - 1.0) - north * sin if k == 0 else east * sin + north * (cos - 1.0))


@inner
def _stand(body: Array, height: float) -> None:
    """Keep the legs of one vehicle on the floor, with friction."""
    body[2, POSITION] = height
    body[2, VELOCITY] = max(body[2, VELOCITY], 0.0)
    still = body[2, THRUST] < GRAVITY
    body[0, VELOCITY] *= 0.0 if still else 0.5
    body[1, VELOCITY] *= 0.0 if still else 0.5


@compiled
def grip_points(state: Floats3, offset: Floats1, points: Floats2) -> None:
    """Write the grip points into ``points`` (n, 3).

    A grip point hangs ``offset`` (n,) metres below the centre on a stiff dropper along the body's
    vertical axis.
    """
    for i in range(len(state)):
        body = state[i]
        length = math.sqrt(body[0, THRUST] ** 2 + body[1, THRUST] ** 2 + body[2, THRUST] ** 2)
        for k in range(3):
            points[i, k] = body[k, POSITION]
            if length >= 1.0:
                points[i, k] -= body[k, THRUST] * (offset[i] / length)
        if length < 1.0:
            points[i, 2] -= offset[i]


@compiled
def free_motion(
    state: Floats3, constants: Floats2, acceleration: Floats2, mobility: Floats1
) -> None:
    """Write the accelerations (n, 3) that the vehicles would have without cable, m/s².

    ``mobility`` (n,) becomes 1 / mass, and 0 for vehicles that stand on the floor.
    """
    for i in range(len(state)):
        body, own = state[i], constants[i]
        stands = body[2, POSITION] <= own[STANDING_HEIGHT]
        mobility[i] = 0.0 if stands else 1.0 / own[MASS]
        for k in range(3):
            s = body[k]
            acceleration[i, k] = s[AIR] - own[DRAG] * s[VELOCITY] + s[THRUST]
            if k < 2 and own[HEADING_ERROR] != 0.0:
                acceleration[i, k] += _turned(body, own[HEADING_ERROR], k)


@compiled
@allocates
def step_disturbances(
    state: Floats3, disturbances: Floats3, constants: Floats2, air: tuple[Floats2, Floats2],
    apart: Floats2, factors: tuple[float, float, float, float, float, float],
) -> None:  # fmt: skip
    """Advance estimator errors, gusts and downwash, and their effects on ``state``, in place.

    ``air`` are gusts (n + 1, 3), which add to the steady wind, and normal numbers (2 n + 1, 3) for
    noise and gusts; horizontal distances squared go to ``apart`` (n, n). ``factors`` are the
    interval in seconds, the shares of noise and gusts that persist, the largest integral, the
    intensity of gusts and the factor of downwash on vehicles.
    """
    interval, keep, gust_keep, integral, intensity, wash_factor = factors
    gust, random = air
    count = len(state)
    for i in range(count):
        slow = disturbances[i]
        for k in range(3):
            drawn = random[i, k] * (math.sqrt(1.0 - keep**2) * slow[k, NOISE_SIGMA])
            slow[k, NOISE] = keep * slow[k, NOISE] + drawn
            slow[k, BIAS] += interval * slow[k, DRIFT]
            state[i, k, INTEGRAL] = min(max(state[i, k, INTEGRAL], -integral), integral)
    if intensity > 0.0:
        _step_gusts(gust, random[count:], gust_keep, intensity)
        _add_gusts(gust, disturbances)
    wash = _downwash(state, constants, apart)
    for i in range(count):
        disturbances[i, 2, DOWNWASH] = -wash_factor * wash[i]
    update_air(state, disturbances, constants)


@compiled
def update_air(state: Floats3, disturbances: Floats3, constants: Floats2) -> None:
    """Write estimator errors, and the acceleration of air and gravity at rest, into ``state``."""
    for i in range(len(state)):
        slow = disturbances[i]
        for k in range(3):
            state[i, k, ESTIMATE_ERROR] = slow[k, BIAS] + slow[k, NOISE]
            state[i, k, AIR] = constants[i, DRAG] * (slow[k, WIND] + slow[k, DOWNWASH])
        state[i, 2, AIR] -= GRAVITY


@inner
def _step_gusts(gust: Array, random: Array, keep: float, intensity: float) -> None:
    """Advance gusts (m, 3), in place; see `sitl.physics.dynamics`."""
    for i in range(len(gust)):
        for k in range(3):
            share = 1.0 if k < 2 else _VERTICAL_GUSTS
            drawn = math.sqrt(1.0 - keep * keep) * intensity * share * random[i, k]
            gust[i, k] = keep * gust[i, k] + drawn


@inner
def _add_gusts(gust: Array, disturbances: Array) -> None:
    """Write the wind at every vehicle into ``disturbances``: the first gust is common to all."""
    for i in range(len(disturbances)):
        for k in range(3):
            steady = disturbances[i, k, STEADY_WIND]
            disturbances[i, k, WIND] = steady + 0.8 * gust[0, k] + 0.6 * gust[i + 1, k]


@inner
@allocates
def _downwash(state: Array, constants: Array, apart: Array) -> Array:
    """Return the downward air speed (n,) at every vehicle from those above it.

    The formula is `sitl.physics.dynamics.downwash_at`; ``apart`` (n, n) gets horizontal distances
    squared.
    """
    count = len(state)
    wash = np.zeros(count)
    near = False
    for i in range(count):
        for j in range(count):
            east = state[i, 0, POSITION] - state[j, 0, POSITION]
            north = state[i, 1, POSITION] - state[j, 1, POSITION]
            apart[i, j] = east * east + north * north
            near = near or (i != j and apart[i, j] < _WASH_DISTANCE_SQUARED)
    if not near:
        return wash
    for j in range(count):
        lift = max(state[j, 2, THRUST], 0.0) * constants[j, MASS]
        jet = 2.0 * math.sqrt(lift / (2.0 * AIR_DENSITY * math.pi)) / constants[j, RADIUS]
        for i in range(count):
            below = state[j, 2, POSITION] - state[i, 2, POSITION]
            if _WASH_START < below < _WASH_END:
                core = 0.7 * constants[j, RADIUS]
                width = core + 0.1 * below
                speed = jet * (core / width) * math.exp(-apart[i, j] / (2.0 * width**2))
                wash[i] = max(wash[i], speed)
    return wash


@compiled
def telemetry_rows(
    state: Floats3, tumbling: Bools1, tumble: Floats1, turn: tuple[Floats1, Floats1],
    frames: Floats2, rows: Singles2,
) -> None:  # fmt: skip
    """Write the floats of LOCAL_POSITION_NED and ATTITUDE, in wire order, to ``rows`` (n, 12).

    ``turn`` are yaws (n,), counter-clockwise from east, and their rates; ``frames`` (n, 5) are the
    origins of the local frames and their metres per true metre east and north. An attitude is that
    of the thrust; rates of roll and pitch in ``rows`` stay unchanged.
    """
    yaw, yaw_rate = turn
    for i in range(len(state)):
        body, row = state[i], rows[i]
        east = body[0, POSITION] + body[0, ESTIMATE_ERROR] - frames[i, 0]
        north = body[1, POSITION] + body[1, ESTIMATE_ERROR] - frames[i, 1]
        row[0], row[1] = north * frames[i, 4], east * frames[i, 3]
        row[2] = frames[i, 2] - (body[2, POSITION] + body[2, ESTIMATE_ERROR])
        row[3], row[4], row[5] = body[1, VELOCITY], body[0, VELOCITY], -body[2, VELOCITY]
        roll, pitch, turned = _attitude(body, tumbling[i], tumble[i], 0.5 * math.pi - yaw[i])
        row[6], row[7], row[8], row[11] = roll, pitch, turned, -yaw_rate[i]


@inner
def _attitude(body: Array, tumbles: bool, tumble: float, yaw: float) -> tuple[float, float, float]:
    """Return roll, pitch and yaw (NED, radians) of one vehicle."""
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
@allocates
def tilts(state: Floats3, tumbling: Bools1, tumble: Floats1) -> Array:
    """Return the angles of all thrusts from vertical (n,), radians."""
    leans = np.zeros(len(state))
    for i in range(len(state)):
        body = state[i]
        level = math.hypot(body[0, THRUST], body[1, THRUST])
        if tumbling[i]:
            leans[i] = abs(_wrap(tumble[i]))
        elif math.hypot(level, body[2, THRUST]) > 1.0:
            leans[i] = math.atan2(level, body[2, THRUST])
    return leans


@inner
def _wrap(angle: float) -> float:
    return (angle + math.pi) % (2.0 * math.pi) - math.pi


@compiled
def unchanged(
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
            slow = slow and abs(velocity[i, k]) < SLOW[k]
        if not (flies and still) or (slow and goal[i, 2] < DESCENDING):
            return False
    return True
