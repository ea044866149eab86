"""The computations for the whole team at every tick, compiled: loops over a few vehicles.

Array operations would cost ten times as much. Results go into arrays of the caller: creating one in
compiled code costs more than most of the computations. All quantities are of grip points, mission
ENU, SI.
"""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from swarm.jit import allocates, compiled
from swarm.mavlink.telemetry_table import ATTITUDE, BOOT_TIME, POSITION, POSITION_AT, VELOCITY
from swarm.signatures import Bools1, Floats1, Floats2, Floats3, Ints1

Floats = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]
Indices = npt.NDArray[np.int64]


_REPORTED, _VELOCITY, _POSITION = range(3)
"""Rows of `Measured.places`."""
_AT, _ERROR, _BOOT = range(3)
"""Rows of `Measured.numbers`."""


class Measured(NamedTuple):
    """The latest reports of n vehicles, and their estimated places now.

    ``places`` (3, n, 3) are the reported positions of their centres, the reported velocities, and
    the grip points now, mission ENU; ``numbers`` (3, n) are the times of the reports: of
    reading, or of measurement where they were delayed; the tracking errors, and the times of the
    reports since each vehicle's boot.
    """

    places: Floats3
    numbers: Floats2

    @classmethod
    def of(cls, n: int) -> "Measured":
        """Return the measurements of n vehicles that have not reported yet."""
        numbers = np.full((3, n), np.nan)
        numbers[_AT] = -np.inf
        return cls(np.full((3, n, 3), np.nan), numbers)

    @property
    def reported(self) -> Floats:
        """Reported positions of centres (n, 3)."""
        part: Floats = self.places[_REPORTED]
        return part

    @property
    def velocity(self) -> Floats:
        """Reported velocities (n, 3)."""
        part: Floats = self.places[_VELOCITY]
        return part

    @property
    def position(self) -> Floats:
        """Grip points now (n, 3)."""
        part: Floats = self.places[_POSITION]
        return part

    @property
    def at(self) -> Floats:
        """Times of the reports (n,), seconds: of reading, or of measurement if delayed."""
        part: Floats = self.numbers[_AT]
        return part

    @property
    def boot(self) -> Floats:
        """Times of the reports since the boot of each vehicle (n,), seconds; NaN: not known."""
        part: Floats = self.numbers[_BOOT]
        return part

    @property
    def error(self) -> Floats:
        """Tracking errors (n,) in metres: grip points against setpoints; NaN: not known."""
        part: Floats = self.numbers[_ERROR]
        return part


@compiled
def measure(
    table: Floats2, rows: Ints1, inverse: tuple[Floats3, Floats2, Floats1],
    commanded: tuple[Floats2, Floats2, Bools1], times: tuple[float, float, float, float],
    measured: Measured,
) -> None:  # fmt: skip
    """Extrapolate the reports of vehicles ``rows`` (n,) of a telemetry ``table`` to this moment.

    ``inverse`` are the maps from their NED frames, and the way (3,) from grip points to centres.
    ``commanded`` are the last tick's setpoints, their velocities, and which vehicles get them; the
    error is NaN for a silent vehicle, or one without setpoints. ``times`` in seconds: now, the
    longest extrapolation, the age from which a vehicle is silent, and the time since the last tick.
    ``measured`` is filled in.
    """
    now, longest, silence, elapsed = times
    setpoint, setpoint_velocity, streaming = commanded
    places, numbers = measured.places, measured.numbers
    turn, offset, lift = inverse
    for i in range(len(rows)):
        row = table[rows[i]]
        age = now - row[POSITION_AT]
        ahead, square = min(age, longest), 0.0
        for k in range(3):
            place = speed = 0.0
            for m in range(3):
                place += turn[i, k, m] * row[POSITION + m]
                speed += turn[i, k, m] * row[VELOCITY + m]
            place += offset[i, k]
            here = place - lift[k] + speed * ahead
            target = setpoint[i, k] + setpoint_velocity[i, k] * elapsed
            square += (here - target) ** 2
            places[_REPORTED, i, k], places[_VELOCITY, i, k] = place, speed
            places[_POSITION, i, k] = here
        numbers[_AT, i] = row[POSITION_AT]
        numbers[_BOOT, i] = 0.001 * row[BOOT_TIME] if row[BOOT_TIME] >= 0.0 else math.nan
        numbers[_ERROR, i] = math.sqrt(square) if streaming[i] and age <= silence else math.nan


@compiled
def evaluate_piece(
    coefficients: Floats3, u: float, rate: float, slope: float, states: Floats3
) -> None:
    """Evaluate a piece of quintics (6, n, 3) at ``u`` into ``states``: position, velocity and
    acceleration (3, n, 3).

    ``rate`` is the rate of its time, and ``slope`` the derivative of that rate in 1/s.
    """
    orders, count, axes = coefficients.shape
    for i in range(count):
        for j in range(axes):
            place = speed = growth = 0.0
            for k in range(orders - 1, -1, -1):
                growth = growth * u + speed
                speed = speed * u + place
                place = place * u + coefficients[k, i, j]
            states[0, i, j] = place
            states[1, i, j] = rate * speed
            states[2, i, j] = rate * rate * 2.0 * growth + slope * speed


@compiled
@allocates
def setpoints_ned(
    state: tuple[Floats2, Floats2, Floats2], lead: float, mobility: Floats1,
    pull: tuple[Floats2, Floats2, float], frames: tuple[Floats3, Floats2, Floats1], states: Floats3,
) -> None:  # fmt: skip
    """Compute setpoints of centres, in each vehicle's NED frame, into ``states`` (n, 3, 3):
    positions, velocities, accelerations.

    ``state`` are position, velocity and acceleration (n, 3) of grip points; positions are ``lead``
    seconds ahead. The cable's pull is fed forward with ``mobility`` (n,), acceleration per force in
    1/kg: ``pull`` is the pull at a sample (n, 3), its change to the next one, and the share of
    that. ``frames`` are rotations (n, 3, 3) and translations (n, 3), and the way (3,) from grip
    points to centres.
    """
    position, velocity, acceleration = state
    before, change, share = pull
    rotation, translation, lift = frames
    enu = np.empty((3, 3))
    for i in range(len(position)):
        for k in range(3):
            ahead = velocity[i, k] + 0.5 * lead * acceleration[i, k]
            enu[0, k] = position[i, k] + lead * ahead + lift[k]
            enu[1, k] = velocity[i, k]
            enu[2, k] = acceleration[i, k] - mobility[i] * (change[i, k] * share + before[i, k])
        for j in range(3):
            for k in range(3):
                states[i, j, k] = (
                    rotation[i, k, 0] * enu[j, 0]
                    + rotation[i, k, 1] * enu[j, 1]
                    + rotation[i, k, 2] * enu[j, 2]
                )
        for k in range(3):
            states[i, 0, k] += translation[i, k]


@compiled
def new_reports(
    table: Floats2, rows: Ints1, reports: tuple[Measured, Measured],
    commanded: tuple[Floats2, Bools1], limits: tuple[float, float, float, float, float],
    step: Floats1,
) -> tuple[bool, bool]:  # fmt: skip
    """Return whether any vehicle has reported since the last time, and all move as commanded.

    ``reports`` are those of now and of the last time; ``commanded`` are velocities (n, 3), and
    which vehicles get setpoints.

    ``step`` (n,) becomes the seconds between the reports, 0 without a new one: by the vehicle's own
    clock where it is known, since a ground station that was stalled reads old reports late. A
    vehicle moves as commanded where it does not sink faster than commanded, jump, turn over, or
    stay without a report for too long. ``limits``: the longest step in seconds, the descent without
    setpoints, the sinking beyond the commanded one, both in m/s, the largest jump along an axis in
    metres, and the largest roll or pitch.
    """
    longest, descent, sinking, jump, tilt = limits
    (now, last), (velocity, streaming) = reports, commanded
    places, at = now.places, now.numbers[_AT]
    before, last_at = last.places, last.numbers[_AT]
    reported, calm = False, True
    for i in range(len(rows)):
        row = table[rows[i]]
        step[i] = 0.0
        if at[i] > last_at[i]:
            by_boot = now.numbers[_BOOT, i] - last.numbers[_BOOT, i]
            step[i] = by_boot if by_boot > 0.0 else at[i] - last_at[i]
        reported = reported or step[i] > 0.0
        down = min(velocity[i, 2], 0.0) if streaming[i] else -descent
        calm = calm and step[i] <= longest and not down - places[_VELOCITY, i, 2] > sinking
        calm = calm and not (abs(row[ATTITUDE]) > tilt or abs(row[ATTITUDE + 1]) > tilt)
        for k in range(3):
            middle = 0.5 * step[i] * (before[_VELOCITY, i, k] + places[_VELOCITY, i, k])
            moved = places[_REPORTED, i, k] - before[_REPORTED, i, k]
            calm = calm and abs(moved - middle) <= jump
    return reported, calm


@compiled
def keep_reports(now: Measured, last: Measured, step: Floats1) -> None:
    """Copy the reports that came after ``step`` (n,) seconds into ``last``."""
    for i in range(len(step)):
        last.numbers[_AT, i] = now.numbers[_AT, i]
        last.numbers[_BOOT, i] = now.numbers[_BOOT, i]
        if step[i] > 0.0:
            for k in range(3):
                last.places[_REPORTED, i, k] = now.places[_REPORTED, i, k]
                last.places[_VELOCITY, i, k] = now.places[_VELOCITY, i, k]
