"""What is reckoned for the whole team at every tick, compiled: loops over a handful of vehicles.

As array operations the same would cost ten times as much. Results go into arrays that are given: to
make one in compiled code costs more than most of what is reckoned. Everything is of grip points,
mission ENU, SI.
"""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from swarm.jit import compiled
from swarm.mavlink.telemetry_table import ATTITUDE, POSITION, POSITION_AT, RECEIVED_AT, VELOCITY

Floats = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]
Indices = npt.NDArray[np.int64]


_REPORTED, _VELOCITY, _POSITION = range(3)
_AT, _ERROR = range(2)


class Measured(NamedTuple):
    """Where n vehicles were when they said so last, and where they are now.

    ``places`` (3, n, 3) are their centres as reported, their velocities, and their grip points now,
    mission ENU; ``numbers`` (2, n) are when they reported, and how far grip points are from where
    setpoints have led.
    """

    places: Floats
    numbers: Floats

    @classmethod
    def of(cls, n: int) -> "Measured":
        """Return what is measured of n vehicles that have said nothing."""
        numbers = np.full((2, n), np.nan)
        numbers[_AT] = -np.inf
        return cls(np.full((3, n, 3), np.nan), numbers)

    @property
    def reported(self) -> Floats:
        """Centres as reported (n, 3)."""
        part: Floats = self.places[_REPORTED]
        return part

    @property
    def velocity(self) -> Floats:
        """Velocities as reported (n, 3)."""
        part: Floats = self.places[_VELOCITY]
        return part

    @property
    def position(self) -> Floats:
        """Grip points now (n, 3)."""
        part: Floats = self.places[_POSITION]
        return part

    @property
    def at(self) -> Floats:
        """When they reported (n,), seconds."""
        part: Floats = self.numbers[_AT]
        return part

    @property
    def error(self) -> Floats:
        """How far grip points are from where setpoints have led (n,), metres; NaN: not known."""
        part: Floats = self.numbers[_ERROR]
        return part


@compiled
def measure(
    said: Floats, rows: Indices, back: tuple[Floats, Floats], lift: Floats, setpoint: Floats,
    setpoint_velocity: Floats, streaming: Flags, times: tuple[float, float, float, float],
    places: Floats, numbers: Floats,
) -> None:  # fmt: skip
    """Bring what vehicles ``rows`` (n,) of a team's columns ``said`` to this moment.

    ``back`` are the maps from their NED, ``lift`` (3,) from grip points to centres. Setpoints are
    the last tick's; errors are not known (NaN) of those who do not get any, or are silent.
    ``times`` in seconds: now, for how long reports are carried on with their velocity, from when on
    a vehicle is silent, and how long ago the last tick was. ``places`` and ``numbers`` are filled
    in as `Measured` has them.
    """
    now, freshest, silence, elapsed = times
    turn, offset = back
    for i in range(len(rows)):
        row = said[rows[i]]
        age = now - row[POSITION_AT]
        carried, square = min(age, freshest), 0.0
        for k in range(3):
            place = speed = 0.0
            for m in range(3):
                place += turn[i, k, m] * row[POSITION + m]
                speed += turn[i, k, m] * row[VELOCITY + m]
            place += offset[i, k]
            here = place - lift[k] + speed * carried
            led = setpoint[i, k] + setpoint_velocity[i, k] * elapsed
            square += (here - led) ** 2
            places[_REPORTED, i, k], places[_VELOCITY, i, k] = place, speed
            places[_POSITION, i, k] = here
        numbers[_AT, i] = row[POSITION_AT]
        numbers[_ERROR, i] = math.sqrt(square) if streaming[i] and age <= silence else math.nan


@compiled
def sampled(coefficients: Floats, u: float, rate: float, slope: float, states: Floats) -> None:
    """Position, velocity and acceleration (3, n, 3) of a piece of quintics (6, n, 3), at ``u`` in
    it, into ``states``.

    ``rate`` is how fast time passes there, and ``slope`` how fast the rate grows, in 1/s.
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
def aimed(
    state: tuple[Floats, Floats, Floats], lead: float, lift: Floats, mass: float,
    pull: tuple[Floats, Floats, float], frames: tuple[Floats, Floats], states: Floats,
) -> None:  # fmt: skip
    """Setpoints of centres, in each vehicle's NED, into ``states`` (n, 3, 3): positions,
    velocities, accelerations.

    ``state`` are position, velocity and acceleration (n, 3) of grip points, ``lift`` (3,) from
    there to centres; positions are ``lead`` seconds ahead. Accelerations are relieved of what the
    cable pulls at ``mass``: ``pull`` is the one at a moment (n, 3), its change to the next, and the
    share of that. ``frames`` are rotations (n, 3, 3) and translations (n, 3).
    """
    position, velocity, acceleration = state
    before, change, share = pull
    rotation, translation = frames
    enu = np.empty((3, 3))
    for i in range(len(position)):
        for k in range(3):
            ahead = velocity[i, k] + 0.5 * lead * acceleration[i, k]
            enu[0, k] = position[i, k] + lead * ahead + lift[k]
            enu[1, k] = velocity[i, k]
            enu[2, k] = acceleration[i, k] - (change[i, k] * share + before[i, k]) / mass
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
def news(
    said: Floats, rows: Indices, places: Floats, at: Floats, last: Floats, last_at: Floats,
    told: Floats, streaming: Flags, limits: tuple[float, float, float, float, float], step: Floats,
) -> tuple[bool, bool, float]:  # fmt: skip
    """Whether anybody has reported since the last time; whether all of them move as they were told
    to; and when the one was heard who was not heard for longest.

    ``places`` and ``last`` are those of `Measured`, reported ``at`` and ``last_at`` (n,); ``step``
    (n,) becomes the seconds between, 0 where there is no new report. As they should move all who do
    not sink faster than ``told`` (n, 3), jump, turn over, or have not been heard for too long.
    ``limits``: the longest step in seconds, how fast those may sink that are not streamed to, by
    how much anybody may beyond what was told, in m/s, the largest jump along an axis in metres, and
    the largest roll or pitch.
    """
    longest, sinking, too_much, jump, tilt = limits
    heard, reported, calm = math.inf, False, True
    for i in range(len(rows)):
        row = said[rows[i]]
        heard = min(heard, row[RECEIVED_AT])
        step[i] = at[i] - last_at[i] if at[i] > last_at[i] else 0.0
        reported = reported or step[i] > 0.0
        down = min(told[i, 2], 0.0) if streaming[i] else -sinking
        calm = calm and step[i] <= longest and not down - places[_VELOCITY, i, 2] > too_much
        calm = calm and not (abs(row[ATTITUDE]) > tilt or abs(row[ATTITUDE + 1]) > tilt)
        for k in range(3):
            middle = 0.5 * step[i] * (last[_VELOCITY, i, k] + places[_VELOCITY, i, k])
            moved = places[_REPORTED, i, k] - last[_REPORTED, i, k]
            calm = calm and abs(moved - middle) <= jump
    return reported, calm, heard


@compiled
def note(places: Floats, at: Floats, last: Floats, last_at: Floats, step: Floats) -> None:
    """Remember what was reported after ``step`` (n,) seconds as each one's last report."""
    for i in range(len(step)):
        last_at[i] = at[i]
        if step[i] > 0.0:
            for k in range(3):
                last[_REPORTED, i, k] = places[_REPORTED, i, k]
                last[_VELOCITY, i, k] = places[_VELOCITY, i, k]
